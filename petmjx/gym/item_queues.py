"""The queues of the boxes that episodes still have to place, stored in arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.loop.episode_orders import STRENGTH, Boxes

_MORE: Final = 32
"""Number of boxes that the table holds for each episode in addition to the visible boxes. When 32 boxes have been
removed from an episode's row of the table, the row is refilled."""


def parts_of(boxes: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Split an array (…, 8), whose rows describe boxes, into three arrays: the sizes (…, 3), mm; the masses (…), kg;
    and (…, 3) whether each size may be vertical."""
    return boxes[..., :3], boxes[..., 3], boxes[..., 5:] > 0


class Queues:
    """The boxes that n episodes still have to place.

    Args:
        seen: number of visible boxes of each episode.

    Attributes:
        counts: (n,) number of remaining boxes of each episode.
        left_out: (n,) number of boxes of each episode that were left out because there was no legal place for them.
    """

    def __init__(self, n: int, seen: int) -> None:
        self._boxes: list[Boxes] = [Boxes(np.zeros((0, 3)), np.zeros(0), np.zeros(0))] * n
        self._seen = seen
        # (n, k, 8) the next boxes of each episode, in the form of ``Boxes.rows``. The first remaining box is at index
        # `_first`. Values are 0 after the last box.
        self._next: FloatArray = np.zeros((n, seen + _MORE, 8))
        self._first: NDArray[np.int64] = np.zeros(n, np.int64)
        # for each episode, the number of boxes that are not in `_next` yet
        self._behind: NDArray[np.int64] = np.zeros(n, np.int64)
        self.counts: NDArray[np.int64] = np.zeros(n, np.int64)
        self.left_out: NDArray[np.int64] = np.zeros(n, np.int64)

    def begin(self, row: int, boxes: Boxes) -> None:
        """Begin an episode in the row ``row``, with the boxes ``boxes`` to place."""
        self._boxes[row], self.left_out[row] = boxes, 0
        self.counts[row] = self._behind[row] = len(boxes)
        self._fill(row)

    def take(self, rows: NDArray[np.int64], places: NDArray[np.int64]) -> FloatArray:
        """Remove one box from each of m queues, at the given positions. Returns (m,) the strengths of the removed
        boxes, N; NaN if unknown."""
        first = self._first[rows]
        strength: FloatArray = self._next[rows, first + places, STRENGTH]
        for place in range(int(places.max(initial=0)), 0, -1):  # boxes before the removed box move one position back
            is_after = places >= place
            at = rows[is_after], first[is_after] + place
            self._next[at] = self._next[at[0], at[1] - 1]
        self._go_on(rows, np.ones(len(rows), np.int64))
        return strength

    def leave_out(self, rows: NDArray[np.int64], count: int | NDArray[np.int64]) -> None:
        """Remove the first ``count`` boxes from the queue in each given row, and count the removed boxes as left out.
        ``count`` is one number, or (m,) a number for each queue."""
        n_removed = np.minimum(self.counts[rows], count)
        self.left_out[rows] += n_removed
        self._go_on(rows, n_removed)

    def kinds(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
        """The first box of each kind (``Boxes.kind``) among the remaining boxes of each of m queues. This method may be
        used only if all boxes so far have been removed from the front of the queues.

        Returns:
            (k,) the queue of each of these k boxes, as an index into ``rows``; (k,) the position of each box in its
            queue; and (k, 8) the values of each box, as in ``Boxes.rows``. Boxes are sorted by queue, and then by
            position.
        """
        queues = [
            (self._boxes[row], count) for row, count in zip(rows.tolist(), self.counts[rows].tolist(), strict=True)
        ]
        of = np.repeat(np.arange(len(rows)), self.counts[rows])
        kind = np.concatenate([boxes.kind[len(boxes) - count :] for boxes, count in queues])
        order = np.lexsort((kind, of))  # a stable sort: the first box of a kind stays the first
        is_first = np.ones(len(order), bool)
        is_first[1:] = (np.diff(kind[order]) != 0) | (np.diff(of[order]) != 0)
        first = np.sort(order[is_first])
        values = np.concatenate([boxes.rows[len(boxes) - count :] for boxes, count in queues])
        begin = np.cumsum(self.counts[rows]) - self.counts[rows]
        return of[first], first - begin[of[first]], values[first]

    def kept(self, rows: NDArray[np.int64]) -> list[NDArray[Any]]:
        """A copy of the states of the queues in the given rows. ``restore`` can set the queues to these states
        again."""
        return [values[rows] for values in self._arrays]

    def restore(self, rows: NDArray[np.int64], kept: Iterable[NDArray[Any]]) -> None:
        """Set the states of the queues in the given rows to a copy that ``kept`` has made."""
        for values, before in zip(self._arrays, kept, strict=True):
            values[rows] = before

    @property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return self._next, self._first, self._behind, self.counts, self.left_out

    def seen(self, rows: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """The k visible boxes of each of m episodes, split by ``parts_of`` into arrays (m, k, …). Values are 0 after
        the last box."""
        return parts_of(self._next[rows[:, None], self._first[rows, None] + np.arange(self._seen)])

    def _go_on(self, rows: NDArray[np.int64], count: NDArray[np.int64]) -> None:
        self._first[rows] += count
        self.counts[rows] -= count
        for row in rows[self._first[rows] > _MORE].tolist():
            self._fill(row)

    def _fill(self, row: int) -> None:
        """Move the remaining boxes of a row to the row's beginning, and append boxes until the row is full."""
        boxes, table = self._boxes[row], self._next[row]
        # ``_behind`` is too large if more boxes were left out than the table held, so it is limited to the remaining
        # boxes.
        behind = min(int(self._behind[row]), int(self.counts[row]))
        n_items, first = int(self.counts[row]) - behind, int(self._first[row])
        table[:n_items] = table[first : first + n_items].copy()
        new_rows = slice(len(boxes) - behind, len(boxes) - behind + len(table) - n_items)
        new = boxes.rows[new_rows]
        table[n_items : n_items + len(new)], table[n_items + len(new) :] = new, 0.0
        self._first[row], self._behind[row] = 0, behind - len(new)
