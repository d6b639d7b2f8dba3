"""The baseline: a plain Python loop over one plan, without any of petmjx's engine."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.config import SOFT_START_STEPS, Cone, Physics, Simulation
from petmjx.engines.cpu.running import OracleMetrics, Sample
from petmjx.metrics.force_np import top_forces
from petmjx.world.model import build_spec
from petmjx.world.scene import Scene

SAMPLE_STEPS = 100
INTERVAL_S = 0.7


def fixed_steps(n_boxes: int, timestep_s: float) -> int:
    """Steps of the fixed schedule after the soft start."""
    return int((n_boxes + 1) * INTERVAL_S / timestep_s)


def plain_loop(scene: Scene, physics: Physics, *, parked_on_floor: bool) -> NDArray[np.float64]:
    """Final shifts (n, 3) in m of the fixed schedule: what one would write first.

    The exact model with all boxes, one ``mj_step`` a step from Python, NumPy metrics every 100 steps, a box placed
    every 0.7 s. Boxes that wait are parked far apart, either on the floor, as in the reference implementation, or in
    the air, held by a force equal to their weight (cheapest).
    """
    model = build_spec(scene, physics).compile()
    data = mujoco.MjData(model)
    n = scene.n_boxes
    pose = data.qpos[7:].reshape(n, 7)
    velocity, qacc = data.qvel[6:].reshape(n, 6), data.qacc[6:].reshape(n, 6)
    lifted = data.xfrc_applied[2:]
    weight = scene.mass * physics.gravity_m_s2
    pose[:, 0] = 3.0 + 1.5 * np.arange(n)
    pose[:, 1] = 5.0
    pose[:, 2] = scene.floor_z + scene.half_size[:, 2] if parked_on_floor else 5.0
    down = np.array([0.0, 0.0, -physics.gravity_m_s2])
    for step in range(2 * SOFT_START_STEPS):
        fraction = max(0, step - SOFT_START_STEPS) / SOFT_START_STEPS
        model.opt.gravity[:] = down * fraction
        if not parked_on_floor:
            lifted[:, 2] = weight * fraction
        mujoco.mj_step(model, data)
    model.opt.gravity[:] = down
    if not parked_on_floor:
        lifted[:, 2] = weight
    data.time = 0.0
    metrics = OracleMetrics(scene, Simulation().thresholds)
    placed, last_s = 0, 0.0
    for step in range(1, fixed_steps(n, physics.timestep_s) + 1):
        mujoco.mj_step(model, data)
        if step % SAMPLE_STEPS == 0:
            force = top_forces(data, n, physics.cone is Cone.PYRAMIDAL)[:placed]
            pos, quat, acc = data.xpos[2 : 2 + placed], data.xquat[2 : 2 + placed], qacc[:placed]
            metrics.add_sample(Sample(data.time, pos, quat, acc[:, :3], acc[:, 3:], force))
        if data.time - last_s >= INTERVAL_S and placed < n:
            pose[placed, :3], pose[placed, 3:] = scene.start_pos[placed], scene.start_quat[placed]
            velocity[placed] = 0.0
            lifted[placed, 2] = 0.0
            placed, last_s = placed + 1, data.time
    return np.asarray(pose[:, :3] - scene.target)
