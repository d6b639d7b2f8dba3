"""The rules of a run for one world, after each of its steps: sampling, placing, resting, ending (docs/rules.md).

Twin of petmjx/engines/batch/rules.py, which does the same for all lanes of a batch at a time. Threads share the boxes.
All read the world's counters before the first barrier, and the first thread changes them after the last one.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.batch import state as batch_state
from petmjx.engines.warp.kernel.block import any_of_all, wait_for_all
from petmjx.engines.warp.kernel.motion import half_size, rotation
from petmjx.engines.warp.records import Lane, Model, State, Tables, Workspace
from petmjx.verdict import Flag

NEVER = wp.constant(int(batch_state.NEVER))
RUNNING = wp.constant(batch_state.Status.RUNNING)
SETTLED = wp.constant(batch_state.Status.SETTLED)
FINISHED = wp.constant(batch_state.Status.FINISHED)
NONFINITE = wp.constant(int(Flag.NONFINITE))
EXPLOSION = wp.constant(int(Flag.EXPLOSION))
EARLY_STOP = wp.constant(int(Flag.EARLY_STOP))

JUST_OVER = wp.constant(1.0000001192092896)
"""The next float32 after 1: the least excess of a box that has dropped."""

LAST_BOX = wp.constant(wp.int64(0x7FFFFFFF))
HALF = wp.constant(wp.int64(32))


@wp.func
def _tilt(q: wp.vec4) -> float:
    """Angle between a box's z axis and the world's, degrees; from the half angle, which float32 resolves."""
    return wp.degrees(2.0 * wp.atan2(wp.sqrt(q[1] * q[1] + q[2] * q[2]), wp.sqrt(q[0] * q[0] + q[3] * q[3])))


@wp.func
def _length(a: wp.array3d[float], world: int, box: int, first: int) -> float:
    """Length of three numbers of a box."""
    x = a[world, box, first]
    y = a[world, box, first + 1]
    z = a[world, box, first + 2]
    return wp.sqrt(x * x + y * y + z * z)


@wp.func
def _look(
    model: Model,
    tables: Tables,
    state: State,
    work: Workspace,
    at: Lane,
    box: int,
    step: int,
    sample: bool,
    driven: bool,
) -> bool:
    """Place of a box in a sample, or at the end; returns whether it has dropped."""
    world = at.world
    place = wp.vec3(0.0, 0.0, 0.0)
    q = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(3):
        place[i] = wp.where(sample, work.seen[at.lane, box, i], state.pose[world, box, i])
    for i in range(4):
        q[i] = wp.where(sample, work.seen[at.lane, box, 3 + i], state.pose[world, box, 3 + i])
    tilt = _tilt(q)
    lowest = place[2] - wp.dot(wp.abs(rotation(q)[2]), half_size(tables, world, box + 2))
    dropped = place[2] < 0.0 or lowest < model.drop_z
    shift = float(0.0)
    for i in range(3):
        moved = wp.abs(place[i] - tables.target[world, box, i])
        if moved >= model.shift_floor:
            shift = wp.max(shift, moved)
    excess = wp.max(shift / model.shift, tilt / model.tilt)
    if dropped:
        excess = wp.max(excess, JUST_OVER)
        if state.drop_step[world, box] < 0:
            state.drop_step[world, box] = step
    # positive numbers are in the order of their bits; of equal ones the first box counts
    key = (wp.int64(wp.cast(excess, wp.int32)) << HALF) | (LAST_BOX - wp.int64(box))
    wp.atomic_max(work.worst, at.lane, key)
    if sample:
        state.max_tilt[world, box] = wp.max(state.max_tilt[world, box], tilt)
        state.max_lin_acc[world, box] = wp.max(state.max_lin_acc[world, box], _length(state.warm, world, box, 0))
        state.max_ang_acc[world, box] = wp.max(state.max_ang_acc[world, box], _length(state.warm, world, box, 3))
        state.max_top_force[world, box] = wp.max(state.max_top_force[world, box], work.top_force[at.lane, box])
    if driven:
        x = place[0] - state.sway_anchor[world, box, 0]
        y = place[1] - state.sway_anchor[world, box, 1]
        state.max_sway[world, box] = wp.max(state.max_sway[world, box], wp.sqrt(x * x + y * y))
    return dropped


@wp.func
def _pace_squared(model: Model, state: State, world: int, box: int) -> float:
    """The larger of a box's linear and angular speed, each divided by its quiet limit, squared."""
    linear = _length(state.vel, world, box, 0) / model.quiet_linear
    angular = _length(state.vel, world, box, 3) / model.quiet_angular
    return wp.max(linear * linear, angular * angular)


