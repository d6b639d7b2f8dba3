"""Motion of released boxes in the kernels of mjx-warp. A step is the same as in other worlds, but no rule ends the
world or changes it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.host_to_device import let_go
from petmjx.engines.mjx.padded_sizes import padded_rows, round_up
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds
from petmjx.engines.mjx.world_state import State, Status, of_flat
from petmjx.engines.warp.block_launch import Features, Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import FEW_BOXES
from petmjx.engines.warp.compiled_programs import constants
from petmjx.engines.warp.contact_buffers import MAX_GROWTH, MORE_BOXES
from petmjx.engines.warp.frame_buffers import pick_frames, room_for_frames
from petmjx.engines.warp.kernel_launcher import KernelLauncher
from petmjx.engines.warp.small_world_blocks import small_world_pool
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies

_NO_RULES: Final[dict[str, Any]] = {
    "fixed": 1,
    "waits_for_rest": 0,
    "extends": 0,
    "early_stop": 0,
    "sample_every": NEVER,
}
"""Values for constants of the kernels (``world_arrays.Model``). With these values, a driven world continues to its last
step, whatever happens to its boxes."""


def paths(
    bodies: FreeBodies, sim: Simulation, blocks: Callable[[Launch], int], slice_ns: int, most_rows: int
) -> FloatArray:
    """See ``petmjx.engines.protocol.Engine.paths``.

    Args:
        blocks: function that returns the number of thread blocks of a launch.
        slice_ns: length of a time slice (one call of the kernels), ns.
        most_rows: largest number of worlds whose states are on the device at the same time.
    """
    n = len(bodies.scenes)
    parts = [
        _paths_of_group(bodies.part(slice(begin, begin + most_rows)), sim, blocks, slice_ns)
        for begin in range(0, n, most_rows)
    ]
    return np.concatenate(parts)


def _paths_of_group(bodies: FreeBodies, sim: Simulation, blocks: Callable[[Launch], int], slice_ns: int) -> FloatArray:
    n, k, steps = len(bodies.scenes), bodies.n_boxes, bodies.steps
    poses = np.full((n, len(steps), k, 7), np.nan)
    if steps[0] == 0:
        poses[:, 0] = bodies.pose
    if steps[-1] == 0:
        return poses
    rows, width = padded_rows(n), round_up(k)
    boards = len(bodies.scenes[0].carrier.half_size)
    worlds, state = let_go(bodies, sim, rows, width)
    order = jnp.where(jnp.arange(rows) < n, jnp.arange(rows), -1).astype(jnp.int32)[None]
    every = np.zeros(rows, np.int32)
    every[:n] = math.gcd(*steps.tolist())
    growth = 1
    program = _program(sim, _block_pool(sim, blocks, width, k, boards, n, growth), slice_ns)
    workspace = program.launcher.workspace()
    frames = room_for_frames(every, width, program.launcher.lanes)
    while True:
        state, workspace, frames = program.slice(state, workspace, worlds, order, frames)
        _collect(frames, steps, poses)
        frames["used"] = jnp.zeros(1, jnp.int32)
        status = np.asarray(state.status)[:n]
        overflowed = status == Status.OVERFLOWED
        if overflowed.any() and growth < MAX_GROWTH:
            growth *= 2
            program = _program(sim, _block_pool(sim, blocks, width, k, boards, n, growth), slice_ns)
            workspace = program.launcher.workspace()
            state = state._replace(status=jnp.where(state.status == Status.OVERFLOWED, Status.RUNNING, state.status))
        elif not (status == Status.RUNNING).any():
            return poses


class _Program:
    """The compiled program that simulates a time slice of these worlds."""

    def __init__(self, sim: Simulation, pool: BlockPool, slice_ns: int) -> None:
        timetable = build_timetable(sim, pool.n_boxes)
        self.launcher = KernelLauncher(constants(sim, timetable) | _NO_RULES, [pool], slice_ns)
        self.launcher.load()
        self.slice = jax.jit(self._slice)

    def _slice(
        self,
        state: State,
        workspace: jax.Array,
        worlds: Worlds,
        order: Int[Array, "queue world"],
        frames: dict[str, jax.Array],
    ) -> tuple[State, jax.Array, dict[str, jax.Array]]:
        flat = worlds.flat() | {"profiles": jnp.zeros((1, 1, 3)), "order": order}
        after, workspace, frames, _ = self.launcher(flat, state.flat(), workspace, frames)
        return of_flat(after), workspace, frames


_program = functools.lru_cache(8)(_Program)


def _block_pool(
    sim: Simulation, blocks: Callable[[Launch], int], width: int, k: int, boards: int, worlds: int, growth: int
) -> BlockPool:
    """The block pool (the thread blocks) for worlds of k boxes. If there are enough small worlds, a block has many of
    them, one per warp."""
    launch = Launch.here(width, Features(lands=sim.physics.has_landings))
    pool = BlockPool.of(launch, blocks(launch), width, boards, growth * (width + MORE_BOXES))
    few = small_world_pool(pool, worlds) if k <= FEW_BOXES.most_boxes else None
    # with least=0, blocks for small worlds stay in use even if few worlds are left
    return pool if few is None else replace(few, least=0)


def _collect(frames: dict[str, jax.Array], steps: NDArray[np.int32], poses: FloatArray) -> None:
    """Copy the requested frames of a slice into the array ``poses``, which has the shape (n, s, k, 7)."""
    firsts, used = pick_frames(frames)
    world, step, pose = (np.asarray(firsts[name])[:used] for name in ("of", "step", "pose"))
    pose = pose[:, : poses.shape[2]]
    column = np.minimum(np.searchsorted(steps, step), len(steps) - 1)
    due = (steps[column] == step) & np.isfinite(pose).all(axis=(1, 2))
    poses[world[due], column[due]] = pose[due]
