"""The phenomena of real pallets that docs/reality.md describes. Each phenomenon is simulated with a small plan, with
and without the option that models it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

FILE = Path(__file__).resolve().parents[2] / "docs" / "reality.json"
PLANS = {plan.plan_id: plan for plan in load_plans(FILE).plans}


def simulated(plan: Plan, **options: Any) -> Outcome:
    sim = Simulation(**options)
    (outcome,) = MujocoEngine(1).run([Job(build_scene(plan, sim))], sim)
    return outcome


@pytest.mark.parametrize("carrier", ["euro-pallet", "epal-1"])
@pytest.mark.parametrize("placing", ["exact", "tines"])
def test_a_box_let_go_by_its_edge_tips_into_a_gap(carrier: str, placing: str) -> None:
    outcome = simulated(PLANS["gap"], carrier=carrier, placing=placing)
    falls = carrier == "epal-1" and placing == "tines"
    assert (outcome.verdict is Verdict.UNSTABLE) is falls
    assert (outcome.reason is Reason.TILT) is falls


def test_a_box_that_a_hand_sets_on_its_neighbours_edge_stays_tilted_and_so_does_the_next() -> None:
    by_hand = simulated(PLANS["pushed"], carrier="euro-pallet", placing="hand").boxes.max_tilt_deg
    exact = simulated(PLANS["pushed"], carrier="euro-pallet", placing="exact").boxes.max_tilt_deg
    assert by_hand[2:] == pytest.approx([3.5, 3.5], abs=0.2)
    assert by_hand[:2].max() < 0.1
    assert exact.max() < 0.1


def test_bottles_lean_on_a_carton_that_gives() -> None:
    soft = simulated(PLANS["bottles"])
    rigid = simulated(replace(PLANS["bottles"], stiffness_n_mm=None))
    assert soft.verdict is rigid.verdict is Verdict.STABLE
    assert soft.boxes.max_tilt_deg[1] == pytest.approx(3.77, abs=0.1)
    assert rigid.boxes.max_tilt_deg[1] < 0.01
