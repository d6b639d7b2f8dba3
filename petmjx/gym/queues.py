"""Which boxes episodes still have before them, in arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.loop.orders import Boxes


class Queues:
    """The boxes that n episodes have still to place.

    Args:
        seen: how many boxes of each episode are visible.

    Attributes:
        left_out: (n,) boxes for which there was no place.
    """

    def __init__(self, n: int, seen: int) -> None:
        self._boxes: list[Boxes] = [Boxes(np.zeros((0, 3)), np.zeros(0), np.zeros(0))] * n
        self._queues: list[list[int]] = [[] for _ in range(n)]
        self._seen = seen
        self.left_out: NDArray[np.int64] = np.zeros(n, np.int64)

    def begin(self, row: int, boxes: Boxes) -> None:
        """An episode has these boxes before it."""
        self._boxes[row], self._queues[row] = boxes, list(range(len(boxes)))
        self.left_out[row] = 0

    def take(self, row: int, place: int) -> float:
        """The box at this place of a queue has been placed. Returns its strength, N; NaN: not given."""
        return float(self._boxes[row].strength_n[self._queues[row].pop(place)])

    def leave_out(self, row: int, count: int) -> None:
        """The first boxes of a queue are left out."""
        self.left_out[row] += len(self._queues[row][:count])
        del self._queues[row][:count]

    def count(self, row: int) -> int:
        """Boxes that are left."""
        return len(self._queues[row])

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n,) boxes that are left."""
        return np.array([len(queue) for queue in self._queues], np.int64)

    def seen(self, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """(m, k, 3) sizes, mm, and (m, k) masses, kg, of the boxes that are seen; 0 where there are fewer."""
        size, mass = np.zeros((len(rows), self._seen, 3)), np.zeros((len(rows), self._seen))
        for at, row in enumerate(rows.tolist()):
            some = self._queues[row][: self._seen]
            size[at, : len(some)], mass[at, : len(some)] = (
                self._boxes[row].size_mm[some],
                self._boxes[row].mass_kg[some],
            )
        return size, mass
