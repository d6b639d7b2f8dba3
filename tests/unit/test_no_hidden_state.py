"""Importing petmjx, building engines and scoring change nothing global in the process, also when several threads score
at the same time."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import mujoco
import pandas as pd
import pytest
from support.fake_stepper import FakeEngine, assert_same, fake_scene, run_all

import petmjx
from petmjx.common.machine import cpu_threads, jax_devices
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.options.simulation import Simulation
from petmjx.plans.bundled import bundled_path
from petmjx.world.job import Job

THREADS = 4
PREALLOCATE = "XLA_PYTHON_CLIENT_PREALLOCATE"
SHORT = Simulation(interval_s=0.1, rest_window_s=0.1)

BUILD = """
import os, sys
missing = sys.argv[1:]
for name in missing:
    sys.modules[name] = None
import jax, mujoco
before = dict(os.environ), sys.stdout, list(sys.meta_path), mujoco.MjLogConfig.get().logto_console
from petmjx.engines.engine_registry import make_engine
make_engine("mujoco")
make_engine("mjx-jax", lanes=16)
if not missing:
    from petmjx.engines.warp.engine import MjxWarpEngine
    MjxWarpEngine(16, allow_cpu=True)
    MjxWarpEngine(16, allow_cpu=True)
assert before == (dict(os.environ), sys.stdout, list(sys.meta_path), mujoco.MjLogConfig.get().logto_console)
print("this alone")
"""


def in_threads(task: Callable[[int], Any], threads: int = THREADS) -> list[Any]:
    """Run a task in several threads that begin at the same moment, and return their results."""
    together = threading.Barrier(threads)

    def begin(number: int) -> Any:
        together.wait()
        return task(number)

    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(begin, range(threads)))


@pytest.mark.parametrize("missing", [["warp"], []], ids=["without Warp", "with Warp"])
def test_importing_and_building_engines_leaves_no_trace(missing: list[str]) -> None:
    if not missing:
        pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    command = [sys.executable, "-c", BUILD, *missing]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop(PREALLOCATE, None)
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "this alone\n"


@pytest.mark.parametrize("users", [None, "true"])
def test_device_memory_is_left_to_warp_unless_the_user_wants_otherwise(
    users: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    monkeypatch.setattr(jax, "devices", lambda _: seen.append(os.environ.get(PREALLOCATE)) or [])
    if users is None:
        monkeypatch.delenv(PREALLOCATE, raising=False)
    else:
        monkeypatch.setenv(PREALLOCATE, users)
    jax_devices()
    assert seen == [users or "false"]
    assert os.environ.get(PREALLOCATE) == users


def test_mujoco_has_as_many_threads_as_the_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert MujocoEngine().threads == cpu_threads() == 3


def test_scoring_from_several_threads(capsys: pytest.CaptureFixture[str]) -> None:
    plans = sorted(petmjx.load_plans(bundled_path()).plans, key=lambda plan: plan.n_boxes)[7 : 7 + 2 * THREADS]
    assert (plans[0].n_boxes, plans[-1].n_boxes) == (3, 16)
    parts = [plans[number::THREADS] for number in range(THREADS)]

    def score(number: int) -> tuple[pd.DataFrame, pd.DataFrame]:
        run = petmjx.score(parts[number], engine="mujoco", threads=1)
        timings = [name for name in run.worlds if name.startswith(("wall", "compute"))]
        return run.worlds.drop(columns=timings), run.boxes

    stdout, logged = sys.stdout, mujoco.MjLogConfig.get().logto_console
    expected = [score(number) for number in range(THREADS)]
    for tables, alone in zip(in_threads(score), expected, strict=True):
        for table, same in zip(tables, alone, strict=True):
            pd.testing.assert_frame_equal(table, same, check_exact=True)
    assert sys.stdout is stdout
    assert mujoco.MjLogConfig.get().logto_console == logged
    print("still heard")
    assert capsys.readouterr().out.endswith("still heard\n")


def test_mujoco_is_silent_until_the_last_run_is_over() -> None:
    def heard() -> bool:
        return bool(mujoco.MjLogConfig.get().logto_console)

    before = heard()
    jobs = [Job(fake_scene(1.0))] * 4
    first, second = (MujocoEngine(1).run(jobs, SHORT) for _ in range(2))
    next(first)
    next(second)
    first.close()
    assert not heard()
    second.close()
    assert heard() == before


def test_threads_take_turns_with_one_batched_engine() -> None:
    engine = FakeEngine()
    jobs = [Job(fake_scene(1.0, mass)) for mass in (10.0, 40.0, 70.0)]

    def run(_: int) -> Any:
        with jax.numpy_rank_promotion("allow"):
            return run_all(engine, jobs, SHORT)

    expected = run(0)
    for outcomes in in_threads(run, 2):
        for outcome, alone in zip(outcomes, expected, strict=True):
            assert_same(outcome, alone)
    assert len(engine.programs) == 1


def test_a_batched_engine_in_the_middle_of_a_run_says_so() -> None:
    engine = FakeEngine(1)
    jobs = [Job(fake_scene(1.0))] * 2
    with jax.numpy_rank_promotion("allow"):
        begun = engine.run(jobs, SHORT)
        next(begun)
        with pytest.raises(RuntimeError, match="engine fake is busy with another run of this thread"):
            next(engine.run(jobs, SHORT))
        begun.close()
        assert len(run_all(engine, jobs, SHORT)) == 2


def test_warp_settings_of_the_user_win(monkeypatch: pytest.MonkeyPatch) -> None:
    warp = pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    from petmjx.common.compile_caches import cache_folder
    from petmjx.common.warp_setup import set_up_warp

    monkeypatch.delenv("WARP_CACHE_PATH", raising=False)
    warp.init()  # when Warp starts, it appends its version to the path of its cache folder
    for users, folder in ((None, str(cache_folder("warp"))), ("mine", "mine")):
        monkeypatch.setattr(warp.config, "kernel_cache_dir", users)
        set_up_warp()
        set_up_warp()
        assert warp.config.kernel_cache_dir == folder
    for users, level in ((warp.LOG_INFO, warp.LOG_ERROR), (warp.LOG_DEBUG, warp.LOG_DEBUG)):
        monkeypatch.setattr(warp.config, "log_level", users)
        set_up_warp()
        assert warp.config.log_level == level


def test_the_cache_of_programs_is_where_the_user_has_it() -> None:
    from petmjx.common.compile_caches import cache_folder
    from petmjx.engines.mjx.jax_setup import MIN_COMPILE_S, set_up_jax

    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    config: Any = jax.config
    before = {name: getattr(config, name) for name in names}
    try:
        for users, expected in (("mine", ("mine", 7.0)), (None, (str(cache_folder("jax")), MIN_COMPILE_S))):
            for name, value in zip(names, (users, 7.0), strict=True):
                config.update(name, value)
            set_up_jax()
            assert tuple(getattr(config, name) for name in names) == expected
    finally:
        for name, value in before.items():
            config.update(name, value)
