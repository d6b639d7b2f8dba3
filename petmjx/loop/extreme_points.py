"""The extreme points of pallets, updated box by box.

Crainic, Perboli, Tadei (2008), "Extreme point-based heuristics for three-dimensional bin packing", INFORMS Journal on
Computing 20(3), 368–384. The points of a box depend only on this box and on earlier boxes. Later boxes add points but
change none. So a pallet that loses its last boxes has its earlier points again.
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
    corners, and the same corners moved towards the carrier's edges until they meet an earlier box.

    Args:
        gap_mm: free space behind each box along x and y, by which boxes count as larger.

    Attributes:
        boxes: (n,) number of each pallet's boxes whose points are included.
    """

    def __init__(self, n: int, gap_mm: float = 0.0) -> None:
        self.gap_mm = gap_mm
        self.boxes: NDArray[np.int64] = np.zeros(n, np.int64)
        self._at: NDArray[np.complex128] = np.zeros((n, 1), np.complex128)  # x + iy, mm
        self._count: NDArray[np.int64] = np.ones((n, 1), np.int64)  # (n, k) number of points of the first 0, 1, … boxes

    def count(self, pallets: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m,) number of points on each of these pallets."""
        counts: NDArray[np.int64] = self._count[pallets, self.boxes[pallets]]
        return counts

    def of(self, pallets: NDArray[np.int64]) -> NDArray[np.complex128]:
        """(m, p) points on these pallets, x + iy, mm; NaN in columns beyond a pallet's points."""
        count = self.count(pallets)
        p = int(count.max(initial=1))
        points = self._at[pallets, :p]
        points[np.arange(p) >= count[:, None]] = np.nan
        return points

    def add(self, pallets: NDArray[np.int64], low: FloatArray, high: FloatArray) -> None:
        """Add the points of one more box on each of these pallets.

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
        """Keep only the points of the first ``count`` boxes on these pallets."""
        self.boxes[pallets] = np.minimum(self.boxes[pallets], count)

    def copy(self, sources: NDArray[np.int64], into: NDArray[np.int64]) -> None:
        """Copy the points of the pallets ``sources`` to the pallets ``into``."""
        for values in (self.boxes, self._at, self._count):
            values[into] = values[sources]


def _piles_corner_points(low: FloatArray, high: FloatArray, number: NDArray[np.int64]) -> FloatArray:
    """(7, m, 2) the points of one box on each of m pallets, mm.

    Args:
        low, high: (m, k, 3) lowest and highest corners of boxes; ``number``: (m,) number of the box. Only earlier boxes
            are obstacles.
    """
    rows, before = np.arange(len(low)), (np.arange(low.shape[1]) < number[:, None])[..., None]
    piles = []
    for ends in (low, high):
        pile = np.where(before, ends, np.nan)
        pile[:, -1] = ends[rows, number]  # the last row is the box itself, which is not an obstacle
        piles.append(pile)
    with np.errstate(invalid="ignore"):  # columns beyond a pallet's boxes hold NaN
        return corner_points(*piles)
