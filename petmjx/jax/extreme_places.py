"""Finds candidate places for a box at the extreme points of a pile, as seen from all four corners of the carrier. At an
extreme point, a box touches other boxes or the carrier's edges. The module is an array program in JAX.

The extreme points are as in ``petmjx.packers.learned_candidates``, for the pile and for its three mirror images
(Crainic, Perboli, Tadei 2008, "Extreme point-based heuristics for three-dimensional bin packing", INFORMS Journal on
Computing 20(3), 368–384). With the extreme points as seen from a single corner, narrow useless strips would remain
along the opposite edges of the carrier.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from petmjx.common.units import MM_PER_M
from petmjx.jax.free_cells import TOUCH_MM, TURNS, Pile, Ways
from petmjx.jax.pile_statics import Statics, contacts_of, hull_planes, least_m, margins_m, no_boxes, with_box
from petmjx.packers.learned_candidates import MIRRORS, OVERHANG_MM

FEATURES: Final = ("turned", "x", "y", "z", "length_x", "length_y", "height", "mass", "support", "inside", "below")
"""Features of a candidate (a box at a place): whether the box is turned by 90°; its corner and its extents, mm; its
mass, kg; and the supported share of its base. ``inside`` is the distance of the box's centre of mass from the edge of
the hull of the box's contacts, mm. ``below`` is 200 mm if the candidate stands on the carrier. Otherwise, the candidate
is put onto the pile, and for each box of the pile, the distance of the box's load from the edge of the hull of the
box's contacts is computed. ``below`` is the smallest of these distances, mm. All distances are positive inside a hull,
negative outside, and at most 200 mm."""

_PER_ASIDE: Final = 0.01
"""Cost of a millimetre of distance from the nearest edges of the carrier, as millimetres of height. Because distances
have a cost, the place nearest to the edges is preferred among equally low places (``cost_mm`` of
petmjx/packers/learned_candidates.py)."""

PLACES_PER_CANDIDATE: Final = 3
"""Number of places that are examined for each candidate that is wanted. More places than candidates are examined
because some places have too little support."""

_FAR: Final = 1e9
"""A number with two uses. It is the cost of a place that cannot be used. It is also the x and y, mm, of points that do
not exist, so that these points are beyond the edges of every carrier."""


class Points(NamedTuple):
    """The extreme points of a pile. ``at`` (p, 2) has their x and y as seen from a corner of the carrier, mm.
    ``mirrored`` (p, 2) tells whether x and y are mirrored, which identifies the corner."""

    at: Float[Array, "point 2"]
    mirrored: Bool[Array, "point 2"]


class View(NamedTuple):
    """Values that do not depend on the next box: the extreme points, the pile, and the pile's balance."""

    points: Points
    pile: Pile
    statics: Statics


