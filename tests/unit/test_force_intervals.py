"""The smallest and the largest possible force on a box at rest are compared with closed forms, and with simulations."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.command_line import only_line, run, write
from support.plans import Box, make_plan, stack

pytest.importorskip("scipy")

import petmjx
from petmjx.analysis import force_intervals as intervals
from petmjx.analysis.force_intervals import force_intervals
from petmjx.common.units import FloatArray
from petmjx.options.simulation import Simulation
from petmjx.plans.bundled import bundled_path
from petmjx.world.scene import build_scene

MU = 0.5
EXACT = {"name": "pallet", "skin_m": 0.0, "gravity_m_s2": 10.0}
"""Options of the physics. Without a skin (thickness by which the collider enlarges boxes), contacts are exactly those
of the plan. With this gravity, a box of 1 kg weighs 10 N."""


def found(boxes: Sequence[Box], mu: float = MU, size_reduction_mm: float = 0.0) -> FloatArray:
    """(n, 2) smallest and largest force on top of each box at its planned place, N."""
    friction = (mu, 0.005, 0.0001)
    physics = EXACT | {"box_friction": friction, "carrier_friction": friction}
    sim = Simulation(physics=physics, size_reduction_mm=size_reduction_mm)
    scene = build_scene(make_plan(boxes=boxes), sim)
    return force_intervals(scene, sim.physics, scene.target, scene.start_quat)


def beam(x: float, x_end: float, z: float, z_end: float, kg: float) -> Box:
    """A box from x to x_end and from z to z_end. All such boxes are 300 mm wide along y, so the problem is
    two-dimensional."""
    return (x_end - x, 300, z_end - z), (x, 0, z), kg


def test_a_determinate_stack_has_one_answer() -> None:
    """In a statically determinate stack, the two ends of an interval are equal: the force on a box is the weight of all
    boxes above."""
    lowest, middle = beam(0, 800, 0, 200, 9), beam(0, 800, 200, 400, 8)
    tops = [beam(0, 300, 400, 600, 3), beam(400, 700, 400, 600, 4), beam(400, 700, 600, 800, 5)]
    answer = found([lowest, middle, *tops])
    assert answer.tolist() == pytest.approx(np.transpose([[200, 120, 0, 50, 0]] * 2))


PLANK = [
    beam(0, 100, 0, 200, 1),
    beam(450, 550, 0, 200, 1),
    beam(900, 1000, 0, 200, 1),
    beam(0, 1000, 200, 300, 6),
]
"""A plank of 60 N on three supports. The middle support alone could carry the plank."""


def test_a_plank_on_three_supports() -> None:
    """The largest force on an outer support acts at its inner edge, while the remaining weight is at the far end of the
    plank. The largest force on an outer support is 500 / 900 of the weight."""
    outer = [0, 60 * 500 / 900]
    assert found(PLANK).tolist() == pytest.approx(np.array([outer, [0, 60], outer, [0, 0]]), abs=1e-4)


def test_of_two_supports_both_are_needed() -> None:
    """Each of two supports carries from 200 / 700 to 500 / 700 of the weight, depending on the points within the
    contacts at which forces act."""
    share = np.array([(700 - 500) / (700 - 0), (1000 - 500) / (1000 - 300)])
    answer = found([beam(0, 300, 0, 200, 1), beam(700, 1000, 0, 200, 1), beam(0, 1000, 200, 300, 6)])
    assert answer.tolist() == pytest.approx(np.array([60 * share, 60 * share, [0, 0]]), abs=1e-4)


WALL_KG = 20.0
WEDGED = [
    beam(0, 600, 0, 400, WALL_KG),
    beam(600, 800, 0, 200, 2),
    beam(800, 1400, 0, 400, WALL_KG),
    beam(600, 800, 200, 400, 3),
]
"""A box of 30 N on another box, between two heavy boxes that are like walls."""


def test_a_box_wedged_between_two_walls() -> None:
    """The walls can carry the whole box by friction. The walls can also press the box down by friction, with μ N each,
    where N is the horizontal force. Friction that presses the box down lifts the walls, so N is at most μ (W - μ N);
    otherwise the walls would slide apart."""
    pressing = MU * WALL_KG * 10 / (1 + MU**2)
    assert found(WEDGED)[1] == pytest.approx([0, 30 + 2 * MU * pressing], abs=1e-3)


def test_neighbours_that_do_not_touch_do_not_press() -> None:
    assert found(WEDGED, size_reduction_mm=0.1)[1] == pytest.approx([30, 30], abs=1e-4)


@pytest.mark.parametrize("boxes", [PLANK, WEDGED])
def test_more_friction_leaves_no_less_open(boxes: Sequence[Box]) -> None:
    answers = [found(boxes, mu) for mu in (0.05, 0.2, 0.5, 0.8)]
    for less, more in pairwise(answers):
        assert (more[:, 0] <= less[:, 0] + 1e-6).all()
        assert (more[:, 1] >= less[:, 1] - 1e-6).all()


def test_what_no_forces_balance_has_no_interval() -> None:
    """If no forces balance a box, there is no interval: both supports of a plank are to the left of its centre. A stack
    beside the plank has intervals."""
    plank = [beam(0, 100, 0, 200, 1), beam(200, 300, 0, 200, 1), beam(0, 1000, 200, 300, 6)]
    answer = found([*plank, *stack(2, at_mm=(2000, 0))])
    assert np.isnan(answer[:2]).all()
    assert answer[2:].tolist() == pytest.approx(np.transpose([[0, 50, 0]] * 2))


def test_the_closed_form_is_what_the_linear_programme_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Simulation()
    (plan,) = (plan for plan in petmjx.load_plans(bundled_path()) if plan.plan_id == "s0-000007")
    scene = build_scene(plan, sim)
    arguments = (scene, sim.physics, scene.target, scene.start_quat)
    with_closed_form = force_intervals(*arguments)
    monkeypatch.setattr(intervals, "_without_programme", lambda touching, weight: np.full((len(weight), 2), np.nan))
    assert force_intervals(*arguments).tolist() == pytest.approx(with_closed_form, rel=1e-5, abs=1e-4)


# runs with intervals of forces

REST_TOLERANCE = 0.005
"""Tolerance of simulated forces, as a share of the largest force in a plan. Forces still tremble when a run ends: in
hand-drop-of-5-mm by 0.23 %."""


def test_what_is_simulated_lies_within(tmp_path: Path) -> None:
    plans = [plan for plan in petmjx.load_plans(bundled_path()) if plan.n_boxes <= 20]
    results = petmjx.score(plans, engine="mujoco", force_intervals=True, out=tmp_path / "run")
    stands = results.worlds.loc[results.worlds["verdict"] == "stable", "plan_id"]
    assert len(stands) > 10
    boxes = results.boxes[results.boxes["plan_id"].isin(stands)]
    low, force, high = (boxes[f"rest_top_force_{part}"] for part in ("low_n", "n", "high_n"))
    slack = REST_TOLERANCE * force.groupby(boxes["plan_id"]).transform("max")
    assert (low <= high).all()
    assert (low - slack <= force).all()
    assert (force <= high + slack).all()
    assert 0.02 < (high > low + slack).mean() < 0.5  # statics leaves some forces open, but determines most of them
    assert results.units("boxes")["rest_top_force_low_n"] == "N"
    assert results.info["timings"]["intervals_s"] > 0
    # a world without forces at rest has no intervals
    ended = results.boxes[results.boxes["rest_top_force_n"].isna()]
    assert len(ended)
    assert ended[["rest_top_force_low_n", "rest_top_force_high_n"]].isna().all(axis=None)


def test_nothing_else_changes(tmp_path: Path) -> None:
    plans = [make_plan(f"p{n}", n) for n in (2, 3)]
    plain = petmjx.score(plans, engine="mujoco", threads=1, out=tmp_path / "plain")
    more = petmjx.score(plans, engine="mujoco", threads=1, force_intervals=True, out=tmp_path / "more")
    names = ["rest_top_force_low_n", "rest_top_force_high_n"]
    assert [name for name in more.boxes if name not in plain.boxes] == names
    assert more.boxes.drop(columns=names).equals(plain.boxes)
    assert more.worlds.equals(plain.worlds)
    for folder, enabled, message in (("plain", True, "is True, was False"), ("more", False, "is False, was True")):
        with pytest.raises(petmjx.InputError, match=rf"another run \(force_intervals {message}\)"):
            petmjx.score(plans, engine="mujoco", force_intervals=enabled, out=tmp_path / folder, resume=True)


def test_masses_of_variants_count_and_drives_have_none(tmp_path: Path) -> None:
    options = {"plans": [make_plan("p", stack(2, kg=10))], "engine": "mujoco", "force_intervals": True, "settle_s": 0.2}
    resting = petmjx.sweep(write(tmp_path / "rest.toml", "axes.mass_factor = [1.0, 2.0]"), **options).boxes
    resting = resting.sort_values(["variant", "box"])
    assert resting["rest_top_force_low_n"].tolist() == pytest.approx([98.1, 0, 196.2, 0])
    drive = 'axes.profile = "eumos-40509"\naxes.level = 0.05\naxes.direction = "+x"'
    driven = petmjx.sweep(write(tmp_path / "drive.toml", drive), **options).boxes
    assert driven["rest_top_force_n"].notna().all()
    assert driven["rest_top_force_low_n"].isna().all()


def test_without_scipy_nothing_is_simulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    assert run("score", "--force-intervals", "-o", str(tmp_path / "run")) == 2
    line = "petmjx: --force-intervals needs SciPy: pip install 'petmjx[packers]'"
    assert only_line(capsys.readouterr().err) == line
    assert not (tmp_path / "run").exists()
