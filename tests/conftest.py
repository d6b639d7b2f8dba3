"""Settings and fixtures of all tests. JAX runs on the CPU, and checks ranks and shapes strictly. Tests that need a GPU
are skipped without CUDA."""

from __future__ import annotations

import functools
import gc
import importlib.metadata
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import jaxtyping
import pytest

pytest_plugins = ("support.browser",)

XLA_CPU_FLAGS = {
    # With the concurrency-optimised scheduler on, programs of the mjx-jax engine hang in XLA's thread pool (jaxlib
    # 0.10.2, two cores: 7 runs of 7; with it off 0 of 4).
    "--xla_cpu_enable_concurrency_optimized_scheduler": "false",
    # Most programs run for a moment, and take longer to compile. Without optimisation, the tests of mjx-jax and of
    # petmjx.jax take half to two thirds of the CPU time.
    "--xla_backend_optimization_level": "0",
}

if importlib.metadata.version("jaxlib").startswith("0.10."):
    # Programs of the tests run for a moment and take long to compile: a program of mjx-jax 28 s of CPU time with XLA's
    # newer emitters of fused loops, and 18 s with those before them. XLA ends a process that names a flag which its
    # release does not have.
    XLA_CPU_FLAGS["--xla_cpu_use_fusion_emitters"] = "false"

# before anything imports jax
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
if os.environ.get("PETMJX_TEST_GPU") != "1":
    os.environ["JAX_PLATFORMS"] = "cpu"
    given = os.environ.get("XLA_FLAGS", "")
    added = [f"{flag}={value}" for flag, value in XLA_CPU_FLAGS.items() if flag not in given]
    os.environ["XLA_FLAGS"] = " ".join([given, *added]).strip()

# Processes that tests start import petmjx from bytecode. Without bytecode, each of these processes takes a quarter of a
# second longer.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Runs of tests need not outlive a power failure, and a test with a hundred small runs waits for the disk for seconds.
os.fsync = lambda descriptor: None

# Tests of hypothesis draw the same examples on each machine, and have no deadline, however slow the machine is.
if importlib.util.find_spec("hypothesis") is not None:
    from hypothesis import HealthCheck, settings

    settings.register_profile("petmjx", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("petmjx")

# Whatever a shell starts in the background ignores Ctrl-C, and after nohup also SIGHUP. Without the next lines, all
# processes that tests start would ignore these signals, too.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Programs of tests that make no engine are kept, too: where petmjx keeps its own, for all processes and later runs.
CACHE = Path(os.environ.get("PETMJX_CACHE_DIR") or Path.home() / ".cache" / "petmjx")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# MJX would import MuJoCo Warp with all its kernels, which no test uses: 0.7 s of CPU time in each test process.
sys.modules["mujoco.mjx.third_party.mujoco_warp"] = None  # type: ignore[assignment]

SHAPE_CHECKED = (
    "petmjx.engines.mjx",
    "petmjx.engines.warp.engine",
    "petmjx.engines.warp.time_slices",
)
"""Packages and modules whose annotations hold at every call, shapes included. Not those with Warp kernels: Warp
parses their source."""

SHAPES_ARE_CHECKED = importlib.util.find_spec("beartype") is not None

# before anything imports petmjx
if SHAPES_ARE_CHECKED:
    jaxtyping.install_import_hook(SHAPE_CHECKED, "beartype.beartype")


def pytest_report_header() -> str:
    if SHAPES_ARE_CHECKED:
        return f"shapes: checked in {', '.join(SHAPE_CHECKED)}"
    return "shapes: not checked, beartype is not installed (extra: dev)"


@functools.cache
def why_no_cuda() -> str:
    """Why GPU tests cannot run on this machine; empty if they can."""
    if os.environ.get("PETMJX_TEST_GPU") != "1":
        return "GPU tests run with PETMJX_TEST_GPU=1 on a machine with CUDA"
    if shutil.which("nvidia-smi") is None:
        return "no CUDA device: nvidia-smi is not installed"
    listing = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, check=False)
    return "" if "GPU" in listing.stdout else "no CUDA device: nvidia-smi lists none"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Exclude all imported objects from garbage collection, now and later. To search them for garbage took a seventh of
    the time in which pytest collects tests."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """After each file of tests, exclude the remaining objects from garbage collection. JAX keeps its compiled programs,
    and a single search among them for garbage takes up to ten seconds."""
    if nextitem is None or nextitem.path != item.path:
        gc.collect()
        gc.freeze()


LONGEST_FIRST = (
    "test_option_types",
    "test_warp_batch_independence",
    "test_doc_examples",
    "test_extending_recipes",
    "test_further_forms",
    "test_worker_pool",
    "test_traces",
    "test_resume",
    "test_mjx_rules",
    "test_repair",
    "test_parity",
    "test_careful_reading",
    "test_report_page",
    "test_story_page",
    "test_chains",
    "test_mjx_robustness",
    "test_confidence",
    "test_warp_step",
    "test_sweep_runs",
    "test_examples",
    "test_jax_palletizing",
    "test_worker_signals",
    "test_jax_loop",
    "test_warp_failures",
    "test_rocking",
    "test_open_worlds",
    "test_placements_on_all_engines",
    "test_mjx_twin",
    "test_damaged_input",
    "test_mjx_warp",
    "test_warp_cpu",
    "test_stiffness",
    "test_notebooks",
    "test_benchmarks",
    "test_other_tools",
    "test_no_hidden_state",
    "test_commands",
    "test_bodies",
    "test_sweep_drives",
    "test_pallets",
    "test_warp_tail_blocks",
    "test_labels",
    "test_packer_rating",
    "test_gym",
    "test_score",
    "test_conventions",
    "test_histories",
    "test_overwrite_guard",
    "test_warp_stiff",
    "test_soft",
    "test_toppling",
    "test_physical_packer",
    "test_pictures",
    "test_slip",
)
"""Files that take longest, 50 to 4 s of CPU time, also of browsers and of processes that are started. With several test
processes (``make test``) each takes the next file when it is through with one. A long file that comes last leaves the
others idle."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))
    for item in items:
        if item.get_closest_marker("gpu") and (reason := why_no_cuda()):
            # The reason is what why_no_cuda found missing here.
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages name files as given; tests give short relative names."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root folder."""
    return Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def cache_folder() -> Path:
    """The folder of what is kept for later test runs, as programs are."""
    return CACHE


@pytest.fixture(scope="session")
def real_data(repository: Path) -> Path:
    """A folder of real plans and orders, which are not part of the repository."""
    folder = repository.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real plans and orders do not lie beside this checkout")
    return folder
