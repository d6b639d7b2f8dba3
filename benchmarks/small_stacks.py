"""Stacks of two to six boxes that statics decides, and petmjx's verdicts.

A stack is a tree of boxes, or a plank on two columns with boxes on it, so that force and moment balance alone say where
the load of each box acts. The stack stands if each load acts over the supports of its box. Sizes are 20 to 4,000 mm,
mass ratios up to 1,000; loads act half a millimetre or more from the nearest edge, mostly not much more.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

import petmjx
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Flag
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan import Plan

LEAST_EDGE_MM = 0.5
"""Smallest distance of a load from an edge, mm. The verdict on a load that is nearer may depend on 0.1 mm of a box's
size."""

SIZES_MM = (20.0, 4000.0)

MOST_MASS_RATIO = 1000.0

FREE_DEG = Thresholds().tilt_deg + 3.0
"""Angle by which a box that tips must be free to turn before it touches another box, degrees. A box with less free
space may be caught, and stand."""

ANGLES_RAD = np.radians(np.arange(1.0, FREE_DEG, 1.0))

PLAY_MM = 1.0
"""Boxes that overlap by less than this length while one of them turns count as not touching, mm."""

GAP_MM = 2.0
"""Smallest gap between boxes side by side, mm, so that the boxes do not rub against each other."""

CHECKS: dict[str, dict[str, Any]] = {
    "adaptive": {},
    "fixed": {"schedule": "fixed"},
    "static adaptive": {"check": "static"},
    "static fixed": {"check": "static", "schedule": "fixed"},
}
"""How each stack is simulated: options of ``petmjx.score``."""

GROUND = -1
"""Stands for the carrier in lists of supports."""


@dataclass(frozen=True, eq=False)
class Stack:
    """A stack of n boxes. Their centres differ along one horizontal axis; along the other axis, all centres are the
    same.

    Attributes:
        centre, length: (n,) along the axis, mm.
        width: (n,) along the other axis, mm.
        bottom, height: (n,) mm.
        mass: (n,) kg.
        supports: supports of each box: one or two boxes that are placed earlier, or ``GROUND``.
    """

    kind: str
    centre: FloatArray
    length: FloatArray
    width: FloatArray
    bottom: FloatArray
    height: FloatArray
    mass: FloatArray
    supports: tuple[tuple[int, ...], ...]

    @property
    def n_boxes(self) -> int:
        return len(self.mass)

    def above(self, box: int, placed: int) -> list[int]:
        """A box and all boxes that rest on it, directly or through other boxes."""
        boxes = [box]
        for other in range(box + 1, placed):
            if set(self.supports[other]) & set(boxes):
                boxes.append(other)
        return boxes

    def base(self, box: int) -> tuple[float, float]:
        """The ends of a box's supports."""
        low, high = self.centre - self.length / 2, self.centre + self.length / 2
        under = [k for k in self.supports[box] if k != GROUND]
        if not under:
            return low[box], high[box]
        return max(low[box], min(low[under])), min(high[box], max(high[under]))

    def edges_mm(self, placed: int) -> FloatArray:
        """(placed,) distance from the load of each box to the nearest edge of the box's supports, mm: positive inside
        the edge, negative beyond it."""
        edges = []
        for box in range(placed):
            load = self.above(box, placed)
            point = np.average(self.centre[load], weights=self.mass[load])
            low, high = self.base(box)
            edges.append(min(point - low, high - point))
        return np.array(edges)

    def plan(self, name: str, axis: int) -> Plan:
        """The stack as a plan. ``axis``: whether the centres differ along x (0) or y (1)."""
        size, corner = np.zeros((2, self.n_boxes, 3))
        size[:, axis], size[:, 1 - axis], size[:, 2] = self.length, self.width, self.height
        corner[:, axis], corner[:, 1 - axis], corner[:, 2] = self.centre, 0.0, self.bottom
        corner[:, :2] -= size[:, :2] / 2
        corner[:, :2] -= corner[:, :2].min(axis=0)
        return Plan.from_boxes(name, size_mm=size, corner_mm=corner, mass_kg=self.mass)


