"""Plausibility of layouts and units, from overlaps, floating boxes, support, neighbours, the carrier, sizes and
densities.

Costs behave like negative log likelihoods: they are added, and a difference of 1.5 corresponds to odds of 4 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median  # of a few numbers, many times faster than that of NumPy
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.plan_warnings import meets, overlap

_OVERLAP, _FLOAT, _OUTSIDE, _SUPPORT, _TOUCH = 25.0, 20.0, 20.0, 4.0, 2.0
"""Costs of five faults of a layout: boxes overlap, float, are outside the carrier, hang over, or touch no neighbour.
Each value is the cost if all boxes have the fault. In the output of a packer, a box rarely overlaps or floats by
mistake, whereas overhang and gaps are common."""
_TOLERANCE: Final = 0.01
"""Largest gap at which boxes touch, as a share of the median of the boxes' smallest sides: 2 mm for cartons of 200 mm.
Boxes that touch may have a gap in a file, because centres are often rounded to centimetres or half millimetres."""
_SMALL_LOAD: Final = 160
"""Largest number of boxes from which a plan is judged. If a plan has more boxes, its overlaps and supports are judged
from the lowest boxes, and its packing order is judged from the first boxes in the list."""
_CARTON_MM, _CARTON_SPREAD = 280.0, 0.75
"""Geometric mean of a carton's sides, and the standard deviation of its natural logarithm, from BED-BPP's boxes."""
_CARTON_KG_M3, _DENSITY_SPREAD = 250.0, 1.1
"""Density of cartons, kg/m³, and the standard deviation of its natural logarithm."""
_DECKS_MM: Final = (
    (1200.0, 800.0), (1200.0, 1000.0), (800.0, 600.0), (600.0, 400.0), (1219.2, 1016.0), (1100.0, 1100.0),
    (1140.0, 1140.0), (1200.0, 1200.0), (1000.0, 1000.0), (800.0, 700.0), (5898.0, 2352.0), (12032.0, 2352.0),
    (13600.0, 2480.0),
)  # fmt: skip
"""Usual carriers: pallets of Europe, America and Asia, the roll container, sea containers and a trailer."""
_N_COMMON_DECKS: Final = 10
"""Number of carriers at the beginning of ``_DECKS_MM`` that are always considered: the pallets and the roll container.
The other carriers are considered only if the file names them."""
_INCHES_48: Final = 1219.2
"""Length of a pallet of 48 inches, mm."""
_DECK_SPREAD: Final = 0.6
_LARGE_MM: Final = 1000.0
"""The footprint of a load counts as evidence only for carriers at least this long. Smaller carriers are no larger than
two cartons, so a footprint of their size may be chance."""
_NEAR: Final = 0.03
"""A deck counts as a usual deck if its sides differ from the sides of the usual deck by at most this share."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The boxes as one reading gives them, in the file's unit of coordinates, along the plan's axes.

    Attributes:
        low, size: (n, 3) corners and sizes.
        container: sizes of the container along x, y and z; NaN if unknown.
    """

    low: FloatArray
    size: FloatArray
    container: FloatArray

    @cached_property
    def tolerance(self) -> float:
        """The largest gap or overlap that counts as touching: a share of the smallest side of a typical box."""
        return _TOLERANCE * float(median(self.size.min(axis=1).tolist()))


def layout_cost(layout: Layout) -> tuple[float, str, tuple[int, int, int, float]]:
    """Three results: how implausible a layout is; where its origin is; and the counts (overlapping boxes, floating
    boxes, boxes outside, sum of supported shares).

    Heights are measured from the lowest box. If the lowest box is not at 0, the cost is higher.
    """
    low, size = layout.low, layout.size
    tolerance = layout.tolerance
    bottom = _floor_of(low, low + size, tolerance)
    heights = low[:, 2] - bottom
    offset = 0.0
    if abs(bottom) > tolerance:
        extent = float(((low + size).max(axis=0) - low.min(axis=0))[:2].max())
        offset = 1.0 if 0 < bottom < max(1.2 * median(size[:, 2].tolist()), _HIGHEST_DECK * extent) else 4.0
        lowest_box_height = median(size[heights <= tolerance, 2].tolist())
        if min(abs(bottom - lowest_box_height / 2), abs(bottom - lowest_box_height)) <= tolerance:
            offset = 3.0  # heights are probably those of centres or of tops
        half = layout.container[2] / 2
        if not np.isnan(half) and abs(bottom + half) <= 2 * tolerance:
            offset = 0.8
    low = np.column_stack([low[:, :2], heights])
    if len(low) > _SMALL_LOAD:
        lowest = np.argsort(heights, kind="stable")[:_SMALL_LOAD]
        low, size = low[lowest], size[lowest]
    scale = len(layout.low) / len(low)
    high = low + size
    overlapping, floating, supported, touching = _contacts(low, high, tolerance)
    outside, origin_cost, origin = _outside(low, high, layout.container, tolerance)
    n = len(low)
    poor = np.maximum(0.0, 1.0 - supported / 0.75)[~floating].sum() / n
    cost = (
        _odd_cost(overlapping, _OVERLAP)
        + _odd_cost(floating, _FLOAT)
        + _odd_cost(outside, _OUTSIDE)
        + _SUPPORT * poor
        + _TOUCH * (1 - np.count_nonzero(touching) / n) * (n > 1)
        + offset
        + origin_cost
    )
    if offset and origin == "given":
        origin = "floor"
    counts = (
        round(scale * int(overlapping.sum())),
        round(scale * int(floating.sum())),
        round(scale * int(outside.sum())),
        scale * float(supported.sum()),
    )
    return float(cost), origin, counts


def _floor_of(low: FloatArray, high: FloatArray, tolerance: float) -> float:
    """The height of the floor: usually the bottom of the lowest box. Exception: several boxes stand at one level, on no
    other box, and only a few boxes are lower. Then the floor is at this level, and the heights of the few lower boxes
    are errors of the file."""
    bottoms: list[float] = np.sort(low[:, 2]).tolist()
    lowest = dict.fromkeys(bottoms[1 : max(1, int(_FEW_BELOW * len(low))) + 1])
    for level in (level for level in lowest if bottoms[0] < level - tolerance):
        below, at = low[:, 2] < level - tolerance, np.abs(low[:, 2] - level) <= tolerance
        carries = np.repeat(np.abs(high[below, 2] - level)[:, None] <= tolerance, np.count_nonzero(at), axis=1)
        for axis in range(2):
            ends = np.minimum.outer(high[below, axis], high[at, axis])
            carries &= ends - np.maximum.outer(low[below, axis], low[at, axis]) > tolerance
        if np.count_nonzero(~carries.any(axis=0)) >= max(_LEAST_AT_FLOOR, below.sum() + 1):
            return level
    return bottoms[0]


_HIGHEST_DECK: Final = 0.2
"""Largest height of a deck above the level from which heights are measured, as a share of the longest side of the
load: a pallet of 800 mm is 144 mm high."""
_FEW_BELOW: Final = 0.1
"""A level counts as the floor, and the boxes below the level as errors of the file, only if at most this share of all
boxes is below the level."""
_LEAST_AT_FLOOR: Final = 3
"""A level above the lowest box counts as the floor only if at least this number of boxes stand on the level and on no
other box."""
_NEGATIVE_COORDINATE_COST: Final = 1.0
"""Cost of a reading in which corners of boxes have negative coordinates and no container is known. In such a reading,
the origin is not a corner of the deck."""
_ANY_ODD: Final = 1.0
"""Smallest cost of odd boxes, also if one of many boxes is odd."""
_FIRST_ODD, _MORE_ODD = 3.0, 1.5
"""Largest cost of a layout with one odd box (such as a box that overlaps another), and largest additional cost of each
further odd box. The cost is limited, because one plan in 20 has a box that its packer placed wrongly, and because in a
plan with few boxes, one odd box is a large share."""


def _odd_cost(odd: NDArray[np.bool_], weight: float) -> float:
    """Cost of a layout because some of its boxes are odd for one reason, such as overlap.

    Args:
        weight: cost if all boxes are odd.
    """
    count = int(np.count_nonzero(odd))
    share_cost = max(weight * count / len(odd), _ANY_ODD)
    return min(share_cost, _FIRST_ODD + _MORE_ODD * (count - 1)) if count else 0.0


def _contacts(
    low: FloatArray, high: FloatArray, tolerance: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], FloatArray, NDArray[np.bool_]]:
    """Four arrays (n,): whether a box overlaps another one, whether it floats, the supported share of its base, and
    whether it touches a box at a side or has no neighbours. The deck is at height 0."""
    x_wide, y_wide, z_wide = overlap(low.T, high.T, tolerance)
    x_meets, y_meets, z_meets = meets(low.T, high.T, tolerance)
    above = x_wide & y_wide
    np.fill_diagonal(above, False)
    carried = z_meets & above  # rows are lower boxes, columns upper boxes
    lower, upper = np.nonzero(carried)
    common = np.minimum(high[lower], high[upper]) - np.maximum(low[lower], low[upper])
    base = (high - low)[:, 0] * (high - low)[:, 1]
    share = np.fmin(np.bincount(upper, common[:, 0] * common[:, 1], len(low)) / base, 1.0)
    on_deck = np.abs(low[:, 2]) <= tolerance
    share = np.where(on_deck, 1.0, share)
    overlapping = (above & z_wide).any(axis=1)
    floating = ~on_deck & ~carried.any(axis=0) & ~overlapping
    beside = (x_meets & y_wide | y_meets & x_wide) & z_wide
    np.fill_diagonal(z_wide, False)
    touching = beside.any(axis=0) | beside.any(axis=1) | ~z_wide.any(axis=1)
    return overlapping, floating, share, touching


def _outside(
    low: FloatArray, high: FloatArray, container: FloatArray, tolerance: float
) -> tuple[NDArray[np.bool_], float, str]:
    """Three results: (n,) whether boxes are outside the container; the cost of the origin; and where the origin is."""
    if np.isnan(container[:2]).any():
        begin, end = low[:, :2].min(axis=0), high[:, :2].max(axis=0)
        around = bool((begin < -tolerance).all() and (end > tolerance).all())
        # if the origin is a corner of the deck, coordinates are rarely negative
        cost = _NEGATIVE_COORDINATE_COST if (begin < -tolerance).any() else 0.0
        return np.zeros(len(low), bool), cost, "middle" if around else "given"
    # loads may overhang pallets, so an overhang of up to 2 % of a side is no evidence against a reading
    slack = np.maximum(tolerance, 0.02 * container[:2])
    at_corner = ((low[:, :2] < -slack) | (high[:, :2] > container[:2] + slack)).any(axis=1)
    half = container[:2] / 2
    at_middle = ((low[:, :2] < -half - slack) | (high[:, :2] > half + slack)).any(axis=1)
    highest = np.inf if np.isnan(container[2]) else container[2] + 2 * tolerance
    too_high = high[:, 2] > highest
    corner, middle = np.asarray(at_corner | too_high), np.asarray(at_middle | too_high)
    if _odd_cost(middle, _OUTSIDE) + 0.5 < _odd_cost(corner, _OUTSIDE):
        return middle, 0.5, "middle"
    return corner, 0.0, "given"


_HALF_DECKS_MM: Final = (
    np.array([(0.0, 0.0), *(deck[::way] for deck in _DECKS_MM[:_N_COMMON_DECKS] for way in (1, -1))]) / 2
)
"""Half lengths and widths of pallets that lie along x or along y, mm. The first deck has no size."""
_POINTS: Final = np.array([(0.0, 0.0), (0.5, 0.5), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 1.0)])
"""Points of a box that coordinates may describe, as shares of its extents along two axes. The last point is the centre
of the top, if y is the vertical axis."""


def vote_for_other_points(layout: Layout, mm: float, point: FloatArray) -> int:
    """A vote on the point of a box that coordinates describe. The vote is −1 if they probably describe the given point,
    such as a corner; 1 if they probably describe another point; 0 if unknown. The vertical axis may be z or y.

    The result is 1 under two conditions. If coordinates are read as those of the other point, the load begins at a
    corner of the deck, or is symmetric to the origin, along both horizontal axes. If coordinates are read as those of
    the given point, neither is true of the load. The origin may be a corner of the deck, or the middle of a deck.

    Args:
        mm: the unit of the layout's lengths, in millimetres.
        point: the point of a box that the coordinates were assumed to describe, as shares of the box's extents along x,
            y and z. 0 is the near end of the box, 1 the far end.
    """
    tolerance = layout.tolerance
    half_decks = _HALF_DECKS_MM / mm
    if not np.isnan(layout.container[:2]).any():
        half_decks = np.array([(0.0, 0.0), layout.container[:2] / 2])
    fit_given_point = []
    for level in ((0, 1), (0, 2)):
        low, size = layout.low[:, level], layout.size[:, level]
        shifts = point[list(level)] - np.vstack([point[list(level)], _POINTS])
        # (7, n, 2) low corners of the boxes for each of 7 points that coordinates may describe: first the given point,
        # then 6 others
        corners = low + size * shifts[:, None]
        begin, end = corners.min(axis=1), (corners + size).max(axis=1)
        is_symmetric = np.abs(begin + end).max(axis=1) <= tolerance
        begins_a_deck = (np.abs(begin[:, None] + half_decks).max(axis=2) <= tolerance).any(axis=1)
        as_given, *as_others = (is_symmetric | begins_a_deck).tolist()
        if any(as_others) and not as_given:
            return 1
        fit_given_point.append(as_given)
    return -1 if fit_given_point[0] else 0


def order_cost(layouts: Sequence[Layout]) -> float:
    """How implausible it is that the boxes of each layout were placed in the order in which they are listed, or in the
    reversed order. Some files list boxes from the top down.

    Packers mostly place boxes from the ground up. From one box to the next, the height falls in 14 % of the steps in
    plans of the packer ``baseline``, and in 25 % in plans of the packer ``balanced``. Each horizontal coordinate falls
    in 30 % of the steps in plans of ``baseline``, and in 39 % in plans of ``balanced`` (200 plans each, ``petmjx
    samples -n 200 --seed 33901``). If a horizontal coordinate falls less often than the height, the axis of this
    coordinate may really be the vertical axis. A box is hardly ever placed below a box that is listed before it. In
    lists in any other order, such as the order of articles, all axes have about the same cost.
    """
    cost = _cost_in_order(layouts, 1)
    return min(cost, _cost_in_order(layouts, -1)) if cost else 0.0


def are_listed_downwards(layouts: Sequence[Layout]) -> bool:
    """Whether boxes cannot have been placed in the order in which they are listed, but can have been placed in the
    reversed order."""
    return _cost_in_order(layouts, -1) < _EARLY_BOX_COST <= _cost_in_order(layouts, 1)


def _cost_in_order(layouts: Sequence[Layout], direction: int) -> float:
    """The cost of placing boxes in the listed order (``direction`` 1) or in the reversed order (-1)."""
    falls, rises, n_early = np.zeros(3), np.zeros(3), 0
    for layout in layouts:
        tolerance = layout.tolerance
        low, size = layout.low[::direction], layout.size[::direction]
        steps = np.diff(low, axis=0)
        falls += (steps < -tolerance).sum(axis=0)
        rises += (steps > tolerance).sum(axis=0)
        n_early += n_before_support(low[:_SMALL_LOAD], size[:_SMALL_LOAD], tolerance)
    fewest = min((falls[axis] for axis in (0, 1) if rises[axis]), default=math.inf)
    is_ordered = fewest <= _MOST_FALLS * sum(len(layout.low) - 1 for layout in layouts)
    more = float(falls[2] - fewest) / math.sqrt(falls[2] + fewest) if is_ordered and falls[2] > fewest else 0.0
    return min(_FALL_COST * more + _EARLY_BOX_COST * n_early, _LARGEST_ORDER_COST)


_LARGEST_ORDER_COST: Final = 2.4
"""Largest cost of the order in which a file lists boxes. The cost is limited because a right reading can have this
cost, too: some packers build loads up from one side. ``order_cost`` was measured with 200 plans of ``baseline`` and 200
plans of ``balanced``. In 14 plans of ``baseline`` and in 7 plans of ``balanced``, the height falls more often from one
box to the next than a horizontal coordinate does."""
_FALL_COST: Final = 1.5
"""Cost of the order in which boxes are listed, for each standard deviation by which the height falls more often than a
horizontal coordinate."""
_MOST_FALLS: Final = 0.2
"""Boxes count as listed along a horizontal axis only if their coordinates along this axis fall in at most this share of
the steps from one box to the next."""
_EARLY_BOX_COST: Final = 0.8
"""Cost of each box that is listed before a box on which it rests. None of the plans with which ``order_cost`` was
measured has such a box. If these plans are read along another vertical axis, 42 to 46 % (``baseline``) and 66 to 69 %
(``balanced``) of them have such a box."""


def n_before_support(low: FloatArray, size: FloatArray, tolerance: float) -> int:
    """Number of boxes that are listed before a box on which they rest."""
    high = low + size
    carries = meets(low[:, 2], high[:, 2], tolerance)  # rows are lower boxes
    for axis in range(2):
        carries &= overlap(low[:, axis], high[:, axis], tolerance)
    return int(np.count_nonzero(np.tril(carries, -1).any(axis=0)))


def is_wall(layout: Layout) -> bool:
    """Whether boxes stand in one vertical plane, side by side and on several levels. A load is rarely one box deep and
    much wider. So such boxes are probably a flat layer, and another axis is vertical. A tower that leans is no wall."""
    tolerance = layout.tolerance
    is_flat = np.ptp(layout.low, axis=0) <= tolerance
    are_beside = bool((np.diff(np.sort(layout.low[:, 2])) <= tolerance).any())
    extent = (layout.low + layout.size).max(axis=0) - layout.low.min(axis=0)
    is_narrow = 3 * float(extent[:2].min()) <= float(extent[:2].max())
    is_in_plane = not is_flat[2] and is_narrow and bool(is_flat[:2].sum() == 1)
    return len(layout.low) >= _LEAST_OF_WALL and are_beside and is_in_plane


_LEAST_OF_WALL: Final = 4  # fewer boxes may be a bridge, which people build to try a simulator


def share_at_other_heights(layouts: Sequence[Layout]) -> float:
    """Share of plans whose lowest box is not at the height at which most plans of the file have their lowest box. If
    some plans have their lowest box at 0, a plan whose lowest box is at the height of any box of these plans is not
    counted, since it may lack its bottom layer."""
    low = [layout.low[:, 2] for layout in layouts if np.isnan(layout.container[2])]
    if len(low) < 2:
        return 0.0
    tolerance = max(layout.tolerance for layout in layouts)
    bottoms = np.array([heights.min() for heights in low])
    is_alike = np.abs(np.subtract.outer(bottoms, bottoms)) <= tolerance
    at_deck = [heights for heights in low if abs(heights.min()) <= tolerance]
    if at_deck:
        is_alike = np.abs(np.subtract.outer(np.concatenate(at_deck), bottoms)) <= tolerance
        return 1.0 - float(is_alike.any(axis=0).mean())
    return 1.0 - float(is_alike.mean(axis=1).max())


def same_layouts(one: Sequence[Layout], other: Sequence[Layout]) -> bool:
    """Whether two readings give the same piles, except for units, a shift, a mirror image or a turn by 90°."""
    factors = set()
    if [len(layout.low) for layout in one] != [len(layout.low) for layout in other]:
        return False
    for first, second in zip(one, other, strict=True):
        a, b = _normal(first), _normal(second)
        scale = float(np.median(a[1])) / max(float(np.median(b[1])), 1e-300)
        factors.add(round(scale, 6))
        low, size = b[0] * scale, b[1] * scale
        if not any(_near(a, variant) for variant in _images(low, size)):
            return False
    return len(factors) <= 1


def _normal(layout: Layout) -> tuple[FloatArray, FloatArray]:
    return layout.low - layout.low.min(axis=0), layout.size


def _near(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> bool:
    tolerance = _TOLERANCE * float(np.median(one[1]))
    return bool(np.abs(one[0] - other[0]).max() <= tolerance and np.abs(one[1] - other[1]).max() <= tolerance)


def _images(low: FloatArray, size: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the corners and sizes of a pile's boxes, then those of its mirror images and of its turns about the
    vertical axis."""
    for order in ([0, 1, 2], [1, 0, 2]):
        placed, extent = low[:, order], size[:, order]
        end = (placed + extent).max(axis=0)
        for flip_x in (False, True):
            for flip_y in (False, True):
                flipped = placed.copy()
                if flip_x:
                    flipped[:, 0] = end[0] - placed[:, 0] - extent[:, 0]
                if flip_y:
                    flipped[:, 1] = end[1] - placed[:, 1] - extent[:, 1]
                yield flipped, extent


