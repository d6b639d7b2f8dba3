"""How boxes come to their places where they do not appear there: from where, along which way, held by what hand.

A box begins above its place and, if it is carried, beside it: away from what stands there. On a straight way it is
drawn by a spring and a damper to a point that moves smoothly from its beginning to its place. The rules:
docs/rules.md, section 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.placing import Placing, Way
from petmjx.options.simulation import Check, Simulation
from petmjx.world.rotation import rotations
from petmjx.world.scene import Scene
from petmjx.world.stackable_scenes import stacked_values

HAND_RATE_1_S: Final = 50.0
"""Natural frequency of the hand's spring, 1/s. It is critically damped: a box that is pushed away is back after about
3 / 50 s. It is 1 / the time constant of the contacts of ``pallet``: a stiffer hand would fight with contacts. The
stiffness is m · 50² / s²: where a box is 1 mm short of its way it presses with 2.5 N per kg."""

MOST_RATE_PER_STEP: Final = 0.1
"""Largest natural frequency × timestep. Forces of the hand are those of a step's beginning; with semi-implicit Euler
they are stable below 2 (√2 − 1) = 0.83 (Jury's criterion on z² − (2 − 2h − h²) z + 1 − 2h), and follow the continuous
ones to a tenth at 0.1."""

MOST_WAY_S: Final = 2.0
"""Time of the longest way: a box that must begin high above its place goes faster than others."""

MOST_STUCK_S: Final = 0.5
"""How long a hand holds a box at most after the way's end, if it does not come to rest; and as long while it sets it
down."""

AT_PLACE_M: Final = 0.0002
"""A box that is no further from its way's end is there: the softness of a contact is a tenth of a millimetre."""

MISSED_M: Final = 0.01
"""A box that a hand lets go further from its place could not be placed. Boxes that find room are within 5 mm of it,
those that stand on the edges of their neighbours as much too high as these are high, or half as much."""

LOWERING_RATE_1_S: Final = 400.0
MOST_LOWERING_PER_STEP: Final = 0.8
"""A box is set down by a damper of this rate, 1/s, but at most so much per step: semi-implicit Euler is stable below 2.
It sinks with g / 400 per s, 25 mm/s, at which a contact of ``pallet`` gives way by a quarter of a millimetre."""

LOWERING_STEPS: Final = 5
"""Fewest steps of it: without a support a box is then faster than a quiet one."""

FREE_M: Final = 0.0003
"""Boxes that overlap by no more are free of one another: twice what neighbours that stand flush may have moved by the
softness of contacts, and less than would push them apart visibly."""

MOST_TILTED: Final = 0.5
"""Tines tilt a box by at most this share of the threshold of tilt, so that its release is not taken for a first
sign."""

MOST_SIDESTEPS: Final = 8
"""How often a box goes aside before it goes up."""

ASIDE_SHARE: Final = 2.0
"""How far aside a box goes at most, as a share of how far beside its place it begins: errors of two places may add."""

CLEARANCE_M: Final = 0.001
"""How far above what is in its way a box begins."""

_BESIDE_M: Final = 0.005
"""Boxes whose planned extents overlap by no more along an axis are beside one another there: sizes and places have
errors."""


class ApproachPath(NamedTuple):
    """How the n boxes of a scene come to their places; of many scenes that are alike, with an axis of these before the
    others. Places are those of their middles, m.

    Attributes:
        lift: (n, 3) from where a box would rest to where it is let go.
        quat: (n, 4) how it is turned on its way.
        offset: (n, 3) from where it is let go to where it begins, if that is free.
        steps: (n,) of its way; 0: it is not carried, but falls.
        falls: (n,) whether it is let go where its way ends, to fall; others are set down first.
    """

    lift: FloatArray
    quat: FloatArray
    offset: FloatArray
    steps: NDArray[np.int64]
    falls: NDArray[np.bool_]


def approach_path_of(scene: Scene, sim: Simulation) -> ApproachPath | None:
    """How the boxes of a scene come to their places; None: they appear there."""
    placing, n = scene.placing, scene.n_boxes
    if placing.appears or sim.check is Check.STATIC:
        return None
    lift, quat, offset = np.zeros((n, 3)), scene.start_quat, np.zeros((n, 3))
    offset[:, 2] = placing.height_mm / MM_PER_M
    steps, falls = np.zeros(n, np.int64), scene.start_pos[:, 2] > scene.target[:, 2]
    if placing.carries:
        approach, open_side = _approaches(scene)
        offset[:, :2] = -placing.side_mm / MM_PER_M * approach
        if placing.name is Way.TINES:
            lift, quat = _on_an_edge(scene, open_side, sim.thresholds.tilt_deg)
            falls = np.ones(n, dtype=bool)
        steps = way_steps(np.linalg.norm(offset, axis=1), scene.mass, placing, sim.physics.timestep_s)
    return ApproachPath(lift, quat, offset, steps, falls)


def approach_paths_of(scenes: Sequence[Scene], sim: Simulation) -> ApproachPath | None:
    """The courses of plain scenes that are alike (petmjx.world.stackable_scenes), to the last bit as
    ``approach_path_of`` has each."""
    placing = scenes[0].placing
    if placing.appears or sim.check is Check.STATIC:
        return None
    if placing.name is Way.TINES:
        courses = [approach_path_of(scene, sim) for scene in scenes]
        return ApproachPath(
            *(np.array(values) for values in zip(*(course for course in courses if course), strict=True))
        )
    start, target = (stacked_values(scenes, name) for name in ("start_pos", "target"))
    quat, offset = stacked_values(scenes, "start_quat"), np.zeros(start.shape)
    offset[..., 2] = placing.height_mm / MM_PER_M
    steps, falls = np.zeros(start.shape[:2], np.int64), start[..., 2] > target[..., 2]
    if placing.carries:
        half_size = stacked_values(scenes, "half_size")
        approach, _ = _approaches_of(_neighbour_mask(target, half_size, placing), scenes[0].approach)
        offset[..., :2] = -placing.side_mm / MM_PER_M * approach
        length_m, mass = np.linalg.norm(offset, axis=-1), stacked_values(scenes, "mass")
        steps = way_steps(length_m, mass, placing, sim.physics.timestep_s)
    return ApproachPath(np.zeros(start.shape), quat, offset, steps, falls)


def way_steps(
    length_m: FloatArray | float, mass_kg: FloatArray | float, placing: Placing, timestep_s: float
) -> NDArray[np.int64]:
    """Steps of ways of these lengths: so many that the largest speed, 1.5 × length / time, is that of the options, and
    that half of the hand's force gives the largest acceleration, 6 × length / time²."""
    seconds = np.maximum(1.5 * length_m / placing.speed_m_s, np.sqrt(12.0 * mass_kg * length_m / placing.force_n))
    steps: NDArray[np.int64] = np.ceil(np.minimum(seconds, MOST_WAY_S) / timestep_s).astype(np.int64)
    return np.maximum(steps, 1)


def progress(step: int, steps: int) -> float:
    """Share of the way after some of its steps: 3t² − 2t³ of the time's share t, at rest at both ends."""
    share = min(max(step / steps, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def rate_1_s(timestep_s: float) -> float:
    """Natural frequency of the hand's spring, 1/s."""
    return min(HAND_RATE_1_S, MOST_RATE_PER_STEP / timestep_s)


def lowering_rate_1_s(timestep_s: float) -> float:
    """Rate of the damper by which a box is set down, 1/s."""
    return min(LOWERING_RATE_1_S, MOST_LOWERING_PER_STEP / timestep_s)


def most_aside_m(placing: Placing) -> float:
    """How far a box goes aside along x and y each at most, m."""
    return ASIDE_SHARE * placing.side_mm / MM_PER_M


def stuck_steps(timestep_s: float) -> int:
    """Steps for which a hand holds a box at most after the way's end, or sets it down."""
    return int(MOST_STUCK_S / timestep_s)


def reach(quat: FloatArray, half_size: FloatArray) -> FloatArray:
    """(k, 3) half extents along x, y and z of the boxes around k turned boxes, m."""
    return np.asarray(np.einsum("kij,kj->ki", np.abs(rotations(quat)), half_size))


def free_begin(
    begin: FloatArray, own_reach: FloatArray, pos: FloatArray, reaches: FloatArray, most_m: float
) -> FloatArray:
    """(3,) where a box begins so that it is in no other, m: there, or as little aside as it must, or above.

    It goes aside from the first box that it overlaps, along x or y, where it overlaps less, and so on. If it would have
    to go further than it may, or comes to no end, it goes up instead, from where it was.

    Args:
        begin: (3,) where it would begin; its half extents (3,).
        pos, reaches: (k, 3) of the boxes that stand.
        most_m: how far it may go aside along x and y each.
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
        if abs(aside[axis] - begin[axis]) > most_m:
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
    """(k, 3) lengths that a box and others share along each axis, m, and (k,) whether it is in the other one."""
    shared = reaches + own_reach - np.abs(pos - place)
    return shared, np.asarray((shared > FREE_M).all(axis=1))


def _approaches(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """As ``_approaches_of`` of a scene."""
    return _approaches_of(_neighbour_mask(scene.target, scene.half_size, scene.placing), scene.approach)


def _approaches_of(beside: NDArray[np.bool_], given: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """(…, n, 2) direction in which each box goes to its place, level, as a share of what the options say, and (…, n, 2)
    unit vectors towards what it goes to.

    Where the plan says nothing it goes, along x and y each, towards the side on which something stands if there is
    nothing on the other one. So a box beside which nothing stands, or that goes between two others, comes from straight
    above. The second vector is the first one's nearest axis of the box; without a first one an axis along which nothing
    stands, +x before +y.

    Args:
        beside: as ``_neighbour_mask`` has it; ``given``: (n, 2) of the plan.
    """
    towards = beside[..., 1, :].astype(float) - beside[..., 0, :]
    if given is not None:
        towards = np.where(given.any(axis=1, keepdims=True), given, towards)
    busy = beside.all(axis=-2) | (towards == 0) & beside.any(axis=-2)
    x_first = np.abs(towards[..., 0]) >= np.abs(towards[..., 1])
    none = ~towards.any(axis=-1)
    along_x = np.where(none, ~busy[..., 0] | busy[..., 1], x_first)
    sign = np.where(none, 1.0, np.where(np.where(along_x, towards[..., 0], towards[..., 1]) < 0, -1.0, 1.0))
    side = np.stack([sign * along_x, sign * ~along_x], axis=-1)
    return towards, side


def _neighbour_mask(place: FloatArray, half: FloatArray, placing: Placing) -> NDArray[np.bool_]:
    """(…, n, 2, 2) whether something stands beside each box before it is placed, by the plan: on its low and its high
    side along x and y, no further away than the box may go aside.

    Args:
        place: (…, n, 3) planned middles, m, ``half``: half extents.
    """
    near_m = most_aside_m(placing)
    lifted_m = placing.height_mm / MM_PER_M
    # along each axis, from the row's box to the column's
    between = [place[..., None, :, axis] - place[..., :, None, axis] for axis in range(3)]
    gap = [np.abs(between[axis]) - (half[..., None, :, axis] + half[..., :, None, axis]) for axis in range(3)]
    before = np.tri(place.shape[-2], k=-1, dtype=bool)
    level = before & ((gap[2] < -_BESIDE_M) | ((gap[2] < lifted_m) & (between[2] > 0)))
    neighbours = np.zeros((*place.shape[:-1], 2, 2), dtype=bool)
    for axis in range(2):
        shares = gap[1 - axis] < -_BESIDE_M
        beside = level & shares & (gap[axis] >= -_BESIDE_M) & (gap[axis] < near_m)
        for side in range(2):
            neighbours[..., side, axis] = (beside & ((between[axis] > 0) == bool(side))).any(axis=-1)
    return neighbours


def _on_an_edge(scene: Scene, towards: FloatArray, tilt_deg: float) -> tuple[FloatArray, FloatArray]:
    """(n, 3) lifts and (n, 4) orientations of boxes on the bottom edge behind, with the one ahead at its height.

    Args:
        towards: (n, 2) what is ahead of each box: a direction along x or y, as its own axes lie before it is turned.
        tilt_deg: the threshold of tilt.
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
    # q_axis(angle) · q about the level axis (a, b) to the right of the direction ahead
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    a, b = s * ahead[:, 1], -s * ahead[:, 0]
    w, x, y, z = scene.start_quat.T
    turned = (c * w - a * x - b * y, c * x + a * w + b * z, c * y - a * z + b * w, c * z + a * y - b * x)
    return lift, np.stack(turned, axis=1)
