"""Supports of boxes by the plan, their loads, and the distances of loads from the edges of the supports.

The load of a box is its own weight plus the weight that rests on it. The load acts at a point of the box's base, the
centre of pressure. The box is in balance if that point lies within the convex hull of its supports. Statics does not
determine how several supports share a load. Here they share it as a bed of equal springs does (Winkler 1867, "Die Lehre
von der Elasticität und Festigkeit"): the pressure varies linearly over all areas that touch, and the balance of force
and moments determines it. If springs would pull somewhere, supports push with the least energy instead
(petmjx.world.load_sharing).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.simulation import Thresholds
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, meets
from petmjx.world.body_shapes import Body
from petmjx.world.friction_pairs import LARGER
from petmjx.world.history import CARRIER
from petmjx.world.load_sharing import ON_EDGE_M, on_edges, pulls, pushes
from petmjx.world.rectangle_hulls import HullTable, hull_table
from petmjx.world.scene import Scene
from petmjx.world.stackable_scenes import is_plain

IntArray = NDArray[np.intp]

TOUCH_M: Final = DEFAULT_TOLERANCE_MM / MM_PER_M
"""Faces touch if they are no further apart than this, as in the warnings about a plan."""

LEANS_M: Final = Thresholds().shift_m
"""Largest gap between a box that tips and the wall that stops it, m. With this gap, the box's middle moves by less than
a verdict allows."""

_LEAST_OVERLAP_M: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Boxes:
    """The boxes of scenes, one scene after the other, n in all.

    Attributes:
        first: (s + 1,) first box of each scene; the last entry is n.
        target: (n, 3) planned middles, m.
        half_size: (n, 3) m.
        mass: (n,) kg.
        mass_center: (n, 3) vector from a box's middle to its centre of mass, m.
        carrier_mass: (n,) mass of the carrier of each box's scene, kg.
        held: (n, 2, 2) largest distance beyond the supports at which a wall still holds a load, at the low and the high
            end of x and y, m.
    """

    first: IntArray
    target: FloatArray
    half_size: FloatArray
    mass: FloatArray
    mass_center: FloatArray
    carrier_mass: FloatArray
    held: FloatArray

    @classmethod
    def of(cls, scenes: Sequence[Scene], targets: Sequence[FloatArray]) -> Boxes:
        """The boxes of scenes, with their middles at these (n, 3) places, m."""
        mass = [scene.mass for scene in scenes]
        counts = [*map(len, mass)]
        first = np.concatenate([[0], np.cumsum(counts)])
        centred, held = np.zeros((first[-1], 3)), np.zeros((first[-1], 2, 2))
        for scene, target, begin, n in zip(scenes, targets, first.tolist(), counts, strict=False):
            if scene.mass_center is not None:
                centred[begin : begin + n] = scene.mass_center
            if scene.carrier.walls:
                held[begin : begin + n] = _held_by_walls(scene, target)
        return cls(
            first,
            np.concatenate(targets),
            np.concatenate([scene.half_size for scene in scenes]),
            np.concatenate(mass),
            centred,
            np.repeat([scene.carrier.mass for scene in scenes], counts),
            held,
        )

    def of_scenes(self, numbers: IntArray) -> tuple[Boxes, IntArray]:
        """The boxes of some of the scenes, in this order, and (k,) their numbers among all boxes."""
        counts = np.diff(self.first)
        rows = spans(counts, numbers)
        first = np.concatenate([[0], np.cumsum(counts[numbers])])
        names = [field.name for field in fields(self) if field.name != "first"]
        return Boxes(first, *(getattr(self, name).take(rows, axis=0) for name in names)), rows

    @cached_property
    def bottom(self) -> FloatArray:
        """(n,) heights of the planned bottoms, m."""
        low: FloatArray = (self.target - self.half_size)[:, 2]
        return low

    @cached_property
    def is_held(self) -> bool:
        """Whether walls hold any of the boxes."""
        return bool(self.held.any())

    def among(self, placed: int | Sequence[int]) -> NDArray[np.bool_]:
        """(n,) which boxes are among the first ``placed`` boxes of their scene."""
        counts = np.diff(self.first)
        number = np.arange(self.first[-1]) - np.repeat(self.first[:-1], counts)
        among: NDArray[np.bool_] = number < np.repeat(np.broadcast_to(placed, len(counts)), counts)
        return among


def _held_by_walls(scene: Scene, target: FloatArray) -> FloatArray:
    """(n, 2, 2) as ``Boxes.held`` of a scene with walls, with the boxes at these (n, 3) places, m.

    A box whose load W acts at a distance e beyond an edge tips until it touches the wall on that side. The box touches
    the wall at its own top or at the wall's top, whichever is lower. This point is a height h above the box's bottom.
    The wall then presses with W·e/h, and the edge must bear this force by friction: so the wall holds the box up to e =
    µ·h. The wall counts as smooth, and the support of the box as fixed.
    """
    room, half = scene.carrier.room, scene.half_size
    bottom, top = (target - half)[:, 2], (target + half)[:, 2]
    height = np.minimum(top[:, None, None], room.top) - bottom[:, None, None]
    return np.where(room.gaps(target, half, TOUCH_M) <= LEANS_M, _least_friction(scene)[:, None, None] * height, 0.0)


def _least_friction(scene: Scene) -> FloatArray:
    """(n,) the smallest coefficient of friction between each box and its possible supports."""
    friction = scene.friction[:, 0]
    if scene.surface is None or scene.pair_friction is None:
        return friction
    of_pairs = np.where(scene.pair_friction == LARGER, np.inf, scene.pair_friction).min(axis=1)[scene.surface]
    return np.where(np.isfinite(of_pairs), of_pairs, friction)


@dataclass(frozen=True, eq=False)
class Bearing:
    """The contacts between boxes and their supports in scenes with n boxes: c rectangles, sorted by the upper box.

    Attributes:
        boxes: the boxes. The planned places count, not the release places.
        upper: (c,) the box above.
        lower: (c,) the box below, even if placed later, or ``CARRIER``.
        low, high: (c, 2) corners of the rectangles along x and y, m.
    """

    boxes: Boxes
    upper: IntArray
    lower: IntArray
    low: FloatArray
    high: FloatArray

    def loads(self, placed: int | Sequence[int]) -> FloatArray:
        """(n, 4) loads once the first ``placed`` boxes of each scene are placed: mass, kg, and its first moments along
        x, y and z, kg·m. 0 for the other boxes."""
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
        """(n, 4) the boxes' own weights, in the form of ``loads``."""
        boxes = self.boxes
        centre = boxes.target + boxes.mass_center
        weights: FloatArray = boxes.mass[:, None] * np.concatenate([np.ones((len(centre), 1)), centre], axis=1)
        return weights

    def forces(self, load: FloatArray, together: IntArray) -> FloatArray:
        """(k, 3) force, and first moments along x and y, with which boxes with several supports press on each support.

        The units are those of ``load``.

        Args:
            load: (n, 3) or more columns.
            together: (k,) all contacts of these boxes, in order.
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
        """(k, 3) the parts of loads that reach these (k,) contacts of boxes with several supports, if supports share
        loads like equal springs.

        Args:
            load: (k, 3) load of the upper box of each contact.
        """
        number = np.searchsorted(self.together, contact)
        part: FloatArray = np.einsum("cij,cj->ci", self.shares.take(number, axis=0), load)
        return part

    def pushed(
        self, load: FloatArray, boxes: IntArray, owner: IntArray, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        """(k, 3) the forces at contacts of boxes with several supports, if supports can only push.

        Args:
            load: (p, 3) one load of each of these ``boxes``.
            owner: (k,) number of the load that presses at each contact. Contacts are sorted by this number.
            low, high: (k, 2) corners of the contacts' rectangles.
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
        """(n,) distance of each box's load from the nearest edge of its supports, m: positive inside, negative beyond.
        NaN for a box without support or load."""
        with np.errstate(divide="ignore", invalid="ignore"):
            point = load[:, 1:3] / load[:, :1]
        return self.inside_m(np.arange(len(load)), point)

    def inside_m(self, box: IntArray, point: FloatArray) -> FloatArray:
        """(p,) distance of (p, 2) points from the nearest edge of the supports of (p,) boxes, m, with the signs of
        ``edges_m``.
        """
        low, high = self.rectangles
        nearer = np.minimum(point - low.take(box, axis=0), high.take(box, axis=0) - point)
        distance_m: FloatArray = np.minimum(nearer[:, 0], nearer[:, 1])  # faster than ``min(axis=1)`` of two columns
        several = np.flatnonzero(self.n_supports.take(box) > 1)
        if len(several):
            hull = self.number_of_hull[box[several]]
            wider: FloatArray | float = 0.0
            if self.boxes.is_held:
                held = self.boxes.held[box[several]]
                outward = -self.hulls.normal[hull]
                wider = (np.maximum(outward, 0.0) * held[:, None, 1] - np.minimum(outward, 0.0) * held[:, None, 0]).sum(
                    axis=2
                )
            distances_m = self.hulls.distances_m(hull, point.take(several, axis=0)) + wider
            distance_m[several] = distances_m.min(axis=1, initial=np.inf)
        return distance_m

    @cached_property
    def rectangles(self) -> tuple[FloatArray, FloatArray]:
        """Two arrays (n, 2): for boxes with one support, the low and the high corner of the rectangle in which a load
        is borne by the support or held by walls, m; NaN for other boxes."""
        low, high = np.full((len(self.boxes.mass), 2), np.nan), np.full((len(self.boxes.mass), 2), np.nan)
        alone = np.flatnonzero(self.n_supports == 1)
        contact = self.ends[alone]
        low[alone], high[alone] = self.low.take(contact, axis=0), self.high.take(contact, axis=0)
        if self.boxes.is_held:
            low, high = low - self.boxes.held[:, 0], high + self.boxes.held[:, 1]
        return low, high

    @cached_property
    def hulls(self) -> HullTable:
        """Hulls of the supports of boxes that have several supports, in the order of boxes."""
        low, high = self.low.take(self.together, axis=0), self.high.take(self.together, axis=0)
        return hull_table(low, high, self.n_supports[self.n_supports > 1])

    def of_scene(self, number: int) -> Bearing:
        """The bearing of one scene alone, as ``of_range``."""
        return self.of_range(number, number + 1)

    def of_range(self, begin: int, end: int) -> Bearing:
        """The bearing of the scenes ``begin`` to ``end`` alone. The new bearing takes hulls, shares and levels from
        this one, so that they need not be computed again."""
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
        """The bearing of some of the scenes, in this order, and (k,) their boxes' numbers among all boxes."""
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
        """(n,) number of each box's hull in ``hulls``, if it has several supports."""
        return np.cumsum(self.n_supports > 1) - 1

    @cached_property
    def widths_m(self) -> FloatArray:
        """(n,) extent of each box's supports along x or y, whichever is shorter, m; NaN without support."""
        low, high = np.full((len(self.boxes.mass), 2), np.inf), np.full((len(self.boxes.mass), 2), -np.inf)
        for axis in range(2):
            np.minimum.at(low[:, axis], self.upper, self.low[:, axis])
            np.maximum.at(high[:, axis], self.upper, self.high[:, axis])
        width: FloatArray = (high - low).min(axis=1)
        return np.where(np.isfinite(width), width, np.nan)

    @cached_property
    def n_supports(self) -> IntArray:
        """(n,) number of rectangles that bear each box."""
        return np.bincount(self.upper, minlength=len(self.boxes.mass))

    @cached_property
    def ends(self) -> IntArray:
        """(n + 1,) first contact of each box; the last entry is the number of contacts."""
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
        """The contacts between boxes, in groups. Once all earlier groups are done, the loads of a group's upper boxes
        are complete."""
        between = np.flatnonzero(self.lower != CARRIER)
        between = between[np.argsort(-self.boxes.bottom[self.upper[between]], kind="stable")]
        level = self.level[self.upper[between]]
        order = np.argsort(level, kind="stable")
        return np.split(between[order], np.flatnonzero(np.diff(level[order])) + 1) if len(order) else []

    def all_below(self, boxes: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n,) which boxes bear any of the chosen boxes (an (n,) mask), directly or through others."""
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
        """For each group of ``levels``: the contacts of those of its boxes that have several supports, including
        contacts with the carrier."""
        groups = []
        upper = self.upper[self.together]
        for between in self.levels:
            chosen = np.zeros(len(self.boxes.mass), bool)
            chosen[self.upper[between]] = True
            groups.append(self.together[chosen[upper]])
        return groups

    @cached_property
    def together(self) -> IntArray:
        """(k,) the contacts of boxes with several supports, in order."""
        return np.flatnonzero((self.n_supports > 1)[self.upper])

    @cached_property
    def shares(self) -> FloatArray:
        """(k, 3, 3) matrix for each of the contacts ``together``. The matrix maps the load of the upper box (mass and
        moments) to the part that reaches the lower body at this contact."""
        boxes, upper = self.boxes, self.upper[self.together]
        # Places are relative to the upper box's centre and in units of its lengths. This keeps the 3 × 3 systems well
        # conditioned.
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
    """Add (k, m) values to these rows of (n, m) sums, one after the other. ``numpy.add.at`` takes six times as long for
    rows as for columns."""
    for column in range(sums.shape[1]):
        np.add.at(sums[:, column], row, values[:, column])


def spans(count: IntArray, chosen: IntArray) -> IntArray:
    """The numbers of all members of the chosen groups. ``count`` has the number of members of each group."""
    return ranges((np.cumsum(count) - count)[chosen], count[chosen])


def ranges(first: IntArray, count: IntArray) -> IntArray:
    """The numbers first, first + 1, … of several ranges, range after range. ``count`` has the length of each range."""
    numbers: IntArray = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
    return numbers


@lru_cache(maxsize=256)
def bearing_of(scene: Scene) -> Bearing:
    """``find_bearing``, cached: in a sweep many worlds have the same scene."""
    return find_bearing(scene)


def bearings_of(
    scenes: Sequence[Scene],
    elsewhere: Sequence[Scene] = (),
    pos: Sequence[FloatArray] = (),
    most_gap_m: Sequence[float] = (),
) -> Bearing:
    """The joined bearings of several scenes, scene after scene, computed together. First come ``scenes``, with boxes at
    their planned places, then the scenes ``elsewhere``.

    Args:
        pos: (n, 3) places of the boxes of each scene ``elsewhere``, m.
        most_gap_m: as in ``find_bearing``, of each scene ``elsewhere``; empty: as for planned places.
    """
    if len({id(scene) for scene in scenes}) == 1 and not elsewhere:
        one = bearing_of(scenes[0])
        return one if len(scenes) == 1 else one.of_scenes(np.zeros(len(scenes), np.intp))[0]
    gaps_m = np.array([TOUCH_M] * len(scenes) + list(most_gap_m or [TOUCH_M] * len(elsewhere)))
    return find_bearings([*scenes, *elsewhere], [*(scene.target for scene in scenes), *pos], gaps_m)


_SORTED_M: Final = 1e-4
"""Boxes are candidates for a contact if their gap exceeds the allowed gap by at most this, m, since sums of the heights
of many scenes are rounded.
"""


def find_bearings(
    scenes: Sequence[Scene], targets: Sequence[FloatArray], most_gap_m: float | FloatArray = TOUCH_M
) -> Bearing:
    """The joined result of ``find_bearing`` for each scene, with its boxes at (n, 3) places, m. Plain scenes are
    computed together.

    Args:
        most_gap_m: as in ``find_bearing``, of all scenes or (s,) of each scene.
    """
    boxes, most_gap_m = Boxes.of(scenes, targets), np.broadcast_to(most_gap_m, len(scenes))
    first, counts = boxes.first, np.diff(boxes.first)
    plain = np.array([is_plain(scene) for scene in scenes], bool)
    parts = [(*np.zeros((2, 0), np.intp), *np.zeros((2, 0, 2)))]  # scenes may have no contacts at all
    for k in np.flatnonzero(~plain).tolist():
        one = find_bearing(replace(scenes[k], target=targets[k]), float(most_gap_m[k]))
        lower = np.where(one.lower == CARRIER, CARRIER, one.lower + first[k])
        parts.append((one.upper + first[k], lower, one.low, one.high))
    chosen = np.flatnonzero(plain & (counts > 0))
    if len(chosen):
        parts.append(_plain_contacts(boxes, scenes, chosen, most_gap_m))
    upper, lower, low, high = (np.concatenate(values) for values in zip(*parts, strict=True))
    order = np.lexsort((lower, upper))  # lexsort is stable, so boards of a deck keep their order
    return Bearing(boxes, upper[order], lower[order], low.take(order, axis=0), high.take(order, axis=0))


def _plain_contacts(
    boxes: Boxes, scenes: Sequence[Scene], chosen: IntArray, most_gap_m: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """The contacts of the chosen scenes, which are plain, as fields of ``Bearing``. They are not sorted."""
    low, high = boxes.target - boxes.half_size, boxes.target + boxes.half_size
    counts = np.diff(boxes.first)
    carriers = [scenes[k].carrier for k in chosen.tolist()]
    n_boards = [carrier.n_boards for carrier in carriers]
    boards = np.array(n_boards)
    shape_pos, half = (
        np.concatenate([getattr(carrier, name)[:n] for carrier, n in zip(carriers, n_boards, strict=True)])
        for name in ("shape_pos", "half_size")
    )
    center = np.repeat([carrier.pos for carrier in carriers], boards, axis=0) + shape_pos
    deck = (center + half)[:, 2] >= -TOUCH_M
    deck_low, deck_high = (center - half)[deck, :2], (center + half)[deck, :2]
    boards = np.bincount(np.repeat(np.arange(len(chosen)), boards)[deck], minlength=len(chosen))
    rows, scene_of = spans(counts, chosen), np.repeat(np.arange(len(chosen)), counts[chosen])
    lies = low[rows, 2] <= np.repeat(most_gap_m[chosen], counts[chosen])
    lying, board = np.repeat(rows[lies], boards[scene_of[lies]]), spans(boards, scene_of[lies])
    below, above = _touching(rows, scene_of, low[:, 2], high[:, 2], np.repeat(most_gap_m[chosen], counts[chosen]))
    upper = np.concatenate([lying, above])
    lower = np.concatenate([np.full(len(board), CARRIER), below])
    low, high = low[:, :2].copy(), high[:, :2].copy()
    area_low = np.maximum(low.take(upper, axis=0), np.concatenate([deck_low[board], low.take(below, axis=0)]))
    area_high = np.minimum(high.take(upper, axis=0), np.concatenate([deck_high[board], high.take(below, axis=0)]))
    extent = area_high - area_low
    wide = np.flatnonzero((extent[:, 0] > _LEAST_OVERLAP_M) & (extent[:, 1] > _LEAST_OVERLAP_M))
    return upper[wide], lower[wide], area_low.take(wide, axis=0), area_high.take(wide, axis=0)


def _touching(
    rows: IntArray, scene: IntArray, low: FloatArray, high: FloatArray, most_gap_m: FloatArray
) -> tuple[IntArray, IntArray]:
    """Pairs of boxes of the same scene, (p,) the lower and (p,) the upper one, between which the gap is at most the
    allowed one.

    Sorting the heights leaves few pairs to examine.

    Args:
        rows: (r,) the boxes.
        scene: (r,) the scene of each box.
        low, high: (n,) heights of all boxes' bottoms and tops, m.
        most_gap_m: (r,) as in ``find_bearing``.
    """
    is_somewhere = np.isfinite(low[rows]) & np.isfinite(high[rows])
    rows, scene, most_gap_m = rows[is_somewhere], scene[is_somewhere], most_gap_m[is_somewhere]
    bottom, top, reach = low[rows], high[rows], TOUCH_M + most_gap_m.max(initial=0.0)
    # The scenes are stacked on each other, with gaps so large that boxes of different scenes do not touch.
    rise = scene * (np.maximum(bottom, top).max(initial=0.0) - np.minimum(bottom, top).min(initial=0.0) + 2 * reach)
    least_m, most_m = bottom + rise - most_gap_m - _SORTED_M, bottom + rise + TOUCH_M + _SORTED_M
    tops, bottoms = np.argsort(top + rise), np.argsort(least_m)
    in_order = (top + rise)[tops]
    begins = np.searchsorted(in_order, least_m[bottoms])
    times = np.maximum(np.searchsorted(in_order, most_m[bottoms], side="right") - begins, 0)
    above = np.repeat(bottoms, times)
    below = tops[np.arange(times.sum()) + np.repeat(begins - (np.cumsum(times) - times), times)]
    over = top[below] - bottom[above]
    touching = (over <= TOUCH_M) & (over >= -most_gap_m[above]) & (bottom[below] < bottom[above])
    touching &= scene[below] == scene[above]
    return rows[below[touching]], rows[above[touching]]


def find_bearing(scene: Scene, most_gap_m: float = TOUCH_M) -> Bearing:
    """The supports of boxes by the planned places.

    A box lies on a board of the carrier's deck if its bottom is not above the deck. A box also lies on another box that
    begins lower if the other's top is at the height of its own bottom. Both rules hold within ``TOUCH_M``, and only if
    the two boxes overlap along x and y.

    Args:
        most_gap_m: a box also counts as lying on bodies that are up to this far below its bottom, since it may lean
            onto them.
    """
    low, high = scene.target - scene.half_size, scene.target + scene.half_size
    deck_low, deck_high = _deck(scene.carrier)
    touching = meets(low[:, 2], high[:, 2], TOUCH_M, most_gap_m)
    touching &= np.less.outer(low[:, 2], low[:, 2])
    below, above = np.nonzero(touching)
    cut_below, cut_low, cut_high = _cut(scene, low, high)
    # A box above a sheet lies on the sheet's pieces. A box above another box lies on that box's whole top.
    row, pieces = np.nonzero(below[:, None] == cut_below)
    below, above, piece_low, piece_high = below[row], above[row], cut_low[pieces], cut_high[pieces]
    on_deck, board = (part.ravel() for part in np.indices((len(low), len(deck_low))))
    lying = low[on_deck, 2] <= most_gap_m
    on_deck, board = on_deck[lying], board[lying]
    upper = np.concatenate([on_deck, above])
    lower = np.concatenate([np.full(len(on_deck), CARRIER), below])
    under_low = np.concatenate([deck_low[board], piece_low])
    under_high = np.concatenate([deck_high[board], piece_high])
    area_low, area_high = np.maximum(low[upper, :2], under_low), np.minimum(high[upper, :2], under_high)
    order = np.lexsort((lower, upper))
    order = order[((area_high - area_low)[order] > _LEAST_OVERLAP_M).all(axis=1)]
    return Bearing(Boxes.of([scene], [scene.target]), upper[order], lower[order], area_low[order], area_high[order])


def _cut(scene: Scene, low: FloatArray, high: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """(t,) boxes to which the tops of a scene belong, and (t, 2) low and high corners of the tops: a box has one top, a
    sheet one for each piece, a pallet one for each board of its deck.

    Args:
        low, high: (n, 3) corners of the boxes, m.
    """
    if not scene.pieces:
        return np.arange(scene.n_boxes), low[:, :2], high[:, :2]
    shapes = scene.shapes
    of_boxes = np.flatnonzero(shapes.body != CARRIER)
    box = shapes.body[of_boxes]
    middle = scene.target[box] + shapes.pos[of_boxes] - scene.middle[box]
    half = shapes.half_size[of_boxes]
    on_top = (middle + half)[:, 2] >= high[box, 2] - TOUCH_M
    box, middle, half = box[on_top], middle[on_top, :2], half[on_top, :2]
    return box, middle - half, middle + half


def _deck(carrier: Body) -> tuple[FloatArray, FloatArray]:
    """(b, 2) lowest and (b, 2) highest corners of the boards whose tops are the carrier's top, m."""
    center, half = (carrier.pos + carrier.shape_pos)[: carrier.n_boards], carrier.half_size[: carrier.n_boards]
    deck = (center + half)[:, 2] >= -TOUCH_M
    return (center - half)[deck, :2], (center + half)[deck, :2]
