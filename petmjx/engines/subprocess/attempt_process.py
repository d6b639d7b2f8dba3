"""The code of the process that simulates single worlds beside a run, on engines with one thread each.

The process reads tasks from a pipe. The process sees no GPU, so its JAX and Warp use the CPU, even if those of the
run's process use a GPU. The process ends when the pipe ends, and so also when the process that started it ends.
"""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import cpu_threads
from petmjx.common.text import one_line
from petmjx.engines.engine_choice import make_engine
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.subprocess.task_pipe import next_of, own_pipes
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

NICE = 5
"""Niceness of the threads of this process: they have a lower priority than the threads of the run, which keep a GPU
busy."""

GRANULE = 96
"""The number of box columns of tables is a multiple of this number, so that single worlds of nearly all sizes use the
same compiled programs."""

_BUILDING = threading.Lock()
"""A lock that is held while an engine is created, since the first engine starts JAX and Warp."""


READY = -1
"""Number of a task whose answer is not needed. The task only makes an engine compile its programs."""


@dataclass(frozen=True)
class Task:
    """A world to simulate, and the name of the engine. ``job`` and ``sim`` are arguments of ``Engine.run``."""

    number: int
    engine: str
    job: Job
    sim: Simulation


@dataclass(frozen=True)
class Answer:
    """The outcome of a task. If there is no outcome, ``outcome`` is None, and ``message`` says why in one line."""

    number: int
    outcome: Outcome | None
    message: str = ""


def main() -> None:
    """Read tasks from standard input and write answers to standard output, in any order, until the input ends."""
    tasks, answers = own_pipes(NICE)
    thread_state, writing = threading.local(), threading.Lock()

    def answer(task: Task) -> None:
        reply = answer_to(task, vars(thread_state), granule=GRANULE)
        try:
            data = pickle.dumps(reply)
        except Exception as error:
            data = pickle.dumps(Answer(task.number, None, one_line(error)))
        with writing, suppress(BrokenPipeError):
            answers.write(data)
            answers.flush()

    pool = ThreadPoolExecutor(max(cpu_threads() - 1, 1), thread_name_prefix="petmjx-beside")
    while (task := next_of(tasks)) is not None:
        pool.submit(answer, task)
    os._exit(0)  # the outcomes of running tasks are no longer needed


def answer_to(
    task: Task, engines: dict[str, Engine], stops: Callable[[], bool] = lambda: False, granule: int | None = None
) -> Answer:
    """Simulate the world of a task.

    Args:
        engines: name → engine, for the engines of this thread. A missing engine is created and added.
        stops: function that returns whether the outcome is no longer needed.
        granule: the number of box columns of tables is a multiple of this number. If ``granule`` is None, the engine's
            default is used.
    """
    outcome, progress = None, Progress(pauses=True)
    try:
        if task.engine not in engines:
            with _BUILDING:
                engine = make_engine(task.engine, threads=1)
            if granule is not None and hasattr(engine, "granule"):
                engine.granule = granule
            engines[task.engine] = engine
        with closing(engines[task.engine].run([task.job], task.sim, progress)) as answers:  # type: ignore[type-var]  # a generator
            for outcome in answers:
                if outcome is not None or stops():  # None is not an outcome: the engine pauses
                    break
    except EngineUnavailable as error:
        return Answer(task.number, None, str(error))
    except Exception as error:
        return Answer(task.number, None, one_line(error))
    return Answer(task.number, outcome, "" if outcome is not None else "no outcome")
