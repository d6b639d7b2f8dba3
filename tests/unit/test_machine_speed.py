"""Tests of time estimates for this machine. Its speed is measured if it matters, and estimated CPU times are scaled
accordingly."""

from __future__ import annotations

import pytest

from petmjx.engines import machine_speed
from petmjx.engines.cost_model import MEASURED, Work
from petmjx.engines.engine_choice import Choice
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.run_engine import resolve_engine
from petmjx.engines.verdict import Verdict
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

SIM = Simulation()
SHORT, LONG = Work(SIM, [5]), Work(SIM, [40] * 1000)


def test_times_of_cpus_grow_with_the_factor_and_those_of_gpus_do_not() -> None:
    work = Work(
        Simulation(carrier="epal-1"), [40] * 9, placements=3, displaced=1, drives=4, drive_steps=700, filmed=True
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


def test_the_block_stands() -> None:
    """The block of boxes that measures the machine's speed stands. So its steps are like those of pallets at rest, and
    their number is the same on every machine."""
    (outcome,) = MujocoEngine(1).run([Job(build_scene(machine_speed.block(), SIM))], SIM)
    assert (outcome.verdict, outcome.n_boxes) == (Verdict.STABLE, machine_speed.SIDE**2 * machine_speed.LAYERS)
    assert machine_speed.block_s() > 0.0
