"""Pieces of NumPy's work on threads: it works on arrays without Python's lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

from petmjx.basics.machine import cpu_threads

MOST_THREADS: Final = 2
"""More wait for Python's lock: on the host of an H200, places for 2,048 pallets took 155 ms with one thread, 118 ms
with two, 141 ms with eight and 158 ms with sixteen."""

_FEW: Final = 2
"""So many pieces take no longer in this thread than others to begin."""

Piece = TypeVar("Piece")
Made = TypeVar("Made")


def on_threads(function: Callable[[Piece], Made], pieces: Sequence[Piece], most: int = MOST_THREADS) -> list[Made]:
    """What a function makes of each piece, in their order; the longest should come first.

    Args:
        most: threads.
    """
    if len(pieces) <= _FEW or most == 1:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(min(cpu_threads(), most)) as pool:
        return list(pool.map(function, pieces))
