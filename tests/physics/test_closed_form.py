"""Results of the engine mujoco are compared with closed forms: balance, loads, sliding and toppling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from support.plans import Box, make_plan, make_scene, stack

import petmjx
from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.carriers import Carrier
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.world.job import Drive, Excitation, Job

G = 9.81
MU = 0.5
"""Coefficient of friction between box and carrier, and between boxes, in the preset ``pallet``."""
MARGIN = 0.03
"""Required accuracy of the thresholds of sliding and toppling: at 3 % below a threshold, boxes hold; at 3 % above, they
fail."""
LOAD_RELATIVE = 0.01
"""Relative tolerance of loads at rest. The forces on a box at rest balance, although contacts are soft. 1 % is allowed
because a box may still sink slowly."""


def simulate(boxes: Sequence[Box], sim: Simulation, drive: Drive | None = None) -> Outcome:
    sim = sim.changed(carrier=Carrier.EURO_PALLET)
    (outcome,) = MujocoEngine(1).run([Job(make_scene(boxes, sim), drive)], sim)
    return outcome


@pytest.mark.parametrize("check", list(Check))
@pytest.mark.parametrize(("overhang_mm", "stands"), [(180, True), (220, False)])
def test_a_box_tips_when_more_than_half_of_it_hangs_over(overhang_mm: float, stands: bool, check: Check) -> None:
    boxes = stack(2, overhang_mm, kg=(8.0, 5.0), at_mm=(0, 100))
    outcome = simulate(boxes, Simulation(check=check))
    assert (outcome.verdict is Verdict.STABLE) == stands
    if not stands:
        assert outcome.culprit == 1


@pytest.mark.parametrize("physics", list(PHYSICS))
def test_every_box_of_a_tower_bears_what_stands_on_it(physics: str) -> None:
    masses = [9.0, 7.0, 5.0, 3.0, 2.0, 1.0]
    boxes = stack(len(masses), size_mm=(300, 300, 150), kg=masses, at_mm=(200, 200))
    outcome = simulate(boxes, Simulation(physics=physics))
    above_kg = np.array([sum(masses[k + 1 :]) for k in range(len(masses))])
    assert outcome.verdict is Verdict.STABLE
    np.testing.assert_allclose(outcome.boxes.rest_top_force_n, above_kg * G, rtol=LOAD_RELATIVE, atol=0.01)


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_a_plank_that_leans_on_a_plate_with_a_higher_middle_bears_on_it(engine: str) -> None:
    """The plank leans from the carrier to the edge of a plate. The plank's middle is lower than that of the plate, but
    the plank lies on the plate."""
    plank, edge_mm, kg = 600.0, 460.0, 2.0
    boxes = [
        ((300.0, 200.0, 10.0), (500.0, 10.0, 0.0), 1.2),
        ((400.0, 300.0, 5.0), (edge_mm, 0.0, 10.0), 2.3),
        ((plank, 200.0, 5.0), (0.0, 70.0, 15.0), kg),
    ]
    results = petmjx.score(make_plan(boxes=boxes), engine=engine)
    middle_z = results.boxes.pos_z_m
    assert middle_z[2] < middle_z[1]
    on_plate = kg * G * plank / 2 / edge_mm
    np.testing.assert_allclose(results.boxes.rest_top_force_n, [2.3 * G + on_plate, on_plate, 0], rtol=LOAD_RELATIVE)
    assert results.boxes.rest_edge_m[2] == pytest.approx(0.1, abs=1e-3)


def test_a_bridge_loads_both_supports_alike() -> None:
    supports = [((200, 300, 200), (x, 0, 0), 5.0) for x in (0, 600)]
    outcome = simulate([*supports, ((800, 300, 100), (0, 0, 200), 6.0)], Simulation())
    assert outcome.verdict is Verdict.STABLE
    np.testing.assert_allclose(outcome.boxes.rest_top_force_n, [3.0 * G, 3.0 * G, 0.0], rtol=LOAD_RELATIVE, atol=0.01)


CUBE = stack(1, size_mm=(200, 200, 200), at_mm=(500, 300))
TALL = stack(1, size_mm=(100, 200, 400), at_mm=(500, 300))
FLAT_PAIR = stack(2, size_mm=(200, 200, 100), at_mm=(500, 300))
TOWER = stack(2, size_mm=(100, 200, 200), at_mm=(500, 300))


def accelerated(boxes: Sequence[Box], carrier_acceleration: FloatArray) -> Outcome:
    """Simulate boxes that stand on a carrier with a prescribed acceleration. ``carrier_acceleration`` has one row for
    each step."""
    sim = Simulation(check=Check.STATIC, schedule=Schedule.FIXED, settle_s=0.4, early_stop=False)
    return simulate(boxes, sim, Drive(Excitation("test", "acceleration", carrier_acceleration), rest_s=0.4))


def constant_along_x(level_m_s2: float) -> FloatArray:
    """An acceleration along x that reaches its level in 0.2 s and keeps it for 1.6 s. The acceleration lasts long
    enough for a slow topple to end."""
    level = np.concatenate((np.linspace(0.0, 1.0, 100), np.ones(800))) * level_m_s2
    return np.column_stack((level, np.zeros_like(level), np.zeros_like(level)))


@pytest.mark.parametrize(
    ("boxes", "threshold_m_s2", "reason"),
    [
        pytest.param(CUBE, MU * G, "shift", id="box slides at mu g"),
        pytest.param(FLAT_PAIR, MU * G, "shift", id="upper of two boxes slides at mu g"),
        pytest.param(TALL, G * 100 / 400, "tilt", id="box topples at g b/h"),
        pytest.param(TOWER, G * 100 / 400, "tilt", id="tower of two topples at g b/h"),
    ],
)
def test_sliding_and_toppling_begin_where_they_should(boxes: Sequence[Box], threshold_m_s2: float, reason: str) -> None:
    below = accelerated(boxes, constant_along_x((1.0 - MARGIN) * threshold_m_s2))
    above = accelerated(boxes, constant_along_x((1.0 + MARGIN) * threshold_m_s2))
    assert below.verdict is Verdict.STABLE
    # A box that slides or topples moves by 100 mm or more, so a sway of less than 2 mm means that neither has begun.
    assert below.boxes.max_sway_m.max() < 0.002
    assert above.verdict is Verdict.UNSTABLE
    assert above.boxes.max_sway_m.max() > 0.1
    toppled = above.boxes.max_tilt_deg[0] > 45.0
    assert toppled == (reason == "tilt")


@pytest.mark.parametrize(("fraction", "holds"), [(1.0 - MARGIN, True), (1.0 + MARGIN, False)])
def test_a_box_slides_when_the_carrier_is_tilted_beyond_the_friction_angle(fraction: float, holds: bool) -> None:
    angle = np.arctan(MU) * fraction * np.minimum(np.arange(1500) / 500, 1.0)
    # In the frame of the tilted carrier, gravity is g (sin, 0, −cos). The acceleration a of the carrier makes gravity
    # minus a equal to this.
    rows = G * np.column_stack((-np.sin(angle), np.zeros_like(angle), np.cos(angle) - 1.0))
    outcome = accelerated(CUBE, rows)
    assert (outcome.verdict is Verdict.STABLE) == holds
    assert (outcome.boxes.max_sway_m[0] < 0.002) == holds


def test_a_push_on_a_free_carrier_moves_it_and_what_stands_on_it() -> None:
    # A force of 0.9 of the weight lifts the pallet, so friction at the floor (coefficient 1.0) is only a tenth of its
    # usual value.
    samples = np.tile([0.4, 0.0, 0.9], (100, 1))
    sim = Simulation(schedule=Schedule.FIXED, settle_s=0.4)
    outcome = simulate(CUBE, sim, Drive(Excitation("push", "force", samples), rest_s=0.6))
    # The net acceleration (0.4 − 0.1 for friction) g for 0.2 s gives a speed of 0.59 m/s. Then friction of 1.0 g stops
    # the pallet within another 18 mm.
    assert 0.02 < outcome.boxes.max_sway_m[0] < 0.16
