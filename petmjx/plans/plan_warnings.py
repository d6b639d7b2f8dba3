"""Warnings about odd plans (``PlanWarnings``): boxes that overlap, float, or are outside the carrier.

Packing algorithms do produce odd plans, and the simulation decides whether these stand. So odd boxes are only counted,
and the plan is not refused. The functions use arrays of one plan: ``corner_mm`` and ``size_mm``, both (n, 3), with rows
in packing order and sizes as placed.

``shared_length`` computes by how much two boxes overlap along an axis, and ``meets`` whether the top of one is at the
bottom of the other. Callers add further conditions: the order of placement, the carrier, or a smallest width.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text, printable_name, three_digits
from petmjx.common.units import FloatArray

if TYPE_CHECKING:
    from petmjx.plans.plan import Plan


def shared_length(low: FloatArray, high: FloatArray) -> FloatArray:
    """(…, n, n) overlap of each pair of boxes along an axis. A negative value is the gap between the two boxes.

    Args:
        low, high: (…, n) lower and upper ends of the boxes along the axis.
    """
    ends, begins = np.minimum(high[..., :, None], high[..., None, :]), np.maximum(low[..., :, None], low[..., None, :])
    length: FloatArray = ends - begins
    return length


def overlap(low: FloatArray, high: FloatArray, tolerance: float = 0.0) -> NDArray[np.bool_]:
    """(…, n, n) whether two boxes overlap along an axis by more than a tolerance. The result equals ``shared_length >
    tolerance``, but no matrix of lengths is made. The overlap of two boxes is the smallest of four distances: from the
    lower end of either box to the upper end of either box.

    Args:
        low, high: (…, n) lower and upper ends of the boxes along the axis.
    """
    over: NDArray[np.bool_]
    if tolerance == 0.0:  # high - low > 0 exactly if high > low, so no differences are computed
        over = high[..., :, None] > low[..., None, :]
        thick = high > low
    else:
        over = high[..., :, None] - low[..., None, :] > tolerance
        thick = high - low > tolerance
    over &= thick[..., :, None]
    return over & np.swapaxes(over, -1, -2)


def meets(
    low: FloatArray, high: FloatArray, tolerance: float, most_gap: float | FloatArray | None = None
) -> NDArray[np.bool_]:
    """(…, n, n) whether the upper end of the row's box meets the lower end of the column's box.

    Args:
        low, high: (…, n) lower and upper ends of the boxes along an axis.
        tolerance: largest length by which the upper end may be above the lower end.
        most_gap: largest length by which the upper end may be below the lower end; None: ``tolerance``.
    """
    over = high[..., :, None] - low[..., None, :]
    touching: NDArray[np.bool_] = (over <= tolerance) & (
        over >= np.negative(tolerance if most_gap is None else most_gap)
    )
    return touching


DEFAULT_TOLERANCE_MM: Final = 0.5
"""Gaps and overlaps up to this size count as touching. Sizes and places in plans are usually whole millimetres, so
larger gaps and overlaps are intended, and not rounding errors."""


_MOST_PAIRS: Final = 1 << 17
"""Number of pairs of boxes that are compared at once. A matrix of numbers then takes 1 MB, which fits into caches."""

MOST_NAMED: Final = 3
"""Largest number of boxes, or of pairs, that a warning names."""


@dataclass(frozen=True, slots=True)
class PlanWarnings:
    """The odd boxes of one plan: their counts, and the names of the first of them.

    Attributes:
        plan_id, source: the plan's id and its file.
        n_overlapping_pairs: pairs of boxes that overlap by more than the tolerance along all three axes.
        n_outside: boxes that reach beyond the carrier or below its top.
        n_floating: boxes that had no support when they were placed.
        overlapping, outside, floating: the first ``MOST_NAMED`` boxes or pairs of each kind, as text: "3 and 7", "3",
            "3 by 100 mm".
    """

    plan_id: str
    source: str
    n_overlapping_pairs: int
    n_outside: int
    n_floating: int
    overlapping: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()
    floating: tuple[str, ...] = ()

    @property
    def any(self) -> bool:
        return bool(self.n_overlapping_pairs or self.n_outside or self.n_floating)

    def __str__(self) -> str:
        counts = (
            (self.n_overlapping_pairs, self.overlapping, "overlapping pair", "overlapping pairs"),
            (self.n_outside, self.outside, "box outside the carrier", "boxes outside the carrier"),
            (self.n_floating, self.floating, "floating box", "floating boxes"),
        )
        oddities = [
            f"{count_text(count, one, many)} ({', '.join([*first, *(['…'] if count > len(first) else [])])})"
            for count, first, one, many in counts
            if count
        ]
        return f"{self.source}: plan {printable_name(self.plan_id)}: {', '.join(oddities) or 'nothing odd'}"


def check_layout(
    plan_id: str,
    source: str,
    corner_mm: FloatArray,
    size_mm: FloatArray,
    carrier_extent_mm: tuple[float, float] | None = None,
) -> PlanWarnings:
    """Count and name the odd boxes of one plan.

    Args:
        carrier_extent_mm: extent of the carrier along x and y, with its corner at the origin. None: the plan's bounding
            box is used as the carrier's extent, so a box can only be outside by being below the carrier's top.
    """
    low, high = corner_mm.T, (corner_mm + size_mm).T
    side_by_side, overlapping = _overlaps(low, high)
    n_pairs = int((np.count_nonzero(overlapping) - np.count_nonzero(_thick_enough(low, high))) // 2)
    outside = _outside(low, high, carrier_extent_mm)
    gap = _gaps(low, high, side_by_side)
    floating = np.flatnonzero(gap > DEFAULT_TOLERANCE_MM)
    first_pairs = np.argwhere(np.triu(overlapping, k=1))[:MOST_NAMED] if n_pairs else ()
    return PlanWarnings(
        plan_id,
        source,
        n_pairs,
        int(np.count_nonzero(outside)),
        len(floating),
        tuple(f"{one} and {other}" for one, other in first_pairs),
        tuple(str(box) for box in np.flatnonzero(outside)[:MOST_NAMED]),
        tuple(f"{box} by {three_digits(gap[box])} mm" for box in floating[:MOST_NAMED]),
    )


def odd_layouts(plans: Sequence[Plan], carrier_extent_mm: tuple[float, float] | None = None) -> list[PlanWarnings]:
    """The results of ``check_layout``, in order, for all plans that have odd boxes. Plans with equal numbers of boxes
    are checked together, which halves the time."""
    numbers = defaultdict[int, list[int]](list)
    for number, plan in enumerate(plans):
        numbers[plan.n_boxes].append(number)
    odd: list[int] = []
    for n_boxes, alike in numbers.items():
        most = max(_MOST_PAIRS // n_boxes**2, 1)
        for first in range(0, len(alike), most):
            group_plans = alike[first : first + most]
            corner = np.stack([plans[number].corner_mm for number in group_plans])
            size = np.stack([plans[number].size_mm for number in group_plans])
            is_odd = _are_odd(corner, size, carrier_extent_mm)
            odd += [number for number, flag in zip(group_plans, is_odd.tolist(), strict=True) if flag]
    return [
        check_layout(plan.plan_id, plan.source, plan.corner_mm, plan.size_mm, carrier_extent_mm)
        for plan in (plans[number] for number in sorted(odd))
    ]


def _are_odd(
    corner_mm: FloatArray, size_mm: FloatArray, carrier_extent_mm: tuple[float, float] | None
) -> NDArray[np.bool_]:
    """(plans,) whether each plan has odd boxes. Corners and sizes are (plans, n, 3)."""
    low, high = np.moveaxis(corner_mm, -1, 0), np.moveaxis(corner_mm + size_mm, -1, 0)
    side_by_side, overlapping = _overlaps(low, high)
    n_thick = np.count_nonzero(_thick_enough(low, high), axis=1)
    overlap = np.count_nonzero(overlapping, axis=(1, 2)) != n_thick
    is_outside = _outside(low, high, carrier_extent_mm)
    floats = _gaps(low, high, side_by_side) > DEFAULT_TOLERANCE_MM
    is_odd: NDArray[np.bool_] = overlap | (is_outside | floats).any(axis=1)
    return is_odd


def gaps_mm(corner_mm: FloatArray, size_mm: FloatArray, in_order: bool = True) -> FloatArray:
    """(n,) gap between each box and its support (a box or the carrier's top), mm; 0 if the support penetrates the box.

    Args:
        in_order: whether only boxes placed earlier can be supports; if not, all boxes can.
    """
    low, high = corner_mm.T, (corner_mm + size_mm).T
    side_by_side, _ = _overlaps(low, high)
    return _gaps(low, high, side_by_side, in_order)


def overlaps_mm(corner_mm: FloatArray, size_mm: FloatArray) -> FloatArray:
    """(n,) largest penetration of each box into another one, mm; 0 if it overlaps none.

    The penetration of two boxes is their overlap along the axis with the smallest overlap.
    """
    low, high = corner_mm.T, (corner_mm + size_mm).T
    depth = np.minimum.reduce([shared_length(low[axis], high[axis]) for axis in range(3)])
    np.fill_diagonal(depth, 0.0)
    deepest: FloatArray = np.maximum(depth.max(axis=0, initial=0.0), 0.0)
    return deepest


def _overlaps(low: FloatArray, high: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(…, n, n) whether two boxes overlap when seen from above, and whether they overlap in all directions. The
    matrices are symmetric. The diagonals, which compare a box with itself, are true for boxes that are thicker than the
    tolerance.

    Args:
        low, high: (3, …, n) ends of the boxes along the axes.
    """
    along_x, along_y, along_z = (overlap(low[axis], high[axis], DEFAULT_TOLERANCE_MM) for axis in range(3))
    side_by_side = along_x & along_y
    return side_by_side, side_by_side & along_z


def _thick_enough(low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """(…, n) whether boxes are larger than the tolerance along all axes."""
    thick_enough: NDArray[np.bool_] = (high - low).min(axis=0) > DEFAULT_TOLERANCE_MM
    return thick_enough


def _outside(low: FloatArray, high: FloatArray, carrier_extent_mm: tuple[float, float] | None) -> NDArray[np.bool_]:
    """(…, n) whether a box reaches beyond the carrier or below its top."""
    outside: NDArray[np.bool_] = low[2] < -DEFAULT_TOLERANCE_MM
    if carrier_extent_mm is not None:
        length, width = (extent + DEFAULT_TOLERANCE_MM for extent in carrier_extent_mm)
        outside |= (low[:2] < -DEFAULT_TOLERANCE_MM).any(axis=0) | (high[0] > length) | (high[1] > width)
    return outside


def _gaps(
    low: FloatArray,
    high: FloatArray,
    side_by_side: NDArray[np.bool_],
    in_order: bool = True,
) -> FloatArray:
    """(…, n) gap between each box and its support, mm.

    The support of a box is the highest top of the boxes under it; if no box is under it, the carrier's top. A box is
    under another box if the two overlap when seen from above, and if its bottom is below the bottom of the other box.

    If a box reaches into another box from below, the upper box counts as overlapping, not as floating. A box that is
    placed before the box under it counts as floating, because it would fall before that box arrives.
    """
    bottom, top = low[2], high[2]
    # Rows are supporting boxes, columns are upper boxes. With ``in_order``, a supporting box must come earlier in
    # packing order.
    below = side_by_side & (bottom[..., :, None] < bottom[..., None, :])
    if in_order:
        below &= ~np.tri(bottom.shape[-1], dtype=bool)
    support = np.where(below, top[..., :, None], 0.0).max(axis=-2, initial=0.0)
    gap: FloatArray = np.maximum(bottom - support, 0.0)
    return gap
