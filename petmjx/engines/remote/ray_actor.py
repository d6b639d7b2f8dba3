"""The code of a worker process: it gets jobs for an engine in packets, and reports their outcomes.

The code also works without Ray.
"""

from __future__ import annotations

import hashlib
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
from weakref import WeakValueDictionary

from petmjx.common.errors import EngineUnavailable, PetmjxError
from petmjx.common.garbage_collection import collect_rarely
from petmjx.common.machine import device_name, package_versions, why_no_warp_at_once
from petmjx.common.text import one_line
from petmjx.engines.attempt_with_fallback import outcomes_of_stream
from petmjx.engines.contact_penetration import stiffened
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.gpu_start import start_gpu
from petmjx.engines.job_stream import JobBounds, JobStream
from petmjx.engines.outcome_checks import MOST_TOGETHER
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.subprocess.check_pool import LARGE, CheckPool
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Excitation, Job

REPORT_S = 0.2
"""Time between two reports of a worker that has enough jobs, s. Each report costs a millisecond in the process that
receives it."""

Packet = list[tuple[int, Job]]
"""Jobs that a worker gets at once, and the numbers by which the worker pool knows the jobs."""


@dataclass(frozen=True)
class WorkerReady:
    """The first message of a worker, sent when it is ready. ``error``: the reason why the worker's engine cannot be
    created."""

    pid: int
    host: str
    device: str
    versions: dict[str, str]
    error: BaseException | None = None


@dataclass(frozen=True)
class WorkerRun:
    """The arguments of a run in a worker. ``feedback``, ``bounds``, ``stiff``: see ``JobStream``."""

    sim: Simulation
    feedback: bool = False
    bounds: JobBounds | None = None
    stiff: frozenset[float] = frozenset()


@dataclass
class Report:
    """A report about a run: the outcomes since the last report, the progress since the beginning of the run, and the
    exception that ended the run, if any. ``Outcome.job`` is the number by which the worker pool knows the job."""

    outcomes: list[Outcome]
    progress: Progress
    error: BaseException | None = None


@dataclass(frozen=True)
class Recipe:
    """The arguments of ``make_engine`` with which each worker creates its engine."""

    name: str
    options: dict[str, Any] = field(default_factory=dict)


