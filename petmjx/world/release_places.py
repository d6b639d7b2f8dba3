"""Release places of boxes: at rest on their supports, without overlaps.

Contacts are soft. Under its present loads, a pile has sunk by up to some tenths of a millimetre. A box's own contacts
are a tenth of a millimetre deep once they carry the box. A box released at its planned place would fall by the sum of
both lengths, land at centimetres per second, and might rock on an edge below it. So a box is released as deep in its
support as its weight will press it in. It is also released lower by the distance by which the support has sunk.

If places and sizes have errors, boxes may overlap when they appear. Contacts of overlapping boxes would throw them
apart, and faster the stiffer the contacts and the shorter the timestep. Whether the pallet stands would then depend on
numbers that are not properties of boxes. So overlapping boxes are first moved apart horizontally, by the smallest
possible translations.
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
"""Stands for a support if a box has none, because it hangs in the air or falls into its place."""

MOST_FOLLOWED_M: Final = 0.002
"""Largest distance by which a box follows its support, m. A pile that has moved farther no longer carries the box as
planned."""


class Release(NamedTuple):
    """How n boxes are released. For several stackable scenes, every array has a leading axis, one entry per scene.

    Attributes:
        support: (n,) the support that each box follows, that is, the body with which it shares the largest area; or
            ``CARRIER`` or ``NOTHING``.
        pos: (n, 3) centres of the released boxes if each support is at its planned place, m.
        most_followed_m: largest distance by which a box follows its support, m; it is larger if supports are compliant.
    """

    support: NDArray[np.intp]
    pos: FloatArray
    most_followed_m: float = MOST_FOLLOWED_M

    def place_of(self, box: int, scene: Scene, boxes_z: FloatArray, carrier_z: float) -> FloatArray:
        """(3,) middle of a box if it is released now, m.

        Args:
            boxes_z, carrier_z: current heights of the centres of earlier boxes, and of the carrier's centre, m.
        """
        place: FloatArray = self.pos[box].copy()
        support = self.support[box]
        if support != NOTHING:
            on_carrier = support == CARRIER
            moved = carrier_z - scene.carrier.pos[2] if on_carrier else boxes_z[support] - scene.target[support, 2]
            place[2] += np.clip(moved, -self.most_followed_m, self.most_followed_m)
        return place


def release_of(scene: Scene, sim: Simulation) -> Release:
    """The releases of a scene's boxes, which are placed one by one. In a static check, all boxes stand at their planned
    places."""
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
    """The releases of stackable scenes (petmjx.world.stackable_scenes), bit-identical to the result of ``release_of``
    for each scene."""
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
    """The release of one more box in each of m worlds, bit-identical to the last row of ``release_of``."""
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
    # if a box has no support, the support's mass and friction are filled with its own, without effect
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
    """(…, n) the support of each box, from planned places: the body under the largest part of its base."""
    low, high = target - half_size, target + half_size
    length, width = (np.maximum(shared_length(low[..., axis], high[..., axis]), 0.0) for axis in range(2))
    area = length * width * np.triu(meets(low[..., 2], high[..., 2], TOUCH_M), k=1)
    box_below = np.where(area.any(axis=-2), area.argmax(axis=-2), NOTHING)
    return np.where(low[..., 2] <= TOUCH_M, CARRIER, box_below)


CLEAR_M: Final = 0.0002
"""Distance to which overlapping boxes are moved apart, m. Contacts of edges begin up to 0.14 mm before the edges touch:
0.7 times the skins of two boxes (docs/rules.md, section 1)."""

_KNOWN_TO_M: Final = 1e-6
"""Tolerance of ``CLEAR_M``, m: a hundredth of the depth of contacts at rest."""

_MOST_ROUNDS: Final = 500
"""Largest number of rounds of Hildreth's method (``make_room``). A row of 12 boxes needs 200 rounds. Any overlap that
remains is left to the contacts."""


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
    """For m worlds, (m, n, 2) the horizontal places of boxes, m, at which no box overlaps a box beside it, as near as
    possible to the original places.

    Nearest means that the sum of the squares of all translations is smallest. Two boxes are kept apart along one axis,
    which is that axis of either box along which they overlap least. Two boxes are kept ``CLEAR_M`` apart, or as in the
    plan if they are nearer or overlap in the plan. So each pair gives one linear inequality for the translations.
    Hildreth's method (Hildreth 1957, "A quadratic programming procedure", Naval Research Logistics Quarterly 4, 79-85)
    finds the smallest translations, pair by pair. The places in a world do not depend on other worlds.

    Args:
        place: (m, n, 2) horizontal places of the boxes' middles, m.
        half_size: (m or 1, n, 3) half extents, m.
        yaw: (m or 1, n) rotation about the vertical, rad.
        planned, planned_half: (n, 2) planned places and (n, 3) planned half extents, m. Planned boxes are not rotated.
        beside: (n, n) symmetric: whether two boxes are beside one another, neither above the other.
        movable: (n,) whether each box may be moved.
        reach_m: pairs that are farther apart than this in the plan are ignored, m.
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
    independent_groups = _independent(first, second)
    running = np.arange(len(open_worlds))
    for _ in range(_MOST_ROUNDS):
        worst = np.zeros(len(running))
        for pairs in independent_groups:
            i, j = first[pairs], second[pairs]
            n = normal[running][:, pairs]
            away = moved[running][:, j] - moved[running][:, i]
            lacks = missing[running][:, pairs] - (n[..., 0] * away[..., 0] + n[..., 1] * away[..., 1])
            before = pressure[running][:, pairs]
            added_force = np.maximum(before + lacks / resistance[pairs], 0.0) - before
            worst = np.maximum(worst, lacks.max(axis=1))
            worst = np.maximum(worst, np.abs(added_force).max(axis=1))
            pressure[running[:, None], pairs] = before + added_force
            moved[running[:, None], i] -= (yields[i] * added_force)[..., None] * n
            moved[running[:, None], j] += (yields[j] * added_force)[..., None] * n
        running = running[worst > _KNOWN_TO_M]
        if not len(running):
            break
    new_place = place.copy()
    new_place[open_worlds] += moved
    return new_place


def _separation(place: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n, n) gaps between unrotated boxes, m: the larger one of the gaps along x and y; negative: they overlap."""
    along = [
        np.abs(place[:, None, axis] - place[:, axis]) - (half_size[:, None, axis] + half_size[:, axis])
        for axis in range(2)
    ]
    return np.asarray(np.maximum(*along))


def _widest(
    place: FloatArray, half_size: FloatArray, yaw: FloatArray, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """(m, p, 2) the axis along which the boxes of each pair are farthest apart, from the first box to the second, and
    (m, p) the gap along this axis, m. Two rectangles are apart if one of their four axes separates them."""
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
    """Groups of pairs. No box occurs twice in a group, so all pairs of a group can be computed together."""
    groups: list[list[int]] = []
    boxes: list[set[int]] = []
    for pair, pair_boxes in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        group = next(
            (k for k, group_boxes in enumerate(boxes) if not group_boxes.intersection(pair_boxes)), len(groups)
        )
        if group == len(groups):
            groups.append([])
            boxes.append(set())
        groups[group].append(pair)
        boxes[group].update(pair_boxes)
    return [np.array(group) for group in groups]
