"""The static balance of a pile (``Balance``). A pile is in balance if the load of each box acts inside the convex hull
of the box's supports.

The criterion is mechanical equilibrium (Ramos, Oliveira, Gonçalves, Lopes 2016, "A container loading algorithm with
static mechanical equilibrium constraints", Transportation Research Part B 91, 565–581). The load of a box is the
resultant of its own weight and of all forces on its top. The load must act inside the convex hull of the areas on which
the box stands. This module also requires a margin: the load must act some distance inside the edges of the hull.
Statics does not determine how a box distributes its load among the boxes below. This module assumes that the pressure
under a box's base is a linear function of x and y, p = a + b·x + c·y. A bed of equal springs has such a pressure
(Winkler 1867, "Die Lehre von der Elasticität und Festigkeit"). The force and the moments of this pressure balance the
load. On two narrow supports, this assumption gives the lever rule.

A load is a vector (F, F·x, F·y), where (x, y) is the point at which the force F acts. The load that a box passes to a
box below is a linear function of its own load: a 3 × 3 matrix. ``Balance`` stores the products of these matrices, from
each box to all boxes below. So adding a box takes only a few small products, however high the pile is. Forces are given
in kg, since the factor g cancels, and lengths in m.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.convex_hull import convex_hull
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.packers.fill_interface import Count

TOUCH_MM: Final = 1e-6
"""Tolerance of lengths for rounding errors of float64 sums, mm. Tops whose heights differ by less than this tolerance
count as equally high. Overlaps smaller than the tolerance are ignored."""

SHARE_SLACK: Final = 1e-9
"""Tolerance for rounding errors of supported shares: a share may be lower than the smallest allowed share by at most
this number."""

MARGIN_M: Final = 0.020
MARGIN_SHARE: Final = 0.2
"""How far inside the hull of its supports the load of a box must act: ``MARGIN_M``, or ``MARGIN_SHARE`` of the base's
shorter side if that is smaller. A margin of 10 mm was enough for all of 60 plans to stand, if at least 0.6 of each base
was supported. The larger ``MARGIN_M`` allows for the errors of a robot."""

FAR_M: Final = 0.2
"""Upper limit of computed margins against tipping, m. A box on the carrier has the margin ``FAR_M``."""

SAME_PLACE_DECIMALS: Final = 9
"""Number of decimals to which corners in m are rounded, that is, to a nanometre. The algorithm of the hull processes
points from left to right. Without rounding, the algorithm could lose a point that is further left than other points by
a distance too small for products in float64."""

LEAST_TURN_M2: Final = 1e-12
"""Smallest cross product, m², of two successive edges of the hull at a corner. If the cross product is smaller, the two
edges differ only by rounding, so the point between them counts as a point of a single edge, not as a corner."""

SLACK_KG_M: Final = 1e-9
"""Tolerance for rounding errors when a load is compared with an edge, kg·m."""


class Rest(NamedTuple):
    """The effect of one more box on the balance.

    Attributes:
        load: (3,) the box's own weight as a load: kg, kg·m, kg·m.
        passed: (n, 3, 3) for each of the n earlier boxes, the matrix that turns a load of the new box into the part
            that the earlier box carries. ``passed`` is None if the new box stands on the carrier.
        planes: (k, 3) edges of the hull of the box's supports, moved inwards by the margin. The scalar product of an
            edge's row with a load is ≤ 0 if the load acts inside the moved edge.
    """

    load: FloatArray
    passed: FloatArray | None
    planes: FloatArray


class Margins(NamedTuple):
    """The margins against tipping of a pile with one more box.

    Attributes:
        rest: the effect of the box on the balance; None if the box has no support.
        own_m: distance of the new box's own weight from the nearest edge of the hull of this box's supports, m;
            negative outside the hull.
        pile_m: smallest distance of any earlier box's load from the nearest edge of the hull of that earlier box's
            supports, m.
    """

    rest: Rest | None
    own_m: float
    pile_m: float


class Balance:
    """The boxes placed so far, and the loads that they pass to the boxes below.

    Args:
        capacity: largest number of boxes.
    """

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
        """An independent copy."""
        twin, n = copy.copy(self), self.n
        twin._low, twin._high = self._low.copy(), self._high.copy()
        twin._top_mm, twin._load = self._top_mm.copy(), self._load.copy()
        twin._passed = np.zeros_like(self._passed)  # pages of zeros that are never written take no memory
        twin._passed[:n, :n] = self._passed[:n, :n]
        return twin

    def write(self, tables: Mapping[str, NDArray[Any]]) -> None:
        """Copy the balance into arrays with the layout of :mod:`petmjx.packers.fill_interface`."""
        n, planes = self.n, len(self._planes)
        tables["counts"][Count.PLANES] = planes
        tables["low_m"][:n], tables["high_m"][:n] = self._low[:n], self._high[:n]
        tables["top"][:n], tables["load"][:n] = self._top_mm[:n], self._load[:n]
        tables["passed"][:n, :n] = self._passed[:n, :n].reshape(n, n, 9)
        tables["planes"][:planes], tables["owner"][:planes] = self._planes, self._owner

    @property
    def loads(self) -> FloatArray:
        """(n, 3) load of each box, which is its own weight and all forces on its top: kg, kg·m, kg·m."""
        return self._load[: self.n]

    def rest(self, corner_mm: tuple[float, float, float], base_mm: tuple[float, float], mass_kg: float) -> Rest | None:
        """The effect of one more box on the balance. The result is None if the new box or a box below would tip over.

        Args:
            corner_mm: lowest corner of the box, mm. The box stands on all tops at the height of its bottom.
            base_mm: sides of the box's base along x and y, mm.
            mass_kg: mass of the box.
        """
        let_down = self._let_down(corner_mm, base_mm, mass_kg)
        if corner_mm[2] <= 0:
            return let_down
        if let_down is None or tips(let_down.planes, let_down.load):
            return None
        # All loads are compared at once: the load of each box of the pile with the edges of the hull of its supports.
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
        """The margins against tipping with one more box, m, at most ``FAR_M``. With a negative margin, a box tips.

        Args:
            corner_mm, base_mm, mass_kg: the box, as for the method ``rest``.
            rest: what the method ``rest`` has returned for this box. ``rest`` is None if the method was not called, or
                if the box or a box below would tip.
        """
        let_down = rest or self._let_down(corner_mm, base_mm, mass_kg)
        if let_down is None:  # the box has no support
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
        """(k,) for each edge of a hull in the pile, the scalar product of the edge and a load, kg·m. The edges are
        moved inwards by the margin (see ``Rest.planes``). The load is the load of the box that stands on this hull,
        after one more box is placed. If the product is above 0, the load acts outside the moved edge."""
        assert let_down.passed is not None
        after = self._load[: self.n] + let_down.passed @ let_down.load
        excess: FloatArray = np.einsum("kc,kc->k", self._planes, after[self._owner])
        return excess

    def _let_down(
        self, corner_mm: tuple[float, float, float], base_mm: tuple[float, float], mass_kg: float
    ) -> Rest | None:
        """The effect of one more box on the balance, even if the new box or another box would tip over. The result is
        None if the new box has no support."""
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
        if len(under) == 1:  # if there is only one support, it carries the whole load
            passed = self._passed[under[0], :n]
        else:
            moments = pressure_moments(low, high)
            shares = moments @ np.linalg.inv(moments.sum(axis=0))
            passed = np.matmul(self._passed[under, :n], shares[:, None]).sum(axis=0)
        return Rest(load, passed, planes)

    def add(self, corner_mm: tuple[float, float, float], size_mm: tuple[float, float, float], rest: Rest) -> None:
        """Place the box for which ``rest`` was computed."""
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
    """Whether a load acts outside the hull whose edges, moved inwards by the margin, are ``planes`` (as in
    ``Rest.planes``)."""
    return bool((planes @ load).max() > 0)


def margin_m(base_mm: tuple[float, float]) -> float:
    """Smallest distance, m, by which the load of a box with the base ``base_mm`` must act inside the hull of the box's
    supports."""
    return min(MARGIN_M, MARGIN_SHARE * (min(base_mm) / MM_PER_M))


def pressure_moments(low: FloatArray, high: FloatArray) -> FloatArray:
    """(c, 3, 3) integral ∫ (1, x, y)ᵀ (1, x, y) dA over each of c rectangles.

    Args:
        low, high: (c, 2) lowest and highest corners of the rectangles, m.
    """
    middle, side = (low + high) / 2, high - low
    ones = np.concatenate([np.ones((len(low), 1)), middle], axis=1)
    moments = ones[:, :, None] * ones[:, None, :]
    moments[:, 1, 1] += side[:, 0] ** 2 / 12
    moments[:, 2, 2] += side[:, 1] ** 2 / 12
    result: FloatArray = moments * side.prod(axis=1)[:, None, None]
    return result


def hull_planes(low: FloatArray, high: FloatArray, margin: float) -> FloatArray:
    """The edges of the convex hull of c rectangles, moved inwards by ``margin``.

    Args:
        low, high: (c, 2) lowest and highest corners of the rectangles, m.
        margin: distance by which edges are moved, m.

    Returns:
        (k, 3) a row (d, n_x, n_y) for each edge. A point p lies beyond the moved edge by d + n · p, m.
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
