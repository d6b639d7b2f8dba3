"""Tests of the flags for doubtful verdicts: worlds in which a load acts at the edge of its supports, and worlds whose
verdict depends on the timestep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from support.outcomes import make_outcome
from support.plans import Box, make_plan, make_scene, stack
from test_attempt_with_fallback import Scripted, never, scored
from test_supports import random_heap

import petmjx
from petmjx.analysis.story_in_words import headline, notes_in_words
from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.knife_edges import AT_REST, BY_PLAN, WHILE_BUILT, KnifeEdge, nearest_edge, sets_flag
from petmjx.engines.outcome_checks import edges_again, note_edges, outcome_checks
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.show.run_tables import worlds_table
from petmjx.world import edge_distances
from petmjx.world.building_edges import building_edges
from petmjx.world.edge_distances import EdgeRisk, edge_risks
from petmjx.world.job import Job
from petmjx.world.supports import bearings_of

MM = 1e-3


@pytest.mark.parametrize(("overhang_mm", "flagged"), [(199.4, False), (199.6, True), (200.0, True), (200.6, False)])
def test_a_load_within_half_a_millimetre_of_an_edge_is_on_a_knife_s_edge(overhang_mm: float, flagged: bool) -> None:
    """A box of 400 mm overhangs another box of 400 mm. The flag ``knife-edge`` is set if the load is within half a
    millimetre of the edge."""
    boxes: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (overhang_mm, 0, 200), 5.0))
    worlds = petmjx.score(make_plan("edge", boxes), engine="mujoco", size_reduction_mm=0.0).worlds
    assert worlds.plan_edge_m[0] == pytest.approx((200 - overhang_mm) * MM, abs=1e-9)
    assert bool(worlds["flags"][0] & Flag.KNIFE_EDGE) is flagged
    if worlds.verdict[0] == "stable":
        assert worlds.rest_edge_m[0] == pytest.approx(worlds.plan_edge_m[0], abs=2e-4)
    else:
        assert worlds.isna().rest_edge_m[0]


def test_a_quick_test_finds_loads_beyond_and_near_edges_while_a_plan_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    """A box of 400 mm overhangs another one, so its own weight acts 0.6 or 0.4 mm inside the edge, or 0.6 mm beyond it.
    A third box on its inner end moves the load inward."""
    base: Box = ((400, 300, 200), (0, 0, 0), 5.0)
    scenes = [
        make_scene(
            [base, ((400, 300, 200), (over, 0, 200), 5.0), ((100, 300, 200), (over, 0, 400), 5.0)],
            Simulation(size_reduction_mm=0.0),
        )
        for over in (199.4, 199.6, 200.6)
    ]
    risks = [EdgeRisk.INSIDE, EdgeRisk.NEAR, EdgeRisk.BEYOND]
    assert edge_risks(scenes).tolist() == risks
    assert edge_risks(scenes[1:2]).tolist() == risks[1:2]
    assert edge_risks([]).tolist() == []
    monkeypatch.setattr(edge_distances, "EXAMINED_AT_ONCE", 1)
    assert edge_risks(scenes).tolist() == risks
    monkeypatch.setattr(edge_distances, "MOST_EXAMINED_BOXES", 2)
    assert edge_risks(scenes).tolist() == [EdgeRisk.NEAR] * 3, "as if a load acted near an edge"


def test_the_quick_test_finds_all_scenes_that_the_slow_one_finds() -> None:
    rng = np.random.default_rng(33329)
    heaps = [make_scene(random_heap(rng, 12)) for _ in range(40)]
    beyond = edge_risks(heaps) > EdgeRisk.INSIDE
    least = [edge.edge_m for edge in building_edges(bearings_of(heaps), [12] * 40)]
    assert beyond[np.array(least) < 0].all(), "it may find more, since it looks for no other shares"
    assert 0 < beyond.sum() < 40


def test_what_a_box_bears_counts_and_so_does_its_own_weight_alone() -> None:
    """A plank would fall when it is placed. According to the complete plan, a weight on its inner end holds it, but the
    weight is placed too late. Distances are computed for the whole load of a box, and for its own weight alone."""
    plank: Box = ((1000, 300, 100), (0, 0, 300), 5.0)
    weight: Box = ((200, 300, 200), (0, 0, 400), 50.0)
    scene = make_scene([((400, 300, 300), (0, 0, 0), 5.0), plank, weight], Simulation(size_reduction_mm=0.0))
    outcome = replace(make_outcome(3, Verdict.UNSTABLE, Reason.DROP), n_placed=3)
    first = replace(outcome, n_placed=1)
    note_edges([outcome, first], [Job(scene), Job(scene)], Simulation())
    # with the weight, the plank's load acts at 136 mm, without it at 500 mm; the weight's own load is 100 mm inside
    assert outcome.boxes.plan_edge_m[1] == pytest.approx((5 * 0.5 + 50 * 0.1) / 55)
    assert (outcome.plan_edge_m, outcome.plan_edge_box) == (pytest.approx(0.1), 2)
    assert (outcome.build_edge_m, outcome.build_edge_box, outcome.build_edge_step) == (pytest.approx(-0.1), 1, 1)
    assert first.plan_edge_m == pytest.approx(0.15)  # half of the width of the only box
    assert np.isnan(first.boxes.plan_edge_m[1:]).all()
    at_once = replace(outcome, build_edge_m=np.nan, build_edge_box=-1)
    note_edges([at_once], [Job(scene)], Simulation(check="static"))
    assert np.isnan(at_once.build_edge_m)
    assert at_once.build_edge_box == -1


def near(margin: float, **changes: Any) -> Outcome:
    """The outcome of a world with one box and the given margin: its shift is the threshold × (1 − margin)."""
    return make_outcome(1, shift_m=np.array([[0.02 * (1 - margin), 0.0, 0.0]]), **changes)


@pytest.mark.parametrize(("margin", "checked"), [(0.6, False), (0.4, True)])
def test_worlds_near_a_threshold_are_checked_at_half_the_timestep(
    margin: float, checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Near(Scripted):
        def run(self, jobs: Any, sim: Any, progress: Any = None) -> Any:
            self.sims.append(sim)
            half = sim.physics.timestep_s < 0.002
            for index in range(len(jobs)):
                changed = half and index == 1
                falls = {"verdict": Verdict.UNSTABLE, "reason": Reason.SHIFT} if changed else {}
                yield near(-0.1 if changed else margin, job=index, **falls)

    engine = Near("mjx-warp", never)
    results, notes = scored(engine, Near("mujoco", never), monkeypatch, Simulation(check_timestep=True))
    assert {result.outcome.verdict for result in results} == {Verdict.STABLE}
    assert [a.attempt for a in results[0].attempts] == ([1, 8] if checked else [1])
    changed = [result.world.plan.plan_id for result in results if result.outcome.flags & Flag.TIMESTEP]
    assert changed == (["p1"] if checked else [])
    assert ("p1: the verdict is stable, but unstable at half the timestep" in notes) is checked
    assert [sim.physics.timestep_s for sim in engine.sims] == ([0.002, 0.001] if checked else [0.002])


def test_a_world_that_ended_on_its_way_down_is_near_nothing() -> None:
    (check,) = (recipe for recipe in ATTEMPTS if recipe.checks)
    falling = near(-0.1, verdict=Verdict.UNSTABLE, reason=Reason.TILT)
    sim = Simulation(check_timestep=True)
    assert check.is_for(falling, sim)
    assert not check.is_for(replace(falling, flags=Flag.EARLY_STOP), sim)


def test_nothing_is_checked_unless_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    c_engine = Scripted("mujoco", never)
    scored(Scripted("mjx-warp", never), c_engine, monkeypatch)
    assert c_engine.sims == []


def test_an_engine_computes_what_is_checked() -> None:
    floats: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (0, 0, 212), 5.0))
    results = petmjx.score(make_plan("floats", floats), engine="mujoco", check_timestep=True)
    assert 0 < results.worlds.margin[0] < 0.5
    assert results.attempts.attempt.tolist() == [1, 8]
    assert results.attempts.timestep_s.tolist() == [0.002, 0.001]


EDGE: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 10.0), ((400, 300, 200), (199.7, 0, 200), 5.0))
"""Two boxes. The upper box's centre is 0.3 mm inside the edge, or 0.25 mm after the reduction of sizes."""

