"""Supports of boxes in a plan, the loads on these supports, and the distances of loads from the supports' edges.

A support of a box is a body below the box that touches its base. The load of a box is its own weight plus the weight
that rests on it. The load acts at a point of the box's base, the centre of pressure. The box is in balance if its
centre of pressure lies within the convex hull of its supports. Statics does not determine how several supports share a
load. This module assumes that supports share a load like a bed of equal springs (Winkler 1867, "Die Lehre von der
Elasticität und Festigkeit"): the pressure varies linearly over all areas that touch. The balance of force and moments
determines this pressure. If springs would have to pull somewhere, the module computes the pushing forces with the least
energy instead (petmjx.world.pushing_forces).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.simulation import Simulation, Thresholds
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM
from petmjx.world.body_shapes import Body
from petmjx.world.friction_pairs import LARGER
from petmjx.world.history import CARRIER
from petmjx.world.pushing_forces import ON_EDGE_M, on_edges, pulls, pushes
from petmjx.world.rectangle_hulls import HullTable, hull_table
from petmjx.world.scene import Scene, carrier_of, half_size_and_target, slab_places

IntArray = NDArray[np.intp]

TOUCH_M: Final = DEFAULT_TOLERANCE_MM / MM_PER_M
"""Largest distance between two faces that count as touching, m. The warnings about plans use the same distance."""

LEANS_M: Final = Thresholds().shift_m
"""Largest gap between a box and a wall that can stop the box from tipping, m. A box that tips across a gap of this
width moves by less than the shift threshold."""

_LEAST_OVERLAP_M: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Boxes:
    """The n boxes of s scenes, scene after scene.

    Attributes:
        first: (s + 1,) number of each scene's first box; the last entry is n.
        target: (n, 3) planned middles of the boxes, m.
        half_size: (n, 3) half extents of the boxes, m.
        mass: (n,) masses of the boxes, kg.
        mass_center: (n, 3) vector from each box's middle to its centre of mass, m.
        carrier_mass: (n,) mass of the carrier in each box's scene, kg.
        wall_allowance: (n, 2, 2) how far beyond a box's supports its load may act while a wall still keeps the box from
            tipping, m. Axis 1 is the low and the high end, axis 2 is x and y.
    """

    first: IntArray
    target: FloatArray
    half_size: FloatArray
    mass: FloatArray
    mass_center: FloatArray
    carrier_mass: FloatArray
    wall_allowance: FloatArray

    @classmethod
    def of(cls, scenes: Sequence[Scene], targets: Sequence[FloatArray]) -> Boxes:
        """The boxes of scenes. ``targets`` has the (n, 3) planned middles of each scene's boxes, m."""
        mass = [scene.mass for scene in scenes]
        counts = [*map(len, mass)]
        first = np.concatenate([[0], np.cumsum(counts)])
        centred, wall_allowance = np.zeros((first[-1], 3)), np.zeros((first[-1], 2, 2))
        for scene, target, begin, n in zip(scenes, targets, first.tolist(), counts, strict=False):
            if scene.mass_center is not None:
                centred[begin : begin + n] = scene.mass_center
            if scene.carrier.walls:
                wall_allowance[begin : begin + n] = _wall_allowances(scene, target)
        return cls(
            first,
            np.concatenate(targets),
            np.concatenate([scene.half_size for scene in scenes]),
            np.concatenate(mass),
            centred,
            np.repeat([scene.carrier.mass for scene in scenes], counts),
            wall_allowance,
        )

    def of_scenes(self, numbers: IntArray) -> tuple[Boxes, IntArray]:
        """The boxes of the scenes ``numbers``, in this order, and (k,) the numbers of these boxes in this object."""
        counts = np.diff(self.first)
        rows = spans(counts, numbers)
        first = np.concatenate([[0], np.cumsum(counts[numbers])])
        names = [field.name for field in fields(self) if field.name != "first"]
        return Boxes(first, *(getattr(self, name).take(rows, axis=0) for name in names)), rows

    @cached_property
    def bottom(self) -> FloatArray:
        """(n,) heights of the boxes' planned bottoms, m."""
        low: FloatArray = (self.target - self.half_size)[:, 2]
        return low

    @cached_property
    def has_wall_allowance(self) -> bool:
        """Whether a wall keeps any of the boxes from tipping."""
        return bool(self.wall_allowance.any())

    def among(self, placed: int | Sequence[int]) -> NDArray[np.bool_]:
        """(n,) whether each box is one of the first ``placed`` boxes of its scene."""
        counts = np.diff(self.first)
        number = np.arange(self.first[-1]) - np.repeat(self.first[:-1], counts)
        among: NDArray[np.bool_] = number < np.repeat(np.broadcast_to(placed, len(counts)), counts)
        return among


