"""Light boxes under heavy boxes: simulated contacts are compressed much more than real cartons, and this must not
decide a verdict."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.outcomes import make_outcome
from support.plans import Box, make_plan, make_scene, make_world, stack

from petmjx.engines.contact_penetration import (
    contact_penetration_m,
    has_penetrated,
    note_penetration,
    penetration_excluded,
    stiffened_physics,
)
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.engines.world_results import World, WorldResult
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

MM = 1e-3
EXACT = Simulation(thresholds={"shift_floor_m": 0.0}, early_stop=False)
"""Options with which no component of a shift is set to 0."""


def one_on_another(light_kg: float, heavy_kg: float) -> tuple[Box, ...]:
    return stack(2, size_mm=(400, 300, 200), kg=(light_kg, heavy_kg))


def column(light_kg: float, heavy_kg: float, n: int) -> tuple[Box, ...]:
    return stack(n + 1, size_mm=(400, 300, 200), kg=[light_kg] + [heavy_kg] * n)


def simulate(boxes: Sequence[Box], sim: Simulation) -> Outcome:
    (outcome,) = MujocoEngine(1).run([Job(make_scene(boxes, sim))], sim)
    return outcome


def score(boxes: Sequence[Box], sim: Simulation) -> WorldResult:
    (result,) = score_worlds([make_world(make_plan(boxes=boxes), sim)], sim, MujocoEngine(1))
    return result


@pytest.mark.parametrize("boxes", [one_on_another(0.02, 300.0), column(0.01, 20.0, 8), column(0.005, 60.0, 3)])
def test_a_light_box_bears_a_heavy_load(boxes: Sequence[Box]) -> None:
    assert simulate(boxes, Simulation()).verdict is Verdict.UNSTABLE  # with soft contacts
    result = score(boxes, Simulation())
    assert [(a.attempt, a.verdict, a.reason) for a in result.attempts] == [
        (1, "invalid", "sinking"),
        (6, "stable", ""),
    ]
    assert result.attempts[0].flags & Flag.SINKING
    assert not result.outcome.flags & Flag.SINKING
    below_mm = -result.outcome.boxes.shift_m[:, 2] / MM
    assert below_mm.max() < 4.0  # it was 47 to 110 mm with soft contacts
    load_n = 9.81 * (sum(kg for *_, kg in boxes) - boxes[0][2])
    assert result.outcome.boxes.rest_top_force_n[0] == pytest.approx(load_n, rel=0.01)


def test_a_support_that_gives_way_does_not_tilt_what_it_bears() -> None:
    """One support of a beam is light and the other heavy. With soft contacts, the beam would tilt by 2.7° and slide."""
    boxes: tuple[Box, ...] = (
        ((200, 300, 200), (0, 0, 0), 0.01),
        ((200, 300, 200), (400, 0, 0), 10.0),
        ((600, 300, 400), (0, 0, 200), 200.0),
    )
    assert simulate(boxes, Simulation()).boxes.max_tilt_deg[2] > 2.5
    result = score(boxes, Simulation())
    assert result.outcome.verdict is Verdict.STABLE
    assert result.outcome.boxes.max_tilt_deg.max() < 0.1


def test_a_box_that_tips_is_unstable_in_stiff_contacts_too() -> None:
    boxes = (*one_on_another(0.02, 300.0), ((400, 300, 200), (220, 0, 400), 5.0))
    result = score(boxes, Simulation())
    assert [a.attempt for a in result.attempts] == [1, 6]
    assert (result.outcome.verdict, result.outcome.culprit) == (Verdict.UNSTABLE, 2)


@pytest.mark.parametrize(("has_errors", "attempts"), [(True, [1]), (False, [1, 6])])
def test_with_errors_a_box_leans_on_what_is_beside_a_higher_strip(has_errors: bool, attempts: list[int]) -> None:
    """A light box with a load stands on a strip that is 3 mm wide and 3 mm higher than the boxes on both sides. On the
    strip alone, the light box would tilt by several degrees, because the contacts at the strip's edges are compressed.
    Another box falls however stiff the contacts are."""
    boxes: tuple[Box, ...] = (
        ((190, 300, 200), (0, 0, 0), 5.0),
        ((3, 300, 203), (199, 0, 0), 5.0),
        ((190, 300, 200), (210, 0, 0), 5.0),
        ((400, 300, 200), (0, 0, 203), 0.5),
        ((400, 300, 200), (0, 0, 403), 60.0),
        ((400, 300, 200), (600, 0, 0), 5.0),
        ((400, 300, 200), (820, 0, 200), 5.0),
    )
    job = Job(make_scene(boxes), has_errors=has_errors)
    (result,) = score_worlds([World(make_plan(boxes=boxes), 1, job)], Simulation(), MujocoEngine(1))
    assert (result.outcome.verdict, result.outcome.culprit) == (Verdict.UNSTABLE, 6)
    assert [attempt.attempt for attempt in result.attempts] == attempts


def test_what_tips_over_in_any_contacts_is_not_simulated_again() -> None:
    """A box is supported only by a strip of 2 mm, and its centre is far beyond the strip."""
    boxes: tuple[Box, ...] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 600), (398, 0, 200), 20.0))
    result = score(boxes, Simulation())
    assert result.outcome.verdict is Verdict.UNSTABLE
    assert [attempt.attempt for attempt in result.attempts] == [1]


def test_boxes_beside_a_pile_change_nothing_about_it() -> None:
    """A leaning pile of slender boxes stands by statics: a load acts 0.45 mm inside the edge of the lowest box. In the
    contacts of attempts 1 and 6, the pile falls. Attempt 7 is made for the pile alone, and also if nine cartons stand
    on the same pallet."""
    masses_kg = (0.131, 0.044, 0.419, 0.033, 1.857)
    pile: list[Box] = [((17, 17, 132), (300 + 2.23855 * k, 0, 132 * k), kg) for k, kg in enumerate(masses_kg)]
    cartons: list[Box] = [((50, 50, 30), (60 * (k % 3), 60 * (k // 3), 0), 0.2) for k in range(9)]
    for boxes in (pile, cartons + pile):
        result = score(boxes, Simulation())
        assert [(a.attempt, a.verdict) for a in result.attempts] == [(1, "unstable"), (6, "unstable"), (7, "stable")]
        assert not result.outcome.flags & Flag.SINKING


def test_contacts_that_still_give_way_leave_no_verdict() -> None:
    """A box of a hundredth of a gram carries half a ton. The ratio of the masses is fifty million."""
    result = score(one_on_another(0.00001, 500.0), Simulation())
    assert [a.attempt for a in result.attempts] == [1, 6, 7]
    assert (result.outcome.verdict, result.outcome.reason) == (Verdict.INVALID, Reason.SINKING)


@pytest.mark.parametrize("boxes", [stack(8), column(4.0, 20.0, 5), one_on_another(1.0, 100.0)])
def test_usual_plans_run_once(boxes: Sequence[Box]) -> None:
    assert [a.attempt for a in score(boxes, Simulation()).attempts] == [1]


def test_the_reference_keeps_its_verdict_and_says_so() -> None:
    sim = Simulation(physics="reference")
    result = score(one_on_another(1.0, 100.0), sim)
    assert [a.attempt for a in result.attempts] == [1]
    assert (result.outcome.verdict, result.outcome.reason) == (Verdict.UNSTABLE, Reason.SHIFT)
    assert result.outcome.flags & Flag.SINKING
    assert not score(stack(3), sim).outcome.flags & Flag.SINKING


@pytest.mark.parametrize("stiff", [None, 0.5])
@pytest.mark.parametrize("boxes", [one_on_another(1.0, 100.0), one_on_another(0.5, 250.0), column(0.2, 20.0, 6)])
def test_the_estimate_is_what_boxes_sink_by(boxes: Sequence[Box], stiff: float | None) -> None:
    """In a column, all loads pass through every box, so the estimate is exact except for rounding and the gaps of 0.1
    mm."""
    physics = EXACT.physics if stiff is None else stiffened_physics(EXACT.physics, stiff)
    sim = EXACT.changed(physics=physics, size_reduction_mm=0.0)
    scene, outcome = make_scene(boxes, sim), simulate(boxes, sim)
    estimate = contact_penetration_m(scene, physics, outcome.boxes.rest_top_force_n)
    np.testing.assert_allclose(-outcome.boxes.shift_m[:, 2], estimate, rtol=0.05, atol=0.05 * MM)


def test_the_estimate_of_the_reference() -> None:
    """With a coefficient of friction of 3, a contact with a pyramidal friction cone is 45 times as soft as one with an
    elliptic cone."""
    sim = EXACT.changed(physics=PHYSICS["reference"], size_reduction_mm=0.0)
    boxes = one_on_another(1.0, 100.0)
    outcome = simulate(boxes, sim)
    estimate = contact_penetration_m(make_scene(boxes, sim), sim.physics, outcome.boxes.rest_top_force_n)
    assert -outcome.boxes.shift_m[1, 2] == pytest.approx(47.7 * MM, rel=0.02)
    assert estimate[1] == pytest.approx(47.7 * MM, rel=0.05)


def test_a_shift_that_is_sinking_alone_is_no_verdict() -> None:
    """A box falls 18.5 mm onto a light box and sinks by 3 mm, so its shift is 21.5 mm."""
    boxes: tuple[Box, ...] = (((400, 300, 200), (0, 0, 0), 0.15), ((400, 300, 200), (0, 0, 218.5), 140.0))
    soft = simulate(boxes, Simulation())
    assert (soft.verdict, soft.reason) == (Verdict.UNSTABLE, Reason.SHIFT)
    assert score(boxes, Simulation()).outcome.verdict is Verdict.STABLE
    fallen: tuple[Box, ...] = (boxes[0], ((400, 300, 200), (0, 0, 225), 140.0))
    result = score(fallen, Simulation())
    assert (result.outcome.verdict, result.outcome.reason) == (Verdict.UNSTABLE, Reason.SHIFT)


@pytest.mark.parametrize("shift_mm", [(0.0, -21.5), (25.0, -21.5), (0.0, 21.5), (0.0, -30.0)])
def test_only_a_shift_straight_down_may_be_sinking(shift_mm: tuple[float, float]) -> None:
    """The upper box has moved down, moved up, or also slid. The support of the upper box is compressed by 3 mm."""
    boxes: tuple[Box, ...] = (((400, 300, 200), (0, 0, 0), 0.15), ((400, 300, 200), (0, 0, 200), 140.0))
    scene, outcome = make_scene(boxes), simulate(boxes, Simulation())
    shift = np.zeros((2, 3))
    shift[1, [0, 2]] = np.array(shift_mm) * MM
    moved_boxes = replace(outcome.boxes, shift_m=shift)
    shifted = replace(outcome, verdict=Verdict.UNSTABLE, reason=Reason.SHIFT, boxes=moved_boxes)
    (noted,) = note_penetration([shifted], [Job(scene)], Simulation())
    assert (noted.reason is Reason.SINKING) == (shift_mm == (0.0, -21.5))


def test_an_impact_is_no_sinking() -> None:
    """In one sample, the upper box has just landed, so the force on the lower box is a hundred times the weight on
    it."""
    boxes = one_on_another(1.0, 20.0)
    scene, outcome = make_scene(boxes), simulate(boxes, Simulation())
    force = outcome.boxes.max_top_force_n
    assert force[0] == pytest.approx(20.0 * 9.81, rel=0.1)
    hit = replace(outcome, boxes=replace(outcome.boxes, max_top_force_n=100 * force))
    assert note_penetration([hit], [Job(scene)], Simulation())[0] is hit
    np.testing.assert_allclose(
        contact_penetration_m(scene, PHYSICS["pallet"], 100 * force),
        contact_penetration_m(scene, PHYSICS["pallet"], force),
        rtol=0.1,
    )


def test_the_look_at_many_worlds_together_misses_none() -> None:
    """Random piles, of which some sink, some slid, and some are incomplete. If the quick check of all worlds excludes
    sinking for a world, the exact check of this world must agree. The quick check must exclude many worlds."""
    rng = np.random.default_rng(2)
    sim, outcomes, scenes = Simulation(), [], []
    for _ in range(300):
        n = int(rng.integers(1, 12))
        scene = make_scene(stack(n, kg=(10 ** rng.uniform(-2.5, 2.5, n)).tolist()), sim)
        top_n = rng.uniform(0, 10 ** rng.uniform(1, 4), n)
        shift = rng.uniform(-0.03, 0.03, (n, 3))
        reason = Reason.SHIFT if rng.random() < 0.5 else Reason.NONE
        placed = int(rng.integers(1, n + 1))
        fields = {"max_top_force_n": top_n, "shift_m": shift, "n_placed": placed}
        outcomes.append(make_outcome(n, Verdict.UNSTABLE if reason else Verdict.STABLE, reason, **fields))
        scenes.append(scene)
    did_not = penetration_excluded(outcomes, scenes, sim)
    sinks = [has_penetrated(outcome, scene, sim) for outcome, scene in zip(outcomes, scenes, strict=True)]
    assert not any(no and yes for no, yes in zip(did_not, sinks, strict=True))
    assert sum(did_not) > 50
    assert sum(sinks) > 50


def test_looking_for_it_costs_next_to_nothing() -> None:
    """For a plan of 60 boxes that do not sink, the check takes at most a fiftieth of the time of the simulation on the
    same machine."""
    boxes = [((200, 200, 200), (200 * (k % 4), 200 * (k // 4 % 4), 200 * (k // 16)), 5.0) for k in range(60)]
    scene = build_scene(make_plan(boxes=boxes), Simulation())
    begin = time.process_time()
    outcome = simulate(boxes, Simulation())
    simulated = time.process_time() - begin
    shaken = replace(
        outcome,
        verdict=Verdict.UNSTABLE,
        reason=Reason.SHIFT,
        boxes=replace(
            outcome.boxes,
            shift_m=outcome.boxes.shift_m + np.array([0.05, 0.0, 0.0]),
            max_top_force_n=10 * outcome.boxes.max_top_force_n,
        ),
    )
    for world_outcome in (outcome, shaken):
        begin = time.process_time()
        for _ in range(100):
            assert outcome_checks([world_outcome], [Job(scene)], Simulation())[0] is world_outcome
        assert (time.process_time() - begin) / 100 < simulated / 50
