"""A plan while it is being changed (``Draft``), and the limits of changed plans (``Rules``).

A draft keeps the numbers that boxes have in the plan, whatever their order is now. Sheets that are added have the next
numbers. A draft is allowed if no fault of its layout is worse than in the plan: boxes that overlap, that float when
they are placed, that reach beyond the carrier, or that would be placed under a box that already stands. So an odd plan
can be repaired step by step, but never becomes odder. A box that is moved aside or turned must not end inside a wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.carriers import extent_m
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import KINDS, SHEET
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, meets, shared_length
from petmjx.world.carrier_boards import has_walls
from petmjx.world.scene import carrier_of

TOLERANCE_MM: Final = DEFAULT_TOLERANCE_MM
"""Gaps and overlaps up to this count as touching, as in the warnings about a plan."""

_ROUNDING_MM: Final = 1e-6
"""A fault counts as worse than in the plan only if it is larger by more than this: sums of millimetres are rounded."""

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Draft:
    """A changed plan. Rows are the n boxes of the plan in its order, then the added sheets, m in all.

    Attributes:
        plan: the plan before the changes.
        size_mm, corner_mm: (m, 3) extents and front-left-bottom corners.
        turned: (m,) whether a box is turned by 90° from its orientation in the plan.
        order: numbers of the boxes that are placed, in packing order.
        moved: numbers of the boxes with another place or orientation than in the plan. The plan's directions of
            approach no longer hold for them.
        sheet_kg: masses of the added sheets.
        film_turns: turns of film around the pallet.
    """

    plan: Plan
    size_mm: FloatArray
    corner_mm: FloatArray
    turned: BoolArray
    order: tuple[int, ...]
    moved: frozenset[int] = frozenset()
    sheet_kg: tuple[float, ...] = ()
    film_turns: float = 0.0

    @classmethod
    def of(cls, plan: Plan, film_turns: float = 0.0) -> Draft:
        """The plan without a change."""
        n = plan.n_boxes
        order = tuple(range(n))
        return cls(plan, plan.size_mm, plan.corner_mm, np.zeros(n, bool), order, film_turns=film_turns)

    @cached_property
    def rank(self) -> FloatArray:
        """(m,) position of each box in packing order; infinite if the box is left out."""
        rank = np.full(len(self.size_mm), np.inf)
        rank[list(self.order)] = np.arange(len(self.order))
        return rank

    @cached_property
    def mass_kg(self) -> FloatArray:
        """(m,) masses, kg."""
        return np.concatenate([self.plan.mass_kg, self.sheet_kg])

    @cached_property
    def on_top(self) -> BoolArray:
        """(m, m) whether the column's box lies on the row's."""
        low, high = self.corner_mm.T, (self.corner_mm + self.size_mm).T
        shared = (shared_length(low[0], high[0]) > TOLERANCE_MM) & (shared_length(low[1], high[1]) > TOLERANCE_MM)
        lies = shared & meets(low[2], high[2], TOLERANCE_MM) & np.less.outer(low[2], low[2])
        present = np.isfinite(self.rank)
        on_top: BoolArray = lies & present & present[:, None]
        return on_top

    @cached_property
    def is_bare(self) -> BoolArray:
        """(m,) whether nothing lies on a box."""
        return np.asarray(~self.on_top.any(axis=1))

    def above(self, box: int) -> list[int]:
        """Numbers of the boxes that lie on a box, directly or through others."""
        return _closure(self.on_top, box)

    def below(self, box: int) -> list[int]:
        """Numbers of the boxes that bear a box, directly or through others."""
        return _closure(self.on_top.T, box)

    def with_places(self, boxes: Sequence[int], corner_mm: FloatArray, *, anew: bool = True) -> Draft:
        """The draft with other corners of some boxes. ``anew``: whether the plan's directions of
        approach no longer hold for these boxes, so that they count as ``moved``."""
        corners = self.corner_mm.copy()
        corners[list(boxes)] = corner_mm
        return replace(self, corner_mm=corners, moved=self.moved | frozenset(boxes) if anew else self.moved)

    def with_turn(self, box: int, turned: bool) -> Draft:
        """The draft in which a box is turned from its orientation in the plan, or is not. Its corner stays where it
        is."""
        if bool(self.turned[box]) == turned:
            return self
        sizes, turns = self.size_mm.copy(), self.turned.copy()
        sizes[box] = sizes[box, [1, 0, 2]]
        turns[box] = turned
        return replace(self, size_mm=sizes, turned=turns, moved=self.moved | {box})

    def with_order(self, box: int, neighbour: int, *, after: bool) -> Draft | None:
        """The draft with a box that is placed directly before or after another one; None if one of both is left out."""
        if box == neighbour or box not in self.order or neighbour not in self.order:
            return None
        other_boxes = [number for number in self.order if number != box]
        other_boxes.insert(other_boxes.index(neighbour) + int(after), box)
        return replace(self, order=tuple(other_boxes))

    def without(self, box: int) -> Draft | None:
        """The draft without a box; None if the draft has no such box, or no other box."""
        if box not in self.order or len(self.order) == 1:
            return None
        return replace(self, order=tuple(number for number in self.order if number != box))

    def with_sheet(self, size_mm: FloatArray, corner_mm: FloatArray, mass_kg: float, before: int) -> Draft | None:
        """The draft with a further sheet, placed before a box, and with all boxes at or above its height raised by its
        thickness."""
        if before not in self.order:
            return None
        corners = self.corner_mm.copy()
        corners[corners[:, 2] >= corner_mm[2] - TOLERANCE_MM, 2] += size_mm[2]
        order = list(self.order)
        order.insert(order.index(before), len(self.size_mm))
        return replace(
            self,
            size_mm=np.vstack([self.size_mm, size_mm]),
            corner_mm=np.vstack([corners, corner_mm]),
            turned=np.append(self.turned, False),
            order=tuple(order),
            sheet_kg=(*self.sheet_kg, mass_kg),
        )

    def as_plan(self, plan_id: str | None = None) -> Plan:
        """The draft as a plan. Without a change it equals the plan to the last bit."""
        plan, rows = self.plan, np.array(self.order)
        n_sheets = len(self.sheet_kg)
        boxes = rows[rows < plan.n_boxes]

        def column(values: Any, sheet: Any) -> Any:
            """Values of the boxes in the new order; sheets have the value ``sheet``."""
            if values is None or not len(values):
                return values
            every = [*values, *[sheet] * n_sheets]
            return tuple(every[row] for row in self.order)

        changed: dict[str, Any] = {
            "plan_id": plan.plan_id if plan_id is None else plan_id,
            "size_mm": self.size_mm[rows],
            "corner_mm": self.corner_mm[rows],
            "mass_kg": self.mass_kg[rows],
            "item_ids": column(plan.item_ids, "tie-sheet"),
            "articles": column(plan.articles, "tie-sheet"),
            "product_groups": column(plan.product_groups, ""),
            "materials": column(plan.materials, ""),
        }
        last = int(plan.sequence[boxes].max(initial=0))
        sequence = np.concatenate([plan.sequence, last + 1 + np.arange(n_sheets)])
        changed["sequence"] = sequence[rows]
        if plan.orientation is not None or self.turned.any():
            before = np.zeros(plan.n_boxes, np.int64) if plan.orientation is None else plan.orientation
            orientation = np.concatenate([before, np.zeros(n_sheets, np.int64)])
            changed["orientation"] = np.where(self.turned, 1 - orientation, orientation)[rows]
        if plan.mass_center_mm is not None:
            changed["mass_center_mm"] = self._mass_center_mm(plan.mass_center_mm)[rows]
        for name in ("stiffness_n_mm", "strength_n", "approach_deg"):
            if (values := getattr(plan, name)) is not None:
                every = np.concatenate([values, np.full(n_sheets, np.nan)])
                if name == "approach_deg":
                    every[list(self.moved)] = np.nan
                changed[name] = every[rows]
        if plan.kinds or n_sheets:
            kinds = [*(plan.kinds or [KINDS[0]] * plan.n_boxes), *[SHEET] * n_sheets]
            changed["kinds"] = tuple(kinds[row] for row in self.order)
        return replace(plan, **changed)

    def _mass_center_mm(self, mass_center_mm: FloatArray) -> FloatArray:
        """(m, 3) centres of mass. A box is turned from orientation 0 to 1 by +90°, and from 1 to 0 by −90°
        (``Plan.item_com_mm``)."""
        centre = np.vstack([mass_center_mm, np.zeros((len(self.sheet_kg), 3))])
        lies_along_y = np.append(self.plan.turned, np.zeros(len(self.sheet_kg), bool))
        sign = np.where(lies_along_y, -1.0, 1.0)
        swapped = np.column_stack([-sign * centre[:, 1], sign * centre[:, 0], centre[:, 2]])
        return np.where(self.turned[:, None], swapped, centre) + 0.0  # + 0.0 turns -0.0 into 0.0


def _closure(leads_to: BoolArray, box: int) -> list[int]:
    """Numbers that can be reached from a box, nearest first."""
    reached: dict[int, None] = {}
    front = [box]
    while front:
        front = [
            number
            for number in dict.fromkeys(np.flatnonzero(leads_to[front].any(axis=0)).tolist())
            if number not in reached and number != box
        ]
        reached.update(dict.fromkeys(front))
    return list(reached)


class Oddities(NamedTuple):
    """Faults of the layouts of c drafts with m boxes each.

    Attributes:
        overlap_mm: (c, m, m) depth by which two boxes overlap, along the axis of least depth; 0: no overlap.
        gap_mm: (c, m) height of each box above its support when it is placed.
        blocked: (c, m, m) whether the row's box is placed before the column's, above its place.
        outside_mm: (c, m) distance by which each box reaches beyond the limits of the rules.
        through_mm: (c, m) depth by which each box reaches through a wall of the carrier.
    """

    overlap_mm: FloatArray
    gap_mm: FloatArray
    blocked: BoolArray
    outside_mm: FloatArray
    through_mm: FloatArray


class Rules:
    """Limits of a changed plan.

    Args:
        plan: the plan as it was.
        sim: options of the simulation. Boxes may overhang the carrier's edges as far as boxes of the plan do.
        max_height_mm: highest top of a box; the plan's own height if that is greater.
        built: number of boxes that stand already. These boxes stay unchanged.
    """

    def __init__(self, plan: Plan, sim: Simulation, max_height_mm: float, built: int) -> None:
        low, high = plan.corner_mm.min(axis=0), (plan.corner_mm + plan.size_mm).max(axis=0)
        extent = extent_m(sim.carrier)
        if extent is not None:
            low[:2] = np.minimum(low[:2], 0.0)
            high[:2] = np.maximum(high[:2], np.array(extent) * MM_PER_M)
        self.low_mm, self.high_mm = np.minimum(low, [np.inf, np.inf, 0.0]), high
        self.high_mm[2] = max(high[2], max_height_mm)
        self.built = built
        self.plan = plan
        self._room = carrier_of(plan, sim).room if has_walls(sim) else None
        self._before = self._oddities([Draft.of(plan)])

    @property
    def height_mm(self) -> float:
        """Height of the plan."""
        return float((self.plan.corner_mm + self.plan.size_mm)[:, 2].max())

    @property
    def floating(self) -> list[int]:
        """Boxes of the plan without support at their placement."""
        return np.flatnonzero(self._before.gap_mm[0] > TOLERANCE_MM).tolist()

    @property
    def overlapping(self) -> list[int]:
        """Boxes of the plan that overlap other boxes, the later box of each pair."""
        pairs = np.argwhere(np.triu(self._before.overlap_mm[0] > TOLERANCE_MM, k=1))
        return list(dict.fromkeys(pairs[:, 1].tolist()))

    def allow(self, drafts: Sequence[Draft]) -> BoolArray:
        """(c,) which drafts are allowed."""
        allowed = np.zeros(len(drafts), bool)
        sizes: dict[int, list[int]] = {}
        for number, draft in enumerate(drafts):
            sizes.setdefault(len(draft.size_mm), []).append(number)
        for numbers in sizes.values():
            for begin in range(0, len(numbers), AT_ONCE):
                chunk = numbers[begin : begin + AT_ONCE]
                allowed[chunk] = self._allow([drafts[number] for number in chunk])
        return allowed

    def _allow(self, drafts: Sequence[Draft]) -> BoolArray:
        """``allow`` for drafts with the same number of rows."""
        now, n = self._oddities(drafts), self.plan.n_boxes
        worse = _worse(now.overlap_mm, self._before.overlap_mm, n).any(axis=(1, 2))
        worse |= _worse(now.gap_mm, self._before.gap_mm, n).any(axis=1)
        worse |= now.outside_mm.max(axis=1) > TOLERANCE_MM
        worse |= _worse(now.through_mm, self._before.through_mm, n).any(axis=1)
        worse |= (self._shifted(drafts) & (now.through_mm[:, :n] > TOLERANCE_MM)).any(axis=1)
        blocked = now.blocked.copy()
        blocked[:, :n, :n] &= ~self._before.blocked
        worse |= blocked.any(axis=(1, 2))
        allowed: BoolArray = ~worse & np.array([self._keeps_built(draft) for draft in drafts])
        return allowed

    def _shifted(self, drafts: Sequence[Draft]) -> BoolArray:
        """(c, n) whether each box of the plan is moved along x or y, or turned."""
        n = self.plan.n_boxes
        aside = np.stack([draft.corner_mm[:n, :2] for draft in drafts]) != self.plan.corner_mm[:, :2]
        turned = np.stack([draft.turned[:n] for draft in drafts])
        return np.asarray(aside.any(axis=2) | turned)

    def _keeps_built(self, draft: Draft) -> bool:
        """Whether the boxes that stand already stand as in the plan."""
        k = self.built
        return draft.order[:k] == tuple(range(k)) and bool(
            (draft.corner_mm[:k] == self.plan.corner_mm[:k]).all() and not draft.turned[:k].any()
        )

    def _oddities(self, drafts: Sequence[Draft]) -> Oddities:
        low = np.stack([draft.corner_mm for draft in drafts])
        high = low + np.stack([draft.size_mm for draft in drafts])
        rank = np.stack([draft.rank for draft in drafts])
        present = np.isfinite(rank)
        is_pair = present[:, :, None] & present[:, None, :]
        shared = [shared_length(low[..., axis], high[..., axis]) for axis in range(3)]
        depth = np.where(is_pair, np.maximum(np.minimum.reduce(shared), 0.0), 0.0)
        m = low.shape[1]
        depth[:, np.arange(m), np.arange(m)] = 0.0
        beside = is_pair & (shared[0] > TOLERANCE_MM) & (shared[1] > TOLERANCE_MM)
        beside[:, np.arange(m), np.arange(m)] = False
        earlier = rank[:, :, None] < rank[:, None, :]
        lower = low[:, :, None, 2] < low[:, None, :, 2]
        support = np.where(beside & earlier & lower, high[:, :, None, 2], 0.0).max(axis=1)
        gap = np.where(present, np.maximum(low[..., 2] - support, 0.0), 0.0)
        over = low[:, :, None, 2] > low[:, None, :, 2] + TOLERANCE_MM  # the row's box begins higher
        blocked = beside & earlier & over
        outside = np.maximum(self.low_mm - low, high - self.high_mm).max(axis=2)
        through = np.where(present, self._through_mm(low, high), 0.0)
        return Oddities(depth, gap, blocked, np.where(present, outside, 0.0), through)

    def _through_mm(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """(c, m) as in ``Oddities``, for boxes with these (c, m, 3) corners."""
        if self._room is None:
            return np.zeros(low.shape[:2])
        middle_m, half_m = (low + high) / 2 / MM_PER_M, (high - low) / 2 / MM_PER_M
        depth_mm = MM_PER_M * self._room.depths(middle_m, half_m, TOLERANCE_MM / MM_PER_M)
        return np.asarray(depth_mm.max(axis=(2, 3)))


AT_ONCE: Final = 256
"""Drafts whose layouts are compared at once: tables of 256 × 50 × 50 pairs stay in a core's cache."""


def _worse(now: FloatArray, before: FloatArray, n: int) -> BoolArray:
    """(c, …) whether a fault counts and is larger than in the plan. The first n entries along each axis are the boxes
    of the plan."""
    limit = np.full(now.shape[1:], TOLERANCE_MM)
    old = limit[tuple(slice(n) for _ in limit.shape)]
    np.maximum(old, before[0] + _ROUNDING_MM, out=old)
    return np.asarray(now > limit)