PULL: Sequence[Box] = (
    ((400, 300, 300), (0, 600, 0), 10.0),
    ((200, 300, 200), (700, 600, 0), 5.0),
    ((200, 300, 100), (620, 600, 200), 0.5),
    ((820, 300, 50), (0, 600, 300), 1.0),
    ((300, 300, 300), (0, 600, 350), 20.0),
)
LATE: Sequence[Box] = (
    ((200, 300, 300), (0, 0, 0), 10.0),
    ((360, 300, 100), (0, 0, 300), 2.0),
    ((150, 300, 200), (210, 0, 400), 6.0),
    ((200, 300, 300), (0, 0, 400), 12.0),
)
"""A beam, a box on its far end, and then its counterweight."""
LID: Sequence[Box] = (
    ((100, 300, 200), (0, 0, 0), 5.0),
    ((200, 300, 170), (160, 0, 0), 8.0),
    ((250, 300, 100), (0, 0, 200), 2.0),
)
"""Three boxes. The last box is a lid that tips onto a neighbour, which is 30 mm lower."""


def test_any_box_within_reach_sets_the_flag() -> None:
    """A single load near an edge sets the flag, also if all other loads are farther inside. A load 3 mm from an edge
    does not set it."""
    far: Sequence[Box] = (((400, 300, 200), (0, 400, 0), 10.0), ((400, 300, 200), (197, 400, 200), 5.0))
    plans = [make_plan("alone", EDGE), make_plan("beside", (*EDGE, *PULL)), make_plan("far", (*far, *PULL))]
    results = petmjx.score(plans, engine="mujoco", check="static", duration_s=0.2)
    assert [bool(flags & Flag.KNIFE_EDGE) for flags in results.worlds["flags"]] == [True, True, False]
    assert results.worlds.plan_edge_box.tolist() == [1, 1, 1]
    np.testing.assert_allclose(results.worlds.plan_edge_m, [0.25e-3, 0.25e-3, 2.95e-3], atol=1e-9)
    of_boxes = results.boxes[results.boxes.plan_id == "beside"].plan_edge_m.to_numpy()
    np.testing.assert_allclose(of_boxes[[1, 4]] / MM, [0.25, 19.95], atol=1e-4)
    assert (of_boxes[[0, 2, 3, 5, 6]] > 50 * MM).all()


