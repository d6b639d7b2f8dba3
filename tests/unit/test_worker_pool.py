"""Runs in workers: the tables equal those of a run without workers, also if workers die, and the process keeps its
global state."""

from __future__ import annotations

import ctypes
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.equal_runs import GRID, PLANS, SEARCH, assert_same, tables
from support.fake_stepper import fake_scene
from support.plans import make_plan, stack

import petmjx
from petmjx.common.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.job_stream import JobStream
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.remote import ray_cluster as cluster_module
from petmjx.engines.remote import worker_pool as pool_module
from petmjx.engines.remote.ray_actor import Recipe
from petmjx.engines.remote.ray_cluster import Cluster
from petmjx.engines.remote.worker_pool import WorkerPool
from petmjx.engines.remote.worker_resources import WorkerResources
from petmjx.engines.verdict import Reason
from petmjx.options.simulation import Simulation
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
    """One Ray cluster with two CPUs for all tests, whatever this machine has. Starting the cluster changes nothing
    global."""
    before = process_state()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("petmjx.engines.remote.ray_cluster.cpu_threads", lambda: 2)
        cluster = Cluster()
    assert process_state() == before
    yield
    close_pool()
    cluster.close()
    assert process_state() == before
    assert not ray.is_initialized()


_kept: list[WorkerPool] = []
"""The pool of the tests that leave it usable, since a worker takes a second of a core to start."""


def close_pool() -> None:
    while _kept:
        _kept.pop().close()


@pytest.fixture
def pool() -> WorkerPool:
    """Two workers, which take both CPUs of the cluster."""
    if not _kept:
        _kept.append(WorkerPool(MUJOCO, [WorkerResources(1), WorkerResources(1)], Cluster()))
    return _kept[0]


@pytest.fixture
def free_cluster() -> None:
    """For tests that start other workers."""
    close_pool()


@pytest.fixture
def lost_pool(free_cluster: None, pool: WorkerPool) -> Iterator[WorkerPool]:
    """Two workers for a test after which the pool starts no more workers."""
    yield pool
    close_pool()


class Killer:
    """A watcher that kills a worker each time that this number of worlds has ended, but not more than two workers."""

    def __init__(self, pool: WorkerPool, every: int) -> None:
        self.pool, self.every, self.done, self.killed = pool, every, 0, 0

    def begin(self, start: object) -> None: ...

    def world_done(self, world: object) -> None:
        self.done += 1
        if self.done % self.every == 0 and self.pool.pids and self.killed < 2:
            os.kill(self.pool.pids[0], signal.SIGKILL)
            self.killed += 1


def run(kind: str, folder: Path, **options: Any) -> petmjx.RunResults:
    if kind == "score":
        return petmjx.score(PLANS[:20], out=folder / "out", **options)
    file = folder / f"{kind}.toml"
    file.write_text({"grid": GRID, "search": SEARCH}[kind])
    return petmjx.sweep(file, PLANS[4:7], out=folder / "out", **options)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, petmjx.RunResults]:
    """Kind → a run in one process."""
    kinds = ("grid", "search")
    return {kind: run(kind, tmp_path_factory.mktemp("alone"), engine=MujocoEngine(1)) for kind in kinds}


@pytest.mark.usefixtures("free_cluster")
def test_tables_are_those_of_a_run_without_workers(alone: dict[str, petmjx.RunResults], tmp_path: Path) -> None:
    shared = run("grid", tmp_path, engine="mujoco", workers=2, threads=1)
    assert_same(shared, tables(alone["grid"]))
    assert shared.info["config"]["engine_reason"] == "as asked for, in 2 workers"
    assert shared.info["device"].startswith("2 workers: ")
    assert shared.info["device"].endswith(", 1 thread")
    assert (shared.info["config"]["workers"], shared.info["config"]["ray"]) == (2, None)


def wait_for_two(pool: WorkerPool) -> None:
    """Wait until both workers are ready. A worker that does not become ready is killed and started again: Ray once lost
    the start of a worker, and had not found it after 11 minutes. A run would continue with the other worker."""
    for _ in range(3):
        deadline = time.monotonic() + 40.0
        while len(pool.pids) < 2 and time.monotonic() < deadline:
            for worker, ref in pool._news():
                pool._greet(worker, ref)
        for lost in [worker for worker in pool._workers if not worker.ready]:
            pool._kill(lost)
            pool._workers[pool._workers.index(lost)] = pool._start(lost.resources)
        if len(pool.pids) == 2:
            return
    pytest.fail("no second worker got ready")


