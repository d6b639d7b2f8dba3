"""An engine whose jobs run in worker processes of a Ray cluster. The engine sends chunks (groups) of jobs to workers,
collects outcomes, and replaces dead workers."""

from __future__ import annotations

import os
import pickle
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import package_versions
from petmjx.common.text import count_text, one_line
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.protocol import GROUP_WORLDS, Capability, Engine, Progress, RunLock, says_at_hand
from petmjx.engines.remote.chunk_dealer import Chunk, Deal
from petmjx.engines.remote.ray_actor import Recipe, Report, Worker, WorkerReady
from petmjx.engines.remote.ray_cluster import Cluster
from petmjx.engines.remote.worker_resources import Place
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import Scene

LOOK_S = 0.25
"""Longest wait for messages from workers, s. After each wait, signals are handled and progress is updated."""

START_S = 30.0
"""Longest wait for the first worker when the pool is created, s. So an engine that cannot run in a worker is reported
before a run begins. A busy cluster may need longer. If no worker is ready after this time, the run begins without a
worker, and waits for the first."""

FALSE_STARTS = 3
"""If this number of workers in a row fail to start, the run ends, or dead workers are no longer replaced."""

LEAST = {"mjx-warp": 512, "mjx-jax": 16}
"""Name of an engine → smallest number of jobs that are divided among several workers. If a run has fewer jobs, one
worker with this engine gets all jobs, since a device takes as long for a few worlds as for many."""

_HIGHEST = (" lanes", " contacts")
"""Endings of names in ``Progress.extra``. If a name has one of these endings, the largest value of all workers is
reported; for other names, the sum."""


@dataclass(eq=False)
class _Stream:
    """A chunk in a worker, and the part of its progress that has already been added to the run's progress."""

    chunk: Chunk
    counted: Progress = field(default_factory=Progress)


@dataclass(eq=False)
class _WorkerRecord:
    """The pool's record of a worker.

    Attributes:
        hello: Ray's reference to the worker's first message; None when this message has arrived.
        working: whether the worker's engine certainly exists: it was created before the first message, or the worker
            has reported about a chunk.
        streams: Ray's streams of reports, one for each chunk of the worker.
        message: the worker's last progress message.
    """

    place: Place
    actor: Any
    hello: Any
    pid: int = 0
    working: bool = False
    streams: dict[Any, _Stream] = field(default_factory=dict)
    compile_s: float = 0.0
    message: str = ""

    @property
    def ready(self) -> bool:
        return self.hello is None

    def has_room(self, plenty: bool) -> bool:
        """Whether the worker can take another chunk. ``plenty``: whether workers may hold chunks in reserve."""
        if not self.ready or any(stream.chunk.alone for stream in self.streams.values()):
            return False
        return len(self.streams) < self.place.slots * (2 if plenty else 1)


