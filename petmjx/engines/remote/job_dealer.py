"""Gives jobs to worker processes as the workers have room, and gives the jobs of dead workers out again. This module
does not need Ray."""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

PIECES: Final = 4
"""Limits the jobs of a thread, for engines that simulate job after job. The expected time of the jobs that one thread
holds is at most the expected time of all waiting jobs, divided by ``PIECES`` and by the number of threads. So all
threads end at about the same time, although expected times are estimates."""

MOST_JOBS: Final = 64
"""Largest number of jobs per thread of a worker whose engine simulates job after job, so that little work is lost if
the worker dies. A worker that holds jobs in reserve (``PLENTY``) may hold twice as many."""

PLENTY: Final = 4
"""Workers hold jobs in reserve while more than this number of jobs per thread is waiting. With fewer waiting jobs, a
job in reserve might wait behind a long job while another thread is idle."""

MOST_ON_DEVICE: Final = 8192
"""Largest number of jobs of a worker whose engine simulates worlds side by side. The device simulates far fewer worlds
at once, and begins with the longest worlds of these jobs."""


@dataclass(eq=False)
class WorkerJobs:
    """The jobs that a worker holds.

    Attributes:
        threads: number of the worker's threads, if its engine simulates job after job on each thread.
        ready: whether the worker can take jobs.
        begun: whether the worker has got jobs in this run.
        costs: number of a job → its expected time, for the jobs without an outcome.
        suspects: number of jobs in the group of suspects (jobs whose workers have died twice) that the worker got; 0 if
            it holds no suspects. Until all jobs of the group have outcomes, the worker gets no other jobs.
    """

    threads: int = 1
    ready: bool = False
    begun: bool = False
    costs: dict[int, float] = field(default_factory=dict)
    suspects: int = 0


@dataclass(frozen=True)
class _Limit:
    """How many jobs a worker may hold now. The worker may always hold ``fewest`` jobs. The worker gets further jobs, up
    to ``most``, while the expected time of all its jobs is less than ``cost``."""

    fewest: int
    most: int
    cost: float


class _Waiting(NamedTuple):
    """A waiting job. The order of these tuples is the order of the jobs: first come jobs that start from a state, then
    jobs that begin with their placement; of each kind, longer jobs come first."""

    begins: bool
    negated_cost: float
    number: int


