"""Checks packings by geometry and statics, with code of its own. The module also draws orders to pack."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st
from shapely import MultiPoint, Point

from petmjx.packers.baseline_packer import MAX_HEIGHT_MM, PlacedBox
from petmjx.packers.packing_state import LEAST_SUPPORT
from petmjx.packers.pile_balance import MARGIN_M, MARGIN_SHARE
from petmjx.plans.order import TARGET_EXTENT_MM, Item

EPS = 1e-6
EURO = (1200.0, 800.0)

sides = st.integers(60, 600).map(float)
articles = st.builds(
    Item,
    article=st.sampled_from(["jam", "a,b\n", "<b>📦"]),
    item_id=st.uuids().map(str),
    product_group=st.just(""),
    length_mm=sides,
    width_mm=sides,
    height_mm=st.integers(50, 400).map(lambda h: h / 2 + 50),
    weight_kg=st.floats(0.2, 30),
)
orders = st.lists(st.tuples(articles, st.integers(1, 6)), min_size=1, max_size=7).map(
    lambda kinds: [item for item, many in kinds for _ in range(many)]
)
targets = st.sampled_from([*TARGET_EXTENT_MM.values()])


def corners(placed: Sequence[PlacedBox]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) low corners and (n, 3) high corners of the boxes, mm."""
    low = np.array([box.corner_mm for box in placed]).reshape(-1, 3)
    size = []
    for box in placed:
        base = [box.item.length_mm, box.item.width_mm]
        size.append([*(base[::-1] if box.orientation else base), box.item.height_mm])
    return low, low + np.array(size).reshape(-1, 3)


def contacts(low: np.ndarray, high: np.ndarray, box: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(number of the box below, low corner, high corner) of each rectangle on which a box rests."""
    rectangles = []
    for other in range(len(low)):
        start, end = np.maximum(low[box, :2], low[other, :2]), np.minimum(high[box, :2], high[other, :2])
        if other != box and (end - start > EPS).all() and abs(high[other, 2] - low[box, 2]) < EPS:
            rectangles.append((other, start, end))
    return rectangles


def least_slack_mm(placed: Sequence[PlacedBox]) -> float:
    """Smallest distance of a resultant load from the hull of its contacts over all boxes, minus the required margin,
    mm.

    Loads are passed down box by box. If a box has several supports, the pressure is the plane a + b·x + c·y that
    carries its load. The plane is found by numerical quadrature.
    """
    low, high = corners(placed)
    load = np.array([[1.0, *((low[k] + high[k]) / 2)[:2]] for k in range(len(placed))])
    load *= np.array([box.item.weight_kg for box in placed])[:, None]
    worst = np.inf
    for box in reversed(range(len(placed))):
        if low[box, 2] <= 0:
            continue
        below = contacts(low, high, box)
        hull = MultiPoint([(x, y) for _, a, b in below for x in (a[0], b[0]) for y in (a[1], b[1])]).convex_hull
        at = Point(load[box, 1:] / load[box, 0])
        margin = min(1000 * MARGIN_M, MARGIN_SHARE * float((high[box] - low[box])[:2].min()))
        worst = min(worst, hull.exterior.distance(at) * (1 if hull.contains(at) else -1) - margin)
        # Gauss's rule with two points per side is exact for products of two linear functions
        points = [(np.array([1.0, x, y]), area, other) for other, a, b in below for x, y, area in gauss(a, b)]
        plane = np.linalg.solve(sum(area * np.outer(p, p) for p, area, _ in points), load[box])
        for point, area, other in points:
            load[other] += area * (point @ plane) * point
    return worst


def gauss(low: np.ndarray, high: np.ndarray) -> list[tuple[float, float, float]]:
    middle, half = (low + high) / 2, (high - low) / 2 / np.sqrt(3)
    area = float((high - low).prod()) / 4
    return [(middle[0] + i * half[0], middle[1] + j * half[1], area) for i in (-1, 1) for j in (-1, 1)]


def check_sound(
    placed: Sequence[PlacedBox],
    items: Sequence[Item],
    extent: tuple[float, float],
    clearance_mm: float = 0.0,
    least_support: float = LEAST_SUPPORT,
) -> None:
    """Check that a packing is on its target, below 2 m, with clearances, placed from above, supported and balanced at
    every moment, and has no box twice."""
    low, high = corners(placed)
    assert (low >= 0).all()
    assert (high <= np.array([*extent, MAX_HEIGHT_MM]) + EPS).all()
    free = np.array([clearance_mm, clearance_mm, 0.0])
    for first in range(len(placed)):
        shared = np.minimum(high[first], high[first + 1 :]) - np.maximum(low[first], low[first + 1 :])
        assert not (shared + free > EPS).all(axis=1).any(), "boxes overlap"
        # boxes are let down from above, so no box that is placed later lies under this box
        covered = (shared[:, :2] > EPS).all(axis=1) & (low[first, 2] >= high[first + 1 :, 2] - EPS)
        assert not covered.any()
    for box in range(len(placed)):
        if low[box, 2] > 0:
            area = sum(float((b - a).prod()) for _, a, b in contacts(low, high, box))
            # the required share is that of the boxes' base areas with their clearances
            sides = (high[box] - low[box])[:2]
            assert area >= (least_support - 1e-9) * sides.prod() - 2 * clearance_mm * sides.sum()
    # at every moment of the packing, not only at its end
    for count in range(1, len(placed) + 1):
        assert least_slack_mm(placed[:count]) > -EPS
    assert not Counter(box.item for box in placed) - Counter(items), "a box that nobody ordered"
