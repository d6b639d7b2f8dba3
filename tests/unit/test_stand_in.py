"""No error of an engine ends a run: C MuJoCo takes its worlds, and what it cannot answer is invalid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import pytest
from support.outcomes import make_outcome
from support.plans import make_plan, make_world, stack

from petmjx.config import Simulation, Solver
from petmjx.engines import stand_in
from petmjx.engines.attempts import ATTEMPTS
from petmjx.engines.base import Engine, Progress
from petmjx.engines.retry import WorldResult, score_worlds
from petmjx.errors import InputError
from petmjx.verdict import Flag, Outcome, Reason, Verdict
from petmjx.world.job import Job

WORLDS = 3


@dataclass
class Scripted(Engine):
    """Raises in some of its runs, after it has answered one job; in the others answers with these reasons."""

    name: str
    raises: Callable[[int], Exception | None]
    reason: Reason = Reason.NONE
    sims: list[Simulation] = field(default_factory=list)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        self.sims.append(sim)
        error = self.raises(len(self.sims))
        for index in range(len(jobs)):
            if error is not None and index == 1:
                raise error
            verdict = Verdict.INVALID if self.reason else Verdict.STABLE
            flags = Flag.SINKING if self.reason is Reason.SINKING else Flag.NONE
            yield make_outcome(1, verdict, self.reason, job=index, flags=flags)


def never(_: int) -> None:
    return None


def in_run(number: int) -> Callable[[int], Exception | None]:
    return lambda run: RuntimeError("Warp CUDA error 901") if run == number else None


def scored(
    own: Scripted, c_engine: Scripted, monkeypatch: pytest.MonkeyPatch, sim: Simulation | None = None
) -> tuple[list[WorldResult], list[str]]:
    monkeypatch.setattr(stand_in, "make_engine", lambda name: c_engine)
    progress = Progress()
    worlds = [make_world(make_plan(f"p{k}", stack(1))) for k in range(WORLDS)]
    results = list(score_worlds(worlds, sim or Simulation(), own, progress=progress))
    assert sorted(result.world.plan.plan_id for result in results) == ["p0", "p1", "p2"]
    return results, list(progress.notes)


def test_what_an_engine_leaves_unanswered_goes_to_c_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    results, notes = scored(Scripted("mjx-warp", in_run(1)), Scripted("mujoco", never), monkeypatch)
    assert sorted(result.outcome.engine for result in results) == ["mjx-warp", "mujoco", "mujoco"]
    assert notes == ["attempt 1: mjx-warp failed (RuntimeError: Warp CUDA error 901); 2 worlds: went to mujoco"]


@pytest.mark.parametrize("number", [each.number for each in ATTEMPTS[1:] if not each.checks])
def test_an_error_in_any_further_attempt_ends_no_run(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """C MuJoCo makes those that want double precision, and takes what the run's engine leaves unanswered.

    Attempts 6 and 7 are for worlds that sank, and 9 comes after 2 to 5 where it is asked for.
    """
    sinks = number in (6, 7)
    reason = Reason.SINKING if sinks else Reason.EXPLOSION
    run = 1 if sinks else min(number - 1, 5)
    own = Scripted("mjx-warp", in_run(2) if number == 6 else never, reason)
    c_engine = Scripted("mujoco", in_run(run), reason)
    results, notes = scored(own, c_engine, monkeypatch, Simulation(attempts="soft" if number == 9 else "rigid"))
    assert len(own.sims) == (2 if sinks else 1)
    failed = [result for result in results if result.outcome.reason is Reason.FAILED]
    assert {result.outcome.verdict for result in results} == {Verdict.INVALID}
    assert any(f"attempt {number}: mujoco failed" in note for note in notes)
    assert "worlds were simulated again on mujoco, in double precision" in notes
    by_attempt = [(a.attempt, a.reason) for result in results for a in result.attempts]
    assert (number, "failed") in by_attempt
    wants_doubles = {each.number for each in ATTEMPTS if each.doubles}
    assert all(a.engine == "mujoco" for result in results for a in result.attempts if a.attempt in wants_doubles)
    assert all(result.attempts[0].engine == "mjx-warp" for result in results)
    assert all(result.outcome.message for result in failed)


def test_conjugate_gradients_are_c_mujoco_s(monkeypatch: pytest.MonkeyPatch) -> None:
    own, c_engine = Scripted("mjx-warp", never), Scripted("mujoco", never)
    results, notes = scored(own, c_engine, monkeypatch, Simulation(solver=Solver.CG))
    assert own.sims == []
    assert {result.outcome.engine for result in results} == {"mujoco"}
    assert notes == ["worlds were simulated on mujoco: the solver cg is its"]


def test_what_an_engine_refuses_is_the_user_s_to_change(monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = Scripted("mjx-warp", lambda run: InputError("too many boxes"))
    with pytest.raises(InputError, match="too many boxes"):
        scored(refusing, Scripted("mujoco", never), monkeypatch)


def test_an_engine_of_one_s_own_has_no_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RuntimeError, match="901"):
        scored(Scripted("own", in_run(1)), Scripted("mujoco", never), monkeypatch)
    results, _ = scored(Scripted("own", in_run(2), Reason.EXPLOSION), Scripted("mujoco", never), monkeypatch)
    assert {result.outcome.engine for result in results} == {"own"}
