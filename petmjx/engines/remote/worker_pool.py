"""An engine whose jobs run in worker processes of a Ray cluster. The engine takes jobs from a stream, sends them to
workers that have room, collects outcomes, and replaces dead workers."""

from __future__ import annotations

import os
import pickle
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import package_versions
from petmjx.common.text import count_text, one_line
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.failed_world import failed_outcome
from petmjx.engines.job_stream import JobStream
from petmjx.engines.protocol import GPU_WORLDS, Capability, Engine, Progress, RunLock, says_at_hand, takes_stream
from petmjx.engines.remote.job_dealer import MOST_ON_DEVICE, JobDealer, WorkerJobs
from petmjx.engines.remote.ray_actor import Packet, Recipe, Report, Worker, WorkerReady, WorkerRun
from petmjx.engines.remote.ray_cluster import Cluster
from petmjx.engines.remote.worker_resources import WorkerResources
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.scene import Scene

MESSAGE_WAIT_S = 0.25
"""Longest wait for messages from workers, s. After each wait, signals are handled and progress is updated."""

FEED_S = 0.05
"""Longest wait for messages, s, while a worker has no jobs and further jobs are being made."""

START_S = 30.0
"""Longest wait for the first worker when a worker pool is created, s. Because of this wait, an engine that cannot run
in a worker is usually reported before a run begins. A busy cluster may need longer. If no worker is ready after this
time, the run begins without a worker, and waits for the first."""

FALSE_STARTS = 3
"""If this number of starts of workers fail one after another, the run ends. There is one exception: if this pool has
already lost a worker that had started, and another worker is ready, the run continues without the worker that does not
start."""

LEAST = {"mjx-warp": 512, "mjx-jax": 16}
"""Name of an engine → smallest number of jobs that are divided among several workers. If a run has fewer jobs, one
worker with this engine gets all jobs, since a device takes as long for a few worlds as for many. An engine without an
entry simulates job after job."""

MOST_TAKEN = GPU_WORLDS
"""Largest number of jobs per device that are taken from the stream and have no outcome yet. The jobs that are expected
to take longest go to workers first."""

_HIGHEST = (" lanes", " contacts")
"""Endings of names in ``Progress.extra``. If a name has one of these endings, the largest value of all workers is
reported; for other names, the sum."""


@dataclass(eq=False)
class _WorkerRecord:
    """The worker pool's record of a worker.

    Attributes:
        hello: Ray's reference to the worker's first message; None when this message has arrived.
        working: whether the worker's engine certainly exists: it was created before the first message, or the worker
            has reported about jobs.
        reports: Ray's stream of reports about the run; None if the worker has no run.
        counted: the part of the worker's progress in this run that has already been added to the run's progress.
    """

    resources: WorkerResources
    actor: Any
    hello: Any
    jobs: WorkerJobs
    pid: int = 0
    working: bool = False
    reports: Any = None
    counted: Progress = field(default_factory=Progress)

    @property
    def ready(self) -> bool:
        return self.jobs.ready


@dataclass(eq=False)
class _PoolRun:
    """A run of a worker pool.

    Attributes:
        compiled_s: time that earlier runs spent on compiling programs, s.
        jobs: stream number → job, for the jobs that have been taken from the stream and have no outcome.
    """

    stream: JobStream[Any]
    sim: Simulation
    progress: Progress
    dealer: JobDealer
    compiled_s: float
    jobs: dict[int, Job] = field(default_factory=dict)


