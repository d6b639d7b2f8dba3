"""The options of ``petmjx loads`` (``Stacking``): how much of their strength boxes lose by the way in which they are
stacked, by moist air and over time.

Defaults, units, checks and descriptions are defined only here. docs/loads.md explains the options to users, and has the
sources of the numbers.
"""

from __future__ import annotations

from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, CliFlag, within

HUMIDITY_LOSS: Final = ((50, 0.0), (60, 0.10), (70, 0.20), (80, 0.32), (90, 0.52), (100, 0.85))
"""Relative humidity, % → share of its strength that a box of corrugated board loses. Source: a table of the Fibre Box
Association, as reproduced by a maker of boxes (http://www.richbox.com/about_boxes/target_compression.asp)."""

TIME_LOSS: Final = ((10.0, 0.37), (30.0, 0.40), (90.0, 0.45), (180.0, 0.50))
"""Number of days under a load → share of its strength that a box loses. Source: the table of ``HUMIDITY_LOSS``."""

PRESS_DAYS: Final = 1.0 / 1440
"""Time for which a box in a press bears its load: one minute, given in days. In this time, the box loses no strength.
From one minute to ten days, the loss is assumed to grow with the logarithm of time, as creep does."""


class Stacking(CheckedRecord):
    """The shares of a box's strength that the box loses by the way in which it is stacked, by moist air and over time.
    A share of 0 turns a loss off.

    McKee's formula and tests in a press give the strength of a box between two flat plates. On a pallet, the loads on a
    box's walls depend on the boxes above and below.

    The defaults of ``interlocked_loss`` and ``gap_loss`` come from packaging literature. A part of a wall with nothing
    below it is assumed to bear no load, because no source states how much load such a part bears.
    """

    interlocked_loss: Annotated[float, within(0, 1), CliFlag("--interlocked-loss", "SHARE")] = Field(
        0.5,
        description="share of its strength that a box loses if no wall of the boxes above stands on the box's own "
        "walls; if only some walls of the boxes above do, the loss is smaller",
    )
    overhang_loss: Annotated[float, within(0, 1), CliFlag("--overhang-loss", "SHARE")] = Field(
        1.0,
        description="share of its strength that a box would lose if all of its walls hung over nothing; the actual "
        "loss is this share times the part of the walls that hangs over nothing",
    )
    gap_loss: Annotated[float, within(0, 1), CliFlag("--gap-loss", "SHARE")] = Field(
        0.26,
        description="share of its strength that a box on the deck loses if some of its walls cross gaps between boards",
    )
    soft_deck_loss: Annotated[float, within(0, 1), CliFlag("--soft-deck-loss", "SHARE")] = Field(
        0.0,
        description="share of their strength that boxes on the deck lose because boards bend: 0 for stiff boards, "
        "0.21 to 0.27 for soft boards",
    )
    wall_tolerance_mm: Annotated[float, within(0, 1000), CliFlag("--wall-tolerance-mm", "MM")] = Field(
        10.0, description="a wall stands on another wall, or on an edge below it, if their distance is at most this, mm"
    )
    humidity_percent: Annotated[float, within(0, 100), CliFlag("--humidity", "PERCENT")] = Field(
        50.0,
        description="relative humidity of the air, %; above 50 %, boxes lose strength against both the force at rest "
        "and the largest force",
    )
    storage_days: Annotated[float, within(0, 180), CliFlag("--storage-days", "DAYS")] = Field(
        0.0,
        description="number of days for which boxes are loaded, which reduces their strength against forces at rest; "
        "0: boxes are loaded as briefly as in a press",
    )
    loss_spread: Annotated[float, within(0, 1), CliFlag("--loss-spread", "SHARE")] = Field(
        0.2,
        description="how far the true value of each loss may differ from the given value, as a share of the given "
        "value; it decides which boxes are surely overloaded, and which only possibly",
    )

    def with_losses(self, factor: float) -> Self:
        """A copy of these options in which each loss by stacking is multiplied by ``factor``, up to a loss of 1."""
        names = ("interlocked_loss", "overhang_loss", "gap_loss", "soft_deck_loss")
        return self.changed(**{name: min(factor * getattr(self, name), 1.0) for name in names})

    @property
    def humidity_loss(self) -> float:
        """The share of its strength that a box loses because the air is moist."""
        percent, losses = np.array(HUMIDITY_LOSS).T
        return float(np.interp(self.humidity_percent, percent, losses))

    @property
    def time_loss(self) -> float:
        """The share of its strength that a box loses over time under load."""
        days, losses = np.array([(PRESS_DAYS, 0.0), *TIME_LOSS]).T
        return float(np.interp(np.log(max(self.storage_days, PRESS_DAYS)), np.log(days), losses))
