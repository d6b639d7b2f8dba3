"""Device tables for released boxes, used by mjx-jax and mjx-warp."""

from __future__ import annotations

from typing import Final

import jax.numpy as jnp
import numpy as np

from petmjx.engines.mjx.world_constants import NEVER, Worlds, device_array, upload_worlds
from petmjx.engines.mjx.world_state import State, Status, fresh_state
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job

_HELD: Final = Drive(Excitation("held", ACCELERATION, np.zeros((0, 3))), scale=0.0, rest_s=0.0)
"""A drive without excitation. Like all drives of the kind ``acceleration``, this drive holds the carrier. The drive
does nothing else."""


def let_go(bodies: FreeBodies, sim: Simulation, rows: int, width: int) -> tuple[Worlds, State]:
    """Worlds in which all boxes are released, and their states. Nothing shakes them. The worlds end after the last
    requested step.

    Args:
        rows: number of rows of the tables, at least one per world; spare rows hold worlds that have already ended.
        width: number of box columns.
    """
    n, k = bodies.velocity.shape[:2]
    jobs = [Job(scene, _HELD) for scene in bodies.scenes]
    boards = len(bodies.scenes[0].carrier.half_size)
    worlds = upload_worlds(jobs, rows, width, {id(_HELD.excitation): 0}, sim, boards)
    ends = jnp.full(rows, int(bodies.steps[-1]), jnp.int32)
    fresh = fresh_state(worlds, all_placed=True, ends=ends, rest_steps=0)
    qpos, qvel = np.array(fresh.qpos), np.zeros((rows, width, 6), np.float32)
    qpos[:n, :k], qvel[:n, :k] = bodies.pose, bodies.velocity
    status = np.where(np.arange(rows) < n, Status.RUNNING, Status.FINISHED).astype(np.int32)
    return worlds, fresh._replace(
        qpos=device_array(qpos),
        qvel=device_array(qvel),
        step=jnp.zeros(rows, jnp.int32),
        driven_from=jnp.zeros(rows, jnp.int32),
        rest_from=jnp.full(rows, NEVER, jnp.int32),
        status=device_array(status),
    )
