"""Convex hulls of points in a plane."""

from __future__ import annotations

from collections.abc import Iterable

Point = tuple[float, float]


def convex_hull(points: Iterable[Point], least_turn: float = 0.0) -> list[Point]:
    """The corners of the convex hull of the points, anticlockwise, beginning at the smallest x.

    The method is by Andrew 1979, "Another efficient algorithm for convex hulls in two dimensions", Information
    Processing Letters 9(5), 216–219.

    Args:
        least_turn: a point counts as a corner if the turn of the outline at the point is larger than this value. The
            turn is the area of the parallelogram spanned by the two sides that meet at the point.
    """
    ordered = sorted(set(points))
    return _half(ordered, least_turn) + _half(ordered[::-1], least_turn)


def _half(ordered: list[Point], least_turn: float) -> list[Point]:
    """The corners of one half of the hull: of the lower half if the points are in ascending order of x, of the upper
    half if they are in descending order. The last point is left out, because the other half begins with it."""
    chain: list[Point] = []
    for x, y in ordered:
        while len(chain) > 1:
            (ax, ay), (bx, by) = chain[-2:]
            if (bx - ax) * (y - by) - (by - ay) * (x - bx) > least_turn:
                break
            chain.pop()
        chain.append((x, y))
    return chain[:-1]
