"""Tables with one row per pallet, and columns for the pallet's boxes or points. Columns are added when boxes are
added."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FIRST_COLUMNS: Final = 16
"""Number of boxes for which tables have columns at the start."""


def widened_table(values: NDArray[Any], columns: int, fill: float = 0.0) -> NDArray[Any]:
    """The table ``values``, widened to at least ``columns`` columns: the number of columns is doubled until it is large
    enough, and new columns have the value ``fill``."""
    while values.shape[1] < columns:
        values = np.concatenate([values, np.full_like(values, fill)], axis=1)
    return values
