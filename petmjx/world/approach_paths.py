"""Approach paths: where a box starts, how it moves to its place, and the hand that holds it meanwhile.

A box starts above its place. A carried box also starts to the side of its place, away from its neighbours. The path is
straight: a spring and a damper pull the box towards a point that moves smoothly from the start to the place. Boxes that
appear at their places have no path. The rules: docs/rules.md, section 4.
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
from petmjx.world.stackable_scenes import stacked_values

HAND_RATE_1_S: Final = 50.0
"""Natural frequency of the hand's spring, 1/s. The spring is critically damped: a box that is pushed away is back after
about 3 / 50 s. The value is 1 / the time constant of the contacts of ``pallet``, since a stiffer hand would work
against the contacts. The stiffness is m · 50² / s²: a box that lags 1 mm behind on its path is pushed with 2.5 N per
kg."""

MOST_RATE_PER_STEP: Final = 0.1
"""Largest natural frequency × timestep. The hand's forces are computed at the beginning of a step. With semi-implicit
Euler, the damped hand is stable if this product is below 2 (√2 − 1) = 0.83 (Jury's criterion on
z² − (2 − 2h − h²) z + 1 − 2h). At 0.1, the simulated motion follows the continuous one to within a tenth."""

MOST_WAY_S: Final = 2.0
"""Longest duration of an approach, s. A box whose approach would take longer, because it starts high, moves faster."""

MOST_STUCK_S: Final = 0.5
"""Longest time for which a hand holds a box after the end of the path, s, if the box does not come to rest. After that,
setting the box down may take up to the same time."""

AT_PLACE_M: Final = 0.0002
"""A box has arrived once it is within this distance of the end of its path, m. The distance allows for contacts, which
give way by a tenth of a millimetre."""

MISSED_M: Final = 0.01
"""A box counts as not placed if the hand releases it farther than this from its place, m. A box that finds room ends
within 5 mm of its place. A box that comes to stand on the edge of a neighbour is too high by the neighbour's height, or
by half of it."""

LOWERING_RATE_1_S: Final = 400.0
MOST_LOWERING_PER_STEP: Final = 0.8
"""A damper sets a box down. The damper's rate is ``LOWERING_RATE_1_S``, 1/s. Rate × timestep is at most
``MOST_LOWERING_PER_STEP``, since semi-implicit Euler is stable below 2. The box sinks at a speed of g / 400 s⁻¹, 25
mm/s. At this speed a contact of ``pallet`` gives way by a quarter of a millimetre."""

LOWERING_STEPS: Final = 5
"""Smallest number of steps during which a hand sets a box down. By then, a box without a support sinks faster than a
box that counts as quiet."""

FREE_M: Final = 0.0003
"""If two boxes overlap by at most this amount, they count as not overlapping, m. The amount is twice the distance by
which soft contacts may move neighbours that stand flush. An overlap of this amount is too small to push neighbours
apart visibly."""

MOST_TILTED: Final = 0.5
"""Tines tilt a box by at most this share of the tilt threshold, so that the tilt of a released box does not count as a
first sign of failure."""

MOST_SIDESTEPS: Final = 8
"""Largest number of times that the start of a path is moved aside. If the start is still not free, it is moved up
instead."""

ASIDE_SHARE: Final = 2.0
"""Largest move aside, as a multiple of the distance to the side at which a box starts. The multiple is larger than 1,
since the errors of two places may add up."""

CLEARANCE_M: Final = 0.001
"""A box that has to start above obstacles starts with its bottom this far above them, m."""

BESIDE_M: Final = 0.005
"""Two boxes count as side by side along an axis if their planned extents along it overlap by at most this, m. The
tolerance is needed since sizes and places have errors."""


class ApproachPath(NamedTuple):
    """The paths on which the n boxes of a scene reach their places.

    For several stackable scenes, every array has a leading axis, one entry per scene. All positions are positions of
    the boxes' middles, m.

    Attributes:
        lift: (n, 3) vector from the place at which a box would rest to the point of its release, m.
        quat: (n, 4) orientation of the box along the path.
        offset: (n, 3) vector from a box's release to the start of its path, m, if that start is free.
        steps: (n,) number of steps of the path; 0: the box is not carried, but falls.
        falls: (n,) True: the box is released at the end of its path and falls. False: at the end of its path, the hand
            sets the box down, and then releases it.
        aside: (n, 2, 2) how far a box may move aside from the start of its path, towards the low and the high end of x
            and y, m.
    """

    lift: FloatArray
    quat: FloatArray
    offset: FloatArray
    steps: NDArray[np.int64]
    falls: NDArray[np.bool_]
    aside: FloatArray


def approach_path_of(scene: Scene, sim: Simulation) -> ApproachPath | None:
    """The approach paths of the boxes of a scene; None: the boxes appear at their places."""
    placing, n = scene.placing, scene.n_boxes
    if placing.appears or sim.check is Check.STATIC:
        return None
    lift, quat, offset = np.zeros((n, 3)), scene.start_quat, np.zeros((n, 3))
    offset[:, 2] = placing.height_mm / MM_PER_M
    steps, falls = np.zeros(n, np.int64), scene.start_pos[:, 2] > scene.target[:, 2]
    room = Room.of([scene.carrier])[0] if scene.carrier.walls else None
    if placing.carries:
        approach, open_side = _approaches(scene, room)
        offset[:, :2] = -placing.side_mm / MM_PER_M * approach
        if placing.name is Way.TINES:
            lift, quat = _on_an_edge(scene, open_side, sim.thresholds.tilt_deg)
            falls = np.ones(n, dtype=bool)
    aside = np.full((n, 2, 2), most_aside_m(placing))
    if room is not None:
        end = scene.start_pos + lift
        offset[:, :2], aside = _between_walls(room, end, offset[:, :2], reach(quat, scene.half_size), aside)
    if placing.carries:
        steps = way_steps(np.linalg.norm(offset, axis=1), scene.mass, placing, sim.physics.timestep_s)
    return ApproachPath(lift, quat, offset, steps, falls, aside)


def approach_paths_of(scenes: Sequence[Scene], sim: Simulation) -> ApproachPath | None:
    """The approach paths of stackable scenes (petmjx.world.stackable_scenes), bit-identical to the result of
    ``approach_path_of`` for each scene."""
    placing = scenes[0].placing
    if placing.appears or sim.check is Check.STATIC:
        return None
    if placing.name is Way.TINES:
        paths = [approach_path_of(scene, sim) for scene in scenes]
        return ApproachPath(*(np.array(values) for values in zip(*(path for path in paths if path), strict=True)))
    start, target = (stacked_values(scenes, name) for name in ("start_pos", "target"))
    quat, offset = stacked_values(scenes, "start_quat"), np.zeros(start.shape)
    offset[..., 2] = placing.height_mm / MM_PER_M
    steps, falls = np.zeros(start.shape[:2], np.int64), start[..., 2] > target[..., 2]
    half_size = stacked_values(scenes, "half_size")
    room = Room.of([scene.carrier for scene in scenes]) if scenes[0].carrier.walls else None
    if placing.carries:
        approach, _ = _approaches_of(_neighbour_mask(target, half_size, placing, room), scenes[0].approach)
        offset[..., :2] = -placing.side_mm / MM_PER_M * approach
    aside = np.full((*start.shape[:2], 2, 2), most_aside_m(placing))
    if room is not None:
        reaches = reach(quat.reshape(-1, 4), half_size.reshape(-1, 3)).reshape(start.shape)
        offset[..., :2], aside = _between_walls(room, start, offset[..., :2], reaches, aside)
    if placing.carries:
        length_m, mass = np.linalg.norm(offset, axis=-1), stacked_values(scenes, "mass")
        steps = way_steps(length_m, mass, placing, sim.physics.timestep_s)
    return ApproachPath(np.zeros(start.shape), quat, offset, steps, falls, aside)


def _between_walls(
    room: Room, end: FloatArray, offset: FloatArray, reaches: FloatArray, aside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(…, n, 2) offsets with which boxes start between the walls, and (…, n, 2, 2) how far each may then move aside.

    A box that does not fit between the walls starts in the middle.

    Args:
        end: (…, n, 3) the ends of the paths, at which boxes are released, m.
        offset: (…, n, 2) from the ends of the paths to their starts, m.
        reaches: (…, n, 3) half extents of the boxes along the axes, m.
        aside: as in ``ApproachPath``, but before walls are taken into account.
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
    """Number of steps of paths with these lengths.

    The largest speed, 1.5 × length / time, is at most the speed in the options. The largest acceleration, 6 × length /
    time², needs at most half of the hand's force. No path takes longer than ``MOST_WAY_S``.
    """
    seconds = np.maximum(1.5 * length_m / placing.speed_m_s, np.sqrt(12.0 * mass_kg * length_m / placing.force_n))
    steps: NDArray[np.int64] = np.ceil(np.minimum(seconds, MOST_WAY_S) / timestep_s).astype(np.int64)
    return np.maximum(steps, 1)


def progress(step: int, steps: int) -> float:
    """Share of a path of ``steps`` steps covered by step ``step``: 3t² − 2t³ with t = step / steps. The box is at rest
    at both ends."""
    share = min(max(step / steps, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def rate_1_s(timestep_s: float) -> float:
    """Natural frequency of the hand's spring at this timestep, 1/s."""
    return min(HAND_RATE_1_S, MOST_RATE_PER_STEP / timestep_s)


