"""Tests of the process in which further attempts (repeated simulations of doubtful worlds) run beside the engine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from support.plans import make_plan, make_world, stack
from support.waiting import wait_for

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.subprocess import attempt_process
from petmjx.engines.subprocess.attempt_process import AttemptAnswer, AttemptProcess, AttemptTask
from petmjx.options.simulation import Simulation

SIM = Simulation()

CHILD = "petmjx.engines.subprocess.attempt_child"

TOWER = make_world(make_plan("tower", stack(3))).job

LONG = make_world(make_plan("long", stack(60, size_mm=(400, 300, 20)))).job
"""A job that takes seconds."""


@pytest.fixture
def beside() -> Iterator[AttemptProcess]:
    helper = AttemptProcess(CHILD)
    yield helper
    helper.close()


def pid_of(beside: AttemptProcess) -> int:
    assert beside._process is not None
    assert beside._process._popen is not None
    return beside._process._popen.pid


def lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_its_answers_are_those_of_the_engine_and_it_is_kept_for_the_next_run(beside: AttemptProcess) -> None:
    [expected] = MujocoEngine(1).run([TOWER], SIM)
    assert list(beside.ended(wait=True)) == []
    beside.begin(AttemptTask(7, "mujoco", TOWER, SIM))
    beside.begin(AttemptTask(8, "no-such", TOWER, SIM))
    answer_by_number: dict[int, AttemptAnswer] = {}
    while len(answer_by_number) < 2:
        answer_by_number |= {answer.number: answer for answer in beside.ended(wait=True)}
    assert answer_by_number[7].outcome is not None
    assert answer_by_number[7].outcome.n_steps == expected.n_steps
    np.testing.assert_array_equal(answer_by_number[7].outcome.boxes.pos, expected.boxes.pos)
    np.testing.assert_array_equal(answer_by_number[7].outcome.boxes.max_top_force_n, expected.boxes.max_top_force_n)
    assert answer_by_number[8].outcome is None
    assert "unknown engine 'no-such'" in answer_by_number[8].message
    first = pid_of(beside)
    beside.close()
    following = AttemptProcess(CHILD)
    following.begin(AttemptTask(0, "mujoco", TOWER, SIM))
    assert pid_of(following) == first
    following.close()  # while one task has no answer
    assert not lives(first)


def test_a_process_that_dies_is_told_of_and_replaced(beside: AttemptProcess) -> None:
    beside.begin(AttemptTask(1, "mujoco", LONG, SIM))
    beside.begin(AttemptTask(2, "mujoco", LONG, SIM))
    os.kill(pid_of(beside), signal.SIGKILL)
    died = list(beside.ended(wait=True))
    assert [answer.number for answer in died] == [1, 2]
    assert all(answer.outcome is None and "died" in answer.message for answer in died)
    beside.begin(AttemptTask(3, "mujoco", TOWER, SIM))
    (answer,) = beside.ended(wait=True)
    assert answer.outcome is not None


def test_what_cannot_be_sent_and_what_cannot_start_is_told_of(
    beside: AttemptProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attempt_process, "_IDLE", {})
    monkeypatch.setattr(sys, "executable", "no-such-interpreter")
    beside.begin(AttemptTask(1, "mujoco", TOWER, SIM))
    (answer,) = beside.ended(wait=True)
    assert answer.outcome is None
    monkeypatch.undo()
    beside.begin(AttemptTask(2, "mujoco", TOWER, lambda: SIM))  # type: ignore[arg-type]
    (answer,) = beside.ended(wait=True)
    assert answer.outcome is None
    assert "pickle" in answer.message.lower()


RUN = """
import sys, time
from support.plans import make_plan, make_world, stack
from petmjx.options.simulation import Simulation
from petmjx.engines.subprocess.attempt_process import AttemptProcess
from petmjx.engines.subprocess.attempt_process import AttemptTask

beside = AttemptProcess("petmjx.engines.subprocess.attempt_child")
job = make_world(make_plan("long", stack(60, size_mm=(400, 300, 20)))).job
beside.begin(AttemptTask(1, "mujoco", job, Simulation()))
print(beside._process._popen.pid, flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")
def test_it_ends_with_the_process_that_started_it() -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", RUN], env=environment, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        pid = int(run.stdout.readline())
        assert lives(pid)
        run.kill()
    wait_for(lambda: not lives(pid))
