"""Where boxes are released: as they will rest on what bears them.

Contacts are soft. Under the loads so far a pile has come down by up to some tenths of a millimetre, and a box's own
contacts are a tenth of a millimetre deep once they carry it. A box that appeared where the plan has it would fall by
both, land with centimetres a second, and might rock over an edge on which it stands. So it is released as deep in what
bears it as its weight will press it, and it follows how far that has come down since.

Room for boxes whose places and sizes have errors, where they appear: the nearest places at which none is in another.

Boxes that appeared in one another would be thrown apart by their contacts, the faster the stiffer these are and the
shorter the timestep is: whether the pallet stands would then depend on numbers that are no property of boxes. So they
are moved apart before, level, by the least translations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.simulation import Check, Simulation
from petmjx.plans.plan_warnings import meets, shared_length
from petmjx.world.compliance import bed_depth_m, sinks_m
from petmjx.world.contact_laws import CONTACTS_PER_FACE, cone_factor, depth_m
from petmjx.world.growing_scenes import NextBoxes, Stacks
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene
from petmjx.world.stackable_scenes import stacked_values
from petmjx.world.supports import TOUCH_M

NOTHING: Final = -2
"""In place of a support: the box hangs in the air, or falls into its place."""

MOST_FOLLOWED_M: Final = 0.002
"""How far a box follows its support at most, m: a pile that has moved by more no longer bears it as planned."""


class Release(NamedTuple):
    """How n boxes are released; of many scenes that are alike, with an axis of these before the others.

    Attributes:
        support: (n,) the box that a box follows, ``CARRIER``, or ``NOTHING``: the one with which it shares most area.
        pos: (n, 3) centres of boxes whose support is where the plan has it, m.
        most_followed_m: how far a box follows its support: further where supports give.
    """

    support: NDArray[np.intp]
    pos: FloatArray
    most_followed_m: float = MOST_FOLLOWED_M

    def place_of(self, box: int, scene: Scene, boxes_z: FloatArray, carrier_z: float) -> FloatArray:
        """(3,) middle of a box that is released now, m.

        Args:
            boxes_z, carrier_z: heights of the centres of the boxes before it, and of the carrier's, m.
        """
        place: FloatArray = self.pos[box].copy()
        support = self.support[box]
        if support != NOTHING:
            on_carrier = support == CARRIER
            moved = carrier_z - scene.carrier.pos[2] if on_carrier else boxes_z[support] - scene.target[support, 2]
            place[2] += np.clip(moved, -self.most_followed_m, self.most_followed_m)
        return place


def release_of(scene: Scene, sim: Simulation) -> Release:
    """How the boxes of a scene are released, one by one. In a static check all stand at their planned places."""
    if sim.physics.falls_into_place or sim.check is Check.STATIC or not scene.n_boxes:
        return Release(np.full(scene.n_boxes, NOTHING), scene.start_pos)
    support = _supports(scene.target, scene.half_size)
    touches = (support != NOTHING) & (scene.start_pos[:, 2] <= scene.target[:, 2])
    physics, friction = sim.physics, scene.friction[:, 0]
    on_carrier, below = support == CARRIER, np.maximum(support, 0)
    share = 1.0 + scene.mass / np.where(on_carrier, scene.carrier.mass, scene.mass[below])
    soft = cone_factor(physics, friction, np.where(on_carrier, scene.carrier.friction[:, 0].max(), friction[below]))
    pos = scene.start_pos.copy()
    depth = depth_m(physics, soft * share * physics.gravity_m_s2 / CONTACTS_PER_FACE)
    sinks, most = sinks_m(scene, physics.gravity_m_s2), MOST_FOLLOWED_M
    if sinks is not None:
        depth = np.maximum(depth, bed_depth_m(scene, scene.mass * physics.gravity_m_s2))
        most += float(sinks.max())
    pos[:, 2] -= np.where(touches, depth, 0.0)
    return Release(support, pos, most)


def releases_of(scenes: Sequence[Scene], sim: Simulation) -> Release:
    """The releases of plain scenes that are alike (petmjx.world.stackable_scenes), to the last bit as ``release_of``
    has each."""
    start = stacked_values(scenes, "start_pos")
    m, n = start.shape[:2]
    if sim.physics.falls_into_place or sim.check is Check.STATIC or not n:
        return Release(np.full((m, n), NOTHING), start)
    target, half = (stacked_values(scenes, name) for name in ("target", "half_size"))
    mass, friction = stacked_values(scenes, "mass"), stacked_values(scenes, "friction")[..., 0]
    carrier_mass = stacked_values(scenes, "carrier.mass")[:, None]
    carrier_friction = stacked_values(scenes, "carrier.friction")[..., 0].max(axis=1)[:, None]
    support = _supports(target, half)
    touches = (support != NOTHING) & (start[..., 2] <= target[..., 2])
    on_carrier, below = support == CARRIER, np.maximum(support, 0)
    physics = sim.physics
    share = 1.0 + mass / np.where(on_carrier, carrier_mass, np.take_along_axis(mass, below, axis=1))
    soft = cone_factor(
        physics, friction, np.where(on_carrier, carrier_friction, np.take_along_axis(friction, below, axis=1))
    )
    depth = depth_m(physics, soft * share * physics.gravity_m_s2 / CONTACTS_PER_FACE)
    start[..., 2] -= np.where(touches, depth, 0.0)
    return Release(support, start)


def release_of_next(before: Stacks, boxes: NextBoxes, sim: Simulation) -> Release:
    """How one box more is released in each of m worlds: to the last bit the last rows that ``release_of`` has."""
    nothing = np.full(len(boxes), NOTHING)
    if sim.physics.falls_into_place or sim.check is Check.STATIC:
        return Release(nothing, boxes.target)
    low, high = boxes.target - boxes.half_size, boxes.target + boxes.half_size
    ends = np.minimum(before.target + before.half_size, high[:, None])
    sides = np.maximum(ends - np.maximum(before.target - before.half_size, low[:, None]), 0.0)
    top = before.target[:, :, 2] + before.half_size[:, :, 2]
    area = np.nan_to_num(sides[:, :, 0] * sides[:, :, 1]) * (np.abs(top - low[:, None, 2]) <= TOUCH_M)
    box_below = np.where(area.any(axis=1), area.argmax(axis=1), nothing) if area.shape[1] else nothing
    support = np.where(low[:, 2] <= TOUCH_M, CARRIER, box_below)
    on_carrier, rows = support == CARRIER, np.arange(len(boxes))
    # where nothing bears a box its own mass and friction stand in, and count for nothing
    masses = np.column_stack([before.mass, boxes.mass])
    below = np.where(support >= 0, support, masses.shape[1] - 1)
    share = 1.0 + boxes.mass / np.where(on_carrier, before.carrier_mass, masses[rows, below])
    friction = np.full(len(boxes), before.box_friction)
    soft = cone_factor(sim.physics, friction, np.where(on_carrier, before.carrier_friction, friction))
    depth = depth_m(sim.physics, soft * share * sim.physics.gravity_m_s2 / CONTACTS_PER_FACE)
    pos = boxes.target.copy()
    pos[:, 2] -= np.where(support != NOTHING, depth, 0.0)
    return Release(support, pos)


def _supports(target: FloatArray, half_size: FloatArray) -> NDArray[np.intp]:
    """(…, n) what each box lies on by the planned places, or most of it."""
    low, high = target - half_size, target + half_size
    length, width = (np.maximum(shared_length(low[..., axis], high[..., axis]), 0.0) for axis in range(2))
    area = length * width * np.triu(meets(low[..., 2], high[..., 2], TOUCH_M), k=1)
    box_below = np.where(area.any(axis=-2), area.argmax(axis=-2), NOTHING)
    return np.where(low[..., 2] <= TOUCH_M, CARRIER, box_below)


CLEAR_M: Final = 0.0002
"""How far apart boxes are once they were in one another: contacts of edges begin up to 0.14 mm before they touch, 0.7
times the skins of two boxes (docs/rules.md, section 1)."""

_KNOWN_TO_M: Final = 1e-6
"""How much of it may be missing: a hundredth of the depth of contacts at rest."""

_MOST_ROUNDS: Final = 500
"""A row of 12 boxes takes 200; then what is missing is left to contacts."""


def make_room(
    place: FloatArray,
    half_size: FloatArray,
    yaw: FloatArray,
    planned: FloatArray,
    planned_half: FloatArray,
    beside: NDArray[np.bool_],
    movable: NDArray[np.bool_],
    reach_m: float,
) -> FloatArray:
    """(m, n, 2) level places nearest to those of m worlds at which no box is in one beside it, m.

    Nearest: the sum of the squares of all translations is the least. Two boxes are kept apart along that axis of one of
    them along which they overlap least, by ``CLEAR_M``, or by less, or not quite, if the plan has them so. Each pair
    then bounds the translations by one linear inequality; the least ones are found by Hildreth's method (Hildreth 1957,
    "A quadratic programming procedure", Naval Research Logistics Quarterly 4, 79-85), pair by pair. A world's places do
    not depend on the others.

    Args:
        place: (m, n, 2) level places of the boxes' middles, m; half_size: (m or 1, n, 3); yaw: (m or 1, n), rad.
        planned, planned_half: (n, 2) and (n, 3) of the plan, whose boxes are not turned.
        beside: (n, n) symmetric: pairs of which neither is above the other.
        movable: (n,) others stay where they are.
        reach_m: pairs that are further apart in the plan are not looked at.
    """
    apart = _separation(planned, planned_half)
    first, second = np.nonzero(np.triu(beside & (apart < reach_m) & (movable[:, None] | movable), k=1))
    if not len(first):
        return place
    normal, gap = _widest(place, half_size, yaw, first, second)
    missing = np.minimum(apart[first, second], CLEAR_M) - gap
    open_worlds = np.flatnonzero((missing > _KNOWN_TO_M).any(axis=1))
    if not len(open_worlds):
        return place
    normal, missing = normal[open_worlds], missing[open_worlds]
    moved = np.zeros((len(open_worlds), place.shape[1], 2))
    pressure = np.zeros_like(missing)
    yields = movable.astype(float)
    resistance = yields[first] + yields[second]
    some = _independent(first, second)
    running = np.arange(len(open_worlds))
    for _ in range(_MOST_ROUNDS):
        worst = np.zeros(len(running))
        for pairs in some:
            i, j = first[pairs], second[pairs]
            n = normal[running][:, pairs]
            away = moved[running][:, j] - moved[running][:, i]
            lacks = missing[running][:, pairs] - (n[..., 0] * away[..., 0] + n[..., 1] * away[..., 1])
            before = pressure[running][:, pairs]
            more = np.maximum(before + lacks / resistance[pairs], 0.0) - before
            worst = np.maximum(worst, lacks.max(axis=1))
            worst = np.maximum(worst, np.abs(more).max(axis=1))
            pressure[running[:, None], pairs] = before + more
            moved[running[:, None], i] -= (yields[i] * more)[..., None] * n
            moved[running[:, None], j] += (yields[j] * more)[..., None] * n
        running = running[worst > _KNOWN_TO_M]
        if not len(running):
            break
    new_place = place.copy()
    new_place[open_worlds] += moved
    return new_place


def _separation(place: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n, n) how far boxes that are not turned are apart along the axis along which they are further; negative: they
    overlap by that much, m."""
    along = [
        np.abs(place[:, None, axis] - place[:, axis]) - (half_size[:, None, axis] + half_size[:, axis])
        for axis in range(2)
    ]
    return np.asarray(np.maximum(*along))


