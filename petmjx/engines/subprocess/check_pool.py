"""Checks outcomes in processes beside a run. For many small worlds, checks in the run's own process would take longer
than the simulation on a GPU."""

from __future__ import annotations

import pickle
import queue
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Generic, TypeVar

import numpy as np

from petmjx.common.machine import cpu_threads
from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.subprocess.task_pipe import Child, serve
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job

LARGE: Final = 1000
"""Smallest number of worlds of a run for which check processes save time."""

MOST: Final = 3
"""Largest number of check processes. With three check processes, the run's own process is busier than each of them, so
a fourth would not make the run faster."""

THREADS_EACH: Final = 4
"""A machine with k times this number of CPU threads gets up to k check processes."""

MOST_WAITING: Final = 8
"""Largest number of unfinished checks of a process. Eight checks of 256 outcomes each take 20 MB."""

CHECK_WAIT_S: Final = 0.005
"""Longest uninterrupted wait for an answer, s. Signals and other work are handled after each wait."""

INTERRUPTED_S: Final = 2.0
"""Longest wait for all processes together after Ctrl-C, s. After this wait, the run's own process makes the remaining
checks."""

HANGS_S: Final = 60.0
"""A process counts as hanging if an answer takes longer than this time, s. A process normally starts within a few
seconds, and a check takes less than a second."""

_ANY_DRIVE: Final = Drive(Excitation("any", ACCELERATION, np.zeros((0, 3))))
"""Stands for the drive (motion of the carrier) of a job that is sent to a check process. Checks need to know only
whether the job has a drive."""

CheckTask = tuple[Sequence[Outcome], Sequence[Job], Simulation]
"""The arguments of ``outcome_checks``."""

CheckAnswer = tuple[Sequence[Outcome], Sequence[tuple[FloatArray, FloatArray]]]
"""Outcomes without their boxes, and for each outcome two arrays: the distances (m) of its boxes' loads from edges, in
the plan and at rest."""

Key = TypeVar("Key")


