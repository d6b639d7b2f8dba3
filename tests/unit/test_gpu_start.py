"""Tests of the start of a GPU or of workers while plans are read. The GPU or the workers are started only if the run
will use them. An error is reported when the GPU or the workers are needed."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from petmjx.common.errors import InputError
from petmjx.common.machine import own_environment
from petmjx.engines import gpu_start, machine_speed
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.engine_warmup import WORTH_A_GPU, engine_warmup
from petmjx.engines.expected_work import Work
from petmjx.engines.remote import ray_cluster as of_clusters
from petmjx.engines.remote import worker_startup as of_workers
from petmjx.engines.remote.ray_actor import Recipe
from petmjx.engines.remote.worker_resources import Node
from petmjx.engines.subprocess import kernel_builds
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """An event that is set when kernels are compiled, after a GPU was started."""
    event = threading.Event()
    monkeypatch.setattr("petmjx.engines.engine_warmup.cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr("petmjx.engines.engine_warmup.start_gpu", lambda: None)
    monkeypatch.setattr("petmjx.engines.engine_warmup.begin_builds", lambda sim: None)
    monkeypatch.setattr("petmjx.engines.engine_warmup.compile_ahead", lambda sim, builds: event.set())
    return event


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"engine": "mjx-warp"}, True),
        ({"engine": "auto"}, True),
        ({"engine": "mujoco"}, False),
    ],
)
def test_it_starts_where_it_will_be_the_engine(
    options: dict[str, object], expected: bool, started: threading.Event, tmp_path: Path
) -> None:
    (tmp_path / "plans.json").write_bytes(b" " * WORTH_A_GPU)
    for plans in (tmp_path, [tmp_path / "plans.json"]):
        started.clear()
        with engine_warmup(RunOptions(**options), plans, Simulation()):
            pass
        assert started.wait(5 if expected else 0.1) is expected


def test_auto_starts_none_for_few_plans_or_without_one(
    started: threading.Event, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plans.json").write_text("{}")
    for plans in (tmp_path / "plans.json", tmp_path / "missing", None, 3, "\0"):
        with engine_warmup(RunOptions(), plans, Simulation()):
            pass
    monkeypatch.setattr("petmjx.engines.engine_warmup.cuda_devices", lambda: ())
    with engine_warmup(RunOptions(engine="mjx-warp"), tmp_path, Simulation()):
        pass
    assert not started.is_set()


def _join_starts() -> None:
    """Wait until no thread starts a GPU any more: such a thread would use what the next test replaces."""
    for name in ("petmjx-start", "petmjx-kernels"):  # the first thread starts the second
        for thread in threading.enumerate():
            if thread.name == name:
                thread.join()


def test_what_is_wrong_with_plans_is_not_held_up(monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr("petmjx.engines.engine_warmup.cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr("petmjx.engines.engine_warmup.start_gpu", released.wait)
    with pytest.raises(InputError, match="no such"), engine_warmup(RunOptions(engine="mjx-warp"), None, Simulation()):
        raise InputError("no such file")
    released.set()
    _join_starts()


def test_importing_the_engine_starts_no_device_of_jax_and_waits_for_no_mjx() -> None:
    """While the engine is imported, another thread starts JAX's devices, in such a way that JAX leaves memory for Warp.
    If the import came first, JAX would take three quarters of the GPU's memory. In this test, JAX has no device to
    start.

    The engine does not import ``mujoco.mjx``, since this import takes longer than everything else that a single plan
    needs on a GPU."""
    pytest.importorskip("warp")
    environment = own_environment() | {"JAX_PLATFORMS": "none"}
    code = """