class WorkerPool(Engine):
    """The engine ``recipe.name`` in many processes. Outcomes are the same as those of the engine itself.

    A worker that dies is replaced, and its jobs without an outcome are given out again (``Deal``). Workers are kept
    between runs, until :meth:`close`.

    Args:
        places: the CPUs and GPUs of each worker. All workers start immediately.
        cluster: the cluster in which the workers run. :meth:`close` also closes the cluster.
        check_pool: number of processes of each worker that check outcomes (petmjx/engines/subprocess/check_pool.py).
    """

    def __init__(self, recipe: Recipe, places: Sequence[Place], cluster: Cluster, check_pool: int = 0) -> None:
        self.name = recipe.name
        self._recipe, self._cluster, self._ray, self._check_pool = recipe, cluster, cluster.ray, check_pool
        self._running = RunLock(self.name)
        # A thread waits for Ray: if the main thread did, exceptions of signal handlers would be lost.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="petmjx-workers")
        self._workers: list[_WorkerRecord] = []
        self._devices: dict[str, None] = {}
        self._false_starts = self._deaths = 0
        self._deadly: dict[int, Scene] = {}
        self._places = list(places)
        self.devices = max(round(sum(place.gpus for place in places)), 1)
        self._workers += (self._start(place) for place in places)

    def wait_for_first(self) -> None:
        """Wait until a worker is ready, but at most ``START_S``.

        Raises:
            EngineUnavailable: the engine cannot run in a worker.
        """
        first = time.monotonic() + START_S
        while not any(worker.ready for worker in self._workers) and time.monotonic() < first:
            for worker, ref in self._news():
                self._greet(worker, ref)

    @property
    def capabilities(self) -> Capability:
        """The capabilities of the workers' engine, and ``CHECKS``, since workers check their outcomes themselves."""
        return super().capabilities | Capability.CHECKS

    @property
    def size(self) -> int:
        """The number of workers."""
        return len(self._places)

    @property
    def device(self) -> str:
        """The number of workers, and the names of the devices that workers have reported."""
        return ": ".join(filter(None, (count_text(self.size, "worker"), ", ".join(self._devices))))

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers that are ready. An id is valid on the machine of its worker."""
        return [worker.pid for worker in self._workers if worker.ready]

    def dismiss(self) -> None:
        """End the workers. The cluster continues for its other users."""
        workers, self._workers = self._workers, []
        for worker in workers:
            self._kill(worker)

    def retire(self) -> None:
        """Start to end the workers, and the cluster if it was started for them."""
        try:
            self.dismiss()
        finally:
            self._thread.shutdown()  # an interrupted thread may still be waiting, and would hang when Ray ends
            self._cluster.leave()

    def close(self) -> None:
        """End the workers, and the cluster if it was started for them, and wait until they have ended."""
        try:
            self.retire()
        finally:
            self._cluster.close()

    @says_at_hand
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes are yielded as by the engine itself.

        Raises:
            EngineUnavailable: workers die while they start, a worker has other versions of packages than this process,
                or a worker cannot create its engine.
            PetmjxError: Ray has died.
            Exception: the engine in a worker raised this exception.
        """
        if not jobs:
            return
        with self._running:
            yield from self._run(jobs, sim, progress if progress is not None else Progress())

    def _run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress) -> Iterator[Outcome]:
        lacking = Counter(self._places)
        lacking.subtract(worker.place for worker in self._workers)
        self._workers += [self._start(place) for place in lacking.elements()]
        slots = sum(place.slots for place in self._places)
        deadly = [index for index, job in enumerate(jobs) if id(job.scene) in self._deadly]
        # a user's engine in workers is treated as an MJX engine, since it should inherit from one
        group = None if self.name == "mujoco" else GROUP_WORLDS.get(self.name, GROUP_WORLDS["mjx-jax"])
        least = LEAST.get(self.name, 1)
        deal = Deal(MEASURED.of_jobs(jobs, sim), slots, group, least, deadly)
        compiled_s, before = progress.compile_s, progress.message
        began = time.monotonic()
        for worker in self._workers:
            worker.compile_s, worker.message = 0.0, ""
        try:
            while deal.unanswered or any(worker.streams for worker in self._workers):
                self._hand_out(deal, jobs, sim)
                seconds = time.monotonic() - began
                if seconds >= START_S and not all(worker.ready for worker in self._workers):
                    self._cluster.check()
                progress.message = self._message(seconds) or before
                progress.at_hand = 0
                if progress.pauses:
                    yield None  # type: ignore[misc]  # callers that set ``pauses`` expect it
                for worker, ref in self._news():
                    if not worker.ready:
                        self._greet(worker, ref)
                        continue
                    if ref not in worker.streams:
                        continue  # the worker's death was noticed a moment ago, at another of its chunks
                    report = self._next_report(ref)
                    if isinstance(report, Report):
                        worker.working = True
                        yield from self._take(worker, worker.streams[ref], report, deal, progress)
                        progress.compile_s = compiled_s + max(worker.compile_s for worker in self._workers)
                    elif report is None:
                        missing = set(worker.streams.pop(ref).chunk.jobs) & deal.unanswered
                        if missing:
                            raise RuntimeError(
                                f"engine {self.name} returned no outcome for {count_text(len(missing), 'job')}"
                            )
                    else:
                        yield from self._bury(worker, deal, jobs, sim, progress)
            progress.message = before
        finally:
            busy = [worker for worker in self._workers if worker.streams]
            for worker in busy:  # nobody needs these workers' other chunks
                self._workers.remove(worker)
                self._kill(worker)

    # Workers.

    def _start(self, place: Place) -> _WorkerRecord:
        resources = {"num_cpus": place.cpus, "num_gpus": place.gpus}
        remote = self._ray.remote(Worker).options(**resources, max_concurrency=place.slots, max_restarts=0)
        threads = place.slots if self.name == "mujoco" else None
        thorough = self.name != "mjx-warp" or self._deaths > 0  # after a death, the device may be broken
        options = {"check_pool": self._check_pool, "thorough": thorough}
        actor = remote.remote(self._recipe, os.environ.get("PETMJX_CACHE_DIR"), threads, **options)
        return _WorkerRecord(place, actor, actor.hello.remote(), working=thorough)

    def _kill(self, worker: _WorkerRecord) -> None:
        worker.streams.clear()
        self._ray.kill(worker.actor)

    def _news(self) -> list[tuple[_WorkerRecord, Any]]:
        """Workers that have sent something. Each worker comes with the source of its message: the first message, or the
        stream of a chunk.
        """
        owner = {ref: worker for worker in self._workers for ref in (worker.hello, *worker.streams) if ref is not None}

        def wait() -> list[Any]:
            ready, _ = self._ray.wait(list(owner), num_returns=1, timeout=LOOK_S)
            return self._ray.wait(list(owner), num_returns=len(owner), timeout=0)[0] if ready else []

        return [(owner[ref], ref) for ref in self._thread.submit(wait).result()]

    def _greet(self, worker: _WorkerRecord, ref: Any) -> None:
        """Handle a worker's first message, or its death before this message."""
        try:
            hello: WorkerReady = pickle.loads(self._thread.submit(self._ray.get, ref).result())
        except self._ray.exceptions.RayError as death:
            self._start_again(worker, EngineUnavailable(f"workers die at their start: {one_line(death)}"), FALSE_STARTS)
            return
        if hello.error is not None:
            self._start_again(worker, hello.error, 1)
            return
        own_versions = package_versions()
        for package in sorted(own_versions.keys() & hello.versions.keys()):
            if own_versions[package] != hello.versions[package]:
                raise EngineUnavailable(
                    f"the worker on {hello.host} has {package} {hello.versions[package]}, this process "
                    f"{own_versions[package]}: install the same versions"
                )
        self._false_starts = 0
        worker.hello, worker.pid = None, hello.pid
        self._devices[hello.device] = None

    def _start_again(self, worker: _WorkerRecord, error: BaseException, most: int) -> None:
        """Handle a worker that failed to start. A worker that replaces a dead worker, whose device may be broken, is
        started up to three times. If all starts fail, the run continues with the remaining workers.

        Args:
            error: error that is raised after ``most`` failed starts, if no worker has died before or no other is left.
        """
        self._false_starts += 1
        spare = self._deaths > 0 and any(worker.ready for worker in self._workers)
        if not spare and self._false_starts >= most:
            raise error
        self._kill(worker)
        self._workers.remove(worker)
        if self._false_starts < FALSE_STARTS:
            self._workers.append(self._start(worker.place))
        else:
            self._places.remove(worker.place)
            self._false_starts = 0

    def _bury(
        self, worker: _WorkerRecord, deal: Deal, jobs: Sequence[Job], sim: Simulation, progress: Progress
    ) -> Iterator[Outcome]:
        """Replace a dead worker. Yields the outcomes of jobs that are given up. If the worker's engine did not exist
        yet, no job is given up."""
        held = [stream.chunk for stream in worker.streams.values()]
        self._deaths += 1
        self._kill(worker)
        self._workers[self._workers.index(worker)] = self._start(worker.place)
        if not worker.working:
            deal.put_back(held)
            return
        for index in deal.died(held):
            self._deadly[id(jobs[index].scene)] = jobs[index].scene
            progress.worlds_done += 1
            yield failed_outcome(
                index, jobs[index], sim, "the worker died while it simulated only this world, as did earlier workers"
            )

    # Chunks.

    def _hand_out(self, deal: Deal, jobs: Sequence[Job], sim: Simulation) -> None:
        """Give chunks to workers in turn, one at a time, while there are chunks and workers that can take one."""
        waiting = deque(sorted(self._workers, key=lambda worker: len(worker.streams)))
        while waiting:
            worker = waiting.popleft()
            if worker.has_room(deal.plenty) and (chunk := deal.take(idle=not worker.streams)):
                payload = pickle.dumps(([jobs[index] for index in chunk.jobs], sim))
                method = worker.actor.simulate.options(num_returns="streaming")
                worker.streams[method.remote(payload)] = _Stream(chunk)
                waiting.append(worker)

    def _next_report(self, ref: Any) -> Report | Exception | None:
        """The next report about a chunk; None after the last report; an error if the worker is dead."""
        try:
            item = self._thread.submit(lambda: self._ray.get(ref_of) if (ref_of := next(ref, None)) else None).result()
            report: Report | None = pickle.loads(item) if item is not None else None
            return report
        except Exception as error:
            if not isinstance(error, self._ray.exceptions.RayError):
                raise
            if isinstance(error, self._ray.exceptions.RayTaskError):
                raise RuntimeError(f"a worker failed: {one_line(error)}") from error
            lost: Exception = error  # mypy does not know Ray's classes and treats them as Any
            return lost

    def _take(
        self, worker: _WorkerRecord, stream: _Stream, report: Report, deal: Deal, progress: Progress
    ) -> Iterator[Outcome]:
        new, old = report.progress, stream.counted
        progress.world_steps += new.world_steps - old.world_steps
        worker.compile_s += new.compile_s - old.compile_s
        worker.message = new.message
        for key, value in new.extra.items():
            before = progress.extra.get(key, 0)
            highest = key.endswith(_HIGHEST)
            progress.extra[key] = max(before, value) if highest else before + value - old.extra.get(key, 0)
        stream.counted = new
        for count, outcome in enumerate(report.outcomes, start=1):
            progress.at_hand = len(report.outcomes) - count
            index = stream.chunk.jobs[outcome.job]
            try:
                deal.answered(index)
            except KeyError:
                raise RuntimeError(f"engine {self.name} returned two outcomes for job {index}") from None
            progress.worlds_done += 1
            outcome.job = index
            yield outcome
        if report.error is not None:
            raise report.error

    def _message(self, seconds: float) -> str:
        """A line for the user about the state of the workers."""
        waiting = [worker for worker in self._workers if not worker.ready]
        parts = [f"{count_text(self._deaths, 'worker')} died"] if self._deaths else []
        if waiting:
            of = f"{len(waiting)} of {count_text(len(self._workers), 'worker')}"
            parts += [f"starting {of}" if seconds < START_S else f"waiting until the cluster has room for {of}"]
        messages = {worker.message for worker in self._workers if worker.streams and worker.message}
        return "; ".join(parts + sorted(messages))
