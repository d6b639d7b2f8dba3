"""Maps of pallets for observations: the height of the pile above each cell of the carrier, and the load on the boxes
above each cell."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.processes import on_threads
from petmjx.common.units import FloatArray
from petmjx.common.warp_setup import machine_code
from petmjx.loop.height_maps import spans
from petmjx.world.growing_scenes import FIRST_COLUMNS, widened_table

_AT_ONCE: Final = 512
"""Number of pallets whose maps are computed at a time. The maps of 512 pallets fit into the cache of a CPU core."""

_WORTH_COMPILING: Final = 256
"""Smallest number of pallets for which compiled code is used, if Warp is installed. Compiling takes some seconds; the
code is kept for later runs."""

_MOST: Final = float(np.finfo(np.float32).max)

Map = NDArray[np.float32]


class Maps:
    """The maps of n pallets. The maps are updated with each new box, and are in single precision like all observations.

    Attributes:
        heights: (n, x, y) height of the highest top of a box above each cell, mm.
        loads: (n, x, y) largest force on the top of a box above each cell, N.
    """

    def __init__(self, n: int, cells: tuple[int, int], cell_mm: float) -> None:
        self._cell_mm = cell_mm
        self.heights: Map = np.zeros((n, *cells), np.float32)
        self.loads: Map = np.zeros((n, *cells), np.float32)
        # for each box, the ranges of cells that it covers
        self._spans: NDArray[np.int32] = np.zeros((n, FIRST_COLUMNS, 2, 2), np.int32)
        self._code = machine_code("petmjx.gym.compiled_maps") if n >= _WORTH_COMPILING else None

    def clear(self, rows: NDArray[np.int64]) -> None:
        """Set the maps of the pallets in the given rows to the maps of empty pallets."""
        self.heights[rows] = self.loads[rows] = 0.0

    def add(
        self, rows: NDArray[np.int64], number: NDArray[np.int64], size_mm: FloatArray, corner_mm: FloatArray
    ) -> None:
        """Add a box to each of m pallets.

        Args:
            number: (m,) number of the new box on its pallet, from 0.
            size_mm, corner_mm: (m, 3) extents and corner of the new box.
        """
        self._spans = widened_table(self._spans, int(number.max(initial=0)) + 1)
        self._spans[rows, number] = box_spans = spans(size_mm, corner_mm, self._cell_mm)
        tops = (corner_mm[:, 2] + size_mm[:, 2]).astype(np.float32)
        if self._code is not None:
            self._code.raise_heights(rows, self._spans[rows, number], tops, self.heights)
            return
        over_x, over_y = self._over(box_spans)
        # contiguous factors, and an output array that exists already, reduce the time to a half or a quarter
        heights = np.ascontiguousarray((tops * over_x).T)[:, :, None] * np.ascontiguousarray(over_y.T)[:, None]
        self.heights[rows] = np.maximum(heights, self.heights[rows], out=heights)

    def load(self, rows: NDArray[np.int64], top_force_n: FloatArray) -> None:
        """Update the maps of loads of m pallets.

        Args:
            top_force_n: (m, k) force on the top of each box, N; NaN after the last box of a pallet.
        """
        force = np.minimum(np.nan_to_num(top_force_n), _MOST).astype(np.float32)
        if self._code is not None:
            self._code.put_loads(rows, force, self._spans, self.loads)
            return
        count = (force > 0).sum(axis=1)
        # pallets with similar numbers of loaded boxes are computed together, which saves time
        fullest = np.argsort(-count, kind="stable")

        def load(some: NDArray[np.intp]) -> None:
            most = int(count[some].max(initial=0))
            bearing = np.argsort(force[some] <= 0, axis=1, kind="stable")[:, :most]
            box_spans, box_force = (
                self._spans[rows[some, None], bearing],
                np.take_along_axis(force[some], bearing, axis=1),
            )
            loads: Map = np.zeros((*self.heights.shape[1:], len(some)), np.float32)
            for number in range(most):
                over_x, over_y = self._over(box_spans[:, number])
                np.maximum(loads, (box_force[:, number] * over_x)[:, None] * over_y, out=loads)
            self.loads[rows[some]] = loads.transpose(2, 0, 1)

        on_threads(load, np.split(fullest, range(_AT_ONCE, len(rows), _AT_ONCE)))

    def _over(self, box_spans: NDArray[np.integer]) -> tuple[Map, Map]:
        """For one box of each of m pallets, the cells that the box covers along x, (x, m), and along y, (y, m): 1 for a
        covered cell, otherwise 0.

        Args:
            box_spans: (m, 2, 2) the ranges of cells that one box of each pallet covers, from ``spans``.
        """
        low, high = box_spans.transpose(1, 2, 0)
        x, y = (
            ((low[axis] <= cells) & (cells < high[axis])).astype(np.float32)
            for axis in range(2)
            for cells in [np.arange(self.heights.shape[1 + axis])[:, None]]
        )
        return x, y
