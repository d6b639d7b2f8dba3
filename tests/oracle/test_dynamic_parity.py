"""The dynamic check of the paper, with the options of `sweeps/radial-force.toml`.

Results are compared with the figures that the reference implementation printed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.reference import assert_matches, real_plans, reference_run

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.options.simulation import Check
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.job import Job

FORCE_N = 0.1
"""Tolerance of forces. It is large, since boxes that slide bear and shed load in turn."""


@pytest.mark.parametrize(
    ("plan_id", "shift_m"),
    [
        ("packing_plan_a", 2e-4),
        # one by one this plan collapses, and a collapse amplifies rounding
        ("00100408", 2e-3),
    ],
)
def test_the_demo_s_chain_does_to_plans_what_the_reference_printed(
    plan_id: str, shift_m: float, repository: Path
) -> None:
    sweep = load_sweep(repository / "sweeps" / "radial-force.toml", plans_given=True)
    plan = SweepPlan(sweep, [real_plans()[plan_id]])
    (group,) = plan.groups()
    (variant,) = group.variants
    job = Job(plan.scene(group), plan.drive(group.plan, variant))
    (outcome,) = MujocoEngine(1).run([job], sweep.simulation)
    run = reference_run(plan_id, Check.ONE_BY_ONE, forces=True)
    assert not run.stable
    assert_matches(outcome, run, shift_m, FORCE_N)
    # after the shaking no component of a shift is so near to 1 mm that only one of both sides calls it 0
    np.testing.assert_allclose(outcome.boxes.shift_m, run.shift_m, atol=shift_m)
