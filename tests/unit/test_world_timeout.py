"""Tests of the computing time that a world on C MuJoCo may take, and of the message that is shown meanwhile."""

from __future__ import annotations

from itertools import pairwise

import pytest
from support.plans import make_plan, make_scene, stack

import petmjx
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.mujoco import world_timeout as budgets
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.world_timeout import LEAST_S, MOST_TIMES, Budget
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Flag
from petmjx.options.simulation import Check, Simulation
from petmjx.world.job import Job

STATIC = Simulation(check="static")


class Clock:
    """A mock of the module ``time``."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def thread_time(self) -> float:
        return self.now_s

    monotonic = thread_time


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(budgets, "time", made)
    return made


def spent_after(budget: Budget, clock: Clock) -> float:
    """The time at which the budget is spent, s."""
    while not budget.is_spent(0, 3):
        clock.now_s += 0.5
    return clock.now_s


@pytest.mark.parametrize("check", ["static", "one-by-one"])
def test_small_worlds_have_the_least_time(check: str, clock: Clock) -> None:
    budget = Budget(Job(make_scene(3)), Simulation(check=check))
    assert spent_after(budget, clock) == LEAST_S[Check(check)] + 0.5


def test_large_ones_have_a_multiple_of_what_is_expected(clock: Clock) -> None:
    job = Job(make_scene(stack(150, size_mm=(400, 300, 50))))
    expected_s = float(MEASURED.of_jobs([job], STATIC)[0])
    assert expected_s * MOST_TIMES > LEAST_S[Check.STATIC]
    assert spent_after(Budget(job, STATIC), clock) == pytest.approx(MOST_TIMES * expected_s, abs=0.5)
    assert spent_after(Budget(job, STATIC, 2.0), clock) == pytest.approx(clock.now_s)  # its own time is what it is


def test_slow_steps_are_looked_at_one_by_one(clock: Clock) -> None:
    budget = Budget(Job(make_scene(3)), STATIC)
    seen = []
    for step_s in (0.001, 0.06, 0.06, 0.001):
        clock.now_s += step_s
        assert not budget.is_spent(0, 3)
        seen.append(budget.slow)
    assert seen == [False, True, True, False]


def test_a_static_check_ends_with_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    """If many boxes are at the same place, there are thousands of contacts, and a step takes a tenth of a second or
    more. The static check of such a plan ends with a message."""
    monkeypatch.setitem(LEAST_S, Check.STATIC, 0.2)
    monkeypatch.setattr(budgets, "MOST_TIMES", 0.0)
    plan = make_plan("heap", [((400, 300, 200), (0, 0, 0), 5.0)] * 40)
    run = petmjx.score([plan], engine="mujoco", check="static", threads=1)
    (world,) = run.worlds.to_dict("records")
    assert (world["verdict"], world["reason"], world["attempt"]) == ("invalid", "timeout", 1)
    assert world["flags"] & int(Flag.TIMEOUT)
    (warning,) = [warning for warning in run.info["warnings"] if "no verdict" in warning]
    assert warning.startswith("plan heap: no verdict within 1 s of CPU time: 40 of 40 boxes placed, ")
    assert warning.endswith("world_timeout_s allows more time")


def test_what_has_fallen_by_then_is_unstable(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a box has dropped before the time is up, the world is unstable, even without early stop."""
    plan = make_plan("falls", [((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (380, 0, 200), 5.0)])
    world = petmjx.score([plan], engine="mujoco", early_stop=False, threads=1).worlds.iloc[0]
    looks = iter(range(10_000))
    monkeypatch.setattr(Budget, "is_spent", lambda self, steps, placed: next(looks) > 180)
    cut = petmjx.score([plan], engine="mujoco", early_stop=False, threads=1).worlds.iloc[0]
    assert cut.n_steps < world.n_steps
    assert (cut.verdict, cut.culprit) == (world.verdict, world.culprit) == ("unstable", 1)
    assert cut["flags"] & int(Flag.EARLY_STOP)
    assert not cut["flags"] & int(Flag.TIMEOUT)


def test_it_is_shown_how_far_a_long_world_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budgets, "LONG_S", 0.0)
    monkeypatch.setattr("petmjx.engines.mujoco.engine.WORLD_WAIT_S", 0.01)
    progress = Progress(pauses=True)
    shown = []
    for outcome in MujocoEngine(1).run([Job(make_scene(stack(12, size_mm=(400, 300, 50))))], Simulation(), progress):
        if outcome is None:
            shown.append(progress.message)
    words = [word for word in shown if word]
    assert words
    assert all(word.startswith("one world for ") and " of 12 boxes placed, " in word for word in words)
    placed = [int(word.split(": ")[1].split(" of ")[0]) for word in words]
    assert all(before <= after for before, after in pairwise(placed))
    assert progress.message == ""
