"""Compares columns of boxes that give with beds of springs: which columns stand, and how far they lean.

The bed's answer is computed here, without petmjx: a chain of rigid boxes with a bed of springs (Winkler 1867) between
each two, in which a face that lifts off does not pull. Heights are computed to the second order of the leans. The
energy

    E = Σᵢ mᵢ·g·zᵢ + ½ Σⱼ κⱼ ∫ max(δⱼ + (θⱼ − θⱼ₋₁)·u, 0)² du

of depths δ and leans θ, with κ the beds' stiffness per area, has a minimum where the column stands. The bed has a
solution up to a multiple of gravity: below 1 the column buckles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import petmjx
from petmjx.runs.option_types import EngineName

GRAVITY: Final = 9.81
GRID: Final = 40
"""Number of springs along each side of a face, in the bed that is computed here."""
MOST_MULTIPLE: Final = 4.0
MULTIPLE_STEP: Final = 0.2
CLEAR: Final = 0.05
"""Columns whose multiple of gravity is nearer to 1 than this value are not compared."""
LEAST_LEAN_RAD: Final = 1e-3
"""Smallest lean that is compared, rad. The carrier itself leans on the floor by some tenths of this angle."""
SHIFT_M: Final = 0.2
"""Threshold of the shift, m. The threshold is large, so that a column that leans and stands does not count as failed. A
column that buckles tilts by more than 20°."""
MIDDLE_MM: Final = np.array([600.0, 400.0])
RIGID_N_MM: Final = 1e5
"""Stiffness, N/mm, that stands for rigid boxes in the bed, so that rigid boxes can lie on one another."""
CARRIER_HALF_MM: Final = np.array([600.0, 400.0])

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """A column of n boxes on a Euro pallet. Boxes are listed from the lowest up.

    Attributes:
        size_mm: (n, 3).
        middle_mm: (n, 2) middle of each box along x and y.
        mass_kg: (n,).
        stiffness_n_mm: (n,) stiffness of each box; infinite for rigid boxes.
    """

    size_mm: Array
    middle_mm: Array
    mass_kg: Array
    stiffness_n_mm: Array

    def plan(self, name: str) -> petmjx.Plan:
        """The column as a plan."""
        bottom = np.concatenate([[0.0], np.cumsum(self.size_mm[:-1, 2])])
        low = self.middle_mm - self.size_mm[:, :2] / 2
        rows = []
        for size, (x, y), z, mass, stiffness in zip(
            self.size_mm.tolist(), low.tolist(), bottom.tolist(), self.mass_kg, self.stiffness_n_mm, strict=True
        ):
            row = {"length_mm": size[0], "width_mm": size[1], "height_mm": size[2], "weight_kg": float(mass)}
            row |= {"x_mm": x, "y_mm": y, "z_mm": z}
            rows.append(row | ({"stiffness_n_mm": float(stiffness)} if np.isfinite(stiffness) else {}))
        return petmjx.Plan.from_boxes(name, rows)


class Answer(NamedTuple):
    """The bed's result for a column.

    Attributes:
        multiple: multiple of gravity up to which the column stands. If it is below 1, the column buckles.
        lean_rad: (n, 2) lean of each box towards x and y; NaN if the column buckles.
        shift_mm: (n, 2) shift of the middle of each box along x and y.
    """

    multiple: float
    lean_rad: Array
    shift_mm: Array


class _Chain:
    """The energy of a column. Unknown are the depth and both leans of each box, in SI units."""

    def __init__(self, column: Column) -> None:
        half, middle = column.size_mm / 2e3, column.middle_mm / 1e3
        stiffness = np.minimum(column.stiffness_n_mm, RIGID_N_MM) * 1e3
        give = np.append(0.0, 2 * half[:, 0] * half[:, 1] / stiffness)
        low = np.vstack([(MIDDLE_MM - CARRIER_HALF_MM) / 1e3, middle - half[:, :2]])
        high = np.vstack([(MIDDLE_MM + CARRIER_HALF_MM) / 1e3, middle + half[:, :2]])
        low, high = np.maximum(low[1:], low[:-1]), np.minimum(high[1:], high[:-1])
        self.count, self.mass, self.height = len(column.mass_kg), column.mass_kg, 2 * half[:, 2]
        self.stiffness = 1 / (give[1:] + give[:-1])
        self.hinge = (low + high) / 2
        self.to_center = middle - self.hinge
        self.to_next = np.vstack([self.hinge[1:] - self.hinge[:-1], np.zeros(2)])
        side = (np.arange(GRID) + 0.5) / GRID - 0.5
        across = high - low
        grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        self.springs = across[:, None] * grid[None]
        self.area = across.prod(axis=1) / GRID**2
        self.load = np.cumsum(self.mass[::-1])[::-1] * GRAVITY
        self.above = np.append(self.load[1:], 0.0)

    def slopes(self, x: Array, multiple: float) -> tuple[Array, Array]:
        """Gradient and Hessian of the energy."""
        n = self.count
        depth, lean = x[:n], x[n:].reshape(n, 2)
        gradient, hessian = np.zeros(3 * n), np.zeros((3 * n, 3 * n))
        gradient[:n] = -multiple * self.load
        weight = self.mass * GRAVITY
        levers = weight[:, None] * self.to_center + self.above[:, None] * self.to_next
        heights = weight * self.height / 2 + self.above * self.height
        gradient[n:] = -multiple * (levers + heights[:, None] * lean).ravel()
        hessian[np.arange(n, 3 * n), np.arange(n, 3 * n)] = -multiple * np.repeat(heights, 2)
        turned = np.diff(np.vstack([np.zeros(2), lean]), axis=0)
        for j in range(n):
            d = depth[j] + self.springs[j] @ turned[j]
            on = d > 0
            k = self.stiffness[j] * self.area[j]
            u = self.springs[j][on]
            rows = np.column_stack([np.ones(len(u)), u])
            force, stiff = k * rows.T @ d[on], k * rows.T @ rows
            take = np.zeros((3, 3 * n))
            take[0, j] = 1.0
            for axis in range(2):
                take[1 + axis, n + 2 * j + axis] = 1.0
                if j:
                    take[1 + axis, n + 2 * (j - 1) + axis] = -1.0
            gradient += take.T @ force
            hessian += take.T @ stiff @ take
        return gradient, hessian

    def rest(self, x: Array, multiple: float) -> Array | None:
        """The state near x in which the column stands; None if there is no such state."""
        for _ in range(60):
            gradient, hessian = self.slopes(x, multiple)
            try:
                np.linalg.cholesky(hessian)
            except np.linalg.LinAlgError:
                return None
            step = np.linalg.solve(hessian, -gradient)
            x = x + step * min(1.0, 0.02 / max(np.abs(step[self.count :]).max(), 1e-12))
            if np.abs(step).max() < 1e-10:
                return x
        return None

    def start(self) -> Array:
        """The state with which the search begins: all boxes are level, and each sinks as deep as its load presses
        it."""
        total = self.stiffness * self.area * GRID**2
        return np.concatenate([self.load / total, np.zeros(2 * self.count)])

    def moved_m(self, x: Array) -> Array:
        """(n, 2) distances by which the tops of the boxes have moved."""
        moved: Array = np.cumsum(self.height[:, None] * x[self.count :].reshape(-1, 2), axis=0)
        return moved


def bed_answer(column: Column) -> Answer:
    """The result of the bed of springs for a column whose boxes stand from the beginning."""
    chain = _Chain(column)
    least = min(MOST_MULTIPLE, _most(chain))
    rest = _at(chain, 1.0)
    if rest is None:
        nowhere = np.full((chain.count, 2), np.nan)
        return Answer(least, nowhere, nowhere)
    lean = rest[chain.count :].reshape(-1, 2)
    return Answer(least, lean, (chain.moved_m(rest) - chain.height[:, None] / 2 * lean) * 1e3)


def _at(chain: _Chain, multiple: float) -> Array | None:
    x: Array | None = chain.start() * 0.1
    for part in np.linspace(0.1, 1.0, 10):
        assert x is not None
        x = chain.rest(x, part * multiple)
        if x is None:
            return None
    return x


def _most(chain: _Chain) -> float:
    """The multiple of gravity up to which a column stands."""
    x, reached = chain.start() * MULTIPLE_STEP, 0.0
    step = MULTIPLE_STEP
    while reached < MOST_MULTIPLE and step > 1e-4:
        following = chain.rest(x, reached + step)
        if following is None:
            step /= 2
        else:
            x, reached = following, reached + step
    return reached


def drawn(count: int, seed: int) -> list[Column]:
    """Columns of 1 to 5 boxes of 30 to 200 N/mm, each up to 30 mm aside, under a rigid load near the one that buckles
    them."""
    rng = np.random.default_rng(seed)
    columns: list[Column] = []
    while len(columns) < count:
        n = int(rng.integers(1, 6))
        size = np.tile(np.append(rng.uniform(200.0, 400.0, 2), 0.0), (n + 1, 1)).round()
        size[:, 2] = rng.uniform(120.0, 300.0, n + 1).round()
        middle = MIDDLE_MM + rng.uniform(-1, 1, (n + 1, 2)) * rng.choice([5.0, 15.0, 30.0])
        mass = np.append(rng.uniform(2.0, 12.0, n), 10.0).round(1)
        column = Column(size, middle.round(), mass, np.append(rng.uniform(30.0, 200.0, n), np.inf).round(1))
        aim = rng.uniform(0.6, 2.0)
        for _ in range(4):
            multiple = bed_answer(column).multiple
            mass[-1] = np.clip((mass.sum() * multiple / aim) - mass[:-1].sum(), 2.0, 150.0).round(1)
        columns.append(column)
    return columns


def compared(engine: EngineName, count: int = 40, seed: int = 55, threads: int = 1) -> list[dict[str, Any]]:
    """Yield a line for each column: the result of the bed of springs, and petmjx's result in the static check."""
    columns = drawn(count, seed)
    results = petmjx.score(
        [column.plan(f"column-{number}") for number, column in enumerate(columns)],
        engine=engine,
        threads=threads,
        carrier="euro-pallet",
        check="static",
        thresholds={"shift_m": SHIFT_M},
    )
    lines: list[dict[str, Any]] = []
    first = 0
    for number, column in enumerate(columns):
        answer, world = bed_answer(column), results.worlds.iloc[number]
        n = len(column.mass_kg)
        boxes = results.boxes.iloc[first : first + n]
        first += n
        lean = np.hypot(*answer.lean_rad.T)
        most = int(np.nan_to_num(lean).argmax())
        tilt = 2 * np.arcsin(np.hypot(boxes.quat_x, boxes.quat_y)).to_numpy()
        lines.append(
            {
                "column": number,
                "engine": str(world.engine),
                "boxes": n - 1,
                "multiple": answer.multiple,
                "clear": abs(answer.multiple - 1.0) > CLEAR,
                "stands": answer.multiple > 1.0,
                "petmjx stands": world.verdict == "stable",
                "lean_deg": float(np.degrees(lean[most])),
                "petmjx lean_deg": float(np.degrees(tilt[most])),
                "compares": answer.multiple > 1.0 + CLEAR and bool(lean[most] > LEAST_LEAN_RAD),
                "steps": int(world.n_steps),
            }
        )
    return lines


