"""Where boxes could go: the extreme points of many pallets, in arrays.

As in ``petmjx.plans.samples.packer``: Crainic, Perboli, Tadei (2008), "Extreme point-based heuristics for three-
dimensional bin packing", INFORMS Journal on Computing 20(3), 368–384. A box is lowered at a point until it rests.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.machine import cpu_threads
from petmjx.basics.units import FloatArray
from petmjx.loop.asked import Asked
from petmjx.loop.stock import Stock

TOUCH_MM: Final = 1e-6
"""Tops closer than this have the same height, and smaller overlaps do not count: rounding errors of float64 sums."""

_AT_ONCE: Final = 100_000
"""Pairs of a point and a box that are compared at a time: their tables stay in a core's cache."""

_POINTS_PER_BOX: Final = 7

_COLUMNS: Final = 8
"""Tables of boxes have a multiple of so many columns: NumPy's sums then do not depend on how many there are."""

_FEW_CHUNKS: Final = 4
"""Fewer are not worth threads."""

_Lowered = tuple[NDArray[np.intp], FloatArray, FloatArray, NDArray[np.bool_]]


class Places(NamedTuple):
    """c places, box after box, each box's lowest ones first, then those nearest to the origin.

    Attributes:
        row: (c,) which of the m boxes that were asked about; ``pallet``: (c,) its pallet.
        corner_mm: (c, 3) where its front-left-bottom corner would be.
        support: (c,) share of its base that would rest on the carrier or on boxes' tops.
        centred: (c,) whether its base's middle lies over the convex hull of what it rests on: the criterion ``centre``;
            None where it was not asked for.
    """

    row: NDArray[np.intp]
    pallet: NDArray[np.int64]
    corner_mm: FloatArray
    support: FloatArray
    centred: NDArray[np.bool_] | None


