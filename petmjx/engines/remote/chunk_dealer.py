"""Deals chunks of jobs to workers, and deals the jobs of dead workers again. This module does not depend on Ray."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from petmjx.common.units import FloatArray

PIECES = 4
"""A chunk is one ``PIECES``-th of a slot's share of the remaining cost, so that all slots end at about the same time,
although costs are estimates."""

MOST_JOBS = 64
"""Largest number of jobs of a chunk, so that little work is lost if a worker dies."""

PLENTY = 4
"""Slots hold chunks in reserve while at least this number of jobs per slot are waiting. After that, a job in reserve
might wait behind a long one while another slot is idle."""


@dataclass(frozen=True)
class Chunk:
    """Jobs that one worker simulates, longest first.

    ``alone``: the worker gets no other job meanwhile, since a job of this chunk may make workers die.
    """

    jobs: tuple[int, ...]
    alone: bool = False


class Deal:
    """Hands out jobs to workers, the longest first, until each job is answered or given up.

    For engines that simulate job after job, chunks get smaller towards the end, down to single jobs. For engines that
    simulate worlds side by side, all chunks have equal size and a similar mix of jobs. There are no more chunks than
    are needed to keep all workers busy, since the device is nearly idle at the end of each chunk.

    The first death of a worker may have an outside cause, so its jobs are dealt again like other jobs. Jobs whose
    worker has died twice wait until no other jobs are left. Then these jobs run in small pieces of √n jobs, and after
    another death one by one. A job that was alone in a worker when the worker died is given up.

    Args:
        costs: (n,) expected time of each job, in any unit.
        slots: number of chunks that are simulated at the same time, over all workers.
        group: largest number of jobs of a chunk, for an engine that simulates worlds side by side; None: the engine
            simulates job after job.
        least: used with ``group``: if there are fewer jobs than this, one worker gets all of them.
        deadly: jobs that were alone in a worker that died.
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
        """Whether there are enough jobs for slots to hold chunks in reserve."""
        return self._group is None and len(self._pending) > PLENTY * self._slots

    def take(self, idle: bool) -> Chunk | None:
        """The next chunk for a worker; None if it gets no chunk now.

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
        """Record that a worker died with these chunks. Their unanswered jobs wait again, except for the jobs that are
        given up; these are returned."""
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
        """Record that a worker died before it started these chunks. The jobs of these chunks wait again."""
        for chunk in held:
            left = self._left(chunk)
            if chunk.alone:
                self._suspects.appendleft(tuple(left))
            else:
                self._wait_again(left)

    def _left(self, chunk: Chunk) -> list[int]:
        """The unanswered jobs of a chunk."""
        return [job for job in chunk.jobs if job in self.unanswered]

    def _wait_again(self, jobs: list[int]) -> None:
        self._cost_left += float(self._costs[jobs].sum())
        self._pending = sorted(self._pending + jobs, key=lambda job: (-self._costs[job], job))