def side_cost(side_mm: float) -> float:
    """How unusual the sizes of boxes are, judged by the geometric mean of their sides."""
    return _squared(side_mm, _CARTON_MM, _CARTON_SPREAD)


def density_cost(density_kg_m3: float) -> float:
    """How unusual a density is for boxes."""
    return _squared(density_kg_m3, _CARTON_KG_M3, _DENSITY_SPREAD)


def _squared(value: float, usual: float, spread: float) -> float:
    """d² / 2, where d = ln(``value`` / ``usual``) / ``spread``."""
    return (math.log(value / usual) / spread) ** 2 / 2 if value > 0 else 50.0


def deck_cost(deck_mm: FloatArray) -> float:
    """Cost of the length and width of a deck (the top of a carrier). The cost is negative for a usual carrier. For
    other decks, it grows with the difference of the length from 1,200 mm."""
    long, short = float(deck_mm.max()), float(deck_mm.min())
    return -2.5 if _is_usual(long, short) else min(_squared(long, 1200.0, _DECK_SPREAD), 6.0)


def footprint_cost(footprint_mm: FloatArray, free_mm: float, unit: str) -> float:
    """Cost of an unusual footprint of a load whose deck is not known. A footprint may be smaller than the deck.

    Args:
        free_mm: shortest horizontal side of any box.
        unit: unit of lengths.
    """
    long, short = float(footprint_mm.max()), float(footprint_mm.min())
    if _fills(long, short, free_mm, unit):
        return _FULL_PALLET_COST
    if any(long <= (1 + _NEAR) * side and short <= (1 + _NEAR) * other for side, other in _DECKS_MM[:_N_COMMON_DECKS]):
        return 0.0
    return 1.0 + min(_squared(long, 1200.0, _DECK_SPREAD), 6.0)


