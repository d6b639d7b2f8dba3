"""Tests of the stream of jobs to an engine: its order, when it waits, its limits, and what a run does if the source of
jobs or the engine fails."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest
from support.failing_engine import FailingEngine, outcome_of, worlds_failing
from support.job_streams import put
from support.worlds import make_scene

from petmjx.engines import simulation_loop
from petmjx.engines.job_stream import JobStream
from petmjx.engines.protocol import Progress, takes_stream
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

SIM = Simulation()
ONE, THREE = Job(make_scene(1)), Job(make_scene(3))


def test_a_list_is_a_stream_that_ends() -> None:
    stream = JobStream.of([ONE, THREE, ONE])
    assert JobStream.of(stream) is stream
    assert stream.peek(2) == [ONE, THREE]
    assert stream.take(2) == [ONE, THREE]
    assert not stream.ended
    assert stream.take(5, least=5) == [ONE]  # the stream is closed, so there are no more jobs
    assert stream.ended
    assert stream.take(1) == []
    assert list(stream.in_flight) == [0, 1, 2]


def test_numbers_are_those_of_a_run_and_tags_come_back() -> None:
    stream = JobStream[str]()
    for tag in "abc":
        stream.put(ONE, tag)
    stream.close()
    stream.take(2)
    assert [stream.answered(1), stream.answered(0)] == ["b", "a"]
    with pytest.raises(KeyError):
        stream.answered(0)
    stream.begin()
    stream.take(2)
    assert (stream.in_flight, stream.taken) == ({0: "c"}, 1)


def test_an_engine_waits_for_as_many_as_it_wants_while_more_come() -> None:
    stream = JobStream[Any]()
    put(stream, ONE)
    assert stream.take(9, least=2, wait=False) == []
    taken: list[Job] = []
    engine = threading.Thread(target=lambda: taken.extend(stream.take(9, least=2)))
    engine.start()
    time.sleep(0.01)
    assert not taken
    put(stream, THREE)
    engine.join(30)
    assert taken == [ONE, THREE]
    stream.pause()
    assert stream.take(1) == []  # the source waits for outcomes, not for the stream
    stream.pause(False)
    assert not stream.ended
    stream.close()
    put(stream, ONE)  # a job that follows from an outcome
    assert not stream.ended
    assert stream.take(1) == [ONE]


def test_an_engine_without_worlds_waits_for_jobs_that_follow_from_its_last_outcome() -> None:
    stream = JobStream[Any](feedback=True)
    put(stream, ONE)
    stream.close()
    stream.take(1)
    assert stream.wait_for_following([0]), "its outcome has not been taken"
    stream.answered(0)
    assert stream.wait_for_following([]), "jobs may follow from it"
    stream.put(THREE, None)
    assert not stream.wait_for_following([]), "a job is ready"
    stream.take(1)
    stream.answered(1)
    threading.Timer(0.05, stream.followed).start()
    assert not stream.wait_for_following([]), "no job followed"
    assert stream.ended


def test_an_engine_without_worlds_looks_for_outcomes_while_its_source_may_need_them() -> None:
    """The source of a worker has no further jobs, and declares it when all outcomes have come."""
    stream = JobStream[Any]()
    put(stream, ONE)
    stream.take(1)
    assert stream.wait_for_following([0], left=[0]), "the source may bring jobs when it has the outcome"
    assert not stream.wait_for_following([0]), "the outcome comes at once, so ``peek`` waits for the source"
    stream.pause()
    assert not stream.wait_for_following([0], left=[0])
    stream.pause(False)
    stream.close()
    assert not stream.wait_for_following([0], left=[0])


def test_jobs_that_follow_are_taken_first_but_not_before_those_that_were_looked_at() -> None:
    stream = JobStream[str](feedback=True)
    source = [replace(ONE) for _ in range(3)]
    for number, job in enumerate(source):
        stream.put(job, f"source {number}", bounded=True)
    follows, later = replace(THREE), replace(THREE)
    stream.put(follows, "follows")
    assert stream.peek(3) == [follows, *source[:2]]
    stream.put(later, "later")  # meanwhile, a table gets room for the three jobs
    stream.take_peeked([follows, *source[:2]])
    assert stream.in_flight == {0: "follows", 1: "source 0", 2: "source 1"}
    assert stream.take(9, wait=False) == [later, source[2]]
    assert stream.ready == 0


def test_a_source_waits_while_the_stream_is_full() -> None:
    stream = JobStream[Any](most_boxes=4)
    assert [stream.put(job, None, bounded=True) for job in (THREE, ONE)] == [True, True]
    assert stream.take(9, least=9, wait=False) == [THREE, ONE]  # the jobs for which there is room
    put(stream, THREE, THREE)
    waits = threading.Thread(target=stream.put, args=(ONE, None), kwargs={"bounded": True}, daemon=True)
    waits.start()
    time.sleep(0.01)
    assert stream.ready == 2
    put(stream, ONE)  # a job that follows from an outcome never waits
    stream.take(2)
    waits.join(30)
    assert stream.ready == 2
    stream.close()
    assert not stream.put(ONE, None, bounded=True)


def test_engines_without_streams_get_lists() -> None:
    engine = FailingEngine()
    results = list(score_worlds(worlds_failing(*[0] * 10), SIM, engine, most_pending=4))
    assert [len(jobs) for _, jobs in engine.calls] == [4, 4, 2]
    assert {result.world.plan.plan_id for result in results} == {f"p{k}" for k in range(10)}


@dataclass
class Streaming(FailingEngine):
    """An engine that has up to four worlds at a time, and fails after ``fails_after`` outcomes."""

    fails_after: int = 10**9
    most_in_flight: int = 0
    begin_with: int = 0

    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        stream, taken, in_flight = JobStream.of(jobs), list[Job](), list[int]()
        self.calls.append((sim, taken))
        self.begin_with = stream.begin_with
        while True:
            new = stream.take(4 - len(in_flight), wait=not in_flight)
            in_flight += range(len(taken), len(taken) + len(new))
            taken += new
            if not in_flight:
                return
            self.most_in_flight = max(self.most_in_flight, len(in_flight))
            if self.fails_after == 0:
                raise ValueError("out of order")
            self.fails_after -= 1
            number = in_flight.pop(0)
            failures = round(float(taken[number].scene.mass[0])) - 1
            attempt = sum(any(job is taken[number] for job in batch) for _, batch in self.calls)
            yield outcome_of(number, Verdict.INVALID if attempt <= failures else Verdict.STABLE)


def test_an_engine_with_a_stream_has_all_worlds_in_one_run() -> None:
    engine = Streaming()
    results = list(score_worlds(worlds_failing(*[0] * 10), SIM, engine, most_pending=4))
    assert {result.world.plan.plan_id for result in results} == {f"p{k}" for k in range(10)}
    assert [len(jobs) for _, jobs in engine.calls] == [10]
    assert engine.most_in_flight == 4


def test_an_engine_knows_how_many_jobs_to_wait_for_at_first() -> None:
    """The engine knows how many jobs it should wait for before it begins. If the engine did not know this, a GPU would
    begin with the first job, and compile programs for a single job."""
    engine = Streaming()
    assert len(list(score_worlds(worlds_failing(0), SIM, engine))) == 1
    assert engine.begin_with == simulation_loop.FIRST_WORLDS


def test_the_source_pauses_while_many_wait_for_another_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    """The source of jobs pauses while many worlds wait for another attempt. If the source did not pause, memory would
    grow with the number of invalid worlds."""
    monkeypatch.setattr(simulation_loop, "PENDING_BOXES", 2)
    monkeypatch.setattr("petmjx.engines.attempt_with_fallback.MOST_TOGETHER", 1)
    engine, drawn = Streaming(), 0

    def source() -> Iterator[World]:
        nonlocal drawn
        for world in worlds_failing(*[1] * 40):
            drawn += 1
            yield world

    most_pending = 4
    results = score_worlds(source(), SIM, engine, most_pending=most_pending)
    next(results)
    assert drawn < 20
    assert sorted(len(result.attempts) for result in results) == [2] * 39
    # a second attempt has the worlds that wait, and the worlds that are being simulated when the source pauses
    assert len(engine.calls) > 40 / (most_pending + engine.most_in_flight)


def test_what_an_engine_had_when_it_failed_is_simulated_by_its_fallback(monkeypatch: pytest.MonkeyPatch) -> None:
    fallback = FailingEngine("mujoco")
    monkeypatch.setattr("petmjx.engines.attempt_settings.make_engine", lambda name: fallback)
    engine = Streaming("mjx-warp-cpu", fails_after=3)
    progress = Progress()
    results = list(score_worlds(worlds_failing(*[0] * 10), SIM, engine, progress=progress))
    assert {result.world.plan.plan_id for result in results} == {f"p{k}" for k in range(10)}
    assert len(fallback.calls[0][1]) == 4  # the worlds that were being simulated
    assert any(
        "mjx-warp-cpu failed (ValueError: out of order); 4 worlds: went to mujoco" in line for line in progress.notes
    )


def test_an_engine_that_fails_before_it_takes_a_job_is_not_asked_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    fallback = FailingEngine("mujoco")
    monkeypatch.setattr("petmjx.engines.attempt_settings.make_engine", lambda name: fallback)

    class Broken(Streaming):
        @takes_stream
        def run(self, *_: Any) -> Iterator[Outcome]:
            raise OSError("no device")

    results = list(score_worlds(worlds_failing(*[0] * 10), SIM, Broken("mjx-warp-cpu")))
    assert len(results) == 10


@pytest.mark.parametrize("engine", [Streaming(), FailingEngine()])
def test_an_error_of_the_source_is_raised_after_the_outcomes_before_it(engine: FailingEngine) -> None:
    def source() -> Iterator[World]:
        yield from worlds_failing(*[0] * 5, 1)
        raise ValueError("no more plans")

    plan_ids: list[str] = []
    with pytest.raises(ValueError, match="no more plans"):
        plan_ids.extend(result.world.plan.plan_id for result in score_worlds(source(), SIM, engine))
    assert sorted(plan_ids) == [f"p{k}" for k in range(6)]


def test_memory_that_runs_out_as_a_world_becomes_a_job_ends_the_run_after_the_outcomes_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If memory runs out while a world becomes a job, the run ends after the earlier outcomes. The engine does not get
    the error, since it would think that the memory of its device is full."""
    calls: list[Job] = []

    def short(engine: str, job: Job) -> Job:
        calls.append(job)
        if len(calls) > 3:
            raise MemoryError("no room on the host")
        return job

    monkeypatch.setattr("petmjx.engines.attempt_with_fallback.ready_for", short)
    plan_ids: list[str] = []
    worlds = worlds_failing(*[0] * 9)
    with pytest.raises(MemoryError, match="no room on the host"):
        plan_ids.extend(result.world.plan.plan_id for result in score_worlds(worlds, SIM, Streaming()))
    assert plan_ids == ["p0", "p1", "p2"]


