"""A simulation ends when the pallet rests or has failed. A stack that topples slowly has fallen by then, or the result
has the flag that boxes still move."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

import numpy as np
import pytest
from support.plans import Box, make_plan, make_scene, make_world

from benchmarks.small_stacks import CHECKS, cases, judge, summary
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Flag, Outcome, Verdict
from petmjx.engines.world_results import WorldResult
from petmjx.options.simulation import Simulation
from petmjx.world.job import Drive, Excitation, Job


def pair(overhang_mm: float, height_mm: float = 1200.0) -> list[Box]:
    """A box on a box of 300 × 300 × 600 mm. The centre of the upper box is ``overhang_mm`` beyond the edge of the lower
    box."""
    return [
        ((300, 300, 600), (0, 0, 0), 20.0),
        ((300, 300, height_mm), (150 + overhang_mm, 0, 600), 10.0),
    ]


def cartons(beyond_mm: float) -> list[Box]:
    """Three cartons on the edge of a first carton, and a fifth carton on top. The common centre of the upper four is
    ``beyond_mm`` beyond the edge."""
    low, high = (400.0, 300.0, 300.0), (400.0, 300.0, 400.0)
    fifth = 4 * (200 + beyond_mm) - 3 * 195
    corners = [(0, 0, 0), (195, 0, 300), (195, 0, 700), (195, 0, 1100), (fifth, 0, 1500)]
    return [(high if k else low, corner, 10.0) for k, corner in enumerate(corners)]


def simulate(boxes: Sequence[Box], sim: Simulation, drive: Drive | None = None) -> Outcome:
    (outcome,) = MujocoEngine(1).run([Job(make_scene(boxes, sim), drive)], sim)
    return outcome


def score(boxes: Sequence[Box], **options: Any) -> WorldResult:
    sim = Simulation(**options)
    (result,) = score_worlds([make_world(make_plan(boxes=boxes), sim)], sim, MujocoEngine(1))
    return result


@pytest.mark.parametrize(
    "boxes", [pair(1.0), pair(0.5), pair(3.0, 800.0), pair(1.0, 2000.0), cartons(0.5), cartons(3.0)]
)
@pytest.mark.parametrize("options", CHECKS.values(), ids=list(CHECKS))
def test_what_topples_is_never_stable(boxes: Sequence[Box], options: dict[str, Any]) -> None:
    outcome = simulate(boxes, Simulation(**options))
    assert outcome.verdict is Verdict.UNSTABLE


@pytest.mark.parametrize("boxes", [pair(-0.5), pair(-3.0), cartons(-0.5), cartons(-3.0)])
def test_what_statics_lets_stand_stands(boxes: Sequence[Box]) -> None:
    outcome = score(boxes).outcome
    assert (outcome.verdict, outcome.flags & ~Flag.KNIFE_EDGE) == (Verdict.STABLE, Flag.NONE)
    assert outcome.sim_time_s < 5.0  # there is no waiting for boxes at rest


def test_a_world_whose_time_is_over_says_that_it_moves() -> None:
    for options in ({"longest_wait_s": 0.0}, {"physics": "reference", "schedule": "fixed", "interval_s": 0.4}):
        outcome = simulate(pair(0.5), Simulation(**options))
        assert outcome.verdict is Verdict.STABLE
        assert outcome.flags & Flag.MOVING


def test_a_box_put_onto_a_moving_pile_says_so() -> None:
    """With the schedule fixed, the third box is placed while the second box topples."""
    boxes = [*pair(0.5), ((200.0, 200.0, 100.0), (310.0, 0.0, 0.0), 5.0)]
    assert simulate(boxes, Simulation(schedule="fixed")).flags & Flag.MOVING
    assert not simulate(boxes, Simulation()).flags & Flag.MOVING


def test_a_drive_ends_when_the_pallet_rests() -> None:
    """A push makes a slender box rock, and 0.1 s later it still rocks."""
    boxes: list[Box] = [((150, 300, 1200), (0, 0, 0), 20.0)]
    push = Drive(Excitation("push", "acceleration", np.tile([0.9, 0.0, 0.0], (120, 1))), rest_s=0.1)
    waits = simulate(boxes, Simulation(), push)
    cut = simulate(boxes, Simulation(longest_wait_s=0.0), push)
    assert cut.flags & Flag.MOVING
    assert not waits.flags & Flag.MOVING
    assert waits.sim_time_s > cut.sim_time_s + 0.2


@pytest.mark.parametrize(
    "boxes",
    [
        [((131, 300, 402), (0, 0, 0), 0.32), ((131, 300, 800), (64.8, 0, 402), 7.2)],
        [((62, 300, 400), (0, 0, 0), 0.36), ((62, 300, 800), (24.8, 0, 400), 337.0)],
        [((35, 300, 1000), (0, 0, 0), 1.0), ((35, 300, 200), (15.7, 0, 1000), 5.0)],
    ],
)
@pytest.mark.parametrize("check", ["one-by-one", "static"])
def test_slender_piles_do_not_fall_because_contacts_are_soft(boxes: Sequence[Box], check: str) -> None:
    assert score(boxes, check=check).outcome.verdict is Verdict.STABLE


def test_a_pile_that_no_contacts_hold_is_not_asked_about_soft_ones() -> None:
    """A light box carries a heavy box near its edge, for which soft contacts might decide the verdict. But the third
    box falls in any case, because it stands too far out."""
    boxes: list[Box] = [
        ((200, 300, 200), (0, 0, 0), 0.5),
        ((200, 300, 200), (98, 0, 200), 30.0),
        ((200, 300, 100), (218, 0, 400), 0.01),
    ]
    result = score(boxes)
    assert [(a.attempt, a.verdict) for a in result.attempts] == [(1, "unstable")]
    assert result.outcome.culprit == 2


def test_statics_answer_to_small_stacks() -> None:
    """The first of the stacks of ``python -m benchmarks small-stacks``, with statics as the reference. Each check has
    stacks of its own."""
    stacks = cases(5 * len(CHECKS), seed=0)
    for check in CHECKS:
        counts = summary(judge(list(islice(stacks, 5)), check, engine="mujoco"))
        assert counts["wrong"] == []
        assert 1 <= counts["stand"] < 5
