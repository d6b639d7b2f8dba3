"""Runs in workers: the same tables as without, also if workers die, and a process that stays as it was."""

from __future__ import annotations

import ctypes
import logging
import os
import pickle
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from support.fake_stepper import fake_scene
from support.kills import GRID, PLANS, SEARCH, assert_same, tables
from support.plans import make_plan, make_world, stack

import petmjx
from petmjx.basics.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.basics.machine import cuda_devices
from petmjx.engines.attempts import ATTEMPTS
from petmjx.engines.base import Progress
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.engines.workers import actor
from petmjx.engines.workers import cluster as cluster_module
from petmjx.engines.workers import pool as pool_module
from petmjx.engines.workers.actor import Hello, Recipe, Report, Worker
from petmjx.engines.workers.cluster import Cluster
from petmjx.engines.workers.places import Place
from petmjx.engines.workers.pool import WorkerPool
from petmjx.options.config import Simulation
from petmjx.verdict import Outcome, Reason
from petmjx.world.job import Job

try:
    ray = cluster_module.import_ray()
except EngineUnavailable:
    pytest.skip("Ray is not installed (extra: ray)", allow_module_level=True)

SHORT = Simulation(interval_s=0.1, rest_window_s=0.1)
MUJOCO = Recipe("mujoco", {"threads": 1})


def process_state() -> tuple[Any, ...]:
    ours = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    at_sigterm = ctypes.create_string_buffer(1024)
    ctypes.CDLL(None).sigaction(int(signal.SIGTERM), None, at_sigterm)
    handler = at_sigterm.raw[: ctypes.sizeof(ctypes.c_void_p)]
    return ours, handler, signal.getsignal(signal.SIGTERM), sys.excepthook, logging.getLogger("ray").level


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """One cluster of two CPUs for all tests, whatever this machine has; starting it leaves no trace."""
    before = process_state()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("petmjx.engines.workers.cluster.cpu_threads", lambda: 2)
        cluster = Cluster()
    assert process_state() == before
    yield
    cluster.close()
    assert process_state() == before
    assert not ray.is_initialized()


@pytest.fixture
def pool() -> Iterator[WorkerPool]:
    pool = WorkerPool(MUJOCO, [Place(1), Place(1)], Cluster())
    yield pool
    pool.close()


class Killer:
    """A watcher that kills a worker when some worlds are done, each time so many more are."""

    def __init__(self, pool: WorkerPool, every: int) -> None:
        self.pool, self.every, self.done, self.killed = pool, every, 0, 0

    def begin(self, start: object) -> None: ...

    def world_done(self, world: object) -> None:
        self.done += 1
        if self.done % self.every == 0 and self.pool.pids:
            os.kill(self.pool.pids[0], signal.SIGKILL)
            self.killed += 1


def run(kind: str, folder: Path, **options: Any) -> petmjx.RunResults:
    if kind == "score":
        return petmjx.score(PLANS[:40], out=folder / "out", **options)
    file = folder / f"{kind}.toml"
    file.write_text({"grid": GRID, "search": SEARCH}[kind])
    return petmjx.sweep(file, PLANS[3:7], out=folder / "out", **options)


