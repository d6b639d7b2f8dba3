"""The walls of stacked cartons: how much of each box's walls is loaded and supported.

A carton bears load through its walls, and mostly at its corners. So ``walls_of`` computes two shares of a box's walls
from the plan: the share on which walls of other boxes stand, and the share that nothing supports. A part of a wall has
no support if it sticks out beyond an edge, or lies over a gap between the boards of the carrier. A box on an interlayer
sheet stands on the boxes under the sheet.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import meets, shared_length

MOST_GAP_MM: Final = 5.0
"""Largest vertical gap between a box and the body on which it stands, mm. (In the simulation, each box is lowered until
it touches the body below.)"""

LEAST_SHARED_MM: Final = 1.0
"""Smallest overlap along x and y, seen from above, of a box and the box on which it stands, mm."""

Span = tuple[float, float]


class Walls(NamedTuple):
    """How the walls of n boxes are loaded and supported. Each share is a share of the total length of the four walls of
    a box.

    Attributes:
        met: (n,) share of each box's walls on which walls of the boxes above stand; 1 if nothing stands on the box.
        hanging: (n,) share of each box's walls that sticks out beyond the boxes or the carrier on which the box stands.
        over_gaps: (n,) share of each box's walls that is over gaps between the boards of the carrier's deck.
        on_deck: (n,) whether a box stands on the carrier, directly or on a sheet.
    """

    met: FloatArray
    hanging: FloatArray
    over_gaps: FloatArray
    on_deck: NDArray[np.bool_]


def walls_of(
    plan: Plan, extent_mm: tuple[float, float] | None, deck_mm: FloatArray | None, tolerance_mm: float
) -> Walls:
    """Compute how the walls of a plan's boxes are loaded and supported.

    Args:
        extent_mm: extents of the carrier along x and y; the carrier's corner is at the origin. If ``extent_mm`` is
            None, the carrier is as large as the plan.
        deck_mm: (b, 2, 2) lowest and highest corners of the b boards of the deck. If ``deck_mm`` is None, the deck has
            no gaps.
        tolerance_mm: largest horizontal distance between a wall and the lower wall or edge that bears the wall, mm.
    """
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    on, on_carrier = _stands_on(plan, low, high)
    n = plan.n_boxes
    met, hanging, over_gaps = np.ones(n), np.zeros(n), np.zeros(n)
    for box in range(n):
        walls = list(_walls(low[box], high[box]))
        perimeter = 2.0 * float(plan.size_mm[box, :2].sum())
        above = np.flatnonzero(on[:, box])
        if len(above):
            lines = [wall for other in above for wall in _walls(low[other], high[other])]
            met[box] = sum(_met_length(wall, lines, tolerance_mm) for wall in walls) / perimeter
        below = [(low[other, :2], high[other, :2]) for other in np.flatnonzero(on[box])]
        if on_carrier[box] and extent_mm is None:
            continue  # without ``extent_mm``, the carrier is as large as the plan, so no wall sticks out beyond it
        if on_carrier[box] and extent_mm is not None:
            below.append((np.zeros(2), np.array(extent_mm)))
        if not below:
            continue  # the box floats in the plan, so nothing is known about its support
        borne = sum(_over(wall, below, tolerance_mm) for wall in walls)
        hanging[box] = max(0.0, 1.0 - borne / perimeter)
        if on_carrier[box] and deck_mm is not None:
            on_boards = sum(_over(wall, [*below[:-1], *deck_mm], 0.0) for wall in walls)
            over_gaps[box] = max(0.0, 1.0 - hanging[box] - on_boards / perimeter)
    return Walls(met, hanging, over_gaps, on_carrier)


def _stands_on(plan: Plan, low: FloatArray, high: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Two arrays: (n, n) whether the box of the row stands on the box of the column; and (n,) whether each box stands
    on the carrier. A box may stand on a body directly, or with sheets in between."""
    beside = (shared_length(low[:, 0], high[:, 0]) > LEAST_SHARED_MM) & (
        shared_length(low[:, 1], high[:, 1]) > LEAST_SHARED_MM
    )
    touches = meets(low[:, 2], high[:, 2], MOST_GAP_MM).T & beside
    np.fill_diagonal(touches, val=False)
    sheets = plan.sheets
    on, carried = touches.copy(), low[:, 2] <= MOST_GAP_MM
    through = touches & sheets[None, :]
    for _ in range(int(sheets.sum())):  # each pass looks through one more sheet of a stack of sheets
        further = on | ((through.astype(np.int64) @ on.astype(np.int64)) > 0) & beside
        carried = carried | (through & carried[None, :]).any(axis=1)
        if (further == on).all():
            break
        on = further
    return on & ~sheets[None, :] & ~sheets[:, None], carried


class _Wall(NamedTuple):
    """A wall of a box, seen from above: a line along x or y.

    Attributes:
        axis: number of the axis along which the wall runs, which is 0 for x and 1 for y.
        at: the wall's coordinate along the other axis, mm.
        span: begin and end of the wall along ``axis``, mm.
    """

    axis: int
    at: float
    span: Span


def _walls(low: FloatArray, high: FloatArray) -> Iterator[_Wall]:
    for axis in (0, 1):
        span = float(low[axis]), float(high[axis])
        yield _Wall(axis, float(low[1 - axis]), span)
        yield _Wall(axis, float(high[1 - axis]), span)


def _met_length(wall: _Wall, others: list[_Wall], tolerance_mm: float) -> float:
    """The total length of the parts of a wall on which parallel walls of boxes above stand, mm."""
    near_spans = [other.span for other in others if other.axis == wall.axis and abs(other.at - wall.at) <= tolerance_mm]
    return _covered_length(wall.span, near_spans)


def _over(wall: _Wall, areas: list[tuple[FloatArray, FloatArray]], tolerance_mm: float) -> float:
    """The total length of the parts of a wall that lie over at least one of the areas, mm. Each area is given by its
    lowest and its highest corner."""
    under = []
    for low, high in areas:
        if low[1 - wall.axis] - tolerance_mm <= wall.at <= high[1 - wall.axis] + tolerance_mm:
            under.append((float(low[wall.axis]) - tolerance_mm, float(high[wall.axis]) + tolerance_mm))
    return _covered_length(wall.span, under)


def _covered_length(span: Span, parts: list[Span]) -> float:
    """The length of the part of a span that is covered by other spans, mm. The covering spans may overlap each
    other."""
    reached, total = span[0], 0.0
    for begin, end in sorted(parts):
        begin, end = max(begin, reached), min(end, span[1])
        if end > begin:
            total += end - begin
            reached = end
    return total
