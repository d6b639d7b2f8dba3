"""Tables with a row for each pallet, and columns for its boxes or points: they get wider as pallets grow."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FIRST_COLUMNS: Final = 16
"""Boxes for which there is room at first."""


def widened_table(values: NDArray[Any], columns: int, fill: float = 0.0) -> NDArray[Any]:
    """A table with room for so many columns: twice as many as before, until they are enough."""
    while values.shape[1] < columns:
        values = np.concatenate([values, np.full_like(values, fill)], axis=1)
    return values
