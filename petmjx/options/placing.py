"""The options of the placement of boxes (``Placing``): the pose at which a box starts, and its path to its place.

Defaults, units, checks and descriptions are defined only here. docs/rules.md, section 4, has the exact rules, step by
step; docs/placing.md explains the options to users.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import Field, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, within


class Way(StrEnum):
    """The way in which a box gets to its place. The option ``Placing.name`` describes each way."""

    AUTO = "auto"
    EXACT = "exact"
    DROP = "drop"
    HAND = "hand"
    TINES = "tines"


class Placing(CheckedRecord):
    """How boxes are placed. A ``Placing`` can be made from the name of a ``Way`` ("hand"), or from a mapping
    (``{"name": "hand", "force_n": 50}``).

    The defaults of the options are assumptions. No publication was found that states where a robot's last movement
    starts, its speed, or the largest force with which the robot may press.
    """

    name: Annotated[Way, CliFlag("--placing")] = Field(
        Way.AUTO,
        description="how a box is placed: exact: it appears at its place, at rest; drop: it falls from a height; "
        "hand: a robot carries it with limited force, and lets it go where it can move no further; tines: as hand, "
        "but the box is let go with one bottom edge down and the opposite edge still up; auto: hand if places or "
        "sizes have errors, else exact",
    )
    height_mm: Annotated[float, within(0, 2000), CliFlag("--placing-height-mm", "MM")] = Field(
        5.0, description="with placing=drop, hand or tines: a box starts at this height above its place, mm"
    )
    side_mm: Annotated[float, within(0, 1000), CliFlag("--placing-side-mm", "MM")] = Field(
        5.0,
        description="with placing=hand or tines: a box starts at this horizontal distance from its place, against its "
        "direction of approach, mm; if another box is in the way, the start moves sideways by at most twice this "
        "distance",
    )
    speed_m_s: Annotated[float, within(0.001, 10), CliFlag("--placing-speed", "M/S")] = Field(
        0.08,
        description="with placing=hand or tines: largest speed of a carried box, m/s; exception: if a box would need "
        "more than 2 s for its path, it moves faster",
    )
    force_n: Annotated[float, within(0.1, 100_000), CliFlag("--placing-force-n", "N")] = Field(
        100.0,
        description="with placing=hand or tines: largest force with which the robot presses a carried box, in addition "
        "to the force that holds the box's weight, N",
    )
    tines_mm: Annotated[float, within(0, 1000), CliFlag("--tines-height-mm", "MM")] = Field(
        10.0,
        description="with placing=tines: height of the edge that comes down last when the box is released, mm; the box "
        "is tilted by at most half of thresholds.tilt_deg",
    )

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, values: Any) -> Any:
        return values if isinstance(values, Mapping | Placing) else {"name": values}

    @property
    def appears(self) -> bool:
        """Whether boxes without placement errors appear at their places, instead of being moved there."""
        return self.name in (Way.AUTO, Way.EXACT)

    @property
    def for_errors(self) -> Placing:
        """These options as they apply to boxes whose places or sizes have errors: ``auto`` becomes ``hand``."""
        return self.model_copy(update={"name": Way.HAND}) if self.name is Way.AUTO else self

    @property
    def carries(self) -> bool:
        """Whether a hand or tines carry boxes to their places."""
        return self.name in (Way.HAND, Way.TINES)


EXACT: Final = Placing(name=Way.EXACT)
"""Options of placement with which all boxes appear at their places, without being moved there."""
