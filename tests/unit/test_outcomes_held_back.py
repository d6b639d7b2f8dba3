"""Outcomes are shown as soon as an engine yields them, and are on disk in time, even if the engine yields no further
outcome for long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.failing_engine import FailingEngine, outcome_of, worlds_failing
from support.outcomes import make_outcome, make_plan

import petmjx
import petmjx.results.table_parts as tables_module
from petmjx.common.errors import InputError
from petmjx.engines import attempt_settings
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine, Progress, says_at_hand
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.subprocess.attempt_process import AttemptAnswer, AttemptTask
from petmjx.engines.verdict import Flag, Outcome, Verdict
from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.runs import simulate as simulate_module
from petmjx.world.job import Job

N = 12
LONGEST_S = 30.0
"""Longest time that a test waits, s: long enough for a busy machine."""

Hold = Callable[[int], None]
"""Function that is called with the number of outcomes that an engine has yielded so far. The function waits until the
watcher has been told of this number of worlds."""


class FromAList(MujocoEngine):
    """An engine that yields all outcomes but the last one at once, and then waits before it yields the last one."""

    hold: Hold

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        outcomes = list(super().run(jobs, sim, progress))
        yield from outcomes[:-1]
        self.hold(len(outcomes) - 1)
        yield outcomes[-1]


class InTheMidst(MujocoEngine):
    """An engine that inherits from an engine of petmjx, and waits before each outcome, whatever the base class says
    about outcomes that are at hand."""

    hold: Hold

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for count, outcome in enumerate(super().run(jobs, sim, progress)):
            self.hold(count)
            yield outcome


class OnItsOwn:
    """An engine with only the required attributes. The progress of this engine wrongly says that many outcomes are at
    hand."""

    name = "mine"
    hold: Hold

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        assert progress is not None
        progress.at_hand = 99
        for index, job in enumerate(jobs):
            yield make_outcome(job.scene.n_boxes, job=index)
            if index % 5 == 4:
                self.hold(index + 1)


@pytest.mark.parametrize("kind", [FromAList, InTheMidst, OnItsOwn])
def test_what_has_ended_is_shown_while_the_engine_is_silent(kind: type[Any]) -> None:
    heard, late = threading.Semaphore(0), []
    count = 0

    class Watcher:
        def begin(self, start: Any) -> None:
            pass

        def world_done(self, world: Any) -> None:
            heard.release()

    def hold(yielded: int) -> None:
        nonlocal count
        while count < yielded:
            # one thread both yields outcomes and tells the watcher: an outcome that the watcher does not know by now is
            # held back
            if not heard.acquire(blocking=False):
                late.append(yielded)
                return
            count += 1

    engine = kind()
    engine.hold = hold
    plans = [make_plan(f"p{number:02d}") for number in range(N)]
    petmjx.score(plans, engine=engine, watcher=Watcher())
    assert not late


def test_attempts_beside_a_silent_engine_are_shown_in_its_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """A CPU thread makes a further attempt at one world. The attempt ends while the device simulates another world, and
    is shown before the device has finished."""
    beside: list[AttemptTask] = []

    class Beside:
        def begin(self, task: AttemptTask) -> None:
            beside.append(task)

        def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
            while beside and answered.is_set():
                yield AttemptAnswer(beside.pop().number, make_outcome(1), "")

        def close(self) -> None:
            pass

    answered, seen = threading.Event(), list[str]()

    class Device(Engine):
        name = "mjx-warp"

        @says_at_hand
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            assert progress is not None
            assert progress.pauses
            progress.at_hand = 0
            sinks = outcome_of(0, Verdict.UNSTABLE)
            sinks.flags |= Flag.SINKING
            yield sinks
            assert not seen
            answered.set()
            yield None  # type: ignore[misc]
            assert seen == ["p0"], "it was shown in the pause"
            yield outcome_of(1, Verdict.STABLE)

    monkeypatch.setattr(attempt_settings, "AttemptProcess", lambda _: Beside())
    monkeypatch.setattr("petmjx.engines.attempt_with_fallback.outcome_checks", unchecked)
    for result in score_worlds(worlds_failing(0, 0), Simulation(), Device()):
        seen.append(result.world.plan.plan_id)
    assert seen == ["p0", "p1"]


def test_an_outcome_is_shown_in_a_pause_if_the_next_one_does_not_come() -> None:
    """An outcome that was at hand does not come, since its world continues elsewhere: the engine pauses."""
    seen = list[str]()

    class Device(Engine):
        name = "device"

        @says_at_hand
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            assert progress is not None
            progress.at_hand = 1
            yield outcome_of(0, Verdict.STABLE)
            assert not seen
            progress.at_hand = 0
            yield None  # type: ignore[misc]
            assert seen == ["p0"]
            yield outcome_of(1, Verdict.STABLE)

    for result in score_worlds(worlds_failing(0, 0), Simulation(), Device()):
        seen.append(result.world.plan.plan_id)
    assert seen == ["p0", "p1"]


def test_worlds_follow_while_an_attempt_runs_beside_an_idle_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A CPU thread makes a further attempt at one world, and the engine has nothing else to do. Before the attempt
    ends, the caller has another world, as a packer whose next search has ended. The engine simulates this world at
    once."""
    first, second = worlds_failing(0, 0)
    beside: list[AttemptTask] = []
    runs: list[int] = []

    class Beside:
        def begin(self, task: AttemptTask) -> None:
            beside.append(task)

        def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
            assert not wait, "the world that follows would have to wait for the attempt"
            if len(runs) == 2:
                yield AttemptAnswer(beside.pop().number, make_outcome(1), "")

        def close(self) -> None:
            pass

    class Device(Engine):
        name = "mjx-warp"

        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            runs.append(len(jobs))
            outcome = outcome_of(0, Verdict.UNSTABLE if len(runs) == 1 else Verdict.STABLE)
            outcome.flags |= Flag.SINKING if len(runs) == 1 else Flag.NONE
            yield outcome

    nothing: list[list[World]] = [[]] * 4  # what the caller has while the attempt runs, call by call

    def following() -> list[World]:
        return (nothing.pop() if nothing else [second]) if beside and len(runs) == 1 else []

    monkeypatch.setattr(attempt_settings, "AttemptProcess", lambda _: Beside())
    monkeypatch.setattr("petmjx.engines.attempt_with_fallback.outcome_checks", unchecked)
    results = list(score_worlds([first], Simulation(), Device(), following=following))
    assert [result.world for result in results] == [second, first]
    assert runs == [1, 1]


