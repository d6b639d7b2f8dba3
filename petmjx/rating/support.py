"""Direct support of boxes as BED-BPP counts it.

Its evaluator keeps, for each square millimetre of the target, which box was placed there last, and how high it
reaches. A box lies on all boxes that are last somewhere under it and reach up to 5 mm below its bottom, or higher. Its
support is the sum of what it shares with each of them, as a share of its base; a box under which there is none counts
as on the target, with support 1. So where two supporters overlap, what they share counts twice, a box that is pushed in
under another one lies on that one, and a box that floats stands on the target. In plans without overlapping and
floating boxes it is the share of the base that lies on something. (bed-bpp-env e7459bf, ``environment/space_3d.py`` and
``environment/cuboid.py``.)
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray

HEIGHT_TOLERANCE_MM: Final = 5.0
"""Tops that are lower by up to this still support."""


class Support(NamedTuple):
    """Direct support of n boxes.

    Attributes:
        share: (n,) of the base; 1 on the target.
        n_below: (n,) boxes on which a box lies; 0 on the target.
    """

    share: FloatArray
    n_below: NDArray[np.int64]


def direct_support(corner_mm: FloatArray, size_mm: FloatArray, extent_mm: tuple[float, float]) -> Support:
    """Support of the boxes of one plan.

    Their map has a cell for each square millimetre; here cells reach from one edge of a box to the next, so that all of
    a cell is under the same boxes.

    Args:
        corner_mm, size_mm: (n, 3), mm, as boxes stand, in packing order.
        extent_mm: of the target along x and y, whose corner is the origin. What lies beyond it supports nothing.
    """
    low, high = corner_mm[:, :2], corner_mm[:, :2] + size_mm[:, :2]
    x, y = (_cells(low[:, axis], high[:, axis], extent_mm[axis]) for axis in (0, 1))
    last = np.full((x.number, y.number), -1)
    reached = np.zeros((x.number, y.number))
    tops = corner_mm[:, 2] + size_mm[:, 2]
    share, n_below = np.ones(len(low)), np.zeros(len(low), dtype=np.int64)
    for box, bottom in enumerate(corner_mm[:, 2]):
        under = slice(x.first[box], x.end[box]), slice(y.first[box], y.end[box])
        top_boxes = last[under]
        met = np.zeros(len(low), dtype=bool)
        met[top_boxes[(top_boxes >= 0) & (reached[under] >= bottom - HEIGHT_TOLERANCE_MM)]] = True
        below = np.flatnonzero(met)
        if len(below):
            shared = np.minimum(high[box], high[below]) - np.maximum(low[box], low[below])
            share[box] = (shared[:, 0] * shared[:, 1]).sum() / (size_mm[box, 0] * size_mm[box, 1])
            n_below[box] = len(below)
        last[under], reached[under] = box, tops[box]
    return Support(share, n_below)


class _Cells(NamedTuple):
    """The cells of the target along one axis: how many, and from which to which each box covers them."""

    number: int
    first: NDArray[np.int64]
    end: NDArray[np.int64]


def _cells(low: FloatArray, high: FloatArray, extent: float) -> _Cells:
    low, high = np.clip(low, 0, extent), np.clip(high, 0, extent)
    edges = np.unique(np.concatenate((low, high)))
    return _Cells(len(edges) - 1, np.searchsorted(edges, low), np.searchsorted(edges, high))
