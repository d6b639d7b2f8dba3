"""Approach paths: where a box starts, and how it moves to its place.

A box starts above its place. A carried box also starts to the side of its place, away from its neighbours. The path is
straight, and a hand (petmjx.world.hand) moves the box along it. Boxes that appear at their places have no path.
docs/rules.md, section 4, has all rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.placing import Placing, Way
from petmjx.options.simulation import Check, Simulation
from petmjx.world.body_shapes import Room
from petmjx.world.rotation import rotations
from petmjx.world.scene import Scene
from petmjx.world.scene_arrays import stacked_values

MOST_WAY_S: Final = 2.0
"""Longest duration of an approach, s. If an approach would take longer, because the box starts high, the box moves
faster."""

FREE_M: Final = 0.0003
"""Largest overlap of two boxes that is ignored, m. Contacts are soft: each of two boxes that touch side by side may be
pressed out of its place by half of this distance. An overlap of 0.3 mm does not visibly push neighbours apart."""

MOST_TILTED: Final = 0.5
"""Largest angle by which tines (of a fork that carries boxes) tilt a box, as a share of the tilt threshold. With a
larger angle, the tilt of a box that tines have just released might count as a sign of failure."""

MOST_SIDESTEPS: Final = 8
"""Largest number of times that the start of a path is moved aside because a box is in the way. If a box is still in the
way of the start, the start is moved up instead."""

ASIDE_SHARE: Final = 2.0
"""Largest distance by which the start of a path is moved aside, as a multiple of the option ``placing.side_mm``, the
horizontal distance between start and place. The multiple is larger than 1, since the position errors of two boxes may
add up."""

CLEARANCE_M: Final = 0.001
"""Height of a box's bottom above the highest obstacle, m, if the box must start above obstacles."""

BESIDE_M: Final = 0.005
"""Two boxes of a plan count as side by side along an axis if they overlap along this axis by at most this length, m."""


class ApproachPath(NamedTuple):
    """The paths on which the n boxes of a scene reach their places.

    For several scenes with arrays of equal shapes, every array has an additional first axis, with one entry per scene.
    Positions are the positions of the boxes' middles, m.

    Attributes:
        lift: (n, 3) vector from each box's place to the end of its path, m. The box is released at the end of its path.
        quat: (n, 4) orientation of each box on its path, as a quaternion (w, x, y, z).
        offset: (n, 3) vector from the end of each path to its start, m. If another box is at that start, the start is
            moved (``free_begin``).
        steps: (n,) duration of each path in steps. A box with 0 steps is not carried, but falls.
        falls: (n,) whether each box falls at the end of its path. If a box does not fall, the hand sets it down before
            releasing it.
        aside: (n, 2, 2) largest distance by which the start of each path may be moved aside, m. Axis 1 is the negative
            and the positive direction, axis 2 is x and y.
    """

    lift: FloatArray
    quat: FloatArray
    offset: FloatArray
    steps: NDArray[np.int64]
    falls: NDArray[np.bool_]
    aside: FloatArray


def approach_path_of(scene: Scene, sim: Simulation) -> ApproachPath | None:
    """The approach paths of the boxes of a scene; None if the boxes appear at their places."""
    paths = approach_paths_of([scene], sim)
    return None if paths is None else ApproachPath(*(values[0] for values in paths))


