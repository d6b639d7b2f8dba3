"""Takes one step in mjx-warp's kernel, from a state that C MuJoCo has reached."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.mjx.timetable import build_timetable
from petmjx.engines.protocol import Progress
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import size_for
from petmjx.engines.warp.contact_buffers import MORE_BOXES
from petmjx.engines.warp.engine import MjxWarpEngine
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.engines.warp.time_slices import Rollout
from petmjx.engines.warp.world_table import TableRun
from petmjx.options.physics import Physics
from petmjx.options.simulation import Check, Simulation
from petmjx.world.job import Job
from petmjx.world.scene import Scene


@dataclass(frozen=True)
class Stepped:
    """A world after one step. Rows are the carrier and the boxes. ``force``: force on top of each box, N."""

    qpos: FloatArray
    qvel: FloatArray
    qacc: FloatArray
    force: FloatArray
    contacts: int
    iterations: int
    flags: int


class OneStep:
    """Takes single steps of a scene in which all boxes are placed.

    Args:
        physics: name of a physics preset, or the physics of a run.
    """

    def __init__(self, scene: Scene, physics: str | Physics) -> None:
        self.sim = Simulation(physics=physics, check=Check.STATIC)
        needs = KernelFeatures({size_for(scene.n_boxes).most_boxes: scene.n_boxes})
        run = TableRun(self.sim, build_timetable(self.sim, scene.n_boxes), needs, Progress())
        self.table = MjxWarpEngine(1, allow_cpu=True)._load(run, [Job(scene)], [0], 1)
        boards = len(scene.carrier.half_size)
        launch = Launch.here(scene.n_boxes)
        pool = BlockPool.of(launch, 1, scene.n_boxes, boards, scene.n_boxes + MORE_BOXES)
        self.rollout = Rollout(run, [pool], slice_ns=0)
        self.fresh = jax.tree.map(np.asarray, self.table.table)
        self.most_contacts = 0

    def __call__(self, data: mujoco.MjData) -> Stepped:
        """The step that follows the state in C MuJoCo's data. Forces are computed, since the rest window has begun."""

        def rows(values: FloatArray, width: int) -> tuple[jax.Array, jax.Array]:
            table = jnp.asarray(values.reshape(1, -1, width), jnp.float32)
            return table[:, 0], table[:, 1:]

        carrier_qpos, qpos = rows(data.qpos, 7)
        carrier_qvel, qvel = rows(data.qvel, 6)
        carrier_qacc, qacc = rows(data.qacc_warmstart, 6)
        self.table.table = jax.tree.map(jnp.asarray, self.fresh)._replace(
            carrier_qpos=carrier_qpos,
            carrier_qvel=carrier_qvel,
            carrier_qacc=carrier_qacc,
            carrier_qacc_warmstart=carrier_qacc + 0,
            qpos=qpos,
            qvel=qvel,
            qacc=qacc,
            qacc_warmstart=qacc + 0,
            step=jnp.zeros(1, jnp.int32),
            rest_from=jnp.zeros(1, jnp.int32),
        )
        before = self._taken()
        self.rollout.start(self.table, jnp.zeros((1, 1), jnp.int32))
        _, ended = self.rollout.wait(self.table)
        after, counts = jax.device_get((self.table.table, ended.counts))
        assert int(after.step[0]) == int(counts["steps"][0]) == 1
        assert (self._taken() - before).tolist() == [1, counts["iterations"][0]]
        self.most_contacts = max(self.most_contacts, counts["contacts"][0])
        assert self.table.run.progress.extra["kernel contacts"] == self.most_contacts

        def joined(carrier: FloatArray, boxes: FloatArray) -> FloatArray:
            return np.vstack([carrier, boxes[0]]).astype(float)

        return Stepped(
            qpos=joined(after.carrier_qpos, after.qpos),
            qvel=joined(after.carrier_qvel, after.qvel),
            qacc=joined(after.carrier_qacc, after.qacc),
            force=after.metrics.rest_force_sum[0],
            contacts=int(counts["contacts"][0]),
            iterations=int(counts["iterations"][0]),
            flags=int(after.flags[0]),
        )

    def _taken(self) -> NDArray[np.float64]:
        """Numbers of steps and of solver iterations so far, as counted in the progress."""
        progress = self.table.run.progress
        return np.array([progress.world_steps, progress.extra.get("kernel iterations", 0)])
