"""A packer whose plans stand: the best box for the lowest place, as long as every box keeps its balance.

At every step all kinds of boxes that are left compete for all corner points (best fit, after Allen, Burke, Kendall
2011, "A hybrid placement strategy for the three-dimensional strip packing problem", European J. of Operational Research
209, 219–227). A low place, a large base, a heavy and a tall box are good; a base that hangs over is bad. The best
candidate is taken that keeps the pile in balance, now and at every step before (:mod:`petmjx.plans.samples.balance`).

Nothing is drawn at random: an order has one plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from petmjx.plans.samples.balance import TOUCH_MM, Balance
from petmjx.plans.samples.candidates import Candidates
from petmjx.plans.samples.orders import Item
from petmjx.plans.samples.packer import MAX_HEIGHT_MM, Placed
from petmjx.units import FloatArray

LEAST_SUPPORT: Final = 0.5
"""Least share of a base that rests on something. The balance is the rule that counts; this one keeps overhangs few."""

# What the features of a candidate are worth, in mm of height of its place. Found by a search at random over 50 sets on
# the first 40 orders of seed 0, by volume utilisation and boxes left out; between neighbours there is little to choose.
_PER_BASE_SIDE: Final = 1.4
"""Per mm of the square root of the base area."""
_PER_LOG_WEIGHT: Final = 40.0
"""Per unit of the natural logarithm of the weight."""
_PER_HEIGHT: Final = 0.25
_PER_OVERHANG: Final = 40.0
"""For a base that hangs over as a whole."""
_PER_DISTANCE: Final = 0.01
"""Per mm of x + y: of places that are equally good, the one nearest to the corner."""


def pack_balanced(items: Sequence[Item], extent_mm: tuple[float, float]) -> list[Placed]:
    """Place the items on a target of ``extent_mm``, in packing order. Items without a place are left out."""
    kinds: dict[Item, list[Item]] = {}
    for item in items:
        kinds.setdefault(item, []).append(item)
    stock = [list(reversed(same)) for same in kinds.values()]
    shapes = [
        (kind, orientation)
        for kind, item in enumerate(kinds)
        for orientation in ((0, 1) if item.length_mm != item.width_mm else (0,))
    ]
    firsts = list(kinds)
    kind_of, turned = np.array(shapes).T
    sizes = np.array([_size(firsts[kind], orientation) for kind, orientation in shapes])
    weight = np.array([firsts[kind].weight_kg for kind in kind_of])

    table = Candidates(sizes[:, :2], sizes[:, 2], extent_mm, len(items))
    pile = Balance(len(items))
    worth = _worth(sizes, weight)
    placed: list[Placed] = []
    while len(kind_of):
        found = _best(table, pile, worth, weight)
        if found is None:
            break
        point, shape = found
        kind = int(kind_of[shape])
        corner = (*table.points[point].tolist(), float(table.z[point, shape]))
        placed.append(Placed(stock[kind].pop(), int(turned[shape]), corner))
        table.place(point, shape)
        if not stock[kind]:
            kept = kind_of != kind
            table.keep_shapes(kept)
            kind_of, turned, weight, worth = kind_of[kept], turned[kept], weight[kept], worth[kept]
    return placed


def _size(item: Item, orientation: int) -> tuple[float, float, float]:
    base = (item.length_mm, item.width_mm)
    return (*(base if orientation == 0 else base[::-1]), item.height_mm)


def _worth(sizes: FloatArray, weight: FloatArray) -> FloatArray:
    """(s,) what shapes are worth wherever they go, in mm; (s, 3) sizes, (s,) weights."""
    side = np.sqrt(sizes[:, 0] * sizes[:, 1])
    worth: FloatArray = _PER_BASE_SIDE * side + _PER_LOG_WEIGHT * np.log(weight) + _PER_HEIGHT * sizes[:, 2]
    return worth


def _best(table: Candidates, pile: Balance, worth: FloatArray, weight: FloatArray) -> tuple[int, int] | None:
    """Point and shape of the best candidate that keeps the balance, which the pile then has; None: there is none."""
    support = table.carried / table.base.prod(axis=1)
    cost = table.z - worth + _PER_OVERHANG * (1 - support) + _PER_DISTANCE * table.points.sum(axis=1)[:, None]
    fits = (table.z + table.height <= MAX_HEIGHT_MM + TOUCH_MM) & (support >= LEAST_SUPPORT - 1e-9)
    cost = np.where(table.open & fits, cost, np.inf)
    while True:
        point, shape = divmod(int(cost.argmin()), len(weight))
        if cost[point, shape] == np.inf:
            return None
        width, depth = table.base[shape].tolist()
        corner = (*table.points[point].tolist(), float(table.z[point, shape]))
        rest = pile.rest(corner, (width, depth), float(weight[shape]))
        if rest is not None:
            pile.add(corner, (width, depth, float(table.height[shape])), rest)
            return point, shape
        table.open[point, shape] = False
        cost[point, shape] = np.inf