import petmjx.engines.warp.engine, jax, sys
print("imported", *{"mujoco.mjx", "trimesh"} & set(sys.modules))
jax.devices()
"""
    ended = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (1, "imported\n"), ended.stderr
    assert "Unable to initialize backend" in ended.stderr


def test_a_gpu_that_does_not_start_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.engine_warmup.cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr(gpu_start.importlib, "import_module", lambda name: 1 / 0)
    with engine_warmup(RunOptions(engine="mjx-warp"), None, Simulation()):
        pass
    _join_starts()


def _launch_on(device: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("block_launch", "compiled_programs"):
        monkeypatch.setattr(f"petmjx.engines.warp.{module}.launch_device", lambda: device)


@pytest.fixture
def on_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """An empty cache, and a GPU for Warp. The fixture has the launches whose kernels were loaded."""
    programs = pytest.importorskip("petmjx.engines.warp.compiled_programs")
    loaded: list[object] = []
    _launch_on(SimpleNamespace(is_cuda=True, sm_count=132, max_shared_memory_per_block=227 << 10), monkeypatch)
    monkeypatch.setattr(programs, "load_kernels", loaded.extend)
    monkeypatch.setattr(kernel_builds, "cuda_limits", lambda: (90, 227 << 10))
    monkeypatch.setenv("PETMJX_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("WARP_CACHE_PATH", raising=False)
    return loaded


def test_kernels_that_are_loaded_are_noted(on_a_gpu: list[object]) -> None:
    gpu_start.compile_ahead(Simulation(), None)
    assert len(on_a_gpu) == 3
    assert kernel_builds.builds_if_missing(Simulation()) is None
    # estimates of time know it, too; runs with a hand, film or compliant boxes need other kernels
    starts_s = [
        machine_speed.with_kept_kernels(work).gpu_start_s
        for work in (
            Work(Simulation(), [9]),
            Work(Simulation(placing="hand"), [9]),
            Work(Simulation(), [9], drives=1, filmed=1.0),
            Work(Simulation(), [9], giving=[9]),
        )
    ]
    assert starts_s == [MEASURED.gpu_load_s] + 3 * [MEASURED.gpu_start_s]


@pytest.mark.parametrize("hindrance", ["the program ends", "JAX has no GPU"])
def test_kernels_that_are_not_loaded_are_not_noted(
    hindrance: str, on_a_gpu: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a false note, the next run would start no processes, and would compile the kernels itself."""
    monkeypatch.setattr(kernel_builds, "KernelBuilds", lambda builds: builds)
    if hindrance == "the program ends":
        ended = threading.Thread(target=lambda: None)
        monkeypatch.setattr(threading, "main_thread", lambda: ended)
    else:
        _launch_on(SimpleNamespace(is_cuda=False), monkeypatch)
    gpu_start.compile_ahead(Simulation(), None)
    assert not on_a_gpu
    assert kernel_builds.builds_if_missing(Simulation()) is not None


class _Cluster:
    """A mock of a cluster with two CPUs and two GPUs. Calls of its methods, and of pools on it, are recorded."""

    nodes: tuple[Node, ...] = (Node(2, 2),)

    def __init__(self, notes: queue.SimpleQueue[str]) -> None:
        self.said = notes
        notes.put("cluster")

    def close(self) -> None:
        self.said.put("closed")


class _Pool:
    size = 2

    def __init__(self, recipe: Recipe, resources: object, cluster: _Cluster, check_pool: int) -> None:
        self.name, self._cluster = recipe.name, cluster
        cluster.said.put(recipe.name)

    def wait_for_first(self) -> None:
        self._cluster.said.put("ready")

    def dismiss(self) -> None:
        self._cluster.said.put("dismissed")

    def close(self) -> None:
        self._cluster.close()


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> queue.SimpleQueue[str]:
    """The recorded calls of clusters and pools."""
    notes: queue.SimpleQueue[str] = queue.SimpleQueue()
    monkeypatch.setattr(of_workers, "Cluster", lambda address: _Cluster(notes))
    monkeypatch.setattr(of_workers, "WorkerPool", _Pool)
    return notes


def _heard(notes: queue.SimpleQueue[str], most: int) -> list[str]:
    return [notes.get(timeout=60.0) for _ in range(most)]


