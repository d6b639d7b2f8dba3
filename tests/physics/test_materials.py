"""Boxes with different properties: each box slides at the friction of its pair of materials, and topples according to
its own centre of mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.plans import Box, make_plan

from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.materials import FrictionPair
from petmjx.options.physics import RESTITUTION
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.scene import build_scene
from petmjx.world.surface_pairs import NOT_GIVEN

MARGIN = 0.03
"""Required accuracy of thresholds: at 3 % below a threshold, boxes hold; at 3 % above, they fail."""
SIM = Simulation(check=Check.STATIC, schedule=Schedule.FIXED, settle_s=0.4, carrier="euro-pallet", early_stop=False)
SLIPPERY = {
    "boards": [
        {"corner_mm": [0, 0, 0], "size_mm": [1200, 800, 100], "mass_kg": 20},
        {"corner_mm": [0, 0, 100], "size_mm": [1200, 800, 20], "mass_kg": 5, "friction": 0.2},
    ]
}


def accelerated(plan: Plan, level_g: float, sim: Simulation = SIM) -> Outcome:
    """Simulate the plan on a carrier with a prescribed acceleration along x, which reaches its level in 0.2 s and keeps
    it for 1.6 s."""
    rows = np.zeros((900, 3))
    rows[:, 0] = STANDARD_GRAVITY * level_g * np.concatenate((np.linspace(0.0, 1.0, 100), np.ones(800)))
    drive = Drive(Excitation("test", "acceleration", rows), rest_s=0.4)
    (outcome,) = MujocoEngine(1).run([Job(build_scene(plan, sim), drive)], sim)
    return outcome


def flat(n: int) -> Sequence[Box]:
    return [((200, 200, 100), (500, 300, 100.0 * k), 5.0) for k in range(n)]


@pytest.mark.parametrize(
    ("materials", "changes", "friction", "slides"),
    [
        pytest.param(["film"], {}, 0.3, 0, id="film on wood"),
        pytest.param(["plastic"], {}, 0.2, 0, id="plastic on wood"),
        pytest.param(["cardboard"], {}, 0.5, 0, id="cardboard on wood"),
        pytest.param(["wood", "film"], {}, 0.3, 1, id="film on a wooden box"),
        pytest.param(
            ["rubber", "film"],
            {
                "friction_pairs": [
                    FrictionPair(between=("wood", "rubber"), friction=0.9),
                    FrictionPair(between=("rubber", "rubber"), friction=1.1),
                    FrictionPair(between=("film", "rubber"), friction=0.4),
                ]
            },
            0.4,
            1,
            id="film on rubber, as the user says",
        ),
        pytest.param(["steel"], {"carrier": "rollcontainer-grid"}, 0.2, 0, id="steel on bars of steel"),
        pytest.param(["cardboard"], {"carrier": SLIPPERY}, 0.2, 0, id="a board's own friction"),
        pytest.param([""], {"carrier": SLIPPERY}, 0.2, 0, id="a board's own friction, without materials"),
        pytest.param(["", "film"], {}, 0.5, 1, id="on a box of which nothing is said"),
    ],
)
def test_a_box_slides_at_the_friction_of_its_pair(
    materials: list[str], changes: dict[str, object], friction: float, slides: int
) -> None:
    plan = replace(make_plan(boxes=flat(len(materials))), materials=tuple(materials))
    sim = SIM.changed(**changes)
    below = accelerated(plan, (1 - MARGIN) * friction, sim)
    above = accelerated(plan, (1 + MARGIN) * friction, sim)
    assert below.verdict is Verdict.STABLE
    assert below.boxes.max_sway_m.max() < 0.002
    assert above.boxes.max_sway_m[slides] > 0.05


@pytest.mark.parametrize("aside", [(25.0, 0.0, 0.0), (-25.0, 0.0, 0.0), (0.0, 50.0, 0.0), (-10.0, 0.0, 60.0)])
def test_a_box_topples_about_its_own_centre_of_mass(aside: tuple[float, float, float]) -> None:
    """A box topples at the acceleration g·b′/h, where b′ is the horizontal distance of the centre of mass from the
    tipping edge, and h is the height of the centre."""
    box = ((100.0, 200.0, 400.0), (500.0, 300.0, 0.0), 5.0)
    plan = replace(make_plan(boxes=[box]), mass_center_mm=np.array([aside]))
    level_g = (50.0 + aside[0]) / (200.0 + aside[2])
    below, above = accelerated(plan, (1 - MARGIN) * level_g), accelerated(plan, (1 + MARGIN) * level_g)
    assert below.verdict is Verdict.STABLE
    assert below.boxes.max_sway_m[0] < 0.002
    assert above.boxes.max_tilt_deg[0] > 45.0


def test_the_materials_of_a_board_with_its_own_friction_count_only_for_landings() -> None:
    pair = FrictionPair(between=("cardboard", "wood"), friction=0.4, kinetic=0.3)
    plan = replace(make_plan(boxes=flat(1)), materials=("cardboard",))
    scene = build_scene(plan, SIM.changed(carrier=SLIPPERY, friction_pairs=[pair]))
    assert scene.surface is not None
    of_boards = {name: table[scene.surface[0], scene.carrier.surface].tolist() for name, table in scene.pairs.items()}
    assert of_boards["friction"] == [0.4, 0.2]
    assert of_boards["kinetic"] == [pytest.approx(0.75), NOT_GIVEN]
    assert of_boards["landing"] == [[RESTITUTION, NOT_GIVEN]] * 2


def test_what_says_nothing_changes_nothing() -> None:
    plan = make_plan(boxes=flat(2))
    scene = build_scene(plan, SIM)
    assert not scene.pairs
    assert scene.surface is None
    assert scene.carrier.surface is None
    assert scene.mass_center is None
