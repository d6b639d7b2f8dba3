"""The code of a worker process: it runs chunks (groups) of jobs on an engine and reports their outcomes.

The code also works without Ray.
"""

from __future__ import annotations

import os
import pickle
import platform
import queue
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any

from petmjx.common.errors import EngineUnavailable, PetmjxError
from petmjx.common.machine import device_name, package_versions, why_no_warp_at_once
from petmjx.common.processes import collect_rarely
from petmjx.common.text import one_line
from petmjx.engines.engine_choice import make_engine
from petmjx.engines.gpu_start import start_gpu
from petmjx.engines.outcome_checks import MOST_TOGETHER
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.subprocess.check_pool import LARGE, CheckPool
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

REPORT_S = 0.2
"""Time between two reports about a chunk, s. Each report costs a millisecond in the process that receives it."""


@dataclass(frozen=True)
class WorkerReady:
    """The first message of a worker, sent when it is ready. ``error``: the reason why the worker's engine cannot be
    created."""

    pid: int
    host: str
    device: str
    versions: dict[str, str]
    error: BaseException | None = None


@dataclass
class Report:
    """A report about a chunk of jobs: the outcomes since the last report, the progress since the beginning of the
    chunk, and the exception that ended the chunk, if any."""

    outcomes: list[Outcome]
    progress: Progress
    error: BaseException | None = None


@dataclass(frozen=True)
class Recipe:
    """The arguments of ``make_engine`` with which each worker creates its engine."""

    name: str
    options: dict[str, Any] = field(default_factory=dict)


class Worker:
    """Creates an engine once, and runs chunks of jobs on it. Several chunks may run at the same time, in threads.

    Args:
        threads: number of threads of the engine. If ``threads`` is None, the engine's default is used.
        check_pool: number of processes that check the outcomes of a large chunk. Only one large chunk runs at a time.
        thorough: whether the engine must be created before the worker reports that it is ready. If ``thorough`` is
            False (only for ``mjx-warp``), a thread creates the engine, which takes seconds, while the first jobs are
            made and sent.

    All data are pickled bytes. Objects from Ray's object store would be read-only, and would occupy the memory of the
    store.
    """

    def __init__(
        self, recipe: Recipe, cache_dir: str | None, threads: int | None, check_pool: int = 0, *, thorough: bool = True
    ) -> None:
        collect_rarely()
        if cache_dir is not None:
            os.environ.setdefault("PETMJX_CACHE_DIR", cache_dir)
        self._recipe, self._threads, self._check_processes = recipe, threads, check_pool
        self._check_pool: CheckPool[None] | None = None
        self._thorough = thorough
        self._built: Future[Engine] = Future()

    def hello(self) -> bytes:
        """Create the engine, or start to create it. Returns the pickled first message."""
        error: BaseException | None = None
        device = ""
        try:
            if self._thorough:
                self._build()
                self._built.result()
            elif problem := why_no_warp_at_once():
                raise EngineUnavailable(f"engine {self._recipe.name} cannot run here: {problem}")
            else:
                threading.Thread(target=self._build, name="petmjx-engine", daemon=True).start()
            device = device_name(self._recipe.name, self._threads)
        except Exception as raised:
            error = _sendable(raised)
        return pickle.dumps(WorkerReady(os.getpid(), platform.node(), device, package_versions(), error))

    def _build(self) -> None:
        """Create the engine, and start the other libraries for a GPU. If the engine cannot be created, the worker has
        no fallback engine.
        """
        name = self._recipe.name
        try:
            if name == "mjx-warp":
                start_gpu()
            self._built.set_result(make_engine(name, **self._recipe.options))
        except PetmjxError as error:
            self._built.set_exception(error)
        except BaseException as error:
            self._built.set_exception(EngineUnavailable(f"engine {name} cannot run here: {one_line(error)}"))

    def simulate(self, chunk: bytes) -> Iterator[bytes]:
        """Simulate the jobs of a chunk, the pickled pair (jobs, sim), and yield pickled reports. The outcomes are
        checked in this process. ``Outcome.job`` is the index of the job in the chunk."""
        jobs, sim = pickle.loads(chunk)
        check_pool = self._check_pool_for(jobs)
        news: queue.SimpleQueue[Outcome | None] = queue.SimpleQueue()
        progress = Progress()
        end_errors: list[BaseException] = []
        arguments = jobs, sim, progress, news, end_errors
        runner = threading.Thread(target=self._run, args=arguments, name="petmjx-chunk", daemon=True)
        runner.start()
        going, last_message = True, ""
        while going:
            new_outcomes, going = _gather(news)
            outcomes = _checked_outcomes(new_outcomes, jobs, sim, check_pool, wait=not going)
            if outcomes or not going or progress.message != last_message:
                last_message = progress.message
                # a copy, since the engine keeps writing into ``extra``
                so_far = replace(progress, extra=dict(progress.extra))
                yield pickle.dumps(Report(outcomes, so_far, end_errors[0] if end_errors else None))
        runner.join()

    def _check_pool_for(self, jobs: Sequence[Job]) -> CheckPool[None]:
        """The pool of processes that check the outcomes of a chunk. The first large chunk starts the processes, which
        are kept as long as the worker lives. The outcomes of a small chunk are checked by the worker itself."""
        if self._check_processes == 0 or len(jobs) < LARGE:
            return CheckPool(0)
        self._check_pool = self._check_pool or CheckPool(self._check_processes)
        return self._check_pool

    def _run(
        self,
        jobs: list[Job],
        sim: Simulation,
        progress: Progress,
        news: queue.SimpleQueue[Outcome | None],
        ended: list[BaseException],
    ) -> None:
        try:
            for outcome in self._built.result().run(jobs, sim, progress):
                news.put(outcome)
        except BaseException as error:
            ended.append(_sendable(error))
        finally:
            news.put(None)


def _gather(news: queue.SimpleQueue[Outcome | None]) -> tuple[list[Outcome], bool]:
    """The outcomes that arrive within ``REPORT_S``, and whether further outcomes may follow."""
    outcomes: list[Outcome] = []
    until = time.monotonic() + REPORT_S
    while (left := until - time.monotonic()) > 0:
        try:
            outcome = news.get(timeout=left)
        except queue.Empty:
            break
        if outcome is None:
            return outcomes, False
        outcomes.append(outcome)
    return outcomes, True


def _checked_outcomes(
    outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation, check_pool: CheckPool[None], *, wait: bool
) -> list[Outcome]:
    """Hand outcomes to the check pool, in groups. Returns the outcomes whose checks have ended.

    Args:
        wait: whether to wait for the checks of all outcomes.
    """
    keyed_outcomes: list[tuple[None, Outcome]] = []
    for first in range(0, len(outcomes), MOST_TOGETHER):
        chunk_outcomes = outcomes[first : first + MOST_TOGETHER]
        some_jobs = [jobs[outcome.job] for outcome in chunk_outcomes]
        keyed_outcomes += check_pool.exchanged(
            [(None, outcome) for outcome in chunk_outcomes], some_jobs, sim, wait=False
        )
    keyed_outcomes += check_pool.exchanged([], [], sim, wait=wait)
    return [outcome for _, outcome in keyed_outcomes]


def _sendable(error: BaseException) -> BaseException:
    """The exception itself; if it cannot be pickled, an exception with the same text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(one_line(error))
    return error
