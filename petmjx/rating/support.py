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

from petmjx.units import FloatArray

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

    Args:
        corner_mm, size_mm: (n, 3), mm, as boxes stand, in packing order.
        extent_mm: of the target along x and y, whose corner is the origin. What lies beyond it supports nothing.
    """
    low, high = corner_mm[:, :2], corner_mm[:, :2] + size_mm[:, :2]
    shared = np.maximum(
        np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None]), 0
    )  # (upper box, lower box, axis)
    area = shared.prod(axis=2)
    reaches = corner_mm[:, 2] + size_mm[:, 2] >= corner_mm[:, 2, None] - HEIGHT_TOLERANCE_MM
    upper, lower = np.nonzero(np.tril((area > 0) & reaches, k=-1))
    seen = _seen(low, high, upper, lower, np.array(extent_mm, dtype=float))
    upper, lower = upper[seen], lower[seen]
    n_boxes = len(corner_mm)
    n_below = np.bincount(upper, minlength=n_boxes)
    base = size_mm[:, 0] * size_mm[:, 1]
    share = np.bincount(upper, area[upper, lower], minlength=n_boxes) / base
    return Support(np.where(n_below > 0, share, 1.0), n_below)


def _seen(
    low: FloatArray,
    high: FloatArray,
    upper: NDArray[np.int64],
    lower: NDArray[np.int64],
    extent: FloatArray,
) -> NDArray[np.bool_]:
    """(p,) of pairs of boxes: whether the lower one is the last under the upper one, somewhere on the target."""
    begin = np.maximum(np.maximum(low[upper], low[lower]), 0)
    end = np.minimum(np.minimum(high[upper], high[lower]), extent)
    seen: NDArray[np.bool_] = np.all(end > begin, axis=1)
    # boxes that were placed between the two, and hide some of what they share
    between = (np.arange(len(low)) > lower[:, None]) & (np.arange(len(low)) < upper[:, None])
    hides = between & ((np.minimum(end[:, None], high[None]) > np.maximum(begin[:, None], low[None])).all(axis=2))
    for pair in np.flatnonzero(seen & hides.any(axis=1)):
        boxes = np.flatnonzero(hides[pair])
        seen[pair] = not _covered(begin[pair], end[pair], low[boxes], high[boxes])
    return seen


def _covered(begin: FloatArray, end: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    """Whether rectangles cover another one wholly. Between neighbouring edges nothing changes."""
    edges = [
        np.unique(
            np.clip(np.concatenate(([begin[axis], end[axis]], low[:, axis], high[:, axis])), begin[axis], end[axis])
        )
        for axis in (0, 1)
    ]
    x, y = (each[:-1] + np.diff(each) / 2 for each in edges)
    inside_x = (low[:, 0, None] <= x) & (x <= high[:, 0, None])
    inside_y = (low[:, 1, None] <= y) & (y <= high[:, 1, None])
    return bool((inside_x[:, :, None] & inside_y[:, None, :]).any(axis=0).all())
