"""Copies rows of tables when the same rows are needed many times, for example for many drives that start from one
placement.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.processes import on_threads

MANY: Final = 1_000
"""From this number of rows on, several threads copy faster than one, since NumPy releases the interpreter's lock while
it copies.
"""

MOST_THREADS: Final = 8


def gather_rows(arrays: Iterable[NDArray[Any]], source: NDArray[np.int64]) -> list[NDArray[Any]]:
    """For each array, the rows whose numbers are in ``source``. ``source`` contains many numbers more than once."""
    threads = MOST_THREADS if len(source) >= MANY else 1
    return on_threads(partial(np.take, indices=source, axis=0), [*arrays], threads)
