"""Convex hulls of rectangles along x and y."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from petmjx.basics.hull import convex_hull

Edge = tuple[float, float, float]
"""A hull's edge: its normal along x and y, which points inwards, and the normal's product with points of the edge."""

LEAST_EDGE_M: Final = 1e-9
"""Shorter ones are left out: their direction is rounding."""

_Point = Sequence[float]


def hull_edges(low: Sequence[_Point], high: Sequence[_Point]) -> list[Edge]:
    """The edges of the hull of rectangles, by their lowest and highest corners (x, y), m."""
    sides = zip(low, high, strict=True)
    hull = convex_hull((x, y) for (x0, y0), (x1, y1) in sides for x in (x0, x1) for y in (y0, y1))
    edges = []
    for (x0, y0), (x1, y1) in pairwise([*hull, hull[0]]):
        length = math.hypot(x1 - x0, y1 - y0)
        if length > LEAST_EDGE_M:
            normal_x, normal_y = (y0 - y1) / length, (x1 - x0) / length
            edges.append((normal_x, normal_y, normal_x * x0 + normal_y * y0))
    return edges
