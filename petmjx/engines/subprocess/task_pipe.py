"""The pipes of a process beside a run: the process reads pickled tasks from its standard input, and writes pickled
answers to its standard output.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import IO, Any, Final, TypeVar

from petmjx.common.machine import own_environment
from petmjx.common.processes import collect_rarely

ANSWER_WAIT_S: Final = 0.25
"""Longest uninterrupted wait for an answer, s. Signals are handled after each wait."""

_NO_GPU: Final = {"JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": ""}


class Child:
    """A process beside the run, with its pipes. Threads of this process write the tasks and read the answers.

    Args:
        module: the module whose function ``main`` the process runs.

    Attributes:
        tasks: queue of pickled tasks; the entry None ends the queue.
        answers: queue of answers; the last entry is None.
    """

    def __init__(self, module: str) -> None:
        self.tasks: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self.answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._popen: subprocess.Popen[bytes] | None = None
        try:
            self._popen = subprocess.Popen(
                [sys.executable, "-c", f"from {module} import main; main()"],
                env={**own_environment(), **_NO_GPU},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            for target in (self._write, self._read):
                threading.Thread(target=target, args=(self._popen,), name="petmjx-pipe", daemon=True).start()
        except (OSError, RuntimeError):  # memory is short, or no interpreter can be started
            self.answers.put(None)

    @property
    def lives(self) -> bool:
        return self._popen is not None and self._popen.poll() is None

    @property
    def pid(self) -> int | None:
        return self._popen.pid if self._popen is not None else None

    def end(self) -> None:
        """Kill the process."""
        self.tasks.put(None)
        if self._popen is not None:
            self._popen.kill()
            self._popen.wait()

    def _write(self, popen: subprocess.Popen[bytes]) -> None:
        assert popen.stdin is not None
        with contextlib.suppress(OSError), popen.stdin as pipe:
            while (task := self.tasks.get()) is not None:
                pipe.write(task)
                pipe.flush()

    def _read(self, popen: subprocess.Popen[bytes]) -> None:
        assert popen.stdout is not None
        with popen.stdout as pipe:
            while (answer := next_of(pipe)) is not None:
                self.answers.put(answer)
        self.answers.put(None)


Item = TypeVar("Item")


def arrived(answers: queue.SimpleQueue[Item], *, wait: bool) -> Iterator[Item]:
    """The answers in a queue. ``wait``: whether to wait for the first answer."""
    while True:
        try:
            answer = answers.get(timeout=ANSWER_WAIT_S) if wait else answers.get_nowait()
        except queue.Empty:
            if wait:
                continue
            return
        wait = False
        yield answer


def serve(nice: int, answer_to: Callable[[Any], Any]) -> None:
    """Answer one task after another in this process beside a run. When the pipe of tasks ends, the process ends.

    Args:
        nice: see ``own_pipes``.
        answer_to: function that takes a task, and returns the answer.
    """
    tasks, answers = own_pipes(nice)
    while (task := next_of(tasks)) is not None:
        answer = answer_to(task)
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except BrokenPipeError:
            break
    os._exit(0)


def own_pipes(nice: int) -> tuple[IO[bytes], IO[bytes]]:
    """Set up this process beside a run when it starts, and return its pipes: tasks and answers. The threads of this
    process get a niceness, so that the threads of the run have priority. Ctrl-C is ignored, since the run handles
    Ctrl-C and ends this process."""
    collect_rarely()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(nice)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries that print must not print among the answers
    return sys.stdin.buffer, answers


def next_of(pipe: IO[bytes]) -> Any:
    """The next object from a pipe. The result is None at the end of the pipe, and also if the object cannot be read,
    because the pipe ends within the object, memory is short, or its class cannot be imported."""
    try:
        return pickle.load(pipe)
    except Exception:  # if this thread ended silently, the run would wait for ever
        return None
