"""Tests of the engine that ``auto`` chooses, of the expected time of a run, and of errors if an engine is named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from support.plans import make_scene

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.engines.cost_model import MEASURED, SHAKEN_STEPS
from petmjx.engines.engine_choice import Choice, choose
from petmjx.engines.engine_of_run import engine_for, resolve_engine
from petmjx.engines.engine_registry import ENGINES, make_engine
from petmjx.engines.expected_work import (
    CARRIED_STEPS,
    COST_SHARE,
    DISPLACED_STEPS,
    FAILING_BOXES,
    WAY_STEPS,
    Work,
    rest_steps,
)
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
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
    work = Work(STATIC, [40] * 10, ties=[0.25] * 10)
    assert work.fixed_steps.tolist() == [500] * 10
    # 500 steps and two soft starts of 100 steps
    assert work.steps.tolist() == [700] * 10
    # 10 worlds × 700 steps at rest, and one landing of all boxes; a quarter of a support more than one couples by half
    assert cpu_s(work) == pytest.approx(10 * (700 * rest_s(40) + 0.5 * 40**2 * CPU.static_s))
    # 10 worlds, of which the device simulates 264 at a time, and the longest of them
    gpu_s = MEASURED.gpu_start_s + 10 * (MEASURED.gpu_step_s * 500 * 40 / 264 + MEASURED.host_s)
    gpu_s += MEASURED.gpu_tail_s * 500 * 40 * np.log(1 + 10 / 5)
    assert MEASURED.seconds(work, THREADS)["mjx-warp"] == pytest.approx(gpu_s)
    assert MEASURED.seconds(work, THREADS)["mjx-jax"] == pytest.approx(1.1e-5 * 10 * 500 * 1600)
    fixed = Work(Simulation(schedule="fixed"), [9], ties=[1.0])
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
    work = Work(sim, [10], placements=1, drives=64, drive_steps=450, ties=[1.0])
    assert work.steps.tolist() == [200 + 250 + 64 * 450]
    placing_s = 450 * rest_s(10) + 100 * CPU.static_s
    assert cpu_s(work) == pytest.approx(placing_s + 64 * 450 * (rest_s(10) + CPU.driven_s + CPU.shaken_s * 100))
    # a long drive (shaking) is mostly at rest
    longer = Work(sim, [10], placements=1, drives=64, drive_steps=10_000, ties=[1.0])
    more_s = 9550 * (rest_s(10) + CPU.driven_s) + (SHAKEN_STEPS - 450) * CPU.shaken_s * 100
    assert cpu_s(longer) - cpu_s(work) == pytest.approx(64 * more_s)


def test_a_pallet_has_time_to_come_to_rest_and_needs_less() -> None:
    assert rest_steps(SIM, 1.0) == 115
    assert rest_steps(SIM, 0.2) == 100
    assert rest_steps(SIM, 1.0, 220) == 220
    assert rest_steps(Simulation(schedule="fixed"), 1.0) == 500


def test_placements_with_errors_take_more_steps_and_each_costs_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.engines.expected_work.FAILING_BOXES", 1e-9)
    planned, seventeen = Work(SIM, [10], ties=[1.0]), Work(SIM, [10], placements=17, ties=[1.0])
    exact, by_hand = replace(seventeen, displaced=16), replace(seventeen, carried=16)
    # of ten boxes with a second support each, places with errors take some away
    for errors, steps, factor, hand_s in (
        (exact, DISPLACED_STEPS, 3.2, 0.0),
        (by_hand, CARRIED_STEPS, CPU.jammed, CPU.hand_s),
    ):
        placing = planned.steps[0] - 200
        assert errors.steps == pytest.approx(17 * 200 + (1 + steps * 16) * placing)
        more_s = (steps - 1) * placing * rest_s(10, 1 / 2.25) + hand_s * (200 + steps * placing)
        each_s = factor * (cpu_s(planned) + more_s)
        assert cpu_s(errors) == pytest.approx(cpu_s(planned) + 16 * each_s)
        # a run takes at least as long as its longest world
        assert cpu_s(errors, threads=1000) == pytest.approx(each_s)
    assert 1 < DISPLACED_STEPS < CARRIED_STEPS


def test_of_many_boxes_that_are_carried_with_errors_one_fails() -> None:
    """A plan of 10 boxes is placed nearly to its end. Of 1,000 boxes, the mean world places 1 / ``FAILING_BOXES``."""
    work = Work(SIM, [10, 1000], placements=1, carried=1)
    few, many = work.share_before_failure(work.ways[2]).tolist()
    assert few == pytest.approx(1 - FAILING_BOXES * 10 / 2, rel=2e-3)
    assert many * 1000 == pytest.approx(1 / FAILING_BOXES, rel=3e-3)
    # the mean square of the exponential distribution is twice the square of its mean
    assert work.share_before_failure(work.ways[2], 2.0)[1] == pytest.approx(np.sqrt(2) * many, rel=0.02)
    exact = replace(work, carried=0, displaced=1)
    assert exact.share_before_failure(exact.ways[1]).tolist() == [1, 1]
    unending = replace(work, sim=SIM.changed(early_stop=False))
    assert unending.share_before_failure(unending.ways[2]).tolist() == [1, 1]
    for engine in ("mujoco", "mjx-warp-cpu"):
        assert MEASURED.seconds(work, 1)[engine] < MEASURED.seconds(unending, 1)[engine]


@pytest.mark.parametrize("name", ["drop", "hand", "tines"])
def test_the_way_of_placing_decides_the_steps(name: str) -> None:
    exact, other = Work(SIM, [10]), Work(Simulation(placing=name), [10])
    assert other.steps - 200 == pytest.approx(WAY_STEPS[other.sim.placing.name] * (exact.steps - 200))
    # boxes with errors take longer by tines than by hand, by as much
    errors = Work(other.sim, [10], displaced=int(name == "drop"), carried=int(name != "drop"))
    assert errors.steps[0] > other.steps[0]


def test_threads_share_worlds_and_no_world() -> None:
    assert cpu_s(Work(SIM, [40] * 10), threads=4) == pytest.approx(cpu_s(Work(SIM, [40] * 10)) / 4)
    assert cpu_s(Work(SIM, [40] * 2), threads=4) == pytest.approx(cpu_s(Work(SIM, [40])))
    # a run takes at least as long as its longest world
    assert cpu_s(Work(SIM, [150, *[20] * 10]), threads=4) == pytest.approx(cpu_s(Work(SIM, [150])))
    assert MEASURED.seconds(Work(SIM, []), 4)["mujoco"] == 0


THIRD_PARTY = (
    *((16, 0, 0.022), (45, 28, 0.19), (66, 27, 0.257), (83, 60, 0.68), (98, 123, 1.21), (108, 99, 2.28)),
    *((124, 112, 1.80), (132, 122, 2.49), (140, 124, 2.87), (148, 103, 2.03), (151, 84, 4.79), (166, 143, 3.19)),
)
GENERATED = ((14, 0, 0.020), (22, 2, 0.034), (28, 0, 0.047), (35, 0, 0.057), (44, 0, 0.081), (49, 0, 0.100))
BLOCKS = ((8, 0, 0.0125), (30, 0, 0.047), (36, 0, 0.054), (64, 0, 0.158), (80, 0, 0.234), (120, 0, 0.563))
"""Boxes, ties, and CPU time in s of plans that stand, placed one by one on C MuJoCo. Blocks are columns of equal boxes,
side by side. Times of this table and the ones below were measured on 29 November 2026, and divided by
``machine_speed.slowness``."""

KERNEL = (
    *((35, 0, 0.0196), (22, 2, 0.0138), (49, 0, 0.0333), (44, 0, 0.0296), (14, 1, 0.0041), (64, 0, 0.050)),
    *((30, 0, 0.0113), (120, 0, 0.27), (45, 28, 0.066), (66, 27, 0.120), (83, 60, 0.262), (98, 123, 0.34)),
    *((108, 99, 0.41), (124, 112, 0.53), (140, 124, 0.91), (151, 84, 1.83), (166, 143, 0.92)),
)
CHECKED = (
    *((35, 0, 0.062), (49, 0, 0.125), (94, 57, 0.576), (42, 24, 0.165)),
    *((30, 0, 0.030), (36, 0, 0.031), (64, 0, 0.069), (80, 0, 0.077), (120, 0, 0.140)),
)
CHECKED_KERNEL = (
    *((35, 0, 0.018), (49, 0, 0.025), (30, 0, 0.0086), (64, 0, 0.022), (120, 0, 0.085)),
    *((66, 27, 0.075), (83, 60, 0.105), (98, 123, 0.138), (124, 112, 0.271)),
)


@pytest.mark.parametrize(
    ("engine", "check", "plans"),
    [
        ("mujoco", "one-by-one", (*THIRD_PARTY, *GENERATED, *BLOCKS)),
        ("mjx-warp-cpu", "one-by-one", KERNEL),
        ("mujoco", "static", CHECKED),
        ("mjx-warp-cpu", "static", CHECKED_KERNEL),
    ],
)
def test_expected_times_are_those_measured_on_a_cpu_thread(
    engine: str, check: str, plans: tuple[tuple[int, int, float], ...]
) -> None:
    costs = {"mujoco": MEASURED.mujoco, "mjx-warp-cpu": MEASURED.kernel}[engine]
    for boxes, ties, measured_s in plans:
        expected_s = costs.seconds(Work(Simulation(check=check), [boxes], ties=[ties / boxes]), 1)
        assert 1 / 2 < expected_s / measured_s < 2, (boxes, expected_s)


@pytest.mark.parametrize(
    ("boxes", "steps", "gentle", "measured_s"),
    [
        # the profile of EUMOS, as the mean of 0.2, 0.5 and 0.8 g
        *((n, 315, 1 / 3, s) for n, s in ((31, 0.31), (42, 1.15), (49, 1.37), (59, 1.44), (94, 2.54))),
        (31, 10_715, 0.0, 2.3),  # the pushes of radial-force at 0.5 g
    ],
)
def test_expected_times_of_drives_are_those_measured_on_a_cpu_thread(
    boxes: int, steps: int, gentle: float, measured_s: float
) -> None:
    placed = Work(SIM, [boxes], drives=0)
    shaken = Work(SIM, [boxes], drives=1, drive_steps=steps, gentle=gentle)
    settling = Work(SIM, [boxes], drives=1, drive_steps=0)
    assert cpu_s(settling) < 2 * cpu_s(placed)
    assert 1 / 2 < (cpu_s(shaken) - cpu_s(settling)) / measured_s < 2


def test_expected_times_follow_the_schedule() -> None:
    def gpu_s(schedule: str) -> float:
        seconds = MEASURED.seconds(Work(Simulation(schedule=schedule), [40]), 1)["mjx-warp"]
        return seconds - MEASURED.gpu_start_s - MEASURED.host_s

    for schedule, share in COST_SHARE.items():
        assert gpu_s(schedule.value) == pytest.approx(gpu_s("fixed") * share)
    assert cpu_s(Work(SIM, [40])) < 0.6 * cpu_s(Work(Simulation(schedule="fixed"), [40]))


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


@pytest.mark.parametrize(("mujoco_s", "names"), [(19.0, ("mujoco",) * 2), (29.0, ("mjx-warp-cpu", "mujoco"))])
def test_a_compiler_must_be_worth_waiting_for(mujoco_s: float, names: tuple[str, str]) -> None:
    """Kernels of an earlier run need only be faster; kernels that must be compiled, much faster."""
    seconds = {"mujoco": mujoco_s, "mjx-warp": 99.0, "mjx-warp-cpu": 20.0}

    def chosen(seconds: dict[str, float], compiles: bool) -> str:
        return choose(seconds, 2, why_no_gpu=lambda: "no GPU", why_no_kernel=lambda: None, compiles=compiles)[0]

    assert (chosen(seconds, False), chosen(seconds, True)) == names
    assert chosen(seconds | {"mujoco": 31.0}, True) == "mjx-warp-cpu"


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