@dataclass(frozen=True)
class Case:
    """A stack as a plan, and whether it stands: if boxes are placed one by one, and if all boxes are there from the
    start."""

    plan: Plan
    kind: str
    edge_mm: float
    stands: bool
    stands_at_once: bool


def cases(count: int, seed: int) -> Iterator[Case]:
    """Yield random stacks. The kinds take turns."""
    rng = np.random.default_rng(seed)
    kinds: dict[str, Callable[[np.random.Generator], Stack]] = {
        "tower": _tower,
        "overhang": _overhang,
        "counterweight": _counterweight,
        "bridge": _bridge,
    }
    for number in range(count):
        kind = list(kinds)[number % len(kinds)]
        while (case := _case(kinds[kind](rng), f"{kind}-{number:04}", rng)) is None:
            pass
        yield case


def _case(stack: Stack, name: str, rng: np.random.Generator) -> Case | None:
    """The stack as a case. Its last box is moved so that the load of one of the boxes acts near an edge. None if this
    is impossible."""
    last = stack.n_boxes - 1
    below = [box for box in range(last + 1) if last in stack.above(box, last + 1)]
    box = int(rng.choice(below))
    load, (low, high) = stack.above(box, last + 1), stack.base(box)
    edge = rng.choice([-1.0, 1.0]) * _log_uniform(rng, LEAST_EDGE_MM, max((high - low) / 2, 1.0))
    moment = (high - edge) * stack.mass[load].sum() - (stack.centre * stack.mass)[load[:-1]].sum()
    moved = stack.centre.copy()
    moved[last] = moment / stack.mass[last] if box != last else high - edge
    stack = Stack(**{**vars(stack), "centre": moved})
    if _collides(stack) or not _touches_all(stack):
        return None
    stands, least = True, math.inf
    for placed in range(1, last + 2):
        edges = stack.edges_mm(placed)
        least = min(least, np.abs(edges).min())
        if least < LEAST_EDGE_MM or (edges.min() < 0 and not _tips_freely(stack, placed, int(edges.argmin()))):
            return None
        if edges.min() < 0:
            stands = False
            break
    at_once = stack.edges_mm(last + 1)
    if np.abs(at_once).min() < LEAST_EDGE_MM:
        return None
    if at_once.min() < 0 and not _tips_freely(stack, last + 1, int(at_once.argmin())):
        return None
    plan = stack.plan(name, int(rng.integers(2)))
    return Case(plan, stack.kind, float(least), stands, bool(at_once.min() > 0))


def _collides(stack: Stack) -> bool:
    """Whether two boxes side by side are nearer than ``GAP_MM``, or overlap."""
    low, high = stack.centre - stack.length / 2, stack.centre + stack.length / 2
    top = stack.bottom + stack.height
    beside = np.minimum.outer(top, top) > np.maximum.outer(stack.bottom, stack.bottom)
    near = np.minimum.outer(high, high) + GAP_MM > np.maximum.outer(low, low)
    return bool(np.triu(beside & near, k=1).any())


def _touches_all(stack: Stack) -> bool:
    """Whether each box lies on all of its supports."""
    low, high = stack.centre - stack.length / 2, stack.centre + stack.length / 2
    return all(
        min(high[box], high[k]) - max(low[box], low[k]) > 2 * LEAST_EDGE_MM
        for box, under in enumerate(stack.supports)
        for k in under
        if k != GROUND
    )


