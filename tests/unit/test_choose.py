"""Which engine ``auto`` takes, what a run is expected to cost, and what asking for an engine by name can run into."""

from __future__ import annotations

import pytest

from petmjx.config import Simulation
from petmjx.engines.choose import ENGINES, Choice, choose, make_engine, resolve_engine
from petmjx.engines.cost import COST_SHARE, H100, Work
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.errors import EngineUnavailable, InputError
from petmjx.run_options import RunOptions

SIM = Simulation()
STATIC = Simulation(check="static", schedule="fixed", duration_s=1.0)
THREADS = 16


def chosen(boxes: list[int], threads: int = THREADS) -> str:
    return choose(H100.seconds(Work(SIM, boxes), threads), threads)[0]


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if mjx-warp could run here."""
    monkeypatch.setattr("petmjx.engines.choose.why_no_warp", lambda: None)


# ---------------------------------------------------------------------- cost


def cpu_s(work: Work, threads: int = 1) -> float:
    return H100.seconds(work, threads)["mujoco"]


def test_a_run_s_steps_and_cost_worked_out_by_hand() -> None:
    work = Work(STATIC, [40] * 10)
    assert work.fixed_steps.tolist() == [500] * 10
    # with two soft starts of 100 steps
    assert work.steps.tolist() == [700] * 10
    # 10 worlds × 500 steps × 40² boxes² × 2.4e-7 s, and 3e-5 s for each step
    assert cpu_s(work) == pytest.approx(10 * 500 * 1600 * 2.4e-7 + 10 * 700 * 3e-5)
    # 25 s to start; 10 worlds and the end of the run, worth 3,300, at 2,048 a time
    gpu_s = 25 + 2.4e-6 * 500 * 1600 * 3310 / 2048
    assert H100.seconds(work, THREADS)["mjx-warp"] == pytest.approx(gpu_s)
    assert H100.seconds(work, THREADS)["mjx-jax"] == pytest.approx(1.1e-5 * 10 * 500 * 1600)
    fixed = Work(Simulation(schedule="fixed"), [9])
    assert fixed.fixed_steps.tolist() == [10 * 350]
    # while boxes come one by one, a step costs a third of the full pallet's
    assert cpu_s(fixed) == pytest.approx(3500 * 81 / 3 * 2.4e-7 + 3700 * 3e-5)


def test_drives_from_one_placement_worked_out_by_hand() -> None:
    sim = Simulation(check="static", schedule="fixed", settle_s=0.5)
    work = Work(sim, [10], placements=1, drives=64, drive_steps=450)
    assert work.steps.tolist() == [200 + 250 + 64 * 450]
    # a shaken step costs two at rest
    box2_steps = 100 * 250 + 64 * 2 * 100 * 450
    assert cpu_s(work) == pytest.approx(2.4e-7 * box2_steps + 3e-5 * (450 + 64 * 450))


def test_threads_share_worlds_and_no_world() -> None:
    assert cpu_s(Work(SIM, [40] * 10), threads=4) == pytest.approx(cpu_s(Work(SIM, [40] * 10)) / 4)
    assert cpu_s(Work(SIM, [40] * 2), threads=4) == pytest.approx(cpu_s(Work(SIM, [40])))
    assert H100.seconds(Work(SIM, []), 4)["mujoco"] == 0


def test_expected_times_follow_the_schedule() -> None:
    def by_boxes(schedule: str) -> float:
        """Without what a step costs whatever the number of boxes."""
        work = Work(Simulation(schedule=schedule), [40])
        return cpu_s(work) - H100.cpu_overhead_s * float(work.steps.sum())

    assert by_boxes("adaptive") < by_boxes("fixed")
    for schedule, share in COST_SHARE.items():
        assert by_boxes(schedule.value) == pytest.approx(by_boxes("fixed") * share)


@pytest.mark.parametrize(
    ("plans", "measured_s"), [(500, 18.4), (1_000, 23.6), (2_000, 24.2), (4_000, 40.6), (8_000, 62.8)]
)
def test_expected_times_are_those_measured_on_the_h100(plans: int, measured_s: float) -> None:
    # Plans of 46 boxes take as many box² steps as the workload's do on average (43 ± 14 boxes).
    seconds = H100.seconds(Work(SIM, [46] * plans), 16)
    assert seconds["mjx-warp"] - H100.gpu_start_s == pytest.approx(measured_s, rel=0.25)
    assert seconds["mujoco"] == pytest.approx(plans / 13.8, rel=0.1)


# ---------------------------------------------------------------------- choice


@pytest.mark.usefixtures("gpu")
def test_auto_takes_the_gpu_for_many_plans_and_threads_for_few() -> None:
    assert chosen([43] * 10_000) == "mjx-warp"
    assert chosen([43] * 20) == "mujoco"
    assert chosen([3] * 2000) == "mujoco"
    assert chosen([]) == "mujoco"


@pytest.mark.usefixtures("gpu")
def test_the_choice_turns_once_as_plans_become_more() -> None:
    names = [chosen([43] * n) for n in range(50, 5000, 50)]
    assert names == sorted(names, reverse=True)
    assert set(names) == {"mujoco", "mjx-warp"}
    # and back again as threads become more
    names = [chosen([43] * 1000, threads) for threads in (1, 2, 4, 8, 16, 32, 64)]
    assert names == sorted(names)


def test_auto_says_why_it_does_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.choose.why_no_warp", lambda: "no CUDA device")
    assert choose({"mujoco": 700.0, "mjx-warp": 80.0}, THREADS) == (
        "mujoco",
        "mjx-warp would be faster but cannot run: no CUDA device",
    )


@pytest.mark.usefixtures("gpu")
def test_the_reason_has_both_times() -> None:
    for cpu, name in ((3.0, "mujoco"), (700.0, "mjx-warp")):
        found, reason = choose({"mujoco": cpu, "mjx-warp": 80.0}, THREADS)
        assert found == name
        assert f"about {cpu:.0f} s" in reason
        assert "about 80 s" in reason
        assert "16 CPU threads" in reason


# ---------------------------------------------------------------------- engines by name


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
    for no_engine, shown in ((MujocoEngine, "<class"), (5, "5")):
        with pytest.raises(InputError, match=f"^engine must be a name or an object with .*, got {shown}"):
            resolve_engine(RunOptions(engine=no_engine), Work(SIM, [9]))
    with pytest.raises(InputError, match="threads belong to the engine mujoco"):
        make_engine("mjx-jax", threads=2)
    with pytest.raises(InputError, match="lanes belong to the MJX engines"):
        make_engine("mujoco", lanes=2)


def test_a_run_s_engine_and_why_it_was_taken() -> None:
    work = Work(SIM, [2])
    seconds = H100.seconds(work, 1)["mujoco"]
    engine, choice = resolve_engine(RunOptions(threads=1, lanes=64), work)
    assert engine.name == choice.name == "mujoco"
    assert choice.reason.startswith("about 0 s on 1 CPU thread, a GPU would need about ")
    named, choice = resolve_engine(RunOptions(engine="mujoco", threads=1), work)
    assert named.name == "mujoco"
    assert choice == Choice("mujoco", "as asked for", seconds)
    own = MujocoEngine(1)
    found, choice = resolve_engine(RunOptions(engine=own), work)
    assert found is own
    assert choice == Choice("mujoco", "given", None)


def test_an_engine_whose_packages_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENGINES, "mjx-jax", ("petmjx.engines.not_there", "Engine"))
    with pytest.raises(EngineUnavailable, match="engine mjx-jax cannot run here: No module named"):
        make_engine("mjx-jax")
