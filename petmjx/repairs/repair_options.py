"""Options of a repair (``RepairOptions``): allowed changes, requirements, and limits of the search.

Defaults, units, checks and descriptions are written only here. docs/repair.md explains them to users.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, complaint, shown_value, within
from petmjx.repairs.changes import Kind

LEAST_WORLDS: Final = 4
MOST_WORLDS: Final = 100_000
"""Smallest and largest number of worlds with errors, the same as in ``petmjx.options.confidence.Confidence``."""

KINDS: Final = ", ".join(Kind)


def _split(value: Any) -> Any:
    """Split a text of names with commas, as the command line passes it."""
    return tuple(name.strip() for name in value.split(",") if name.strip()) if isinstance(value, str) else value


def _kinds(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in tuple(Kind):
            raise ValueError(f"must be one of {KINDS}, {shown_value(name)}")
    if len(set(names)) == len(Kind):
        raise ValueError("forbids every change: nothing is left to repair with")
    return names


def _worlds(value: int) -> int:
    if value != 0 and not LEAST_WORLDS <= value <= MOST_WORLDS:
        raise ValueError(f"must be 0, or from {LEAST_WORLDS} to {MOST_WORLDS:,}, {shown_value(value)}")
    return value


class RepairOptions(CheckedRecord):
    """Options of a repair."""

    forbid: Annotated[
        tuple[str, ...], BeforeValidator(_split), AfterValidator(_kinds), CliFlag("--without", "KIND,…")
    ] = Field((), description=f"changes that must not be made: {KINDS}")
    built: Annotated[int, within(0, 100_000), CliFlag("--built", "N")] = Field(
        0,
        description="number of boxes at the beginning of each plan that already stand, so that the repair does not "
        "change them",
    )
    most_move_mm: Annotated[float, within(1, 10_000), CliFlag("--most-move-mm", "MM")] = Field(
        150.0, description="largest distance by which a box is moved along x or y, mm"
    )
    max_height_mm: Annotated[float, within(0, 100_000), CliFlag("--max-height-mm", "MM")] = Field(
        2000.0,
        description="largest height that the top of a moved box may reach, mm; a plan that is higher may keep its own "
        "height",
    )
    most_changes: Annotated[int, within(1, 100), CliFlag("--most-changes", "N")] = Field(
        60, description="largest number of changes; boxes that are left out do not count"
    )
    trials: Annotated[int, within(1, 1_000_000), CliFlag("--trials", "N")] = Field(
        600,
        description="largest number of simulations of changed plans, for each plan. With a profile, a sixth of this "
        "number is allowed, but at least one simulation. If boxes must be left out, half of this number is added",
    )
    seconds: Annotated[float | None, within(0.1, 10_000_000), CliFlag("--seconds", "S", default="no limit")] = Field(
        None,
        description="time for the repairs of all plans, s, without the start of the engine; if worlds with errors are "
        "simulated, the search gets 70 % of this time. When the time is up, the results are the best repairs so "
        "far, and the results say so. Without a limit, results depend only on plans and options",
    )
    worlds: Annotated[int, AfterValidator(_worlds), CliFlag("--worlds", "N")] = Field(
        8,
        description="number of worlds with errors of placement, size, mass and friction in which the plan and its "
        "repair are simulated, at least 4; 0: none",
    )
    share: Annotated[float, within(0, 1), CliFlag("--share", "SHARE")] = Field(
        0.75,
        description="share of worlds with errors in which a repaired plan shall stand; without a profile, the repair "
        "makes further changes to reach this share; 0: no further changes",
    )
    sheet_mm: Annotated[float, within(0.1, 100), CliFlag("--sheet-mm", "MM")] = Field(
        3.0, description="thickness of a tie sheet, mm"
    )
    sheet_kg_m2: Annotated[float, within(0.01, 100)] = Field(
        0.5, description="mass of a tie sheet per area, kg/m²; single-wall board has about 0.5"
    )
    profile: Annotated[str | None, CliFlag("--profile", "NAME", default="at rest")] = Field(
        None,
        description="profile that the pallet must survive, such as eumos-40509; by default the pallet must only stand "
        "at rest",
    )
    level: Annotated[float, within(0, 1000), CliFlag("--level", "LEVEL")] = Field(
        1.0, gt=0, description="strength of the profile: a level in g, or a factor (scale), as the profile requires"
    )
    direction_deg: Annotated[float, within(-360, 360), CliFlag("--direction", "DEG")] = Field(
        0.0, description="angle by which the profile is turned from +x towards +y, degrees"
    )
    most_turns: Annotated[int, within(1, 1000), CliFlag("--most-turns", "N")] = Field(
        12, description="largest number of turns of film, if the pallet must survive a profile"
    )

    @model_validator(mode="after")
    def _strength_of_something(self) -> Self:
        for name in ("level", "direction_deg", "most_turns"):
            if self.profile is None and name in self.model_fields_set:
                raise complaint("needs a profile: at rest nothing shakes the pallet", name)
        return self

    @model_validator(mode="after")
    def _share_of_something(self) -> Self:
        if not self.worlds and "share" in self.model_fields_set and self.share > 0:
            raise complaint("needs worlds > 0: without worlds with errors there is no share", "share")
        return self

    @property
    def kinds(self) -> frozenset[Kind]:
        """The kinds of changes that may be made. Film is not among the kinds if plans need only stand at rest: at rest,
        film holds nothing."""
        kinds = {kind for kind in Kind if kind not in self.forbid}
        return frozenset(kinds - ({Kind.FILM} if self.profile is None else set()))
