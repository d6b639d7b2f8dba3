"""Boxes that are released without the rules of placement, on C MuJoCo: one world per thread."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.engines.mujoco.message_log import QUIET_MUJOCO
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Simulation
from petmjx.world.free_bodies import FreeBodies


def paths(bodies: FreeBodies, sim: Simulation, threads: int) -> FloatArray:
    """See ``petmjx.engines.protocol.Engine.paths``."""

    def path(world: int) -> FloatArray:
        """(s, k, 7) the path of one world. If numbers of the world are not finite at a step, this step and all later
        steps have NaN."""
        poses = np.full((len(bodies.steps), bodies.n_boxes, 7), np.nan)
        live = LiveWorld.let_go(bodies.scenes[world], sim, bodies.velocity[world])
        last_step = 0
        for row, step in enumerate(bodies.steps.tolist()):
            if step > last_step:
                live.step(step - last_step)
                last_step = step
            if live.error_flags() is not Flag.NONE:
                break
            poses[row] = live.pose
        return poses

    with QUIET_MUJOCO, ThreadPoolExecutor(threads, thread_name_prefix="petmjx-mujoco") as pool:
        return np.array(list(pool.map(path, range(len(bodies.scenes)))))