@pytest.mark.parametrize(
    ("inside_mm", "again"), [(0.1, True), (0.39, True), (0.7, True), (0.99, True), (3.0, False), (-0.7, False)]
)
def test_an_unstable_load_within_a_millimetre_is_tried_in_stiffer_contacts(inside_mm: float, again: bool) -> None:
    """If a load within a millimetre of an edge falls, the world is simulated again with stiffer contacts, in whichever
    level of a tower the load is."""
    sim = Simulation(size_reduction_mm=0.0)
    upper: Box = ((400, 300, 200), (200 - inside_mm, 0, 200), 5.0)
    tower = (((400, 300, 200), (0, 0, 0), 5.0), upper, ((400, 300, 200), (200 - inside_mm, 0, 400), 5.0))
    scene = make_scene(tower, sim)
    for culprit in (1, 2):
        tilt = {"max_tilt_deg": np.array([0.0, 90.0, 90.0]), "max_top_force_n": np.zeros(3)}
        fell = make_outcome(3, Verdict.UNSTABLE, Reason.TILT, culprit=culprit, **tilt)
        (noted,) = outcome_checks([fell], [Job(scene)], sim)
        assert bool(noted.flags & Flag.SINKING) is again
        assert noted.verdict is Verdict.UNSTABLE


@pytest.mark.parametrize("lower_mm", [0.2, 1.0, 3.0, 8.0])
@pytest.mark.parametrize("scale", [0.1, 1.0])
def test_what_stands_has_its_loads_inside_edges_at_rest(lower_mm: float, scale: float) -> None:
    """A beam on two supports of unequal height leans on both. By the plan, only the higher support bears it, but at
    rest its load acts between the two supports."""
    lower_mm, kg = scale * lower_mm, scale**3
    beam: Box = ((500 * scale, 200 * scale, 50 * scale), (0, 0, 100 * scale), 8.0 * kg)
    supports: list[Box] = [
        ((150 * scale, 200 * scale, 100 * scale), (0, 0, 0), 5.0 * kg),
        ((150 * scale, 200 * scale, 100 * scale - lower_mm), (350 * scale, 0, 0), 5.0 * kg),
    ]
    worlds = petmjx.score(make_plan("beam", [*supports, beam]), engine="mujoco").worlds
    assert worlds.verdict[0] == "stable"
    assert (worlds.plan_edge_m[0] < 0) == (lower_mm > 0.5)
    assert worlds.rest_edge_m[0] > 0.03 * scale


