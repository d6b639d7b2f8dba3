"""Worlds are made and simulated a chunk at a time; an engine may take the next chunk while it has this one."""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field

import pytest
from support.failing_engine import FailingEngine, outcome_of, worlds_failing
from support.plans import make_plan, make_world, stack
from support.waiting import wait_for

import petmjx.engines.attempt_stream as retry_module
from petmjx.engines.attempt_stream import score_worlds
from petmjx.engines.protocol import JobsInParts, Progress
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job


def test_worlds_are_drawn_a_chunk_at_a_time_while_the_one_before_is_simulated() -> None:
    engine = FailingEngine()
    drawn, next_ones = 0, threading.Event()

    def source() -> Iterator[World]:
        nonlocal drawn
        for world in worlds_failing(*[0] * 10):
            drawn += 1
            if drawn == 8:
                next_ones.set()
            yield world

    results = score_worlds(source(), Simulation(), engine, chunk_worlds=4)
    next(results)
    assert next_ones.wait(30)
    assert drawn == 8
    assert len(list(results)) == 9
    assert [len(jobs) for _, jobs in engine.calls] == [4, 4, 2]


@dataclass
class InParts(FailingEngine):
    """Takes each next part when it has answered half of the one before, and fails when it has begun one."""

    fails: int = 0
    parts: list[int] = field(default_factory=list)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        self.calls.append((sim, list(jobs)))
        self.parts.append(len(jobs))
        left = dict(enumerate(jobs))
        n_jobs = len(left)
        while left:
            number = next(iter(left))
            attempt = sum(left[number] in batch for _, batch in self.calls)
            failures = round(float(left.pop(number).scene.mass[0])) - 1
            yield outcome_of(number, Verdict.INVALID if attempt <= failures else Verdict.STABLE)
            if isinstance(jobs, JobsInParts) and len(left) <= 2:
                while (part := jobs.next_part()) is None:
                    time.sleep(0.001)
                if part and self.fails:
                    raise ValueError("out of order")
                left.update(enumerate(part, n_jobs))
                n_jobs += len(part)
                self.calls[-1][1].extend(part)
                self.parts.extend([len(part)] if part else [])


def test_an_engine_may_take_the_next_chunk_before_it_is_through_with_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as not too many wait for another attempt."""
    engine = InParts()
    results = list(score_worlds(worlds_failing(*[0] * 10), Simulation(), engine, chunk_worlds=4))
    assert sorted(r.world.plan.plan_id for r in results) == sorted(f"p{k}" for k in range(10))
    assert [len(jobs) for _, jobs in engine.calls] == [10]
    assert engine.parts == [4, 4, 2]
    monkeypatch.setattr("petmjx.engines.attempt_runner.MOST_TOGETHER", 1)
    engine = InParts()
    results = list(score_worlds(worlds_failing(*[1] * 10), Simulation(), engine, chunk_worlds=4))
    assert sorted(len(r.attempts) for r in results) == [2] * 10
    assert [len(jobs) for _, jobs in engine.calls] == [8, 8, 2, 2]


def test_an_engine_that_takes_parts_begins_with_few_worlds() -> None:
    engine = InParts()
    engine.takes_parts = True
    results = list(score_worlds(worlds_failing(*[0] * 25), Simulation(), engine, chunk_worlds=10, first_worlds=1))
    assert sorted(r.world.plan.plan_id for r in results) == sorted(f"p{k}" for k in range(25))
    assert engine.parts == [1, 8, 10, 6]
    assert len(engine.calls) == 1
    engine.parts.clear()
    growing = score_worlds(
        worlds_failing(*[0] * 25), Simulation(), engine, chunk_worlds=10, first_worlds=1, more=lambda: ()
    )
    assert len(list(growing)) == 25
    assert engine.parts[0] == 10


def test_what_an_engine_had_of_several_chunks_when_it_failed_is_simulated_by_its_stand_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fallback = FailingEngine("mujoco")
    monkeypatch.setattr("petmjx.engines.attempts.make_engine", lambda name: fallback)
    engine = InParts("mjx-warp-cpu", fails=1)
    results = list(score_worlds(worlds_failing(*[0] * 10), Simulation(), engine, chunk_worlds=4))
    assert sorted(r.world.plan.plan_id for r in results) == sorted(f"p{k}" for k in range(10))
    assert engine.parts == [4, 2]
    assert len(fallback.calls[0][1]) == 6


def test_an_error_of_the_source_is_none_of_the_engine() -> None:
    """What came before it is there."""

    def source() -> Iterator[World]:
        yield from worlds_failing(*[0] * 6)
        raise ValueError("no more plans")

    results, engine = [], InParts()
    with pytest.raises(ValueError, match="no more plans"):
        results.extend(score_worlds(source(), Simulation(), engine, chunk_worlds=4))
    assert engine.parts == [4]


def test_chunks_of_larger_worlds_have_fewer() -> None:
    """A chunk is full with the world that has its last box."""
    worlds = [make_world(make_plan("p", stack(n))) for n in (1, 2, 1, 3, 4, 2, 5, 1, 1, 1, 1)]
    source = retry_module.Chunks(iter(worlds), 4, 4, 6)
    chunks = [[world.job.scene.n_boxes for world in source.take()] for _ in range(6)]
    source.close()
    assert chunks == [[1, 2, 1, 3], [4, 2], [5, 1], [1, 1, 1], [], []]


def test_a_last_chunk_that_is_made_before_it_is_asked_for_is_yet_to_come() -> None:
    source = retry_module.Chunks(iter(worlds_failing(*[0] * 5)), 3, 3)
    assert len(source.take()) == 3
    wait_for(lambda: source._next is None or source._next.done())
    assert source.more
    assert len(source.take_made() or []) == 2
    assert not source.more
    assert source.take_made() == source.take() == []
    source.close()


def test_a_run_that_is_cut_off_does_not_wait_for_the_rest_of_a_chunk() -> None:
    """With Ctrl-C, for example. The second chunk would take 50 s."""

    def source() -> Iterator[World]:
        for number, world in enumerate(worlds_failing(*[0] * 200)):
            time.sleep(0.5 if number >= 100 else 0.0)
            yield world

    results = score_worlds(source(), Simulation(), FailingEngine(), chunk_worlds=100)
    assert isinstance(results, Generator)
    next(results)
    begin = time.monotonic()
    results.close()
    assert time.monotonic() - begin < 25


def test_invalid_worlds_of_several_chunks_gather() -> None:
    engine = FailingEngine()
    engine.devices = 2
    results = list(score_worlds(worlds_failing(1, 0, 1, 0, 0, 1), Simulation(), engine, chunk_worlds=1))
    assert [len(jobs) for _, jobs in engine.calls] == [2, 2, 2, 2, 1]
    assert sorted(r.world.plan.plan_id for r in results) == ["p0", "p1", "p2", "p3", "p4", "p5"]
