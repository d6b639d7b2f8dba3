"""Tests of time estimates for plans that fall, for ties and compliant boxes, and for pallets with film. Whether a box
tips over follows from the plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.plans import Box, make_plan

from benchmarks.time_estimates import cut, shelf_plan
from petmjx.engines.cost_model import GENTLE_COST, MEASURED, STATIC_FALL_BOXES
from petmjx.engines.engine_choice import choose
from petmjx.engines.expected_work import (
    DRIVEN_SWAY,
    FALL_BOXES,
    FALL_STEPS,
    FALLING_SWAY_MM,
    GIVING_STEPS,
    LOST,
    MOST_SWAY_STEPS,
    SOFT_STARTS,
    STATIC_FALL_STEPS,
    STEP_SHARE,
    SWAY_MM,
    SWAY_STEPS,
    Work,
)
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Check, Simulation
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.plans.plan_workload import MOST_LOOKED_AT, loose_and_ties, mean_sink_mm, statics_of, tipping_g
from petmjx.results.recording import Recording
from petmjx.results.resume import CompletedWorlds
from petmjx.runs.ready_sweeps import find_sweep
from petmjx.runs.study import Nominal
from petmjx.runs.sweep_cost import work_of
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.edge_distances import EdgeRisk
from petmjx.world.supports import deck_mm

SIM = Simulation()
CPU = MEASURED.mujoco


def boxes(*places: tuple[float, float, float], size: tuple[float, float, float] = (400.0, 300.0, 200.0)) -> Plan:
    made: list[Box] = [(size, place, 6.0) for place in places]
    return make_plan(boxes=made)


@pytest.mark.parametrize(
    ("plan", "box"),
    [
        (boxes((0, 0, 0), (0, 0, 200)), 2),
        (boxes((0, 0, 0), (190, 0, 200)), 2),
        (boxes((0, 0, 0), (210, 0, 200)), 1),
        (boxes((0, 0, 0), (0, 160, 200), (0, 160, 400)), 1),
        (boxes((0, 0, 0), (600, 0, 0), (300, 0, 200)), 3),  # a bridge
        (boxes((0, 0, 0), (300, 0, 200), (600, 0, 0)), 1),  # a bridge whose second support is placed too late
        (boxes((0, 0, 0), (210, 0, 230)), 1),  # a box that floats above a box
        (boxes((0, 0, 0), (0, 0, 700)), 2),
        (boxes((0, 0, 50)), 1),
    ],
)
def test_the_first_box_that_tips_over(plan: Plan, box: int) -> None:
    assert loose_and_ties(plan)[0] == box


def test_a_lower_neighbour_bears_nothing() -> None:
    """A box on a taller and above a lower box tips towards the lower box, which does not carry it."""
    sizes = ((300.0, 300.0, 200.0), (300.0, 300.0, 150.0), (500.0, 300.0, 100.0))
    for x, box in ((100.0, 2), (0.0, 3)):
        plan = make_plan(boxes=[(sizes[0], (0, 0, 0), 5), (sizes[1], (300, 0, 0), 5), (sizes[2], (x, 0, 200), 5)])
        assert loose_and_ties(plan)[0] == box


def test_where_the_mass_is() -> None:
    plan = boxes((0, 0, 0), (150, 0, 200))
    shifted = Plan.from_boxes(
        "p",
        size_mm=plan.size_mm,
        corner_mm=plan.corner_mm,
        mass_kg=plan.mass_kg,
        com_length_mm=[0, 100],
        com_width_mm=[0, 0],
        com_height_mm=[0, 0],
    )
    assert (loose_and_ties(plan)[0], loose_and_ties(shifted)[0]) == (2, 1)


def test_ties_are_supports_beyond_the_first() -> None:
    column = boxes((0, 0, 0), (0, 0, 200), (0, 0, 400))
    bridge = boxes((0, 0, 0), (410, 0, 0), (205, 0, 200), (0, 310, 0))
    brick = boxes((0, 0, 0), (410, 0, 0), (0, 310, 0), (410, 310, 0), (205, 155, 200))
    assert statics_of([column, bridge, brick]).ties.tolist() == pytest.approx([0, 1 / 4, 3 / 5])


def test_a_box_beside_the_boards_of_the_carrier_tips_over() -> None:
    """The deck has two boards, with a gap from y = 200 to 500 mm."""
    deck_mm = np.array([[[0.0, 0.0], [1000.0, 200.0]], [[0.0, 500.0], [1000.0, 700.0]]])
    plan = boxes((0, 0, 0), (500, 100, 0), (500, 100, 200), (0, 380, 0))
    assert loose_and_ties(plan)[0] == 4
    # the middles of the boxes are at y = 150, 250, 250 and 530
    assert loose_and_ties(plan, deck_mm)[0] == 1
    assert statics_of([plan], lambda _: deck_mm).placed_share.tolist() == [2 / 4]
    bridge = boxes((0, 0, 0), size=(400.0, 600.0, 200.0))
    assert loose_and_ties(bridge, deck_mm)[0] == 1, "both boards bear the box"
    assert loose_and_ties(boxes((0, 250, 0), size=(400.0, 200.0, 200.0)), deck_mm)[0] == 0, "the box is over the gap"


def test_where_boards_are_is_known_from_the_carrier() -> None:
    plan = boxes((0, 0, 0), (790, 0, 0))
    assert deck_mm(plan, SIM).tolist() == [[[0, 0], [1190, 300]]]
    boards = deck_mm(plan, Simulation(carrier="epal-1"))
    assert boards[:, 0, 1] == pytest.approx([0, 186.25, 327.5, 513.75, 655])
    beyond = boxes((0, 0, 0), (0, 600, 0), (410, 700, 0), (410, 0, 0))  # the middle of the third box is at y = 850 mm
    works = [Nominal(Simulation(carrier=name), [plan, beyond], RunOptions()).work for name in ("footprint", "epal-1")]
    assert [work.placed_share.tolist() for work in works] == [[1, 1], [1, 3 / 4]]


def test_a_pile_of_compliant_boxes_sways_worked_out_by_hand() -> None:
    """A column of two boxes of 6 kg. The lower box is compressed by 1.5 weights and the upper one by half a weight."""
    column = boxes((0, 0, 0), (0, 0, 200))
    soft = replace(column, stiffness_n_mm=np.array([50.0, 50.0]))
    weight_n = 6 * 9.81
    assert mean_sink_mm(soft) == pytest.approx((1.5 * weight_n / 50 + 2 * weight_n / 50) / 2)
    stiff_below = replace(column, stiffness_n_mm=np.array([np.nan, 50.0]))
    assert mean_sink_mm(stiff_below) == pytest.approx(0.5 * weight_n / 50 / 2)
    assert tipping_g(column) == pytest.approx(300 / 400)
    sway_mm = mean_sink_mm(soft) / tipping_g(soft)
    assert statics_of([column, soft]).sway_mm.tolist() == pytest.approx([0, sway_mm])
    steps = GIVING_STEPS + SWAY_STEPS * np.sqrt(sway_mm) * (1 + sway_mm / SWAY_MM)
    work = Work(SIM, [2, 2, 2], giving=[0, 2, 2], sway_mm=[0, sway_mm, 40.0])
    assert work.sway_steps.tolist() == pytest.approx([0, steps, MOST_SWAY_STEPS])
    assert (work.steps - work.steps[0]).tolist() == pytest.approx([0, 2 * steps, 2 * MOST_SWAY_STEPS])
    shaken = replace(work, drives=3, drive_steps=300.0)
    settled = replace(shaken, drives=1, drive_steps=0.0)
    assert (shaken.steps - settled.steps - 900).tolist() == pytest.approx(2 * DRIVEN_SWAY * work.sway_steps)
    # a pile that sways 27 times as far falls at a third of its height
    soft_pile = Work(SIM, [12], giving=[12], sway_mm=[27 * FALLING_SWAY_MM])
    assert soft_pile.share.tolist() == pytest.approx([1 / 3])
    assert Work(SIM.changed(early_stop=False), [12], giving=[12], sway_mm=[1e6]).share.tolist() == [1]
    fixed = replace(work, sim=Simulation(schedule="fixed"))
    assert fixed.sway_steps.tolist() == [0, 0, 0]


def test_compliant_boxes_are_counted() -> None:
    giving = make_plan(boxes=[((400.0, 300.0, 200.0), (0, 0, z), 6.0) for z in (0, 200)])
    soft = Plan.from_boxes(
        "soft",
        size_mm=giving.size_mm,
        corner_mm=giving.corner_mm,
        mass_kg=giving.mass_kg,
        stiffness_n_mm=[50.0, None],
    )
    assert statics_of([giving, soft]).giving.tolist() == [0, 1]
    work = Work(SIM, [2, 2], giving=[0, 1])
    assert work.compliant.tolist() == [0, 1]
    assert Work(Simulation(physics="reference"), [2, 2], giving=[0, 1]).compliant.tolist() == [0, 0]
    rigid_s, soft_s = CPU.placing_s(work)
    assert soft_s > rigid_s


def test_of_many_plans_some_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    def look(plan: Plan, deck_mm: None) -> tuple[int, int]:
        seen.append(plan.plan_id)
        return 0, 1

    monkeypatch.setattr("petmjx.plans.plan_workload.loose_and_ties", look)
    plans = [boxes((0, 0, 0), (0, 0, 200))] * (3 * MOST_LOOKED_AT)
    statics = statics_of(plans)
    assert statics.placed_share.tolist() == statics.ties.tolist() == [0.5] * len(plans)
    assert len(seen) == MOST_LOOKED_AT
    assert [values.tolist() for values in statics_of([])] == [[], [], [], []]


def test_a_fall_worked_out_by_hand() -> None:
    """The estimate for twenty boxes of which the tenth tips over, computed by hand: the placement of ten boxes, and the
    fall, during which seven more boxes are placed."""
    work = Work(SIM, [20], placed_share=[0.5], ties=[1.0])
    placing = 0.5 * STEP_SHARE * work.fixed_steps[0]
    assert work.steps.tolist() == pytest.approx([SOFT_STARTS + placing + FALL_STEPS])
    placed, fallen = 10, 10 + FALL_BOXES
    at_rest_s = (CPU.rest_s * placed**1.25 / 2.25 + CPU.overhead_s) * (SOFT_STARTS + placing)
    falling_s = CPU.rest_s * fallen**1.25 + CPU.overhead_s
    expected_s = at_rest_s + CPU.landing_s * placed**3 / 3 + FALL_STEPS * falling_s + CPU.fall_s
    assert MEASURED.seconds(work, 1)["mujoco"] == pytest.approx(expected_s)
    # with errors a world ends when a box is lost
    errors = Work(SIM, [20], placements=2, displaced=1, placed_share=[0.5], ties=[1.0])
    assert errors.steps[0] - 2 * SOFT_STARTS == pytest.approx((1 + 1.1) * placing + (1 + LOST) * FALL_STEPS)
    # the estimate is that of a plan that stands if the plan stands, if this is unknown, or without early stop
    for other in (
        Work(SIM, [20], placed_share=[1.0]),
        Work(SIM, [20]),
        Work(SIM.changed(early_stop=False), [20], placed_share=[0.5]),
    ):
        assert MEASURED.seconds(other, 1)["mujoco"] == MEASURED.seconds(Work(SIM, [20]), 1)["mujoco"]
    # in a static check, all boxes are in place, and fall from the beginning
    static = Simulation(check=Check.STATIC)
    falls, stands = Work(static, [20], placed_share=[0.5]), Work(static, [20])
    assert (falls.steps - stands.steps).tolist() == [STATIC_FALL_STEPS]
    step_s = CPU.rest_s * 20**1.25 + CPU.overhead_s
    more_s = MEASURED.seconds(falls, 1)["mujoco"] - MEASURED.seconds(stands, 1)["mujoco"]
    assert more_s == pytest.approx(STATIC_FALL_STEPS * step_s + 20 / STATIC_FALL_BOXES * CPU.fall_s)
    # a plan that falls is not shaken
    shaken = Work(SIM, [20, 20], drives=8, drive_steps=500, placed_share=[0.5, 1.0])
    assert shaken.shaken.tolist() == [0, 8]


def test_auto_takes_the_faster_engine_for_plans_that_fall() -> None:
    """``auto`` chooses the faster engine for 200 plans of shelves that fall. C MuJoCo takes many times as long for them
    as for 200 plans that stand."""
    plans = [shelf_plan(number % 20) for number in range(200)]
    work = Nominal(SIM, plans, RunOptions()).work
    assert (work.share < 1).mean() > 0.9
    seconds, if_they_stood = (MEASURED.seconds(task, 2) for task in (work, Work(SIM, work.boxes)))
    assert seconds["mujoco"] > 4 * if_they_stood["mujoco"]

    def chosen(expected: dict[str, float]) -> str:
        return choose(expected, 2, why_no_gpu=lambda: "no GPU", why_no_kernel=lambda: None)[0]

    assert (chosen(if_they_stood), chosen(seconds)) == ("mujoco", "mjx-warp-cpu")


def test_good_packers_are_not_taken_for_bad_ones() -> None:
    plans = []
    for index in range(20):
        plan_id, placements = generate_one(index, 21, packer="balanced")
        plans.append(parse_plan(plan_id, placements, DecoderOptions("test")))
    np.testing.assert_array_equal(statics_of(plans).placed_share, 1.0)


def test_progress_of_a_score_follows_the_expected_time() -> None:
    """The longest worlds come first, so one of three plans is most of the work."""
    tower = boxes(*((0, 0, 200.0 * k) for k in range(6)))
    plans = [replace(plan, plan_id=name) for name, plan in (("a", cut(tower, 1)), ("b", tower), ("c", cut(tower, 1)))]
    study, progress = Nominal(SIM, plans, RunOptions()), Progress()
    worlds = study.worlds(MujocoEngine(1), CompletedWorlds(), Recording(), progress)
    shares = {world.plan.plan_id: progress.work_share for world in worlds}
    once_s, tower_s = MEASURED.kernel.placing_s(study.work)[:2]
    assert [*shares] == ["b", "a", "c"]
    total_s = tower_s + 2 * once_s
    assert [*shares.values()] == pytest.approx([tower_s / total_s, 1 - once_s / total_s, 1.0])
    study.edge_risks = {"c": EdgeRisk.NEAR, "a": EdgeRisk.BEYOND}
    again = study.worlds(MujocoEngine(1), CompletedWorlds(), Recording(), progress)
    assert [world.plan.plan_id for world in again] == ["c", "a", "b"], "worlds whose collapse may take long come first"


def test_film_makes_steps_of_a_drive_dearer() -> None:
    """With film, steps of a drive (shaking) take longer. On C MuJoCo, Python computes the forces of film for each box
    and step."""
    plans = [boxes((0, 0, 0), (0, 0, 200))]
    bare, filmed = (
        work_of(SweepPlan(load_sweep(find_sweep(name), plans_given=True), plans))
        for name in ("eumos-search", "wrap-search")
    )
    assert (bare.filmed, filmed.filmed) == (0.0, 1.0)
    box_steps = 2 * float((filmed.shaken * filmed.drive_steps).sum())
    unfilmed = replace(filmed, filmed=0.0)
    for name, costs in (("mujoco", CPU), ("mjx-warp-cpu", MEASURED.kernel)):
        more_s = MEASURED.seconds(filmed, 1)[name] - MEASURED.seconds(unfilmed, 1)[name]
        # half of the levels of a search are gentle
        assert more_s == pytest.approx(box_steps * costs.film_s * (1 + GENTLE_COST) / 2)