@pytest.mark.filterwarnings("ignore:.*kg/m³")
@pytest.mark.usefixtures("free_cluster")
def test_workers_with_kernels_give_the_tables_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drives (motions of the carrier) start from settled states, which may come from the other worker. Piles whose
    contacts are too soft are placed again in stiffer contacts, among the other worlds. In the second run, jobs are
    dealt to workers as if the engines were devices."""
    heavy = stack(2, size_mm=(400, 300, 200), kg=(0.02, 300.0))
    plans = [
        *PLANS[4:6],
        make_plan("stands", heavy),
        make_plan("tips", (*heavy, ((400, 300, 200), (220, 0, 400), 5.0))),
    ]
    assert "[0.8, 1.0]" in GRID
    (file := tmp_path / "sweep.toml").write_text(GRID.replace("[0.8, 1.0]", "[0.8]"))
    alone = petmjx.sweep(file, plans, engine="mjx-warp-cpu", threads=1)
    pool = WorkerPool(Recipe("mjx-warp-cpu", {"threads": 1}), [WorkerResources(1), WorkerResources(1)], Cluster())
    try:
        wait_for_two(pool)
        for least in ({}, {"mjx-warp-cpu": 1}):
            monkeypatch.setattr(pool_module, "LEAST", least)
            shared = petmjx.sweep(file, plans, engine=pool)
            assert_same(shared, tables(alone))
            assert set(shared.attempts.attempt) == {1, 6}
            assert set(shared.attempts.engine) == {"mjx-warp-cpu"}
    finally:
        pool.close()


@pytest.mark.usefixtures("free_cluster")
@pytest.mark.gpu
@pytest.mark.parametrize("kind", ["score", "grid", "search"])
def test_gpu_workers_give_the_tables_of_one_process(kind: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    alone = run(kind, tmp_path_factory.mktemp("alone"), engine="mjx-warp")
    shared = run(kind, tmp_path_factory.mktemp("shared"), engine="mjx-warp", workers="auto")
    assert_same(shared, tables(alone))


def test_a_search_in_workers_is_that_of_a_run_without_them(
    pool: WorkerPool, alone: dict[str, petmjx.RunResults], tmp_path: Path
) -> None:
    assert_same(run("search", tmp_path, engine=pool), tables(alone["search"]))


@pytest.mark.parametrize("least", [None, 1])
def test_workers_that_are_killed_change_no_table(
    least: int | None,
    pool: WorkerPool,
    alone: dict[str, petmjx.RunResults],
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """``least``: if a number, jobs are dealt as to devices. Of the worlds of the grid, drives follow from placements,
    and placements from no other world."""
    monkeypatch.setattr(pool_module, "LEAST", {} if least is None else {"mujoco": least})
    killer = Killer(pool, every=8 if least is None else 12)  # a world whose workers die three times would be blamed
    shared = run("grid", tmp_path_factory.mktemp("shared"), engine=pool, watcher=killer)
    assert killer.killed >= 1
    assert_same(shared, tables(alone["grid"]))


def test_jobs_are_simulated_as_they_come(pool: WorkerPool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs that follow from outcomes are simulated while the source still makes jobs. ``least``: if a number, jobs are
    dealt as to devices."""
    for least in (None, 1, 10):
        monkeypatch.setattr(pool_module, "LEAST", {} if least is None else {"mujoco": least})
        stream = JobStream[str](feedback=True, begin_with=2)
        for tag in ("a", "b"):
            stream.put(Job(fake_scene(1.0)), tag, bounded=True)
        tags = []
        for outcome in pool.run(stream, SHORT):
            tags.append(tag := stream.answered(outcome.job))
            if len(tag) < 3:
                stream.put(Job(fake_scene(1.0, 2.0)), tag + "'")
            if tag == "b''":
                stream.put(Job(fake_scene(3.0)), "c", bounded=True)
                stream.close()
                stream.put(Job(fake_scene(3.0)), "d''")
        assert sorted(tags) == ["a", "a'", "a''", "b", "b'", "b''", "c", "c'", "c''", "d''"]
        assert not stream.in_flight


class _Deadly:
    """An object that ends the process in which it is unpickled."""

    def __reduce__(self) -> Any:
        return os._exit, (1,)