_FULL_PALLET_COST: Final = -0.8
"""Cost of a footprint that leaves no room for one more box on a usual pallet."""
_MOST_FREE: Final = 0.15
"""A footprint fills a pallet only if it leaves free at most this share of each side."""


def _fills(long_mm: float, short_mm: float, free_mm: float, unit: str) -> bool:
    """Whether a footprint leaves no room on a usual pallet for one more box with a side of ``free_mm``. Lengths in
    inches are compared with the pallet of 48 × 40 inches, and other lengths with the other pallets."""
    return any(
        -_NEAR * long < long - long_mm < min(free_mm, _MOST_FREE * long)
        and -_NEAR * short < short - short_mm < min(free_mm, _MOST_FREE * short)
        for long, short in _DECKS_MM[:_N_COMMON_DECKS]
        if long >= _LARGE_MM and (long == _INCHES_48) == (unit in ("in", "ft"))
    )


def _is_usual(long_mm: float, short_mm: float) -> bool:
    """Whether a deck is as large as a usual deck."""
    return any(abs(long_mm / long - 1) < _NEAR and abs(short_mm / short - 1) < _NEAR for long, short in _DECKS_MM)


_LOAD_MM: Final = (1340.0, 1320.0)
"""Largest extents of a load on a pallet along x and y, longer side first. The values are the extents of the largest
pallets plus an overhang of a tenth."""
_HIGHEST_MM: Final = 3000.0