def lowering_rate_1_s(timestep_s: float) -> float:
    """Rate of the damper that sets a box down, at this timestep, 1/s."""
    return min(LOWERING_RATE_1_S, MOST_LOWERING_PER_STEP / timestep_s)


def most_aside_m(placing: Placing) -> float:
    """Largest distance that a box may move aside along x, and along y, m."""
    return ASIDE_SHARE * placing.side_mm / MM_PER_M


def stuck_steps(timestep_s: float) -> int:
    """Largest number of steps for which a hand holds a box after the end of its path. Also the largest number of steps
    for which it sets the box down."""
    return int(MOST_STUCK_S / timestep_s)


def reach(quat: FloatArray, half_size: FloatArray) -> FloatArray:
    """(k, 3) half extents of the axis-aligned bounding boxes of k rotated boxes, m."""
    return np.asarray(np.einsum("kij,kj->ki", np.abs(rotations(quat)), half_size))


def free_begin(
    begin: FloatArray, own_reach: FloatArray, pos: FloatArray, reaches: FloatArray, most_m: FloatArray
) -> FloatArray:
    """(3,) where a box starts so that it overlaps no other box, m: at ``begin`` if there is room, else to the side of
    it, else above it.

    The box moves aside from the first box that it overlaps, along x or y, whichever overlap is smaller. This move is
    repeated at most ``MOST_SIDESTEPS`` times. If the box would have to move aside by more than ``most_m``, or still
    overlaps a box, it moves up from ``begin`` instead. ``begin`` is between the carrier's walls, and moves of up to
    ``most_m`` stay between them.

    Args:
        begin: (3,) position at which the box would start if it were free, m.
        own_reach: (3,) half extents of the box, m.
        pos, reaches: (k, 3) middles and half extents of the boxes that already stand, m.
        most_m: (2, 2) largest distance aside, towards the low and the high end of x and y, m.
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
    """(k, 3) overlap of a box with k other boxes along each axis, m, and (k,) whether it overlaps each box."""
    shared = reaches + own_reach - np.abs(pos - place)
    return shared, np.asarray((shared > FREE_M).all(axis=1))


def _approaches(scene: Scene, room: Room | None) -> tuple[FloatArray, FloatArray]:
    """``_approaches_of`` for one scene."""
    return _approaches_of(_neighbour_mask(scene.target, scene.half_size, scene.placing, room), scene.approach)


def _approaches_of(beside: NDArray[np.bool_], approaches: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """(…, n, 2) horizontal directions in which boxes move to their places, and (…, n, 2) unit vectors along an axis.

    A direction has the length 1 if the box starts as far to the side as the options state. If the plan gives no
    direction, a box moves along x towards the side that has a neighbour, provided that the opposite side has none;
    likewise along y. So a box without neighbours, or between two, comes from straight above. The unit vector is the
    axis of the box that is nearest to the direction. If there is no direction, the unit vector is an axis along which
    the box has no neighbour, +x before +y.

    Args:
        beside: the mask of ``_neighbour_mask``.
        approaches: (n, 2) directions given by the plan; None: the plan gives none.
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