class JobDealer:
    """Gives jobs to workers, the longest of the waiting jobs first, until each job has an outcome or is given up. Jobs
    that start from a state come before all others, so that few states wait in memory.

    If the engine simulates job after job, a worker holds fewer jobs towards the end, down to one per thread. If the
    engine simulates worlds side by side, all jobs are divided among the workers at once, so that all workers have the
    same expected remaining time. If a worker is still starting, its share of the jobs is kept until it can take them.
    A worker of such an engine begins with at least ``begin_with`` jobs, unless no more jobs come.

    If the worker of a job dies once, the cause may lie outside the job, so the job is given out again like other jobs.
    Jobs whose workers have died twice are *suspects*. Suspects wait until no other jobs are left. If n suspects come
    from the death of one worker, they are given out in groups of √n jobs, each group to a worker that holds no other
    job. If this worker dies, too, the jobs of its group are given out one by one. A suspect that was given out alone is
    given up if its worker dies.

    Args:
        least: if there are fewer jobs than this number, one worker gets all jobs. The number is for engines that
            simulate worlds side by side. None if the engine simulates job after job.
        begin_with: smallest number of jobs with which a worker begins, if the engine simulates worlds side by side. If
            ``least`` is None, ``begin_with`` has no effect.
    """

    def __init__(self, least: int | None = None, begin_with: int = 1) -> None:
        self._least, self._begin_with = least, begin_with
        self._deaths: Counter[int] = Counter()
        self._suspects: deque[tuple[int, ...]] = deque()
        self._pending: list[_Waiting] = []
        """Heap of the waiting jobs."""
        self._pending_cost = 0.0
        self._jobs: dict[int, _Waiting] = {}
        """Number of a job → its entry in the heap of waiting jobs. While a worker has the job, its entry is kept here,
        because the job may be given out again. The dict has all jobs that have no outcome and are not given up."""

    @property
    def unanswered(self) -> int:
        """Number of jobs that have no outcome and are not given up."""
        return len(self._jobs)

    def add(self, job: int, cost: float, *, starts: bool = False, deadly: bool = False) -> None:
        """Add a job.

        Args:
            job: number of the job.
            cost: expected time of the job, in any unit.
            starts: whether the job starts from a state.
            deadly: whether the job was the only job in a worker that died, in an earlier run.
        """
        self._jobs[job] = _Waiting(not starts, -cost, job)
        if deadly:
            self._suspects.append((job,))
        else:
            self._wait(job)

    def deal(self, workers: Sequence[WorkerJobs], *, more_come: bool) -> dict[int, list[int]]:
        """Give waiting jobs to the workers that have room, each job to the worker whose jobs have the shortest expected
        time in total.

        Args:
            workers: the jobs of each worker, also of workers that are starting. This method adds the new jobs.
            more_come: whether further jobs may be added before the next outcome arrives.

        Returns:
            Index of a worker → numbers of its new jobs.
        """
        dealt = self._deal_pending(workers, more_come) if self._pending else {}
        if not self._pending and not more_come:
            for index, worker in enumerate(workers):
                if self._suspects and worker.ready and not worker.costs:
                    dealt[index] = [*self._suspects.popleft()]
                    worker.costs = {job: -self._jobs[job].negated_cost for job in dealt[index]}
                    worker.suspects, worker.begun = len(worker.costs), True
        return dealt

    def _deal_pending(self, workers: Sequence[WorkerJobs], more_come: bool) -> dict[int, list[int]]:
        limits = self._limits_on_devices(workers, more_come) if self._least else self._limits_of_threads(workers)
        dealt: dict[int, list[int]] = {}
        # of workers with the same expected time for their jobs, the worker with the fewest jobs gets the next job
        queue = [(sum(workers[index].costs.values()), len(workers[index].costs), index) for index in limits]
        heapq.heapify(queue)
        while self._pending and queue:
            cost, n_jobs, index = queue[0]
            limit = limits[index]
            if n_jobs >= limit.fewest and (n_jobs >= limit.most or cost >= limit.cost):
                heapq.heappop(queue)
                continue
            _, negated_cost, job = heapq.heappop(self._pending)
            self._pending_cost = self._pending_cost + negated_cost if self._pending else 0.0
            workers[index].costs[job] = -negated_cost
            workers[index].begun = True
            dealt.setdefault(index, []).append(job)
            heapq.heapreplace(queue, (cost - negated_cost, n_jobs + 1, index))
        return dealt

    def _limits_of_threads(self, workers: Sequence[WorkerJobs]) -> dict[int, _Limit]:
        threads = max(sum(worker.threads for worker in workers), 1)
        times = 2 if len(self._pending) > PLENTY * threads else 1
        share = self._pending_cost / (PIECES * threads)
        return {
            index: _Limit(times * worker.threads, times * worker.threads * MOST_JOBS, times * worker.threads * share)
            for index, worker in enumerate(workers)
            if worker.ready and not worker.suspects
        }

    def _limits_on_devices(self, workers: Sequence[WorkerJobs], more_come: bool) -> dict[int, _Limit]:
        assert self._least is not None
        n_jobs = len(self._pending) + sum(len(worker.costs) for worker in workers)
        cost = self._pending_cost + sum(sum(worker.costs.values()) for worker in workers)
        begun = sum(worker.begun for worker in workers)
        if more_come:
            n_workers, n_begin, fewest = len(workers), len(self._pending) // self._begin_with, self._begin_with
        else:
            n_workers = min(len(workers), max(begun, math.ceil(n_jobs / self._least)))
            n_begin, fewest = n_workers - begun, 1
        idle = [index for index, worker in enumerate(workers) if worker.ready and not worker.begun][: max(n_begin, 0)]
        return {
            index: _Limit(1 if worker.begun else fewest, MOST_ON_DEVICE, cost / max(n_workers, 1))
            for index, worker in enumerate(workers)
            if worker.ready and not worker.suspects and (worker.begun or index in idle)
        }

    def answered(self, worker: WorkerJobs, job: int) -> None:
        """Record that a job of a worker has its outcome.

        Raises:
            KeyError: the worker does not hold the job.
        """
        del worker.costs[job]
        del self._jobs[job]
        worker.suspects = worker.suspects if worker.costs else 0

    def died(self, worker: WorkerJobs) -> list[int]:
        """Record that a worker died. The worker's jobs wait again, except for jobs that are given up. Returns the
        numbers of the jobs that are given up."""
        jobs = [*worker.costs]
        self._deaths.update(jobs)
        if worker.suspects == 1:
            for job in jobs:
                del self._jobs[job]
            return jobs
        once = [] if worker.suspects else [job for job in jobs if self._deaths[job] < 2]
        for job in once:
            self._wait(job)
        more = [job for job in jobs if self._deaths[job] >= 2]
        size = 1 if worker.suspects else math.isqrt(max(len(more) - 1, 0)) + 1
        self._suspects += [tuple(more[first : first + size]) for first in range(0, len(more), size)]
        return []

    def put_back(self, worker: WorkerJobs) -> None:
        """Record that a worker died before it started the jobs that it holds. The jobs of the worker wait again."""
        if worker.suspects:
            self._suspects.appendleft(tuple(worker.costs))
            return
        for job in worker.costs:
            self._wait(job)

    def _wait(self, job: int) -> None:
        heapq.heappush(self._pending, self._jobs[job])
        self._pending_cost -= self._jobs[job].negated_cost
