"""Checks outcomes in processes beside a run. If a run with many small worlds checked them itself, it would be slower
than a GPU."""

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
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.subprocess.check_process import Look
from petmjx.engines.subprocess.task_pipe import Child
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job

LARGE: Final = 1000
"""Smallest number of worlds of a run for which check processes save time."""

MOST: Final = 3
"""Largest number of check processes. With three, the run's own process is busier than each of them."""

THREADS_EACH: Final = 4
"""Number of CPU threads of a machine for each check process."""

MOST_WAITING: Final = 8
"""Largest number of unanswered checks of a process. With 256 outcomes each, they take 20 MB."""

LOOK_S: Final = 0.005
"""Longest wait for an answer, s. After each wait, signals and other work are noticed."""

INTERRUPTED_S: Final = 2.0
"""Longest wait for all processes together after Ctrl-C, s. The remaining checks are then made in this process."""

HANGS_S: Final = 60.0
"""A process counts as hanging if an answer takes longer than this, s. A process starts within a few seconds, and a
check takes less than a second."""

_ANY_DRIVE: Final = Drive(Excitation("any", ACCELERATION, np.zeros((0, 3))))
"""Replaces the drives of jobs that are sent to a check process: checks need to know only whether there is a drive."""

Key = TypeVar("Key")


def max_check_processes(threads: int) -> int:
    """Number of check processes for a run on a machine with this number of CPU threads."""
    return min(threads // THREADS_EACH, MOST)


@dataclass(eq=False)
class _CheckProcess(Generic[Key]):
    """A process, and its unanswered checks with a key for each outcome. The process answers checks in order."""

    child: Child = field(default_factory=lambda: Child("petmjx.engines.subprocess.check_process"))
    unanswered: deque[tuple[list[Key], Look]] = field(default_factory=deque)


class CheckPool(Generic[Key]):
    """Processes that check outcomes (``outcome_checks``). Outcomes that get no answer are checked in this process.

    Each outcome has a key, by which the run identifies it.
    """

    def __init__(self, processes: int) -> None:
        self._check_pool = [_CheckProcess[Key]() for _ in range(processes)]
        self._finished: list[tuple[Key, Outcome]] = []
        self._until_s: float | None = None

    @classmethod
    def here(cls) -> CheckPool[Key]:
        """A pool with the number of processes that suits this machine's CPU threads."""
        return cls(max_check_processes(cpu_threads()))

    def hurry(self) -> None:
        """From now on, wait only a moment, since the run is about to end."""
        if self._until_s is None:
            self._until_s = time.monotonic() + INTERRUPTED_S

    def _hangs(self, waits: int) -> bool:
        """Whether a process hangs, after this number of waits for its answer."""
        return waits * LOOK_S >= HANGS_S if self._until_s is None else time.monotonic() >= self._until_s

    @property
    def has_unanswered(self) -> bool:
        """Whether any check is still unanswered."""
        return any(looker.unanswered for looker in self._check_pool)

    def exchanged(
        self,
        keyed_outcomes: Sequence[tuple[Key, Outcome]],
        jobs: Sequence[Job],
        sim: Simulation,
        *,
        wait: bool,
        until: Callable[[], bool] = lambda: False,
    ) -> list[tuple[Key, Outcome]]:
        """Hand in outcomes to be checked, and return checked outcomes. Outcomes must not be changed meanwhile.

        Args:
            jobs: the job of each outcome.
            wait: whether to wait for all outcomes.
            until: function that returns whether other work is due. Outcomes not checked by then are returned by later
                calls.
        """
        if keyed_outcomes:
            self._begin([key for key, _ in keyed_outcomes], ([outcome for _, outcome in keyed_outcomes], jobs, sim))
        for looker in self._check_pool.copy():
            self._take(looker, wait=False)
        while wait and not until() and (busy := [looker for looker in self._check_pool if looker.unanswered]):
            self._take(busy[0], wait=True, until=until)
        finished, self._finished = self._finished, []
        return finished

    def _begin(self, keys: list[Key], look: Look) -> None:
        """Start a check. Waits if too many checks are unanswered."""
        outcomes, jobs, sim = look
        # checks need no histories, no samples of drives, and no states; for states, a process would have to import JAX
        light = [replace(outcome, state=None, history=None) for outcome in outcomes]
        sent = [replace(job, start=None, drive=_ANY_DRIVE if job.drive is not None else None) for job in jobs]
        while self._check_pool:
            looker = min(self._check_pool, key=lambda candidate: len(candidate.unanswered))
            if len(looker.unanswered) < MOST_WAITING:
                try:
                    task = pickle.dumps((light, sent, sim))
                except Exception:
                    break
                looker.unanswered.append((keys, look))
                looker.child.tasks.put(task)
                return
            self._take(looker, wait=True)
        self._look(keys, look)

    def _look(self, keys: list[Key], look: Look) -> None:
        """Check outcomes in this process."""
        self._finished += zip(keys, outcome_checks(*look), strict=True)

    def _take(self, looker: _CheckProcess[Key], *, wait: bool, until: Callable[[], bool] = lambda: False) -> None:
        """Take the answers of a process. With ``wait``, wait for at least one, unless other work is due (``until``). A
        process that has died or hangs is dropped."""
        waits = 0  # waits are counted instead of seconds: while this process is stopped (Ctrl-Z), no answer is late
        while looker.unanswered:
            try:
                answer = looker.child.answers.get(timeout=LOOK_S) if wait else looker.child.answers.get_nowait()
            except queue.Empty:
                if not wait or until():
                    return
                waits += 1
                if not self._hangs(waits):
                    continue
                answer = None
            wait = False
            if answer is None:
                self._check_pool.remove(looker)
                looker.child.end()
                while looker.unanswered:
                    self._look(*looker.unanswered.popleft())
                return
            keys, look = looker.unanswered.popleft()
            # The answer is the text of an error, which the check in this process will raise.
            if isinstance(answer, str):
                self._look(keys, look)
                continue
            outcomes, edges = answer
            for outcome, sent, (plan_edge_m, rest_edge_m) in zip(outcomes, look[0], edges, strict=True):
                outcome.boxes = replace(sent.boxes, plan_edge_m=plan_edge_m, rest_edge_m=rest_edge_m)
                outcome.state, outcome.history = sent.state, sent.history
            self._finished += zip(keys, outcomes, strict=True)

    def close(self) -> None:
        """End the processes. Unanswered checks are dropped."""
        while self._check_pool:
            self._check_pool.pop().child.end()