@pytest.mark.parametrize("kind", ["score", "grid", "search"])
def test_tables_are_those_of_a_run_without_workers(kind: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    alone = run(kind, tmp_path_factory.mktemp("alone"), engine="mujoco", threads=1)
    shared = run(kind, tmp_path_factory.mktemp("shared"), engine="mujoco", workers=2, threads=1)
    assert_same(shared, tables(alone))
    assert shared.info["config"]["engine_reason"] == "as asked for, in 2 workers"
    assert shared.info["device"].startswith("2 workers: ")
    assert shared.info["device"].endswith(", 1 thread")
    assert (shared.info["config"]["workers"], shared.info["config"]["ray"]) == (2, None)


@pytest.mark.gpu
@pytest.mark.parametrize("kind", ["score", "grid", "search"])
def test_gpu_workers_give_the_tables_of_one_process(kind: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    alone = run(kind, tmp_path_factory.mktemp("alone"), engine="mjx-warp")
    shared = run(kind, tmp_path_factory.mktemp("shared"), engine="mjx-warp", workers="auto")
    assert_same(shared, tables(alone))


@pytest.mark.parametrize("kind", ["score", "grid"])
def test_workers_that_are_killed_change_no_table(
    kind: str, pool: WorkerPool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    alone = run(kind, tmp_path_factory.mktemp("alone"), engine=MujocoEngine(1))
    killer = Killer(pool, every=15)
    shared = run(kind, tmp_path_factory.mktemp("shared"), engine=pool, watcher=killer)
    assert killer.killed >= 1
    assert_same(shared, tables(alone))


class _Deadly:
    """Kills the process into which it is unpickled."""

    def __reduce__(self) -> Any:
        return os._exit, (1,)


def test_only_the_world_that_kills_its_workers_is_invalid(pool: WorkerPool, capsys: pytest.CaptureFixture[str]) -> None:
    jobs = [Job(fake_scene(1.0, 10.0 + k)) for k in range(12)]
    jobs[5] = Job(jobs[5].scene, start=_Deadly())
    progress = Progress()
    outcomes = sorted(pool.run(jobs, SHORT, progress), key=lambda outcome: outcome.job)
    assert [outcome.job for outcome in outcomes] == list(range(12))
    assert [outcome.job for outcome in outcomes if outcome.reason is Reason.FAILED] == [5]
    assert outcomes[5].message == "the worker that simulated this world alone died, like others before"
    assert progress.worlds_done == 12
    # in its next attempt it is alone from the beginning
    began = time.monotonic()
    again = list(pool.run([jobs[5]], ATTEMPTS[1].apply_to_sim(SHORT)))
    assert again[0].reason is Reason.FAILED
    assert time.monotonic() - began < 20
    assert capsys.readouterr().out == ""  # only results belong there, not what Ray says of workers


def test_a_run_that_is_left_in_the_middle_leaves_the_pool_usable(pool: WorkerPool) -> None:
    jobs = [Job(fake_scene(1.0, 10.0 + k)) for k in range(6)]
    begun = pool.run(jobs, SHORT)
    next(begun)
    with pytest.raises(RuntimeError, match="engine mujoco is busy with another run"):
        next(pool.run(jobs, SHORT))
    begun.close()
    assert len(list(pool.run(jobs, SHORT))) == 6
    assert list(pool.run([], SHORT)) == []
    pids = pool.pids
    assert pids
    assert len(list(pool.run(jobs, SHORT))) == 6
    assert set(pids) <= set(pool.pids)


def wait_for_two(pool: WorkerPool) -> None:
    """Both workers are ready. Ray once lost the start of one, and had not found it after 11 minutes: such a worker is
    started again. A run goes on with the other one."""
    for _ in range(3):
        deadline = time.monotonic() + 40.0
        while len(pool.pids) < 2 and time.monotonic() < deadline:
            for hand, ref in pool._news():
                pool._greet(hand, ref)
        for lost in [hand for hand in pool._hands if not hand.ready]:
            pool._kill(lost)
            pool._hands[pool._hands.index(lost)] = pool._start(lost.place)
        if len(pool.pids) == 2:
            return
    pytest.fail("no second worker got ready")


def test_a_place_where_no_worker_gets_ready_any_more_is_left(pool: WorkerPool, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a GPU that has broken down."""
    wait_for_two(pool)
    jobs = [Job(fake_scene(1.0, 10.0 + k)) for k in range(30)]
    outcomes = pool.run(jobs, SHORT)
    next(outcomes)
    monkeypatch.setattr(pool, "_recipe", Recipe("none"))
    monkeypatch.setattr(pool_module, "FALSE_STARTS", 1)
    os.kill(pool.pids[0], signal.SIGKILL)
    assert len(list(outcomes)) == 29
    patience = time.monotonic() + 60.0  # a worker takes a second or two until it says that it cannot start
    while len(pool._places) == 2 and time.monotonic() < patience:
        assert len(list(pool.run(jobs * 8, SHORT))) == 240
    assert len(pool._places) == 1


def test_a_ray_of_this_machine_that_has_died_is_not_waited_for(
    pool: WorkerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when its process has been killed for memory: no worker can start any more."""
    outcomes = pool.run([Job(fake_scene(1.0, 10.0 + k)) for k in range(30)], SHORT)
    next(outcomes)
    monkeypatch.setattr(pool_module, "START_S", 0.0)
    monkeypatch.setattr(Cluster, "nodes", [])
    os.kill(pool.pids[0], signal.SIGKILL)
    with pytest.raises(PetmjxError, match="Ray died on this machine"):
        list(outcomes)


def _ready(recipe: Recipe) -> None:
    pool = WorkerPool(recipe, [Place(1)], Cluster())
    try:
        pool.wait_for_first()
    finally:
        pool.close()


class _Unreadable:
    def __reduce__(self) -> Any:
        return int, ("no number",)


def test_errors_in_workers_are_raised_here(pool: WorkerPool, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match=r"a worker failed: .*no number"):
        list(pool.run([Job(fake_scene(1.0), start=_Unreadable())], SHORT))
    pool.close()
    with pytest.raises(InputError, match="unknown engine 'none'"):
        _ready(Recipe("none"))
    monkeypatch.setattr(pool_module, "package_versions", lambda: {"mujoco": "0.1"})
    with pytest.raises(EngineUnavailable, match=r"the worker on .* has mujoco .*, this process 0.1"):
        _ready(MUJOCO)


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
    hello: Hello = pickle.loads(worker.hello())
    assert (hello.pid, hello.error) == (os.getpid(), None)
    chunk = pickle.dumps(([Job(fake_scene(1.0))] * 2, SHORT))
    reports: list[Report] = [pickle.loads(report) for report in worker.simulate(chunk)]
    assert sorted(outcome.job for report in reports for outcome in report.outcomes) == [0, 1]
    assert reports[-1].progress.world_steps > 0
    broken: Any = _Broken()
    worker._built = Future()
    worker._built.set_result(broken)
    told: list[Report] = [pickle.loads(report) for report in worker.simulate(chunk)]
    assert told[0].progress.message == "compiling"
    assert isinstance(told[-1].error, KeyboardInterrupt)
    broken.error = _Unpicklable(1, 2)
    told = [pickle.loads(report) for report in worker.simulate(chunk)]
    assert repr(told[-1].error) == "RuntimeError('_Unpicklable: 1 and 2')"


def test_processes_beside_a_worker_look_at_the_outcomes_of_large_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(actor, "LARGE", 3)
    worker = Worker(MUJOCO, None, 1, lookers=1)
    alone = Worker(MUJOCO, None, 1)
    for each in (worker, alone):
        each.hello()
    for count in (2, 3, 3):
        chunk = pickle.dumps(([make_world(make_plan(boxes=stack(1 + k))).job for k in range(count)], SHORT))
        beside, here = (
            {outcome.job: outcome for report in each.simulate(chunk) for outcome in pickle.loads(report).outcomes}
            for each in (worker, alone)
        )
        assert sorted(beside) == sorted(here) == list(range(count))
        for job, outcome in beside.items():
            assert (outcome.margin, outcome.rest_edge_m) == (here[job].margin, here[job].rest_edge_m)
            assert outcome.rest_edge_m > 0
        assert (worker._lookers is None) == (count == 2)
    assert alone._lookers is None
    assert worker._lookers is not None
    worker._lookers.close()


def test_auto_counts_what_the_cluster_has(tmp_path: Path) -> None:
    shared = petmjx.score(PLANS[:4], workers="auto")
    reason = shared.info["config"]["engine_reason"]
    assert reason.startswith("about 0 s on 2 CPU threads, a GPU would need")
    assert reason.endswith("in 1 worker")
    with pytest.raises(EngineUnavailable, match="mjx-warp cannot run here: there are 2 CPUs and 0 GPUs"):
        petmjx.score(PLANS[:4], engine="mjx-warp", workers="auto")


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"workers": 3}, "workers: no room for 3 workers of 1 CPU; there are 2 CPUs and 0 GPUs"),
        ({"workers": 0}, "workers must be auto or a whole number from 1 to 4,096, got 0"),
        ({"workers": "many"}, "workers must be auto or a whole number from 1 to 4,096, got 'many'"),
        ({"workers": True}, "workers must be auto"),
        ({"workers": 1, "lanes": 16}, "lanes belong to the engines mjx-jax and mjx-warp"),
        ({"ray": "ray://head:10001"}, "ray must be HOST:PORT of a cluster's head, or auto"),
        ({"ray": "head"}, "ray must be HOST:PORT of a cluster's head, or auto"),
        ({"ray": "127.0.0.1:1"}, "ray: this process is in another cluster already, 127.0.0.1:1 cannot be joined"),
        ({"workers": 1, "engine": MujocoEngine(1)}, "workers need an engine by name"),
    ],
)
def test_what_cannot_be_is_refused_before_a_folder_is_touched(
    options: dict[str, Any], line: str, tmp_path: Path
) -> None:
    petmjx.score(PLANS[:2], out=tmp_path, engine="mujoco")
    with pytest.raises(InputError) as error:
        petmjx.score(PLANS, out=tmp_path, overwrite=True, **({"engine": "mujoco"} | options))
    assert str(error.value).startswith(line)
    assert len(petmjx.load_run(tmp_path).worlds) == 2


