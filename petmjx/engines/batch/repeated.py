"""Rows that tables have many times, as those of a placement from which many drives start."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.machine import cpu_threads

MANY: Final = 1_000
"""Rows for which several threads are worth while: NumPy leaves the interpreter's lock."""

MOST_THREADS: Final = 8


def repeated(arrays: Iterable[NDArray[Any]], source: NDArray[np.int64]) -> list[NDArray[Any]]:
    """Of each array its rows ``source``, of which many are the same."""
    take = partial(np.take, indices=source, axis=0)
    if len(source) < MANY:
        return [take(array) for array in arrays]
    with ThreadPoolExecutor(min(cpu_threads(), MOST_THREADS), thread_name_prefix="petmjx-rows") as pool:
        return list(pool.map(take, arrays))
