"""Tests of the unit of a profile's samples. The unit is the same on every engine, and does not depend on gravity."""

from __future__ import annotations

import numpy as np
import pytest
from support.worlds import make_plan

from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.options.simulation import Simulation
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import build_scene

GRAVITY_M_S2 = 4.0
BOXES = (((400, 300, 200), (0, 0, 0), 6.0), ((400, 300, 200), (0, 0, 200), 4.0))


def pushed(kind: str, scale: float, gravity_m_s2: float) -> tuple[Job, Simulation]:
    """A job with a push along +z for 0.1 s, and its options."""
    sim = Simulation(physics={"gravity_m_s2": gravity_m_s2}, longest_wait_s=0.0)
    samples = np.tile([0.0, 0.0, 0.5], (50, 1))
    drive = Drive(Excitation("push", kind, samples), scale=scale, rest_s=0.0)
    return Job(build_scene(make_plan("two", BOXES), sim), drive), sim


@pytest.mark.parametrize(("kind", "unit"), [("force", 35.0 * 9.81), ("acceleration", 1.0)])
def test_the_unit_does_not_depend_on_gravity(kind: str, unit: float) -> None:
    for gravity_m_s2 in (9.81, GRAVITY_M_S2):
        job, sim = pushed(kind, 2.0, gravity_m_s2)
        assert job.drive is not None
        assert job.drive.unit(job.scene.total_mass) == pytest.approx(unit)
        worlds = upload_worlds([job], 1, 2, {id(job.drive.excitation): 0}, sim)
        assert float(worlds.drive_scale[0]) == pytest.approx(2.0 * unit)


def test_mujoco_pushes_with_half_of_the_weight_on_earth() -> None:
    """A push of 0.5 units accelerates the pallet with 0.5 × 9.81 m/s², more than the gravity of 4 m/s², so the pallet
    rises. If the unit depended on gravity, the pallet would not rise."""
    job, sim = pushed("force", 1.0, GRAVITY_M_S2)
    (outcome,) = MujocoEngine(1).run([job], sim)
    rise_m = 0.5 * (0.5 * 9.81 - GRAVITY_M_S2) * 0.1**2
    np.testing.assert_allclose(outcome.boxes.pos[:, 2] - job.scene.target[:, 2], rise_m, atol=1.5e-3)
    (on_earth,) = MujocoEngine(1).run([pushed("force", 1.0, 9.81)[0]], pushed("force", 1.0, 9.81)[1])
    assert (on_earth.boxes.pos[:, 2] < job.scene.target[:, 2]).all()
