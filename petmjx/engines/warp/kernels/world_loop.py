"""The loop of a lane's threads: they take one world after another from the queue and step each to its end.

A lane is a thread block, or a warp of a block. The warps of a block go through the parts of a step together, even warps
that have no more worlds. If the solver of one warp takes longer than the solvers of the other warps, the slow solver
pauses. The other warps take their next step. When they call their solvers again, the paused solver continues
(benchmarks/notebook/performance.md, "Small worlds").
"""

from __future__ import annotations

from typing import Any

import warp as wp

from petmjx.engines.mjx.world_state import Status
from petmjx.engines.verdict import Flag
from petmjx.engines.warp.kernels.block_collectives import (
    add_to,
    any_of_all,
    any_of_block,
    elapsed,
    fused,
    go_together,
    raise_to,
    times,
    wait_for_all,
)
from petmjx.engines.warp.kernels.body_dynamics import begin_step, end_step, first_geom
from petmjx.engines.warp.kernels.box_motion import is_fast, is_unbalanced, rises
from petmjx.engines.warp.kernels.collision import APART, NEAR, collide, list_pairs
from petmjx.engines.warp.kernels.contact_rows import link_contacts, make_constraint
from petmjx.engines.warp.kernels.elimination_order import RENEWED_EVERY, renew_order
from petmjx.engines.warp.kernels.film import hold
from petmjx.engines.warp.kernels.frame_recorder import keep_frame, no_room
from petmjx.engines.warp.kernels.hand import carry
from petmjx.engines.warp.kernels.landing import land
from petmjx.engines.warp.kernels.newton_binding import in_pause, newton
from petmjx.engines.warp.kernels.rules import NEVER, PLACES, RUNNING, after_step, place_next
from petmjx.engines.warp.world_arrays import Counts, FrameBuffer, Model, Ref, State, Thread, Workspace, Worlds

OVERFLOWED = wp.constant(Status.OVERFLOWED)
CONTACT_OVERFLOW = wp.constant(int(Flag.CONTACT_OVERFLOW))


@wp.func
def excitation(model: Ref[Model], worlds: Ref[Worlds], state: Ref[State], world: int) -> tuple[wp.vec3, wp.vec3]:
    """Gravity (m/s²), and the force on the carrier (N), for the next step."""
    step = state.step[world]
    ramp = wp.clamp(float(step + model.soft_start) / float(model.soft_start), 0.0, 1.0)
    gravity = wp.vec3(0.0, 0.0, -ramp * model.gravity)
    push = wp.vec3(0.0, 0.0, 0.0)
    if state.driven_from[world] != NEVER:
        at = step - state.driven_from[world]
        if at >= 0 and at < worlds.profiles.shape[1]:
            sample = worlds.profiles[worlds.profile[world], at]
            scale = worlds.drive_scale[world]
            cos = worlds.drive_yaw[world, 0]
            sin = worlds.drive_yaw[world, 1]
            x = times(scale, sample[0])
            y = times(scale, sample[1])
            z = times(scale, sample[2])
            turned = wp.vec3(fused(cos, x, -times(sin, y)), fused(sin, x, times(cos, y)), z)
            if worlds.held[world]:
                gravity -= turned
            else:
                push = turned
    return gravity, push


@wp.func
def overflow(
    # In:
    at: Thread,
    # Data out:
    state: Ref[State],
) -> None:
    """Stop a world in its state before the step, since a buffer is too small for the step."""
    if at.thread == 0:
        state.status[at.world] = OVERFLOWED
        state.flags[at.world] = state.flags[at.world] | CONTACT_OVERFLOW
    wait_for_all()


