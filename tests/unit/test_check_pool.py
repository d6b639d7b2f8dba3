"""Tests of the processes that check outcomes during a run. The findings of the processes are those of the run itself,
even if one of the processes dies."""

from __future__ import annotations

import io
import os
import pickle
import signal
import socket
import threading
import time
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from support.plans import make_plan, make_world, stack

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.subprocess.check_pool import CHECK_WAIT_S, MOST_WAITING, CheckPool
from petmjx.engines.subprocess.task_pipe import Fork, Forks, next_of
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.simulation import Simulation
from petmjx.repairs.repair_options import RepairOptions
from petmjx.repairs.search import Search
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job

SIM = Simulation()
JOBS = [make_world(make_plan(f"stack of {n}", stack(n))).job for n in (1, 3)]


@pytest.fixture(scope="module")
def raw() -> list[Outcome]:
    """Outcomes of an engine before they are checked."""
    return sorted(MujocoEngine(1).run(JOBS, SIM), key=lambda outcome: outcome.job)


@pytest.fixture(scope="module")
def lasting_pool() -> Iterator[CheckPool[Any]]:
    """For tests that leave both processes alive, and nothing to wait for."""
    pool = CheckPool[Any](2)
    yield pool
    pool.close()


@pytest.fixture
def check_pool() -> Iterator[CheckPool[Any]]:
    pool = CheckPool[Any](2)
    yield pool
    pool.close()


def pids(check_pool: CheckPool[Any]) -> list[int]:
    return [process.child.pid for process in check_pool._processes if process.child.pid is not None]


def told(outcomes: list[Outcome]) -> list[tuple[Any, ...]]:
    return [
        (outcome.job, outcome.verdict, outcome.plan_edge_m, outcome.rest_edge_m, outcome.margin, outcome.flags)
        for outcome in outcomes
    ]


def expected(raw: list[Outcome]) -> list[tuple[Any, ...]]:
    rows = told(outcome_checks(deepcopy(raw), JOBS, SIM))
    assert {row[1] for row in rows} == {Verdict.STABLE}
    assert all(0 < edge < 1 for _, _, *edges, _, _ in rows for edge in edges)
    return rows


def given(raw: list[Outcome], key: Any) -> list[tuple[Any, Outcome]]:
    """Copies of outcomes, each with a key."""
    return [((key, outcome.job), outcome) for outcome in deepcopy(raw)]


def test_they_find_what_the_run_would(lasting_pool: CheckPool[Any], raw: list[Outcome]) -> None:
    assert len(pids(lasting_pool)) == 2
    outcomes: dict[Any, Outcome] = {}
    many = 2 * MOST_WAITING + 3  # more outcomes than may wait for the processes
    for key in range(many):
        outcomes |= lasting_pool.exchanged(given(raw, key), JOBS, SIM, wait=False)
    outcomes |= lasting_pool.exchanged([], [], SIM, wait=True)
    assert sorted(outcomes) == [(key, job) for key in range(many) for job in range(len(JOBS))]
    for key in range(many):
        assert told([outcomes[key, job] for job in range(len(JOBS))]) == expected(raw)
        for job, sent in enumerate(raw):
            np.testing.assert_array_equal(outcomes[key, job].boxes.pos, sent.boxes.pos)
    assert lasting_pool.exchanged([], [], SIM, wait=True) == []


def test_what_was_measured_of_boxes_stays_with_the_run(lasting_pool: CheckPool[Any], raw: list[Outcome]) -> None:
    sent = given(raw, "once")
    boxes = [outcome.boxes for _, outcome in sent]
    outcomes = dict(lasting_pool.exchanged(sent, JOBS, SIM, wait=True))
    assert [outcomes["once", job].boxes.pos is boxes[job].pos for job in range(len(JOBS))] == [True, True]
    assert [np.isfinite(outcomes["once", job].boxes.plan_edge_m).any() for job in range(len(JOBS))] == [True, True]
    assert [outcomes["once", job] is sent[job][1] for job in range(len(JOBS))] == [False, False]


