"""The dynamic check of the paper, with the options of `sweeps/radial-force.toml`.

Results are compared with the figures that the reference implementation printed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.reference import assert_matches, real_plans, reference_run

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.options.simulation import Check
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.job import Job

PLAN = "00100408"
SHIFT_M = 0.002
"""Tolerance of shifts. If boxes are placed one by one, the plan collapses, and a collapse amplifies rounding."""
FORCE_N = 0.1
"""Tolerance of forces. The tolerance of forces is large, since boxes that slide bear and shed load in turn."""


def test_the_demo_s_chain_does_to_a_plan_what_the_reference_printed(repository: Path) -> None:
    sweep = load_sweep(repository / "sweeps" / "radial-force.toml", plans_given=True)
    plan = SweepPlan(sweep, [real_plans()[PLAN]])
    (group,) = plan.groups()
    (variant,) = group.variants
    job = Job(plan.scene(group), plan.drive(group.plan, variant))
    (outcome,) = MujocoEngine(1).run([job], sweep.simulation)
    run = reference_run(PLAN, Check.ONE_BY_ONE, forces=True)
    assert not run.stable
    assert_matches(outcome, run, SHIFT_M, FORCE_N)
    # after the shaking no component of a shift is so near to 1 mm that only one of both sides calls it 0
    np.testing.assert_allclose(outcome.boxes.shift_m, run.shift_m, atol=SHIFT_M)
