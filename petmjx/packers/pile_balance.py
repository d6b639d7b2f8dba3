"""Whether a pile keeps its balance: loads go down from box to box, and each must press inside what it stands on.

The criterion is that of mechanical equilibrium (Ramos, Oliveira, Gonçalves, Lopes 2016, "A container loading algorithm
with static mechanical equilibrium constraints", Transportation Research Part B 91, 565–581): below every box, the
resultant of its weight and of all loads on it must act within the convex hull of its contacts; here at least a margin
inside. How a box shares its load out among the boxes below it is not determined by statics. As on a bed of equal
springs (Winkler 1867, "Die Lehre von der Elasticität und Festigkeit"), the pressure under its base is taken as a plane,
p = a + b·x + c·y, with the force and the moments of the load; on two narrow supports that is the lever rule.

So a load is a vector (F, F·x, F·y), and what a box passes on to each box below is linear in its load. ``Balance`` keeps
the products of these 3 × 3 matrices, from each box to all below it: one more box is judged with a few small products,
however high the pile is. Forces are in kg (without g, which cancels), lengths in metres.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.convex_hull import convex_hull
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.packing_tables import Count

TOUCH_MM: Final = 1e-6
"""Tops closer than this have the same height, and smaller overlaps do not count: rounding errors of float64 sums."""

SHARE_SLACK: Final = 1e-9
"""A supported share may be smaller than the least one by so much: rounding errors, too."""

MARGIN_M: Final = 0.020
MARGIN_SHARE: Final = 0.2
"""How far inside the hull a resultant must act: 20 mm, for small boxes this share of the shorter side. With 10 mm and a
least support of 0.6 all of 60 plans stood as well; the margin is for what a robot does."""

FAR_M: Final = 0.2
"""Margins are not said to be larger: that of a box on the carrier."""

SAME_PLACE_DECIMALS: Final = 9
"""Corners are the same where they are as near as a nanometre. The hull takes points from left to right, and would lose
one that is to the left of others by less than its products resolve."""

LEAST_TURN_M2: Final = 1e-12
"""A corner at which the hull turns by less lies on an edge: rounding errors of its coordinates' products."""

SLACK_KG_M: Final = 1e-9


class Rest(NamedTuple):
    """A box that would keep the balance.

    Attributes:
        load: (3,) its own weight as a load.
        passed: (n, 3, 3) from a load on it to what reaches each of the n boxes placed before; None on the carrier.
        planes: (k, 3) the edges of its hull, moved inward; the product with a load is ≤ 0 inside.
    """

    load: FloatArray
    passed: FloatArray | None
    planes: FloatArray


class Margins(NamedTuple):
    """How far from tipping over a pile with one more box would be.

    Attributes:
        rest: what the box would do; None: there is nothing under it.
        own_m: how far inside its hull its weight acts.
        pile_m: the same of all boxes below, the least of them.
    """

    rest: Rest | None
    own_m: float
    pile_m: float