class Candidates:
    """Finds the n places for a box that have the lowest cost. A place has a low cost if it is low, has much support,
    and is near the carrier's edges.

    Args:
        extent_mm: extent of the carrier along x and y.
        gap_mm: free space between a box and its neighbours along x and y.
        least_support: smallest share of a box's base that must be supported. If ``least_support`` is None, any
            supported share is sufficient.
        inside_mm: how far inside the convex hull of its contacts the load of a box must act, mm. A fifth of the shorter
            side of the box's base is always enough. If ``inside_mm`` is 0, loads may act anywhere.

    Attributes:
        count: number n of actions.
        features: names of the features of an action.
    """

    features = FEATURES

    def __init__(
        self,
        extent_mm: tuple[float, float],
        count: int,
        max_height_mm: float,
        least_support: float | None,
        gap_mm: float,
        inside_mm: float,
    ) -> None:
        self.count, self._highest, self._least = count, max_height_mm, least_support or 0.0
        self._gap = jnp.array([[gap_mm, gap_mm, 0.0]], jnp.float32)
        # Boxes are enlarged by a gap on their far sides, so the extent is enlarged by one gap, too.
        self._extent = jnp.asarray([extent_mm], jnp.float32) + gap_mm
        self._inside = inside_mm

    def no_boxes(self, most: int) -> Statics:
        """The balance of an empty pile, with room for ``most`` boxes."""
        return no_boxes(most)

    def put(
        self, statics: Statics, row: Array, size_mm: Array, corner_mm: Array, mass_kg: Array, pile: Pile
    ) -> Statics:
        """The balance of the pile after one more box, whose values are stored in row ``row``. If ``row`` is beyond the
        last row, the box is ignored. ``pile`` does not contain the new box."""
        contacts = contacts_of(size_mm[None], corner_mm[None], pile)
        return with_box(statics, row, contacts, mass_kg, least_m(size_mm[None], self._inside)[0])

    def view(self, pile: Pile, statics: Statics) -> View:
        """The values for ``ways`` that do not depend on the next box."""
        return View(self._points(pile), pile, statics)

    def _points(self, pile: Pile) -> Points:
        """The extreme points of a pile. Each box has extreme points of its own. Only boxes that were placed before a
        box can be obstacles for its points."""
        k = len(pile.present)
        low, high = pile.corner_mm, pile.corner_mm + pile.size_mm + self._gap
        earlier = (jnp.arange(k)[None] < jnp.arange(k)[:, None]) & pile.present[None]

        def seen_from(mirror: jax.Array) -> jax.Array:
            start = jnp.where(mirror[None], self._extent - high[:, :2], low[:, :2])
            end = jnp.where(mirror[None], self._extent - low[:, :2], high[:, :2])
            points = _corner_points(start, end, low[:, 2], high[:, 2], earlier)
            points = jnp.where(pile.present[None, :, None], points, _FAR)
            return jnp.concatenate([jnp.zeros((1, 2)), points.reshape(-1, 2)])

        mirrors = jnp.array(MIRRORS)
        at = jax.vmap(seen_from)(mirrors)
        return Points(at.reshape(-1, 2), jnp.broadcast_to(mirrors[:, None], at.shape).reshape(-1, 2))

    def ways(self, view: View, size_mm: Float[Array, " 3"], mass_kg: Float[Array, ""]) -> Ways:
        """The actions for a box of size ``size_mm``. If the size is 0, there are no legal actions."""
        points, pile, statics = view
        sizes = jnp.stack([size_mm, size_mm[jnp.array([1, 0, 2])]])
        bases = (sizes + self._gap)[:, None, :2]
        at = jnp.where(points.mirrored[None], (self._extent - points.at)[None] - bases, points.at[None])  # (2, p, 2)
        corner = at.reshape(-1, 2)
        base = jnp.broadcast_to(bases, at.shape).reshape(-1, 2)
        turned = jnp.repeat(jnp.arange(TURNS), len(points.at))
        cost, z = self._costs(corner, base, pile)
        fits = (corner >= -TOUCH_MM).all(axis=1) & (corner + base <= self._extent + TOUCH_MM).all(axis=1)
        fits &= (z + size_mm[2] <= self._highest + TOUCH_MM) & (size_mm[2] > 0)
        fits &= (turned == 0) | (size_mm[0] != size_mm[1])
        chosen, is_place = self._cheapest(jnp.where(fits, cost, _FAR), corner, z, turned)
        size = sizes[turned[chosen]]
        corner = jnp.concatenate([jnp.maximum(corner[chosen], 0.0), z[chosen, None]], axis=1)
        contacts = contacts_of(size, corner, pile)
        inside, below, is_far_enough = margins_m(statics, contacts, hull_planes(contacts), mass_kg)
        legal = is_place & (contacts.support >= self._least - 1e-6)
        if self._inside > 0:
            legal &= is_far_enough & (inside >= least_m(size, self._inside) - TOUCH_MM / MM_PER_M)
        first = jnp.argsort(~legal, stable=True)[: self.count]
        mass = jnp.broadcast_to(mass_kg, (len(legal), 1))
        margins = MM_PER_M * jnp.stack([inside, below], axis=1)
        columns = [turned[chosen, None], corner, size, mass, contacts.support[:, None], margins]
        features = jnp.where(legal[:, None], jnp.concatenate(columns, axis=1), 0.0)
        return Ways(legal[first], size[first], corner[first], features[first])

    def _costs(
        self, corner: Float[Array, "place 2"], base: Float[Array, "place 2"], pile: Pile
    ) -> tuple[Float[Array, " place"], Float[Array, " place"]]:
        """(p,) the cost of each place, and (p,) the height at which the box's bottom would be, mm. In this method, the
        size of a box includes the gap to its neighbours."""
        lows, highs = pile.corner_mm, pile.corner_mm + pile.size_mm + self._gap
        end = corner + base
        area = jnp.broadcast_to(jnp.where(pile.present[None], 1.0, 0.0), (len(corner), len(lows)))
        for axis in (0, 1):
            ends = jnp.minimum(end[:, axis, None], highs[None, :, axis])
            side = ends - jnp.maximum(corner[:, axis, None], lows[None, :, axis])
            area = jnp.where(side > TOUCH_MM, area * side, 0.0)
        tops = jnp.broadcast_to(highs[None, :, 2], area.shape)
        z = jnp.where(area > 0, tops, 0.0).max(axis=1)
        carried = jnp.where(jnp.abs(tops - z[:, None]) <= TOUCH_MM, area, 0.0).sum(axis=1)
        support = jnp.where(z > 0, carried / jnp.maximum(base.prod(axis=1), 1.0), 1.0)
        aside = jnp.minimum(corner, self._extent - end).sum(axis=1)
        cost = z + OVERHANG_MM * (1.0 - support) + _PER_ASIDE * aside
        return jnp.where(support >= self._least - 1e-6, cost, _FAR), z

    def _cheapest(
        self, cost: Float[Array, " place"], corner: Float[Array, "place 2"], z: Float[Array, " place"], turned: Array
    ) -> tuple[Array, Bool[Array, " action"]]:
        """(q,) the indices of the q places with the lowest cost, and (q,) whether each place can be used. Each place is
        listed once, although several points may give the same place. To leave out repeated places, the method takes the
        cheapest remaining place again and again. On a GPU, this is also faster than sorting all places."""

        def take(cost: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
            best = cost.argmin()
            same = (jnp.abs(corner - corner[best][None]) <= TOUCH_MM).all(axis=1) & (turned == turned[best])
            return jnp.where(same, _FAR, cost), (best, cost[best] < _FAR)

        return jax.lax.scan(take, cost, None, length=PLACES_PER_CANDIDATE * self.count)[1]


def _corner_points(
    start: Float[Array, "box 2"],
    end: Float[Array, "box 2"],
    bottom: Float[Array, " box"],
    top: Float[Array, " box"],
    earlier: Bool[Array, "box box"],
) -> Float[Array, "7 box 2"]:
    """The same as ``petmjx.packers.candidate_points.corner_points`` for all boxes of one pile, as an array program.

    Args:
        start, end: lowest and highest x and y of the boxes.
        bottom, top: heights of the boxes' bottoms and tops.
        earlier: row i tells which boxes may be obstacles for the points of box i.
    """
    (x, y), (x_end, y_end) = start.T, end.T
    # Four points of each box slide until they meet an obstacle. Beside the box, one point starts at (x_end, y) and
    # slides towards −y, and one starts at (x, y_end) and slides towards −x. On top of the box, two points start at
    # (x, y): one slides towards −y, the other towards −x.
    axes, levels = jnp.array([1, 0, 0, 1]), jnp.stack([bottom, bottom, top, top])[..., None]
    begins, across = jnp.stack([y, x, x, y])[..., None], jnp.stack([x_end, y_end, y, x])[..., None]
    lows, highs, ends = start.T[1 - axes][:, None], end.T[1 - axes][:, None], end.T[axes][:, None]
    in_way = earlier[None] & (lows <= across) & (across < highs)
    in_way &= (bottom[None, None] <= levels) & (levels < top[None, None])
    south, west, west_on_top, south_on_top = jnp.where(in_way & (ends <= begins + TOUCH_MM), ends, 0.0).max(axis=2)
    beside = [(x_end, y), (x_end, south), (x, y_end), (west, y_end)]
    pairs = [*beside, (x, y), (west_on_top, y), (x, south_on_top)]
    return jnp.stack([jnp.stack(pair, axis=1) for pair in pairs])
