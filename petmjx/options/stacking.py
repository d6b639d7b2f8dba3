"""How much of their strength boxes keep as they are stacked (``Stacking``): options of ``petmjx loads``.

As ``petmjx.options.simulation``: defaults, units, checks and descriptions are written only here. Users read about it,
and about the sources of the numbers, in docs/loads.md.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, within


class Stacking(CheckedRecord):
    """Shares of a box's strength that are lost as it is stacked. McKee's formula, and a press, are about a box under
    plates; on a pallet its walls bear what stands on them. 0 switches a loss off.

    The defaults of ``interlocked_loss`` and ``gap_loss`` are those of packaging sources. Of walls over nothing none
    gives a number: they bear nothing.
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