def fits_a_carrier(load_mm: FloatArray) -> bool:
    """Whether a load with these extents along x, y and z fits the largest usual carrier, a trailer."""
    level, largest = np.sort(load_mm[:2]), np.sort(np.max(_DECKS_MM, axis=0))
    return bool(load_mm[2] <= _HIGHEST_MM and (level <= (1 + _NEAR) * largest).all())


_SMALLEST_SIDE_MM, _LARGEST_SIDE_MM = 50.0, 1500.0
"""Limits of the geometric mean of the sides of boxes on pallets."""
_OF_PALLET_MM: Final = (580.0, 1500.0, 380.0, 1320.0)
"""Smallest and largest long side, then smallest and largest short side, of a carrier that could be a pallet."""


def load_fit(side_mm: float, load_mm: FloatArray, deck_mm: FloatArray, known: bool, free_mm: float, unit: str) -> int:
    """How well boxes and a load fit a carrier if lengths are in a certain unit. 0: they do not fit. 1: they fit a
    carrier of unusual size. 2: they fit a usual carrier that is known or that the load fills. Masses do not matter for
    the fit.

    Args:
        side_mm: geometric mean of the boxes' sides.
        load_mm: extents of the load along x, y and z.
        deck_mm: extents along x and y of the carrier if it is ``known``, else of the load.
        free_mm: shortest horizontal side of any box.
        unit: unit of lengths.
    """
    if not _SMALLEST_SIDE_MM <= side_mm <= _LARGEST_SIDE_MM or load_mm[2] > _HIGHEST_MM:
        return 0
    long, short = float(deck_mm.max()), float(deck_mm.min())
    if _is_usual(long, short) if known else _fills(long, short, free_mm, unit):
        return 2
    if known:
        least, most, narrow, wide = _OF_PALLET_MM
        return int(least <= long <= most and narrow <= short <= wide)
    return int(long <= _LOAD_MM[0] and short <= _LOAD_MM[1])


_WHOLE_MM: Final = 0.03
"""A length counts as a whole number of millimetres if it differs from a whole number by at most this length, mm.
Lengths in inches have three decimals, so they are not exact after a conversion to millimetres."""


def converted_share(lengths_mm: FloatArray) -> float:
    """Share of lengths that are whole millimetres. The share is small for lengths that were whole inches. The share is
    1 for lengths in inches that were converted from whole millimetres (600 mm are 23.622 inches)."""
    return float(np.mean(np.abs(lengths_mm - np.rint(lengths_mm)) <= _WHOLE_MM))
