"""The code that runs in a worker's process. The code of a worker also works without Ray."""

from __future__ import annotations

import os
import pickle
import queue
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest
from support.fake_stepper import fake_scene
from support.outcomes import make_outcome
from support.plans import make_plan, make_world, stack

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import cuda_devices
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine, Progress, takes_stream
from petmjx.engines.remote import ray_actor
from petmjx.engines.remote.job_dealer import JobDealer, WorkerJobs
from petmjx.engines.remote.ray_actor import Packet, Recipe, Report, Worker, WorkerReady, WorkerRun
from petmjx.engines.remote.worker_pool import WorkerPool, _PoolRun, _WorkerRecord
from petmjx.engines.user_engine import UserEngine
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Drive, Excitation, Job

SHORT = Simulation(interval_s=0.1, rest_window_s=0.1)
RUN = WorkerRun(SHORT)
MUJOCO = Recipe("mujoco", {"threads": 1})


class _Broken(Engine):
    name = "broken"

    def run(self, jobs: Any, sim: Any, progress: Progress) -> Iterator[Outcome]:
        progress.message = "compiling"
        time.sleep(0.5)
        raise self.error

    error: BaseException = KeyboardInterrupt()


class _Unpicklable(Exception):
    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def simulated(worker: Worker, *packets: Packet, run: WorkerRun = RUN) -> list[Report]:
    """The reports that a worker sends about a run with these packets of jobs."""
    for packet in packets:
        worker.feed(pickle.dumps(packet))
    worker.feed(b"")
    return [pickle.loads(report) for report in worker.simulate(pickle.dumps(run))]


def outcomes_of(reports: list[Report]) -> dict[int, Outcome]:
    return {outcome.job: outcome for report in reports for outcome in report.outcomes}


def test_a_worker_reports_progress_and_errors() -> None:
    worker = Worker(MUJOCO, None, 1)
    hello: WorkerReady = pickle.loads(worker.hello())
    assert (hello.pid, hello.error) == (os.getpid(), None)
    packets: list[Packet] = [[(7, Job(fake_scene(1.0))), (3, Job(fake_scene(2.0)))], [(5, Job(fake_scene(3.0)))]]
    reports = simulated(worker, *packets)
    assert sorted(outcomes_of(reports)) == [3, 5, 7]
    assert reports[-1].progress.world_steps > 0
    broken: Any = _Broken()
    worker._built = Future()
    worker._built.set_result(broken)
    last_reports = simulated(worker, *packets)
    assert last_reports[0].progress.message == "compiling"
    assert isinstance(last_reports[-1].error, KeyboardInterrupt)
    broken.error = _Unpicklable(1, 2)
    last_reports = simulated(worker, *packets)
    assert repr(last_reports[-1].error) == "RuntimeError('_Unpicklable: 1 and 2')"


def test_the_notes_of_a_worker_are_notes_of_the_run() -> None:
    resources: Any = None
    worker = _WorkerRecord(resources, None, None, WorkerJobs(1))
    pool = WorkerPool.__new__(WorkerPool)
    pool._workers = [worker]
    run = _PoolRun(JobStream(), SHORT, Progress(notes={"before": None}), JobDealer(None, 1), 0.0)
    list(pool._take_report(worker, Report([], Progress(notes={"there were long worlds": None})), run))
    assert [*run.progress.notes] == ["before", "there were long worlds"]


def test_processes_beside_a_worker_look_at_the_outcomes_of_large_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_actor, "LARGE", 3)
    worker = Worker(MUJOCO, None, 1, check_pool=1)
    alone = Worker(MUJOCO, None, 1)
    for peer in (worker, alone):
        peer.hello()
    for count in (2, 3, 3):
        jobs: Packet = [(k, make_world(make_plan(boxes=stack(1 + k))).job) for k in range(count)]
        beside, here = (outcomes_of(simulated(peer, jobs[:1], jobs[1:])) for peer in (worker, alone))
        assert sorted(beside) == sorted(here) == list(range(count))
        for job, outcome in beside.items():
            assert (outcome.margin, outcome.rest_edge_m) == (here[job].margin, here[job].rest_edge_m)
            assert outcome.rest_edge_m > 0
        assert (worker._check_pool is None) == (count == 2)
    assert alone._check_pool is None
    assert worker._check_pool is not None
    worker._check_pool.close()


