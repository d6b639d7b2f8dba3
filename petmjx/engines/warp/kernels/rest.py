"""The rule that decides whether a pallet is quiet (docs/rules.md, section 5), for one world. Twin of
``Rules.count_quiet``."""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import any_of_all
from petmjx.engines.warp.kernels.trembling import has_stayed, is_trembling, speed_without_trembling
from petmjx.engines.warp.world_arrays import Model, Ref, State, Thread, Worlds


@wp.func
def has_failed(
    # Model:
    model: Ref[Model],
    # In:
    at: Thread,
    culprit: int,
    # Data in:
    state: Ref[State],
) -> bool:
    """Whether a box has failed irreversibly: it has dropped, or was tilted too far at a sample or at a check during a
    drive. A shift is not irreversible: it is judged at rest, and may decrease until then. ``culprit`` is the number of
    the box that first crossed a threshold; if it is negative, no box has crossed one, and the result is False."""
    if culprit < 0:
        return False
    world = at.world
    failed = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        failed = failed or state.drop_step[world, box] >= 0 or state.max_tilt[world, box] > model.tilt_deg
    return any_of_all(failed)


@wp.func
def count_quiet(
    # Model:
    model: Ref[Model],
    worlds: Ref[Worlds],
    # In:
    at: Thread,
    quiet_steps: int,
    failed: bool,
    looks: int,
    # Data out:
    state: Ref[State],
) -> tuple[int, bool]:
    """Check whether the pallet is quiet. Returns the number of steps for which all boxes have been quiet, and whether
    the pallet is quiet. If a box creeps, the pallet is not quiet, and the count starts again. Trembling boxes are
    ignored. If any box of a quiet pallet trembles, the count is 0."""
    world = at.world
    fast = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        if not speed_without_trembling(model, worlds, state, looks, world, box) < model.quiet_speed:
            fast = True
    count = int(0)
    if not any_of_all(fast):
        count = quiet_steps + model.poll_steps
    quiet = count >= model.quiet_steps
    if model.waits_for_rest == 0:
        return count, quiet
    creeps = bool(False)
    for box in range(at.thread, at.placed, at.threads):
        speed = speed_without_trembling(model, worlds, state, looks, world, box)
        if count <= model.poll_steps:
            state.quiet_speed[world, box] = speed
        first = state.quiet_speed[world, box]
        if speed >= wp.max(model.slow_speed, model.slowing * first) or speed > wp.max(model.still_speed, first):
            creeps = creeps or not has_stayed(model, state, looks, world, box, 0.0)
    if any_of_all(creeps) and quiet and not failed:
        quiet = False
        count = model.poll_steps
        for box in range(at.thread, at.placed, at.threads):
            state.quiet_speed[world, box] = speed_without_trembling(model, worlds, state, looks, world, box)
    if quiet and looks > 2 * model.tremble_looks:
        trembling = bool(False)
        for box in range(at.thread, at.placed, at.threads):
            trembling = trembling or is_trembling(model, state, looks, world, box)
        if any_of_all(trembling):
            count = 0
    return count, quiet
