"""The heights of a pile over a grid, with sums over rectangles of it in constant time."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray

CELL_MM: Final = 25.0


class HeightMap:
    """Highest tops over cells. Boxes are let down from above, so the last one's top is the highest.

    Attributes:
        height: (nx, ny) mm; ``cells``: how many.

    Args:
        extent_mm: of the target; ``cell_mm``: side of a cell.
    """

    def __init__(self, extent_mm: tuple[float, float], cell_mm: float = CELL_MM) -> None:
        self._cell_mm = cell_mm
        self._lines = np.array([max(round(side / cell_mm), 1) for side in extent_mm])
        self.height = np.zeros(self._lines)
        self.cells = self.height.size
        self._sums = self._squares = np.zeros(self._lines + 1)

    def put(self, low: FloatArray, high: FloatArray) -> None:
        """One more box, (3,) corners, mm."""
        (x0, y0), (x1, y1) = self.lines(low[None])[0].tolist(), self.lines(high[None])[0].tolist()
        self.height[x0:x1, y0:y1] = high[2]
        self._sums, self._squares = _summed_area(self.height), _summed_area(self.height**2)

    def copy(self) -> HeightMap:
        """The same surface, which goes its own way."""
        twin = HeightMap.__new__(HeightMap)
        twin.__dict__.update(self.__dict__)
        twin.height = self.height.copy()
        return twin

    def lines(self, corner_mm: FloatArray) -> NDArray[np.intp]:
        """(m, 2) the lines of the grid next to corners, whatever their further columns."""
        lines: NDArray[np.intp] = np.minimum(np.rint(corner_mm[:, :2] / self._cell_mm).astype(np.intp), self._lines)
        return lines

    @property
    def mean(self) -> float:
        """Mean height, mm."""
        return float(self._sums[-1, -1]) / self.cells

    @property
    def mean_square(self) -> float:
        """Mean squared height, mm²."""
        return float(self._squares[-1, -1]) / self.cells

    def over(self, low: NDArray[np.intp], high: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of (m, 2) rectangles between lines: how many cells, and the sums of heights and of their squares.

        Parts outside the target do not count.
        """
        (x0, y0), (x1, y1) = np.maximum(low, 0).T, np.minimum(high, self._lines).T
        count = ((x1 - x0) * (y1 - y0)).astype(np.float64)
        height, square = (
            sums[x1, y1] - sums[x0, y1] - sums[x1, y0] + sums[x0, y0] for sums in (self._sums, self._squares)
        )
        return count, height, square


def _summed_area(values: FloatArray) -> FloatArray:
    """(nx + 1, ny + 1) sums over all rectangles that begin at the corner (Crow 1984, "Summed-area tables")."""
    sums = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    values.cumsum(axis=0).cumsum(axis=1, out=sums[1:, 1:])
    return sums
