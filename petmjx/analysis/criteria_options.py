"""The options of ``petmjx.criteria``, as a record that checks their values."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from petmjx.analysis.criteria import Criterion, chosen_criteria
from petmjx.common.checked_records import CheckedRecord, CliFlag, within
from petmjx.options.carriers import AnyCarrier, Carrier
from petmjx.options.physics import PHYSICS
from petmjx.options.walls import Walls
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM


class CriteriaOptions(CheckedRecord):
    """The options of ``petmjx.criteria``: properties of the load and the carrier, and parameters of the comparison with
    a run."""

    friction: Annotated[float, within(0, 10), CliFlag("--friction", "MU")] = Field(
        PHYSICS["pallet"].box_friction[0], description="coefficient of friction where boxes lie, for force balance"
    )
    side_friction: Annotated[float, within(0, 10), CliFlag("--side-friction", "MU")] = Field(
        0.0, description="coefficient of friction where boxes touch side by side, for force balance with leaning"
    )
    tolerance_mm: Annotated[float, within(0, 100), CliFlag("--tolerance-mm", "MM")] = Field(
        DEFAULT_TOLERANCE_MM, description="gaps and overlaps up to this count as touching, mm"
    )
    carrier: Annotated[AnyCarrier, CliFlag("--carrier", "NAME|FILE", default="that of the run, or footprint")] = Field(
        Carrier.FOOTPRINT,
        description="what the boxes stand on, as for petmjx score, and by default that of the run: boards bear, gaps "
        "do not; one without boards reaches under all boxes",
    )
    walls: Walls = Field(Walls(), description="walls around the carrier's top, by default those of the run")
    only: tuple[str, ...] | None = Field(None, description="names of criteria; by default all")
    processes: Annotated[int, within(1, 1024)] = Field(1, description="processes that share the plans")
    p_arrives: Annotated[float, within(0, 1), CliFlag("--p-arrives", "P")] = Field(
        0.5,
        description="of a run of a chain: a plan counts as standing if at least this share of its worlds arrives",
    )
    seed: Annotated[int, within(0, 2**63 - 1), CliFlag("--seed", "SEED")] = Field(
        0, description="of the halves of the plans and of the bootstrap"
    )

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The criteria to evaluate."""
        return chosen_criteria(self.only)

    @model_validator(mode="after")
    def _names_criteria(self) -> Self:
        chosen_criteria(self.only)
        return self
