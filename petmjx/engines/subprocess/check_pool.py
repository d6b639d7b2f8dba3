"""Looks at outcomes in processes beside a run: of many small worlds the run itself would be slower than a GPU."""

from __future__ import annotations

import pickle
import queue
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Generic, TypeVar

from petmjx.common.machine import cpu_threads
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.subprocess.check_process import Look
from petmjx.engines.subprocess.task_pipe import Child
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

LARGE: Final = 1000
"""Worlds that are worth processes beside them."""

MOST: Final = 3
"""Processes. With three the run has more to do itself than each of them."""

THREADS_EACH: Final = 4
"""So many CPU threads of a machine are worth one of them."""

MOST_WAITING: Final = 8
"""Looks that wait for one of them: with 128 outcomes each, 10 MB."""

LOOK_S: Final = 0.005
"""Longest wait for an answer, s: a signal is noticed after it, or that there is something else to do."""

INTERRUPTED_S: Final = 2.0
"""After Ctrl-C: how long all of them together are waited for. What is left then is looked at here."""

HANGS_S: Final = 60.0
"""A process that is waited for and has not answered for so long hangs, s. It starts in a few seconds, and a look takes
less than one."""

Key = TypeVar("Key")


def max_check_processes(threads: int) -> int:
    """Processes beside a run that has so many CPU threads."""
    return min(threads // THREADS_EACH, MOST)


@dataclass(eq=False)
class _CheckProcess(Generic[Key]):
    """A process, and the looks that it has not answered, with a key for each outcome; it answers them in turn."""

    child: Child = field(default_factory=lambda: Child("petmjx.engines.subprocess.check_process"))
    unanswered: deque[tuple[list[Key], Look]] = field(default_factory=deque)


class CheckPool(Generic[Key]):
    """Processes that look at outcomes (``looked_at``). What none of them answers is looked at here.

    Each outcome has a key, by which the run knows it again.
    """

    def __init__(self, processes: int) -> None:
        self._lookers = [_CheckProcess[Key]() for _ in range(processes)]
        self._found: list[tuple[Key, Outcome]] = []
        self._until_s: float | None = None

    @classmethod
    def here(cls) -> CheckPool[Key]:
        """As many as this machine has CPU threads for."""
        return cls(max_check_processes(cpu_threads()))

    def hurry(self) -> None:
        """The run is about to end: wait no longer than a moment, whatever hangs."""
        if self._until_s is None:
            self._until_s = time.monotonic() + INTERRUPTED_S

    def _hangs(self, waits: int) -> bool:
        """Whether a process that was waited for so often takes too long."""
        return waits * LOOK_S >= HANGS_S if self._until_s is None else time.monotonic() >= self._until_s

    def exchanged(
        self,
        keyed_outcomes: Sequence[tuple[Key, Outcome]],
        jobs: Sequence[Job],
        sim: Simulation,
        *,
        wait: bool,
        until: Callable[[], bool] = lambda: False,
    ) -> list[tuple[Key, Outcome]]:
        """Give outcomes to be looked at, and take those that have been. Nobody may change outcomes meanwhile.

        Args:
            jobs: one for each outcome.
            wait: for all outcomes.
            until: whether there is something else to do: what has not been looked at by then follows in later calls.
        """
        if keyed_outcomes:
            self._begin([key for key, _ in keyed_outcomes], ([outcome for _, outcome in keyed_outcomes], jobs, sim))
        for looker in self._lookers.copy():
            self._take(looker, wait=False)
        while wait and not until() and (busy := [looker for looker in self._lookers if looker.unanswered]):
            self._take(busy[0], wait=True, until=until)
        finished, self._found = self._found, []
        return finished

    def _begin(self, keys: list[Key], look: Look) -> None:
        """Begin a look. Waits where too many have not been answered."""
        large = any(outcome.state is not None or outcome.history is not None for outcome in look[0])
        while self._lookers and not large:
            looker = min(self._lookers, key=lambda candidate: len(candidate.unanswered))
            if len(looker.unanswered) < MOST_WAITING:
                outcomes, jobs, sim = look
                # states are of no use there, and for those of a GPU it would have to import JAX
                sent = [replace(job, start=None) if job.start is not None else job for job in jobs]
                try:
                    task = pickle.dumps((outcomes, sent, sim))
                except Exception:
                    break
                looker.unanswered.append((keys, look))
                looker.child.tasks.put(task)
                return
            self._take(looker, wait=True)
        self._look(keys, look)

    def _look(self, keys: list[Key], look: Look) -> None:
        """Look here."""
        self._found += zip(keys, outcome_checks(*look), strict=True)

    def _take(self, looker: _CheckProcess[Key], *, wait: bool, until: Callable[[], bool] = lambda: False) -> None:
        """Take the answers of a process, with ``wait`` one at least, or until there is something else to do. One that
        died or hangs is done without."""
        waits = 0  # not the time: while this process is stopped itself (Ctrl-Z), no answer is late
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
                self._lookers.remove(looker)
                looker.child.end()
                while looker.unanswered:
                    self._look(*looker.unanswered.popleft())
                return
            keys, look = looker.unanswered.popleft()
            if isinstance(answer, str):  # an error, which is raised here
                self._look(keys, look)
                continue
            outcomes, edges = answer
            for outcome, sent, (plan_edge_m, rest_edge_m) in zip(outcomes, look[0], edges, strict=True):
                outcome.boxes = replace(sent.boxes, plan_edge_m=plan_edge_m, rest_edge_m=rest_edge_m)
            self._found += zip(keys, outcomes, strict=True)

    def close(self) -> None:
        """End the processes. What is unanswered is for nobody."""
        while self._lookers:
            self._lookers.pop().child.end()
