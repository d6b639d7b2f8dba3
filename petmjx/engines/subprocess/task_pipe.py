"""The pipes of a process beside a run: the process reads pickled tasks from its standard input, and writes pickled
answers to its standard output.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import IO, Any, Final, TypeVar

from petmjx.common.garbage_collection import collect_rarely
from petmjx.common.machine import own_environment

ANSWER_WAIT_S: Final = 0.25
"""Longest uninterrupted wait for an answer, s. Signals are handled after each wait."""

KILL_WAIT_S: Final = 5.0
"""Longest wait for processes to be killed by the process from which they were copied, s."""

NICE: Final = 5
"""Niceness of most processes beside a run: their threads have a lower priority than the threads of the run, which may
keep a GPU busy."""

_NO_GPU: Final = {"JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": ""}


class PipedProcess:
    """A process beside the run, with the queues of its tasks and answers. Threads of the run write the tasks to the
    pipe of the process, and read the answers.

    Attributes:
        tasks: queue of pickled tasks; the entry None ends the queue.
        answers: queue of answers; the last entry is None.
    """

    def __init__(self) -> None:
        self.tasks: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self.answers: queue.SimpleQueue[Any] = queue.SimpleQueue()

    def _begin(self, tasks: IO[bytes], answers: IO[bytes]) -> None:
        """Start the threads of these pipes. A thread closes its pipe at the end. A pipe whose thread cannot be started
        is closed here.

        Raises:
            RuntimeError: a thread cannot be started.
        """
        waiting = [(self._write, tasks), (self._read, answers)]
        try:
            while waiting:
                target, pipe = waiting[0]
                threading.Thread(target=target, args=(pipe,), name="petmjx-pipe", daemon=True).start()
                del waiting[0]
        finally:
            for _, pipe in waiting:
                pipe.close()

    def _write(self, tasks: IO[bytes]) -> None:
        with contextlib.suppress(OSError), tasks as pipe:
            while (task := self.tasks.get()) is not None:
                pipe.write(task)
                pipe.flush()

    def _read(self, answers: IO[bytes]) -> None:
        with answers as pipe:
            while (answer := next_of(pipe)) is not None:
                self.answers.put(answer)
        self.answers.put(None)


class Child(PipedProcess):
    """A process beside the run, with its pipes.

    Args:
        module: the module whose function ``main`` the process runs.
    """

    def __init__(self, module: str) -> None:
        super().__init__()
        self._popen: subprocess.Popen[bytes] | None = None
        try:
            self._popen = subprocess.Popen(
                _command(module, "main()"),
                env=_environment(),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            assert self._popen.stdin is not None
            assert self._popen.stdout is not None
            self._begin(self._popen.stdin, self._popen.stdout)
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


class Fork(PipedProcess):
    """A process beside the run, forked by the process of ``Forks``."""

    def __init__(self, connection: socket.socket | None) -> None:
        super().__init__()
        fds: list[int] = []
        try:
            if connection is None:
                raise OSError
            fds += os.pipe()
            fds += os.pipe()
            its_tasks, tasks, answers, its_answers = fds
            socket.send_fds(connection, [b"f"], [its_tasks, its_answers])
            pipes = os.fdopen(tasks, "wb"), os.fdopen(answers, "rb")
            fds = [its_tasks, its_answers]  # ``tasks`` and ``answers`` are closed together with ``pipes``
            self._begin(*pipes)
        except (OSError, RuntimeError):  # memory is short, or the other process has died
            self.answers.put(None)
        for fd in fds:
            os.close(fd)

    def end(self) -> None:
        """End the pipe of tasks: a process that waits for a task ends."""
        self.tasks.put(None)


class Forks:
    """Processes beside the run that are copies of one process. A copy starts in a hundredth of the time in which an
    interpreter starts and imports its modules.

    Args:
        module: the module whose function ``main`` the processes run.

    Attributes:
        are_possible: whether this system can copy processes. On macOS, system libraries may fail in a copy.
    """

    are_possible: Final = sys.platform == "linux"

    def __init__(self, module: str) -> None:
        self._popen: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._forks: list[Fork] = []
        own, its = socket.socketpair()
        try:
            self._popen = subprocess.Popen(
                _command(module, f"from {__name__} import copy; copy(main)"),
                env=_environment(),
                stdin=its.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                process_group=0,  # with one group, all copies can be killed at once
            )
            self._connection = own
        except OSError:  # memory is short, or no interpreter can be started
            own.close()
        its.close()

    def fork(self) -> Fork:
        """A further process. If the process cannot be started, the queue of its answers ends at once."""
        self._forks.append(Fork(self._connection))
        return self._forks[-1]

    def end(self) -> None:
        """Kill all processes."""
        for fork in self._forks:
            fork.end()
        if self._connection is not None:
            self._connection.close()
        if self._popen is not None:
            try:
                self._popen.wait(KILL_WAIT_S)
            except subprocess.TimeoutExpired:
                os.killpg(self._popen.pid, signal.SIGKILL)
                self._popen.wait()


def copy(main: Callable[[], None]) -> None:
    """The program of the process of ``Forks``. Its standard input is a socket, at which pairs of pipes arrive. For each
    pair, the program starts a copy of this process, and the copy runs the function ``main`` with these pipes. When the
    socket is closed, the process kills its copies, and ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    copies: list[int] = []  # an ended copy keeps its process id until ``waitpid``, so no other process is killed
    gc.collect()
    # garbage collection in a copy then leaves the objects of this process unchanged, so both processes share memory
    gc.freeze()
    with socket.socket(fileno=os.dup(0)) as connection:
        while True:
            message, fds, *_ = socket.recv_fds(connection, 1, 2)
            if not message:
                for pid in copies:
                    os.kill(pid, signal.SIGKILL)
                for pid in copies:
                    os.waitpid(pid, 0)
                os._exit(0)
            # If memory is too short for a copy, no process holds the pipes after they are closed below, so the run sees
            # their end.
            with contextlib.suppress(OSError):
                copies.append(os.fork())
                if not copies[-1]:
                    break
            for fd in fds:
                os.close(fd)
    for fd, standard in zip(fds, (0, 1), strict=True):
        os.dup2(fd, standard)
        os.close(fd)
    try:
        main()
    finally:
        os._exit(0)


def _command(module: str, call: str) -> list[str]:
    return [sys.executable, "-c", f"from {module} import main; {call}"]


def _environment() -> dict[str, str]:
    return {**own_environment(), **_NO_GPU}


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


def serve(answer_to: Callable[[Any], Any], *, nice: int = NICE) -> None:
    """Answer one task after another in this process beside a run. When the pipe of tasks ends, the process ends.

    Args:
        answer_to: function that takes a task, and returns the answer.
        nice: niceness of this process.
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


def own_pipes(nice: int = NICE) -> tuple[IO[bytes], IO[bytes]]:
    """Set up this process beside a run when it starts, and return its pipes: tasks and answers. Ctrl-C is ignored,
    since the run handles Ctrl-C and ends this process."""
    collect_rarely()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(nice)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries that print must not print among the answers
    return sys.stdin.buffer, answers


def next_of(pipe: IO[bytes]) -> Any:
    """The next object from a pipe. The result is None at the end of the pipe. It is also None if the object cannot be
    read, because the pipe ends within the object, memory is short, or the object's class cannot be imported."""
    try:
        return pickle.load(pipe)
    except Exception:  # if this thread ended silently, the run would wait for ever
        return None