def _wall_allowances(scene: Scene, target: FloatArray) -> FloatArray:
    """(n, 2, 2) how far beyond a box's supports its load may act while a wall keeps the box from tipping, m
    (``Boxes.wall_allowance``), in a scene with walls. ``target`` has the (n, 3) middles of the boxes, m.

    If the load W of a box acts at a distance e beyond an edge of the supports, the box tips until it touches the wall
    on that side. The box touches the wall at its own top or at the wall's top, whichever is lower. The point at which
    the box touches the wall is a height h above the box's bottom. The wall then presses on the box with the force
    W·e/h, which friction at the edge must balance. So the wall holds the box as long as e is at most µ·h. This limit
    assumes a smooth wall and a support that does not move.
    """
    room, half = scene.carrier.room, scene.half_size
    bottom, top = (target - half)[:, 2], (target + half)[:, 2]
    height = np.minimum(top[:, None, None], room.top) - bottom[:, None, None]
    return np.where(room.gaps(target, half, TOUCH_M) <= LEANS_M, _least_friction(scene)[:, None, None] * height, 0.0)


def _least_friction(scene: Scene) -> FloatArray:
    """(n,) smallest coefficient of sliding friction between each box and any body on which it may stand."""
    friction = scene.friction[:, 0]
    if scene.surface is None or scene.pair_friction is None:
        return friction
    of_pairs = np.where(scene.pair_friction == LARGER, np.inf, scene.pair_friction).min(axis=1)[scene.surface]
    return np.where(np.isfinite(of_pairs), of_pairs, friction)


