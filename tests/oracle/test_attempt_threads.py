"""Further attempts (simulations of a world again, with other options) of a run on mjx-warp-cpu.

Few worlds need them. The run makes them on further threads, while it simulates the other worlds.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

from support.fake_stepper import assert_same
from support.plans import make_plan, make_world, stack

from petmjx.engines import attempt_settings
from petmjx.engines.attempt_threads import AttemptThreads
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.subprocess.attempt_process import AttemptTask
from petmjx.engines.verdict import Outcome
from petmjx.engines.warp.cpu_engine import MjxWarpCpuEngine
from petmjx.engines.world_results import World, WorldResult
from petmjx.options.simulation import Simulation

SINKS = make_plan("sinks", stack(2, size_mm=(400, 300, 200), kg=(0.02, 300.0)))
PLAIN = make_plan("plain", stack(2))


@pytest.mark.slow
def test_a_world_is_simulated_again_beside_the_others_and_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    begun_after = list[int]()
    begin = AttemptThreads.begin

    def watched(self: AttemptThreads, task: AttemptTask) -> None:
        begun_after.append(len(results))
        begin(self, task)

    monkeypatch.setattr(AttemptThreads, "begin", watched)
    engine, results = MjxWarpCpuEngine(2), list[WorldResult[World]]()
    for result in score_worlds([make_world(SINKS), *[make_world(PLAIN)] * 2], Simulation(), engine):
        results.append(result)
    assert len(begun_after) == 1
    assert begun_after[0] < 3, "not at the end"
    monkeypatch.setattr(attempt_settings, "ENGINE_WITH_ATTEMPT_THREADS", "")
    (again,) = score_worlds([make_world(SINKS)], Simulation(), engine)
    assert len(begun_after) == 1
    (beside,) = (result for result in results if result.world.plan is SINKS)
    assert [attempt.attempt for attempt in beside.attempts] == [attempt.attempt for attempt in again.attempts] == [1, 6]
    assert {attempt.engine for attempt in beside.attempts} == {"mjx-warp-cpu"}
    assert_same(beside.outcome, again.outcome)


def test_an_error_is_an_answer_and_close_ends_what_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses = threading.Event()

    class Slow:
        def run(self, jobs: object, sim: object, progress: object) -> Iterator[Outcome | None]:
            while True:
                pauses.set()
                yield None
                time.sleep(0.01)

    simulator, job = AttemptThreads(1), make_world(PLAIN).job
    simulator.begin(AttemptTask(0, "no-such-engine", job, Simulation()))
    (answer,) = simulator.ended(wait=True)
    assert (answer.number, answer.outcome) == (0, None)
    assert "no-such-engine" in answer.message
    monkeypatch.setattr("petmjx.engines.subprocess.attempt_child.make_engine", lambda *_, **__: Slow())
    simulator.begin(AttemptTask(1, "slow", job, Simulation()))
    simulator.begin(AttemptTask(2, "slow", job, Simulation()))
    assert pauses.wait(10)
    assert [*simulator.ended(wait=False)] == []
    simulator.close()
    for thread in simulator._pool._threads:
        thread.join(10)
        assert not thread.is_alive()