@wp.func
def _count_quiet(model: Model, state: State, at: Lane, quiet_steps: int, signs: bool) -> tuple[int, bool]:
    """Steps for which all boxes have been slow, at a poll, and whether the pallet is quiet. If a box creeps it is not,
    and the count starts again."""
    world = at.world
    fast = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        if not _pace_squared(model, state, world, box) < 1.0:
            fast = True
    count = int(0)
    if not any_of_all(fast):
        count = quiet_steps + model.poll_steps
    quiet = count >= model.quiet_steps
    if model.waits_for_creep == 0:
        return count, quiet
    creeps = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        pace = _pace_squared(model, state, world, box)
        if count <= model.poll_steps:
            state.quiet_pace[world, box] = pace
        slow = model.slowing * model.slowing * state.quiet_pace[world, box]
        if not pace < wp.max(model.rest_share * model.rest_share, slow):
            creeps = True
    if any_of_all(creeps) and quiet and not signs:
        quiet = False
        count = model.poll_steps
        for box in range(at.thread, at.placed, at.threads):
            state.quiet_pace[world, box] = _pace_squared(model, state, world, box)
    return count, quiet


@wp.func
def place_next(tables: Tables, state: State, world: int, step: int) -> None:
    """Release the next box: at its release pose, at rest. By one thread."""
    box = state.placed[world]
    for i in range(7):
        state.pose[world, box, i] = tables.start[world, box, i]
    for i in range(6):
        state.vel[world, box, i] = 0.0
        state.warm[world, box, i] = 0.0
        state.ahead[world, box, i] = 0.0
    state.position[world, box] = box + 1
    state.placed[world] = box + 1
    state.last_placed_at[world] = step
    state.quiet_steps[world] = 0


@wp.func
def after_step(model: Model, tables: Tables, state: State, work: Workspace, at: Lane, nonfinite: bool) -> None:
    """Everything that happens between two steps.

    Args:
        nonfinite: a body has gone astray.
    """
    world = at.world
    step = state.step[world] + 1
    end = state.end[world]
    landed = state.last_placed_at[world]
    n_boxes = tables.n_boxes[world]
    culprit = state.culprit[world]
    violent_since = state.violent_since[world]
    quiet_steps = state.quiet_steps[world]
    driven = state.driven_from[world] != NEVER
    counted = step > 0 and not nonfinite
    sample = counted and step % model.sample_every == 0
    last = counted and step >= end
    resting = counted and step > state.rest_from[world]

    violent = bool(False)
    drops = bool(False)
    if sample or last or resting:
        for box in range(at.thread, at.placed, at.threads):
            if sample or last:
                if _look(model, tables, state, work, at, box, step, sample, driven):
                    drops = True
            if sample:
                linear = _length(state.warm, world, box, 0)
                if (
                    linear > model.linear_acceleration
                    or _length(state.warm, world, box, 3) > model.angular_acceleration
                ):
                    violent = True
            if resting:
                state.rest_force_sum[world, box] = state.rest_force_sum[world, box] + work.top_force[at.lane, box]
    signs = bool(False)
    exploded = bool(False)
    if sample or last:
        violent = any_of_all(violent)
        drops = any_of_all(drops)
        worst = work.worst[at.lane]
        signs = culprit < 0 and wp.cast(wp.int32(worst >> HALF), float) > 1.0
        if signs:
            culprit = wp.int32(LAST_BOX - (worst & LAST_BOX))
        # Light boxes land, and tipping ones hit, with up to 240 rad/s² for a few steps. So samples right after a
        # placement do not count, and a violent one is an explosion only if those that follow say the same.
        if sample and step - landed >= model.min_steps:
            since = NEVER
            if violent and culprit < 0:
                since = wp.min(violent_since, step)
            violent_since = since
            exploded = since != NEVER and step - since >= model.min_steps and not driven
    stopped = drops and model.early_stop != 0 and not last
    finished = last or stopped or exploded or nonfinite

    goes = bool(False)
    if not finished and not driven and step > 0:
        poll = step % model.poll_steps == 0
        quiet = bool(False)
        if model.fixed == 0 and poll:
            quiet_steps, quiet = _count_quiet(model, state, at, quiet_steps, culprit >= 0)
        if at.placed == n_boxes and tables.settles[world]:
            if model.fixed != 0:
                goes = step >= model.settled_nominally[n_boxes]
            else:
                goes = step >= model.settled[landed]
        elif model.static_end != NEVER:
            goes = step >= model.static_end
        else:
            goes = step >= model.due[landed]
        if quiet and step - landed >= model.min_steps:
            goes = True

    wait_for_all()
    if at.thread == 0:
        state.step[world] = step
        state.steps_done[world] = state.steps_done[world] + wp.where(step > 0, 1, 0)
        state.rest_samples[world] = state.rest_samples[world] + wp.where(resting, 1, 0)
        state.violent_since[world] = violent_since
        state.quiet_steps[world] = quiet_steps
        if signs:
            state.culprit[world] = culprit
            state.sign_step[world] = step
        flags = state.flags[world]
        flags = flags | wp.where(nonfinite, NONFINITE, 0)
        flags = flags | wp.where(exploded, EXPLOSION, 0)
        flags = flags | wp.where(stopped, EARLY_STOP, 0)
        state.flags[world] = flags
        if finished:
            state.status[world] = FINISHED
        elif goes and at.placed < n_boxes:
            place_next(tables, state, world, step)
        elif goes and tables.settles[world]:
            state.driven_from[world] = step
            state.status[world] = SETTLED
        elif goes and end == NEVER:
            state.rest_from[world] = step
            state.end[world] = step + model.rest_steps
    wait_for_all()