def _tips_freely(stack: Stack, placed: int, box: int) -> bool:
    """Whether a box and the boxes on it touch no other box while they tip over their edge."""
    moving = stack.above(box, placed)
    low, high = stack.base(box)
    point = np.average(stack.centre[moving], weights=stack.mass[moving])
    side = 1.0 if point > high else -1.0
    pivot = np.array([high if side > 0 else low, stack.bottom[box]])
    still = [k for k in range(placed) if k not in moving]
    others = [_rectangle(stack, k) for k in still]
    others.append(np.array([[-1e6, -1e6], [1e6, -1e6], [1e6, 0.0], [-1e6, 0.0]]))
    for angle in ANGLES_RAD:
        turn = np.array([[math.cos(angle), -side * math.sin(angle)], [side * math.sin(angle), math.cos(angle)]])
        for k in moving:
            corners = (_rectangle(stack, k) - pivot) @ turn + pivot
            if any(_overlap_mm(corners, other) > PLAY_MM for other in others):
                return False
    return True


def _rectangle(stack: Stack, box: int) -> FloatArray:
    """(4, 2) corners of a box seen from the side, in order."""
    x = stack.centre[box] + stack.length[box] / 2 * np.array([-1, 1, 1, -1])
    z = stack.bottom[box] + stack.height[box] * np.array([0, 0, 1, 1])
    return np.stack([x, z], axis=1)


def _overlap_mm(one: FloatArray, other: FloatArray) -> float:
    """Depth of the overlap of two rectangles, by separating axes; negative if they are apart."""
    sides = np.concatenate([np.diff(one[:3], axis=0), np.diff(other[:3], axis=0)])
    axes = sides / np.linalg.norm(sides, axis=1)[:, None]
    a, b = one @ axes.T, other @ axes.T
    return float(np.minimum(a.max(axis=0) - b.min(axis=0), b.max(axis=0) - a.min(axis=0)).min())


# ---------------------------------------------------------------------- kinds


def _log_uniform(rng: np.random.Generator, low: float, high: float, size: int | None = None) -> Any:
    return np.exp(rng.uniform(math.log(low), math.log(high), size))


def _sizes(rng: np.random.Generator, n: int) -> FloatArray:
    """n random extents for the boxes of one stack."""
    scale = _log_uniform(rng, 2 * SIZES_MM[0], SIZES_MM[1] / 2)
    sizes: FloatArray = np.clip(np.round(scale * _log_uniform(rng, 1 / 3, 3, n)), *SIZES_MM)
    return sizes


def _masses(rng: np.random.Generator, n: int) -> FloatArray:
    masses: FloatArray = _log_uniform(rng, 0.5, 0.5 * MOST_MASS_RATIO, n)
    return masses


def _piled(height: FloatArray, supports: tuple[tuple[int, ...], ...]) -> FloatArray:
    """(n,) heights of the boxes' bottoms, mm."""
    bottom = np.zeros(len(height))
    for box, (first, *_) in enumerate(supports):
        bottom[box] = 0.0 if first == GROUND else bottom[first] + height[first]
    return bottom


def _stack(
    kind: str,
    rng: np.random.Generator,
    centre: FloatArray,
    length: FloatArray,
    supports: tuple[tuple[int, ...], ...],
    height: FloatArray | None = None,
) -> Stack:
    n = len(centre)
    height = _sizes(rng, n) if height is None else height
    return Stack(kind, centre, length, _sizes(rng, n), _piled(height, supports), height, _masses(rng, n), supports)


def _tower(rng: np.random.Generator) -> Stack:
    """A random stack in which each box is at a random place on the box before."""
    n = int(rng.integers(2, 7))
    length = _sizes(rng, n)
    centre = np.cumsum(np.r_[0.0, rng.uniform(-0.5, 0.5, n - 1) * np.minimum(length[1:], length[:-1])])
    return _stack("tower", rng, centre, length, ((GROUND,), *((k,) for k in range(n - 1))))


def _overhang(rng: np.random.Generator) -> Stack:
    """A random stack: a plank over the edge of a box, and boxes side by side on the plank."""
    n = int(rng.integers(3, 6))
    base, plank, *rest = _sizes(rng, n)
    plank = min(max(plank, 1.5 * base), SIZES_MM[1])
    length = np.array([base, plank, *np.minimum(rest, plank / (n - 2))])
    spots = (np.arange(n - 2) + 0.5) / (n - 2) - 0.5
    middle = rng.uniform(-0.5, 0.5) * plank
    return _stack(
        "overhang", rng, np.r_[0.0, middle, middle + spots * plank], length, ((GROUND,), (0,), *[(1,)] * (n - 2))
    )