def test_the_run_looks_itself_where_they_do_not(check_pool: CheckPool[Any], raw: list[Outcome]) -> None:
    one, other = pids(check_pool)
    # one outcome cannot be sent to a process; others are sent to processes that are stopped and then killed
    os.kill(one, signal.SIGSTOP)
    os.kill(other, signal.SIGSTOP)
    unsendable = [Job(job.scene, record=lambda: None) for job in JOBS]  # type: ignore[arg-type]
    outcomes = dict(check_pool.exchanged(given(raw, "unsendable"), unsendable, SIM, wait=False))
    assert len(outcomes) == len(JOBS)
    for key in range(5):
        assert check_pool.exchanged(given(raw, key), JOBS, SIM, wait=False) == []
    os.kill(one, signal.SIGKILL)
    os.kill(other, signal.SIGKILL)
    outcomes |= check_pool.exchanged(given(raw, 5), JOBS, SIM, wait=True)
    assert pids(check_pool) == []
    outcomes |= check_pool.exchanged(given(raw, "none is left"), JOBS, SIM, wait=False)
    for key in ("unsendable", *range(6), "none is left"):
        assert told([outcomes[key, job] for job in range(len(JOBS))]) == expected(raw)


@pytest.mark.parametrize("driven", [False, True], ids=["placed", "driven"])
def test_states_histories_and_samples_stay_here(
    lasting_pool: CheckPool[Any], raw: list[Outcome], monkeypatch: pytest.MonkeyPatch, driven: bool
) -> None:
    """Outcomes with states, histories or samples are checked in this process. Another process would have to import the
    modules of the states, and would take longer to receive samples than to check them."""
    here: Any = lambda: None  # noqa: E731  # cannot be sent
    drive = Drive(Excitation("drive", ACCELERATION, here)) if driven else None
    jobs = [Job(job.scene, start=here, drive=drive) for job in JOBS]
    sent = given(raw, 0)
    for _, outcome in sent:
        outcome.state = outcome.history = here
    # the checks must run in other processes
    monkeypatch.setattr("petmjx.engines.subprocess.check_pool.outcome_checks", None)
    assert lasting_pool.exchanged(sent, jobs, SIM, wait=False) == []
    outcomes = dict(lasting_pool.exchanged([], [], SIM, wait=True))
    assert [(outcomes[0, job].state, outcomes[0, job].history) for job in range(2)] == [(here, here)] * 2
    if not driven:
        assert told([outcomes[0, job] for job in range(len(JOBS))]) == expected(raw)


