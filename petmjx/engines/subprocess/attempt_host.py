"""Tasks for the process beside a run, and their answers: the side of the run."""

from __future__ import annotations

import atexit
import os
import pickle
import queue
from collections.abc import Iterator
from typing import Final, Protocol

from petmjx.common.text import one_line
from petmjx.engines.subprocess.attempt_process import READY, Answer, Task
from petmjx.engines.subprocess.task_pipe import Child

LOOK_S: Final = 0.25
"""Longest wait for an answer, s: a signal is noticed after it."""


class SideSimulator(Protocol):
    """Simulates worlds beside the caller."""

    def begin(self, task: Task) -> None:
        """Simulate a world. Returns at once."""

    def ended(self, *, wait: bool) -> Iterator[Answer]:
        """The answers that have come, each once.

        Args:
            wait: for one at least, if a task is unanswered.
        """
        ...

    def close(self) -> None:
        """Nothing is asked any more. What is unanswered is for nobody."""


class SubprocessSimulator:
    """Worlds in a process of their own, which starts with the first one.

    Tasks that a process leaves unanswered when it dies are answered without an outcome. The next task starts another
    one.
    Processes that have nothing to do are kept for the next user, since each has to load JAX, Warp and the kernel.
    """

    def __init__(self) -> None:
        self._process: Child | None = None
        self._unanswered: set[int] = set()

    def begin(self, task: Task) -> None:
        """As in the protocol."""
        if self._process is None:
            self._process = _idle_child()
        self._unanswered.add(task.number)
        try:
            self._process.tasks.put(pickle.dumps(task))
        except Exception as error:
            self._process.answers.put(Answer(task.number, None, one_line(error)))

    def ended(self, *, wait: bool) -> Iterator[Answer]:
        """As in the protocol."""
        while self._unanswered:
            assert self._process is not None
            try:
                answer = self._process.answers.get(timeout=LOOK_S) if wait else self._process.answers.get_nowait()
            except queue.Empty:
                if wait:
                    continue
                return
            wait = False
            if answer is not None:
                self._unanswered.discard(answer.number)
                yield answer
                continue
            died, self._unanswered = sorted(self._unanswered), set()
            self._process.end()
            self._process = None
            for number in died:
                yield Answer(number, None, "the process beside the run died")

    def close(self) -> None:
        """As in the protocol."""
        process, self._process = self._process, None
        if process is None:
            return
        if self._unanswered - {READY}:
            process.end()
        else:
            _IDLE.setdefault(os.getpid(), []).append(process)


_IDLE: Final[dict[int, list[Child]]] = {}
"""Processes that have nothing to do, by the process that has started them: a fork of it must not use them, too."""


def _idle_child() -> Child:
    """One that has nothing to do, or a new one."""
    idle = _IDLE.get(os.getpid(), [])
    while idle:
        process = idle.pop()
        if process.lives:
            return process
        process.end()
    return Child("petmjx.engines.subprocess.attempt_process")


@atexit.register
def _end_idle() -> None:
    for process in _IDLE.pop(os.getpid(), []):
        process.end()
