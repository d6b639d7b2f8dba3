"""The hand that carries a box to its place (docs/rules.md, section 4). Twin of petmjx/engines/mujoco/hand.py.

The carried box is always the box that was placed last. Between two steps, one thread takes boxes up and releases them.
The first thread computes the hand's forces in a step.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.mjx import world_constants
from petmjx.engines.warp.kernels.block_collectives import cross, difference, times
from petmjx.engines.warp.kernels.body_dynamics import (
    angular_velocity,
    box_half,
    center,
    linear_velocity,
    middle_of,
    moments,
    orientation,
    rotation,
    vec6,
)
from petmjx.engines.warp.kernels.box_motion import speed_of
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds
from petmjx.world import approach_paths, hand

NEVER = wp.constant(int(world_constants.NEVER))
FREE = wp.constant(approach_paths.FREE_M)
CLEARANCE = wp.constant(approach_paths.CLEARANCE_M)
MISSED = wp.constant(hand.MISSED_M)
AT_PLACE = wp.constant(hand.AT_PLACE_M)
MOST_SIDESTEPS = wp.constant(approach_paths.MOST_SIDESTEPS)
MOST_WAY_S = wp.constant(approach_paths.MOST_WAY_S)
LOWERING_STEPS = wp.constant(hand.LOWERING_STEPS)


@wp.func
def reach_of(q: wp.vec4, half: wp.vec3) -> wp.vec3:
    """Half extents of the axis-aligned bounding box of a turned box, m."""
    turn = rotation(q)
    return wp.vec3(wp.dot(wp.abs(turn[0]), half), wp.dot(wp.abs(turn[1]), half), wp.dot(wp.abs(turn[2]), half))


@wp.func
def _bounding_extents(
    # Model:
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    world: int,
    box: int,
) -> tuple[wp.vec3, wp.vec3]:
    """Centre and half extents of the axis-aligned bounding box of a standing box, m."""
    q = orientation(state, world, box + 1)
    middle = middle_of(worlds, world, box, center(state, world, box + 1), q)
    return middle, reach_of(q, box_half(worlds, world, box))


@wp.func
def _first_obstacle(
    # Model:
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    world: int,
    count: int,
    place: wp.vec3,
    reach: wp.vec3,
) -> tuple[int, float]:
    """The first standing box that overlaps a box at this place (-1: none), and the highest top of all standing boxes
    that overlap it, m.
    """
    first = int(-1)
    top = float(-1.0e30)
    for other in range(count):
        middle, extent = _bounding_extents(worlds, state, world, other)
        if wp.min(extent + reach - wp.abs(middle - place)) > FREE:
            if first < 0:
                first = other
            top = wp.max(top, middle[2] + extent[2])
    return first, top


@wp.func
def free_begin(
    # Model:
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    world: int,
    box: int,
    begin: wp.vec3,
    reach: wp.vec3,
) -> wp.vec3:
    """The place at which a box begins so that it overlaps no standing box, m: the original place if it is free, else
    the nearest free place beside it, else a place above it.

    Args:
        begin: the original place.
        reach: half extents of the box's axis-aligned bounding box, m.
    """
    place = begin
    first, top = _first_obstacle(worlds, state, world, box, place, reach)
    moves = int(0)
    while first >= 0 and moves < MOST_SIDESTEPS:
        other, extent = _bounding_extents(worlds, state, world, first)
        shared = extent + reach - wp.abs(other - place)
        axis = wp.where(shared[0] <= shared[1], 0, 1)
        place[axis] = place[axis] + wp.where(place[axis] >= other[axis], shared[axis], -shared[axis])
        way = place[axis] - begin[axis]
        if -way > worlds.way_aside[world, box, 0, axis] or way > worlds.way_aside[world, box, 1, axis]:
            break
        first, top = _first_obstacle(worlds, state, world, box, place, reach)
        moves += 1
    if first < 0:
        return place
    place = begin
    first, top = _first_obstacle(worlds, state, world, box, place, reach)
    while first >= 0:
        place[2] = top + reach[2] + CLEARANCE
        first, top = _first_obstacle(worlds, state, world, box, place, reach)
    return place


@wp.func
def take_up(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    world: int,
    box: int,
    step: int,
    # Data out:
    state: Ref[State],
) -> None:
    """Move a box from its release pose to the start of its path. If the path takes steps, a hand carries the box.
    Called by one thread."""
    end = center(state, world, box + 1)
    q = orientation(state, world, box + 1)
    offset = wp.vec3(
        worlds.way_offset[world, box, 0], worlds.way_offset[world, box, 1], worlds.way_offset[world, box, 2]
    )
    planned = middle_of(worlds, world, box, end + offset, q)
    aside = free_begin(worlds, state, world, box, planned, reach_of(q, box_half(worlds, world, box))) - planned
    begin = end + offset + aside
    steps = worlds.way_steps[world, box]
    if steps > 0 and wp.length_sq(aside) > 0.0:
        length = wp.length(offset + aside)
        at_speed = 1.5 * length / worlds.hand_speed[world]
        at_force = wp.sqrt(12.0 * worlds.mass[world, box + 1] * length / worlds.hand_force[world])
        seconds = wp.min(wp.max(at_speed, at_force), MOST_WAY_S)
        steps = wp.max(int(wp.ceil(seconds / model.timestep)), 1)
    for i in range(3):
        state.qpos[world, box, i] = begin[i]
        state.still_qpos[world, box, i] = begin[i]
        state.way_begin[world, i] = begin[i]
        state.way_end[world, i] = end[i]
    if steps > 0:
        state.carried_from[world] = step
        state.carried_steps[world] = steps


@wp.func
def lets_go(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    world: int,
    box: int,
    step: int,
    # Data out:
    state: Ref[State],
) -> bool:
    """Whether the hand releases the box after a step in which it carried the box. The box must have arrived and be at
    rest. Unless the box is meant to fall, it is set down first. Called by one thread."""
    elapsed = step - state.carried_from[world]
    slow = speed_of(worlds, state, world, box) < model.quiet_speed
    lowered_from = state.lowered_from[world]
    if lowered_from != NEVER:
        since = step - lowered_from
        return since >= model.stuck_steps or (slow and since >= LOWERING_STEPS)
    if elapsed < state.carried_steps[world] + wp.where(slow, 0, model.stuck_steps):
        return False
    place = center(state, world, box + 1)
    if worlds.falls[world, box] and wp.length(_world_vector(state.way_end, world) - place) <= AT_PLACE:
        return True
    state.lowered_from[world] = step
    return False


@wp.func
def has_missed(
    # Data in:
    state: Ref[State],
    # In:
    world: int,
    box: int,
) -> bool:
    """Whether a released box is too far from its place to count as placed."""
    return wp.length(_world_vector(state.way_end, world) - center(state, world, box + 1)) > MISSED


@wp.func
def _world_vector(values: wp.array2d[float], world: int) -> wp.vec3:
    """The 3-vector stored for a world."""
    return wp.vec3(values[world, 0], values[world, 1], values[world, 2])


@wp.func
def _progress(step: int, steps: int) -> float:
    """Share of a path of ``steps`` steps covered by step ``step``, with a smooth start and stop."""
    share = wp.clamp(float(step) / float(steps), 0.0, 1.0)
    return times(share * share, 3.0 - 2.0 * share)


@wp.func
def _limited(vector: wp.vec3, most: float) -> wp.vec3:
    """A vector, shortened to this length if it is longer."""
    length = wp.length(vector)
    return wp.where(length <= most, vector, vector * (most / wp.max(length, 1.0e-30)))


@wp.func
def _rotation_vector(q: wp.vec4, target_quat: wp.vec4) -> wp.vec3:
    """Rotation vector from one orientation to another, in the axes of the first, rad; for small angles."""
    w = q[0]
    u = wp.vec3(q[1], q[2], q[3])
    v = wp.vec3(target_quat[1], target_quat[2], target_quat[3])
    real = w * target_quat[0] + wp.dot(u, v)
    imaginary = difference(w, v, target_quat[0], u) - cross(u, v)
    return imaginary * wp.where(real >= 0.0, 2.0, -2.0)


@wp.func
def _hand_qacc(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    world: int,
    box: int,
    inertia: wp.vec3,
) -> vec6:
    """Accelerations that the hand gives a box during the next step: m/s² in world axes, rad/s² in the box's."""
    mass = worlds.mass[world, box + 1]
    half = box_half(worlds, world, box)
    most = worlds.hand_force[world]
    q = orientation(state, world, box + 1)
    place = center(state, world, box + 1)
    velocity = linear_velocity(state, world, box + 1)
    spin = angular_velocity(state, world, box + 1)
    force = wp.vec3(0.0, 0.0, 0.0)
    moment = wp.vec3(0.0, 0.0, 0.0)
    if state.lowered_from[world] != NEVER:
        force = _limited(-mass * model.lowering_rate * velocity, most + mass * model.gravity)
        moment = wp.cw_mul(inertia, -model.lowering_rate * spin)
    else:
        rate = model.hand_rate
        elapsed = state.step[world] - state.carried_from[world]
        steps = state.carried_steps[world]
        before = _progress(elapsed - 1, steps)
        now = _progress(elapsed, steps)
        after = _progress(elapsed + 1, steps)
        begin = _world_vector(state.way_begin, world)
        way = _world_vector(state.way_end, world) - begin
        ahead = begin + now * way - place
        lag = (now - before) / model.timestep * way - velocity
        along = ((after - now) - (now - before)) / (model.timestep * model.timestep) * way
        force = _limited(mass * (along + rate * rate * ahead + 2.0 * rate * lag), most)
        force = force + wp.vec3(0.0, 0.0, mass * model.gravity)
        target_quat = wp.vec4(
            worlds.start[world, box, 3],
            worlds.start[world, box, 4],
            worlds.start[world, box, 5],
            worlds.start[world, box, 6],
        )
        turn = difference(rate * rate, _rotation_vector(q, target_quat), 2.0 * rate, spin)
        moment = wp.vec3(inertia[0] * turn[0], inertia[1] * turn[1], inertia[2] * turn[2])
    moment = _limited(moment, most * wp.max(half))
    qacc = vec6()
    for i in range(3):
        qacc[i] = force[i] / mass
        qacc[3 + i] = moment[i] / inertia[i]
    return qacc


@wp.func
def carry(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    at: Thread,
    # Data out:
    work: Ref[Workspace],
) -> None:
    """Let the hand act in the next step. Called after ``begin_step``. While a box is carried, the carrier is free."""
    if at.carried != 0 and at.thread == 0:
        body = at.placed
        equal = worlds.inertia_box[at.world, body]
        inertia = moments(wp.vec3(equal[0], equal[1], equal[2]), worlds.mass[at.world, body])
        qacc = _hand_qacc(model, worlds, state, at.world, body - 1, inertia)
        for i in range(6):
            work.qacc_smooth[at.block, 6 * body + i] = work.qacc_smooth[at.block, 6 * body + i] + qacc[i]