@dataclass(frozen=True, eq=False)
class Bearing:
    """The contacts between boxes and their supports, in one or several scenes with n boxes in all.

    A contact is the rectangle in which a box touches a body below it. The c contacts are sorted by their upper boxes.

    Attributes:
        boxes: the boxes at their planned places, not at the places of their release.
        upper: (c,) number of the box above each contact.
        lower: (c,) number of the box below each contact, even if it is placed later, or ``CARRIER``.
        low, high: (c, 2) lowest and highest corner (x, y) of each rectangle, m.
    """

    boxes: Boxes
    upper: IntArray
    lower: IntArray
    low: FloatArray
    high: FloatArray

    def loads(self, placed: int | Sequence[int]) -> FloatArray:
        """(n, 4) loads of the boxes when the first ``placed`` boxes of each scene are in place.

        A load is a mass, kg, and the mass's first moments along x, y and z, kg·m: mass × coordinates of the point at
        which the load acts. The loads of boxes that are not in place are 0.
        """
        load = self.weights
        load[~self.boxes.among(placed)] = 0.0
        for between, together in zip(self.levels, self.borne_together, strict=True):
            upper, lower = self.upper.take(between), self.lower.take(between)
            passed = load.take(upper, axis=0)
            height = passed[:, 3] / np.where(passed[:, 0] > 0, passed[:, 0], 1.0)
            if len(together):
                shared = np.flatnonzero(self.n_supports.take(upper) > 1)
                passed[shared, :3] = self.forces(load, together)[np.searchsorted(together, between[shared])]
            passed[:, 3] = passed[:, 0] * height
            add_rows(load, lower, passed)
        return load

    @property
    def weights(self) -> FloatArray:
        """(n, 4) the boxes' own masses, kg, and their first moments along x, y and z, kg·m, as in ``loads``."""
        boxes = self.boxes
        centre = boxes.target + boxes.mass_center
        weights: FloatArray = boxes.mass[:, None] * np.concatenate([np.ones((len(centre), 1)), centre], axis=1)
        return weights

    def forces(self, load: FloatArray, together: IntArray) -> FloatArray:
        """(k, 3) for each contact in ``together``, the part of the upper box's load that the contact carries: mass, kg,
        and first moments along x and y, kg·m.

        Args:
            load: (n, 3 or 4) loads of all boxes, as in ``loads``.
            together: (k,) numbers of contacts, rising. The box above each of these contacts has several supports, and
                all contacts below this box are included.
        """
        upper, low, high = self.upper[together], self.low.take(together, axis=0), self.high.take(together, axis=0)
        under = load.take(upper, axis=0)[:, :3]
        force = self.shared(together, under)
        pulled = np.unique(upper[pulls(force, low, high, under[:, 0])])
        if len(pulled):
            chosen = np.flatnonzero(np.isin(upper, pulled))
            owner = np.searchsorted(pulled, upper[chosen])
            under = load.take(pulled, axis=0)[:, :3]
            force[chosen] = self.pushed(under, pulled, owner, low.take(chosen, axis=0), high.take(chosen, axis=0))
        return force

    def shared(self, contact: IntArray, load: FloatArray) -> FloatArray:
        """(k, 3) the part of the upper box's load that each contact carries if supports share loads like equal springs.

        Args:
            contact: (k,) numbers of contacts whose upper boxes have several supports.
            load: (k, 3) load of the upper box of each contact.
        """
        number = np.searchsorted(self.together, contact)
        part: FloatArray = np.einsum("cij,cj->ci", self.shares.take(number, axis=0), load)
        return part

    def pushed(
        self, load: FloatArray, boxes: IntArray, owner: IntArray, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        """(k, 3) the part of the upper box's load that each contact carries if supports can push but not pull.

        Args:
            load: (p, 3) load of each box in ``boxes``.
            boxes: (p,) numbers of boxes that have several supports.
            owner: (k,) index in ``boxes`` of the box above each contact. Contacts are sorted by ``owner``.
            low, high: (k, 2) lowest and highest corner (x, y) of each contact's rectangle, m.
        """
        force, hull = np.zeros((len(owner), 3)), self.number_of_hull[boxes]
        within = self.hulls.inside_m(hull, load[:, 1:] / load[:, :1]) > ON_EDGE_M
        for chosen in (within, ~within):
            if chosen.any():
                is_chosen = np.flatnonzero(chosen[owner])
                rows = low.take(is_chosen, axis=0), high.take(is_chosen, axis=0)
                contact_args = load[chosen], (np.cumsum(chosen) - 1)[owner[is_chosen]], *rows
                force[is_chosen] = (
                    pushes(*contact_args) if chosen is within else on_edges(*contact_args, self.hulls, hull[chosen])
                )
        return force

    def edges_m(self, load: FloatArray) -> FloatArray:
        """(n,) distance of each box's load from the nearest edge of the box's supports, m: positive inside, negative
        outside. The distance is NaN for a box without supports or load."""
        with np.errstate(divide="ignore", invalid="ignore"):
            point = load[:, 1:3] / load[:, :1]
        return self.inside_m(np.arange(len(load)), point)

    def inside_m(self, box: IntArray, point: FloatArray) -> FloatArray:
        """(p,) distance of each of p points from the nearest edge of a box's supports, m: positive inside, negative
        outside.

        Args:
            box: (p,) number of the box for each point.
            point: (p, 2) points (x, y), m.
        """
        low, high = self.rectangles
        nearer = np.minimum(point - low.take(box, axis=0), high.take(box, axis=0) - point)
        distance_m: FloatArray = np.minimum(nearer[:, 0], nearer[:, 1])  # faster than ``min(axis=1)`` of two columns
        several = np.flatnonzero(self.n_supports.take(box) > 1)
        if len(several):
            hull = self.number_of_hull[box[several]]
            wider: FloatArray | float = 0.0
            if self.boxes.has_wall_allowance:
                allowance = self.boxes.wall_allowance[box[several]]
                outward = -self.hulls.normal[hull]
                wider = (
                    np.maximum(outward, 0.0) * allowance[:, None, 1] - np.minimum(outward, 0.0) * allowance[:, None, 0]
                ).sum(axis=2)
            distances_m = self.hulls.distances_m(hull, point.take(several, axis=0)) + wider
            distance_m[several] = distances_m.min(axis=1, initial=np.inf)
        return distance_m

    @cached_property
    def rectangles(self) -> tuple[FloatArray, FloatArray]:
        """(n, 2) lowest and (n, 2) highest corner (x, y) of the rectangle in which the load of a box must act, m.

        While the load acts inside the rectangle, the support or a wall keeps the box from tipping. The corners of boxes
        with no support or several supports are NaN.
        """
        low, high = np.full((len(self.boxes.mass), 2), np.nan), np.full((len(self.boxes.mass), 2), np.nan)
        alone = np.flatnonzero(self.n_supports == 1)
        contact = self.ends[alone]
        low[alone], high[alone] = self.low.take(contact, axis=0), self.high.take(contact, axis=0)
        if self.boxes.has_wall_allowance:
            low, high = low - self.boxes.wall_allowance[:, 0], high + self.boxes.wall_allowance[:, 1]
        return low, high

    @cached_property
    def hulls(self) -> HullTable:
        """The convex hulls of the supports, one for each box with several supports, in the order of boxes."""
        low, high = self.low.take(self.together, axis=0), self.high.take(self.together, axis=0)
        return hull_table(low, high, self.n_supports[self.n_supports > 1])

    def of_scene(self, number: int) -> Bearing:
        """The contacts of one scene alone; see ``of_range``."""
        return self.of_range(number, number + 1)

    def of_range(self, begin: int, end: int) -> Bearing:
        """The contacts of the scenes ``begin`` to ``end`` − 1 alone. Values that this object has already computed, such
        as hulls, are copied."""
        first, last = int(self.boxes.first[begin]), int(self.boxes.first[end])
        rows, contacts = slice(first, last), slice(int(self.ends[first]), int(self.ends[last]))
        values = (getattr(self.boxes, field.name)[rows] for field in fields(self.boxes) if field.name != "first")
        lower = self.lower[contacts]
        some = Bearing(
            Boxes(self.boxes.first[begin : end + 1] - first, *values),
            self.upper[contacts] - first,
            np.where(lower == CARRIER, CARRIER, lower - first),
            self.low[contacts],
            self.high[contacts],
        )
        ends = np.searchsorted(self.together, [contacts.start, contacts.stop])
        hulls = slice(*(int(self.number_of_hull[row - 1]) + 1 if row else 0 for row in (first, last)))
        vars(some).update(
            n_supports=self.n_supports[rows],
            rectangles=tuple(corners[rows] for corners in self.rectangles),
            hulls=HullTable(self.hulls.normal[hulls], self.hulls.offset[hulls]),
            shares=self.shares[slice(*ends.tolist())],
            level=self.level[rows],
        )
        return some

    def of_scenes(self, numbers: IntArray) -> tuple[Bearing, IntArray]:
        """The contacts of the scenes ``numbers``, in this order, and (k,) the numbers of these scenes' boxes in this
        object."""
        boxes, rows = self.boxes.of_scenes(numbers)
        counts = self.n_supports[rows]
        contacts = spans(self.n_supports, rows)
        begins = np.repeat(boxes.first[:-1] - self.boxes.first[numbers], np.diff(boxes.first))
        moved = np.repeat(begins, counts)
        lower = self.lower[contacts]
        some = Bearing(
            boxes,
            self.upper[contacts] + moved,
            np.where(lower == CARRIER, CARRIER, lower + moved),
            self.low.take(contacts, axis=0),
            self.high.take(contacts, axis=0),
        )
        return some, rows

    @cached_property
    def number_of_hull(self) -> IntArray:
        """(n,) index in ``hulls`` of each box's hull. The index is meaningless for boxes without several supports."""
        return np.cumsum(self.n_supports > 1) - 1

    @cached_property
    def widths_m(self) -> FloatArray:
        """(n,) extent of each box's supports along x or y, whichever is shorter, m; NaN for a box without support."""
        low, high = np.full((len(self.boxes.mass), 2), np.inf), np.full((len(self.boxes.mass), 2), -np.inf)
        for axis in range(2):
            np.minimum.at(low[:, axis], self.upper, self.low[:, axis])
            np.maximum.at(high[:, axis], self.upper, self.high[:, axis])
        width: FloatArray = (high - low).min(axis=1)
        return np.where(np.isfinite(width), width, np.nan)

    @cached_property
    def n_supports(self) -> IntArray:
        """(n,) number of contacts that carry each box."""
        return np.bincount(self.upper, minlength=len(self.boxes.mass))

    @cached_property
    def ends(self) -> IntArray:
        """(n + 1,) number of each box's first contact; the last entry is the number of all contacts."""
        return np.concatenate([[0], np.cumsum(self.n_supports)])

    @cached_property
    def level(self) -> IntArray:
        """(n,) level of each box: the largest number of contacts on a path from the box up to a box with a free top."""
        between = np.flatnonzero(self.lower != CARRIER)
        upper, lower = self.upper[between], self.lower[between]
        level = np.zeros(len(self.boxes.mass), int)
        while (level[lower] <= level[upper]).any():
            np.maximum.at(level, lower, level[upper] + 1)
        return level

    @cached_property
    def levels(self) -> list[IntArray]:
        """Numbers of the contacts between boxes, in groups from the top of the pile downwards. The loads of a group's
        upper boxes are known as soon as the forces at the contacts of all earlier groups are known."""
        between = np.flatnonzero(self.lower != CARRIER)
        between = between[np.argsort(-self.boxes.bottom[self.upper[between]], kind="stable")]
        level = self.level[self.upper[between]]
        order = np.argsort(level, kind="stable")
        return np.split(between[order], np.flatnonzero(np.diff(level[order])) + 1) if len(order) else []

    def all_below(self, boxes: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n,) whether each box carries any of the chosen boxes, directly or through other boxes.

        Args:
            boxes: (n,) whether each box is chosen.
        """
        below = np.zeros(len(boxes), bool)
        new = np.flatnonzero(boxes)
        while len(new):
            lower = self.lower[ranges(self.ends[new], self.n_supports[new])]
            is_new = np.zeros(len(boxes), bool)
            is_new[lower[lower != CARRIER]] = True
            new = np.flatnonzero(is_new & ~below)
            below[new] = True
        return below

    @cached_property
    def borne_together(self) -> list[IntArray]:
        """For each group of ``levels``, numbers of contacts. The upper boxes of these contacts have several supports,
        and are upper boxes of the group. Their contacts with the carrier are included."""
        groups = []
        upper = self.upper[self.together]
        for between in self.levels:
            chosen = np.zeros(len(self.boxes.mass), bool)
            chosen[self.upper[between]] = True
            groups.append(self.together[chosen[upper]])
        return groups

    @cached_property
    def together(self) -> IntArray:
        """(k,) numbers of the contacts whose upper box has several supports, rising."""
        return np.flatnonzero((self.n_supports > 1)[self.upper])

    @cached_property
    def shares(self) -> FloatArray:
        """(k, 3, 3) a matrix for each contact whose number is in ``together``. The matrix maps the load of the upper
        box (mass and first moments) to the part of this load that the contact carries."""
        boxes, upper = self.boxes, self.upper[self.together]
        # Places are relative to the upper box's middle, in units of its half extents. Relative coordinates keep the 3 ×
        # 3 systems well conditioned.
        origin, scale = boxes.target.take(upper, axis=0)[:, :2], boxes.half_size.take(upper, axis=0)[:, :2]
        low = (self.low.take(self.together, axis=0) - origin) / scale
        high = (self.high.take(self.together, axis=0) - origin) / scale
        middle, length = np.c_[np.ones(len(upper)), (low + high) / 2], high - low
        area = length.prod(axis=1)
        moments = area[:, None, None] * middle[:, :, None] * middle[:, None, :]
        moments[:, [1, 2], [1, 2]] += area[:, None] * length**2 / 12
        box = self.number_of_hull[upper]
        total_moments = np.zeros((np.count_nonzero(self.n_supports > 1), 3, 3))
        add_rows(total_moments.reshape(-1, 9), box, moments.reshape(-1, 9))
        to_global = np.zeros_like(moments)
        to_global[:, 0, 0] = 1.0
        to_global[:, 1:, 0] = origin
        to_global[:, [1, 2], [1, 2]] = scale
        inverse = np.linalg.inv(total_moments).take(box, axis=0)
        share: FloatArray = to_global @ (moments @ inverse) @ np.linalg.inv(to_global)
        return share


def add_rows(sums: FloatArray, row: IntArray, values: FloatArray) -> None:
    """Add (k, m) ``values`` to the rows ``row`` of (n, m) ``sums``; a row may occur several times.

    The columns are added one by one, since ``numpy.add.at`` takes six times as long for whole rows.
    """
    for column in range(sums.shape[1]):
        np.add.at(sums[:, column], row, values[:, column])


def spans(count: IntArray, chosen: IntArray) -> IntArray:
    """The numbers of all members of the chosen groups.

    Args:
        count: number of members of each group. Members are numbered group after group.
        chosen: numbers of the chosen groups.
    """
    return ranges((np.cumsum(count) - count)[chosen], count[chosen])


def ranges(first: IntArray, count: IntArray) -> IntArray:
    """The numbers first, first + 1, … of several ranges, range after range. ``count`` is the length of each range."""
    numbers: IntArray = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
    return numbers


@lru_cache(maxsize=256)
def bearing_of(scene: Scene) -> Bearing:
    """The contacts of a scene, from ``find_bearings``. The contacts are cached, since many worlds of a sweep have the
    same scene."""
    return find_bearings([scene], [scene.target])


def bearings_of(
    scenes: Sequence[Scene],
    elsewhere: Sequence[Scene] = (),
    pos: Sequence[FloatArray] = (),
    most_gap_m: Sequence[float] = (),
    up: Sequence[FloatArray] = (),
) -> Bearing:
    """The contacts of several scenes in one ``Bearing``, scene after scene.

    Args:
        scenes: scenes whose boxes are at their planned places. The contacts of these scenes come first.
        elsewhere: scenes whose boxes are at other places. The contacts of these scenes come after those of ``scenes``.
        pos: (n, 3) places of the boxes in each scene of ``elsewhere``, m.
        most_gap_m: ``most_gap_m`` of ``find_bearings`` for each scene of ``elsewhere``.
        up: ``up`` of ``find_bearings`` for each scene of ``elsewhere``. If ``up`` is empty, all boxes stand upright.
    """
    if len({id(scene) for scene in scenes}) == 1 and not elsewhere:
        one = bearing_of(scenes[0])
        return one if len(scenes) == 1 else one.of_scenes(np.zeros(len(scenes), np.intp))[0]
    gaps_m = np.array([TOUCH_M] * len(scenes) + list(most_gap_m))
    upright = [np.broadcast_to(UPRIGHT, scene.target.shape) for scene in scenes] if len(up) else []
    return find_bearings([*scenes, *elsewhere], [*(scene.target for scene in scenes), *pos], gaps_m, [*upright, *up])


_SORTED_M: Final = 1e-4
"""Tolerance of a first, rough search for contacts, m. The search raises the heights of each scene by a different
amount, and the raised heights are rounded."""


UPRIGHT: Final = (0.0, 0.0, 1.0)
"""Unit vector along the vertical edges of a box that stands upright."""

_MOST_TILT_COSINE: Final = 0.5
"""Boxes that are tilted by more than 60°, whose vertical edges have a smaller vertical component than this value, are
treated as if they stood upright: they no longer rest on the bases that they have in the plan."""


@dataclass(frozen=True, eq=False)
class _Faces:
    """The bottom and top faces of n boxes that may be tilted.

    Attributes:
        slope: (n, 2) slope of each box's bottom and top along x and y.
        aside_m: (n, 2) horizontal vector from the middle of a box to the middle of its top face, m.
        bottom, top: (n,) heights of the planes of each box's bottom and top at the x and y of the box's middle, m.
        rise_m: (n,) largest height of a point of the bottom face above the middle of the face, m.
    """

    slope: FloatArray
    aside_m: FloatArray
    bottom: FloatArray
    top: FloatArray
    rise_m: FloatArray

    @classmethod
    def of(cls, boxes: Boxes, up: Sequence[FloatArray]) -> _Faces:
        half, height = boxes.half_size, boxes.target[:, 2]
        if not len(up):
            flat = np.zeros((len(half), 2))
            return cls(flat, flat, height - half[:, 2], height + half[:, 2], np.zeros(len(half)))
        axis = np.concatenate(up)
        stands = axis[:, 2] >= _MOST_TILT_COSINE  # False for NaN
        axis = np.where(stands[:, None], axis, UPRIGHT)
        slope = -axis[:, :2] / axis[:, 2:]
        half_height = half[:, 2] / axis[:, 2]
        rise_m = (np.abs(slope) * half[:, :2]).sum(axis=1)
        return cls(slope, axis[:, :2] * half[:, 2:], height - half_height, height + half_height, rise_m)


def find_bearings(
    scenes: Sequence[Scene],
    targets: Sequence[FloatArray],
    most_gap_m: float | FloatArray = TOUCH_M,
    up: Sequence[FloatArray] = (),
) -> Bearing:
    """The contacts between boxes and their supports in several scenes, in one ``Bearing``, scene after scene.

    A box lies on a board of the carrier's deck if the box's bottom is not above the deck. Box A lies on box B if B's
    bottom is lower than A's bottom, and B's top is at the height of A's bottom. Heights are compared with the tolerance
    ``TOUCH_M``, and the two bodies must overlap along x and y. A box above a sheet or a pallet lies on the pieces of
    the sheet, or on the boards of the pallet's deck.

    Args:
        targets: (n, 3) middles of the boxes in each scene, m.
        most_gap_m: largest gap below a box's bottom across which the box still counts as lying on a body, m: one value
            for all scenes, or (s,) one for each scene. The gap can exceed ``TOUCH_M``, since a box may lean onto a
            lower body.
        up: (n, 3) unit vectors along the vertical edges of the boxes in each scene. A tilted box touches a body below
            it where the gap between the two faces is at most ``most_gap_m``, and a contact is the rectangle around
            this part of the faces. If ``up`` is empty, all boxes stand upright.
    """
    boxes, decks = Boxes.of(scenes, targets), _decks([scene.carrier for scene in scenes])
    return _find_bearings(boxes, decks, most_gap_m, scenes, up)


def find_plain_bearings(
    size_mm: FloatArray, corner_mm: FloatArray, mass_kg: FloatArray, counts: Sequence[int], sim: Simulation
) -> Bearing:
    """The contacts in several plans with ``has_plain_scene``, as ``find_bearings`` finds them in the scenes of the
    plans. No ``Scene`` is made, which takes a third of the time.

    Args:
        size_mm, corner_mm: (n, 3) extents and corners of the boxes of all plans, plan after plan, mm.
        mass_kg: (n,) masses of these boxes, kg.
        counts: number of boxes of each plan.
    """
    n, first = len(mass_kg), np.concatenate([[0], np.cumsum(counts)])
    half_size, target = half_size_and_target(size_mm, corner_mm, sim)
    carrier_mass = np.full(n, sim.physics.carrier_mass_kg)
    boxes = Boxes(first, target, half_size, mass_kg, np.zeros((n, 3)), carrier_mass, np.zeros((n, 2, 2)))
    place, half = slab_places(corner_mm, size_mm, first[:-1], sim)
    decks = (place - half)[:, :2], (place + half)[:, :2], np.ones(len(counts), np.intp)
    return _find_bearings(boxes, decks, TOUCH_M, ())


def _find_bearings(
    boxes: Boxes,
    decks: tuple[FloatArray, FloatArray, IntArray],
    most_gap_m: float | FloatArray,
    scenes: Sequence[Scene],
    up: Sequence[FloatArray] = (),
) -> Bearing:
    """The contacts of ``find_bearings``.

    Args:
        decks: the result of ``_decks``.
        most_gap_m, up: as for ``find_bearings``.
        scenes: the scenes, if some of them have sheets or pallets among their boxes.
    """
    low, high, counts = boxes.target - boxes.half_size, boxes.target + boxes.half_size, np.diff(boxes.first)
    faces_of_boxes = _Faces.of(boxes, up)
    scene_of = np.repeat(np.arange(len(counts)), counts)
    gap_m = np.broadcast_to(most_gap_m, len(counts))[scene_of]
    deck_low, deck_high, boards = decks
    bottom, top, rise_m = faces_of_boxes.bottom, faces_of_boxes.top, faces_of_boxes.rise_m
    lies = np.flatnonzero(bottom - rise_m <= gap_m)
    lying, board = np.repeat(lies, boards[scene_of[lies]]), spans(boards, scene_of[lies])
    below, above = _touching(scene_of, bottom, top, gap_m, rise_m, is_tilted=len(up) > 0)
    face_low, face_high, faces = _top_faces(boxes, scenes, low, high)
    if len(up):
        aside_m = np.repeat(faces_of_boxes.aside_m, faces, axis=0)
        face_low, face_high = face_low + aside_m, face_high + aside_m
    above, face, below = np.repeat(above, faces[below]), spans(faces, below), np.repeat(below, faces[below])
    upper = np.concatenate([lying, above])
    lower = np.concatenate([np.full(len(board), CARRIER), below])
    low, high = low[:, :2] - faces_of_boxes.aside_m, high[:, :2] - faces_of_boxes.aside_m
    area_low = np.maximum(low.take(upper, axis=0), np.concatenate([deck_low[board], face_low.take(face, axis=0)]))
    area_high = np.minimum(high.take(upper, axis=0), np.concatenate([deck_high[board], face_high.take(face, axis=0)]))
    if len(up):
        area_low, area_high = _pressed(boxes, faces_of_boxes, upper, lower, area_low, area_high, gap_m)
    extent = area_high - area_low
    wide = np.flatnonzero((extent[:, 0] > _LEAST_OVERLAP_M) & (extent[:, 1] > _LEAST_OVERLAP_M))
    # lexsort is stable: contacts of a box with several boards keep their order
    order = wide[np.lexsort((lower[wide], upper[wide]))]
    if len(up):
        order = order[without_circles(upper[order], lower[order], boxes.target[:, 2])]
    return Bearing(boxes, upper[order], lower[order], area_low.take(order, axis=0), area_high.take(order, axis=0))


def _pressed(
    boxes: Boxes,
    faces: _Faces,
    upper: IntArray,
    lower: IntArray,
    low: FloatArray,
    high: FloatArray,
    most_gap_m: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(c, 2) lowest and (c, 2) highest corners of the rectangles around those parts of the contacts' rectangles in
    which the gap between the two faces is at most ``most_gap_m``, m. ``high`` is below ``low`` if no part
    is left, or if two boxes overlap by more than ``TOUCH_M`` everywhere.

    Args:
        upper, lower: (c,) numbers of the two bodies of each contact.
        low, high: (c, 2) corners of the rectangles in which the two faces are above each other, m.
        most_gap_m: (n,) ``most_gap_m`` of ``find_bearings`` for each box.
    """
    on_box = lower != CARRIER
    below = np.where(on_box, lower, 0)
    # the gap is ``gap`` at the low corner, and grows by ``rise`` along x and y to the opposite sides of the rectangle
    slope = faces.slope[upper] - np.where(on_box[:, None], faces.slope[below], 0.0)
    gap = faces.bottom[upper] + (faces.slope[upper] * (low - boxes.target[upper, :2])).sum(axis=1)
    gap -= np.where(on_box, faces.top[below] + (faces.slope[below] * (low - boxes.target[below, :2])).sum(axis=1), 0.0)
    extent = high - low
    rise = slope * extent
    least, most = np.minimum(rise, 0.0), np.maximum(rise, 0.0)
    room = most_gap_m[upper] - gap - least.sum(axis=1)
    touches = (room >= 0.0) & (~on_box | (gap + most.sum(axis=1) >= -TOUCH_M))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.where(rise != 0.0, room[:, None] / np.abs(rise), 1.0), 0.0, 1.0)
    new_low = np.where(rise < 0.0, high - share * extent, low)
    new_high = np.where(rise > 0.0, low + share * extent, high)
    return new_low, np.where(touches[:, None], new_high, -np.inf)