def test_a_verdict_against_a_load_within_a_millimetre_has_the_flag() -> None:
    """The flag is set if a box stands although its load is 0.8 mm beyond the edge, or falls although it is 0.8 mm
    inside. In the opposite cases, the flag is not set."""
    for inside_mm, falls in ((0.8, True), (-0.8, False), (0.8, False), (-0.8, True)):
        scene = make_scene(
            (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (200 - inside_mm, 0, 200), 5.0)),
            Simulation(size_reduction_mm=0.0),
        )
        verdict = (Verdict.UNSTABLE, Reason.TILT) if falls else (Verdict.STABLE, Reason.NONE)
        tilt_deg = np.full(2, 90.0 * falls)
        # at the end, boxes do not touch
        outcome = make_outcome(2, *verdict, max_tilt_deg=tilt_deg, pos=np.full((2, 3), 10.0))
        note_edges([outcome], [Job(scene)], Simulation())
        assert bool(outcome.flags & Flag.KNIFE_EDGE) is (falls == (inside_mm > 0))


def test_a_counterweight_that_comes_too_late_is_named() -> None:
    plans = [make_plan("late", LATE), make_plan("first", (*LATE[:2], LATE[3], LATE[2]))]
    worlds = petmjx.score(plans, engine="mujoco").worlds
    assert worlds.verdict.tolist() == ["unstable", "stable"]
    assert (worlds.build_edge_box[0], worlds.build_edge_step[0]) == (1, 2)
    # masses of 2 kg at 179.95 mm and of 6 kg at 284.95 mm, on a base that ends at 199.9 mm
    assert worlds.build_edge_m[0] == pytest.approx((199.9 - (2 * 179.95 + 6 * 284.95) / 8) * MM, abs=1e-9)
    assert worlds.build_edge_m[1] == pytest.approx(19.95 * MM, abs=1e-9)
    (note,) = notes_in_words(petmjx.tell("late", plans, engine="mujoco"))
    assert (
        "box 1 hangs too far over the edge of its support from step 2 on; its counterweight, box 3, comes too late"
        in note
    )
    assert notes_in_words(petmjx.tell("first", plans, engine="mujoco")) == []
    at_once = petmjx.score(plans, engine="mujoco", check="static", duration_s=0.1).worlds
    assert at_once.build_edge_m.isna().all()
    assert at_once.build_edge_box.isna().all()


