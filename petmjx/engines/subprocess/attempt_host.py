"""Sends worlds to a process that simulates them beside the run (an *attempt process*), and receives the outcomes."""

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
"""Longest uninterrupted wait for an answer, s. Signals are handled after each wait."""


class SideSimulator(Protocol):
    """Simulates worlds while the caller continues."""

    def begin(self, task: Task) -> None:
        """Start to simulate a world. Returns at once."""

    def ended(self, *, wait: bool) -> Iterator[Answer]:
        """The answers that have arrived since the last call.

        Args:
            wait: whether to wait for at least one answer, if any task has no answer yet.
        """
        ...

    def close(self) -> None:
        """End the simulator. Tasks without an answer are dropped."""


class SubprocessSimulator:
    """Simulates worlds in a separate process, which is started for the first task.

    If the process dies, its open tasks get answers without an outcome, and the next task starts a new process. Idle
    processes are kept for the next user, since a new process has to load JAX, Warp and the kernel.
    """

    def __init__(self) -> None:
        self._process: Child | None = None
        self._unanswered: set[int] = set()

    def begin(self, task: Task) -> None:
        """See ``SideSimulator.begin``."""
        if self._process is None:
            self._process = _idle_child()
        self._unanswered.add(task.number)
        try:
            self._process.tasks.put(pickle.dumps(task))
        except Exception as error:
            self._process.answers.put(Answer(task.number, None, one_line(error)))

    def ended(self, *, wait: bool) -> Iterator[Answer]:
        """See ``SideSimulator.ended``."""
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
        """See ``SideSimulator.close``."""
        process, self._process = self._process, None
        if process is None:
            return
        if self._unanswered - {READY}:
            process.end()
        else:
            _IDLE.setdefault(os.getpid(), []).append(process)


_IDLE: Final[dict[int, list[Child]]] = {}
"""Process id of a process → the idle processes that it started. A fork of this process must not use these processes,
since a fork has no threads that write tasks and read answers."""


def _idle_child() -> Child:
    """An idle process that is alive; if there is none, a new process."""
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
