"""Which engine ``auto`` takes, and what asking for one by name can run into."""

from __future__ import annotations

import pytest

from petmjx.config import Check, Schedule, Simulation
from petmjx.engines.choose import ENGINES, H100, choose_engine, make_engine, resolve_engine
from petmjx.errors import EngineUnavailable, InputError

SIM = Simulation()
THREADS = 16


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if mjx-warp could run here."""
    monkeypatch.setattr("petmjx.engines.choose.why_no_warp", lambda: None)


@pytest.mark.usefixtures("gpu")
def test_auto_takes_the_gpu_for_many_plans_and_threads_for_few() -> None:
    assert choose_engine([43] * 10_000, SIM, threads=THREADS).name == "mjx-warp"
    assert choose_engine([43] * 20, SIM, threads=THREADS).name == "mujoco"
    assert choose_engine([3] * 2000, SIM, threads=THREADS).name == "mujoco"
    assert choose_engine([], SIM, threads=THREADS).name == "mujoco"


@pytest.mark.usefixtures("gpu")
def test_the_choice_turns_once_as_plans_become_more() -> None:
    names = [choose_engine([43] * n, SIM, threads=THREADS).name for n in range(50, 5000, 50)]
    assert names == sorted(names, reverse=True)
    assert set(names) == {"mujoco", "mjx-warp"}


def test_auto_says_why_it_does_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.choose.why_no_warp", lambda: "no CUDA device")
    choice = choose_engine([43] * 10_000, SIM, threads=THREADS)
    assert choice.name == "mujoco"
    assert "cannot run: no CUDA device" in choice.reason


def test_expected_times_follow_the_work() -> None:
    def cpu_s(sim: Simulation, boxes: int = 40, threads: int = 1) -> float:
        return H100.seconds([boxes] * 10, sim, threads)[0]

    assert cpu_s(SIM, threads=4) == pytest.approx(cpu_s(SIM) / 4)
    fixed = SIM.model_copy(update={"schedule": Schedule.FIXED})
    assert cpu_s(SIM) == pytest.approx(cpu_s(fixed) * H100.adaptive_share)
    static = fixed.model_copy(update={"check": Check.STATIC, "duration_s": 1.0})
    assert cpu_s(static, boxes=40) == pytest.approx(4 * cpu_s(static, boxes=20))
    # a hand calculation: 10 worlds × 500 steps × 40² boxes² × 2.4e-7 s
    assert cpu_s(static) == pytest.approx(10 * 500 * 1600 * 2.4e-7)
    brisk = SIM.model_copy(update={"schedule": Schedule.BRISK})
    assert cpu_s(brisk) < cpu_s(SIM)


@pytest.mark.parametrize(
    ("plans", "measured_s"), [(500, 18.4), (1_000, 23.6), (2_000, 24.2), (4_000, 40.6), (8_000, 62.8)]
)
def test_expected_times_are_those_measured_on_the_h100(plans: int, measured_s: float) -> None:
    # Plans of 46 boxes take as many box² steps as the workload's do on average (43 ± 14 boxes).
    cpu_s, gpu_s = H100.seconds([46] * plans, SIM, 16)
    assert gpu_s - H100.gpu_start_s == pytest.approx(measured_s, rel=0.25)
    assert cpu_s == pytest.approx(plans / 13.8, rel=0.1)


def test_engines_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "petmjx.engines.warp.engine.why_no_warp", lambda: "no CUDA device (or no driver) on this machine"
    )
    assert make_engine("mujoco", threads=3).name == "mujoco"
    assert make_engine("mjx-jax", lanes=8).name == "mjx-jax"
    with pytest.raises(EngineUnavailable, match="no CUDA device"):
        make_engine("mjx-warp")
    with pytest.raises(InputError, match="there are mujoco, mjx-jax, mjx-warp and auto"):
        make_engine("abacus")
    with pytest.raises(InputError, match="threads belong to the engine mujoco"):
        make_engine("mjx-jax", threads=2)


def test_auto_uses_the_option_that_applies() -> None:
    engine, choice = resolve_engine("auto", [2], SIM, threads=1, lanes=64)
    assert engine.name == choice.name == "mujoco"
    named, choice = resolve_engine("mujoco", [2], SIM, threads=1)
    assert (named.name, choice.reason) == ("mujoco", "as asked for")


def test_an_engine_whose_packages_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENGINES, "mjx-jax", ("petmjx.engines.not_there", "Engine"))
    with pytest.raises(EngineUnavailable, match="engine mjx-jax cannot run here: No module named"):
        make_engine("mjx-jax")