def _neighbour_mask(
    place: FloatArray, half: FloatArray, placing: Placing, room: Room | None = None
) -> NDArray[np.bool_]:
    """(…, n, 2, 2) whether each side of a box has a neighbour when the box is placed, according to the plan: (low and
    high side, x and y). A neighbour is a box or a wall that is no farther away than the box may move aside.

    Args:
        place: (…, n, 3) planned middles, m.
        half: (…, n, 3) half extents, m.
        room: the space between the carrier's walls; None: no walls.
    """
    near_m = most_aside_m(placing)
    lifted_m = placing.height_mm / MM_PER_M
    # distance along each axis from the row's box to the column's box
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


def _on_an_edge(scene: Scene, towards: FloatArray, tilt_deg: float) -> tuple[FloatArray, FloatArray]:
    """(n, 3) lifts and (n, 4) orientations of boxes that stand on their rear bottom edge, with the front edge raised.

    Args:
        towards: (n, 2) forward direction of each box: x or y of its own axes, before the box is rotated.
        tilt_deg: the tilt threshold.
    """
    yaw = 2.0 * np.arctan2(scene.start_quat[:, 3], scene.start_quat[:, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead = np.stack([cos * towards[:, 0] - sin * towards[:, 1], sin * towards[:, 0] + cos * towards[:, 1]], axis=1)
    half = np.where(towards[:, 0] != 0, scene.half_size[:, 0], scene.half_size[:, 1])
    height = scene.placing.tines_mm / MM_PER_M
    most = np.radians(MOST_TILTED * tilt_deg)
    angle = np.arcsin(np.minimum(height / (2.0 * half), np.sin(min(most, np.pi / 2))))
    up = scene.half_size[:, 2]
    along = half * np.cos(angle) - up * np.sin(angle) - half
    lift = np.column_stack([along[:, None] * ahead, half * np.sin(angle) + up * np.cos(angle) - up])
    # the product q_axis(angle) · q: a rotation about the horizontal axis (a, b), which points to the right of the
    # forward direction
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    a, b = s * ahead[:, 1], -s * ahead[:, 0]
    w, x, y, z = scene.start_quat.T
    turned = (c * w - a * x - b * y, c * x + a * w + b * z, c * y - a * z + b * w, c * z + a * y - b * x)
    return lift, np.stack(turned, axis=1)
