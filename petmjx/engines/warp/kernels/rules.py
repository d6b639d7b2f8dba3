"""The rules of a run for one world, applied after each of its steps: sampling, placing, resting, ending
(docs/rules.md).

Twin of petmjx/engines/mjx/rules.py, which applies the rules to all worlds of a batch together. The boxes of
a world are divided among its threads. In ``after_step``, all threads read the world's counters before the first
barrier, and the first thread changes the counters after the last barrier.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.mjx import world_constants
from petmjx.engines.mjx import world_state as batch_state
from petmjx.engines.verdict import Flag
from petmjx.engines.warp.kernels.block_collectives import any_of_all, wait_for_all
from petmjx.engines.warp.kernels.body_dynamics import center, middle_of, orientation
from petmjx.engines.warp.kernels.box_motion import (
    HALF,
    LAST_BOX,
    corner_acceleration,
    is_gone,
    length_of,
    measure,
    press,
    sway_of,
    tilt_of,
)
from petmjx.engines.warp.kernels.hand import has_missed, lets_go, take_up
from petmjx.engines.warp.kernels.rest import count_quiet, has_failed
from petmjx.engines.warp.kernels.trembling import (
    distance_since,
    find_trembling,
    has_stayed,
    is_trembling,
    speed_without_trembling,
)
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Workspace, Worlds
from petmjx.world import history, release_places

NEVER = wp.constant(int(world_constants.NEVER))
RUNNING = wp.constant(batch_state.Status.RUNNING)
SETTLED = wp.constant(batch_state.Status.SETTLED)
PAUSED = wp.constant(batch_state.Status.PAUSED)
PLACES = wp.constant(batch_state.Status.PLACES)
FINISHED = wp.constant(batch_state.Status.FINISHED)
LEFT = wp.constant(batch_state.Status.LEFT)
NONFINITE = wp.constant(int(Flag.NONFINITE))
EXPLOSION = wp.constant(int(Flag.EXPLOSION))
EARLY_STOP = wp.constant(int(Flag.EARLY_STOP))
ITERATION_LIMIT = wp.constant(int(Flag.ITERATION_LIMIT))
MOVING = wp.constant(int(Flag.MOVING))
NOT_PLACED = wp.constant(int(Flag.NOT_PLACED))
CARRIER = wp.constant(history.CARRIER)
NOTHING = wp.constant(release_places.NOTHING)


@wp.func
def _longest_wait(model: Ref[Model], worlds: Ref[Worlds], state: Ref[State], world: int, driven: bool) -> int:
    """The step at which a world that keeps moving stops waiting for rest. The wait is counted from the last placement
    or, in a drive, from the end of the drive."""
    if driven:
        return state.driven_from[world] + worlds.drive_steps[world] + model.longest_steps
    return model.longest[state.last_placed_at[world]]


@wp.func
def _deadline(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # Data in:
    state: Ref[State],
    # In:
    world: int,
    driven: bool,
    more: bool,
    adapts: bool,
    failed: bool,
    sign_step: int,
) -> int:
    """The latest step for the next event. If a box has failed, a long wait becomes a short wait, which is counted from
    the first sign of failure. The wait before the next box is also short if an earlier wait ended while the world was
    still moving."""
    settles = worlds.settles[world]
    plain_static = model.static_end != NEVER and not settles and not driven
    patient = adapts and not plain_static and model.waits_for_rest != 0
    restless = (more or worlds.pauses[world]) and (state.flags[world] & MOVING) != 0
    if patient and not failed and not restless:
        return _longest_wait(model, worlds, state, world, driven)
    since = state.waits_since[world]
    if patient:
        since = wp.max(since, sign_step)
    if driven:
        return since + model.due_steps
    if not more and settles:
        if model.fixed != 0:
            return model.settled_nominally[worlds.n_boxes[world]]
        return model.settled[since]
    if plain_static:
        return model.static_end
    return model.due[since]


@wp.func
def _look_at_the_end(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    seconds: float,
    looks: int,
    driven: bool,
    # Data in:
    state: Ref[State],
) -> tuple[bool, bool, bool]:
    """Checks at the end of a world.

    Returns:
        Three answers. First, whether any point of a box moves too fast now, or has moved too fast since the poses
        ``still_qpos``, which are ``seconds`` old. Second, whether the rules must wait for such a box. Third, whether a
        box is lost. A box is lost if it has dropped, or is tilted too far now. In a drive, a tilted box counts only if
        it has also swayed as far as its drive allows.
    """
    world = at.world
    moves = bool(False)
    waits = bool(False)
    lost = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        moved = distance_since(worlds, state, state.still_qpos, world, box)
        speed = float(0.0)
        if model.waits_for_rest != 0:
            speed = speed_without_trembling(model, worlds, state, looks, world, box)
        stays = has_stayed(model, state, looks, world, box, moved)
        turns = speed > model.still_speed and not stays
        moves = moves or turns or moved > model.still_speed * seconds
        most = wp.where(is_trembling(model, state, looks, world, box), model.slow_speed, model.still_speed)
        waits = waits or turns or (moved > most * seconds and not stays)
        q = orientation(state, world, box + 1)
        tilted = tilt_of(q) > model.tilt_deg
        if driven:
            place = middle_of(worlds, world, box, center(state, world, box + 1), q)
            tilted = tilted and sway_of(state, world, box, place) >= worlds.allowed_sway[world]
        lost = lost or tilted or state.drop_step[world, box] >= 0
    return any_of_all(moves), any_of_all(waits), any_of_all(lost)


@wp.func
def place_next(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    step: int,
    # Data out:
    state: Ref[State],
) -> None:
    """Release the next box, at rest. Called by one thread."""
    world = at.world
    box = state.placed[world]
    support = worlds.support[world, box]
    come_down = float(0.0)
    if support == CARRIER:
        come_down = state.carrier_qpos[world, 2] - worlds.carrier_pos[world, 2]
    elif support != NOTHING:
        place = center(state, world, support + 1)
        middle = middle_of(worlds, world, support, place, orientation(state, world, support + 1))
        come_down = middle[2] - worlds.target[world, support, 2]
    come_down = wp.clamp(come_down, -worlds.most_followed[world], worlds.most_followed[world])
    for i in range(7):
        start = worlds.start[world, box, i] + wp.where(i == 2, come_down, 0.0)
        state.qpos[world, box, i] = start
        state.still_qpos[world, box, i] = start
    for i in range(6):
        state.qvel[world, box, i] = 0.0
        state.qacc[world, box, i] = 0.0
        state.qacc_warmstart[world, box, i] = 0.0
    if at.hands != 0 and not worlds.appears[world]:
        take_up(model, worlds, world, box, step, state)
    state.position[world, box] = box + 1
    state.placed[world] = box + 1
    state.last_placed_at[world] = step
    state.waits_since[world] = step
    state.quiet_steps[world] = 0
    state.tremble_looks[world] = 0


@wp.func
def carry_on(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    world: int,
    step: int,
    # Data out:
    state: Ref[State],
) -> None:
    """After a step in which a box was carried: carry it farther, or release it. Called by one thread."""
    box = state.placed[world] - 1
    if lets_go(model, worlds, world, box, step, state):
        if has_missed(state, world, box) and state.culprit[world] < 0:
            state.flags[world] = state.flags[world] | NOT_PLACED
        for i in range(7):
            state.still_qpos[world, box, i] = state.qpos[world, box, i]
        state.carried_from[world] = NEVER
        state.lowered_from[world] = NEVER
        state.last_placed_at[world] = step
        state.waits_since[world] = step
        state.quiet_steps[world] = 0


@wp.func
def after_step(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    presses: bool,
    nonfinite: bool,
    # Data out:
    state: Ref[State],
    work: Ref[Workspace],
) -> None:
    """Apply all rules between two steps.

    Args:
        presses: whether the largest forces on the tops of boxes include the forces of this step.
        nonfinite: whether a body's position or velocity is out of range or not finite.
    """
    world = at.world
    step = state.step[world] + 1
    end = state.end[world]
    landed = state.last_placed_at[world]
    n_boxes = worlds.n_boxes[world]
    culprit = state.culprit[world]
    violent_since = state.violent_since[world]
    quiet_steps = state.quiet_steps[world]
    looks = state.tremble_looks[world]
    sign_step = state.sign_step[world]
    iterations = state.iterations_done[world] + work.solver_niter[at.block]
    driven = state.driven_from[world] != NEVER
    counted = step > 0 and not nonfinite
    sample = counted and step % model.sample_every == 0
    last = counted and step >= end
    resting = counted and step > state.rest_from[world]
    polled = step % model.poll_steps == 0
    look = counted and driven and model.waits_for_rest != 0 and polled and not sample
    looks_at_poses = sample or look or last

    violent = bool(False)
    lost = bool(False)
    if looks_at_poses or resting or presses:
        for box in range(at.thread, at.placed - at.carried, at.threads):
            if looks_at_poses:
                if measure(model, worlds, at, box, step, culprit, sample, look, driven, state, work):
                    lost = True
            if sample:
                at_corners = corner_acceleration(worlds, state, world, box)
                turns = length_of(state.qacc, world, box, 3) > model.ang_acc_rad_s2 and at_corners > model.gravity
                if length_of(state.qacc, world, box, 0) > model.lin_acc_m_s2 or turns:
                    violent = True
            if presses and counted:
                press(world, at.block, box, state, work)
            if resting:
                state.rest_force_sum[world, box] = state.rest_force_sum[world, box] + work.top_force[at.block, box]
    signs = bool(False)
    exploded = bool(False)
    if looks_at_poses:
        violent = any_of_all(violent)
        lost = any_of_all(lost)
        worst = work.worst[at.block]
        signs = culprit < 0 and wp.cast(wp.int32(worst >> HALF), float) > 1.0
        if signs:
            culprit = wp.int32(LAST_BOX - (worst & LAST_BOX))
        # Light boxes that land, and tipping boxes that hit something, reach up to 240 rad/s² for a few steps. So a
        # violent sample (accelerations above the thresholds) is an explosion only if the samples before it were
        # violent, too, for the time that a box needs to land. Samples right after a placement are no evidence of an
        # explosion. But if such a sample is not violent, the series of violent samples before it has ended: one box has
        # landed, and another may land later.
        if sample:
            if not violent or culprit >= 0:
                violent_since = NEVER
            elif step - landed >= model.landing_steps and at.carried == 0:
                violent_since = wp.min(violent_since, step)
                exploded = step - violent_since >= model.landing_steps and not driven
    if worlds.ends_when_gone[world] and counted and polled and not looks_at_poses:
        for box in range(at.thread, at.placed, at.threads):
            lost = lost or is_gone(model, worlds, state, world, box)
        lost = any_of_all(lost)
    stopped = lost and model.early_stop != 0 and not last
    # ``spent``: the world has used up its iterations, and does not end after this step for another reason
    spent = iterations >= worlds.most_iterations[world] and not (last or stopped or exploded or nonfinite)
    finished = stopped or exploded or nonfinite or spent
    if signs:
        sign_step = step
    more = at.placed < n_boxes and not driven
    adapts = model.fixed == 0 or state.waits_since[world] > landed
    rests_first = model.fixed == 0 and model.waits_for_rest != 0
    # A drive may end early if the pallet is quiet, but only while two rest windows fit before the world's planned end:
    # the window that would begin now, and the window just before the planned end.
    in_drive = driven and rests_first and end != NEVER and step <= end - 2 * model.rest_steps
    goes = bool(False)
    failed = bool(False)
    if spent:
        failed = has_failed(model, at, culprit, state)
    if not finished and step > 0 and at.carried == 0 and (more or end == NEVER or in_drive):
        waited = step - state.waits_since[world]
        failed = has_failed(model, at, culprit, state)
        quiet = bool(False)
        if step % model.poll_steps == 0 and waited > 0:
            if adapts and model.waits_for_rest != 0:
                find_trembling(model, worlds, at, looks, state)
                looks += 1
            quiet_steps, quiet = count_quiet(model, worlds, at, quiet_steps, failed, looks, state)
        if not in_drive:
            goes = step >= _deadline(model, worlds, state, world, driven, more, adapts, failed, sign_step)
        if quiet and adapts and (model.waits_for_rest != 0 or waited >= model.landing_steps):
            goes = True
    pauses = goes and not more and not driven and worlds.pauses[world]
    # in worlds with ``settles`` set, the drive begins at once, without a check whether the pallet is at rest
    settles = goes and not more and not pauses and not driven and worlds.settles[world] and not rests_first
    rest_from = state.rest_from[world]
    if goes and not more and not settles and not pauses:
        rest_from = wp.where(driven, step, wp.max(step, landed + model.landing_steps))
        end = rest_from + model.rest_steps

    still_from = end - model.still_steps
    if end != NEVER:
        still_from = wp.max(still_from, wp.where(driven, state.driven_from[world], 0))
    again = bool(False)
    last_end = NEVER
    last_window = NEVER
    moving = (settles or (goes and more)) and not failed and quiet_steps < model.quiet_steps
    if last and not finished:
        seconds = float(step - still_from) * model.timestep
        moves, waits, lost = _look_at_the_end(model, worlds, at, seconds, looks, driven, state)
        limit = _longest_wait(model, worlds, state, world, driven)
        if model.static_end != NEVER and not driven and not worlds.settles[world]:
            limit = model.static_end
        if driven and step < state.driven_from[world] + worlds.drive_steps[world]:
            last_end = state.driven_from[world] + worlds.drive_steps[world]
            last_window = last_end - model.rest_steps
        again = waits and (last_end != NEVER or not lost) and model.extends != 0 and step < limit
        moving = moves and not lost and not again
        settles = worlds.settles[world] and not driven and not again
        finished = not again and not settles
    if pauses:
        for box in range(at.thread, at.placed, at.threads):
            state.top_force[world, box] = work.top_force[at.block, box]
    if step == still_from or again:
        for box in range(at.thread, at.placed, at.threads):
            if again:
                state.rest_force_sum[world, box] = 0.0
            else:
                for i in range(7):
                    state.still_qpos[world, box, i] = state.qpos[world, box, i]

    wait_for_all()
    if at.thread == 0:
        state.step[world] = step
        state.steps_done[world] = state.steps_done[world] + wp.where(step > 0, 1, 0)
        state.iterations_done[world] = iterations
        state.rest_samples[world] = wp.where(again, 0, state.rest_samples[world] + wp.where(resting, 1, 0))
        state.violent_since[world] = violent_since
        state.quiet_steps[world] = wp.where(again, 0, quiet_steps)
        state.tremble_looks[world] = looks
        state.rest_from[world] = wp.where(again, last_window, rest_from)
        state.end[world] = wp.where(again, last_end, end)
        if again:
            state.waits_since[world] = step
        if signs:
            state.culprit[world] = culprit
            state.sign_step[world] = step
            state.sign_placed[world] = wp.where(sample or look, at.placed, 0)
        flags = state.flags[world]
        flags = flags | wp.where(nonfinite, NONFINITE, 0)
        flags = flags | wp.where(exploded, EXPLOSION, 0)
        flags = flags | wp.where(stopped or (spent and failed), EARLY_STOP, 0)
        flags = flags | wp.where(spent and not failed, ITERATION_LIMIT, 0)
        flags = flags | wp.where(moving, MOVING, 0)
        state.flags[world] = flags
        if finished:
            state.status[world] = FINISHED
            state.placed[world] = at.placed - at.carried
        elif at.hands != 0 and at.carried != 0:
            carry_on(model, worlds, world, step, state)
        elif pauses:
            state.status[world] = PAUSED
        elif goes and more:
            place_next(model, worlds, at, step, state)
        elif settles:
            state.driven_from[world] = step
            state.status[world] = SETTLED
        elif state.steps_done[world] >= worlds.most_steps[world]:
            state.status[world] = LEFT
    wait_for_all()
