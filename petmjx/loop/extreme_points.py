"""The extreme points of pallets (points at which the corner of a new box is put), updated box by box.

Source: Crainic, Perboli, Tadei (2008), "Extreme point-based heuristics for three-dimensional bin packing", INFORMS
Journal on Computing 20(3), 368–384. Each box has points of its own, which depend only on this box and on the boxes
placed before it. Later boxes add points but do not change existing points. So if the last boxes are removed from a
pallet, the pallet has its previous points again.
"""

from __future__ import annotations

from types import ModuleType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.candidate_points import corner_points
from petmjx.world.growing_scenes import widened_table

_POINTS_PER_BOX: Final = 7


class Points:
    """The extreme points of n pallets, each point only once: the origin, and points beside and on top of each box. The
    points of a box are some of its corners, and the same corners moved towards the carrier's edges until they meet a
    box placed earlier.

    Args:
        gap_mm: free space behind each box along x and y; boxes are treated as larger by this space.

    Attributes:
        boxes: (n,) for each pallet, the number of boxes whose points are included.
    """

    def __init__(self, n: int, gap_mm: float = 0.0) -> None:
        self.gap_mm = gap_mm
        self.boxes: NDArray[np.int64] = np.zeros(n, np.int64)
        self._at: NDArray[np.complex128] = np.zeros((n, 1), np.complex128)  # points as x + iy, mm.
        # (n, k) for each pallet, the number of points after the first 0, 1, … boxes
        self._count: NDArray[np.int64] = np.ones((n, 1), np.int64)

    def count(self, pallets: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m,) number of points on each given pallet."""
        counts: NDArray[np.int64] = self._count[pallets, self.boxes[pallets]]
        return counts

    @property
    def tables(self) -> tuple[NDArray[np.complex128], NDArray[np.int64]]:
        """(n, p) the points of all pallets as x + iy, mm, and (n,) the number of points of each pallet. Values after
        the last point of a pallet have no meaning."""
        return self._at, self.count(np.arange(len(self.boxes)))

    def of(self, pallets: NDArray[np.int64]) -> NDArray[np.complex128]:
        """(m, p) the points of the given pallets as x + iy, mm. Values after the last point of a pallet are NaN."""
        count = self.count(pallets)
        p = int(count.max(initial=1))
        points = self._at[pallets, :p]
        points[np.arange(p) >= count[:, None]] = np.nan
        return points

    def add(self, pallets: NDArray[np.int64], low: FloatArray, high: FloatArray) -> None:
        """For each given pallet, add the points of one more box.

        Args:
            low, high: (m, k, 3) lowest and highest corners of the boxes on the pallets, including the free space. The
                box whose points are added has the number ``boxes[pallet]``. Boxes with larger numbers are ignored.
        """
        number, rows = self.boxes[pallets], np.arange(len(pallets))
        points, count = self.of(pallets), self._count[pallets, number]
        points = np.concatenate([points, np.full((len(pallets), _POINTS_PER_BOX), np.nan)], axis=1)
        for x, y in np.moveaxis(_piles_corner_points(low, high, number), 2, 1):
            point = x + 1j * y
            fresh = ~(points == point[:, None]).any(axis=1)
            points[rows[fresh], count[fresh]] = point[fresh]
            count += fresh
        self._make_room(int(count.max()), int(number.max()) + 1)
        self._at[pallets, : points.shape[1]] = points[:, : self._at.shape[1]]
        self._count[pallets, number + 1] = count
        self.boxes[pallets] += 1

    def add_all(
        self,
        pallets: NDArray[np.int64],
        corner_mm: FloatArray,
        size_mm: FloatArray,
        n_boxes: NDArray[np.int64],
        machine_code: ModuleType,
    ) -> None:
        """Add the points of those boxes on the given pallets whose points are not included yet.

        Args:
            corner_mm, size_mm: (n, k, 3) corners and sizes of the boxes on all pallets; ``n_boxes``: (n,) number of
                boxes on each pallet.
            machine_code: the module ``petmjx.loop.compiled_places``, loaded.
        """
        most = self.count(pallets) + _POINTS_PER_BOX * (n_boxes[pallets] - self.boxes[pallets])
        self._make_room(int(most.max()), int(n_boxes[pallets].max()))
        machine_code.add_points(pallets, self.boxes, corner_mm, size_mm, n_boxes, self.gap_mm, self._at, self._count)
        self.boxes[pallets] = n_boxes[pallets]

    def _make_room(self, n_points: int, n_boxes: int) -> None:
        """Widen the tables if they have no room for ``n_points`` points, or for the points of ``n_boxes`` boxes."""
        self._at, self._count = widened_table(self._at, n_points), widened_table(self._count, n_boxes + 1)

    def cut(self, pallets: NDArray[np.int64], count: NDArray[np.int64]) -> None:
        """Keep only the extreme points of the first ``count`` boxes of each given pallet."""
        self.boxes[pallets] = np.minimum(self.boxes[pallets], count)

    def copy(self, sources: NDArray[np.int64], into: NDArray[np.int64]) -> None:
        """Copy the extreme points of the pallets ``sources`` to the pallets ``into``."""
        for values in (self.boxes, self._at, self._count):
            values[into] = values[sources]


def _piles_corner_points(low: FloatArray, high: FloatArray, number: NDArray[np.int64]) -> FloatArray:
    """(7, m, 2) x and y of the seven extreme points that one box adds to each of m pallets, mm.

    Args:
        low, high: (m, k, 3) lowest and highest corners of the boxes on the pallets; ``number``: (m,) number of the box
            whose points are computed. Only boxes with smaller numbers are obstacles.
    """
    rows, before = np.arange(len(low)), (np.arange(low.shape[1]) < number[:, None])[..., None]
    piles = []
    for ends in (low, high):
        pile = np.where(before, ends, np.nan)
        pile[:, -1] = ends[rows, number]  # the last row is the box itself, which is not an obstacle
        piles.append(pile)
    with np.errstate(invalid="ignore"):  # values after the last box of a pallet are NaN
        return corner_points(*piles)