@pytest.mark.parametrize(("name", "limit"), [("mujoco", "PENDING_BOXES"), ("mjx-warp", "PENDING_BOXES_GPU")])
def test_few_boxes_are_pending_at_a_time(name: str, limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation_loop, limit, 3)
    engine = FailingEngine(name)
    assert len(list(score_worlds(worlds_failing(*[0] * 10), SIM, engine))) == 10
    assert all(len(jobs) <= 3 for _, jobs in engine.calls)


def test_a_run_that_is_cut_off_does_not_wait_for_worlds_that_come_later() -> None:
    """An interrupted run, for example by Ctrl-C, does not wait for later worlds, which would take 50 s."""

    def source() -> Iterator[World]:
        for number, world in enumerate(worlds_failing(*[0] * 200)):
            time.sleep(0.5 if number >= 100 else 0.0)
            yield world

    results = score_worlds(source(), SIM, Streaming())
    assert isinstance(results, Generator)
    next(results)
    begin = time.monotonic()
    results.close()
    assert time.monotonic() - begin < 25


def test_invalid_worlds_gather() -> None:
    engine = FailingEngine()
    results = list(score_worlds(worlds_failing(1, 0, 1, 0, 0, 1), SIM, engine))
    assert [len(jobs) for _, jobs in engine.calls] == [6, 3]
    assert sorted(result.world.plan.plan_id for result in results) == ["p0", "p1", "p2", "p3", "p4", "p5"]
