"""An error of an engine never ends a run. C MuJoCo simulates the engine's worlds. Worlds that it cannot simulate either
are invalid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from support.fake_attempt_process import AtOnce
from support.outcomes import make_outcome
from support.plans import make_plan, make_world, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines import attempt_settings, attempt_with_fallback, simulation_loop
from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.subprocess.check_pool import CheckPool, CheckTask
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.engines.world_results import WorldResult
from petmjx.options.simulation import Simulation, Solver
from petmjx.world.job import Drive, Excitation, Job

WORLDS = 3

HEAVY = stack(1, kg=100_000.0)
"""A box that is so heavy that it sinks into the carrier."""


@dataclass
class Scripted(Engine):
    """An engine whose outcomes have a given reason. In some of its runs, it raises an exception after the first of
    several outcomes."""

    name: str
    raises: Callable[[int, Simulation], Exception | None]
    reason: Reason = Reason.NONE
    sims: list[Simulation] = field(default_factory=list)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        self.sims.append(sim)
        error = self.raises(len(self.sims), sim)
        for index in range(len(jobs)):
            if error is not None and index == min(1, len(jobs) - 1):
                raise error
            verdict = Verdict.INVALID if self.reason else Verdict.STABLE
            flags = Flag.SINKING if self.reason is Reason.SINKING else Flag.NONE
            yield make_outcome(1, verdict, self.reason, job=index, flags=flags)


def never(run: int, sim: Simulation) -> None:
    return None


def in_run(number: int) -> Callable[[int, Simulation], Exception | None]:
    return lambda run, _: RuntimeError("Warp CUDA error 901") if run == number else None


def at_attempt(number: int, of: Simulation) -> Callable[[int, Simulation], Exception | None]:
    attempt_sim = ATTEMPTS[number - 1].apply_to_sim(of)
    return lambda _, sim: RuntimeError("no") if sim == attempt_sim else None


def scored(
    engine: Scripted,
    c_engine: Scripted,
    monkeypatch: pytest.MonkeyPatch,
    sim: Simulation | None = None,
    kernel: Scripted | None = None,
) -> tuple[list[WorldResult], list[str]]:
    """Results and notes of a run. ``c_engine`` and ``kernel`` also make the attempts that run beside the engine."""
    engines = {"mujoco": c_engine, "mjx-warp-cpu": kernel or Scripted("mjx-warp-cpu", never)}
    monkeypatch.setattr(attempt_settings, "make_engine", engines.__getitem__)
    monkeypatch.setattr(attempt_settings, "AttemptProcess", lambda _: AtOnce(engines.__getitem__))
    progress = Progress()
    worlds = [make_world(make_plan(f"p{k}", stack(1))) for k in range(WORLDS)]
    results = list(score_worlds(worlds, sim or Simulation(), engine, progress=progress))
    assert sorted(result.world.plan.plan_id for result in results) == ["p0", "p1", "p2"]
    return results, list(progress.notes)


def test_an_engine_whose_distances_are_too_coarse_for_stiff_contacts_leaves_attempt_6_to_c_mujoco(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    engine, c_engine = (Scripted(name, never, Reason.SINKING) for name in ("mjx-jax", "mujoco"))
    results, notes = scored(engine, c_engine, monkeypatch)
    engines = {(a.attempt, a.engine) for result in results for a in result.attempts}
    assert {(1, "mjx-jax"), (6, "mujoco")} <= engines
    assert (6, "mjx-jax") not in engines
    assert "worlds were simulated again on mujoco, with stiffer contacts" in notes


def test_what_an_engine_leaves_unanswered_goes_to_c_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    results, notes = scored(Scripted("mjx-warp", in_run(1)), Scripted("mujoco", never), monkeypatch)
    assert sorted(result.outcome.engine for result in results) == ["mjx-warp", "mujoco", "mujoco"]
    assert notes == ["attempt 1: mjx-warp failed (RuntimeError: Warp CUDA error 901); 2 worlds: went to mujoco"]


@pytest.mark.parametrize("number", [attempt.number for attempt in ATTEMPTS[1:] if not attempt.checks])
def test_an_error_in_any_further_attempt_ends_no_run(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error in any further attempt does not end the run.

    C MuJoCo makes the attempts that need double precision, and those that another engine does not finish. Attempts 6
    and 7 are for worlds in which boxes sank. Attempt 9 follows attempts 2 to 5 if the user requests it.
    """
    sinks = number in (6, 7)
    sim = Simulation(attempts="soft" if number == 9 else "rigid")
    reason = Reason.SINKING if sinks else Reason.EXPLOSION
    engine, fails = Scripted("mjx-warp", never, reason), at_attempt(number, sim)
    c_engine, kernel = Scripted("mujoco", fails, reason), Scripted("mjx-warp-cpu", fails, reason)
    results, notes = scored(engine, c_engine, monkeypatch, sim, kernel)
    assert len(engine.sims) == 1
    failed = [result for result in results if result.outcome.reason is Reason.FAILED]
    assert {result.outcome.verdict for result in results} == {Verdict.INVALID}
    assert any(f"attempt {number}: mujoco failed" in note for note in notes)
    if number == 6:
        assert "attempt 6: mjx-warp-cpu failed (no); 1 world: went to mujoco" in notes
    else:
        assert "worlds were simulated again on mujoco, in double precision" in notes
    by_attempt = [(a.attempt, a.reason) for result in results for a in result.attempts]
    assert by_attempt.count((number, "failed")) == WORLDS
    wants_doubles = {attempt.number for attempt in ATTEMPTS if attempt.doubles}
    assert all(a.engine == "mujoco" for result in results for a in result.attempts if a.attempt in wants_doubles)
    assert all(result.attempts[0].engine == "mjx-warp" for result in results)
    assert all(result.outcome.message for result in failed)


