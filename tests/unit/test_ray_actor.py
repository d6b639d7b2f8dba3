"""The code that runs in a worker's process. It also works without Ray."""

from __future__ import annotations

import os
import pickle
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any

import pytest
from support.fake_stepper import fake_scene
from support.plans import make_plan, make_world, stack

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import cuda_devices
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.remote import ray_actor
from petmjx.engines.remote.ray_actor import Recipe, Report, Worker, WorkerReady
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

SHORT = Simulation(interval_s=0.1, rest_window_s=0.1)
MUJOCO = Recipe("mujoco", {"threads": 1})


class _Broken:
    name = "broken"

    def run(self, jobs: Any, sim: Any, progress: Progress) -> Iterator[Outcome]:
        progress.message = "compiling"
        time.sleep(0.5)
        raise self.error

    error: BaseException = KeyboardInterrupt()


class _Unpicklable(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def test_a_worker_reports_progress_and_errors() -> None:
    worker = Worker(MUJOCO, None, 1)
    hello: WorkerReady = pickle.loads(worker.hello())
    assert (hello.pid, hello.error) == (os.getpid(), None)
    chunk = pickle.dumps(([Job(fake_scene(1.0))] * 2, SHORT))
    reports: list[Report] = [pickle.loads(report) for report in worker.simulate(chunk)]
    assert sorted(outcome.job for report in reports for outcome in report.outcomes) == [0, 1]
    assert reports[-1].progress.world_steps > 0
    broken: Any = _Broken()
    worker._built = Future()
    worker._built.set_result(broken)
    last_reports: list[Report] = [pickle.loads(report) for report in worker.simulate(chunk)]
    assert last_reports[0].progress.message == "compiling"
    assert isinstance(last_reports[-1].error, KeyboardInterrupt)
    broken.error = _Unpicklable(1, 2)
    last_reports = [pickle.loads(report) for report in worker.simulate(chunk)]
    assert repr(last_reports[-1].error) == "RuntimeError('_Unpicklable: 1 and 2')"


def test_processes_beside_a_worker_look_at_the_outcomes_of_large_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_actor, "LARGE", 3)
    worker = Worker(MUJOCO, None, 1, check_pool=1)
    alone = Worker(MUJOCO, None, 1)
    for peer in (worker, alone):
        peer.hello()
    for count in (2, 3, 3):
        chunk = pickle.dumps(([make_world(make_plan(boxes=stack(1 + k))).job for k in range(count)], SHORT))
        beside, here = (
            {outcome.job: outcome for report in peer.simulate(chunk) for outcome in pickle.loads(report).outcomes}
            for peer in (worker, alone)
        )
        assert sorted(beside) == sorted(here) == list(range(count))
        for job, outcome in beside.items():
            assert (outcome.margin, outcome.rest_edge_m) == (here[job].margin, here[job].rest_edge_m)
            assert outcome.rest_edge_m > 0
        assert (worker._check_pool is None) == (count == 2)
    assert alone._check_pool is None
    assert worker._check_pool is not None
    worker._check_pool.close()


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker checks whether there is a GPU before it builds its engine. The check finds one."""
    monkeypatch.setattr(ray_actor, "why_no_warp_at_once", lambda: None)


@pytest.mark.usefixtures("gpu")
def test_the_engine_of_a_gpu_is_built_while_jobs_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def start() -> None:
        begun.set()
        assert may_end.wait(20.0)

    monkeypatch.setattr(ray_actor, "start_gpu", start)
    monkeypatch.setattr(ray_actor, "make_engine", lambda name: MujocoEngine(1))
    worker = Worker(Recipe("mjx-warp"), None, 1, thorough=False)
    assert pickle.loads(worker.hello()).error is None
    assert begun.wait(20.0)
    reports = worker.simulate(pickle.dumps(([Job(fake_scene(1.0))], SHORT)))
    threading.Timer(0.1, may_end.set).start()
    assert sum(len(pickle.loads(report).outcomes) for report in reports) == 1
    assert may_end.is_set()


@pytest.mark.usefixtures("gpu")
@pytest.mark.parametrize("thorough", [False, True])
@pytest.mark.parametrize("error", [EngineUnavailable("jax sees no CUDA device"), PermissionError("no cache")])
def test_an_engine_that_cannot_be_built_on_a_gpu_is_told(
    thorough: bool, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error is not taken for an error of a running engine, which would lead to a simulation on another engine."""

    def fail(name: str) -> None:
        raise error

    monkeypatch.setattr(ray_actor, "start_gpu", lambda: None)
    monkeypatch.setattr(ray_actor, "make_engine", fail)
    worker = Worker(Recipe("mjx-warp"), None, 1, thorough=thorough)
    hello: WorkerReady = pickle.loads(worker.hello())
    [report] = worker.simulate(pickle.dumps(([Job(fake_scene(1.0))], SHORT)))
    for failure in [pickle.loads(report).error, *([hello.error] if thorough else [])]:
        assert isinstance(failure, EngineUnavailable)
        assert str(error) in str(failure)
    assert thorough == (hello.error is not None)


def test_a_worker_without_a_gpu_says_so_before_jobs_are_made() -> None:
    if cuda_devices():
        pytest.skip("this is a GPU")
    hello: WorkerReady = pickle.loads(Worker(Recipe("mjx-warp"), None, 1, thorough=False).hello())
    assert str(hello.error) == "engine mjx-warp cannot run here: no CUDA device (or no driver) on this machine"
