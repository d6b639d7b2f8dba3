"""Frames of recorded worlds: the poses after a step, and the forces on the tops of boxes during this step
(petmjx.world.history)."""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.kernels.block_collectives import add_to, wait_for_all
from petmjx.engines.warp.kernels.rules import RUNNING
from petmjx.engines.warp.world_arrays import FrameBuffer, Ref, State, Thread, Workspace


@wp.func
def no_room(frames: Ref[FrameBuffer], blocks: int) -> bool:
    """Whether the buffer might overflow if every block wrote a frame. While this is so, no block may step a recorded
    world. Called by one thread.

    An atomic addition reads the writes of all blocks; a plain load might read an old value from a multiprocessor's own
    cache.
    """
    return add_to(frames.used, 0, 0) + blocks > frames.of.shape[0]


@wp.func
def keep_frame(
    # Data in:
    state: Ref[State],
    # In:
    at: Thread,
    every: int,
    # Data out:
    work: Ref[Workspace],
    frames: Ref[FrameBuffer],
) -> None:
    """Write a frame of a recorded world if one is due. Called after a step and its rules.

    Args:
        every: number of steps between two frames.
    """
    world = at.world
    step = state.step[world]
    placed = state.placed[world]
    regular = at.placed > 0 and step >= 0 and step % every == 0
    if regular or placed > at.placed or state.status[world] != RUNNING:
        if at.thread == 0:
            work.frame[at.block] = add_to(frames.used, 0, 1)
        wait_for_all()
        frame = work.frame[at.block]
        for box in range(at.thread, placed, at.threads):
            for i in range(7):
                frames.pose[frame, box, i] = state.qpos[world, box, i]
            # a box that was just placed has no force on its top yet
            frames.top_force[frame, box] = wp.where(box < at.placed, work.top_force[at.block, box], 0.0)
        if at.thread == 0:
            frames.of[frame] = world
            frames.step[frame] = step
            frames.placed[frame] = placed
            for i in range(7):
                frames.carrier_pose[frame, i] = state.carrier_qpos[world, i]
