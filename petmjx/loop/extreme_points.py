"""The extreme points of pallets, kept from box to box.

Crainic, Perboli, Tadei (2008), "Extreme point-based heuristics for three-dimensional bin packing", INFORMS Journal on
Computing 20(3), 368–384. The points of a box depend only on this box and earlier boxes. Later boxes add points
and change none. If a pallet loses its last boxes, it has its earlier points again.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.loop.growing_tables import widened_table
from petmjx.packers.candidate_points import corner_points

_POINTS_PER_BOX: Final = 7


class Points:
    """The distinct points of n pallets: the origin, and points beside and on each box. The points of a box are its
    corners, and the same corners slid towards the carrier's edges until they meet an earlier box.

    Args:
        gap_mm: free space behind each box along x and y, by which boxes count as larger.

    Attributes:
        boxes: (n,) number of boxes of each pallet whose points are included.
    """

    def __init__(self, n: int, gap_mm: float = 0.0) -> None:
        self.gap_mm = gap_mm
        self.boxes: NDArray[np.int64] = np.zeros(n, np.int64)
        self._at: NDArray[np.complex128] = np.zeros((n, 1), np.complex128)  # x + iy, mm
        self._count: NDArray[np.int64] = np.ones((n, 1), np.int64)  # (n, k) points of the first 0, 1, … boxes

    def count(self, pallets: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m,) number of points of these pallets."""
        counts: NDArray[np.int64] = self._count[pallets, self.boxes[pallets]]
        return counts

    def of(self, pallets: NDArray[np.int64]) -> NDArray[np.complex128]:
        """(m, p) points of pallets, x + iy, mm; NaN beyond a pallet's own points."""
        count = self.count(pallets)
        p = int(count.max(initial=1))
        points = self._at[pallets, :p]
        points[np.arange(p) >= count[:, None]] = np.nan
        return points

    def add(self, pallets: NDArray[np.int64], low: FloatArray, high: FloatArray) -> None:
        """Add the points of one more box of each of these pallets.

        Args:
            low, high: (m, k, 3) ends of their boxes, with the free space. Box number ``boxes[pallet]`` is the new box;
                boxes after it are ignored.
        """
        number, rows = self.boxes[pallets], np.arange(len(pallets))
        points, count = self.of(pallets), self._count[pallets, number]
        points = np.concatenate([points, np.full((len(pallets), _POINTS_PER_BOX), np.nan)], axis=1)
        for x, y in np.moveaxis(_piles_corner_points(low, high, number), 2, 1):
            point = x + 1j * y
            fresh = ~(points == point[:, None]).any(axis=1)
            points[rows[fresh], count[fresh]] = point[fresh]
            count += fresh
        self._at = widened_table(self._at, int(count.max()))
        self._count = widened_table(self._count, int(number.max()) + 2)
        self._at[pallets, : points.shape[1]] = points[:, : self._at.shape[1]]
        self._count[pallets, number + 1] = count
        self.boxes[pallets] += 1

    def cut(self, pallets: NDArray[np.int64], count: NDArray[np.int64]) -> None:
        """Keep only the points of the first ``count`` boxes of some pallets."""
        self.boxes[pallets] = np.minimum(self.boxes[pallets], count)

    def copy(self, sources: NDArray[np.int64], into: NDArray[np.int64]) -> None:
        """Copy the points of the pallets ``sources`` to the pallets ``into``."""
        for values in (self.boxes, self._at, self._count):
            values[into] = values[sources]


def _piles_corner_points(low: FloatArray, high: FloatArray, number: NDArray[np.int64]) -> FloatArray:
    """(7, m, 2) the points of a box of each of m pallets, mm.

    Args:
        low, high: (m, k, 3) ends of boxes; ``number``: (m,) number of the box; only earlier boxes are in the way.
    """
    rows, before = np.arange(len(low)), (np.arange(low.shape[1]) < number[:, None])[..., None]
    piles = []
    for ends in (low, high):
        pile = np.where(before, ends, np.nan)
        pile[:, -1] = ends[rows, number]  # no box of the pile is in the way
        piles.append(pile)
    with np.errstate(invalid="ignore"):  # columns beyond a pallet's boxes
        return corner_points(*piles)
