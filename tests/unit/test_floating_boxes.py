"""Boxes that float when they are placed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.outcomes import make_outcome
from support.plans import make_plan

import petmjx
from petmjx.analysis.story_in_words import first_box_in_words, headline
from petmjx.engines.floating_boxes import gaps_m, note_floating
from petmjx.engines.verdict import Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.repairs.drafts import Draft
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.requests import TrialRequest
from petmjx.repairs.trials import Question
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

pytestmark = pytest.mark.filterwarnings("ignore:the packing order looks reversed")

SIZE, TURNED = (600.0, 400.0, 200.0), (400.0, 600.0, 200.0)
SUPPORTS = (SIZE, (0.0, 600.0, 0.0), 9.5), (SIZE, (600.0, 600.0, 0.0), 9.5)


@pytest.fixture(scope="module")
def thrown() -> petmjx.Plan:
    """A plan whose first box is placed in the air. It falls by 200 mm, and its support, which comes last, throws it
    back to its place."""
    return make_plan("thrown", ((TURNED, (800.0, 400.0, 200.0), 9.0), *SUPPORTS))


def test_a_box_that_is_thrown_back_to_its_place_has_dropped(thrown: petmjx.Plan) -> None:
    results = petmjx.score([thrown], engine="mujoco", threads=1)
    (world,) = results.worlds.itertuples()
    assert abs(results.boxes.shift_z_m[0]) < 0.001
    assert (world.verdict, world.reason, world.culprit) == ("unstable", "drop", 0)
    assert world.margin == pytest.approx(-1.0)
    assert results.boxes.dropped.tolist() == [True, False, False]
    assert math.isnan(results.boxes.drop_s[0])


def test_its_story_says_that_it_fell(thrown: petmjx.Plan) -> None:
    story = petmjx.tell(thrown, engine="mujoco")
    assert headline(story) == "unstable by drop: first box 0 (article-0)"
    assert first_box_in_words(story) == "Box 0 (article-0) was planned 200 mm in the air and failed first: it fell."


def test_so_it_has_when_a_repair_judges_it(thrown: petmjx.Plan) -> None:
    question = Question({"engine": "mujoco", "threads": 1}, RepairOptions(worlds=0))
    (trial,) = question.trials([TrialRequest(Draft.of(thrown), is_judged=True)])
    assert (trial.verdict, trial.culprit) == ("unstable", 0)


@pytest.mark.parametrize("options", [{"thresholds": {"shift_m": 0.25}}, {"check": "static"}, {"physics": "reference"}])
def test_no_rule_without_a_threshold_or_an_order(thrown: petmjx.Plan, options: dict[str, object]) -> None:
    worlds = petmjx.score([thrown], engine="mujoco", threads=1, **options).worlds
    assert worlds.reason[0] != "drop"


@pytest.mark.parametrize(("gap_mm", "shift_m", "falls"), [(19, 0.001, False), (21, 0.001, True), (21, 0.03, False)])
def test_a_gap_counts_beyond_the_threshold_and_20_mm(gap_mm: float, shift_m: float, falls: bool) -> None:
    plan = make_plan("gap", ((SIZE, (0.0, 0.0, 0.0), 9.0), (SIZE, (0.0, 0.0, 200.0 + gap_mm), 9.0)))
    sim = Simulation(thresholds={"shift_m": shift_m})
    scene = build_scene(plan, sim)
    np.testing.assert_allclose(gaps_m(scene), [0.0, gap_mm / 1000], atol=1e-4)
    outcome = make_outcome(2, shift_m=np.zeros((2, 3)))
    (noted,) = note_floating([outcome], [Job(scene)], sim)
    assert noted.boxes.dropped.tolist() == [False, falls]
    assert (noted.verdict is Verdict.UNSTABLE, noted.culprit) == (falls, 1 if falls else -1)
    failed = replace(outcome, verdict=Verdict.UNSTABLE, reason=Reason.TILT, culprit=0)
    assert note_floating([failed], [Job(scene)], sim) == [failed]
