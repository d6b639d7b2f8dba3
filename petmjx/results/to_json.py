"""Converts values to plain JSON values."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np


def to_json(value: Any) -> Any:
    """Convert a value to plain JSON values.

    NumPy scalars, enums and tuples become plain values, a data frame becomes a list of rows, and a path becomes text.
    Missing numbers and numbers that are not finite become None.
    """
    if isinstance(value, Mapping):
        return {str(to_json(key)): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_json(item) for item in value]
    pandas = sys.modules.get("pandas")  # importing pandas takes 0.2 s; a data frame can exist only if pandas is loaded
    if pandas is not None and isinstance(value, pandas.DataFrame):
        return to_json(value.to_dict("records"))
    if isinstance(value, np.ndarray | np.generic):
        return to_json(value.tolist())
    if isinstance(value, Enum):
        return to_json(value.value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or (pandas is not None and value is pandas.NA):
        return None
    return value if isinstance(value, bool | int | str) else str(value)
