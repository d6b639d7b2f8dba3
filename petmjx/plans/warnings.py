"""Warnings about plans that are legal but odd: overlapping, overhanging and floating boxes.

Packing algorithms do produce such plans, and physics shall judge them: they are counted, never refused. Everything
here works on plain arrays of one plan: ``corner_mm`` and ``size_mm``, both (n, 3), rows in packing order, sizes as the
boxes stand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petmjx.text import counted
from petmjx.units import FloatArray

DEFAULT_TOLERANCE_MM = 0.5
"""Gaps and overlaps up to this count as touching. Plans are written in whole millimetres, in which neighbours touch:
half of the last digit separates rounding from intent."""


@dataclass(frozen=True, slots=True)
class PlanWarnings:
    """What is odd about one plan, as counts.

    Attributes:
        plan_id, source: which plan, and the file it came from.
        n_overlapping_pairs: pairs of boxes that share more than the tolerance along all three axes.
        n_outside: boxes that reach beyond the carrier or below its top.
        n_floating: boxes with nothing under them at the moment they are placed.
    """

    plan_id: str
    source: str
    n_overlapping_pairs: int
    n_outside: int
    n_floating: int

    @property
    def any(self) -> bool:
        return bool(self.n_overlapping_pairs or self.n_outside or self.n_floating)

    def __str__(self) -> str:
        counts = (
            (self.n_overlapping_pairs, "overlapping pair", "overlapping pairs"),
            (self.n_outside, "box outside the carrier", "boxes outside the carrier"),
            (self.n_floating, "floating box", "floating boxes"),
        )
        found = ", ".join(counted(count, one, many) for count, one, many in counts if count)
        return f"{self.source}: plan {self.plan_id}: {found or 'nothing odd'}"


def check_layout(
    plan_id: str,
    source: str,
    corner_mm: FloatArray,
    size_mm: FloatArray,
    carrier_extent_mm: tuple[float, float] | None = None,
    tolerance_mm: float = DEFAULT_TOLERANCE_MM,
) -> PlanWarnings:
    """Count what is odd about one plan's layout.

    Args:
        carrier_extent_mm: x–y extent of the carrier, whose corner is the origin. None: the carrier is the plan's
            bounding box, so only boxes below its top are outside.
    """
    low, high = corner_mm.T, (corner_mm + size_mm).T
    side_by_side = _shared(low[0], high[0], tolerance_mm) & _shared(low[1], high[1], tolerance_mm)
    return PlanWarnings(
        plan_id,
        source,
        _count_overlapping_pairs(low, high, side_by_side, tolerance_mm),
        _count_outside(low, high, carrier_extent_mm, tolerance_mm),
        _count_floating(low, high, side_by_side, tolerance_mm),
    )


def _shared(low: FloatArray, high: FloatArray, tolerance_mm: float) -> NDArray[np.bool_]:
    """(n, n): whether two boxes share more than the tolerance along one axis."""
    length = np.minimum.outer(high, high) - np.maximum.outer(low, low)
    return length > tolerance_mm


def _count_overlapping_pairs(
    low: FloatArray, high: FloatArray, side_by_side: NDArray[np.bool_], tolerance_mm: float
) -> int:
    both = side_by_side & _shared(low[2], high[2], tolerance_mm)
    thick_enough = ((high - low) > tolerance_mm).all(axis=0)
    # The matrix is symmetric, and its diagonal says of each box whether it overlaps itself.
    return int((np.count_nonzero(both) - np.count_nonzero(thick_enough)) // 2)


def _count_outside(
    low: FloatArray,
    high: FloatArray,
    carrier_extent_mm: tuple[float, float] | None,
    tolerance_mm: float,
) -> int:
    outside = low[2] < -tolerance_mm
    if carrier_extent_mm is not None:
        outside |= (low[:2] < -tolerance_mm).any(axis=0)
        outside |= (high[0] > carrier_extent_mm[0] + tolerance_mm) | (high[1] > carrier_extent_mm[1] + tolerance_mm)
    return int(np.count_nonzero(outside))


def _count_floating(low: FloatArray, high: FloatArray, side_by_side: NDArray[np.bool_], tolerance_mm: float) -> int:
    """Boxes above the carrier's top that no earlier box supports from below.

    A box into which another one reaches from below counts as overlapping, not as floating. A box that is placed before
    the box under it floats: placed one by one, it falls.
    """
    bottom, top = low[2], high[2]
    begins_below = np.less.outer(bottom, bottom)
    reaches_up = np.greater_equal.outer(top, bottom - tolerance_mm)
    # Row: supporter, column: the box above it; supporters are earlier in packing order.
    supports = np.triu(side_by_side & begins_below & reaches_up, k=1)
    return int(np.count_nonzero((bottom > tolerance_mm) & ~supports.any(axis=0)))
