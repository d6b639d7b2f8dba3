"""Tests of the engine that ``auto`` chooses, of the expected time of a run, and of errors if an engine is named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest
from support.plans import make_scene

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.engines.cost_model import COST_SHARE, ERROR_STEPS, MEASURED, SHAKEN_STEPS, STATIC_LANDINGS, Work, rest_steps
from petmjx.engines.engine_choice import ENGINES, Choice, choose, make_engine
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.run_engine import engine_for, resolve_engine
from petmjx.engines.verdict import Outcome
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

SIM = Simulation()
STATIC = Simulation(check="static", schedule="fixed", duration_s=1.0)
THREADS = 16


def chosen(boxes: list[int], threads: int = THREADS) -> str:
    return choose(MEASURED.seconds(Work(SIM, boxes), threads), threads)[0]


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """petmjx believes that ``mjx-warp`` can run on this machine."""
    monkeypatch.setattr("petmjx.engines.engine_choice.why_no_warp", lambda: None)


# ---------------------------------------------------------------------- cost


CPU = MEASURED.mujoco


def cpu_s(work: Work, threads: int = 1) -> float:
    return MEASURED.seconds(work, threads)["mujoco"]


def rest_s(boxes: int, share: float = 1.0) -> float:
    """Time of a step at rest, s. ``share`` is the mean time of a step while boxes are placed one by one, as a share of
    the time with all boxes."""
    return share * CPU.rest_s * boxes**1.25 + CPU.overhead_s


def test_a_run_s_steps_and_cost_worked_out_by_hand() -> None:
    work = Work(STATIC, [40] * 10)
    assert work.fixed_steps.tolist() == [500] * 10
    # 500 steps and two soft starts of 100 steps
    assert work.steps.tolist() == [700] * 10
    # 10 worlds × 700 steps at rest, and the landings of all boxes
    assert cpu_s(work) == pytest.approx(10 * (700 * rest_s(40) + STATIC_LANDINGS * 40**2 * CPU.landing_s))
    # 10 worlds, and 900 worlds for the end of the run, simulated 264 at a time
    gpu_s = MEASURED.gpu_start_s + MEASURED.gpu_step_s * 500 * 40 * (10 + 900) / 264
    assert MEASURED.seconds(work, THREADS)["mjx-warp"] == pytest.approx(gpu_s)
    assert MEASURED.seconds(work, THREADS)["mjx-jax"] == pytest.approx(1.1e-5 * 10 * 500 * 1600)
    fixed = Work(Simulation(schedule="fixed"), [9])
    assert fixed.fixed_steps.tolist() == [10 * 350]
    # the model of mjx-jax has all boxes from the beginning
    assert MEASURED.seconds(fixed, THREADS)["mjx-jax"] == pytest.approx(1.1e-5 * 3500 * 9**2)
    # while n = 9 boxes are placed one by one, the mean of k^1.25 is n^1.25 / 2.25, and the sum of k² is n³ / 3
    assert cpu_s(fixed) == pytest.approx(3700 * rest_s(9, 1 / 2.25) + 9**3 / 3 * CPU.landing_s)
    # with the schedule adaptive, a static check ends when the pallet is quiet, even if duration_s is larger
    for duration_s, steps in ((10.0, 220), (100.0, 220), (0.2, 100)):
        adaptive = Work(Simulation(check="static", duration_s=duration_s), [9])
        assert adaptive.steps.tolist() == [200 + steps]


def test_drives_from_one_placement_worked_out_by_hand() -> None:
    sim = Simulation(check="static", schedule="fixed", settle_s=0.5)
    work = Work(sim, [10], placements=1, drives=64, drive_steps=450)
    assert work.steps.tolist() == [200 + 250 + 64 * 450]
    placing_s = 450 * rest_s(10) + STATIC_LANDINGS * 100 * CPU.landing_s
    assert cpu_s(work) == pytest.approx(placing_s + 64 * 450 * (rest_s(10) + CPU.driven_s + CPU.shaken_s * 100))
    # a long drive (shaking) is mostly at rest
    longer = Work(sim, [10], placements=1, drives=64, drive_steps=10_000)
    more_s = 9550 * (rest_s(10) + CPU.driven_s) + (SHAKEN_STEPS - 450) * CPU.shaken_s * 100
    assert cpu_s(longer) - cpu_s(work) == pytest.approx(64 * more_s)


def test_a_pallet_has_time_to_come_to_rest_and_needs_less() -> None:
    assert rest_steps(SIM, 1.0) == 220
    assert rest_steps(SIM, 0.2) == 100
    assert rest_steps(Simulation(schedule="fixed"), 1.0) == 500


def test_placements_with_errors_take_more_steps_and_each_costs_more() -> None:
    planned = Work(SIM, [10])
    exact, by_hand = Work(SIM, [10], placements=17, displaced=16), Work(SIM, [10], placements=17, carried=16)
    for errors, steps, cost in (
        (exact, ERROR_STEPS.displaced, CPU.errors.displaced),
        (by_hand, ERROR_STEPS.carried, CPU.errors.carried),
    ):
        assert errors.steps == pytest.approx(17 * 200 + (1 + steps * 16) * (planned.steps - 200))
        assert cpu_s(errors) == pytest.approx((1 + cost * 16) * cpu_s(planned))
        # a run takes at least as long as its longest world
        assert cpu_s(errors, threads=1000) == pytest.approx(cost * cpu_s(planned))
    assert 1 < ERROR_STEPS.displaced < ERROR_STEPS.carried


def test_threads_share_worlds_and_no_world() -> None:
    assert cpu_s(Work(SIM, [40] * 10), threads=4) == pytest.approx(cpu_s(Work(SIM, [40] * 10)) / 4)
    assert cpu_s(Work(SIM, [40] * 2), threads=4) == pytest.approx(cpu_s(Work(SIM, [40])))
    # a run takes at least as long as its longest world
    assert cpu_s(Work(SIM, [150, *[20] * 10]), threads=4) == pytest.approx(cpu_s(Work(SIM, [150])))
    assert MEASURED.seconds(Work(SIM, []), 4)["mujoco"] == 0


ADAPTIVE, FIXED = Simulation(), Simulation(schedule="fixed")
CHECKED, CHECKED_FIXED = Simulation(check="static"), Simulation(check="static", schedule="fixed")


@pytest.mark.parametrize(
    ("sim", "boxes", "measured_s"),
    [
        # plans of other tools that stand
        *((ADAPTIVE, *case) for case in [(16, 0.044), (45, 0.33), (66, 0.37), (83, 1.12), (103, 1.29), (121, 2.20)]),
        *((ADAPTIVE, *case) for case in [(146, 4.27), (150, 2.93), (175, 9.09), (217, 7.23), (241, 8.83)]),
        # means of twelve generated plans each, with 20 to 29, 30 to 39, 40 to 49, and 50 or more boxes
        *((ADAPTIVE, *case) for case in [(24, 0.057), (34, 0.091), (45, 0.155), (64, 0.286)]),
        *((FIXED, *case) for case in [(16, 0.24), (66, 3.6), (83, 6.8), (121, 18.6)]),
        *((CHECKED, *case) for case in [(45, 0.33), (83, 0.78), (121, 1.83), (150, 2.3), (201, 6.3), (241, 5.9)]),
        *((CHECKED_FIXED, *case) for case in [(16, 0.28), (45, 1.26), (83, 3.8), (150, 5.9)]),
    ],
)
def test_expected_times_are_those_measured_on_a_cpu_thread(sim: Simulation, boxes: int, measured_s: float) -> None:
    # a single plan unless stated otherwise, measured on the machine of the lines ``estimates`` of cpu-0.3.jsonl
    assert 1 / 2 < cpu_s(Work(sim, [boxes])) / measured_s < 2


@pytest.mark.parametrize(
    ("boxes", "steps", "measured_s"),
    # the profile of EUMOS, as the mean of 0.2, 0.5 and 0.8 g; and last, the pushes of radial-force at 0.5 g
    [(31, 700, 0.31), (42, 700, 1.15), (49, 700, 1.37), (59, 700, 1.44), (94, 700, 2.54), (31, 10_715, 2.3)],
)
def test_expected_times_of_drives_are_those_measured_on_a_cpu_thread(boxes: int, steps: int, measured_s: float) -> None:
    placed = Work(SIM, [boxes], drives=0)
    shaken = Work(SIM, [boxes], drives=1, drive_steps=steps)
    settling = Work(SIM, [boxes], drives=1, drive_steps=0)
    assert cpu_s(settling) < 2 * cpu_s(placed)
    assert 1 / 2 < (cpu_s(shaken) - cpu_s(settling)) / measured_s < 2


def test_expected_times_follow_the_schedule() -> None:
    def gpu_s(schedule: str) -> float:
        return MEASURED.seconds(Work(Simulation(schedule=schedule), [40]), 1)["mjx-warp"] - MEASURED.gpu_start_s

    for schedule, share in COST_SHARE.items():
        assert gpu_s(schedule.value) == pytest.approx(gpu_s("fixed") * share)
    assert cpu_s(Work(ADAPTIVE, [40])) < 0.6 * cpu_s(Work(FIXED, [40]))


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
    # with more threads, the choice changes back
    names = [chosen([43] * 1000, threads) for threads in (1, 2, 4, 8, 16, 32, 64)]
    assert names == sorted(names)


def test_auto_says_why_it_does_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.engine_choice.why_no_warp", lambda: "no CUDA device")
    monkeypatch.setattr("petmjx.engines.engine_choice.why_no_warp_on_cpu", lambda: "Warp is not installed")
    seconds = {"mujoco": 700.0, "mjx-warp": 80.0, "mjx-warp-cpu": 200.0}
    assert choose(seconds, THREADS) == ("mujoco", "mjx-warp would be faster but cannot run: no CUDA device")
    some = seconds | {"mjx-warp": 900.0}
    assert choose(some, THREADS) == ("mujoco", "mjx-warp-cpu would be faster but cannot run: Warp is not installed")


def test_auto_takes_kernels_on_cpu_threads_where_there_is_no_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.engine_choice.why_no_warp", lambda: "no CUDA device")
    monkeypatch.setattr("petmjx.engines.engine_choice.why_no_warp_on_cpu", lambda: None)
    seconds = {"mujoco": 700.0, "mjx-warp": 80.0, "mjx-warp-cpu": 200.0}
    reason = "about 200 s on 16 CPU threads, mujoco would need about 700 s"
    assert choose(seconds, THREADS) == ("mjx-warp-cpu", reason)
    assert chosen([43] * 10) == "mujoco", "ten plans do not wait for a compiler"
    assert chosen([43] * 5000) == "mjx-warp-cpu"


@pytest.mark.usefixtures("gpu")
def test_the_reason_has_both_times() -> None:
    for cpu, name in ((3.0, "mujoco"), (700.0, "mjx-warp")):
        engine_name, reason = choose({"mujoco": cpu, "mjx-warp": 80.0, "mjx-warp-cpu": 90.0}, THREADS)
        assert engine_name == name
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
    with pytest.raises(InputError, match="there are mujoco, mjx-jax, mjx-warp, mjx-warp-cpu and auto"):
        make_engine("abacus")
    for no_engine, shown in ((MujocoEngine, "<class"), (5, "5")):
        with pytest.raises(InputError, match=f"^engine must be a name or an object with .*, got {shown}"):
            resolve_engine(RunOptions(engine=no_engine), Work(SIM, [9]))
    with pytest.raises(InputError, match="threads are an option of the engines mujoco and mjx-warp-cpu"):
        make_engine("mjx-jax", threads=2)
    with pytest.raises(InputError, match="lanes are an option of the engines mjx-jax and mjx-warp"):
        make_engine("mujoco", lanes=2)


def test_a_run_s_engine_and_why_it_was_taken() -> None:
    work = Work(SIM, [2])
    seconds = MEASURED.seconds(work, 1)["mujoco"]
    engine, choice = resolve_engine(RunOptions(threads=1, lanes=64), work)
    assert engine.name == choice.name == "mujoco"
    assert choice.reason.startswith("about 0 s on 1 CPU thread, a GPU would need about ")
    named, choice = resolve_engine(RunOptions(engine="mujoco", threads=1), work)
    assert named.name == "mujoco"
    assert choice == Choice("mujoco", "as asked for", seconds)
    given_engine, choice = resolve_engine(RunOptions(engine=MujocoEngine(1)), work)
    assert (given_engine.name, given_engine.streams) == ("mujoco", True)
    assert given_engine.device.endswith(", 1 thread")
    assert choice == Choice("mujoco", "given", None)


def test_an_engine_of_the_user_s_own_needs_a_name_and_a_method_and_stays_open() -> None:
    closed: list[str] = []

    class Least:
        name = "least"

        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            yield from MujocoEngine(1).run(jobs, sim, progress)

    class More(Least):
        device = "a tin can"

        def close(self) -> None:
            closed.append(self.name)

    for user_engine, device in ((Least(), ", 3 threads"), (More(), "a tin can")):
        with engine_for(RunOptions(engine=user_engine, threads=3), Work(SIM, [1])) as (engine, _):
            assert engine.name == "least"
            assert engine.device.endswith(device)
            (outcome,) = engine.run([Job(make_scene(1))], SIM)
            assert outcome.n_boxes == 1
    assert closed == []


def test_an_engine_whose_packages_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENGINES, "mjx-jax", ("petmjx.engines.not_there", "Engine", ()))
    with pytest.raises(EngineUnavailable, match="engine mjx-jax cannot run here: No module named"):
        make_engine("mjx-jax")
