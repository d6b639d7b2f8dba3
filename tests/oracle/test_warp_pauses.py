"""On mjx-warp, a placement that pauses and continues later has the same results, to the last bit, as one without a
pause. A paused placement may also continue in another world."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from petmjx.engines.protocol import Capability, Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.placing import Placing, Way
from petmjx.repairs import common_placements
from petmjx.repairs.drafts import Draft
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.requests import Trial, TrialRequest
from petmjx.repairs.trials import Lane, Question, TrialStream
from petmjx.world.error_distributions import Distribution
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scene
from petmjx.world.variants import PlacementChange, Variant, apply

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same
from support.plans import Box, make_plan
from support.tiny_worlds import SHORT, shared_engine

HEAP: Sequence[Box] = (
    ((300, 200, 150), (0, 0, 0), 4),
    ((490, 200, 150), (310, 0, 0), 6),
    ((400, 180, 100), (100, 10, 150), 3),
    ((200, 150, 120), (110, 20, 250), 2),
    ((200, 150, 120), (320, 30, 250), 2),
)
"""Boxes of which the later ones stand on several of the earlier ones."""

FALLING: Sequence[Box] = (*HEAP[:3], ((100, 100, 300), (460, 30, 250), 5), HEAP[3])
"""The boxes of ``HEAP``, with a fourth box that falls."""

WITH_SHEET: Sequence[Box] = (
    *(((200, 200, 100), (x, 0, 0), 5) for x in (0, 400)),
    ((600, 200, 5), (0, 0, 100), 0.5),
    *HEAP[3:4],
    ((200, 150, 120), (320, 30, 105), 2),
)
"""A sheet of several pieces on two towers. (The fourth box hangs above it, and falls on it.)"""

ERRORS = PlacementChange(
    x_mm=Distribution("normal", 0.0, 6.0),  # type: ignore[arg-type]
    y_mm=Distribution("normal", 0.0, 6.0),  # type: ignore[arg-type]
    size_mm=Distribution("normal", 0.0, 4.0),  # type: ignore[arg-type]
)
"""Errors as large as the gaps between boxes: hands begin beside neighbours that are in the way."""


def scene_of(boxes: Sequence[Box], *, errors: bool = False) -> Scene:
    kinds = tuple("sheet" if box[0][2] == 5 else "" for box in boxes)
    scene = build_scene(replace(make_plan(boxes=boxes), kinds=kinds if any(kinds) else ()), SHORT)
    return apply(scene, "heap", Variant(1, ERRORS), 33329) if errors else scene


def simulated(*jobs: Job) -> list[Outcome]:
    """The outcomes of jobs that are simulated side by side."""
    outcomes = [*shared_engine().run(list(jobs), SHORT)]
    return sorted(outcomes, key=lambda outcome: outcome.job)


@pytest.mark.parametrize(
    ("boxes", "errors"), [(HEAP, False), (HEAP, True), (WITH_SHEET, False)], ids=["exact", "errors", "sheet"]
)
def test_a_placement_that_has_paused_ends_as_one_that_has_not(boxes: Sequence[Box], errors: bool) -> None:
    """The placement pauses before each box, and continues in the table of another run, beside other worlds."""
    job = Job(scene_of(boxes, errors=errors), has_errors=errors)
    (whole,) = simulated(job)
    start = None
    for n_placed in range(1, job.scene.n_boxes):
        paused, beside = simulated(replace(job, start=start, pauses_after=n_placed), Job(scene_of(HEAP[:2])))
        assert beside.state is None
        start = paused.state
        assert start is not None
        assert paused.n_placed == n_placed
        _, rest = simulated(Job(scene_of(FALLING)), replace(job, start=start))
        assert_same(rest, whole)
        assert rest.flags == whole.flags


def test_worlds_that_begin_alike_start_from_one_state() -> None:
    """The first three boxes of the worlds are equal. The worlds differ in the fourth box and in their numbers of
    boxes."""
    jobs = [Job(scene_of(boxes), has_errors=True) for boxes in (HEAP, FALLING, HEAP[:4])]
    (paused,) = simulated(replace(jobs[0], pauses_after=3))
    wholes = simulated(*jobs)
    assert [outcome.n_placed for outcome in wholes] == [5, 4, 4], "the fourth box of the second world falls"
    rests = simulated(*(replace(job, start=paused.state) for job in jobs))
    for rest, whole in zip(rests, wholes, strict=True):
        assert_same(rest, whole)
        assert rest.flags == whole.flags


def test_a_placement_that_falls_does_not_pause() -> None:
    job = Job(scene_of(FALLING), has_errors=True)
    (whole,), (ended,) = simulated(job), simulated(replace(job, pauses_after=4))
    assert ended.state is None
    assert_same(ended, whole)


def test_keys_are_equal_as_far_as_worlds_are_the_same() -> None:
    engine = shared_engine()
    assert Capability.PAUSES in engine.capabilities
    scenes = [scene_of(boxes) for boxes in (HEAP, FALLING, HEAP[:4])]
    carried = replace(scenes[0], placing=Placing(name=Way.HAND))
    slippery = replace(scenes[0], friction=0.5 * scenes[0].friction)
    heavier = replace(scenes[0], mass=scenes[0].mass * [1, 1, 1, 1, 2])
    slowed = replace(scenes[0], pairs={"kinetic": np.full((1, 1), 0.5)})
    whole, *others = engine.beginnings([*scenes, carried, slippery, heavier, slowed], SHORT)
    assert [len(keys) for keys in (whole, *others)] == [6, 6, 5, 6, 6, 6, 6]
    n_same = [sum(mine == its for mine, its in zip(whole, keys, strict=False)) for keys in others]
    assert n_same == [4, 5, 0, 1, 5, 0], "a key covers the carrier, one more covers each box"
    assert engine.beginnings(scenes[2:], SHORT)[0] == others[1], "keys do not depend on the scenes beside one"


def test_trials_of_repairs_that_share_beginnings_are_those_of_whole_worlds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The trials are of changes of the last two boxes, without errors and in two worlds with errors. Placements pause
    as early as they can. A second request starts from the states that the first request has kept."""
    draft = Draft.of(make_plan(boxes=HEAP))
    corners = [draft.corner_mm[[box]] + [0.0, move, 0.0] for box in (3, 4) for move in (0.0, 30.0, 120.0)]
    drafts = [
        draft.with_places([box], corner, anew=False) for box, corner in zip((3, 3, 3, 4, 4, 4), corners, strict=True)
    ]
    requests = [
        [TrialRequest(one, True, world) for one in some for world in (0, 1, 2)] for some in (drafts[:4], drafts[2:])
    ]
    question = Question({"engine": shared_engine(), "threads": 1}, RepairOptions(worlds=8))
    steps: list[int] = []
    results: list[list[Trial]] = []

    def trials() -> list[str]:
        steps.append(0)
        stream, answers = TrialStream(question), []
        for asked in requests:
            stream.put(None, asked)
            answers += [answer for answer in stream.answers() if answer is not None]
        results.append([trial for answer in answers for trial in answer.trials])
        return [repr(trial) for trial in results[-1]]  # margins are NaN

    run = type(shared_engine()).run

    def counted(*arguments: object) -> Iterator[Outcome | None]:
        progress = Progress(pauses=True)
        yield from run(*arguments[:3], progress)
        steps[-1] += progress.world_steps

    monkeypatch.setattr(type(shared_engine()), "run", counted)
    counted.takes_stream = counted.says_at_hand = True  # type: ignore[attr-defined]
    monkeypatch.setattr(common_placements, "LEAST_SAVED", 1)
    monkeypatch.setattr(Lane, "can_pause", True)  # this engine has the name of the engine for GPUs
    shared = trials()
    monkeypatch.setattr(Lane, "can_pause", False)
    assert shared == trials()
    assert {trial.stands for trial in results[0]} == {True, False}
    assert steps[0] < 0.8 * steps[1], "a part of the steps are those of the rest windows"