def max_check_processes(threads: int) -> int:
    """Number of check processes for a run on a machine with ``threads`` CPU threads."""
    return min(threads // THREADS_EACH, MOST)


@dataclass(eq=False)
class _CheckProcess(Generic[Key]):
    """A check process and its unfinished checks, with a key for each outcome. The process answers in order."""

    child: Child = field(default_factory=lambda: Child(__name__))
    unanswered: deque[tuple[list[Key], CheckTask]] = field(default_factory=deque)


class CheckPool(Generic[Key]):
    """Processes that check outcomes (``outcome_checks``). If a process gives no answer, the run's own process checks
    the outcomes.

    Each outcome has a key, by which the run identifies the outcome.
    """

    def __init__(self, processes: int) -> None:
        self._processes = [_CheckProcess[Key]() for _ in range(processes)]
        self._finished: list[tuple[Key, Outcome]] = []
        self._until_s: float | None = None

    @classmethod
    def here(cls) -> CheckPool[Key]:
        """A check pool with the number of processes that suits the number of CPU threads of this machine."""
        return cls(max_check_processes(cpu_threads()))

    def hurry(self) -> None:
        """From now on, wait for at most ``INTERRUPTED_S`` in total for all answers, since the run is about to end."""
        if self._until_s is None:
            self._until_s = time.monotonic() + INTERRUPTED_S

    def _hangs(self, waits: int) -> bool:
        """Whether a check process hangs, judged by the number of waits for its answer."""
        return waits * CHECK_WAIT_S >= HANGS_S if self._until_s is None else time.monotonic() >= self._until_s

    @property
    def has_unanswered(self) -> bool:
        """Whether any check is unfinished."""
        return any(process.unanswered for process in self._processes)

    def exchanged(
        self,
        keyed_outcomes: Sequence[tuple[Key, Outcome]],
        jobs: Sequence[Job],
        sim: Simulation,
        *,
        wait: bool,
        until: Callable[[], bool] = lambda: False,
    ) -> list[tuple[Key, Outcome]]:
        """Hand in outcomes to be checked, and return checked outcomes. The caller must not change outcomes while they
        are checked.

        Args:
            jobs: the job of each outcome.
            wait: whether to wait until all outcomes are checked.
            until: function that returns whether the caller has other work. If the caller has other work, the wait ends,
                and later calls return the remaining outcomes.
        """
        if keyed_outcomes:
            self._begin([key for key, _ in keyed_outcomes], ([outcome for _, outcome in keyed_outcomes], jobs, sim))
        for process in self._processes.copy():
            self._take(process, wait=False)
        while wait and not until() and (busy := [process for process in self._processes if process.unanswered]):
            self._take(busy[0], wait=True, until=until)
        finished, self._finished = self._finished, []
        return finished

    def _begin(self, keys: list[Key], task: CheckTask) -> None:
        """Start a check. The call waits if too many checks are unfinished."""
        outcomes, jobs, sim = task
        # Checks need no histories, samples of drives, or states. To unpickle states, a check process would have to
        # import JAX.
        light = [replace(outcome, state=None, history=None) for outcome in outcomes]
        sent = [replace(job, start=None, drive=_ANY_DRIVE if job.drive is not None else None) for job in jobs]
        while self._processes:
            process = min(self._processes, key=lambda candidate: len(candidate.unanswered))
            if len(process.unanswered) < MOST_WAITING:
                try:
                    pickled = pickle.dumps((light, sent, sim))
                except Exception:
                    break
                process.unanswered.append((keys, task))
                process.child.tasks.put(pickled)
                return
            self._take(process, wait=True)
        self._check(keys, task)

    def _check(self, keys: list[Key], task: CheckTask) -> None:
        """Check outcomes in this process."""
        self._finished += zip(keys, outcome_checks(*task), strict=True)

    def _take(self, process: _CheckProcess[Key], *, wait: bool, until: Callable[[], bool] = lambda: False) -> None:
        """Take those answers of a process that have already arrived. With ``wait``, wait for at least one answer,
        unless the caller has other work (``until``). A process that has died or hangs is removed from the check
        pool."""
        waits = 0  # waits are counted, not seconds: time in which this process is stopped (Ctrl-Z) does not count
        while process.unanswered:
            try:
                answer = process.child.answers.get(timeout=CHECK_WAIT_S) if wait else process.child.answers.get_nowait()
            except queue.Empty:
                if not wait or until():
                    return
                waits += 1
                if not self._hangs(waits):
                    continue
                answer = None
            wait = False
            if answer is None:
                self._processes.remove(process)
                process.child.end()
                while process.unanswered:
                    self._check(*process.unanswered.popleft())
                return
            keys, task = process.unanswered.popleft()
            # The answer is the text of an error. The check in this process will raise the same error.
            if isinstance(answer, str):
                self._check(keys, task)
                continue
            outcomes, edges = answer
            for outcome, sent, (plan_edge_m, rest_edge_m) in zip(outcomes, task[0], edges, strict=True):
                outcome.boxes = replace(sent.boxes, plan_edge_m=plan_edge_m, rest_edge_m=rest_edge_m)
                outcome.state, outcome.history = sent.state, sent.history
            self._finished += zip(keys, outcomes, strict=True)

    def close(self) -> None:
        """End the processes. Unfinished checks are dropped."""
        while self._processes:
            self._processes.pop().child.end()


def main() -> None:
    """Check the outcomes of tasks, one task after another, until the pipe of tasks ends. A check process needs neither
    JAX nor Warp."""
    serve(_checked)


def _checked(task: CheckTask) -> CheckAnswer | str:
    """The answer of a check process. If the check raises an error, the answer is a line of text."""
    try:
        outcomes = outcome_checks(*task)
        edges = [(outcome.boxes.plan_edge_m, outcome.boxes.rest_edge_m) for outcome in outcomes]
    except Exception as error:
        return one_line(error)
    for outcome in outcomes:
        del outcome.boxes  # the run still has these data, and unpickling them takes long
    return outcomes, edges