def unchecked(outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation, **_: Any) -> list[Outcome]:
    return list(outcomes)


def test_no_pause_is_asked_of_an_engine_that_does_not_know_them() -> None:
    pauses: list[bool] = []

    class Own(FailingEngine):
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            assert progress is not None
            pauses.append(progress.pauses)
            return super().run(jobs, sim, progress)

    assert len(list(score_worlds(worlds_failing(0, 2), Simulation(), Own()))) == 2
    assert pauses
    assert not any(pauses)


def wait_for_worlds(folder: Path, count: int) -> float:
    """Wait until a run's folder has this number of worlds, and return the time that this took, s."""
    begin = time.monotonic()
    while time.monotonic() - begin < LONGEST_S:
        try:
            if load_run(folder).info["counts"]["worlds"] == count:
                return time.monotonic() - begin
        except InputError:  # run.json is not written yet
            pass
        time.sleep(0.01)
    raise AssertionError(f"{count} worlds are not on disk after {LONGEST_S} s")


@pytest.mark.parametrize(
    "error", [ValueError("odd"), MemoryError(), OSError(28, "No space left on device"), KeyError()]
)
def test_the_timer_that_writes_parts_outlives_errors_of_all_kinds(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first attempts to write a part fail. The waiting worlds are written nevertheless, although no further world
    ends."""
    failures, write = [error, error], tables_module.write_table

    def failing(*arguments: Any) -> str:
        if threading.current_thread() is not threading.main_thread() and failures:
            raise failures.pop()
        return write(*arguments)

    with RunWriter(tmp_path, {}, seconds_per_part=0.05) as run:
        monkeypatch.setattr(tables_module, "write_table", failing)
        for number in range(3):
            run.add(make_plan(f"p{number}"), 0, "fixed", make_outcome())
        wait_for_worlds(tmp_path, 3)
        assert not failures
    assert sorted(load_run(tmp_path).worlds["plan_id"]) == ["p0", "p1", "p2"]


@pytest.mark.parametrize(
    ("ends_s", "waited_s"),
    [([], 0.0), ([1.0], 0.0), ([1.0, 3.5], 2.5), ([*np.linspace(0, 2, 1999), 9.0], 7.001), ([0.0] * 3000 + [5.0], 5.0)],
)
def test_the_time_for_the_last_of_a_thousand_worlds(ends_s: list[float], waited_s: float) -> None:
    assert simulate_module._last_permille_s(ends_s) == waited_s
    if not ends_s:
        timings = petmjx.score([make_plan("p")], engine="mujoco").info["timings"]
        assert 0 <= timings["last_permille_s"] <= timings["wall_s"]
