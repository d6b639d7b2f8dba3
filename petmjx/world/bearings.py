"""Contacts between boxes and their supports (``Bearing``), loads on supports, and distances of loads from the supports'
edges.

The load of a box is its own weight plus the weight that rests on it. The load acts at a point of the box's base, the
centre of pressure. The box is in balance if its centre of pressure lies within the convex hull of its supports. Statics
does not determine how several supports share a load. This module assumes that supports share a load like a bed of equal
springs (Winkler 1867, "Die Lehre von der Elasticität und Festigkeit"): the pressure varies linearly over all areas that
touch. The balance of force and moments determines this pressure. If springs would have to pull somewhere, the module
computes the pushing forces with the least energy instead (petmjx.world.pushing_forces).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM
from petmjx.world.history import CARRIER
from petmjx.world.pushing_forces import ON_EDGE_M, on_edges, pulls, pushes
from petmjx.world.rectangle_hulls import HullTable, hull_table
from petmjx.world.scene import Scene
from petmjx.world.surface_pairs import NOT_GIVEN

TOUCH_M: Final = DEFAULT_TOLERANCE_MM / MM_PER_M
"""Largest distance between two faces that count as touching, m. The warnings about plans use the same distance."""

LEANS_M: Final = Thresholds().shift_m
"""Largest gap between a box and a wall that can stop the box from tipping, m. A box that tips across a gap of this
width moves by less than the shift threshold."""

IntArray = NDArray[np.intp]


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
        """The boxes of the scenes ``numbers``, in this order, and (k,) the numbers that these boxes have in this
        ``Boxes``."""
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
    """(n, 2, 2) for a scene with walls: how far beyond a box's supports its load may act while a wall keeps the box
    from tipping, m (``Boxes.wall_allowance``). ``target`` has the (n, 3) middles of the boxes, m.

    If the load W of a box acts at a distance e beyond an edge of the supports, the box tips until it touches the wall
    on that side. The box touches the wall at its own top or at the wall's top, whichever is lower. The box touches
    the wall at the height h above its own bottom. The wall then presses on the box with the force
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
    table = scene.pairs.get("friction")
    if scene.surface is None or table is None:
        return friction
    of_pairs = np.where(table == NOT_GIVEN, np.inf, table).min(axis=1)[scene.surface]
    return np.where(np.isfinite(of_pairs), of_pairs, friction)


@dataclass(frozen=True, eq=False)
class Bearing:
    """The contacts between boxes and their supports, in one or several scenes with n boxes in all.

    A contact is the rectangle in which a box touches a body below it. The c contacts are sorted by their upper boxes.

    Attributes:
        boxes: the boxes at their planned places, not at the places of their release.
        upper: (c,) number of the box above each contact.
        lower: (c,) number of the box below each contact, or ``CARRIER``. The box below may be placed later than the box
            above.
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
        first, number = _different(load, owner, low, high)
        if len(first) == len(load):
            return self._pushed(load, boxes, owner, low, high)
        counts = np.bincount(owner, minlength=len(load))
        begins, count = (np.cumsum(counts) - counts)[first], counts[first]
        rows = ranges(begins, count)
        owner = np.repeat(np.arange(len(first)), count)
        force = self._pushed(load[first], boxes[first], owner, low.take(rows, axis=0), high.take(rows, axis=0))
        return force.take(ranges((np.cumsum(count) - count)[number], counts), axis=0)

    def _pushed(
        self, load: FloatArray, boxes: IntArray, owner: IntArray, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        """The result of ``pushed``, computed for each load."""
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
        distance_m: FloatArray = np.minimum(nearer[:, 0], nearer[:, 1])  # this is faster than ``min(axis=1)``
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
        """The contacts of the scenes ``numbers``, in this order, and (k,) the numbers that the boxes of these scenes
        have in this ``Bearing``."""
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
        """For each group of ``levels``, numbers of contacts: all contacts below those upper boxes of the group that
        have several supports. Contacts with the carrier are included."""
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
        """(k, 3, 3) a matrix for each contact whose upper box has several supports, that is, for each of the contacts
        ``together``. The matrix maps the load of the upper box (mass and first moments) to the part of this load that
        the contact carries."""
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


def _different(load: FloatArray, owner: IntArray, low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """Two arrays of indices, for p loads of which d differ from each other. (d,) The first of each set of equal loads;
    two loads are equal only if their contacts are equal, too. (p,) For each load, the place of its equal in the first
    array. Plans that differ only in a few boxes have many equal loads. Arguments: as for ``Bearing.pushed``."""
    ends = np.cumsum(np.bincount(owner, minlength=len(load)))
    loads, areas = load.tobytes(), np.concatenate([low, high], axis=1).tobytes()
    of_load, of_area = load.itemsize * load.shape[1], low.itemsize * 4
    known: dict[bytes, int] = {}
    first, numbers, begin = list[int](), list[int](), 0
    for k, end in enumerate((of_area * ends).tolist()):
        number = known.setdefault(loads[of_load * k : of_load * (k + 1)] + areas[begin:end], len(first))
        if number == len(first):
            first.append(k)
        numbers.append(number)
        begin = end
    return np.array(first, np.intp), np.array(numbers, np.intp)


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
