"""Where the walls of boxes stand, and what stands on them, by the places of the plan.

A carton bears by its walls, and most at its corners. So it matters how much of them has walls of other boxes above,
and how much of them hangs over an edge or over a gap of the deck. Interlayer sheets are passed through: a box on a
sheet stands on the boxes under it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.plans.overlap import meets, shared
from petmjx.plans.plan import Plan

MOST_GAP_MM: Final = 5.0
"""A box stands on what ends no further below it; boxes are let down onto what is there."""

LEAST_SHARED_MM: Final = 1.0
"""Boxes that share less along an axis stand beside each other."""

Span = tuple[float, float]


class Walls(NamedTuple):
    """The walls of n boxes, as shares of their lengths.

    Attributes:
        met: (n,) on which walls of boxes above stand; 1 where nothing stands on the box.
        hanging: (n,) that have nothing below them, beyond the edges of what bears the box.
        over_gaps: (n,) that are over gaps between the boards of the deck.
        on_deck: (n,) whether a box stands on the carrier, perhaps with a sheet between.
    """

    met: FloatArray
    hanging: FloatArray
    over_gaps: FloatArray
    on_deck: NDArray[np.bool_]


def walls_of(
    plan: Plan, extent_mm: tuple[float, float] | None, deck_mm: FloatArray | None, tolerance_mm: float
) -> Walls:
    """The walls of a plan's boxes.

    Args:
        extent_mm: of the carrier along x and y, with its corner in the origin; None: it is as large as the plan.
        deck_mm: (b, 2, 2) lowest and highest corners of the boards of its deck; None: it has no gaps.
        tolerance_mm: walls stand on walls and edges that are no further away.
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
            met[box] = sum(_met(wall, lines, tolerance_mm) for wall in walls) / perimeter
        below = [(low[other, :2], high[other, :2]) for other in np.flatnonzero(on[box])]
        if on_carrier[box] and extent_mm is None:
            continue  # the carrier has the plan's extents
        if on_carrier[box] and extent_mm is not None:
            below.append((np.zeros(2), np.array(extent_mm)))
        if not below:
            continue  # it floats: nobody knows on what it comes to stand
        borne = sum(_over(wall, below, tolerance_mm) for wall in walls)
        hanging[box] = max(0.0, 1.0 - borne / perimeter)
        if on_carrier[box] and deck_mm is not None:
            on_boards = sum(_over(wall, [*below[:-1], *deck_mm], 0.0) for wall in walls)
            over_gaps[box] = max(0.0, 1.0 - hanging[box] - on_boards / perimeter)
    return Walls(met, hanging, over_gaps, on_carrier)


def _stands_on(plan: Plan, low: FloatArray, high: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n, n) whether the row's box stands on the column's, directly or through sheets; (n,) whether on the carrier."""
    beside = (shared(low[:, 0], high[:, 0]) > LEAST_SHARED_MM) & (shared(low[:, 1], high[:, 1]) > LEAST_SHARED_MM)
    touches = meets(low[:, 2], high[:, 2], MOST_GAP_MM).T & beside
    np.fill_diagonal(touches, val=False)
    sheets = plan.sheets
    on, carried = touches.copy(), low[:, 2] <= MOST_GAP_MM
    through = touches & sheets[None, :]
    for _ in range(int(sheets.sum())):  # one more sheet on top of each other at a time
        further = on | ((through.astype(np.int64) @ on.astype(np.int64)) > 0) & beside
        carried = carried | (through & carried[None, :]).any(axis=1)
        if (further == on).all():
            break
        on = further
    return on & ~sheets[None, :] & ~sheets[:, None], carried


class _Wall(NamedTuple):
    """A wall seen from above: a line along an axis.

    Attributes:
        axis: along which it runs.
        at: where it is along the other axis, mm.
        span: from where to where it runs, mm.
    """

    axis: int
    at: float
    span: Span


def _walls(low: FloatArray, high: FloatArray) -> Iterator[_Wall]:
    for axis in (0, 1):
        span = float(low[axis]), float(high[axis])
        yield _Wall(axis, float(low[1 - axis]), span)
        yield _Wall(axis, float(high[1 - axis]), span)


def _met(wall: _Wall, others: list[_Wall], tolerance_mm: float) -> float:
    """The length of a wall on which parallel ones stand, mm."""
    near = [other.span for other in others if other.axis == wall.axis and abs(other.at - wall.at) <= tolerance_mm]
    return _covered(wall.span, near)


def _over(wall: _Wall, areas: list[tuple[FloatArray, FloatArray]], tolerance_mm: float) -> float:
    """The length of a wall that is over areas, from their lowest and highest corners, mm."""
    under = []
    for low, high in areas:
        if low[1 - wall.axis] - tolerance_mm <= wall.at <= high[1 - wall.axis] + tolerance_mm:
            under.append((float(low[wall.axis]) - tolerance_mm, float(high[wall.axis]) + tolerance_mm))
    return _covered(wall.span, under)


def _covered(span: Span, parts: list[Span]) -> float:
    """The length of a span that is covered by parts, which may overlap."""
    reached, total = span[0], 0.0
    for begin, end in sorted(parts):
        begin, end = max(begin, reached), min(end, span[1])
        if end > begin:
            total += end - begin
            reached = end
    return total
