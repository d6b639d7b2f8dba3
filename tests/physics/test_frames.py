"""petmjx simulates a prescribed acceleration of the carrier as additional gravity in the carrier's frame. The tests
compare this gravity with a carrier that really accelerates.

A plan that holds and a single box that slides are compared. Stacks that slide far are not compared: their boxes rub and
rock, so their final places differ by millimetres, even if only the solver's tolerance is changed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.plans.bundled import bundled_path
from petmjx.plans.plan_reader import load_plans
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.profiles.profile_registry import BUILT_IN
from petmjx.world.scene import Scene, build_scene

HEAVY_KG = 1e6
"""Mass of the carrier that really accelerates. The boxes slow such a carrier by at most a ten-thousandth."""

SLIPPERY = (1e-5, 1e-5, 1e-5)
"""MuJoCo's smallest coefficients of friction, for carrier and floor. In a contact, MuJoCo uses the larger coefficient
of the two bodies. So boxes keep their friction on the carrier, while the carrier slides freely on the floor."""

SHIFT_M = 0.001
"""Required agreement of shifts, m: a twentieth of the shift above which a plan is unstable."""

SIM = Simulation(check=Check.STATIC, schedule=Schedule.FIXED, settle_s=0.6, early_stop=False, longest_wait_s=0)
"""There is no waiting for rest, because boxes on a carrier that keeps sliding are never at rest."""
REST_S = 0.6


def run(scene: Scene, kind: str, samples: FloatArray) -> Outcome:
    (outcome,) = MujocoEngine(1).run([Job(scene, Drive(Excitation("test", kind, samples), rest_s=REST_S))], SIM)
    return outcome


def travelled_m(acceleration: FloatArray) -> FloatArray:
    """(3,) distance that the carrier travels until the end of the run, m, integrated with MuJoCo's steps."""
    dt = SIM.physics.timestep_s
    steps = np.zeros((len(acceleration) + int(REST_S / dt), 3))
    steps[: len(acceleration)] = acceleration
    return np.asarray((np.cumsum(steps * dt, axis=0) * dt).sum(axis=0))


@pytest.mark.parametrize(("plan_id", "level_g", "holds"), [("s0-000092", 0.45, True), ("hand-one-box", 0.58, False)])
def test_gravity_in_the_carrier_s_frame_is_the_carrier_accelerated(plan_id: str, level_g: float, holds: bool) -> None:
    plan = next(plan for plan in load_plans([bundled_path()]) if plan.plan_id == plan_id)
    scene = build_scene(plan, SIM)
    scene = replace(scene, carrier=replace(scene.carrier, friction=np.array([SLIPPERY])))
    acceleration = BUILT_IN["eumos-40509"].excitation(SIM.physics.timestep_s).samples * level_g
    held = run(scene, "acceleration", acceleration)
    heavy = replace(scene, carrier=replace(scene.carrier, mass=HEAVY_KG), floor_friction=SLIPPERY)
    moved = run(heavy, "force", acceleration / STANDARD_GRAVITY)
    travel = travelled_m(acceleration)
    assert travel[0] > 1.0
    shift = held.boxes.pos - scene.target
    relative = moved.boxes.pos - travel - scene.target
    np.testing.assert_allclose(relative, shift, atol=SHIFT_M)
    limits = SIM.thresholds
    for shifts, outcome in ((shift, held), (relative, moved)):
        within = np.abs(shifts).max() < limits.shift_m and outcome.boxes.max_tilt_deg.max() < limits.tilt_deg
        assert within == holds
