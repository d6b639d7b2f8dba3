"""Gives chunks (groups) of jobs to worker processes, and gives the jobs of dead workers out again. This module does not
need Ray."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from petmjx.common.units import FloatArray

PIECES = 4
"""The expected time of a chunk is the remaining time, divided by this number and by the number of slots. (A slot is a
place for one running chunk.) So all slots end at about the same time, although expected times are estimates."""

MOST_JOBS = 64
"""Largest number of jobs of a chunk, so that little work is lost if a worker dies."""

PLENTY = 4
"""Workers hold chunks in reserve while at least this number of jobs per slot is waiting. With fewer waiting jobs, a job
in reserve might wait behind a long job while another slot is idle."""


@dataclass(frozen=True)
class Chunk:
    """Numbers of the jobs that one worker simulates, the longest job first.

    ``alone``: if True, the worker gets no other chunk at the same time, since a job of this chunk may make workers die.
    """

    jobs: tuple[int, ...]
    alone: bool = False


class Deal:
    """Gives jobs to workers, the longest first, until each job has an outcome or is given up.

    If the engine simulates job after job, chunks get smaller towards the end, down to single jobs. If the engine
    simulates worlds side by side, all chunks have the same size and a similar mix of jobs. Since a device is nearly
    idle at the end of each chunk, there are only as many of these chunks as keep all workers busy.

    The first death of a worker may have an outside cause, so its jobs are given out again like other jobs. Jobs whose
    workers have died twice wait until no other jobs are left. If n such jobs come from the death of one worker,
    they are given out in chunks of √n jobs, each chunk to a worker that holds no other one. If a worker dies again, the
    jobs of its chunk are given out one by one. A job is given up if it was the only job in a worker that died.

    Args:
        costs: (n,) expected time of each job, in any unit.
        slots: number of chunks that are simulated at the same time, over all workers.
        group: largest number of jobs of a chunk, if the engine simulates worlds side by side; None if the engine
            simulates job after job.
        least: used with ``group``: if there are fewer jobs than this number, one worker gets all jobs.
        deadly: numbers of the jobs that were the only job in a worker that died.
    """

    def __init__(
        self, costs: FloatArray, slots: int, group: int | None = None, least: int = 1, deadly: Iterable[int] = ()
    ) -> None:
        self._costs, self._slots, self._group = costs, slots, group
        self._deaths: Counter[int] = Counter()
        deadly_jobs = set(deadly)
        self._suspects: deque[tuple[int, ...]] = deque((job,) for job in sorted(deadly_jobs))
        self._pending = [int(job) for job in np.argsort(-costs, kind="stable") if job not in deadly_jobs]
        self._cost_left = float(costs[self._pending].sum())
        self.unanswered = set(range(len(costs)))
        n = max(len(self._pending), 1)
        useful = min(slots, math.ceil(n / least))
        self._size = math.ceil(n / (useful * math.ceil(n / (useful * group)))) if group else 1

    @property
    def plenty(self) -> bool:
        """Whether so many jobs wait that workers may hold chunks in reserve."""
        return self._group is None and len(self._pending) > PLENTY * self._slots

    def take(self, idle: bool) -> Chunk | None:
        """The next chunk for a worker. The result is None if the worker gets no chunk now.

        Args:
            idle: whether the worker holds no other chunk.
        """
        if self._pending:
            jobs = self._next_equal() if self._group else self._next_shrinking()
            self._cost_left -= float(self._costs[jobs].sum())
            return Chunk(tuple(jobs))
        if idle and self._suspects:
            return Chunk(self._suspects.popleft(), alone=True)
        return None

    def _next_shrinking(self) -> list[int]:
        share = self._cost_left / (PIECES * self._slots)
        total = np.cumsum(self._costs[self._pending[:MOST_JOBS]])
        count = max(int(np.searchsorted(total, share, side="right")), 1)
        chunk, self._pending = self._pending[:count], self._pending[count:]
        return chunk

    def _next_equal(self) -> list[int]:
        chunks = math.ceil(len(self._pending) / self._size)
        chunk = self._pending[::chunks]
        del self._pending[::chunks]
        return chunk

    def answered(self, job: int) -> None:
        """Record that a job has its outcome.

        Raises:
            KeyError: the job already has an outcome, or does not exist.
        """
        self.unanswered.remove(job)

    def died(self, held: Iterable[Chunk]) -> list[int]:
        """Record that a worker died while it held these chunks. The jobs of these chunks that have no outcome wait
        again, except for jobs that are given up. Returns the numbers of the jobs that are given up."""
        given_up = []
        requeued: list[int] = []
        twice: list[int] = []
        for chunk in held:
            left = self._left(chunk)
            self._deaths.update(left)
            if not chunk.alone:
                requeued += [job for job in left if self._deaths[job] < 2]
                twice += [job for job in left if self._deaths[job] >= 2]
            elif len(chunk.jobs) == 1:
                given_up += left
            else:
                self._suspects += [(job,) for job in left]
        self.unanswered.difference_update(given_up)
        self._wait_again(requeued)
        size = math.isqrt(max(len(twice) - 1, 0)) + 1
        self._suspects += [tuple(twice[first : first + size]) for first in range(0, len(twice), size)]
        return given_up

    def put_back(self, held: Iterable[Chunk]) -> None:
        """Record that a worker died before it started these chunks. The jobs of these chunks are put back among the
        waiting jobs.
        """
        for chunk in held:
            left = self._left(chunk)
            if chunk.alone:
                self._suspects.appendleft(tuple(left))
            else:
                self._wait_again(left)

    def _left(self, chunk: Chunk) -> list[int]:
        """The jobs of a chunk that have no outcome yet."""
        return [job for job in chunk.jobs if job in self.unanswered]

    def _wait_again(self, jobs: list[int]) -> None:
        self._cost_left += float(self._costs[jobs].sum())
        self._pending = sorted(self._pending + jobs, key=lambda job: (-self._costs[job], job))
