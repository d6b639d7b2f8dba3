"""The options of the stretch film around a finished pallet (``Wrap``): how much film there is, and how strongly it
pulls.

Defaults, units, checks and descriptions are defined only here. docs/wrap.md explains the options to users.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, CliFlag, within


class Wrap(CheckedRecord):
    """The film that is wound around a pallet before the pallet is shaken.

    The force of the film is proportional to the number of turns (Sensors 2025, 25(22), 6883). The defaults of the
    forces and of the friction are assumptions, so measure your own film.
    """

    turns: Annotated[float, within(0, 1000), CliFlag("--wrap-turns", "N")] = Field(
        0.0,
        description="number of turns of stretch film around each part of the pallet's height while the pallet is "
        "shaken; 0: no film",
    )
    force_n: Annotated[float, within(0, 10_000), CliFlag("--wrap-force-n", "N")] = Field(
        50.0, description="tension of one turn of film over its whole width, N"
    )
    film_mm: Annotated[float, within(10, 5000)] = Field(500.0, description="width of the film, mm")
    friction: Annotated[float, within(0, 10)] = Field(0.3, description="friction between film and boxes")
    hat_n: Annotated[float, within(0, 100_000), CliFlag("--wrap-hat-n", "N")] = Field(
        0.0, description="total force with which a hat (a cover over the top) presses down on a wrapped pallet, N"
    )

    @property
    def holds(self) -> bool:
        """Whether there is any film around the pallet."""
        return self.turns > 0