@wp.func
def advance(
    # Model:
    model: Model,
    worlds: Worlds,
    # In:
    at: Thread,
    goes: bool,
    shared: Any,
    shared_words: int,
    listed: int,
    # Data out:
    state: State,
    work: Workspace,
    frames: FrameBuffer,
    counts: Counts,
) -> int:
    """Take a step of a lane's world, and apply the rules after it. If the solver pauses, the call ends there. A later
    call then takes the rest of the step.

    Args:
        goes: whether the lane has a running world. If ``goes`` is False, the lane's threads only wait for other threads
            of the block.
        shared: a tile in shared memory: ``shared_words`` numbers for each world of the block, followed by further
            memory of the solver.
        listed: number of listed near pairs; negative: no list.

    Returns:
        Number of listed near pairs for the next step; negative: no list.
    """
    on = bool(goes)
    begins = bool(False)
    anew = bool(False)
    sample = bool(False)
    presses = bool(False)
    restless = bool(False)
    measured = bool(False)
    changed = bool(False)
    astray = bool(False)
    step = int(0)
    every = int(0)
    npair = int(listed)
    ncon = int(0)
    if on:
        begins = not in_pause(work.solver_paused, at.block)
        step = state.step[at.world] + 1
        sample = step > 0 and step % model.sample_every == 0
        every = frames.every[at.world]
        resting = step > state.rest_from[at.world]
        if step > 0 and at.placed > 0 and model.waits_for_rest != 0 and not sample:
            driven = state.driven_from[at.world]
            acts = driven != NEVER and step - driven <= worlds.profile_steps[at.world]
            restless = acts or any_of_all(is_fast(worlds, state, at))
            presses = acts or (restless and step % model.poll_steps == 0)
        presses = presses or sample
        measured = presses or resting or every > 0 or worlds.pauses[at.world]
    if begins:
        gravity, push = excitation(model, worlds, state, at.world)
        left = any_of_all(begin_step(model, worlds, state, at, gravity, push, sample, work))
        if at.hands != 0:
            carry(model, worlds, state, at, work)
        if at.wraps != 0 and state.driven_from[at.world] <= state.step[at.world]:
            hold(model, worlds, at, state, work)
        anew = left or npair < 0
        if anew:
            npair = list_pairs(model, worlds, at, APART, work)
            listed = npair
            if npair > model.npairmax:
                # The pairs are listed again, without pairs that cannot touch yet. So whether a buffer overflows does
                # not depend on the step in which pairs were listed.
                npair = list_pairs(model, worlds, at, NEAR, work)
                listed = -1
            if npair > model.npairmax:
                overflow(at, state)
                on = False
    go_together()
    if on and begins:
        changed = collide(model, worlds, state, at, npair, anew, work)
        ncon = work.pair_conadr[at.block, npair]
        if at.thread == 0:
            work.ncon[at.block] = ncon
            raise_to(counts.contacts, 0, ncon)
        if ncon > model.nconmax:
            overflow(at, state)
            on = False
    go_together()
    if on and begins:
        make_constraint(model, worlds, state, at, ncon, work)
        if at.lands != 0:
            land(model, worlds, at, ncon, state, work)
        if step % RENEWED_EVERY == 0:
            renew_order(worlds, at, npair, state, work)
            changed = True
        if changed:
            link_contacts(worlds, state, at, work)
    go_together()
    if on:
        forces = measured or restless
        newton(model, at.block, at.thread, at.threads, changed, forces, shared, shared_words, work)
        wait_for_all()
        if in_pause(work.solver_paused, at.block):
            on = False
    go_together()
    if on:
        if restless and not presses:
            presses = any_of_all(rises(work, at))
        if presses and work.solver_niter[at.block] >= model.iterations:
            presses = not any_of_all(is_unbalanced(work, at))
        astray = any_of_all(end_step(model, at, measured or presses, state, work))
    go_together()
    if on:
        after_step(model, worlds, at, presses, astray, state, work)
        if every > 0:
            keep_frame(state, at, every, work, frames)
    return listed


@wp.func
def _goes_on(model: Ref[Model], state: Ref[State], world: int) -> bool:
    """Whether a world runs, and has no more boxes than these blocks have room for."""
    return state.status[world] == RUNNING and state.placed[world] <= model.most_placed