def without_circles(upper: IntArray, lower: IntArray, height: FloatArray) -> NDArray[np.bool_]:
    """(c,) which contacts remain if no box may lie on itself through other boxes. Tilted boxes may lie on one another
    in a circle. Of the contacts in and below a circle, those remain whose upper box has the higher middle.

    Args:
        upper, lower: (c,) numbers of the two bodies of each contact.
        height: (n,) heights of the boxes' middles, m.
    """
    may_be_circle = lower != CARRIER
    while True:
        has_load = np.zeros(len(height), bool)
        has_load[lower[may_be_circle]] = True
        remaining = may_be_circle & has_load[upper]
        if (remaining == may_be_circle).all():
            kept: NDArray[np.bool_] = ~remaining | (height[lower] < height[upper])
            return kept
        may_be_circle = remaining


def deck_mm(plan: Plan, sim: Simulation) -> FloatArray:
    """(b, 2, 2) lowest and highest corner (x, y) of each of the boards of the carrier under a plan on which boxes can
    stand, mm."""
    low, high, _ = _decks([carrier_of(plan, sim)])
    return MM_PER_M * np.stack([low, high], axis=1)


def _decks(carriers: Sequence[Body]) -> tuple[FloatArray, FloatArray, IntArray]:
    """(b, 2) lowest and (b, 2) highest corners (x, y) of the boards that form the carriers' decks, m, carrier after
    carrier, and (s,) the number of these boards of each carrier."""
    n_boards = [carrier.n_boards for carrier in carriers]
    shape_pos, half = (
        np.concatenate([getattr(carrier, name)[:n] for carrier, n in zip(carriers, n_boards, strict=True)])
        for name in ("shape_pos", "half_size")
    )
    center = np.repeat([carrier.pos for carrier in carriers], n_boards, axis=0) + shape_pos
    deck = (center + half)[:, 2] >= -TOUCH_M
    boards = np.bincount(np.repeat(np.arange(len(carriers)), n_boards)[deck], minlength=len(carriers))
    return (center - half)[deck, :2], (center + half)[deck, :2], boards