def test_a_world_that_stands_otherwise_than_planned_leans() -> None:
    """The flag ``leans`` is set for a lid that tips by 11°, and for a box that sinks by 12 mm. The flag is not set if
    lid and box are where they are planned."""
    flat = (LID[0], ((200, 300, 200), (160, 0, 0), 8.0), LID[2])
    floats: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (0, 0, 212), 5.0))
    near: Sequence[Box] = (((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (0, 0, 202), 5.0))
    plans = [make_plan(str(k), boxes) for k, boxes in enumerate((LID, floats, flat, near))]
    results = petmjx.score(plans, engine="mujoco")
    assert results.worlds.verdict.tolist() == ["stable"] * 4
    assert [bool(flags & Flag.LEANS) for flags in results.worlds["flags"]] == [True, True, False, False]
    assert results.info["counts"]["leans"] == 2
    story = petmjx.tell("0", plans, engine="mujoco")
    assert headline(story).startswith("stable, leans, margin")
    assert any("leans: box 2 (" in note and "tilted by 11." in note for note in notes_in_words(story))


def test_what_an_engine_needed_twice_is_not_in_results() -> None:
    """Results do not contain flag 32 (``RERUN_AFTER_OVERFLOW``), since it depends on the other worlds of the run."""
    scene = make_scene(EDGE, Simulation())
    outcome = make_outcome(2, flags=Flag.RERUN_AFTER_OVERFLOW | Flag.EARLY_STOP)
    (noted,) = outcome_checks([outcome], [Job(scene)], Simulation())
    assert noted.flags & ~Flag.KNIFE_EDGE == Flag.EARLY_STOP


def test_the_table_names_the_box_on_the_edge() -> None:
    """If a world has the flag ``knife-edge``, the table has a column with the distance from the edge, for all
    worlds."""
    plans = [make_plan("edge", (*EDGE, *PULL)), make_plan("flat", LID[:2])]
    results = petmjx.score(plans, engine="mujoco")
    console = Console(width=140, record=True, file=StringIO())
    console.print(worlds_table(results.worlds, results.boxes))
    header, *rows = [" ".join(line.split()) for line in console.export_text().splitlines() if line.strip()][1:]
    assert "mm box force N" in header
    assert [" ".join(row.split()[-3:-1]) for row in rows] == ["0.2 1", "49.9 0"]
    console.print(worlds_table(results.worlds[1:], results.boxes))
    assert "mm box" not in console.export_text()


BESIDE: Sequence[Box] = (
    ((400, 300, 200), (0, 0, 0), 10.0),
    ((400, 300, 200), (199.7, 0, 200), 5.0),
    ((400, 300, 200), (0, 600, 0), 10.0),
    ((400, 300, 200), (230, 600, 200), 5.0),
)
"""A tower with a load 0.25 mm inside an edge, and beside it a tower that overhangs by 30 mm."""
HELD: Sequence[Box] = (
    ((400, 300, 200), (0, 0, 0), 5.0),
    ((400, 300, 194), (400, 0, 0), 5.0),
    ((800, 300, 100), (0, 0, 200), 3.0),
    ((400, 300, 100), (400, 0, 300), 8.0),
)
"""Boxes with a lid on a single support. The lid's own weight, without its load, acts at the edge of this support."""


def test_the_box_that_sets_the_flag_is_named_and_not_the_one_that_is_furthest_beyond() -> None:
    results = petmjx.score([make_plan("two", BESIDE)], engine="mujoco")
    assert (results.worlds.build_edge_box[0], results.worlds.build_edge_m[0] < -0.03) == (3, True)
    console = Console(width=140, record=True, file=StringIO())
    console.print(worlds_table(results.worlds, results.boxes))
    row = console.export_text().strip().splitlines()[-1].split()
    assert row[-3:-1] == ["0.3", "1"]
    note = notes_in_words(petmjx.tell("two", results))[0]
    assert "within 0.25 mm of the edge of its support (by the plan)" in note
    assert "(the load of box 1 (" in note


def test_a_box_is_named_whose_own_weight_sets_the_flag() -> None:
    """If a box's own weight sets the flag, a note names the box. The tables do not contain the distance of the own
    weight, so it is computed again."""
    results = petmjx.score([make_plan("held", HELD)], engine="mujoco")
    assert results.worlds["flags"][0] & Flag.KNIFE_EDGE
    note = notes_in_words(petmjx.tell("held", results))[0]
    assert "within 0.05 mm of the edge of its support (by the plan)" in note
    assert "(the own weight of box 2 (" in note
    console = Console(width=140, record=True, file=StringIO())
    console.print(worlds_table(results.worlds, results.boxes))
    assert "mm box" in " ".join(console.export_text().split())


def test_the_nearest_load_while_a_plan_is_built_is_named() -> None:
    """A note names the load that is nearest to an edge while the plan is built: a beam's load is 0.25 mm inside, until
    the next box moves it inwards. A tower beside the beam overhangs."""
    scene = make_scene(
        (
            ((400, 300, 200), (0, 0, 0), 10.0),
            ((400, 300, 100), (199.7, 0, 200), 5.0),
            ((150, 300, 100), (199.7, 0, 300), 5.0),
            *BESIDE[2:],
        ),
        Simulation(),
    )
    fell = make_outcome(5, Verdict.UNSTABLE, Reason.DROP, culprit=4)
    note_edges([fell], [Job(scene)], Simulation())
    assert fell.flags & Flag.KNIFE_EDGE
    assert fell.build_edge_box == 4
    nearest = nearest_edge((edge for edge in edges_again(scene, fell) if edge.when == WHILE_BUILT), fell.verdict)
    assert nearest is not None
    assert (nearest.box, nearest.step) == (1, 1)
    assert nearest.edge_m == pytest.approx(0.25e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("verdict", "expected"),
    [
        (None, [True, True, False, False, False, False, False]),
        (Verdict.STABLE, [True, True, False, True, False, False, False]),
        (Verdict.UNSTABLE, [True, True, True, False, False, False, False]),
    ],
)
def test_a_load_sets_the_flag_near_an_edge_and_less_near_on_the_wrong_side(
    verdict: Verdict | None, expected: list[bool]
) -> None:
    edge_m = np.array([0.0005, -0.0005, 0.0008, -0.0008, 0.0012, -0.0012, np.nan])
    assert sets_flag(edge_m, verdict).tolist() == expected
    if verdict is not None:  # with a verdict, distances come from tables, which round them
        for k in range(2):
            rounded = KnifeEdge(float(edge_m[k]) * (1 + 1e-7), 3, BY_PLAN)
            assert nearest_edge([rounded], verdict) is rounded
        sides = [KnifeEdge(float(value), 3, AT_REST) for value in edge_m[2:]]
        assert nearest_edge(sides, verdict) is None, "at rest the side does not count"


def outcomes_of_heaps(sim: Simulation) -> tuple[list[Outcome], list[Job]]:
    """Made-up outcomes, and their jobs, of heaps and stacks that stand, that fell with all or some boxes, and with
    errors."""
    rng, jobs, outcomes = np.random.default_rng(12), list[Job](), list[Outcome]()
    for number in range(48):
        n = int(rng.integers(2, 14))
        slender = stack(n, size_mm=(60, 60, 400), kg=[0.2] + [5.0] * (n - 1))  # these lean because contacts are soft
        boxes, has_errors = slender if number % 5 == 0 else random_heap(rng, n), number % 3 == 2
        scene = make_scene(boxes, sim)
        if has_errors:
            scene = replace(scene, start_pos=scene.target + rng.normal(0, 2e-3, (n, 3)))
        fell = bool(number % 2)
        tilt_deg = np.where(np.arange(n) == n - 1, 90.0 * fell, 0.0)
        outcomes.append(
            make_outcome(
                n,
                *((Verdict.UNSTABLE, Reason.TILT) if fell else (Verdict.STABLE, Reason.NONE)),
                culprit=n - 1 if fell else -1,
                n_at_sign=int(rng.integers(1, n + 1)) if fell else 0,
                max_tilt_deg=tilt_deg,
                max_top_force_n=rng.uniform(0, 300, n),
                pos=scene.target + rng.normal(0, 1e-4, (n, 3)),
            )
        )
        jobs.append(Job(scene, has_errors=has_errors))
    return outcomes, jobs


def test_outcomes_that_are_checked_together_are_those_checked_alone() -> None:
    """Outcomes that are checked together get the same values, to the last bit, as if each were checked alone."""
    sim = Simulation()
    outcomes, jobs = outcomes_of_heaps(sim)
    alone = [outcome_checks([replace(outcome)], [job], sim)[0] for outcome, job in zip(outcomes, jobs, strict=True)]
    together = outcome_checks([replace(outcome) for outcome in outcomes], jobs, sim)
    for one, other in zip(together, alone, strict=True):
        assert _values(one) == _values(other)
    assert {Flag.NONE, Flag.SINKING} <= {outcome.flags & Flag.SINKING for outcome in together if outcome.culprit >= 0}
    assert sum(outcome.build_edge_m < 0 for outcome in together) > 5


def test_checks_for_verdicts_give_the_verdicts_of_all_checks() -> None:
    sim = Simulation()
    outcomes, jobs = outcomes_of_heaps(sim)
    whole, verdicts = (
        outcome_checks([replace(outcome) for outcome in outcomes], jobs, sim, verdicts_only=verdicts_only)
        for verdicts_only in (False, True)
    )
    for outcome, checked in zip(verdicts, whole, strict=True):
        assert (outcome.verdict, outcome.reason, outcome.margin) == (checked.verdict, checked.reason, checked.margin)
        assert outcome.flags & Flag.SINKING == checked.flags & Flag.SINKING
        if checked.verdict is Verdict.STABLE:
            assert np.isnan(outcome.plan_edge_m)
    assert {Verdict.STABLE, Verdict.UNSTABLE} == {outcome.verdict for outcome in verdicts}
    assert {Flag.NONE, Flag.SINKING} == {outcome.flags & Flag.SINKING for outcome in verdicts}


def _values(outcome: Outcome) -> dict[str, Any]:
    """All values of an outcome and its boxes, in a form in which NaN equals NaN."""
    values = vars(outcome) | vars(outcome.boxes)
    return {
        name: value.tobytes() if isinstance(value, np.ndarray) else repr(value)
        for name, value in values.items()
        if name != "boxes"
    }