def approach_paths_of(scenes: Sequence[Scene], sim: Simulation) -> ApproachPath | None:
    """The approach paths of scenes whose arrays have equal shapes (petmjx.world.scene_arrays); None if the boxes
    appear at their places. The paths of a scene do not depend on the other scenes."""
    placing = scenes[0].placing
    if placing.appears or sim.check is Check.STATIC:
        return None
    start, target, half_size, quat = (
        stacked_values(scenes, name) for name in ("start_pos", "target", "half_size", "start_quat")
    )
    lift, offset = np.zeros(start.shape), np.zeros(start.shape)
    offset[..., 2] = placing.height_mm / MM_PER_M
    steps, falls = np.zeros(start.shape[:2], np.int64), start[..., 2] > target[..., 2]
    room = Room.of([scene.carrier for scene in scenes]) if scenes[0].carrier.walls else None
    if placing.carries:
        beside = _neighbour_mask(target, half_size, placing, room)
        approach, open_side = _approaches(beside, scenes[0].approach)
        offset[..., :2] = -placing.side_mm / MM_PER_M * approach
        if placing.name is Way.TINES:
            lift, quat = _on_an_edge(quat, half_size, open_side, placing.tines_mm / MM_PER_M, sim.thresholds.tilt_deg)
            falls = np.ones(falls.shape, dtype=bool)
    aside = np.full((*start.shape[:2], 2, 2), most_aside_m(placing))
    if room is not None:
        reaches = reach(quat.reshape(-1, 4), half_size.reshape(-1, 3)).reshape(start.shape)
        offset[..., :2], aside = _between_walls(room, start + lift, offset[..., :2], reaches, aside)
    if placing.carries:
        length_m, mass = np.linalg.norm(offset, axis=-1), stacked_values(scenes, "mass")
        steps = way_steps(length_m, mass, placing, sim.physics.timestep_s)
    return ApproachPath(lift, quat, offset, steps, falls, aside)