MOST_MISS: Final = 0.1
"""Largest accepted difference of a column's lean from the lean of its bed, as a share of the lean."""


def rows(engine: EngineName = "mujoco", count: int = 40, seed: int = 55) -> list[dict[str, Any]]:
    """Rows of the gallery: quantity, source, measured, petmjx, miss (0: the goal is reached), engine."""
    lines = compared(engine, count, seed)
    clear = [line for line in lines if line["clear"]]
    other = sum(line["stands"] != line["petmjx stands"] for line in clear)
    errors = [
        abs(line["petmjx lean_deg"] / line["lean_deg"] - 1.0)
        for line in lines
        if line["compares"] and line["petmjx stands"]
    ]
    largest = max(errors, default=0.0)
    fields = {"source": "bed of springs (Winkler 1867)", "engine": engine}
    return [
        {
            "quantity": f"number of columns that stand or fall as on a bed of springs (of {len(clear)} columns "
            "that are at least 5 % from buckling)",
            "measured": str(len(clear)),
            "petmjx": str(len(clear) - other),
            "miss": other,
            **fields,
        },
        {
            "quantity": f"largest error of the leaning angle of {len(errors)} columns that stand",
            "measured": f"at most {MOST_MISS:.0%}",
            "petmjx": f"{largest:.1%}",
            "miss": round(max(largest - MOST_MISS, 0.0), 3),
            **fields,
        },
    ]