def test_only_the_world_that_kills_its_workers_is_invalid(pool: WorkerPool, capsys: pytest.CaptureFixture[str]) -> None:
    jobs = [Job(fake_scene(1.0, 10.0 + k)) for k in range(12)]
    jobs[5] = Job(jobs[5].scene, start=_Deadly())
    progress = Progress()
    outcomes = sorted(pool.run(jobs, SHORT, progress), key=lambda outcome: outcome.job)
    assert [outcome.job for outcome in outcomes] == list(range(12))
    assert [outcome.job for outcome in outcomes if outcome.reason is Reason.FAILED] == [5]
    assert outcomes[5].message == "this worker and earlier workers died, each while it simulated only this world"
    assert progress.worlds_done == 12
    # in its next attempt, the world is alone from the beginning: it kills one more worker, not two
    deaths = pool._deaths
    again = list(pool.run([jobs[5]], ATTEMPTS[1].apply_to_sim(SHORT)))
    assert again[0].reason is Reason.FAILED
    assert pool._deaths == deaths + 1
    assert capsys.readouterr().out == ""  # standard output has only results, no output of Ray about its workers


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


class _Unreadable:
    def __reduce__(self) -> Any:
        return int, ("no number",)


def test_an_error_in_a_worker_is_raised_here_and_leaves_the_pool_usable(pool: WorkerPool) -> None:
    with pytest.raises(RuntimeError, match=r"a worker failed: .*no number"):
        list(pool.run([Job(fake_scene(1.0), start=_Unreadable())], SHORT))
    assert len(list(pool.run([Job(fake_scene(1.0))], SHORT))) == 1


def test_a_place_where_no_worker_gets_ready_any_more_is_left(
    lost_pool: WorkerPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example, a GPU may have broken down."""
    wait_for_two(lost_pool)
    jobs = [Job(fake_scene(1.0, 10.0 + k)) for k in range(30)]
    outcomes = lost_pool.run(jobs, SHORT)
    next(outcomes)
    monkeypatch.setattr(lost_pool, "_recipe", Recipe("none"))
    monkeypatch.setattr(pool_module, "FALSE_STARTS", 1)
    os.kill(lost_pool.pids[0], signal.SIGKILL)
    assert len(list(outcomes)) == 29
    patience = time.monotonic() + 60.0  # a worker needs a second or two until it reports that it cannot start
    while len(lost_pool._resources) == 2 and time.monotonic() < patience:
        assert len(list(lost_pool.run(jobs * 8, SHORT))) == 240
    assert len(lost_pool._resources) == 1


@pytest.mark.usefixtures("free_cluster")
def test_a_ray_of_this_machine_that_has_died_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """For example, Ray's process may have been killed because memory was short. No worker can then be started any
    more."""
    pool = WorkerPool(MUJOCO, [WorkerResources(1)], Cluster())
    try:
        outcomes = pool.run([Job(fake_scene(1.0, 10.0 + k)) for k in range(30)], SHORT)
        next(outcomes)
        monkeypatch.setattr(pool_module, "START_S", 0.0)
        monkeypatch.setattr(Cluster, "nodes", [])
        os.kill(pool.pids[0], signal.SIGKILL)
        with pytest.raises(PetmjxError, match="Ray died on this machine"):
            list(outcomes)
    finally:
        pool.close()


def _ready(recipe: Recipe) -> None:
    pool = WorkerPool(recipe, [WorkerResources(1)], Cluster())
    try:
        pool.wait_for_first()
    finally:
        pool.close()


@pytest.mark.usefixtures("free_cluster")
def test_workers_that_cannot_start_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="unknown engine 'none'"):
        _ready(Recipe("none"))
    monkeypatch.setattr(pool_module, "package_versions", lambda: {"mujoco": "0.1"})
    with pytest.raises(EngineUnavailable, match=r"the worker on .* has mujoco .*, this process 0.1"):
        _ready(MUJOCO)


@pytest.mark.usefixtures("free_cluster")
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
        ({"workers": 1, "lanes": 16}, "lanes are an option of the engines mjx-jax and mjx-warp"),
        ({"ray": "ray://head:10001"}, "ray must be HOST:PORT of a cluster's head, or auto"),
        ({"ray": "head"}, "ray must be HOST:PORT of a cluster's head, or auto"),
        ({"ray": "127.0.0.1:1"}, "ray: this process is already in another cluster, so it cannot join 127.0.0.1:1"),
        ({"workers": 1, "engine": MujocoEngine(1)}, "workers need the name of an engine"),
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
