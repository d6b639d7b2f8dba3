"""The baseline: a simple Python loop over one plan, without an engine of petmjx."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mujoco.box_motion import tilt_deg
from petmjx.engines.mujoco.top_forces import top_forces
from petmjx.options.physics import Cone, Physics
from petmjx.options.simulation import SOFT_START_STEPS
from petmjx.world.mujoco_model import build_spec, geom_bodies
from petmjx.world.scene import Scene

SAMPLE_STEPS = 100
INTERVAL_S = 0.7


def fixed_steps(n_boxes: int, timestep_s: float) -> int:
    """Number of steps of the fixed schedule after the soft start."""
    return int((n_boxes + 1) * INTERVAL_S / timestep_s)


def plain_loop(scene: Scene, physics: Physics, *, on_floor: bool) -> NDArray[np.float64]:
    """(n, 3) shifts at the end of the fixed schedule, m.

    The exact model with all boxes, one call of ``mj_step`` per step, NumPy metrics every 100 steps, a box placed every
    0.7 s. Boxes that wait are parked far apart: on the floor, as in the reference implementation, or in the air, held
    by a force equal to their weight (faster).
    """
    model = build_spec(scene, physics).compile()
    bodies = geom_bodies(model, range(scene.n_boxes))
    data = mujoco.MjData(model)
    n = scene.n_boxes
    pose, velocity = data.qpos[7:].reshape(n, 7), data.qvel[6:].reshape(n, 6)
    first = model.nbody - n
    acceleration, lifted = data.qacc[6:].reshape(n, 6), data.xfrc_applied[first:]
    weight = scene.mass * physics.gravity_m_s2 * (not on_floor)
    pose[:, 0] = 3.0 + 1.5 * np.arange(n)
    pose[:, 1] = 5.0
    pose[:, 2] = scene.floor_z + scene.half_size[:, 2] if on_floor else 5.0
    down = np.array([0.0, 0.0, -physics.gravity_m_s2])
    for step in range(2 * SOFT_START_STEPS):
        share = max(0, step - SOFT_START_STEPS) / SOFT_START_STEPS
        model.opt.gravity[:] = down * share
        lifted[:, 2] = weight * share
        mujoco.mj_step(model, data)
    model.opt.gravity[:] = down
    lifted[:, 2] = weight
    data.time = 0.0
    largest = np.zeros((4, n))  # tilt, linear and angular acceleration, force on top
    placed, last_s = 0, 0.0
    for step in range(1, fixed_steps(n, physics.timestep_s) + 1):
        mujoco.mj_step(model, data)
        if step % SAMPLE_STEPS == 0 and placed:
            now = (
                tilt_deg(data.xquat[first : first + placed]),
                np.linalg.norm(acceleration[:placed, :3], axis=1),
                np.linalg.norm(acceleration[:placed, 3:], axis=1),
                top_forces(data, bodies, n, physics.cone is Cone.PYRAMIDAL)[:placed],
            )
            np.maximum(largest[:, :placed], now, out=largest[:, :placed])
        if data.time - last_s >= INTERVAL_S and placed < n:
            pose[placed, :3], pose[placed, 3:] = scene.start_pos[placed], scene.start_quat[placed]
            velocity[placed] = 0.0
            lifted[placed, 2] = 0.0
            placed, last_s = placed + 1, data.time
    return np.asarray(pose[:, :3] - scene.target)