class Balance:
    """The boxes placed so far, and the load that each passes on."""

    def __init__(self, capacity: int) -> None:
        self.n = 0
        self._low = np.zeros((capacity, 2))
        self._high = np.zeros((capacity, 2))
        self._top_mm = np.zeros(capacity)
        self._load = np.zeros((capacity, 3))
        self._passed = np.zeros((capacity, capacity, 3, 3))
        self._planes = np.zeros((0, 3))
        self._owner: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._moved = np.zeros(0)

    def copy(self) -> Balance:
        """The same pile, which goes its own way."""
        twin, n = copy.copy(self), self.n
        twin._low, twin._high = self._low.copy(), self._high.copy()
        twin._top_mm, twin._load = self._top_mm.copy(), self._load.copy()
        twin._passed = np.zeros_like(self._passed)  # pages that nobody writes cost nothing
        twin._passed[:n, :n] = self._passed[:n, :n]
        return twin

    def write(self, tables: Mapping[str, NDArray[Any]]) -> None:
        """Write everything into :mod:`petmjx.packers.packing_tables`."""
        n, planes = self.n, len(self._planes)
        tables["counts"][Count.PLANES] = planes
        tables["low_m"][:n], tables["high_m"][:n] = self._low[:n], self._high[:n]
        tables["top"][:n], tables["load"][:n] = self._top_mm[:n], self._load[:n]
        tables["passed"][:n, :n] = self._passed[:n, :n].reshape(n, n, 9)
        tables["planes"][:planes], tables["owner"][:planes] = self._planes, self._owner

    @property
    def loads(self) -> FloatArray:
        """(n, 3) own weight and all loads from above of each box: kg, kg·m, kg·m."""
        return self._load[: self.n]

    def rest(self, corner_mm: tuple[float, float, float], base_mm: tuple[float, float], mass_kg: float) -> Rest | None:
        """What one more box would do, let down on the tops at its height; None: it or a box below would tip over."""
        let_down = self._let_down(corner_mm, base_mm, mass_kg)
        if corner_mm[2] <= 0:
            return let_down
        if let_down is None or tips(let_down.planes, let_down.load):
            return None
        # the load of a plane's owner against that plane, for all hulls of the pile at a time
        if len(self._planes) and self._over_planes(let_down).max() > SLACK_KG_M:
            return None
        return let_down

    def margins_m(
        self,
        corner_mm: tuple[float, float, float],
        base_mm: tuple[float, float],
        mass_kg: float,
        rest: Rest | None = None,
    ) -> Margins:
        """How far inside the hulls of their contacts loads would act if one more box were let down, in metres, at most
        ``FAR_M``; negative: outside, so that a box tips over.

        Args:
            rest: what ``rest`` said of the box, where that is known.
        """
        let_down = rest or self._let_down(corner_mm, base_mm, mass_kg)
        if let_down is None:  # on nothing
            return Margins(let_down, -FAR_M, FAR_M)
        box_margin = pile = FAR_M
        if len(let_down.planes):
            box_margin = margin_m(base_mm) - float((let_down.planes @ let_down.load).max()) / mass_kg
        if len(self._planes) and let_down.passed is not None:
            after = self._load[:, 0][: self.n] + (let_down.passed @ let_down.load)[:, 0]
            beyond = self._over_planes(let_down) / after[self._owner]
            pile = float((self._moved - beyond).min())
        return Margins(let_down, min(box_margin, FAR_M), min(pile, FAR_M))

    def _over_planes(self, let_down: Rest) -> FloatArray:
        """(k,) what each plane of the pile says of its owner's load with one more box: above 0 is outside."""
        assert let_down.passed is not None
        after = self._load[: self.n] + let_down.passed @ let_down.load
        excess: FloatArray = np.einsum("kc,kc->k", self._planes, after[self._owner])
        return excess

    def _let_down(
        self, corner_mm: tuple[float, float, float], base_mm: tuple[float, float], mass_kg: float
    ) -> Rest | None:
        """What one more box would do, whether it keeps the balance or not; None: there is nothing under it."""
        n = self.n
        corner = np.array(corner_mm[:2]) / MM_PER_M
        base = np.array(base_mm) / MM_PER_M
        load = mass_kg * np.array([1.0, *(corner + base / 2)])
        if corner_mm[2] <= 0:
            return Rest(load, None, np.zeros((0, 3)))
        low, high = np.maximum(self._low[:n], corner), np.minimum(self._high[:n], corner + base)
        touch = TOUCH_MM / MM_PER_M
        side = high - low > touch
        below = side[:, 0] & side[:, 1] & (np.abs(self._top_mm[:n] - corner_mm[2]) <= TOUCH_MM)
        under = np.flatnonzero(below)
        if not len(under):
            return None
        low, high = low[under], high[under]
        planes = hull_planes(low, high, margin_m(base_mm))
        if len(under) == 1:  # which takes the whole load
            passed = self._passed[under[0], :n]
        else:
            moments = _moments(low, high)
            shares = moments @ np.linalg.inv(moments.sum(axis=0))
            passed = np.matmul(self._passed[under, :n], shares[:, None]).sum(axis=0)
        return Rest(load, passed, planes)

    def add(self, corner_mm: tuple[float, float, float], size_mm: tuple[float, float, float], rest: Rest) -> None:
        """Put the box down that ``rest`` is about."""
        n = self.n
        self._low[n] = np.array(corner_mm[:2]) / MM_PER_M
        self._high[n] = self._low[n] + np.array(size_mm[:2]) / MM_PER_M
        self._top_mm[n] = corner_mm[2] + size_mm[2]
        self._passed[n, n] = np.eye(3)
        self._load[n] = rest.load
        if rest.passed is not None:
            self._passed[n, :n] = rest.passed
            self._load[:n] += rest.passed @ rest.load
            self._planes = np.concatenate([self._planes, rest.planes])
            self._owner = np.concatenate([self._owner, np.full(len(rest.planes), n)])
            moved = margin_m((size_mm[0], size_mm[1]))
            self._moved = np.concatenate([self._moved, np.full(len(rest.planes), moved)])
        self.n += 1


def tips(planes: FloatArray, load: FloatArray) -> bool:
    """Whether a box with that load tips over the edges of its hull."""
    return bool((planes @ load).max() > 0)


def margin_m(base_mm: tuple[float, float]) -> float:
    """How far inside its hull the load of a box with that base must act."""
    return min(MARGIN_M, MARGIN_SHARE * (min(base_mm) / MM_PER_M))


def _moments(low: FloatArray, high: FloatArray) -> FloatArray:
    """∫ (1, x, y)ᵀ (1, x, y) dA over each of c rectangles, (c, 2) low and high corners: (c, 3, 3)."""
    middle, side = (low + high) / 2, high - low
    ones = np.concatenate([np.ones((len(low), 1)), middle], axis=1)
    moments = ones[:, :, None] * ones[:, None, :]
    moments[:, 1, 1] += side[:, 0] ** 2 / 12
    moments[:, 2, 2] += side[:, 1] ** 2 / 12
    result: FloatArray = moments * side.prod(axis=1)[:, None, None]
    return result


def hull_planes(low: FloatArray, high: FloatArray, margin: float) -> FloatArray:
    """The edges of the convex hull of rectangles, each moved inward by ``margin``.

    Args:
        low, high: (c, 2) corners.

    Returns:
        (k, 3) rows (d, n_x, n_y): d + n · p is how far p lies beyond the edge that was moved.
    """
    lows, highs = np.round(low, SAME_PLACE_DECIMALS).tolist(), np.round(high, SAME_PLACE_DECIMALS).tolist()
    corners = [(x, y) for (x0, y0), (x1, y1) in zip(lows, highs, strict=True) for x in (x0, x1) for y in (y0, y1)]
    ring = convex_hull(corners, LEAST_TURN_M2)
    planes = []
    for (ax, ay), (bx, by) in zip(ring, ring[1:] + ring[:1], strict=True):
        length = ((bx - ax) ** 2 + (by - ay) ** 2) ** 0.5
        nx, ny = (by - ay) / length, (ax - bx) / length
        planes.append((margin - nx * ax - ny * ay, nx, ny))
    return np.array(planes).reshape(-1, 3)
