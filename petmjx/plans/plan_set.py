"""Sets of plans (``PlanSet``), with the skipped entries and the warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from petmjx.common.argument_checks import instance_of, list_of
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import PlanWarnings

if TYPE_CHECKING:
    import pandas as pd

    from petmjx.plans.readings import Reading


@dataclass(frozen=True, slots=True)
class Skipped:
    """A skipped plan, or another skipped part of the input. ``message`` is the whole line, with the file and the plan.

    ``plan_id`` is None if the entry concerns a whole file, or damage between plans. ``number`` is the plan's number in
    the input, from 0.
    """

    source: str
    plan_id: str | None
    message: str
    number: int | None = None

    @classmethod
    def plan(cls, plan: Plan, why: str, strict: bool) -> Skipped:
        """Make the entry for a plan that was read but cannot be simulated.

        Args:
            why: the part of the message after the plan's id, such as ": repeated plan id".

        Raises:
            InputError: ``strict`` is set.
        """
        message = f"{plan.source}: plan {printable_name(plan.plan_id)}{why}"
        if strict:
            raise InputError(message)
        return cls(plan.source, plan.plan_id, message)

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True, repr=False)
class PlanSet:
    """The result of `load_plans`: plans in the order of the files, skipped entries, and warnings.

    Attributes:
        plans: the good plans.
        skipped: an entry for each skipped plan, damaged part or unusable file.
        warnings: an entry for each plan of ``plans`` in which a box overlaps another, is outside the carrier, or
            floats.
        notes: lines about the whole input, such as ignored fields.
        conventions: a line for each file of another tool, and for each other convention that plans appear to follow.
        readings: name of a file of another tool → how it was read.
        numbers: plan id → number of the plan in the input, from 0, counting skipped plans; empty: the plans are
            numbered as in ``plans``.
    """

    plans: list[Plan] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[PlanWarnings] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    conventions: list[str] = field(default_factory=list)
    readings: dict[str, Reading] = field(default_factory=dict)
    numbers: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the type. Raises InputError if ``plans`` is not a list of plans."""
        if not isinstance(self.plans, list) or not all(type(plan) is Plan for plan in self.plans):
            object.__setattr__(self, "plans", list_of(self.plans, "plans", Plan, "Plan objects"))
        for name in ("skipped", "warnings", "notes", "conventions"):
            instance_of(getattr(self, name), name, list, "a list")

    def __len__(self) -> int:
        return len(self.plans)

    def __iter__(self) -> Iterator[Plan]:
        return iter(self.plans)

    def to_frame(self) -> pd.DataFrame:
        """The plans as a table with one row per placement, which ``petmjx.score`` accepts.

        Raises:
            ValueError: there is no plan.
        """
        from petmjx.plans.plan_writer import plans_table  # this import loads Arrow

        if not self.plans:
            raise ValueError("there is no plan")
        frame: pd.DataFrame = plans_table(self.plans).to_pandas()
        return frame

    def __repr__(self) -> str:
        plans = count_text(len(self.plans), "plan")
        return f"PlanSet({plans}, {len(self.skipped):,} skipped, {len(self.warnings):,} odd)"