def _counterweight(rng: np.random.Generator) -> Stack:
    """A random stack: a plank over the edge of a box, then a weight on its inner end, then a weight on its outer
    end."""
    base, plank, inner, outer = _sizes(rng, 4)
    plank = min(max(plank, 1.5 * base), SIZES_MM[1])
    length = np.array([base, plank, min(inner, plank / 3), min(outer, plank / 3)])
    middle = rng.uniform(0.2, 0.5) * plank
    ends = middle + np.array([-1, 1]) * rng.uniform(0.2, 0.45, 2) * plank
    return _stack("counterweight", rng, np.r_[0.0, middle, ends], length, ((GROUND,), (0,), (1,), (1,)))


def _bridge(rng: np.random.Generator) -> Stack:
    """A random stack: a plank across two boxes of equal height, and one or two boxes on the plank."""
    loads = int(rng.integers(1, 3))
    lengths = _sizes(rng, 3 + loads)
    gap = rng.uniform(0.1, 2.0) * lengths[:2].sum()
    left, right = -(gap + lengths[0]) / 2, (gap + lengths[1]) / 2
    lengths[2] = min(max(lengths[2], 1.2 * (gap + lengths[:2].sum() / 2)), SIZES_MM[1])
    lengths[3:] = np.minimum(lengths[3:], lengths[2] / loads)
    spots = ((np.arange(loads) + 0.5) / loads - 0.5) * lengths[2]
    height = _sizes(rng, 3 + loads)
    height[1] = height[0]
    middle = (left + right) / 2 + rng.uniform(-0.3, 0.3) * lengths[2]
    centre = np.r_[left, right, middle, middle + spots]
    return _stack("bridge", rng, centre, lengths, ((GROUND,), (GROUND,), (0, 1), *[(2,)] * loads), height)


# ---------------------------------------------------------------------- judgement


def judge(stacks: list[Case], check: str, **options: Any) -> pd.DataFrame:
    """A row for each case: its kind, whether it stands by statics, the verdict, and whether boxes still moved at the
    world's end."""
    with warnings.catch_warnings():
        # petmjx warns, since masses and sizes of these stacks look like mistakes of units
        warnings.simplefilter("ignore", petmjx.PlanWarning)
        results = petmjx.score([case.plan for case in stacks], carrier="footprint", **CHECKS[check], **options)
    worlds = results.worlds.set_index("plan_id").loc[[case.plan.plan_id for case in stacks]]
    at_once = CHECKS[check].get("check") == "static"
    return pd.DataFrame(
        {
            "plan_id": worlds.index,
            "kind": [case.kind for case in stacks],
            "edge_mm": [case.edge_mm for case in stacks],
            "stands": [case.stands_at_once if at_once else case.stands for case in stacks],
            "verdict": worlds["verdict"].astype(str).to_numpy(),
            "moving": (worlds["flags"].to_numpy() & int(Flag.MOVING)) != 0,
            "attempt": worlds["attempt"].to_numpy(),
        }
    )


def summary(table: pd.DataFrame) -> dict[str, Any]:
    """The results of a check for the stacks: the number of verdicts that agree with statics, the number of worlds with
    the flag *moving*, and the plans with a wrong verdict but without this flag."""
    answers = table["verdict"].map({"stable": True, "unstable": False})
    agrees = answers == table["stands"]
    wrong = table[~agrees & ~table["moving"]]
    return {
        "stacks": len(table),
        "stand": int(table["stands"].sum()),
        "agree": int(agrees.sum()),
        "moving": int(table["moving"].sum()),
        "wrong": wrong["plan_id"].tolist(),
        "retried": {str(key): value for key, value in sorted(Counter(table["attempt"]).items()) if key > 1},
    }