@pytest.mark.parametrize(
    ("says", "line"),
    [(None, "no answer within 0.2 s"), (b"HTTP/1.1 400 Bad", "not the head of a Ray cluster"), (b"", "not the head")],
)
def test_what_listens_but_is_no_head_is_refused(says: bytes | None, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "REACH_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        if says is not None:

            def answer() -> None:
                caller, _ = server.accept()
                with caller:
                    caller.recv(1000)
                    caller.sendall(says)

            threading.Thread(target=answer, daemon=True).start()
        with pytest.raises(InputError, match=rf"^ray: no cluster at 127\.0\.0\.1:\d+ \(.*{line}"):
            cluster_module._check_reachable(f"127.0.0.1:{server.getsockname()[1]}")


def test_the_head_of_a_cluster_is_known() -> None:
    cluster_module._check_reachable(ray.get_runtime_context().gcs_address)


def test_without_ray_a_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(EngineUnavailable, match=r"Ray is not installed: pip install 'petmjx\[ray\]'"):
        petmjx.score(PLANS[:2], engine="mujoco", workers=1)


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU, as far as a worker asks before it builds its engine."""
    monkeypatch.setattr(actor, "why_no_warp_at_once", lambda: None)


@pytest.mark.usefixtures("gpu")
def test_the_engine_of_a_gpu_is_built_while_jobs_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def start() -> None:
        begun.set()
        assert may_end.wait(20.0)

    monkeypatch.setattr(actor, "start_gpu", start)
    monkeypatch.setattr(actor, "make_engine", lambda name: MujocoEngine(1))
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
    """Not as an error of the engine, for which others would stand in."""

    def fail(name: str) -> None:
        raise error

    monkeypatch.setattr(actor, "start_gpu", lambda: None)
    monkeypatch.setattr(actor, "make_engine", fail)
    worker = Worker(Recipe("mjx-warp"), None, 1, thorough=thorough)
    hello: Hello = pickle.loads(worker.hello())
    [report] = worker.simulate(pickle.dumps(([Job(fake_scene(1.0))], SHORT)))
    for told in [pickle.loads(report).error, *([hello.error] if thorough else [])]:
        assert isinstance(told, EngineUnavailable)
        assert str(error) in str(told)
    assert thorough == (hello.error is not None)


def test_a_worker_without_a_gpu_says_so_before_jobs_are_made() -> None:
    if cuda_devices():
        pytest.skip("this is a GPU")
    hello: Hello = pickle.loads(Worker(Recipe("mjx-warp"), None, 1, thorough=False).hello())
    assert str(hello.error) == "engine mjx-warp cannot run here: no CUDA device (or no driver) on this machine"