def _widest(
    place: FloatArray, half_size: FloatArray, yaw: FloatArray, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """(m, p, 2) the axis of each pair along which its boxes are furthest apart, from the first one to the second, and
    (m, p) how far, m: rectangles are apart where one of their four axes separates them."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    between = place[:, second] - place[:, first]
    widest = np.full(between.shape[:2], -np.inf)
    normal = np.zeros(between.shape)
    for box in (first, second):
        for x, y in ((cos[:, box], sin[:, box]), (-sin[:, box], cos[:, box])):
            reach = sum(
                half_size[:, other, 0] * np.abs(x * cos[:, other] + y * sin[:, other])
                + half_size[:, other, 1] * np.abs(y * cos[:, other] - x * sin[:, other])
                for other in (first, second)
            )
            along = x * between[..., 0] + y * between[..., 1]
            gap = np.abs(along) - reach
            wider = gap > widest
            sign = np.where(along < 0, -1.0, 1.0)
            widest = np.where(wider, gap, widest)
            normal = np.where(wider[..., None], np.stack([sign * x, sign * y], axis=-1), normal)
    return normal, widest


def _independent(first: NDArray[np.intp], second: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Pairs in groups of which none has a box twice, so that a group's can be worked on together."""
    groups: list[list[int]] = []
    boxes: list[set[int]] = []
    for pair, both in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        group = next((k for k, some in enumerate(boxes) if not some.intersection(both)), len(groups))
        if group == len(groups):
            groups.append([])
            boxes.append(set())
        groups[group].append(pair)
        boxes[group].update(both)
    return [np.array(group) for group in groups]
