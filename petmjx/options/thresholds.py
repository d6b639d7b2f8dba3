"""The thresholds of verdicts (``Thresholds``): shift, tilt, drop, and the accelerations of explosions.

Defaults, units, checks and descriptions are defined only here.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, CliFlag, within


class Thresholds(CheckedRecord):
    """The thresholds above which a plan counts as unstable, or a simulation as invalid (PET-Physics paper, section
    IV-C)."""

    shift_m: Annotated[float, within(0, 100), CliFlag("--shift-limit-m", "M")] = Field(
        0.02,
        gt=0,
        description="a plan is unstable if the final place of a box differs from its planned place by more than this "
        "along x, y or z, m",
    )
    shift_floor_m: Annotated[float, within(0, 100)] = Field(
        0.001, ge=0, description="components of a shift that are smaller than this count as 0, m"
    )
    tilt_deg: Annotated[float, within(0, 360), CliFlag("--tilt-limit-deg", "DEG")] = Field(
        20.0,
        gt=0,
        description="a plan is unstable if the angle between a box's z axis and the world's z axis exceeds this, "
        "degrees",
    )
    drop_hull_z_m: Annotated[float, within(-100, 100)] = Field(
        -0.1, description="a box has dropped if a part of it is lower than this z, m; the carrier's top is at z = 0"
    )
    lin_acc_m_s2: Annotated[float, within(0, 1e9)] = Field(
        110.0,
        gt=0,
        description="the simulation may have exploded if the linear acceleration of a box exceeds this before any box "
        "has failed, m/s²",
    )
    ang_acc_rad_s2: Annotated[float, within(0, 1e9)] = Field(
        110.0,
        gt=0,
        description="the simulation may have exploded if the angular acceleration of a box exceeds this before any box "
        "has failed, rad/s²",
    )