def _between_walls(
    room: Room, end: FloatArray, offset: FloatArray, reaches: FloatArray, aside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Two arrays: (…, n, 2) horizontal vectors from the ends of the paths to starts that are between the walls, m; and
    (…, n, 2, 2) the distances by which these starts may still be moved aside, m (``ApproachPath.aside``).

    A box that does not fit between the walls starts in the middle between them.

    Args:
        end: (…, n, 3) ends of the paths, m.
        offset: (…, n, 2) horizontal vectors from the ends of the paths to their starts if there were no walls, m.
        reaches: (…, n, 3) half extents of the rotated boxes along x, y and z, m.
        aside: (…, n, 2, 2) ``ApproachPath.aside`` if there were no walls, m.
    """
    gap = room.gaps(end, reaches, BESIDE_M)
    low, high = -gap[..., 0, :], gap[..., 1, :]
    narrow = low > high
    middle = (np.where(narrow, low, 0.0) + np.where(narrow, high, 0.0)) / 2
    clipped = np.where(narrow, middle, np.clip(offset, np.minimum(low, high), high))
    free = np.maximum(np.stack([clipped - low, high - clipped], axis=-2), 0.0)
    return clipped, np.minimum(aside, free)


def way_steps(
    length_m: FloatArray | float, mass_kg: FloatArray | float, placing: Placing, timestep_s: float
) -> NDArray[np.int64]:
    """Durations of paths in steps, given their lengths and the boxes' masses.

    The largest speed on a path, 1.5 × length / time, is at most the option ``placing.speed_m_s``. The largest
    acceleration, 6 × length / time², needs at most half of the hand's force. No path takes longer than ``MOST_WAY_S``.
    """
    seconds = np.maximum(1.5 * length_m / placing.speed_m_s, np.sqrt(12.0 * mass_kg * length_m / placing.force_n))
    steps: NDArray[np.int64] = np.ceil(np.minimum(seconds, MOST_WAY_S) / timestep_s).astype(np.int64)
    return np.maximum(steps, 1)


def progress(step: int, steps: int) -> float:
    """Share of a path that a box has covered at step number ``step``, if the whole path takes ``steps`` steps: 3t² −
    2t³ with t = step / steps. The speed is 0 at both ends of the path."""
    share = min(max(step / steps, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def most_aside_m(placing: Placing) -> float:
    """Largest distance, m, by which the start of a path may be moved aside along x. The same limit holds along y."""
    return ASIDE_SHARE * placing.side_mm / MM_PER_M


def reach(quat: FloatArray, half_size: FloatArray) -> FloatArray:
    """(k, 3) half extents of the axis-aligned bounding boxes of k rotated boxes, m."""
    return np.asarray(np.einsum("kij,kj->ki", np.abs(rotations(quat)), half_size))


def free_begin(
    begin: FloatArray, own_reach: FloatArray, pos: FloatArray, reaches: FloatArray, most_m: FloatArray
) -> FloatArray:
    """(3,) position of a box's middle at the start of its path, m, at which the box overlaps no other box.

    The result is ``begin`` if there is room, else a position beside ``begin``, else a position above ``begin``. The box
    is moved aside from the first box that it overlaps, along the axis (x or y) along which the overlap is smaller. The
    box is moved aside at most ``MOST_SIDESTEPS`` times. If the box would be moved by more than ``most_m`` in all, or
    still overlaps a box, it is moved up from ``begin`` instead. ``begin`` is between the carrier's walls, and a box
    that is moved aside by up to ``most_m`` stays between the walls.

    Args:
        begin: (3,) preferred position at the start, m.
        own_reach: (3,) half extents of the box along x, y and z, m.
        pos: (k, 3) middles of the boxes that already stand, m.
        reaches: (k, 3) half extents along x, y and z of the boxes that already stand, m.
        most_m: (2, 2) largest distances, m, by which the box may be moved aside. Axis 0 is the negative and the
            positive direction, axis 1 is x and y.
    """
    aside = begin.copy()
    for _ in range(MOST_SIDESTEPS + 1):
        overlap, in_way = _overlap(aside, own_reach, pos, reaches)
        if not in_way.any():
            return aside
        first = int(in_way.argmax())
        axis = 0 if overlap[first, 0] <= overlap[first, 1] else 1
        away = 1.0 if aside[axis] >= pos[first, axis] else -1.0
        aside[axis] += away * overlap[first, axis]
        way_m = aside[axis] - begin[axis]
        if -way_m > most_m[0, axis] or way_m > most_m[1, axis]:
            break
    above = begin.copy()
    for _ in range(len(pos)):
        _, in_way = _overlap(above, own_reach, pos, reaches)
        if not in_way.any():
            break
        above[2] = (pos[in_way, 2] + reaches[in_way, 2]).max() + own_reach[2] + CLEARANCE_M
    return above


def _overlap(
    place: FloatArray, own_reach: FloatArray, pos: FloatArray, reaches: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(k, 3) overlap of a box with each of k other boxes along x, y and z, m, and (k,) whether the two boxes overlap
    along all three axes."""
    shared = reaches + own_reach - np.abs(pos - place)
    return shared, np.asarray((shared > FREE_M).all(axis=1))


def _approaches(beside: NDArray[np.bool_], approaches: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Two arrays: (…, n, 2) horizontal directions in which boxes move to their places; and (…, n, 2) the forward
    directions that the boxes would have on the tines of a fork, each a unit vector along x or y.

    A box starts beside its place. The horizontal distance from start to place is the length of the box's direction
    vector times the option ``placing.side_mm``. If the plan gives no direction, a box that has a neighbour on only one
    of its two sides along x moves along x towards this neighbour. The same rule applies along y. So a box without
    neighbours, or between two neighbours, moves straight down. The forward direction on tines is along the axis that is
    nearest to the direction of movement. If the box moves straight down, the forward direction is along an axis on
    which the box has no neighbour; if x and y are equally good, it is along x.

    Args:
        beside: (…, n, 2, 2) whether each side of a box has a neighbour, from ``_neighbour_mask``.
        approaches: (n, 2) directions that the plan gives. A row of zeros means that the plan gives no direction for
            this box. ``approaches`` is None if the plan gives no directions.
    """
    towards = beside[..., 1, :].astype(float) - beside[..., 0, :]
    if approaches is not None:
        towards = np.where(approaches.any(axis=1, keepdims=True), approaches, towards)
    busy = beside.all(axis=-2) | (towards == 0) & beside.any(axis=-2)
    x_first = np.abs(towards[..., 0]) >= np.abs(towards[..., 1])
    none = ~towards.any(axis=-1)
    along_x = np.where(none, ~busy[..., 0] | busy[..., 1], x_first)
    sign = np.where(none, 1.0, np.where(np.where(along_x, towards[..., 0], towards[..., 1]) < 0, -1.0, 1.0))
    side = np.stack([sign * along_x, sign * ~along_x], axis=-1)
    return towards, side


def _neighbour_mask(place: FloatArray, half: FloatArray, placing: Placing, room: Room | None) -> NDArray[np.bool_]:
    """(…, n, 2, 2) whether each side of a box will have a neighbour when the box is placed, if all boxes stand as
    planned. Axis −2 is the low and the high side, axis −1 is x and y.

    A neighbour is a box or a wall that is nearer than the largest distance by which a path's start may be moved aside.

    Args:
        place: (…, n, 3) planned middles of the boxes, m.
        half: (…, n, 3) half extents of the boxes, m.
        room: the space between the carrier's walls. If ``room`` is None, there are no walls.
    """
    near_m = most_aside_m(placing)
    lifted_m = placing.height_mm / MM_PER_M
    # one matrix per axis: the distance from the box of the row to the box of the column
    between = [place[..., None, :, axis] - place[..., :, None, axis] for axis in range(3)]
    gap = [np.abs(between[axis]) - (half[..., None, :, axis] + half[..., :, None, axis]) for axis in range(3)]
    before = np.tri(place.shape[-2], k=-1, dtype=bool)
    level = before & ((gap[2] < -BESIDE_M) | ((gap[2] < lifted_m) & (between[2] > 0)))
    neighbours = np.zeros((*place.shape[:-1], 2, 2), dtype=bool)
    for axis in range(2):
        shares = gap[1 - axis] < -BESIDE_M
        beside = level & shares & (gap[axis] >= -BESIDE_M) & (gap[axis] < near_m)
        for side in range(2):
            neighbours[..., side, axis] = (beside & ((between[axis] > 0) == bool(side))).any(axis=-1)
    return neighbours if room is None else neighbours | (room.gaps(place, half, BESIDE_M) < near_m)


def _on_an_edge(
    quat: FloatArray, half_size: FloatArray, towards: FloatArray, height_m: float, tilt_deg: float
) -> tuple[FloatArray, FloatArray]:
    """(…, n, 3) ``lift`` and (…, n, 4) ``quat`` of ``ApproachPath`` for boxes that stand on their rear bottom edge,
    with the front edge raised by tines.

    Args:
        quat: (…, n, 4) orientations of the boxes at release, as quaternions (w, x, y, z).
        half_size: (…, n, 3) half extents of the boxes, m.
        towards: (…, n, 2) forward direction of each box: unit vector along the box's own x or y axis.
        height_m: height of the front edge, m.
        tilt_deg: the tilt threshold, degrees.
    """
    yaw = 2.0 * np.arctan2(quat[..., 3], quat[..., 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    along_x, along_y = towards[..., 0], towards[..., 1]
    ahead = np.stack([cos * along_x - sin * along_y, sin * along_x + cos * along_y], axis=-1)
    half = np.where(along_x != 0, half_size[..., 0], half_size[..., 1])
    most = np.radians(MOST_TILTED * tilt_deg)
    angle = np.arcsin(np.minimum(height_m / (2.0 * half), np.sin(min(most, np.pi / 2))))
    up = half_size[..., 2]
    along = half * np.cos(angle) - up * np.sin(angle) - half
    raised = half * np.sin(angle) + up * np.cos(angle) - up
    lift = np.concatenate([along[..., None] * ahead, raised[..., None]], axis=-1)
    # quaternion product: the rotation ``quat``, followed by a rotation by ``angle`` about the horizontal axis that
    # points to the right of the forward direction
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    a, b = s * ahead[..., 1], -s * ahead[..., 0]
    w, x, y, z = np.moveaxis(quat, -1, 0)
    turned = (c * w - a * x - b * y, c * x + a * w + b * z, c * y - a * z + b * w, c * z + a * y - b * x)
    return lift, np.stack(turned, axis=-1)
