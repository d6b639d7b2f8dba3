"""Which boxes of a scene bear which, as planned, and how far the loads of boxes are from the edges of what bears them.

The load of a box is its own weight and all that rests on it. It acts at a point of the box's base, its centre of
pressure, and the box is in balance if that lies within the convex hull of what bears it. Where a box has several
supports, statics does not say how they share its load; here as on a bed of equal springs (Winkler 1867, "Die Lehre von
der Elasticität und Festigkeit"): the pressure is a plane over all areas that touch, which force and moments determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.history import CARRIER
from petmjx.plans.overlap import meets
from petmjx.plans.warnings import DEFAULT_TOLERANCE_MM
from petmjx.units import MM_PER_M, FloatArray
from petmjx.world.body import Body
from petmjx.world.scene import Scene

IntArray = NDArray[np.intp]

TOUCH_M: Final = DEFAULT_TOLERANCE_MM / MM_PER_M
"""Faces that are no further apart touch, as in the warnings about a plan."""

_LEAST_OVERLAP_M: Final = 1e-6
_ON_EDGE_M: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Bearing:
    """Who bears whom in a scene of n boxes: c rectangles on which a box lies, in the order of the boxes above.

    Attributes:
        scene: whose planned places count, not where boxes are released.
        upper: (c,) the box above.
        lower: (c,) the box below, whenever it is placed, or ``CARRIER``.
        low, high: (c, 2) corners of the rectangles along x and y, m.
    """

    scene: Scene
    upper: IntArray
    lower: IntArray
    low: FloatArray
    high: FloatArray

    def loads(self, placed: int) -> FloatArray:
        """(n, 4) loads once the first ``placed`` boxes are placed: mass, kg, and its first moments along x, y and z,
        kg·m. 0 for the other boxes."""
        load = self.weights
        load[placed:] = 0.0
        share = self._shares
        for contacts in self._levels:
            upper, lower = self.upper[contacts], self.lower[contacts]
            passed = np.einsum("cij,cj->ci", share[contacts], load[upper, :3])
            height = load[upper, 3] / np.where(load[upper, 0] > 0, load[upper, 0], 1.0)
            np.add.at(load, lower, np.c_[passed, passed[:, 0] * height])
        return load

    @property
    def weights(self) -> FloatArray:
        """(n, 4) the boxes' own weights, as ``loads`` has them."""
        scene = self.scene
        center = scene.target if scene.mass_center is None else scene.target + scene.mass_center
        own: FloatArray = scene.mass[:, None] * np.c_[np.ones(scene.n_boxes), center]
        return own

    def edges_m(self, load: FloatArray) -> FloatArray:
        """(n,) how far inside the nearest edge of what bears it each box's load acts, m: negative beyond it, NaN where
        nothing bears the box, or there is no load."""
        with np.errstate(divide="ignore", invalid="ignore"):
            point = load[:, 1:3] / load[:, :1]
        found = np.full(len(load), np.nan)
        single = np.flatnonzero(self._n_supports[self.upper] == 1)
        alone = self.upper[single]
        found[alone] = np.minimum(point[alone] - self.low[single], self.high[single] - point[alone]).min(axis=1)
        for box, (normal, offset) in self._hulls.items():
            found[box] = (normal @ point[box] - offset).min()
        return found

    @cached_property
    def _hulls(self) -> dict[int, tuple[FloatArray, FloatArray]]:
        """The hulls of the supports of boxes that have several (``_hull_edges``)."""
        begin = np.searchsorted(self.upper, np.arange(self.scene.n_boxes + 1)).tolist()
        return {
            box: _hull_edges(self.low[begin[box] : begin[box + 1]], self.high[begin[box] : begin[box + 1]])
            for box in np.flatnonzero(self._n_supports > 1).tolist()
        }

    @cached_property
    def widths_m(self) -> FloatArray:
        """(n,) extent of what bears each box, along x or y, where it is shorter, m; NaN where nothing does."""
        low, high = np.full((self.scene.n_boxes, 2), np.inf), np.full((self.scene.n_boxes, 2), -np.inf)
        np.minimum.at(low, self.upper, self.low)
        np.maximum.at(high, self.upper, self.high)
        width: FloatArray = (high - low).min(axis=1)
        return np.where(np.isfinite(width), width, np.nan)

    @cached_property
    def _n_supports(self) -> IntArray:
        return np.bincount(self.upper, minlength=self.scene.n_boxes)

    @cached_property
    def _levels(self) -> list[IntArray]:
        """The contacts between boxes, in groups: once all before are done, nothing is added to the upper boxes."""
        level = [0] * self.scene.n_boxes
        at: list[int] = []
        between = np.flatnonzero(self.lower != CARRIER)
        bottom = self.scene.target[:, 2] - self.scene.half_size[:, 2]
        between = between[np.argsort(-bottom[self.upper[between]], kind="stable")]  # from the highest box down
        for upper, lower in zip(self.upper[between].tolist(), self.lower[between].tolist(), strict=True):
            level[lower] = max(level[lower], level[upper] + 1)
            at.append(level[upper])
        order = np.argsort(at, kind="stable")
        return np.split(between[order], np.flatnonzero(np.diff(np.array(at)[order])) + 1) if at else []

    @cached_property
    def _shares(self) -> FloatArray:
        """(c, 3, 3): load of the upper box (mass and moments) → what of it reaches the lower one at this contact."""
        share = np.tile(np.eye(3), (len(self.upper), 1, 1))
        several = self._n_supports[self.upper] > 1
        if not several.any():
            return share
        scene, upper = self.scene, self.upper[several]
        # about the upper box's centre and in its lengths, which keeps the 3 × 3 systems well conditioned
        origin, scale = scene.target[upper, :2], scene.half_size[upper, :2]
        low, high = (self.low[several] - origin) / scale, (self.high[several] - origin) / scale
        middle, length = np.c_[np.ones(len(upper)), (low + high) / 2], high - low
        area = length.prod(axis=1)
        moments = area[:, None, None] * middle[:, :, None] * middle[:, None, :]
        moments[:, [1, 2], [1, 2]] += area[:, None] * length**2 / 12
        whole = np.zeros((scene.n_boxes, 3, 3))
        np.add.at(whole, upper, moments)
        to_global = np.zeros_like(moments)
        to_global[:, 0, 0] = 1.0
        to_global[:, 1:, 0] = origin
        to_global[:, [1, 2], [1, 2]] = scale
        share[several] = to_global @ (moments @ np.linalg.inv(whole[upper])) @ np.linalg.inv(to_global)
        return share


