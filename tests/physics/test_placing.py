"""The placement of boxes: falls and tips agree with closed forms, a hand presses with at most its largest force, and no
box starts inside another box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.plans import Box, make_scene

from petmjx.common.errors import InputError
from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.simulation import Simulation
from petmjx.world.approach_paths import FREE_M, approach_path_of
from petmjx.world.history import History, Record
from petmjx.world.job import Job
from petmjx.world.scene import Scene

CUBE: Box = ((300.0, 300.0, 300.0), (0.0, 0.0, 0.0), 6.0)
EVERY_STEP = Record(0.002, details=True)


def simulation(**placing: Any) -> Simulation:
    return Simulation(placing=placing)


def watched(scene: Scene, sim: Simulation) -> tuple[Outcome, History]:
    (outcome,) = MujocoEngine(1).run([Job(scene, record=EVERY_STEP)], sim)
    assert outcome.history is not None
    return outcome, outcome.history


def from_the_side(boxes: Sequence[Box], sim: Simulation, towards: tuple[float, float]) -> Scene:
    """A scene whose last box is moved to its place in the direction ``towards``."""
    scene = make_scene(boxes, sim)
    approach = np.zeros((scene.n_boxes, 2))
    approach[-1] = towards
    return replace(scene, approach=approach)


def begins(history: History, box: int) -> int:
    """The number of the first frame that contains a box."""
    return int(np.isfinite(history.pos[:, box, 0]).argmax())


def pressed_n(history: History, frame: int, one: int, other: int) -> np.ndarray[Any, Any]:
    """(3,) sum of the forces of all contacts between two bodies in a frame, N."""
    contacts = history.contacts
    assert contacts is not None
    these = (contacts.frame == frame) & (np.sort(contacts.body, axis=1) == sorted((one, other))).all(axis=1)
    force: np.ndarray[Any, Any] = contacts.force[these].sum(axis=0)
    return force


def test_a_dropped_box_lands_with_the_speed_of_its_height() -> None:
    sim = simulation(name="drop", height_mm=50.0)
    outcome, history = watched(make_scene([CUBE], sim), sim)
    speed = -np.diff(history.pos[:, 0, 2]) / np.diff(history.time_s)
    assert outcome.verdict is Verdict.STABLE
    assert speed.max() == pytest.approx(math.sqrt(2 * STANDARD_GRAVITY * 0.05), rel=0.03)


@pytest.mark.parametrize("size", [(300.0, 300.0, 300.0), (400.0, 200.0, 100.0)])
def test_a_box_let_go_on_one_edge_lands_as_a_pendulum_does(size: tuple[float, float, float]) -> None:
    """Energy of the turn about the edge on which the box stands: ½ · 4/3 · m (a² + c²) ω² = m g · (fall of the
    centre)."""
    sim = simulation(name="tines", tines_mm=40.0, force_n=1000.0)
    outcome, history = watched(make_scene([(size, (0.0, 0.0, 0.0), 6.0)], sim), sim)
    a, c = (size[0] - sim.size_reduction_mm) / 2000, size[2] / 2000
    angle = math.asin(0.04 / (2 * a))
    fall = a * math.sin(angle) + c * math.cos(angle) - c
    landing = math.sqrt(2 * STANDARD_GRAVITY * fall / (4 / 3 * (a * a + c * c)))
    tilt = 2 * np.arcsin(np.linalg.norm(history.quat[:, 0, 1:3], axis=1))
    turning = -np.diff(tilt) / np.diff(history.time_s)
    assert tilt[0] == pytest.approx(angle, rel=1e-6)
    assert turning.max() == pytest.approx(landing, rel=0.05)
    assert outcome.verdict is Verdict.STABLE


@pytest.mark.parametrize("force_n", [40.0, 120.0])
def test_a_hand_that_meets_a_wall_stops_at_its_force(force_n: float) -> None:
    wall: Box = ((400.0, 400.0, 400.0), (0.0, 0.0, 0.0), 2000.0)
    sim = simulation(name="hand", side_mm=100.0, height_mm=0.0, force_n=force_n)
    boxes = [wall, ((300.0, 300.0, 300.0), (340.0, 0.0, 0.0), 6.0)]
    scene = from_the_side(boxes, sim, (-1.0, 0.0))
    outcome, history = watched(scene, sim)
    path = approach_path_of(scene, sim)
    assert path is not None
    arrives = begins(history, 1) + int(path.steps[1]) - 1
    assert abs(pressed_n(history, arrives, 0, 1)[0]) == pytest.approx(force_n, rel=0.05)
    assert history.pos[-1, 1, 0] == pytest.approx(0.4 + 0.15, abs=0.001)
    assert outcome.culprit == 1  # the box stops 60 mm before its place
    assert history.time_s[-1] < 4.0


def test_a_hand_sets_a_box_down_where_it_belongs_and_nobody_feels_it() -> None:
    boxes = [CUBE, (CUBE[0], (300.0, 0.0, 0.0), 6.0), (CUBE[0], (150.0, 0.0, 300.0), 6.0)]
    exact, _ = watched(make_scene(boxes, Simulation()), Simulation())
    sim = simulation(name="hand")
    outcome, history = watched(make_scene(boxes, sim), sim)
    assert outcome.verdict is Verdict.STABLE
    np.testing.assert_allclose(outcome.boxes.pos, exact.boxes.pos, atol=1e-4)
    assert history.penetration_m is not None
    assert np.nanmax(history.penetration_m) < exact_depth(exact) + 2e-4
    assert outcome.n_steps < 2.5 * exact.n_steps


def exact_depth(exact: Outcome) -> float:
    assert exact.history is not None
    assert exact.history.penetration_m is not None
    return float(np.nanmax(exact.history.penetration_m[-1]))


def test_a_box_comes_from_where_nothing_stands() -> None:
    """Each box comes from sides at which no box stands. The last box, between two boxes, comes from −x and −y."""
    places = [(300.0, 0.0, 0.0), (600.0, 0.0, 0.0), (300.0, 300.0, 0.0), (0.0, 300.0, 0.0), (0.0, 0.0, 0.0)]
    sim = simulation(name="hand", side_mm=20.0, height_mm=5.0)
    path = approach_path_of(make_scene([(CUBE[0], place, 6.0) for place in places], sim), sim)
    assert path is not None
    np.testing.assert_allclose(
        path.offset * 1000, [(0, 0, 5), (20, 0, 5), (0, 20, 5), (-20, 0, 5), (-20, -20, 5)], atol=1e-9
    )


def test_no_box_begins_in_another_one() -> None:
    """The planned places of the third and the fourth box are 6 and 8 mm inside other boxes. The third box moves aside,
    and the fourth, between two boxes, moves up. So no contact ever becomes deeper than half a millimetre."""
    boxes = [
        CUBE,
        (CUBE[0], (600.0, 0.0, 0.0), 6.0),
        (CUBE[0], (0.0, 294.0, 0.0), 6.0),
        ((316.0, 300.0, 300.0), (292.0, 0.0, 0.0), 6.0),
    ]
    sim = simulation(name="hand", side_mm=3.5)
    _, history = watched(make_scene(boxes, sim), sim)
    assert history.pos[begins(history, 2), 2, 1] > 0.299 + 0.15  # moved aside
    assert history.pos[begins(history, 3), 3, 2] > 0.3 + 0.15  # moved up, above its neighbours
    assert history.penetration_m is not None
    assert np.nanmax(history.penetration_m) < FREE_M + 5e-4


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"placing": "hand", "check": "static"}, "placing hand needs check='one-by-one': in a static check"),
        ({"placing": "tines", "schedule": "fixed"}, "placing tines needs schedule='adaptive'"),
        ({"placing": "throw"}, "placing.name must be 'auto', 'exact', 'drop', 'hand' or 'tines', got 'throw'"),
        ({"placing": {"name": "hand", "force_n": 0}}, "placing.force_n must be from 0.1 to 100000, got 0"),
    ],
)
def test_what_cannot_be_placed_so_is_refused(options: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line):
        Simulation(**options)
