"""Finds candidate places for boxes at the extreme points of many pallets (points at which a new box touches other boxes
or the carrier's edges).

The corner of a box is put above a point, and the box is lowered until it rests on something, as in
``petmjx.packers.baseline_packer``.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.processes import DEFAULT_THREADS, on_threads
from petmjx.common.units import FloatArray
from petmjx.common.warp_setup import machine_code
from petmjx.loop.box_tables import BoxTable
from petmjx.loop.placement_arguments import Placements
from petmjx.packers.pile_balance import SHARE_SLACK, TOUCH_MM

LARGEST_GAP_MM: Final = 1_000.0
"""Largest allowed free space between boxes. A larger space would leave no room for boxes on a pallet."""

_AT_ONCE: Final = 100_000
"""Number of pairs (a point and a box) that are compared at a time. The tables for 100,000 pairs fit into the cache of a
CPU core."""

_WORTH_A_THREAD: Final = 50_000
"""Smallest number of pairs (a point and a box) for which another thread is started."""

_WORTH_COMPILING: Final = 256
"""Smallest number of pallets or of requested boxes for which compiled code is used, if Warp is installed. Compiling
takes some seconds; the code is kept for later runs."""

COMPILED: Final = "petmjx.loop.compiled_places"
"""Name of the module whose compiled code lowers boxes."""

_Lowered = tuple[NDArray[np.intp], FloatArray, FloatArray, NDArray[np.bool_]]


class Places(NamedTuple):
    """c places for m requested boxes. The places of the first box come first. The places of a box are sorted by height,
    then by x, then by y.

    Attributes:
        row: (c,) index of each place's box among the m requested boxes; ``pallet``: (c,) number of the place's pallet.
        corner_mm: (c, 3) position of the box's front-left-bottom corner at the place.
        support: (c,) share of the box's base that would rest on the carrier or on the tops of other boxes.
        centred: (c,) whether the centre of the box's base lies over the convex hull of the areas on which the box would
            rest, as in the criterion ``centre``. If ``centred`` was not requested, it is None.
    """

    row: NDArray[np.intp]
    pallet: NDArray[np.int64]
    corner_mm: FloatArray
    support: FloatArray
    centred: NDArray[np.bool_] | None


def free_places(
    stock: BoxTable,
    placements: Placements,
    extent_mm: tuple[float, float],
    max_height_mm: float,
    grid: FloatArray | None = None,
    *,
    least_support: float = 0.0,
    gap_mm: float = 0.0,
    hulls: bool = True,
) -> Places:
    """Find places for boxes on pallets. ``placements`` has the boxes and their pallets; the corners in ``placements``
    are ignored.

    Args:
        grid: (p, 2) x and y of points, mm, that are used instead of the extreme points.
        least_support: smallest share of a box's base that must be supported.
        gap_mm: free space between a box and its neighbours along x and y.
        hulls: whether to compute ``Places.centred``.
    """
    count = stock.count[placements.pallet]
    if grid is None:
        are_many = max(len(stock.count), len(placements)) >= _WORTH_COMPILING
        code = machine_code(COMPILED) if are_many and not hulls else None
        points = stock.find_points(placements.pallet, gap_mm, code)
        of_each = points.count(placements.pallet)
        if code is not None and len(placements):
            row, corner, support = code.lowered_boxes(
                placements.pallet,
                placements.size_mm,
                *points.tables,
                stock.corner_mm,
                stock.size_mm,
                stock.count,
                (extent_mm[0] + gap_mm, extent_mm[1] + gap_mm),
                max_height_mm,
                least_support,
                gap_mm,
            )
            return Places(row, placements.pallet[row], corner, support, None)
    else:
        of_each = np.full(len(placements), len(grid))
    # pallets with similar numbers of boxes are computed together, which saves time
    order = np.argsort(count, kind="stable")
    n_done = np.cumsum((of_each * (count + 1))[order])
    share = int(n_done[-1] // (2 * DEFAULT_THREADS)) if len(order) else 0
    at_once = min(max(share, _WORTH_A_THREAD), _AT_ONCE)
    free_mm, extent_mm = np.array([gap_mm, gap_mm, 0.0]), (extent_mm[0] + gap_mm, extent_mm[1] + gap_mm)
    chunks = np.split(order, np.flatnonzero(np.diff(n_done // at_once)) + 1) if len(order) else []

    def lowered(rows: NDArray[np.intp]) -> _Lowered:
        pallets, k = placements.pallet[rows], int(count[rows].max())
        low, size = stock.corner_mm[pallets, :k], placements.size_mm[rows] + free_mm
        high = low + stock.size_mm[pallets, :k] + free_mm
        at = points.of(pallets) if grid is None else np.tile(grid[:, 0] + 1j * grid[:, 1], (len(pallets), 1))
        limits = extent_mm, max_height_mm, least_support, gap_mm
        box, corner, support, centred = _lowered_boxes(at, low, high, size, *limits, hulls=hulls)
        return rows[box], corner, support, centred

    parts = on_threads(lowered, chunks[::-1])
    if not parts:
        nothing = np.zeros(0, np.intp)
        return Places(nothing, placements.pallet, np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool) if hulls else None)
    row, corner, support, centred = (np.concatenate(values) for values in zip(*parts, strict=True))
    by_row = np.argsort(row, kind="stable")
    row, corner, support = row[by_row], corner[by_row], support[by_row]
    return Places(row, placements.pallet[row], corner, support, centred[by_row] if hulls else None)


def _lowered_boxes(
    points: NDArray[np.complex128],
    low: FloatArray,
    high: FloatArray,
    size: FloatArray,
    extent_mm: tuple[float, float],
    max_height_mm: float,
    least_support: float,
    gap_mm: float,
    *,
    hulls: bool,
) -> _Lowered:
    """Let each new box down at each point of its pallet until the box rests on something. Returns four values for each
    place: the index of the box; the box's corner; the supported share of its base; and whether the centre of the base
    is over the convex hull of the contact areas.

    Args:
        points: (m, p) points as x + iy; ``low``, ``high``: (m, k, 3) lowest and highest corners of the boxes on the
            pallets; ``size``: (m, 3) sizes of the new boxes. Sizes, highest corners and the carrier's extent include
            the free space ``gap_mm`` along x and y, which cannot support boxes.
    """
    with np.errstate(invalid="ignore"):  # columns beyond a pallet's points and boxes hold NaN
        x, y = points.real, points.imag
        inside = (x + size[:, :1] <= extent_mm[0] + TOUCH_MM) & (y + size[:, 1:2] <= extent_mm[1] + TOUCH_MM)
        box, point = np.nonzero(inside)
        x, y = x[box, point], y[box, point]
        length_x, length_y, height = size[box].T
        x_end, y_end = x + length_x, y + length_y
        # Candidates are the last axis, so that sums over boxes are added in the same order for any number of
        # candidates.
        low_x, low_y = np.take(low[..., :2].transpose(2, 1, 0), box, axis=2)
        high_x, high_y, top = np.take(high.transpose(2, 1, 0), box, axis=2)
        under = (low_x < x_end - TOUCH_MM) & (low_y < y_end - TOUCH_MM)
        under &= (x + TOUCH_MM < high_x) & (y + TOUCH_MM < high_y)
        z = np.where(under, top, 0.0).max(axis=0, initial=0.0)
        useful = z + height <= max_height_mm + TOUCH_MM
        under &= np.where(useful, z - TOUCH_MM, np.inf) <= top
    bearing = np.flatnonzero(under)
    at = bearing % max(len(box), 1)
    low_x, low_y, high_x, high_y = (values.reshape(-1)[bearing] for values in (low_x, low_y, high_x, high_y))
    start = np.column_stack([np.maximum(x[at], low_x), np.maximum(y[at], low_y)])
    end = np.column_stack([np.minimum(x_end[at], high_x), np.minimum(y_end[at], high_y)])
    side = np.maximum(end - start - gap_mm, 0.0)
    base_x, base_y = length_x - gap_mm, length_y - gap_mm
    carried = np.bincount(at, side.prod(axis=1), len(box))
    support = np.where(z > 0, carried / (base_x * base_y), 1.0)
    selected = np.flatnonzero(useful & (support >= least_support - SHARE_SLACK))
    selected = selected[np.lexsort((y[selected], x[selected], z[selected], box[selected]))]
    corner = np.column_stack([x[selected], y[selected], z[selected]])
    if not hulls:
        return box[selected], corner, support[selected], np.zeros(0, bool)
    middle = np.column_stack([x + base_x / 2, y + base_y / 2])
    bears = (side > TOUCH_MM).all(axis=1)
    centred = _over_hull(middle, at[bears], start[bears], start[bears] + side[bears]) | (z <= 0)
    return box[selected], corner, support[selected], centred[selected]


def _over_hull(point: FloatArray, at: NDArray[np.intp], low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """(c,) whether each of c points lies over the convex hull of its rectangles. A point lies over the hull if the
    rectangles' corners, seen from the point, leave no angular gap larger than 180°.

    Args:
        point: (c, 2); ``at``: (q,) index of the point to which each of q rectangles belongs; ``low``, ``high``: (q, 2)
            lowest and highest corners of the rectangles.
    """
    order = np.argsort(at, kind="stable")
    at, low, high = at[order], low[order] - point[at[order]], high[order] - point[at[order]]
    rank = np.arange(len(at)) - np.searchsorted(at, at)
    angles = np.full((len(point), int(rank.max(initial=0)) + 1, 4), np.nan)
    x = np.column_stack([low[:, 0], high[:, 0], low[:, 0], high[:, 0]])
    y = np.column_stack([low[:, 1], high[:, 1], high[:, 1], low[:, 1]])
    angles[at, rank] = np.arctan2(y, x)
    angles = np.sort(angles.reshape(len(point), -1), axis=1)  # NaN values are sorted to the end
    has_angles = np.isfinite(angles[:, 0])
    first, last = angles[:, 0], np.nanmax(np.where(has_angles[:, None], angles, 0.0), axis=1)
    gap = np.nan_to_num(np.diff(angles, axis=1), nan=0.0).max(axis=1, initial=0.0)
    return np.asarray((np.maximum(gap, first + 2 * np.pi - last) <= np.pi + 1e-9) & has_angles)
