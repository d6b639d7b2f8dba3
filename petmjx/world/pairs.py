"""Friction by pairs: which coefficient counts between two shapes, where it is not the larger one of the two; and
landings.

Shapes have surfaces, numbered from 1; a table has the coefficient of sliding friction of each pair of surfaces. Surface
0 is that of the floor, and of all shapes without a surface of their own.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray

MOST_SURFACES: Final = 16
"""Rows of a world's table on devices, surface 0 included."""

LARGER: Final = -1.0
"""In place of a coefficient: the larger one of the two shapes counts, as everywhere in MuJoCo."""


USUAL: Final = -1.0
"""In place of a number of a landing: that of the physics counts."""


def no_landings(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k, 2) a table of landings that says nothing."""
    return np.full((n_surfaces, n_surfaces, 2), USUAL)


def no_pairs(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k) a table that says nothing."""
    return np.full((n_surfaces, n_surfaces), LARGER)


def scaled_pairs(
    table: FloatArray | None, of_boards: NDArray[np.intp] | None, box_factor: float, carrier_factor: float
) -> FloatArray | None:
    """(k, k) a table with other friction of boxes and carrier, whose boards have surfaces of their own.

    Between two the larger factor counts, as the larger coefficient does for a pair without an entry.
    """
    if table is None:
        return None
    factor = np.full(len(table), box_factor)
    if of_boards is not None:
        factor[of_boards] = carrier_factor
    return np.where(table == LARGER, LARGER, table * np.maximum.outer(factor, factor))


def filled_up(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``) a world's table with rows for all surfaces.

    Raises:
        ValueError: it has more.
    """
    filled = no_pairs()
    if table is not None:
        if len(table) > MOST_SURFACES:
            raise ValueError(f"at most {MOST_SURFACES} surfaces, got {len(table)}")
        filled[: len(table), : len(table)] = table
    return filled


def filled_up_landings(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``, 2) a world's table of landings with rows for all surfaces."""
    filled = no_landings()
    if table is not None:
        filled[: len(table), : len(table)] = table
    return filled