class WorkerPool(Engine):
    """The engine ``recipe.name`` in many processes. Outcomes are the same as on the engine itself.

    A worker that dies is replaced, and its jobs without an outcome are given out again (``JobDealer``). Workers are
    kept between runs, until :meth:`close`.

    Args:
        resources: the CPUs and GPUs of each worker. All workers start immediately.
        cluster: the cluster in which the workers run. :meth:`close` also closes the cluster.
        check_pool: number of processes of each worker that check outcomes (petmjx/engines/subprocess/check_pool.py).
    """

    def __init__(
        self, recipe: Recipe, resources: Sequence[WorkerResources], cluster: Cluster, check_pool: int = 0
    ) -> None:
        self.name = recipe.name
        self._recipe, self._cluster, self._ray, self._check_pool = recipe, cluster, cluster.ray, check_pool
        self._running = RunLock(self.name)
        # A thread waits for Ray: if the main thread did, exceptions of signal handlers would be lost.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="petmjx-workers")
        self._workers: list[_WorkerRecord] = []
        self._devices: dict[str, None] = {}
        self._false_starts = self._deaths = 0
        self._deadly: dict[int, Scene] = {}
        self._resources = list(resources)
        self.devices = max(round(sum(worker.gpus for worker in resources)), 1)
        self._workers += map(self._start, resources)

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
        return len(self._resources)

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
        """Begin to end the workers, and the cluster if it was started for them; do not wait until they have ended."""
        try:
            self.dismiss()
        finally:
            # the thread ends before Ray: after an interruption, it may still wait for Ray, and would hang when Ray ends
            self._thread.shutdown()
            self._cluster.leave()

    def close(self) -> None:
        """End the workers, and the cluster if it was started for them, and wait until they have ended."""
        try:
            self.retire()
        finally:
            self._cluster.close()

    @says_at_hand
    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes are the same as on the engine itself, and are yielded in any order, as
        worlds finish.

        Raises:
            EngineUnavailable: workers die while they start, a worker has other versions of packages than this process,
                or a worker cannot create its engine.
            PetmjxError: Ray has died.
            Exception: the engine in a worker raised this exception.
        """
        stream = JobStream.of(jobs)
        if stream.ended:
            return
        least = LEAST.get(self.name)
        # mjx-jax cannot take further jobs while it simulates, so it begins with as many jobs as a worker may hold
        begin_with = MOST_ON_DEVICE if self.name == "mjx-jax" else min(stream.begin_with, MOST_ON_DEVICE)
        with self._running:
            progress = progress if progress is not None else Progress()
            run = _PoolRun(stream, sim, progress, JobDealer(least, begin_with), progress.compile_s)
            yield from self._run(run)

    def _run(self, run: _PoolRun) -> Iterator[Outcome]:
        lacking = Counter(self._resources)
        lacking.subtract(worker.resources for worker in self._workers)
        self._workers += [self._start(resources) for resources in lacking.elements()]
        progress = run.progress
        before, began = progress.message, time.monotonic()
        for worker in self._workers:
            worker.counted, worker.jobs.begun = Progress(), False
        try:
            while self._take_jobs(run) or run.jobs:
                self._hand_out(run)
                seconds = time.monotonic() - began
                if seconds >= START_S and not all(worker.ready for worker in self._workers):
                    self._cluster.check()
                progress.message = self._message(seconds) or before
                progress.at_hand = 0
                if progress.pauses:
                    yield None  # type: ignore[misc]  # callers that set ``pauses`` expect it
                yield from self._reported(run)
            for worker in self._workers:
                if worker.reports is not None:
                    worker.actor.feed.remote(b"")
            while any(worker.reports is not None for worker in self._workers):
                yield from self._reported(run)
            progress.message = before
        finally:
            busy = [worker for worker in self._workers if worker.reports is not None]
            for worker in busy:  # the run has ended, so nobody needs the outcomes of busy workers
                self._workers.remove(worker)
                self._kill(worker)

    def _reported(self, run: _PoolRun) -> Iterator[Outcome]:
        """Handle what workers have sent. Yields the outcomes."""
        hungry = not run.stream.closed and not all(worker.jobs.costs for worker in self._workers)
        for worker, ref in self._news(FEED_S if hungry else MESSAGE_WAIT_S):
            if not worker.ready:
                self._greet(worker, ref)
                continue
            report = self._next_report(ref)
            if isinstance(report, Report):
                worker.working = True
                yield from self._take_report(worker, report, run)
            elif report is None:
                worker.reports = None
            else:
                yield from self._bury(worker, run)

    # Workers.

    def _start(self, resources: WorkerResources) -> _WorkerRecord:
        limits = {"num_cpus": resources.cpus, "num_gpus": resources.gpus}
        # a worker handles two calls at the same time: one reports about the run, the other takes a packet of jobs
        remote = self._ray.remote(Worker).options(**limits, max_concurrency=2, max_restarts=0)
        threads = None if self.name in LEAST else resources.cpus
        # after a worker's death, its device may be broken, so the next worker creates its engine before it gets jobs
        thorough = self.name != "mjx-warp" or self._deaths > 0
        options = {"check_pool": self._check_pool, "thorough": thorough}
        actor = remote.remote(self._recipe, os.environ.get("PETMJX_CACHE_DIR"), threads, **options)
        return _WorkerRecord(resources, actor, actor.hello.remote(), WorkerJobs(resources.cpus), working=thorough)

    def _kill(self, worker: _WorkerRecord) -> None:
        worker.reports = None
        self._ray.kill(worker.actor)

    def _news(self, longest_s: float = MESSAGE_WAIT_S) -> list[tuple[_WorkerRecord, Any]]:
        """The workers from which a message has arrived, each with Ray's reference to the message: ``hello`` for the
        first message of a worker, ``reports`` for a report about the run. Waits for at most ``longest_s``.
        """
        sources = [(worker, worker.reports if worker.ready else worker.hello) for worker in self._workers]
        owner = {ref: worker for worker, ref in sources if ref is not None}
        if not owner:
            return []

        def wait() -> list[Any]:
            ready, _ = self._ray.wait(list(owner), num_returns=1, timeout=longest_s)
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
        worker.hello, worker.pid, worker.jobs.ready = None, hello.pid, True
        self._devices[hello.device] = None

    def _start_again(self, worker: _WorkerRecord, error: BaseException, most: int) -> None:
        """Handle a worker that failed to start: start a worker again with the same CPUs and GPUs. If ``FALSE_STARTS``
        starts have failed one after another, the device may be broken. In this case, the run continues with the other
        workers.

        Args:
            error: error that is raised after ``most`` failed starts. The error is not raised if this pool has already
                lost a worker that had started, and another worker is ready.
        """
        self._false_starts += 1
        spare = self._deaths > 0 and any(worker.ready for worker in self._workers)
        if not spare and self._false_starts >= most:
            raise error
        self._kill(worker)
        self._workers.remove(worker)
        if self._false_starts < FALSE_STARTS:
            self._workers.append(self._start(worker.resources))
        else:
            self._resources.remove(worker.resources)
            self._false_starts = 0

    def _bury(self, worker: _WorkerRecord, run: _PoolRun) -> Iterator[Outcome]:
        """Replace a dead worker. Yields the outcomes of jobs that are given up. If the worker's engine did not exist
        yet, no job is given up."""
        self._deaths += 1
        self._kill(worker)
        self._workers[self._workers.index(worker)] = self._start(worker.resources)
        if not worker.working:
            run.dealer.put_back(worker.jobs)
            return
        for number in run.dealer.died(worker.jobs):
            job = run.jobs.pop(number)
            self._deadly[id(job.scene)] = job.scene
            run.progress.worlds_done += 1
            yield failed_outcome(
                number, job, run.sim, "this worker and earlier workers died, each while it simulated only this world"
            )

    # Jobs.

    def _take_jobs(self, run: _PoolRun) -> bool:
        """Take jobs from the stream. If all jobs so far have outcomes, wait for further jobs. Returns whether the
        method has taken any job."""
        on_devices = self.name in LEAST
        most = MOST_TAKEN * self.devices - len(run.jobs)
        least = run.stream.begin_with if on_devices and not run.stream.taken else 1
        jobs = run.stream.take(most, least=least, wait=not run.jobs)
        costs = MEASURED.of_jobs_on_device if on_devices else MEASURED.of_jobs
        priced = zip(jobs, costs(jobs, run.sim).tolist() if jobs else (), strict=True)
        for number, (job, cost) in enumerate(priced, start=run.stream.taken - len(jobs)):
            run.jobs[number] = job
            run.dealer.add(number, cost, starts=job.start is not None, deadly=id(job.scene) in self._deadly)
        return bool(jobs)

    def _hand_out(self, run: _PoolRun) -> None:
        """Give jobs to the workers that have room."""
        jobs_of_workers = [worker.jobs for worker in self._workers]
        for index, numbers in run.dealer.deal(jobs_of_workers, more_come=not run.stream.ended).items():
            self._send(self._workers[index], [(number, run.jobs[number]) for number in numbers], run)

    def _send(self, worker: _WorkerRecord, packet: Packet, run: _PoolRun) -> None:
        """Send jobs to a worker. With the first jobs of a run, the worker begins the run."""
        if worker.reports is None:
            arguments = WorkerRun(run.sim, run.stream.feedback, run.stream.bounds, run.stream.stiff)
            worker.reports = worker.actor.simulate.options(num_returns="streaming").remote(pickle.dumps(arguments))
        worker.actor.feed.remote(pickle.dumps(packet))

    def _next_report(self, ref: Any) -> Report | Exception | None:
        """The next report about a run; None after the last report; an error if the worker is dead."""
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

    def _take_report(self, worker: _WorkerRecord, report: Report, run: _PoolRun) -> Iterator[Outcome]:
        """Add a worker's progress to the progress of the run, and yield its new outcomes.

        Raises:
            RuntimeError: a job has two outcomes.
            Exception: the exception that ended the worker's run.
        """
        new, old, progress = report.progress, worker.counted, run.progress
        progress.world_steps += new.world_steps - old.world_steps
        for key, value in new.extra.items():
            before = progress.extra.get(key, 0)
            highest = key.endswith(_HIGHEST)
            progress.extra[key] = max(before, value) if highest else before + value - old.extra.get(key, 0)
        progress.notes |= new.notes
        worker.counted = new
        progress.compile_s = run.compiled_s + max(worker.counted.compile_s for worker in self._workers)
        for count, outcome in enumerate(report.outcomes, start=1):
            progress.at_hand = len(report.outcomes) - count
            run.dealer.answered(worker.jobs, outcome.job)
            del run.jobs[outcome.job]
            progress.worlds_done += 1
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
        messages = {worker.counted.message for worker in self._workers if worker.jobs.costs} - {""}
        return "; ".join(parts + sorted(messages))