@pytest.mark.parametrize(
    ("engine", "size", "steps", "early", "later"),
    [
        ("mujoco", 0, 9, ["cluster", "mujoco"], ["ready"]),
        ("auto", WORTH_A_GPU, 10_000_000, ["cluster", "mjx-warp"], ["ready"]),
        ("auto", WORTH_A_GPU, 9, ["cluster", "mjx-warp"], ["dismissed", "mujoco", "ready"]),
        ("auto", 0, 9, ["cluster"], ["mujoco", "ready"]),
    ],
)
def test_workers_start_before_plans_are_read(
    engine: str, size: int, steps: int, early: list[str], later: list[str], said: queue.SimpleQueue[str], tmp_path: Path
) -> None:
    (tmp_path / "plans.json").write_bytes(b" " * size)
    options, work = RunOptions(engine=engine, workers=2), Work(Simulation(), [50] * max(steps // 1000, 1))
    with engine_warmup(options, tmp_path, Simulation()) as ahead:
        assert _heard(said, len(early)) == early
    pool, choice = of_workers.resolve_workers(options, work, MEASURED, ahead)
    assert _heard(said, len(later)) == later
    assert said.empty()
    assert pool.name == choice.name
    assert choice.reason.endswith("in 2 workers")


@pytest.mark.parametrize(
    ("workers", "name", "reason"),
    [(2, "mjx-warp", "about"), (5, "mujoco", "mjx-warp would be faster but cannot run: at most 4 workers share a GPU")],
)
def test_auto_lets_workers_share_a_gpu(
    workers: int, name: str, reason: str, said: queue.SimpleQueue[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_Cluster, "nodes", (Node(8, 1),))
    options, work = RunOptions(workers=workers), Work(Simulation(), [50] * 10_000)
    alone = MEASURED.seconds(work, threads=8, gpus=1)
    pool, choice = of_workers.resolve_workers(options, work, MEASURED)
    assert (pool.name, choice.seconds) == (name, alone[name])
    assert choice.reason.startswith(reason)


def test_workers_of_a_run_whose_plans_are_wrong_are_ended(said: queue.SimpleQueue[str]) -> None:
    with (
        pytest.raises(InputError, match="no such"),
        engine_warmup(RunOptions(engine="mujoco", workers=2), None, Simulation()),
    ):
        raise InputError("no such file")
    heard = [""]
    while heard[-1] != "closed":
        heard += _heard(said, 1)
    assert heard[1] == "cluster"


def test_what_workers_cannot_do_is_told_when_they_are_needed(said: queue.SimpleQueue[str]) -> None:
    for options, line in (
        ({"workers": 1, "lanes": 3}, "lanes are an option of"),
        ({"workers": 3}, "no room for 3 workers"),
    ):
        run_options = RunOptions(engine="mujoco", **options)
        with engine_warmup(run_options, None, Simulation()) as ahead:
            pass
        with pytest.raises(InputError, match=line):
            of_workers.resolve_workers(run_options, Work(Simulation(), [9]), MEASURED, ahead)
    assert _heard(said, 2) == ["cluster", "closed"]  # no pool is made: the options are checked first
    assert said.empty()


def test_threads_do_not_import_ray_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads do not import Ray at the same time. Each import changes and restores environment variables, so one
    thread would restore the changes of the other, and these would stay."""
    meets, met = threading.Barrier(2, timeout=0.2), []

    def importing(name: str) -> SimpleNamespace:
        with suppress(threading.BrokenBarrierError):
            met.append(meets.wait())
        return SimpleNamespace(is_initialized=lambda: True, get_runtime_context=lambda: SimpleNamespace(gcs_address=""))

    before = dict(os.environ)
    monkeypatch.setattr(of_clusters, "importlib", SimpleNamespace(import_module=importing))
    with ThreadPoolExecutor(2) as pool:
        for user in [pool.submit(of_clusters.Cluster) for _ in range(2)]:
            user.result().leave()
    assert not met
    assert dict(os.environ) == before
