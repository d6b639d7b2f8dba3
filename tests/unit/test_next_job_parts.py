"""Errors while the next part of a run's jobs is made: they are none of the engine that takes it, and lose no world
without an error."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest
from support.outcomes import make_outcome
from support.plans import make_plan, make_world, stack

from petmjx.engines.attempt_runner import _PendingJobs
from petmjx.engines.attempt_stream import score_worlds
from petmjx.engines.attempts import Engines, ready_for
from petmjx.engines.protocol import Engine, JobsInParts, Progress
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

CHUNK = 4


@dataclass
class TakesForItsOwn(Engine):
    """Takes each next part when it is down to its last two jobs. Memory that runs out then is its device's, for all it
    knows, and it goes on with the jobs that it has.

    Attributes:
        fails: at the end of the jobs that it has got, as an engine that loses its device.
    """

    name: str = "mjx-warp-cpu"
    fails: bool = False
    parts: list[int] = field(default_factory=list)
    runs: int = 0

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        left, n_jobs = list(range(len(jobs))), len(jobs)
        self.parts.append(n_jobs)
        self.runs += 1
        while left:
            yield make_outcome(1, Verdict.STABLE, job=left.pop(0))
            if isinstance(jobs, JobsInParts) and len(left) <= 2:
                part: Sequence[Job] = ()
                try:
                    while (made := jobs.next_part()) is None:
                        time.sleep(0.001)
                    part = made
                except MemoryError:
                    pass
                if self.fails and len(left) == 1:
                    raise ValueError("out of order")
                left += range(n_jobs, n_jobs + len(part))
                n_jobs += len(part)
                self.parts.extend([len(part)] if part else [])


def worlds_of(count: int) -> list[World]:
    return [make_world(make_plan(f"p{k}", stack(1))) for k in range(count)]


def without_room(plain: Callable[..., Any], first: int, last: int) -> Callable[..., Any]:
    """The same, but the host has no memory for these calls."""
    calls = itertools.count(1)

    def fails(*args: Any, **options: Any) -> Any:
        if first <= next(calls) <= last:
            raise MemoryError("no room on the host")
        return plain(*args, **options)

    return fails


def when_it_is_found_who_simulates_them(monkeypatch: pytest.MonkeyPatch, last: int) -> None:
    monkeypatch.setattr(Engines, "for_job", without_room(Engines.for_job, CHUNK + 2, last))


def when_worlds_become_jobs(monkeypatch: pytest.MonkeyPatch, last: int) -> None:
    monkeypatch.setattr("petmjx.engines.attempt_runner.ready_for", without_room(ready_for, CHUNK + 2, last))


def found_by(engine: Engine, source: Iterable[World], plan_ids: list[str]) -> None:
    for result in score_worlds(source, Simulation(), engine, chunk_worlds=CHUNK):
        plan_ids.append(result.world.plan.plan_id)


Short = Callable[[pytest.MonkeyPatch, int], None]
shorts = pytest.mark.parametrize("short", [when_it_is_found_who_simulates_them, when_worlds_become_jobs])


@pytest.fixture(autouse=True)
def fallback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.attempts.make_engine", lambda name: TakesForItsOwn("mujoco"))


@shorts
@pytest.mark.parametrize("fails", [False, True])
def test_a_part_for_which_the_host_has_no_memory_is_made_again_in_another_run(
    short: Short, fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a stand-in has taken over meanwhile."""
    short(monkeypatch, CHUNK + 2)
    engine, plan_ids = TakesForItsOwn(fails=fails), list[str]()
    found_by(engine, worlds_of(3 * CHUNK), plan_ids)
    assert sorted(plan_ids) == sorted(f"p{k}" for k in range(3 * CHUNK))
    assert engine.parts[:2] == [CHUNK, CHUNK]
    assert engine.runs > 1


@shorts
def test_memory_of_the_host_that_stays_short_is_raised_after_the_outcomes_of_the_part_before(
    short: Short, monkeypatch: pytest.MonkeyPatch
) -> None:
    short(monkeypatch, sys.maxsize)
    engine, plan_ids = TakesForItsOwn(), list[str]()
    with pytest.raises(MemoryError, match="no room on the host"):
        found_by(engine, worlds_of(3 * CHUNK), plan_ids)
    assert sorted(plan_ids) == sorted(f"p{k}" for k in range(CHUNK))
    assert engine.parts == [CHUNK]


class Full(dict[int, Any]):
    """Takes one number, and has no room for the next."""

    def update(self, *_: Any) -> None:
        self[0] = None
        raise MemoryError


def test_what_an_engine_could_not_be_asked_is_not_missed_from_it() -> None:
    requests = _PendingJobs[World](unanswered=Full())
    with pytest.raises(MemoryError):
        requests.add([(world, None, ()) for world in worlds_of(2)])
    assert (requests.count, requests.unanswered) == (0, {})


@pytest.mark.parametrize("fails", [False, True])
def test_memory_that_runs_out_in_the_source_is_raised_after_the_outcomes_of_the_part_before(fails: bool) -> None:
    source = map(without_room(lambda world: world, CHUNK + 2, CHUNK + 2), worlds_of(3 * CHUNK))
    engine, plan_ids = TakesForItsOwn(fails=fails), list[str]()
    with pytest.raises(MemoryError, match="no room on the host"):
        found_by(engine, source, plan_ids)
    assert sorted(plan_ids) == sorted(f"p{k}" for k in range(CHUNK))