def test_further_attempts_of_single_worlds_begin_beside_the_first_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Further attempts of single worlds begin before the run's engine has finished the next world. Kernels on CPU
    threads make attempts with stiffer contacts, and C MuJoCo makes the other attempts. Attempts with half the timestep,
    which may be many, wait for the GPU."""
    engine_names: list[str] = []
    monkeypatch.setattr(attempt_with_fallback, "MOST_TOGETHER", 1)

    @dataclass
    class Telling(Scripted):
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            for outcome in super().run(jobs, sim, progress):
                engine_names.append(self.name)
                yield replace(outcome, boxes=replace(outcome.boxes, max_tilt_deg=np.array([15.0])))

    engine = Telling("mjx-warp", never, Reason.SINKING)
    kernel, c_engine = Telling("mjx-warp-cpu", never, Reason.SINKING), Telling("mujoco", never)
    results, notes = scored(engine, c_engine, monkeypatch, Simulation(check_timestep=True), kernel)
    assert engine_names == ["mjx-warp", "mjx-warp-cpu", "mujoco"] * WORLDS + ["mjx-warp"] * WORLDS
    made = [(1, "mjx-warp"), (6, "mjx-warp-cpu"), (7, "mujoco"), (8, "mjx-warp")]
    assert all([(a.attempt, a.engine) for a in result.attempts] == made for result in results)
    assert "worlds were simulated again on mjx-warp-cpu, with stiffer contacts" in notes


def test_worlds_with_errors_that_sank_and_drives_keep_to_the_gpu_in_stiffer_contacts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If boxes of a plan sink, they do so in all of its worlds with errors. Such attempts with stiffer contacts are
    many, so the GPU makes them."""
    engines = {name: Scripted(name, never) for name in ("mujoco", "mjx-warp-cpu")}
    monkeypatch.setattr(attempt_settings, "make_engine", engines.__getitem__)
    monkeypatch.setattr(attempt_settings, "AttemptProcess", lambda _: AtOnce(engines.__getitem__))
    nominal = make_world(make_plan("p", stack(1)))
    drive = Drive(Excitation("push", "force", np.zeros((3, 3))))
    heavy = make_world(make_plan("heavy", HEAVY))
    by_chance = replace(nominal, variant=1)
    worlds = [
        by_chance,
        replace(heavy, variant=1),
        replace(nominal, job=replace(nominal.job, drive=drive)),
        replace(nominal, job=replace(nominal.job, keep_state=True)),
    ]
    engine = Scripted("mjx-warp", never, Reason.SINKING)
    for result in score_worlds(worlds, Simulation(), engine, attempts=ATTEMPTS[:6]):
        again = "mjx-warp-cpu" if result.world is by_chance else "mjx-warp"
        assert [(a.attempt, a.engine) for a in result.attempts] == [(1, "mjx-warp"), (6, again)]


def test_a_world_with_errors_that_leans_is_simulated_beside_the_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    class Leaning(Scripted):
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            for outcome in super().run(jobs, sim, progress):
                yield replace(outcome, verdict=Verdict.UNSTABLE, reason=Reason.TILT, flags=Flag.SINKING)

    engines = {name: Scripted(name, never) for name in ("mujoco", "mjx-warp-cpu")}
    monkeypatch.setattr(attempt_settings, "make_engine", engines.__getitem__)
    monkeypatch.setattr(attempt_settings, "AttemptProcess", lambda _: AtOnce(engines.__getitem__))
    worlds = [replace(make_world(make_plan("p", stack(1))), variant=1)]
    (result,) = score_worlds(worlds, Simulation(), Leaning("mjx-warp", never), attempts=ATTEMPTS[:6])
    assert [(a.attempt, a.engine) for a in result.attempts] == [(1, "mjx-warp"), (6, "mjx-warp-cpu")]


