"""Tests of time estimates for this machine. The speed of the machine is measured if it matters, and estimated CPU times
are scaled accordingly. Kernels that it has compiled before start sooner."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from petmjx.common import compile_caches
from petmjx.common.errors import EngineUnavailable
from petmjx.engines import kernel_notes, machine_speed
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.engine_choice import Choice
from petmjx.engines.engine_of_run import resolve_engine
from petmjx.engines.expected_work import Work
from petmjx.engines.kernel_notes import CPU_KERNEL, are_noted, note_kernels
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Verdict
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

SIM = Simulation()
SHORT, LONG = Work(SIM, [5]), Work(SIM, [40] * 1000)
LOADED = replace(MEASURED, kernel_start_s=MEASURED.kernel_load_s)


@pytest.fixture(autouse=True)
def no_kernels(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A new folder for compiled programs."""
    monkeypatch.delenv(compile_caches.VARIABLES["warp"], raising=False)
    monkeypatch.setenv("PETMJX_CACHE_DIR", str(tmp_path))
    return tmp_path / "warp"


def test_times_of_cpus_grow_with_the_factor_and_those_of_gpus_do_not() -> None:
    work = Work(
        Simulation(carrier="epal-1"), [40] * 9, placements=3, displaced=1, drives=4, drive_steps=700, filmed=1.0
    )
    usual, slow = MEASURED.seconds(work, 2), MEASURED.slowed(3.0).seconds(work, 2)
    times = {name: slow[name] / usual[name] for name in usual}
    assert times == pytest.approx({"mujoco": 3.0, "mjx-warp-cpu": 3.0, "mjx-jax": 3.0, "mjx-warp": 1.0})


def test_only_runs_of_some_seconds_are_worth_a_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_speed, "slowness", lambda: 2.5)
    assert machine_speed.costs_here(SHORT, 1) is MEASURED
    assert machine_speed.costs_here(LONG, 1) == MEASURED.slowed(2.5)
    _, choice = resolve_engine(RunOptions(engine="mujoco", threads=1), LONG)
    assert choice == Choice("mujoco", "as asked for", MEASURED.slowed(2.5).seconds(LONG, 1)["mujoco"])


def test_a_kernel_of_an_earlier_run_starts_sooner(monkeypatch: pytest.MonkeyPatch, no_kernels: Path) -> None:
    usual, by_hand = Work(SIM, [5]), Work(Simulation(placing="hand"), [5])
    assert machine_speed.costs_here(usual, 1) == MEASURED
    note_kernels(CPU_KERNEL)
    for work in (usual, by_hand, Work(SIM, [5], giving=[2]), Work(SIM, [5], drives=1, filmed=1.0)):
        assert machine_speed.costs_here(work, 1) == LOADED
    # the kernels of another version are other kernels
    real_code = kernel_notes.kernel_code
    monkeypatch.setattr(kernel_notes, "kernel_code", lambda: "other")
    assert machine_speed.costs_here(usual, 1) == MEASURED
    monkeypatch.setattr(kernel_notes, "kernel_code", real_code)
    for note in no_kernels.iterdir():
        note.unlink()
    assert machine_speed.costs_here(usual, 1) == MEASURED


def test_where_nothing_can_be_written_nothing_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(kind: str) -> Path:
        raise EngineUnavailable("no folder for compiled programs")

    monkeypatch.setattr(kernel_notes, "cache_folder", refuse)
    note_kernels(CPU_KERNEL)
    assert machine_speed.costs_here(SHORT, 1) is MEASURED


def test_an_engine_notes_the_kernels_that_it_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("warp")
    from petmjx.engines.warp import block_launch, block_sizes

    launch = block_launch.Launch.of(block_sizes.SIZES[0], block_launch.Features(hands=True))
    monkeypatch.setattr(block_launch.wp, "force_load", lambda *_, **__: None)
    monkeypatch.setattr(block_launch, "kernel", lambda launch: block_launch.pause)
    block_launch.load_kernels([launch])
    assert are_noted(CPU_KERNEL) != block_launch.launch_device().is_cuda


@pytest.mark.parametrize(
    ("seconds", "factor"), [(1.0, 2.0), (100.0, machine_speed.SLOWEST), (0.0, machine_speed.FASTEST)]
)
def test_the_fastest_round_counts_within_bounds(seconds: float, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = iter([seconds * machine_speed.REFERENCE_S * 2.0, seconds * machine_speed.REFERENCE_S * 3.0])
    monkeypatch.setattr(machine_speed, "block_s", lambda: next(rounds))
    machine_speed.slowness.cache_clear()
    try:
        assert machine_speed.slowness() == pytest.approx(factor)
    finally:
        machine_speed.slowness.cache_clear()


@pytest.mark.parametrize(
    ("content", "age_s", "expected"),
    [
        ("2.5", 60.0, 2.5),
        ("2.5", machine_speed.KEPT_S + 60.0, 1.5),  # too old
        ("2.5", -3600.0, 1.5),  # the clock has been set back
        ("99.0", 60.0, 1.5),  # no machine is so slow
        ("nan", 60.0, 1.5),
        ("2,5", 60.0, 1.5),
    ],
)
def test_a_recent_measurement_is_kept(
    content: str, age_s: float, expected: float, monkeypatch: pytest.MonkeyPatch, no_kernels: Path
) -> None:
    seconds = [1.0 * machine_speed.REFERENCE_S]
    monkeypatch.setattr(machine_speed, "block_s", lambda: seconds[0])
    try:
        machine_speed.slowness.cache_clear()
        assert machine_speed.slowness() == 1.0
        (file,) = (file for file in no_kernels.iterdir() if file.name.startswith("slowness"))
        seconds[0] *= 1.5
        file.write_text(content)
        written_s = time.time() - age_s
        os.utime(file, (written_s, written_s))
        machine_speed.slowness.cache_clear()
        assert machine_speed.slowness() == expected
        machine_speed.slowness.cache_clear()
        assert machine_speed.slowness() == expected  # the new measurement replaces the old one
    finally:
        machine_speed.slowness.cache_clear()


def test_where_nothing_can_be_kept_the_machine_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(kind: str) -> Path:
        raise EngineUnavailable("no folder for compiled programs")

    monkeypatch.setattr(machine_speed, "cache_folder", refuse)
    monkeypatch.setattr(machine_speed, "block_s", lambda: 3.0 * machine_speed.REFERENCE_S)
    machine_speed.slowness.cache_clear()
    try:
        assert machine_speed.slowness() == 3.0
    finally:
        machine_speed.slowness.cache_clear()


def test_the_block_stands() -> None:
    """The block of boxes that measures the machine's speed stands. So the steps of this block are like those of pallets
    at rest, and their number is the same on every machine."""
    (outcome,) = MujocoEngine(1).run([Job(build_scene(machine_speed.block(), SIM))], SIM)
    assert (outcome.verdict, outcome.n_boxes) == (Verdict.STABLE, machine_speed.SIDE**2 * machine_speed.LAYERS)
    assert machine_speed.block_s() > 0.0


def test_measuring_the_machine_does_not_load_pandas() -> None:
    code = "import sys\nfrom petmjx.engines.machine_speed import slowness\nslowness()\nprint('pandas' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
