"""Rows that tables have many times, as those of a placement from which many drives start."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.processes import on_threads

MANY: Final = 1_000
"""Rows for which several threads are worth while: NumPy leaves the interpreter's lock."""

MOST_THREADS: Final = 8


def gather_rows(arrays: Iterable[NDArray[Any]], source: NDArray[np.int64]) -> list[NDArray[Any]]:
    """Of each array its rows ``source``, of which many are the same."""
    threads = MOST_THREADS if len(source) >= MANY else 1
    return on_threads(partial(np.take, indices=source, axis=0), [*arrays], threads)