def test_a_process_that_hangs_is_not_waited_for_without_end(
    check_pool: CheckPool[Any], raw: list[Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = pids(check_pool)
    check_pool.exchanged(given(raw, "started"), JOBS, SIM, wait=True)
    monkeypatch.setattr("petmjx.engines.subprocess.check_pool.HANGS_S", 2 * CHECK_WAIT_S)
    os.kill(one, signal.SIGSTOP)
    check_pool.exchanged(given(raw, 0), JOBS, SIM, wait=False)
    outcomes = dict(check_pool.exchanged([], [], SIM, wait=True))
    assert told([outcomes[0, job] for job in range(len(JOBS))]) == expected(raw)
    assert pids(check_pool) == [other]
    with pytest.raises(ProcessLookupError):
        os.kill(one, 0)


def test_waiting_ends_when_there_is_something_else_to_do(lasting_pool: CheckPool[Any], raw: list[Outcome]) -> None:
    stopped, answers = pids(lasting_pool), list[bool]()

    def later() -> bool:
        answers.append(len(answers) > 2)
        return answers[-1]

    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    assert lasting_pool.exchanged(given(raw, 0), JOBS, SIM, wait=True, until=later) == []
    assert answers[-1]
    assert lasting_pool.exchanged([], [], SIM, wait=True, until=lambda: True) == []
    for pid in stopped:
        os.kill(pid, signal.SIGCONT)
    outcomes = dict(lasting_pool.exchanged([], [], SIM, wait=True, until=lambda: False))
    assert told([outcomes[0, job] for job in range(len(JOBS))]) == expected(raw)
    assert pids(lasting_pool) == stopped


@pytest.mark.parametrize("sent", [b"", pickle.dumps(range(9))[:-3], b"cno_such_module\nname\n.", b"\x80\x04]K\x01R."])
def test_what_cannot_be_read_is_the_end_of_a_pipe(sent: bytes) -> None:
    assert next_of(io.BytesIO(sent)) is None


def test_an_error_is_raised_in_the_run(check_pool: CheckPool[Any], raw: list[Outcome]) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - NumPy words it
        check_pool.exchanged(given(raw, 0), JOBS[:1], SIM, wait=True)


def test_they_end_with_the_run(check_pool: CheckPool[Any]) -> None:
    some = pids(check_pool)
    check_pool.close()
    for pid in some:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_after_ctrl_c_all_that_hang_are_waited_for_a_moment_together(
    check_pool: CheckPool[Any], raw: list[Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("petmjx.engines.subprocess.check_pool.INTERRUPTED_S", 2 * CHECK_WAIT_S)
    stopped = pids(check_pool)
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    for key in range(4):
        check_pool.exchanged(given(raw, key), JOBS, SIM, wait=False)
    begin = time.monotonic()
    check_pool.hurry()
    outcomes = dict(check_pool.exchanged([], [], SIM, wait=True))
    assert time.monotonic() - begin < 20  # generous, for a busy machine; each process would have had a minute
    for key in range(4):
        assert told([outcomes[key, job] for job in range(len(JOBS))]) == expected(raw), "nothing that came is lost"
    assert pids(check_pool) == []


@pytest.mark.skipif(not Forks.are_possible, reason="this system cannot copy processes")
def test_copies_of_a_process_run_beside_each_other_and_end_with_it() -> None:
    """Each copy asks for the trials of its own plan. If the processes are killed, the run learns that the copies have
    died, and that there are no further ones."""
    forks = Forks("petmjx.repairs.search_processes")
    try:
        copies = [forks.fork() for _ in range(3)]
        for k, one in enumerate(copies):
            plan = make_plan(f"{k}", stack(2))
            one.tasks.put(pickle.dumps([Search(plan, SIM, RepairOptions(worlds=0))]))
        for k, one in enumerate(copies):
            message = one.answers.get(timeout=60)
            ((_, (request,)),) = message.batches
            assert (request.draft.plan.plan_id, message.ended, message.searches) == (f"{k}", [], None)
        copies[0].end()
        (search,) = copies[0].answers.get(timeout=60).searches
        assert (search.plan.plan_id, search.complete) == ("0", False)
        assert forks._popen is not None
        os.killpg(forks._popen.pid, signal.SIGKILL)
        for one in (*copies, forks.fork()):
            assert one.answers.get(timeout=60) is None
    finally:
        forks.end()


@pytest.mark.skipif(not Forks.are_possible, reason="this system cannot copy processes")
@pytest.mark.parametrize("n_started", [0, 1])
def test_pipes_without_threads_are_closed_once(n_started: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system lets no further thread start: first the one that writes tasks, then the one that reads answers. A
    pipe that was closed twice would close a file that has meanwhile got its number."""
    start_thread, close_fd, threads, closed = threading.Thread.start, os.close, list[threading.Thread](), list[int]()

    def start(thread: threading.Thread) -> None:
        if len(threads) == n_started:
            raise RuntimeError("can't start new thread")
        threads.append(thread)
        start_thread(thread)

    def close(fd: int) -> None:
        closed.append(fd)
        close_fd(fd)

    ours, its = socket.socketpair()
    with ours, its:
        before = open_files()
        with monkeypatch.context() as patch:
            patch.setattr(threading.Thread, "start", start)
            patch.setattr(os, "close", close)
            fork = Fork(ours)
        assert fork.answers.get(timeout=60) is None
        fork.end()
        _, (its_tasks, its_answers), *_ = socket.recv_fds(its, 1, 2)
        with os.fdopen(its_tasks, "rb") as tasks, os.fdopen(its_answers, "wb"):
            assert tasks.read() == b"", "the process learns that there are no tasks"
        for thread in threads:
            thread.join(60)
        assert open_files() <= before
        assert len(closed) == len({*closed}) == 2, "those of the process"


def open_files() -> set[str]:
    return {*os.listdir("/proc/self/fd")}