def free_places(
    stock: Stock,
    asked: Asked,
    extent_mm: tuple[float, float],
    max_height_mm: float,
    grid: FloatArray | None = None,
    *,
    hulls: bool = True,
) -> Places:
    """Places for boxes on pallets; ``asked.corner_mm`` is not read.

    Args:
        grid: (p, 2) points, mm, instead of the extreme ones.
        hulls: whether ``centred`` is asked for.
    """
    count = stock.count[asked.pallet]
    order = np.argsort(count, kind="stable")  # pallets with few boxes cost little, if they are together
    done = np.cumsum(_POINTS_PER_BOX * count[order] ** 2 + 1)
    chunks = np.split(order, np.flatnonzero(np.diff(done // _AT_ONCE)) + 1) if len(order) else []

    def lowered(rows: NDArray[np.intp]) -> _Lowered:
        pallets, at = np.unique(asked.pallet[rows], return_inverse=True)
        k = -(-int(stock.count[pallets].max()) // _COLUMNS) * _COLUMNS
        low = stock.corner_mm[pallets, :k]
        high = low + stock.size_mm[pallets, :k]
        points = _points(low, high) if grid is None else np.broadcast_to(grid, (len(pallets), *grid.shape))
        return _lowered(rows, points[at], low[at], high[at], asked.size_mm[rows], extent_mm, max_height_mm, hulls)

    if len(chunks) < _FEW_CHUNKS:
        parts = [lowered(rows) for rows in chunks]
    else:  # NumPy works on arrays without the GIL
        with ThreadPoolExecutor(cpu_threads()) as pool:
            parts = list(pool.map(lowered, chunks[::-1]))  # the longest first
    if not parts:
        nothing = np.zeros(0, np.intp)
        return Places(nothing, asked.pallet, np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool) if hulls else None)
    row, corner, support, centred = (np.concatenate(values) for values in zip(*parts, strict=True))
    given = np.argsort(row, kind="stable")
    row, corner, support = row[given], corner[given], support[given]
    return Places(row, asked.pallet[row], corner, support, centred[given] if hulls else None)


def _points(low: FloatArray, high: FloatArray) -> FloatArray:
    """(w, p, 2) corners, mm: the origin, and points beside and on each of k boxes: its corners, and the same corners
    slid towards the carrier's edges until an earlier box is in the way. NaN where a pallet has fewer boxes, and for
    repeated points.

    Args:
        low, high: (w, k, 3) ends of boxes.
    """
    w, k = low.shape[:2]
    x, y, z = np.moveaxis(low, 2, 0)
    x_end, y_end, top = np.moveaxis(high, 2, 0)
    before = np.tri(k, k=-1, dtype=bool)

    def slid(axis: int, start: FloatArray, across: FloatArray, level: FloatArray) -> FloatArray:
        """(w, k) where points that slide along −axis meet a box, or 0 at the carrier's edge."""
        other = 1 - axis
        with np.errstate(invalid="ignore"):
            in_way = (low[:, None, :, other] <= across[:, :, None]) & (across[:, :, None] < high[:, None, :, other])
            in_way &= (low[:, None, :, 2] <= level[:, :, None]) & (level[:, :, None] < high[:, None, :, 2])
            in_way &= (high[:, None, :, axis] <= start[:, :, None] + TOUCH_MM) & before
        ends = np.where(in_way, np.nan_to_num(high[:, None, :, axis]), 0.0)
        found: FloatArray = ends.max(axis=2, initial=0.0)
        return found

    each = [
        (x_end, y),
        (x_end, slid(1, y, x_end, z)),
        (x, y_end),
        (slid(0, x, y_end, z), y_end),
        (x, y),
        (slid(0, x, y, top), y),
        (x, slid(1, y, x, top)),
    ]
    found = np.stack([np.stack(point, axis=-1) for point in each], axis=2).reshape(w, _POINTS_PER_BOX * k, 2)
    found[np.isnan(np.repeat(x, _POINTS_PER_BOX, axis=1).reshape(w, _POINTS_PER_BOX * k))] = np.nan
    return _distinct(np.concatenate([np.zeros((w, 1, 2)), found], axis=1))


def _distinct(points: FloatArray) -> FloatArray:
    """The same points of each pallet, each once and in order, and no more columns than are needed."""
    code = np.nan_to_num(points[:, :, 0] + 1j * points[:, :, 1], nan=np.inf)
    order = np.argsort(code, axis=1, kind="stable")
    ordered = np.take_along_axis(points, order[:, :, None], axis=1)
    again = np.zeros(points.shape[:2], bool)
    again[:, 1:] = (ordered[:, 1:] == ordered[:, :-1]).all(axis=2)
    ordered[again] = np.nan
    there = np.isfinite(ordered[:, :, 0])
    front = np.argsort(~there, axis=1, kind="stable")
    packed = np.take_along_axis(ordered, front[:, :, None], axis=1)
    return packed[:, : int(there.sum(axis=1).max(initial=1))]


def _lowered(
    rows: NDArray[np.intp],
    points: FloatArray,
    low: FloatArray,
    high: FloatArray,
    size: FloatArray,
    extent_mm: tuple[float, float],
    max_height_mm: float,
    hulls: bool,
) -> _Lowered:
    """Boxes lowered at their pallets' points: which box, its corner, the supported share of its base, and whether its
    middle is between what bears it.

    Args:
        points: (m, p, 2); ``low``, ``high``: (m, k, 3); ``size``: (m, 3).
    """
    ends = points + size[:, None, :2]
    with np.errstate(invalid="ignore"):
        inside = (ends <= np.array(extent_mm) + TOUCH_MM).all(axis=2)
        start, end = (
            np.maximum(points[:, :, None], low[:, None, :, :2]),
            np.minimum(ends[:, :, None], high[:, None, :, :2]),
        )
        side = end - start
        area = np.where((side > TOUCH_MM).all(axis=3), side[..., 0] * side[..., 1], 0.0)
        tops = np.nan_to_num(high[:, None, :, 2])
        z = np.where(area > 0, tops, 0.0).max(axis=2, initial=0.0)
        bears = (area > 0) & (np.abs(tops - z[:, :, None]) <= TOUCH_MM)
        carried = np.where(bears, area, 0.0).sum(axis=2)
        support = np.where(z > 0, carried / size[:, None, :2].prod(axis=2), 1.0)
        useful: NDArray[np.bool_] = inside & (z + size[:, None, 2] <= max_height_mm + TOUCH_MM)
    box, point = np.nonzero(useful)
    corner = np.column_stack([points[box, point], z[box, point]])
    order = np.lexsort((corner[:, 1], corner[:, 0], corner[:, 2], box))
    box, point, corner = box[order], point[order], corner[order]
    if not hulls:
        return rows[box], corner, support[box, point], np.zeros(0, bool)
    middle: FloatArray = corner[:, :2] + size[box, :2] / 2
    centred = _over_hull(middle, start[box, point], end[box, point], bears[box, point])
    centred |= corner[:, 2] <= 0
    return rows[box], corner, support[box, point], centred


def _over_hull(point: FloatArray, low: FloatArray, high: FloatArray, counts: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(c,) whether points lie over the convex hulls of rectangles: seen from it their corners leave no gap of more than
    180°.

    Args:
        point: (c, 2); ``low``, ``high``: (c, k, 2) of rectangles, ``counts``: (c, k) whether each is one.
    """
    if not counts.shape[1]:
        return np.zeros(len(point), bool)
    x = np.concatenate([low[..., 0], high[..., 0], low[..., 0], high[..., 0]], axis=1) - point[:, :1]
    y = np.concatenate([low[..., 1], high[..., 1], high[..., 1], low[..., 1]], axis=1) - point[:, 1:]
    there = np.asarray(counts.any(axis=1))
    angles = np.where(np.tile(counts, (1, 4)), np.arctan2(y, x), np.nan)
    angles = np.sort(angles, axis=1)  # those that are none come last
    first, last = angles[:, 0], np.nanmax(np.where(there[:, None], angles, 0.0), axis=1)
    gap = np.nan_to_num(np.diff(angles, axis=1), nan=0.0).max(axis=1, initial=0.0)
    inside = np.maximum(gap, first + 2 * np.pi - last) <= np.pi + 1e-9
    return np.asarray(inside & there)
