"""Height maps (``HeightMap``): the heights of a pile's tops on a grid, with sums over rectangles in constant time."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray

CELL_MM: Final = 25.0


class HeightMap:
    """The height of the highest top in each cell of a grid.

    Boxes are lowered from above, so a new box is the highest box in the cells that it covers.

    Attributes:
        height: (nx, ny) heights of the tops, mm.
        cells: number of cells.

    Args:
        extent_mm: length and width of the target, mm.
        cell_mm: side of a cell, mm.
    """

    def __init__(self, extent_mm: tuple[float, float], cell_mm: float = CELL_MM) -> None:
        self._cell_mm = cell_mm
        self._lines = np.array([max(round(side / cell_mm), 1) for side in extent_mm])
        self.height = np.zeros(self._lines)
        self.cells = self.height.size
        self._sums = self._squares = np.zeros(self._lines + 1)

    def put(self, low: FloatArray, high: FloatArray) -> None:
        """Add a box with the (3,) lowest and (3,) highest corners ``low`` and ``high``, mm."""
        (x0, y0), (x1, y1) = self.lines(low[None])[0].tolist(), self.lines(high[None])[0].tolist()
        self.height[x0:x1, y0:y1] = high[2]
        self._sums, self._squares = _summed_area(self.height), _summed_area(self.height**2)

    def copy(self) -> HeightMap:
        """An independent copy of the map."""
        twin = HeightMap.__new__(HeightMap)
        twin.__dict__.update(self.__dict__)
        twin.height = self.height.copy()
        return twin

    def lines(self, corner_mm: FloatArray) -> NDArray[np.intp]:
        """(m, 2) numbers of the grid lines nearest to the x and y of corners. Other columns of ``corner_mm`` are
        ignored."""
        lines: NDArray[np.intp] = np.minimum(np.rint(corner_mm[:, :2] / self._cell_mm).astype(np.intp), self._lines)
        return lines

    @property
    def mean(self) -> float:
        """Mean height over all cells, mm."""
        return float(self._sums[-1, -1]) / self.cells

    @property
    def mean_square(self) -> float:
        """Mean squared height over all cells, mm²."""
        return float(self._squares[-1, -1]) / self.cells

    def over(self, low: NDArray[np.intp], high: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(m,) number of cells, (m,) sum of heights, mm, and (m,) sum of squared heights, mm², in m rectangles.

        Parts of a rectangle outside the target are ignored.

        Args:
            low, high: (m, 2) grid lines through the rectangles' lowest and highest corners.
        """
        (x0, y0), (x1, y1) = np.maximum(low, 0).T, np.minimum(high, self._lines).T
        count = ((x1 - x0) * (y1 - y0)).astype(np.float64)
        height, square = (
            sums[x1, y1] - sums[x0, y1] - sums[x1, y0] + sums[x0, y0] for sums in (self._sums, self._squares)
        )
        return count, height, square


def _summed_area(values: FloatArray) -> FloatArray:
    """(nx + 1, ny + 1) sum of the values of all cells before each pair of grid lines (Crow 1984, "Summed-area
    tables")."""
    sums = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    values.cumsum(axis=0).cumsum(axis=1, out=sums[1:, 1:])
    return sums
