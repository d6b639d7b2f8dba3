"""Tests of attempts (repeated simulations of invalid or doubtful worlds), with engines whose results are prescribed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from support.failing_engine import FailingEngine, outcome_of, worlds_failing
from support.outcomes import make_outcome
from support.plans import make_plan, make_world

import petmjx.engines.outcome_checks as looked_at
from petmjx.engines.attempt_settings import ATTEMPTS, CAREFUL_ITERATIONS, CAREFUL_TOLERANCE
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Capability, Engine, Progress, says_at_hand, takes_stream
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.subprocess.check_pool import CheckPool
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.engines.world_results import World
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import MOST_ITERATIONS, Simulation, Solver
from petmjx.runs.sweep_run import SAME_STEP_ATTEMPTS
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job


@pytest.mark.parametrize("streams", [False, True])
def test_worlds_that_follow_from_results_are_simulated_too(streams: bool) -> None:
    """New worlds may follow from results. An engine that takes jobs while it runs simulates them at once. Any other
    engine simulates them when the earlier jobs have ended. If a world is invalid, new worlds follow from the result of
    its last attempt."""

    class Taking(FailingEngine):
        @takes_stream
        def run(
            self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
        ) -> Iterator[Outcome]:
            stream, number = JobStream.of(jobs), 0
            self.calls.append((sim, stream.peek(9)))
            while new := stream.take(1):
                failures = round(float(new[0].scene.mass[0])) - 1
                yield outcome_of(number, Verdict.INVALID if len(self.calls) <= failures else Verdict.STABLE)
                number += 1

    engine = Taking() if streams else FailingEngine()
    first, second, third, fourth = worlds_failing(0, 9, 0, 0)
    follow = {"p0": [second, third], "p1": [fourth]}
    queue: list[World] = []

    def following() -> list[World]:
        next_worlds = queue.copy()
        queue.clear()
        return next_worlds

    seen = []
    for result in score_worlds([first], Simulation(), engine, following=following):
        seen.append(result.world.plan.plan_id)
        queue += follow.get(seen[-1], [])
    assert sorted(seen) == ["p0", "p1", "p2", "p3"]
    assert seen[0] == "p0"
    assert seen.index("p3") > seen.index("p1")
    assert [len(jobs) for _, jobs in engine.calls][:2] == ([1, 1] if streams else [1, 2])


@dataclass
class Mixing(Engine):
    """An engine that takes jobs with stiffer contacts together with others. Boxes sink in all other worlds. With
    ``raises``, the engine raises an error when it has taken a job with stiffer contacts beside others."""

    name: str = "mjx-warp"
    mixes: bool = True
    raises: bool = False
    doubtful: Verdict = Verdict.UNSTABLE
    calls: list[list[tuple[float | None, float]]] = field(default_factory=list)
    """For each run, the jobs in the order in which they were taken: ``Job.stiff``, and the contacts of the run."""

    @property
    def capabilities(self) -> Capability:
        return super().capabilities if self.mixes else super().capabilities & ~Capability.STIFF_JOBS

    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        stream, taken = JobStream.of(jobs), list[tuple[float | None, float]]()
        self.calls.append(taken)
        while new := stream.take(1):
            (job,) = new
            taken.append((job.stiff, sim.physics.solimp[0]))
            if self.raises and job.stiff is not None:
                raise RuntimeError("Warp CUDA error 901")
            stands = job.stiff is not None or sim.physics.solimp[0] == STIFF or job.drive is not None
            flags = Flag.NONE if stands else Flag.SINKING
            verdict, reason = (Verdict.STABLE, Reason.NONE) if stands else (self.doubtful, Reason.SINKING)
            yield make_outcome(1, verdict, reason, job=len(taken) - 1, flags=flags)


USUAL, STIFF = (ATTEMPTS[k].apply_to_sim(Simulation()).physics.solimp[0] for k in (0, 5))
"""Impedance at depth 0 of usual and of stiffer contacts."""


def driven(
    engine: Engine,
    sim: Simulation | None = None,
    progress: Progress | None = None,
    kg: float = 1.0,
    **of_job: Any,
) -> dict[str, list[int]]:
    """Simulate the placements p and q with the engine, and then a drive that starts from p. Returns the attempts at
    each world; the drive is named drive. ``of_job``: fields of the jobs of both placements."""
    p, q = (make_world(make_plan(name, [((100, 100, 100), (0, 0, 0), kg)])) for name in "pq")
    placed = [replace(world, variant=1, job=replace(world.job, keep_state=True, **of_job)) for world in (p, q)]
    drive = make_world(make_plan("drive", [((100, 100, 100), (0, 0, 0), 1.0)]))
    drive = replace(drive, job=replace(drive.job, drive=Drive(Excitation("push", "force", np.zeros((3, 3))))))
    follows: list[World] = []

    def following() -> list[World]:
        ready = follows.copy()
        follows.clear()
        return ready

    attempts = {}
    options: dict[str, Any] = {"following": following, "attempts": SAME_STEP_ATTEMPTS, "progress": progress}
    for result in score_worlds(placed, sim or Simulation(), engine, **options):
        attempts[result.world.plan.plan_id] = [record.attempt for record in result.attempts]
        follows += [drive] if result.world is placed[0] else []
    return attempts


def test_a_placement_in_stiffer_contacts_joins_the_run_and_what_follows_does_too() -> None:
    mixing, apart = Mixing(), Mixing(mixes=False)
    assert driven(mixing) == driven(apart) == {"p": [1, 6], "q": [1, 6], "drive": [1]}
    placed, again, shaken = (None, USUAL), (0.5, USUAL), (None, USUAL)
    assert mixing.calls == [[placed, again, shaken, placed, again]]
    assert apart.calls == [[(None, USUAL)] * 2, [(None, STIFF)] * 2, [(None, USUAL)]]


def test_an_attempt_that_joined_is_made_again_if_the_engine_fails() -> None:
    """The attempt is not taken for a first attempt, and its world is not simulated on the fallback engine."""
    engine, progress = Mixing(raises=True), Progress()
    assert driven(engine, progress=progress) == {"p": [1, 6], "q": [1, 6], "drive": [1]}
    assert engine.calls[-1] == [(None, USUAL)]
    assert (None, STIFF) in [job for run in engine.calls for job in run]
    assert [*progress.notes] == ["attempt 1: mjx-warp failed (RuntimeError: Warp CUDA error 901)"]


@pytest.mark.parametrize(
    ("of_job", "kg", "joins"),
    [
        ({"record": Record(0.05)}, 1.0, False),
        ({"has_errors": True}, 1.0, True),
        ({"has_errors": True}, 100_000.0, False),
        ({}, 100_000.0, True),
    ],
)
def test_recorded_worlds_and_plans_whose_boxes_sink_with_any_errors_wait_for_their_turn(
    of_job: dict[str, Any], kg: float, joins: bool
) -> None:
    """A box of 100 t sinks into the carrier, in all worlds with errors of its plan."""
    engine = Mixing(doubtful=Verdict.INVALID)
    assert driven(engine, kg=kg, **of_job) == {"p": [1, 6], "q": [1, 6], "drive": [1]}
    assert len(engine.calls) == (1 if joins else 3)


def test_with_pyramidal_cones_no_world_is_simulated_in_stiffer_contacts() -> None:
    engine = Mixing()
    assert driven(engine, Simulation(physics="reference"))["p"] == [1]
    assert all(stiff is None for run in engine.calls for stiff, _ in run)


def test_answers_at_hand_are_looked_at_together_also_where_worlds_follow_from_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class InSlices(FailingEngine):
        @says_at_hand
        @takes_stream
        def run(
            self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
        ) -> Iterator[Outcome]:
            stream = JobStream.of(jobs)
            while new := stream.take(9, least=9):
                ended = range(stream.taken - len(new), stream.taken)
                for index in ended:
                    assert progress is not None
                    progress.at_hand = ended[-1] - index
                    yield outcome_of(index, Verdict.STABLE)

    together: list[int] = []
    monkeypatch.setattr(looked_at, "note_edges", lambda outcomes, jobs, sim: together.append(len(outcomes)))
    queue, worlds = [], worlds_failing(0, 0, 0, 0, 0)

    def following() -> list[World]:
        next_worlds = queue.copy()
        queue.clear()
        return next_worlds

    for result in score_worlds(worlds[:3], Simulation(), InSlices(), following=following):
        queue += worlds[3:] if result.world is worlds[2] else []
    assert [number for number in together if number] == [3, 2]


def test_what_looks_at_answers_is_waited_for_until_more_are_at_hand() -> None:
    class Answering(FailingEngine):
        @says_at_hand
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            for outcome in super().run(jobs, sim, progress):
                assert progress is not None
                progress.at_hand = 0
                yield outcome

    class Waiting(CheckPool[Any]):
        """A pool that has other answers while the caller waits."""

        def exchanged(self, came: Any, *_: Any, wait: bool, until: Callable[[], bool]) -> Any:
            assert wait
            assert not until()
            kept.extend(came)
            progress.at_hand = 1
            if until():
                return []
            answers = kept.copy()
            kept.clear()
            went_on.append(len(answers))
            return answers

    kept, went_on = list[Any](), list[int]()
    progress, worlds = Progress(), worlds_failing(0, 0, 0)
    results = score_worlds(worlds, Simulation(), Answering(), progress=progress, check_pool=Waiting(0))
    assert sorted(result.world.plan.plan_id for result in results) == ["p0", "p1", "p2"]
    assert [count for count in went_on if count] == [3], "in the end all are waited for"


def test_valid_worlds_run_once() -> None:
    engine = FailingEngine()
    results = list(score_worlds(worlds_failing(0, 0, 0), Simulation(), engine))
    assert {r.world.plan.plan_id for r in results} == {"p0", "p1", "p2"}
    assert [len(r.attempts) for r in results] == [1, 1, 1]
    assert len(engine.calls) == 1


def test_invalid_worlds_run_again_as_one_batch_until_they_are_valid() -> None:
    engine = FailingEngine()
    results = {r.world.plan.plan_id: r for r in score_worlds(worlds_failing(0, 1, 3, 9, 1), Simulation(), engine)}
    assert [len(jobs) for _, jobs in engine.calls] == [5, 4, 2, 2, 1]
    assert {name: len(r.attempts) for name, r in results.items()} == {"p0": 1, "p1": 2, "p2": 4, "p3": 5, "p4": 2}
    assert {name: r.outcome.attempt for name, r in results.items()} == {
        "p0": 1, "p1": 2, "p2": 4, "p3": 5, "p4": 2
    }  # fmt: skip
    assert results["p3"].outcome.verdict is Verdict.INVALID
    assert results["p3"].outcome.reason is Reason.EXPLOSION
    assert results["p2"].outcome.verdict is Verdict.STABLE
    assert [a.verdict for a in results["p2"].attempts] == ["invalid", "invalid", "invalid", "stable"]
    assert [a.solver for a in results["p3"].attempts] == ["newton", "newton", "cg", "cg", "newton"]
    assert [a.timestep_s for a in results["p3"].attempts] == [0.002] * 4 + [0.001]


def test_flags_of_an_engine_of_one_s_own_may_be_numbers() -> None:
    outcome = make_outcome(1, Verdict.STABLE, flags=int(Flag.SINKING))  # type: ignore[arg-type]
    numbers = [attempt.number for attempt in ATTEMPTS if attempt.is_for(outcome, Simulation())]
    assert numbers == [
        attempt.number for attempt in ATTEMPTS if attempt.is_for(replace(outcome, flags=Flag.SINKING), Simulation())
    ]
    assert numbers


def test_no_attempt_repeats_another() -> None:
    engine = FailingEngine()
    list(score_worlds(worlds_failing(9), Simulation(), engine))
    sims = [sim for sim, _ in engine.calls]
    assert len(sims) == 5
    assert all(sims[i] != sims[j] for i in range(5) for j in range(i))
    assert [sim.solver for sim in sims] == [Solver.NEWTON, Solver.NEWTON, Solver.CG, Solver.CG, Solver.NEWTON]
    assert [sim.solver_iterations for sim in sims] == [None, *[CAREFUL_ITERATIONS] * 3, None]
    assert [sim.solver_tolerance for sim in sims] == [None, CAREFUL_TOLERANCE, None, CAREFUL_TOLERANCE, None]


def test_half_the_timestep_keeps_durations() -> None:
    sim = Simulation()
    (half,) = (recipe.apply_to_sim(sim) for recipe in ATTEMPTS if recipe.number == 5)
    assert half.physics.timestep_s == sim.physics.timestep_s / 2
    for name in ("steps", "landing_steps", "poll_steps", "still_steps", "tremble_steps"):
        before, after = (getattr(s.quiet, name) * s.physics.timestep_s for s in (sim, half))
        assert after == pytest.approx(before)


def test_half_the_timestep_resamples_force_profiles_and_keeps_them_shared() -> None:
    engine = FailingEngine()
    pulse = Excitation("pulse", "force", np.arange(6.0).reshape(2, 3))
    worlds = [replace(world, job=replace(world.job, drive=Drive(pulse, scale=2.0))) for world in worlds_failing(9, 9)]
    list(score_worlds(worlds, Simulation(), engine))
    drives = [job.drive for job in engine.calls[-1][1]]
    assert drives[0] is not None
    assert drives[1] is not None
    assert drives[0].scale == 2.0
    np.testing.assert_array_equal(drives[0].excitation.samples, [[0, 1, 2], [0, 1, 2], [3, 4, 5], [3, 4, 5]])
    assert drives[0].excitation is drives[1].excitation
    assert engine.calls[0][1][0].drive is worlds[0].job.drive


def test_no_worlds() -> None:
    engine = FailingEngine()
    assert list(score_worlds([], Simulation(), engine)) == []
    assert engine.calls == []


def test_an_engine_that_loses_or_repeats_a_world_is_found_out() -> None:
    with pytest.raises(RuntimeError, match="returned no outcome for 1 of 2 jobs"):
        list(score_worlds(worlds_failing(0, 0), Simulation(), FailingEngine(drop_last=True)))
    with pytest.raises(RuntimeError, match="returned an outcome for job 0, but"):
        list(score_worlds(worlds_failing(0, 0), Simulation(), FailingEngine(repeat_last=True)))


def test_second_attempts_change_what_the_c_engine_computes() -> None:
    sim = Simulation()
    cube = (200.0, 200.0, 200.0)
    boxes = [(cube, (0, 0, 0), 1.0), (cube, (0, 0, 205), 4.0), (cube, (30, 0, 410), 9.0)]
    jobs = [make_world(make_plan("tower", boxes)).job]
    positions = []
    attempts = [recipe for recipe in ATTEMPTS if not recipe.checks]
    for recipe in attempts:
        [outcome] = MujocoEngine(1).run(recipe.apply_to_jobs(jobs), recipe.apply_to_sim(sim))
        positions.append(outcome.boxes.pos)
        assert outcome.verdict is Verdict.STABLE
    assert all((positions[i] != positions[j]).any() for i in range(len(attempts)) for j in range(i))


@dataclass
class AnsweringEngine(Engine):
    """An engine whose k-th run ends with the k-th of the given reasons. No reason means a stable world."""

    reasons: list[Reason]
    name: str = "answering"
    sims: list[Simulation] = field(default_factory=list)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        reason = self.reasons[len(self.sims)]
        self.sims.append(sim)
        for index in range(len(jobs)):
            flags = Flag.SINKING if reason is SINKING else Flag.NONE
            yield make_outcome(1, Verdict.INVALID if reason else Verdict.STABLE, reason, job=index, flags=flags)


SINKING, EXPLOSION, NONE = Reason.SINKING, Reason.EXPLOSION, Reason.NONE


@pytest.mark.parametrize(
    ("reasons", "attempts"),
    [
        ([SINKING, NONE], [1, 6]),
        ([SINKING, SINKING, NONE], [1, 6, 7]),
        ([SINKING] * 3, [1, 6, 7]),
        ([SINKING, EXPLOSION, NONE], [1, 6, 7]),
        ([SINKING, Reason.NONFINITE, SINKING], [1, 6, 7]),
        ([SINKING, EXPLOSION, EXPLOSION], [1, 6, 7]),
        ([SINKING, Reason.FAILED], [1, 6]),
        ([SINKING, Reason.TIMEOUT], [1, 6]),
        ([EXPLOSION, EXPLOSION, SINKING, NONE], [1, 2, 3, 6]),
        ([EXPLOSION] * 5, [1, 2, 3, 4, 5]),
        ([Reason.FAILED, NONE], [1, 2]),
        ([Reason.TIMEOUT], [1]),
        ([EXPLOSION, Reason.TIMEOUT], [1, 2]),
        ([Reason.ITERATION_LIMIT], [1]),
    ],
)
def test_attempts_are_for_what_went_wrong(reasons: list[Reason], attempts: list[int]) -> None:
    engine = AnsweringEngine(reasons)
    (result,) = score_worlds(worlds_failing(0), Simulation(), engine)
    assert [attempt.attempt for attempt in result.attempts] == attempts
    assert result.outcome.reason is reasons[-1]
    for sim, number in zip(engine.sims, attempts, strict=True):
        assert (sim.physics.solimp[1] > PHYSICS["pallet"].solimp[1]) == (number >= 6)


@pytest.mark.parametrize(("first", "number"), [(SINKING, 6), (EXPLOSION, 2)])
def test_an_attempt_without_enough_iterations_changes_nothing_and_is_the_last(first: Reason, number: int) -> None:
    (result,) = score_worlds(worlds_failing(0), Simulation(), AnsweringEngine([first, Reason.ITERATION_LIMIT]))
    assert [(record.attempt, record.reason) for record in result.attempts] == [
        (1, first),
        (number, Reason.ITERATION_LIMIT),
    ]
    assert (result.outcome.attempt, result.outcome.reason) == (1, first)
    assert result.outcome.flags == (Flag.SINKING if first is SINKING else Flag.NONE)


def test_half_a_timestep_has_twice_the_iterations_up_to_the_largest_limit() -> None:
    factors = {1: 1, 2: 1, 3: 1, 4: 1, 5: 2, 6: 1, 7: 8, 8: 2, 9: 1}
    for limit in (100, MOST_ITERATIONS // 4, MOST_ITERATIONS):
        sim = Simulation(iteration_limit=limit)
        limits = {recipe.number: recipe.apply_to_sim(sim).iteration_limit for recipe in ATTEMPTS}
        assert limits == {number: min(limit * factor, MOST_ITERATIONS) for number, factor in factors.items()}


@pytest.mark.parametrize(("n_boxes", "asked"), [(20, {6, 7}), (21, {6}), (96, {6}), (97, set())])
def test_stiff_contacts_are_asked_about_what_they_can_answer_in_time(n_boxes: int, asked: set[int]) -> None:
    """If a world may be unstable only because contacts are soft, it is simulated again with stiffer contacts, unless it
    is so large that this would take too long. A world without a valid verdict is always simulated again."""
    leaning = make_outcome(n_boxes, Verdict.UNSTABLE, Reason.DROP, flags=Flag.SINKING)
    sunk = make_outcome(n_boxes, Verdict.INVALID, Reason.SINKING, flags=Flag.SINKING)
    assert {attempt.number for attempt in ATTEMPTS[1:] if attempt.is_for(leaning, Simulation())} == asked
    assert {attempt.number for attempt in ATTEMPTS[1:] if attempt.is_for(sunk, Simulation())} == {6, 7}