@lru_cache(maxsize=256)
def bearing_of(scene: Scene) -> Bearing:
    """``find_bearing``, kept, since in a sweep many worlds have the same scene."""
    return find_bearing(scene)


def find_bearing(scene: Scene) -> Bearing:
    """Who bears whom, by the planned places.

    A box lies on a board of the carrier's deck if its bottom is not above its top, and on another box that begins lower
    if that one's top is at the height of its bottom; both within ``TOUCH_M``, and if they overlap along x and y.
    """
    low, high = scene.target - scene.half_size, scene.target + scene.half_size
    deck_low, deck_high = _deck(scene.carrier)
    touching = meets(low[:, 2], high[:, 2], TOUCH_M)
    touching &= np.less.outer(low[:, 2], low[:, 2])
    below, above = np.nonzero(touching)
    on_deck, board = (part.ravel() for part in np.indices((len(low), len(deck_low))))
    lying = low[on_deck, 2] <= TOUCH_M
    on_deck, board = on_deck[lying], board[lying]
    upper = np.concatenate([on_deck, above])
    lower = np.concatenate([np.full(len(on_deck), CARRIER), below])
    under_low = np.concatenate([deck_low[board], low[below, :2]])
    under_high = np.concatenate([deck_high[board], high[below, :2]])
    area_low, area_high = np.maximum(low[upper, :2], under_low), np.minimum(high[upper, :2], under_high)
    order = np.lexsort((lower, upper))
    order = order[((area_high - area_low)[order] > _LEAST_OVERLAP_M).all(axis=1)]
    return Bearing(scene, upper[order], lower[order], area_low[order], area_high[order])


def _deck(carrier: Body) -> tuple[FloatArray, FloatArray]:
    """(b, 2) lowest and (b, 2) highest corners of the boards whose tops are the carrier's, m."""
    center = carrier.pos + carrier.shape_pos
    deck = (center + carrier.half_size)[:, 2] >= -TOUCH_M
    return (center - carrier.half_size)[deck, :2], (center + carrier.half_size)[deck, :2]


@lru_cache(maxsize=256)
def plan_edge_m(scene: Scene, placed: int) -> float:
    """How far inside the nearest edge of what bears it a load acts, the least of all boxes, m: by the plan.

    Looked at are each box's own weight, which is all when it is placed, and its load once ``placed`` boxes are.
    Negative: beyond the edge, so that the box falls. NaN: no box lies on anything. Kept, as ``bearing_of`` is.
    """
    return _least_m(bearing_of(scene), placed)


def rest_edge_m(scene: Scene, pos: FloatArray) -> float:
    """The same where the boxes of a pallet that stands have come to rest: (n, 3) centres, m."""
    return _least_m(find_bearing(replace(scene, target=pos)), scene.n_boxes)


def _least_m(bearing: Bearing, placed: int) -> float:
    edges = [bearing.edges_m(load)[:placed] for load in (bearing.weights, bearing.loads(placed))]
    return float(np.fmin.reduce(np.concatenate(edges), initial=np.nan))


def _hull_edges(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edges of the convex hull of rectangles: (e, 2) normals that point inwards, and (e,) their products with points of
    the edges. They are those lines through two corners on one side of which all other corners are."""
    x, y = np.stack([low, high], axis=-1).transpose(1, 0, 2)
    corner = np.stack([np.repeat(x, 2, axis=1).ravel(), np.tile(y, 2).ravel()], axis=1)
    along = corner[None] - corner[:, None]
    length = np.hypot(along[..., 0], along[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.stack([-along[..., 1], along[..., 0]], axis=-1) / length[..., None]
    offset = (normal * corner[:, None]).sum(axis=-1)
    inside = (normal @ corner.T - offset[..., None] >= -_ON_EDGE_M).all(axis=-1) & (length > _ON_EDGE_M)
    return normal[inside], offset[inside]