def _top_faces(
    boxes: Boxes, scenes: Sequence[Scene], low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """(t, 2) lowest and (t, 2) highest corners of the top faces of boxes, m, box after box, and (n,) the number of top
    faces of each box.

    A box has one top face, a sheet has one per piece, and a pallet among the boxes has one per board of its deck.

    Args:
        low, high: (n, 3) lowest and highest corners of the boxes, m.
    """
    counts = np.ones(len(low), np.intp)
    if not any(scene.pieces for scene in scenes):
        return low[:, :2], high[:, :2], counts
    face_low, face_high = [], []
    for scene, (first, end) in zip(scenes, pairwise(boxes.first.tolist()), strict=True):
        shapes, rows = scene.shapes, slice(first, end)
        of_boxes = np.flatnonzero(shapes.body != CARRIER)
        box = shapes.body[of_boxes]
        middle = boxes.target[rows][box] + shapes.pos[of_boxes] - scene.middle[box]
        half = shapes.half_size[of_boxes]
        on_top = (middle + half)[:, 2] >= high[rows][box, 2] - TOUCH_M
        counts[rows] = np.bincount(box[on_top], minlength=scene.n_boxes)
        face_low.append((middle - half)[on_top, :2])
        face_high.append((middle + half)[on_top, :2])
    return np.concatenate(face_low), np.concatenate(face_high), counts


def _touching(
    scene: IntArray, low: FloatArray, high: FloatArray, most_gap_m: FloatArray, rise_m: FloatArray, is_tilted: bool
) -> tuple[IntArray, IntArray]:
    """(p,) lower and (p,) upper boxes of pairs in the same scene whose vertical gap is small enough for a contact.

    Heights are sorted first, so that few pairs must be compared.

    Args:
        scene: (n,) number of the scene of each box.
        low, high: (n,) heights of the boxes' bottoms and tops, m. Boxes whose heights are not finite have no contacts.
        most_gap_m: (n,) ``most_gap_m`` of ``find_bearings`` for each box.
        rise_m: (n,) largest height of a point of each box's bottom or top above the height in ``low`` or ``high``, m.
        is_tilted: whether boxes may be tilted. The middle of a tilted box may be lower than that of the box on which it
            lies, so the order of heights is not considered.
    """
    rows = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    scene, rise_m = scene[rows], rise_m[rows]
    most_rise_m = rise_m.max(initial=0.0)
    most_gap_m, most_over_m = most_gap_m[rows] + rise_m, TOUCH_M + rise_m
    bottom, top = low[rows], high[rows]
    reach = TOUCH_M + most_gap_m.max(initial=0.0) + 2 * most_rise_m
    # Heights are raised by a different amount for each scene, so that boxes of different scenes are far apart.
    rise = scene * (np.maximum(bottom, top).max(initial=0.0) - np.minimum(bottom, top).min(initial=0.0) + 2 * reach)
    least_m = bottom + rise - most_gap_m - most_rise_m - _SORTED_M
    most_m = bottom + rise + most_over_m + most_rise_m + _SORTED_M
    tops, bottoms = np.argsort(top + rise), np.argsort(least_m)
    in_order = (top + rise)[tops]
    begins = np.searchsorted(in_order, least_m[bottoms])
    times = np.maximum(np.searchsorted(in_order, most_m[bottoms], side="right") - begins, 0)
    above = np.repeat(bottoms, times)
    below = tops[np.arange(times.sum()) + np.repeat(begins - (np.cumsum(times) - times), times)]
    over = top[below] - bottom[above]
    touching = (over <= most_over_m[above] + rise_m[below]) & (over >= -most_gap_m[above] - rise_m[below])
    touching &= (below != above) if is_tilted else bottom[below] < bottom[above]
    touching &= scene[below] == scene[above]
    return rows[below[touching]], rows[above[touching]]