class Worker:
    """Creates an engine once, and simulates jobs on it, in one run after another. While a run simulates, further jobs
    arrive in packets.

    Args:
        threads: number of jobs that the engine simulates at the same time. None: the engine simulates worlds side by
            side.
        check_pool: number of processes that check the outcomes of a run with many jobs.
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
        self._packets: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def hello(self) -> bytes:
        """Create the engine, or start a thread that creates it. Returns the pickled first message."""
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
        """Create the engine. For ``mjx-warp``, start JAX and Warp first. If the engine cannot be created, the error is
        kept for the worker pool, because a worker has no fallback engine.
        """
        name = self._recipe.name
        try:
            if name == "mjx-warp":
                start_gpu()
            threads = {} if self._threads is None else {"threads": self._threads}
            self._built.set_result(make_engine(name, **(self._recipe.options | threads)))
        except PetmjxError as error:
            self._built.set_exception(error)
        except BaseException as error:
            self._built.set_exception(EngineUnavailable(f"engine {name} cannot run here: {one_line(error)}"))

    def feed(self, packet: bytes) -> None:
        """Add the jobs of a pickled ``Packet`` to the run. An empty packet (b"") means that no jobs follow: the run
        ends when all its jobs have outcomes."""
        self._packets.put(packet)

    def simulate(self, run: bytes) -> Iterator[bytes]:
        """Simulate the jobs of all packets up to the empty one, and yield pickled reports. The outcomes are checked in
        this process.

        Args:
            run: the pickled ``WorkerRun``.
        """
        jobs = _RunJobs(pickle.loads(run))
        progress = Progress()
        threading.Thread(target=self._take_packets, args=(jobs,), name="petmjx-packets", daemon=True).start()
        threading.Thread(target=self._run, args=(jobs, progress), name="petmjx-run", daemon=True).start()
        check_pool: CheckPool[None] = CheckPool(0)
        going, last_message = True, ""
        while going:
            answered, going = jobs.new_outcomes(self._threads or 1)
            if check_pool is not self._check_pool and self._check_processes and jobs.count >= LARGE:
                # the first large run starts the processes, which are kept as long as the worker lives
                check_pool = self._check_pool = self._check_pool or CheckPool(self._check_processes)
            outcomes = _checked_outcomes(answered, jobs.sim, check_pool, wait=not going or not jobs.unanswered)
            if outcomes or not going or progress.message != last_message:
                last_message = progress.message
                # the progress is copied, since the engine continues to change it
                so_far = replace(progress, extra=dict(progress.extra), notes=dict(progress.notes))
                yield pickle.dumps(Report(outcomes, so_far, jobs.error))

    def _take_packets(self, jobs: _RunJobs) -> None:
        """Put the jobs of each packet into the stream from which the engine takes jobs, until an empty packet
        arrives."""
        try:
            while packet := self._packets.get():
                jobs.put(pickle.loads(packet))
        except BaseException as error:
            jobs.end(RuntimeError(f"a worker failed: {one_line(error)}"))
        finally:
            jobs.close()

    def _run(self, jobs: _RunJobs, progress: Progress) -> None:
        """Simulate the jobs on the engine."""
        try:
            engine = self._built.result()
            for outcome in outcomes_of_stream(engine, jobs.stream, jobs.sim, progress):
                jobs.answered(outcome, engine.name)
            if not jobs.stream.closed or jobs.unanswered:
                raise RuntimeError(f"engine {engine.name} ended before all jobs had outcomes")
            jobs.end()
        except BaseException as error:
            jobs.end(_sendable(error))


class _RunJobs:
    """The jobs of a run in a worker, from their packets to their outcomes.

    Attributes:
        stream: the stream from which the engine takes jobs. An engine that waits for many jobs gets the jobs that have
            arrived, even if they are few, since the worker pool may have no others.
        count: number of jobs so far.
        error: the exception that ended the run.
    """

    def __init__(self, run: WorkerRun) -> None:
        self.sim, self.count = run.sim, 0
        self.stream = JobStream[tuple[int, Job]](
            most_boxes=1, feedback=run.feedback, bounds=run.bounds, stiff=run.stiff
        )
        self.error: BaseException | None = None
        self._excitations = WeakValueDictionary[tuple[str, str, bytes], Excitation]()
        """The excitations of the jobs that are in memory, by name, kind and digest."""
        self._news: queue.SimpleQueue[tuple[Job, Outcome] | None] = queue.SimpleQueue()

    @property
    def unanswered(self) -> int:
        """Number of jobs that the engine has not answered."""
        return self.stream.ready + len(self.stream.in_flight)

    def put(self, packet: Packet) -> None:
        """Add the jobs of a packet."""
        self.count += len(packet)
        distinct = {id(job.drive.excitation): job.drive.excitation for _, job in packet if job.drive is not None}
        known = {identity: self._known(excitation) for identity, excitation in distinct.items()}
        shared = (
            (number, replace(job, drive=replace(job.drive, excitation=known[id(job.drive.excitation)])))
            if job.drive is not None
            else (number, job)
            for number, job in packet
        )
        self.stream.put_all([(job, (number, job)) for number, job in shared])

    def _known(self, excitation: Excitation) -> Excitation:
        """The equal excitation of an earlier packet, if there is one; otherwise this excitation. An engine counts two
        equal objects as two excitations, and has room for a limited number of excitations (``JobBounds``)."""
        digest = hashlib.blake2b(excitation.samples.tobytes()).digest()
        return self._excitations.setdefault((excitation.name, excitation.kind, digest), excitation)

    def close(self) -> None:
        """Declare that no packet follows."""
        self.stream.close()
        self.stream.followed()

    def answered(self, outcome: Outcome, engine: str) -> None:
        """Take an outcome of the engine. The outcome's stream number becomes the number that the worker pool gave the
        job."""
        try:
            outcome.job, job = self.stream.answered(outcome.job)
        except KeyError:
            raise RuntimeError(
                f"engine {engine} returned an outcome for job {outcome.job}, but this job already has an outcome, "
                "or does not exist"
            ) from None
        self._news.put((job, outcome))

    def end(self, error: BaseException | None = None) -> None:
        """Declare that no outcome follows."""
        self.error = self.error or error
        self._news.put(None)

    def new_outcomes(self, threads: int) -> tuple[list[tuple[Job, Outcome]], bool]:
        """The outcomes that arrive within ``REPORT_S``, and whether further outcomes may follow. With fewer jobs left
        than ``threads``, an outcome is returned at once, since the engine has capacity for further jobs."""
        outcomes: list[tuple[Job, Outcome]] = []
        until = time.monotonic() + REPORT_S
        while (left := until - time.monotonic()) > 0:
            if outcomes and self._news.empty() and self.unanswered < threads:
                break
            try:
                entry = self._news.get(timeout=left)
            except queue.Empty:
                break
            if entry is None:
                return outcomes, False
            outcomes.append(entry)
        return outcomes, True


def _checked_outcomes(
    answered: Sequence[tuple[Job, Outcome]], sim: Simulation, check_pool: CheckPool[None], *, wait: bool
) -> list[Outcome]:
    """Hand outcomes to the check pool, in groups. Returns the outcomes whose checks have ended.

    Args:
        wait: whether to wait for the checks of all outcomes.
    """
    keyed_outcomes: list[tuple[None, Outcome]] = []
    by_stiff: dict[float | None, list[tuple[Job, Outcome]]] = {}
    for job, outcome in answered:
        by_stiff.setdefault(job.stiff, []).append((job, outcome))
    for stiff, group in by_stiff.items():
        group_sim = sim if stiff is None else stiffened(sim, stiff)
        for first in range(0, len(group), MOST_TOGETHER):
            some = group[first : first + MOST_TOGETHER]
            keyed = [(None, outcome) for _, outcome in some]
            keyed_outcomes += check_pool.exchanged(keyed, [job for job, _ in some], group_sim, wait=False)
    keyed_outcomes += check_pool.exchanged([], [], sim, wait=wait)
    return [outcome for _, outcome in keyed_outcomes]


def _sendable(error: BaseException) -> BaseException:
    """The exception itself; if it cannot be pickled, an exception with the same text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(one_line(error))
    return error