@wp.func
def run_worlds(
    # Model:
    model: Model,
    worlds: Worlds,
    # In:
    block: int,
    thread: int,
    threads: int,
    n_blocks: int,
    slice_ns: wp.int64,
    hands: int,
    gives: int,
    wraps: int,
    lands: int,
    shared: Any,
    shared_words: int,
    # Data out:
    state: State,
    work: Workspace,
    frames: FrameBuffer,
    counts: Counts,
) -> None:
    """Take worlds and step them, until the queue is empty or the time slice is over.

    Args:
        block: number of the lane (place for a running world). The lane's data are in the rows of the workspace with
            this number.
        thread: the thread's number among the threads that share a world.
        threads: the number of these threads.
        n_blocks: number of all lanes of the call, for worlds of any size.
        hands: 1 if a hand may carry boxes.
        gives: 1 if boxes may be compliant.
        wraps: 1 if film may hold boxes.
        lands: 1 if landing boxes follow a law of their own.
        slice_ns: length of the time slice, ns, from the call's first step on. After the slice is over, a lane takes one
            more step.
        shared: a tile in shared memory: ``shared_words`` numbers for each world of the block, followed by further
            memory of the solver.
    """
    at = Thread()
    at.block = block
    at.thread = thread
    at.threads = threads
    at.world = -1
    at.hands = hands
    at.gives = gives
    at.wraps = wraps
    at.lands = lands
    steps = int(0)
    iterations = int(0)
    paired_boxes = int(-1)  # number of placed boxes when pairs were last listed
    listed = int(-1)
    recorded = bool(False)
    late = bool(False)
    others = bool(True)  # whether any lane of the block still has a running world
    while others:
        goes = bool(False)
        if at.world >= 0 and not late:
            goes = _goes_on(model, state, at.world)
        while not goes and not late:
            if thread == 0:
                number = add_to(counts.taken, model.queue, 1)
                work.world[block] = -1
                if number < worlds.order.shape[1]:
                    work.world[block] = worlds.order[model.queue, number]
            wait_for_all()
            at.world = work.world[block]
            wait_for_all()
            if at.world < 0:
                late = True
                if thread == 0:
                    add_to(counts.idle, model.queue, 1)
            else:
                if thread == 0 and state.status[at.world] == PLACES:
                    place_next(model, worlds, at, state.step[at.world], state)
                    state.status[at.world] = RUNNING
                wait_for_all()
                paired_boxes = -1
                recorded = frames.every[at.world] > 0
                full = bool(False)
                if recorded and thread == 0:
                    full = no_room(frames, n_blocks)
                late = any_of_all(full)
                goes = not late and _goes_on(model, state, at.world)
        others = any_of_block(goes)
        if goes:
            at.placed = state.placed[at.world]
            at.geoms = first_geom(worlds, at.world, at.placed + 1)
            at.held = wp.where(state.driven_from[at.world] != NEVER and worlds.held[at.world], 1, 0)
            at.carried = wp.where(at.hands != 0 and state.carried_from[at.world] != NEVER, 1, 0)
            if at.placed != paired_boxes:
                listed = -1
            paired_boxes = at.placed
        if others:
            listed = advance(model, worlds, at, goes, shared, shared_words, listed, state, work, frames, counts)
        if goes and not in_pause(work.solver_paused, block):
            steps += 1
            iterations += work.solver_niter[block]
            over = bool(False)
            if thread == 0:
                over = elapsed(counts.clock) >= slice_ns
                if model.most_idle < NEVER:
                    over = over or add_to(counts.idle, model.queue, 0) > model.most_idle
                if recorded:
                    over = over or no_room(frames, n_blocks)
            late = any_of_all(over)
    if thread == 0:
        add_to(counts.steps, 0, steps)
        add_to(counts.iterations, 0, iterations)
