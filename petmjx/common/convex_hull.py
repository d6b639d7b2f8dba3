"""Convex hulls of points in a plane."""

from __future__ import annotations

from collections.abc import Iterable

Point = tuple[float, float]


def convex_hull(points: Iterable[Point], least_turn: float = 0.0) -> list[Point]:
    """The corners of the hull, anticlockwise from the lowest x (Andrew 1979, "Another efficient algorithm for convex
    hulls in two dimensions", Information Processing Letters 9(5), 216–219).

    Args:
        least_turn: a point at which the way around turns by no more, as the area of the parallelogram of its two sides,
            is no corner.
    """
    ordered = sorted(set(points))
    return _half(ordered, least_turn) + _half(ordered[::-1], least_turn)


def _half(ordered: list[Point], least_turn: float) -> list[Point]:
    """The corners from the first point to the last but one."""
    chain: list[Point] = []
    for x, y in ordered:
        while len(chain) > 1:
            (ax, ay), (bx, by) = chain[-2:]
            if (bx - ax) * (y - by) - (by - ay) * (x - bx) > least_turn:
                break
            chain.pop()
        chain.append((x, y))
    return chain[:-1]
