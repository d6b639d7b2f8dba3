"""Height maps of pallets: the planned height of the boxes above each cell of the carrier."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import number_of
from petmjx.common.units import FloatArray
from petmjx.loop.box_tables import BoxTable

_EDGE: float = 1e-6
"""Tolerance for rounding errors, as a share of a cell's side. A box that ends closer to the edge of a cell than this
tolerance counts as ending at the edge."""


def cells_of(extent_mm: tuple[float, float], cell_mm: Any) -> tuple[int, int]:
    """Number of cells of a height map along x and along y.

    Raises:
        InputError: cells are smaller than 1 mm, or larger than the carrier.
    """
    side = number_of(cell_mm, "cell_mm", 1.0, min(extent_mm))
    x, y = (int(np.ceil(length / side - _EDGE)) for length in extent_mm)
    return x, y


def spans(size_mm: FloatArray, corner_mm: FloatArray, cell_mm: float) -> NDArray[np.intp]:
    """(m, 2, 2) the ranges of cells that boxes cover along x and y: the first covered cells, and the cells after the
    last covered ones.

    Args:
        size_mm, corner_mm: (m, 3) extents and corners of the boxes, mm.
    """
    low = np.floor(corner_mm[:, :2] / cell_mm + _EDGE)
    high = np.ceil((corner_mm + size_mm)[:, :2] / cell_mm - _EDGE)
    cells: NDArray[np.intp] = np.maximum(np.stack([low, high], axis=1), 0).astype(np.intp)
    return cells


def height_maps(stock: BoxTable, rows: NDArray[np.int64], extent_mm: tuple[float, float], cell_mm: Any) -> FloatArray:
    """(m, x, y) height of the highest box above each cell of the carrier of each given pallet, mm; 0 if there is no
    box."""
    maps = np.zeros((len(rows), *cells_of(extent_mm, cell_mm)))
    for number in range(int(stock.count[rows].max(initial=0))):
        has = np.flatnonzero(stock.count[rows] > number)
        box = stock.box(rows[has], number)
        tops = box.corner_mm[:, 2] + box.size_mm[:, 2]
        cell_spans = spans(box.size_mm, box.corner_mm, float(cell_mm))
        for row, ((x, y), (x_end, y_end)), top in zip(has.tolist(), cell_spans.tolist(), tops.tolist(), strict=True):
            part = maps[row, x:x_end, y:y_end]
            np.maximum(part, top, out=part)
    return maps