class _Streaming:
    """An engine that takes a stream of jobs, and needs no time. The engine waits for many jobs, and then yields their
    outcomes, the last one first."""

    name = "streaming"

    def __init__(self) -> None:
        self.taken: list[list[Job]] = []

    @takes_stream
    def run(self, jobs: Any, sim: Any, progress: Progress) -> Iterator[Outcome]:
        while some := jobs.take(1000, least=1000):
            first = jobs.taken - len(some)
            self.taken.append(some)
            for index in reversed(range(len(some))):
                yield make_outcome(some[index].scene.n_boxes, job=first + index)


def test_a_run_goes_on_while_packets_come() -> None:
    """An engine that waits for many jobs gets all jobs of a packet. If equal profiles come in several packets, they
    become one object, since an engine has room only for the announced number of profiles."""
    worker, engine = Worker(MUJOCO, None, None), _Streaming()
    worker._built.set_result(UserEngine(engine, None))
    reports: queue.SimpleQueue[Report | None] = queue.SimpleQueue()

    def run() -> None:
        for report in worker.simulate(pickle.dumps(WorkerRun(SHORT, feedback=True))):
            reports.put(pickle.loads(report))
        reports.put(None)

    threading.Thread(target=run, daemon=True).start()
    shakes = [Excitation("shake", "force", np.full((5, 3), level)) for level in (1.0, 2.0)]
    for first in (10, 20):
        jobs = [Job(fake_scene(1.0), drive=Drive(shakes[k % 2])) for k in range(4)]
        worker.feed(pickle.dumps([*enumerate(jobs, first)]))
        numbers: list[int] = []
        while len(numbers) < 4:
            report = reports.get(timeout=20.0)
            assert report is not None
            numbers += (outcome.job for outcome in report.outcomes)
        assert numbers == [*reversed(range(first, first + 4))]
    worker.feed(b"")
    last = reports.get(timeout=20.0)
    assert last is not None
    assert (last.outcomes, last.error) == ([], None)
    assert reports.get(timeout=20.0) is None
    assert [len(jobs) for jobs in engine.taken] == [4, 4]
    assert len({id(job.drive.excitation) for jobs in engine.taken for job in jobs if job.drive}) == 2


def test_an_engine_that_leaves_jobs_out_is_told() -> None:
    class Forgets(_Streaming):
        @takes_stream
        def run(self, jobs: Any, sim: Any, progress: Progress) -> Iterator[Outcome]:
            yield from [*super().run(jobs, sim, progress)][1:]

    class Repeats(_Streaming):
        @takes_stream
        def run(self, jobs: Any, sim: Any, progress: Progress) -> Iterator[Outcome]:
            yield from 2 * [*super().run(jobs, sim, progress)]

    for engine, line in ((Forgets(), "ended before all jobs had outcomes"), (Repeats(), "already has an outcome")):
        worker = Worker(MUJOCO, None, None)
        worker._built.set_result(UserEngine(engine, None))
        *_, last = simulated(worker, [(k, Job(fake_scene(1.0))) for k in range(3)])
        assert isinstance(last.error, RuntimeError)
        assert line in str(last.error)


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
    worker = Worker(Recipe("mjx-warp"), None, None, thorough=False)
    assert pickle.loads(worker.hello()).error is None
    assert begun.wait(20.0)
    threading.Timer(0.1, may_end.set).start()
    assert len(outcomes_of(simulated(worker, [(0, Job(fake_scene(1.0)))]))) == 1
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
    worker = Worker(Recipe("mjx-warp"), None, None, thorough=thorough)
    hello: WorkerReady = pickle.loads(worker.hello())
    [report] = simulated(worker, [(0, Job(fake_scene(1.0)))])
    for failure in [report.error, *([hello.error] if thorough else [])]:
        assert isinstance(failure, EngineUnavailable)
        assert str(error) in str(failure)
    assert thorough == (hello.error is not None)


def test_a_worker_without_a_gpu_says_so_before_jobs_are_made() -> None:
    if cuda_devices():
        pytest.skip("this is a GPU")
    hello: WorkerReady = pickle.loads(Worker(Recipe("mjx-warp"), None, 1, thorough=False).hello())
    assert str(hello.error) == "engine mjx-warp cannot run here: no CUDA device (or no driver) on this machine"
