"""The verdict on a plan does not depend on where the plan lies, on its orientation or on mirroring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.plans import make_plan

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome
from petmjx.options.carriers import Carrier
from petmjx.options.simulation import Simulation
from petmjx.plans.bundled import bundled_path
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

SIM = Simulation()

GENERATED = ("s0-000092", "s0-000430", "s0-001349")
"""Ids of three generated plans with few boxes, of which one stands and two collapse. No verdict changed either for all
bundled plans, 40 more generated plans and 10 plans of other packers, but these take two minutes."""


def mirrored_x(plan: Plan) -> Plan:
    corner = plan.corner_mm * (-1, 1, 1) - plan.size_mm * (1, 0, 0)
    return replace(plan, corner_mm=corner)


def mirrored_y(plan: Plan) -> Plan:
    corner = plan.corner_mm * (1, -1, 1) - plan.size_mm * (0, 1, 0)
    return replace(plan, corner_mm=corner)


def turned_by_180(plan: Plan) -> Plan:
    return mirrored_y(mirrored_x(plan))


def turned_by_90(plan: Plan) -> Plan:
    """The plan turned by 90°: (x, y) → (−y, x)."""
    swap = [1, 0, 2]
    return mirrored_x(replace(plan, corner_mm=plan.corner_mm[:, swap], size_mm=plan.size_mm[:, swap]))


def translated(plan: Plan) -> Plan:
    return replace(plan, corner_mm=plan.corner_mm + np.array([-1234.0, 567.0, 0.0]))


MOVES: tuple[Callable[[Plan], Plan], ...] = (mirrored_x, mirrored_y, turned_by_180, turned_by_90, translated)


def outcomes(plans: list[Plan]) -> dict[str, Outcome]:
    answers = MujocoEngine().run([Job(build_scene(plan, SIM)) for plan in plans], SIM)
    return {plans[outcome.job].plan_id: outcome for outcome in answers}


@pytest.fixture(scope="module")
def plans() -> list[Plan]:
    every = load_plans(bundled_path()).plans
    return [plan for plan in every if plan.plan_id.startswith("hand-") or plan.plan_id in GENERATED]


@pytest.fixture(scope="module")
def as_planned(plans: list[Plan]) -> dict[str, Outcome]:
    return outcomes(plans)


@pytest.mark.parametrize("move", MOVES)
def test_no_verdict_changes(plans: list[Plan], as_planned: dict[str, Outcome], move: Callable[[Plan], Plan]) -> None:
    moved = outcomes([move(plan) for plan in plans])
    assert {name: outcome.verdict for name, outcome in moved.items()} == {
        name: outcome.verdict for name, outcome in as_planned.items()
    }


@pytest.mark.parametrize("move", MOVES)
def test_the_footprint_carrier_moves_with_the_plan(move: Callable[[Plan], Plan]) -> None:
    plan = make_plan(boxes=(((400, 300, 200), (0, 0, 0), 6.0), ((200, 100, 200), (500, 350, 0), 6.0)))
    scene = build_scene(move(plan), SIM)
    corners = move(plan).corner_mm, move(plan).corner_mm + move(plan).size_mm
    low, high = corners[0].min(axis=0) / 1000, corners[1].max(axis=0) / 1000
    np.testing.assert_allclose((scene.carrier.pos - scene.carrier.half_size[0])[:2], low[:2], atol=1e-12)
    np.testing.assert_allclose((scene.carrier.pos + scene.carrier.half_size[0])[:2], high[:2], atol=1e-12)
    assert scene.carrier.pos[2] + scene.carrier.half_size[0][2] == 0.0


def test_a_fixed_carrier_stays_at_the_origin() -> None:
    sim = Simulation(carrier=Carrier.EURO_PALLET)
    scene = build_scene(translated(make_plan()), sim)
    np.testing.assert_array_equal(scene.carrier.pos, [0.6, 0.4, -0.072])
