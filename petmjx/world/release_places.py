"""Places at which boxes are released, so that they are at rest on their supports and overlap no other box.
docs/rules.md, section 4, states the places.

If places and sizes have errors, boxes may overlap when they appear. Contacts would throw overlapping boxes apart.
Stiffer contacts and shorter timesteps would throw them apart faster. Whether the pallet stands would then depend on the
stiffness of contacts and on the timestep, which are no properties of boxes. So, before boxes are released, overlapping
boxes are moved apart horizontally, by the smallest possible translations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.simulation import Check, Simulation
from petmjx.plans.plan_warnings import meets, shared_length
from petmjx.world.bearings import TOUCH_M
from petmjx.world.compliance import bed_depth_m, sinks_m
from petmjx.world.contact_laws import CONTACTS_PER_FACE, cone_factor, depth_m
from petmjx.world.growing_scenes import NextBoxes, Stacks
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene
from petmjx.world.scene_arrays import stacked_values

NOTHING: Final = -2
"""Stands in place of the number of a support if a box has no support: the box hangs in the air, or falls into its
place."""

MOST_FOLLOWED_M: Final = 0.002
"""Largest distance by which a box is released higher or lower because its support has moved vertically, m. A pile that
has moved farther no longer carries the box as planned."""


class Release(NamedTuple):
    """The places at which n boxes are released.

    For several scenes with arrays of equal shapes, every array has an additional first axis, with one entry per scene.

    Attributes:
        support: (n,) number of the box under the largest part of each box's base, or ``CARRIER`` or ``NOTHING``. If
            this support has moved vertically, the box is released higher or lower by the same distance.
        pos: (n, 3) middles of the boxes at release if their supports are at their planned places, m.
        most_followed_m: largest distance by which a box is released higher or lower because its support has moved, m.
            ``most_followed_m`` is larger than ``MOST_FOLLOWED_M`` if boxes are compliant.
    """

    support: NDArray[np.intp]
    pos: FloatArray
    most_followed_m: float = MOST_FOLLOWED_M

    def place_of(self, box: int, scene: Scene, boxes_z: FloatArray, carrier_z: float) -> FloatArray:
        """(3,) place of a box's middle if the box is released now, m.

        Args:
            boxes_z: current heights of the middles of the boxes that are already placed, m.
            carrier_z: current height of the carrier's centre of mass, m.
        """
        place: FloatArray = self.pos[box].copy()
        support = self.support[box]
        if support != NOTHING:
            on_carrier = support == CARRIER
            moved = carrier_z - scene.carrier.pos[2] if on_carrier else boxes_z[support] - scene.target[support, 2]
            place[2] += np.clip(moved, -self.most_followed_m, self.most_followed_m)
        return place


def release_of(scene: Scene, sim: Simulation) -> Release:
    """The places at which the boxes of a scene are released. In a static check, boxes are at their planned places."""
    support, pos, most_followed_m = releases_of([scene], sim)
    return Release(support[0], pos[0], most_followed_m)


def releases_of(scenes: Sequence[Scene], sim: Simulation) -> Release:
    """The places at which the boxes of scenes are released. The places of a scene do not depend on the other scenes.

    The arrays of all scenes must have equal shapes (petmjx.world.scene_arrays). A scene with compliant boxes must be
    the only one in ``scenes``, because its arrays cannot be stacked.
    """
    start, physics = stacked_values(scenes, "start_pos"), sim.physics
    m, n = start.shape[:2]
    if physics.falls_into_place or sim.check is Check.STATIC or not n:
        return Release(np.full((m, n), NOTHING), start)
    target, half = (stacked_values(scenes, name) for name in ("target", "half_size"))
    mass, friction = stacked_values(scenes, "mass"), stacked_values(scenes, "friction")[..., 0]
    carrier_mass = stacked_values(scenes, "carrier.mass")[:, None]
    carrier_friction = stacked_values(scenes, "carrier.friction")[..., 0].max(axis=1)[:, None]
    support = _supports(target, half)
    touches = (support != NOTHING) & (start[..., 2] <= target[..., 2])
    on_carrier, below = support == CARRIER, np.maximum(support, 0)
    share = 1.0 + mass / np.where(on_carrier, carrier_mass, np.take_along_axis(mass, below, axis=1))
    soft = cone_factor(
        physics, friction, np.where(on_carrier, carrier_friction, np.take_along_axis(friction, below, axis=1))
    )
    depth, most_followed_m = depth_m(physics, soft * share * physics.gravity_m_s2 / CONTACTS_PER_FACE), MOST_FOLLOWED_M
    sinks = sinks_m(scenes[0], physics.gravity_m_s2)
    if sinks is not None:
        depth = np.maximum(depth, bed_depth_m(scenes[0], scenes[0].mass * physics.gravity_m_s2))
        most_followed_m += float(sinks.max())
    start[..., 2] -= np.where(touches, depth, 0.0)
    return Release(support, start, most_followed_m)


def release_of_next(before: Stacks, boxes: NextBoxes, sim: Simulation) -> Release:
    """The place at which the next box of each of m worlds is released, bit-identical to the last row of
    ``release_of``.

    Args:
        before: the boxes that are already placed in each world.
        boxes: the next box of each world.
        sim: the options.
    """
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
    # if a box has no support, its own mass and friction stand in for the support's; the depth of this box is not used
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
    """(…, n) the support of each box at its planned place: number of the box under the largest part of its base,
    ``CARRIER`` or ``NOTHING``."""
    low, high = target - half_size, target + half_size
    length, width = (np.maximum(shared_length(low[..., axis], high[..., axis]), 0.0) for axis in range(2))
    area = length * width * np.triu(meets(low[..., 2], high[..., 2], TOUCH_M), k=1)
    box_below = np.where(area.any(axis=-2), area.argmax(axis=-2), NOTHING)
    return np.where(low[..., 2] <= TOUCH_M, CARRIER, box_below)


CLEAR_M: Final = 0.0002
"""Gap between two boxes after they are moved apart, m. The gap must exceed 0.14 mm, since contacts of edges may begin
before the edges touch: at a gap of up to 0.7 × the skins of both boxes. A skin is the thickness by which the collider
enlarges a box (docs/rules.md, section 1)."""

_KNOWN_TO_M: Final = 1e-6
"""Tolerance of the gap ``CLEAR_M``, m. The tolerance is a hundredth of the depth of contacts at rest."""

_MOST_ROUNDS: Final = 500
"""Largest number of rounds of Hildreth's method (see ``make_room``). A row of 12 boxes needs 200 rounds. If boxes still
overlap after the last round, contacts push them apart in the simulation."""


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
    """(m, n, 2) horizontal places of the boxes of m worlds, m, at which no box overlaps a box beside it. The places are
    as near as possible to the given places: the sum of the squares of all translations is as small as possible.

    Two rotated boxes have four horizontal axes. The two boxes are kept apart along the axis along which they overlap
    least. The gap between the two boxes must be at least ``CLEAR_M``, or the planned gap if that is smaller; a planned
    overlap is a negative gap. So each pair gives one linear inequality for the translations. Hildreth's method
    (Hildreth 1957, "A quadratic programming procedure", Naval Research Logistics Quarterly 4, 79-85) finds the smallest
    translations, pair by pair. The places in a world do not depend on other worlds.

    Args:
        place: (m, n, 2) given horizontal places of the boxes' middles, m.
        half_size: (m or 1, n, 3) half extents of the boxes, m.
        yaw: (m or 1, n) rotations of the boxes about the vertical, rad.
        planned, planned_half: (n, 2) planned places and (n, 3) planned half extents of the boxes, m. In the plan, boxes
            are not rotated.
        beside: (n, n) whether two boxes are side by side, so that neither is above the other; a symmetric matrix.
        movable: (n,) whether each box may be moved.
        reach_m: pairs of boxes whose planned gap is larger than ``reach_m`` are ignored, m.
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
    """(n, n) gap between each two unrotated boxes, m: the gap along x or y, whichever is larger; negative if the boxes
    overlap."""
    along = [
        np.abs(place[:, None, axis] - place[:, axis]) - (half_size[:, None, axis] + half_size[:, axis])
        for axis in range(2)
    ]
    return np.asarray(np.maximum(*along))


def _widest(
    place: FloatArray, half_size: FloatArray, yaw: FloatArray, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Two arrays: (m, p, 2) the unit vector along which the gap between the two boxes of each pair is largest, from the
    first box to the second; and (m, p) this gap, m (negative if the boxes overlap).

    The vector is along one of the four axes of the two boxes: if two rectangles do not overlap, one of these axes
    separates them.
    """
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
    """Groups of pairs of boxes. No box occurs twice in a group, so all pairs of a group can be computed together."""
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
