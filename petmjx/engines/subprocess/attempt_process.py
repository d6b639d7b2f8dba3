"""Processes that simulate single worlds beside a run, on engines with one thread. The attempt process simulates worlds
again (further *attempts*). The process of long worlds simulates long worlds of a GPU to their ends.

``AttemptProcess`` sends tasks to such a process, and receives the answers. ``serve_attempts`` is the work of the
process. The process sees no GPU, so its JAX and Warp use the CPU, even if JAX and Warp use a GPU in the run's process.
The process ends when its pipe of tasks ends, and so also when the process that started it ends.
"""

from __future__ import annotations

import atexit
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Final, Protocol

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import cpu_threads
from petmjx.common.text import one_line
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.subprocess.task_pipe import Child, arrived, next_of, own_pipes
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

GRANULE = 96
"""The number of box columns of tables is a multiple of this number, so that single worlds of nearly all sizes use the
same compiled programs."""

_BUILDING = threading.Lock()
"""A lock that is held while an engine is created, since the first engine starts JAX and Warp."""


READY = -1
"""Number of a task whose answer is not needed. The task only makes an engine compile its programs."""


JOBS_WORTH_A_PROCESS: Final = 64
"""If a run begins with this number of jobs or more on a GPU, processes for single worlds start before a world needs
them. Such a process takes some seconds to start."""


@dataclass(frozen=True)
class AttemptTask:
    """A world to simulate, and the name of the engine. ``job`` and ``sim`` are arguments of ``Engine.run``."""

    number: int
    engine: str
    job: Job
    sim: Simulation


@dataclass(frozen=True)
class AttemptAnswer:
    """The outcome of a task. If there is no outcome, ``outcome`` is None, and ``message`` says why in one line."""

    number: int
    outcome: Outcome | None
    message: str = ""


class AttemptSimulator(Protocol):
    """Simulates worlds while the caller continues."""

    def begin(self, task: AttemptTask) -> None:
        """Start to simulate a world. Returns at once."""

    def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
        """The answers that have arrived since the last call.

        Args:
            wait: whether to wait for at least one answer, if any task has no answer yet.
        """
        ...

    def close(self) -> None:
        """End the simulator. Tasks without an answer are dropped."""


class AttemptProcess:
    """Simulates worlds in a separate process, which is started for the first task.

    If the process dies, its open tasks get answers without an outcome, and the next task starts a new process. Idle
    processes are kept for the next ``AttemptProcess``, since a new process has to load JAX, Warp and the kernel.

    Args:
        module: the module whose function ``main`` the process runs. The function ``main`` calls ``serve_attempts``.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._process: Child | None = None
        self._unanswered: set[int] = set()

    def begin(self, task: AttemptTask) -> None:
        """See ``AttemptSimulator.begin``."""
        if self._process is None:
            self._process = _idle_child(self._module)
        self._unanswered.add(task.number)
        try:
            self._process.tasks.put(pickle.dumps(task))
        except Exception as error:
            self._process.answers.put(AttemptAnswer(task.number, None, one_line(error)))

    def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
        """See ``AttemptSimulator.ended``."""
        if not self._unanswered:
            return
        assert self._process is not None
        for answer in arrived(self._process.answers, wait=wait):
            if answer is not None:
                self._unanswered.discard(answer.number)
                yield answer
                continue
            died, self._unanswered = sorted(self._unanswered), set()
            self._process.end()
            self._process = None
            for number in died:
                yield AttemptAnswer(number, None, "the process that simulates further attempts died")
            return

    def close(self) -> None:
        """See ``AttemptSimulator.close``."""
        process, self._process = self._process, None
        if process is None:
            return
        if self._unanswered - {READY}:
            process.end()
        else:
            _IDLE.setdefault((os.getpid(), self._module), []).append(process)


_IDLE: Final[dict[tuple[int, str], list[Child]]] = {}
"""(Process id, module) → the idle processes that the process with this id started for this module. A fork cannot use
the idle processes of the original process, since it has no threads that write tasks and read answers. The key has the
process id, which differs between a fork and its original process, so a fork finds only its own idle processes."""


def _idle_child(module: str) -> Child:
    """An idle process that is alive; if there is none, a new process."""
    idle = _IDLE.get((os.getpid(), module), [])
    while idle:
        process = idle.pop()
        if process.lives:
            return process
        process.end()
    return Child(module)


@atexit.register
def _end_idle() -> None:
    for pid, module in [*_IDLE]:
        if pid == os.getpid():
            for process in _IDLE.pop((pid, module)):
                process.end()


def serve_attempts(make_engine: Callable[[str], Engine]) -> None:
    """The work of the process: simulate the worlds of all tasks on threads, and answer in any order.

    Args:
        make_engine: function that takes the name of an engine, and creates this engine with one thread.
    """
    tasks, answers = own_pipes()
    thread_state, writing = threading.local(), threading.Lock()

    def answer(task: AttemptTask) -> None:
        reply = answer_to(task, vars(thread_state), make_engine, granule=GRANULE)
        try:
            data = pickle.dumps(reply)
        except Exception as error:
            data = pickle.dumps(AttemptAnswer(task.number, None, one_line(error)))
        with writing, suppress(BrokenPipeError):
            answers.write(data)
            answers.flush()

    pool = ThreadPoolExecutor(max(cpu_threads() - 1, 1), thread_name_prefix="petmjx-attempts")
    while (task := next_of(tasks)) is not None:
        pool.submit(answer, task)
    os._exit(0)  # ends running tasks, whose outcomes are no longer needed


def answer_to(
    task: AttemptTask,
    engines: dict[str, Engine],
    make_engine: Callable[[str], Engine],
    stops: Callable[[], bool] = lambda: False,
    granule: int | None = None,
) -> AttemptAnswer:
    """Simulate the world of a task.

    Args:
        engines: name → engine, for the engines of this thread. A missing engine is created and added.
        make_engine: see ``serve_attempts``.
        stops: function that returns whether the outcome is no longer needed.
        granule: the number of box columns of tables is a multiple of this number. If ``granule`` is None, the engine's
            default is used.
    """
    outcome, progress = None, Progress(pauses=True)
    try:
        if task.engine not in engines:
            with _BUILDING:
                engine = make_engine(task.engine)
            if granule is not None and hasattr(engine, "granule"):
                engine.granule = granule
            engines[task.engine] = engine
        with closing(engines[task.engine].run([task.job], task.sim, progress)) as answers:  # type: ignore[type-var]  # a generator
            for outcome in answers:
                if outcome is not None or stops():  # None means that the engine pauses
                    break
    except EngineUnavailable as error:
        return AttemptAnswer(task.number, None, str(error))
    except Exception as error:
        return AttemptAnswer(task.number, None, one_line(error))
    return AttemptAnswer(task.number, outcome, "" if outcome is not None else "no outcome")