def test_a_large_run_has_what_may_be_needed_beside_it_compiled_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a large run, the kernels for further attempts are compiled before the run's engine begins, even if they turn
    out not to be needed. A small run does not start a process for this."""
    kernel = Scripted("mjx-warp-cpu", never, Reason.SINKING)
    scored(Scripted("mjx-warp", never), Scripted("mujoco", never), monkeypatch, kernel=kernel)
    assert kernel.sims == []
    monkeypatch.setattr(simulation_loop, "JOBS_WORTH_A_PROCESS", WORLDS)
    results, notes = scored(Scripted("mjx-warp", never), Scripted("mujoco", never), monkeypatch, kernel=kernel)
    assert kernel.sims == [ATTEMPTS[5].apply_to_sim(Simulation())]
    assert all(len(result.attempts) == 1 for result in results)
    assert notes == []
    for other in (Simulation(physics="reference"), Simulation(solver=Solver.CG)):
        scored(Scripted("mjx-warp", never), Scripted("mujoco", never), monkeypatch, other, kernel=kernel)
    assert len(kernel.sims) == 1


def test_an_interruption_loses_nothing_that_is_looked_at_beside_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    class Slow(CheckPool[Any]):
        """A pool that answers only if the caller waits. The third check of outcomes is interrupted."""

        begun = 0

        def _begin(self, keys: list[Any], task: CheckTask) -> None:
            self.begun += 1
            if self.begun == WORLDS:
                raise KeyboardInterrupt
            super()._begin(keys, task)

        def _take(self, process: Any, *, wait: bool, **until: Any) -> None:
            if wait:
                super()._take(process, wait=True, **until)

    monkeypatch.setattr(simulation_loop, "LARGE", WORLDS)
    monkeypatch.setattr(attempt_with_fallback, "MOST_TOGETHER", 1)
    monkeypatch.setattr(simulation_loop.CheckPool, "here", lambda: Slow(1))
    worlds = [make_world(make_plan(f"p{k}", stack(1))) for k in range(WORLDS)]
    results = score_worlds(worlds, Simulation(physics="reference"), Scripted("mjx-warp", never))
    assert [next(results).world.plan.plan_id for _ in range(WORLDS - 1)] == ["p0", "p1"]
    with pytest.raises(KeyboardInterrupt):
        next(results)


def test_looks_are_waited_for_whatever_an_engine_that_raised_had_at_hand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An engine raises an exception while it reports that further outcomes are ready. Each outcome that it returned,
    and each outcome that replaces a missing one, is checked."""
    untils = list[bool]()

    class Left(Scripted):
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            for outcome in super().run(jobs, sim, progress):
                assert progress is not None
                progress.at_hand = 7
                yield outcome

    class Watched(CheckPool[Any]):
        def exchanged(self, *args: Any, until: Callable[[], bool], **how: Any) -> Any:
            untils.append(until())
            return super().exchanged(*args, until=until, **how)

    monkeypatch.setattr(simulation_loop, "LARGE", WORLDS)
    monkeypatch.setattr(simulation_loop.CheckPool, "here", lambda: Watched(0))
    results, _ = scored(Left("mjx-warp", in_run(1)), Scripted("mujoco", never), monkeypatch)
    assert len(results) == WORLDS
    assert len(untils) > WORLDS - 1
    assert not any(untils)


@pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")  # a warning about the heavy box
def test_of_a_plan_that_sinks_worlds_with_errors_are_not_simulated_beside_the_gpu(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    engines = {name: Scripted(name, never) for name in ("mujoco", "mjx-warp-cpu")}
    monkeypatch.setattr(attempt_settings, "make_engine", engines.__getitem__)
    monkeypatch.setattr(attempt_settings, "AttemptProcess", lambda _: AtOnce(engines.__getitem__))
    engine = Scripted("mjx-warp", never, Reason.SINKING)
    made = petmjx.score([make_plan("p", HEAVY)], engine=engine, confidence=4, placing="exact").attempts
    again = made[made["attempt"] == 6]
    assert again.set_index("variant")["engine"].to_dict() == {0: "mjx-warp-cpu"} | dict.fromkeys(
        range(1, 5), "mjx-warp"
    )


def test_conjugate_gradients_are_c_mujoco_s(monkeypatch: pytest.MonkeyPatch) -> None:
    engine, c_engine = Scripted("mjx-warp", never), Scripted("mujoco", never)
    results, notes = scored(engine, c_engine, monkeypatch, Simulation(solver=Solver.CG))
    assert engine.sims == []
    assert {result.outcome.engine for result in results} == {"mujoco"}
    assert notes == ["worlds were simulated on mujoco, the only engine with the solver cg"]


def test_what_an_engine_refuses_is_the_user_s_to_change(monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = Scripted("mjx-warp", lambda run, sim: InputError("too many boxes"))
    with pytest.raises(InputError, match="too many boxes"):
        scored(refusing, Scripted("mujoco", never), monkeypatch)


def test_an_engine_of_one_s_own_has_no_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match="901"):
        scored(Scripted("own", in_run(1)), Scripted("mujoco", never), monkeypatch)
    results, _ = scored(Scripted("own", in_run(2), Reason.EXPLOSION), Scripted("mujoco", never), monkeypatch)
    assert {result.outcome.engine for result in results} == {"own"}
