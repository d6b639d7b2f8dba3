"""Options of ``petmjx loads`` (``Stacking``): how much of their strength boxes lose by the way they are stacked.

Defaults, units, checks and descriptions are written only here. docs/loads.md explains them to users, and has the
sources of the numbers.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, within


class Stacking(CheckedRecord):
    """Shares of a box's strength that are lost by the way it is stacked. 0 switches a loss off.

    McKee's formula and a press give the strength of a box between plates. On a pallet the walls of the box bear the
    boxes above.

    The defaults of ``interlocked_loss`` and ``gap_loss`` are those of packaging sources. No source has a number for
    walls that stand over nothing: they bear nothing.
    """

    interlocked_loss: Annotated[float, within(0, 1)] = Field(
        0.5, description="share that a box loses if no wall of the boxes on it stands on its own walls; less as more do"
    )
    overhang_loss: Annotated[float, within(0, 1)] = Field(
        1.0, description="share that a box would lose if all of its walls hung over nothing; in proportion to those"
    )
    gap_loss: Annotated[float, within(0, 1)] = Field(
        0.26, description="share that a box on the deck loses if walls of it cross gaps between boards"
    )
    soft_deck_loss: Annotated[float, within(0, 1)] = Field(
        0.0, description="share that boxes on the deck lose by boards that bend; stiff ones: 0, soft ones 0.21 to 0.27"
    )
    wall_tolerance_mm: Annotated[float, within(0, 1000)] = Field(
        10.0, description="walls stand on each other, and on edges of what is below, if no further apart, mm"
    )
