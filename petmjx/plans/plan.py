"""A packing plan in memory, and a set of them with what was skipped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from petmjx.errors import InputError
from petmjx.plans.warnings import PlanWarnings
from petmjx.text import counted, shown


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Plan:
    """One packing plan. Rows are placements in packing order, counted from 0; lengths are millimetres.

    Attributes:
        plan_id: the plan's key in its file.
        source: the file it came from, for messages.
        size_mm: (n, 3) box extents along x, y, z as they stand, orientation applied.
        corner_mm: (n, 3) front-left-bottom corners; z = 0 is the top of the carrier.
        mass_kg: (n,).
        item_ids, articles: n names each.
        sequence: (n,) number of each item in the customer's order.
    """

    plan_id: str
    source: str
    size_mm: NDArray[np.float64]
    corner_mm: NDArray[np.float64]
    mass_kg: NDArray[np.float64]
    item_ids: tuple[str, ...]
    articles: tuple[str, ...]
    sequence: NDArray[np.int64]

    @property
    def n_boxes(self) -> int:
        return len(self.mass_kg)

    def __repr__(self) -> str:
        return f"Plan({shown(self.plan_id)!r}, {counted(self.n_boxes, 'box', 'boxes')})"


@dataclass(frozen=True, slots=True)
class Skipped:
    """Something that was not used. ``message`` is the whole line, with file and plan.

    ``plan_id`` is None if it is not about one plan (a file, or damage between plans).
    """

    source: str
    plan_id: str | None
    message: str

    @classmethod
    def plan(cls, plan: Plan, why: str, strict: bool) -> Skipped:
        """A plan that was read but cannot be simulated.

        Args:
            why: goes on after the plan's id, as in ": repeated plan id".

        Raises:
            InputError: with ``strict``.
        """
        message = f"{plan.source}: plan {shown(plan.plan_id)}{why}"
        if strict:
            raise InputError(message)
        return cls(plan.source, plan.plan_id, message)

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True, repr=False)
class PlanSet:
    """What `load_plans` found: plans in the order of the files, what was skipped, and warnings.

    ``warnings`` holds an entry for each plan of ``plans`` with an overlap, a box outside or a floating box.
    """

    plans: list[Plan] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[PlanWarnings] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.plans)

    def __iter__(self) -> Iterator[Plan]:
        return iter(self.plans)

    def __repr__(self) -> str:
        plans = counted(len(self.plans), "plan")
        return f"PlanSet({plans}, {len(self.skipped):,} skipped, {len(self.warnings):,} odd)"
