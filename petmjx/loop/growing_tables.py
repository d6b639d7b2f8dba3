"""Growing tables: one row per pallet, and columns for its boxes or points. Columns are added as pallets grow."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FIRST_COLUMNS: Final = 16
"""Number of boxes for which tables have room at the start."""


def widened_table(values: NDArray[Any], columns: int, fill: float = 0.0) -> NDArray[Any]:
    """A table with at least ``columns`` columns. The number of columns is doubled until it is large enough."""
    while values.shape[1] < columns:
        values = np.concatenate([values, np.full_like(values, fill)], axis=1)
    return values
