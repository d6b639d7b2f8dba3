"""The beginning of a world's drive. Twin of ``begin_drives`` in petmjx/engines/batch/rules.py."""

from __future__ import annotations

import warp as wp

from petmjx.engines.batch.state import Status
from petmjx.engines.warp.kernel.block import any_of_all, wait_for_all
from petmjx.engines.warp.kernel.motion import center, middle_of, orientation
from petmjx.engines.warp.kernel.samples import excess_of, tilt_of
from petmjx.engines.warp.records import Model, State, Thread, Worlds

RUNNING = wp.constant(Status.RUNNING)


@wp.func
def begin_drive(
    # Model:
    model: Model,
    worlds: Worlds,
    # In:
    at: Thread,
    # Data out:
    state: State,
) -> None:
    """Begin the drive of a world whose placement has settled. Signs from the placement (a hard landing) are forgotten
    if no box is over a threshold now."""
    world = at.world
    is_over = bool(False)
    for box in range(at.thread, state.placed[world], at.threads):
        q = orientation(state, world, box + 1)
        place = middle_of(worlds, world, box, center(state, world, box + 1), q)
        if excess_of(model, worlds, world, box, place, tilt_of(q), state.drop_step[world, box] >= 0) > 1.0:
            is_over = True
        state.sway_anchor[world, box, 0] = place[0]
        state.sway_anchor[world, box, 1] = place[1]
        state.rest_force_sum[world, box] = 0.0
        for i in range(7):
            state.still_qpos[world, box, i] = state.qpos[world, box, i]
    is_over = any_of_all(is_over)
    if at.thread == 0:
        begin = state.driven_from[world]
        end = begin + worlds.drive_steps[world]
        state.end[world] = end
        state.rest_from[world] = end - model.rest_steps
        state.rest_samples[world] = 0
        state.waits_since[world] = begin + worlds.profile_steps[world]
        state.quiet_steps[world] = 0
        state.tremble_looks[world] = 0
        state.status[world] = RUNNING
        if not is_over:
            state.culprit[world] = -1
            state.sign_step[world] = -1
    wait_for_all()
