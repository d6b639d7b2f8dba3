"""Which jobs a worker gets next, and what becomes of the jobs that it held when it died. Nothing here knows Ray."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from petmjx.common.units import FloatArray

PIECES = 4
"""A chunk is this part of a slot's share of what is left, so that slots end together although costs are guesses."""

MOST_JOBS = 64
"""Most jobs in such a chunk: a worker that dies has done little in vain."""

PLENTY = 4
"""Slots hold chunks in reserve while this many jobs for each of them are waiting. Later a job could wait behind a long
one while another slot is idle."""


@dataclass(frozen=True)
class Chunk:
    """Jobs that one worker simulates, longest first.

    ``alone``: no other job may be in the worker meanwhile, since one of these may be what workers die of.
    """

    jobs: tuple[int, ...]
    alone: bool = False


class Deal:
    """Hands out jobs, longest first, until each one is answered or given up.

    Of engines that simulate job after job, chunks shrink towards the end, to single jobs. Of engines that simulate
    worlds side by side, all chunks are of equal size and mix, and there are as few as busy workers allow: the end of
    each one runs on a nearly idle device.

    A first death may come from outside, so the jobs of a dead worker are dealt again as any others. Those of a second
    death wait until no others are left and run in small pieces, √n each, and after another death one by one. A job that
    was alone in a worker when that died is given up.

    Args:
        costs: (n,) expected time of each job, in any unit.
        slots: chunks that are simulated at the same time, over all workers.
        group: most jobs of a chunk of an engine that simulates worlds side by side; None: job after job.
        least: fewer jobs than this are not divided among workers that simulate side by side.
        deadly: jobs that are known to have been alone in a worker that died.
    """

    def __init__(
        self, costs: FloatArray, slots: int, group: int | None = None, least: int = 1, deadly: Iterable[int] = ()
    ) -> None:
        self._costs, self._slots, self._group = costs, slots, group
        self._deaths: Counter[int] = Counter()
        known = set(deadly)
        self._suspects: deque[tuple[int, ...]] = deque((job,) for job in sorted(known))
        self._pending = [int(job) for job in np.argsort(-costs, kind="stable") if job not in known]
        self._cost_left = float(costs[self._pending].sum())
        self.unanswered = set(range(len(costs)))
        n = max(len(self._pending), 1)
        useful = min(slots, math.ceil(n / least))
        self._size = math.ceil(n / (useful * math.ceil(n / (useful * group)))) if group else 1

    @property
    def plenty(self) -> bool:
        """Whether slots may hold chunks in reserve."""
        return self._group is None and len(self._pending) > PLENTY * self._slots

    def take(self, idle: bool) -> Chunk | None:
        """The next chunk for a worker; None if there is nothing for it now.

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
        """A job has its outcome.

        Raises:
            KeyError: it has one already, or was never asked.
        """
        self.unanswered.remove(job)

    def died(self, held: Iterable[Chunk]) -> list[int]:
        """A worker has died with some chunks. Their unanswered jobs wait again, except those that are returned, which
        are given up."""
        given_up = []
        again: list[int] = []
        twice: list[int] = []
        for chunk in held:
            left = self._left(chunk)
            self._deaths.update(left)
            if not chunk.alone:
                again += [job for job in left if self._deaths[job] < 2]
                twice += [job for job in left if self._deaths[job] >= 2]
            elif len(chunk.jobs) == 1:
                given_up += left
            else:
                self._suspects += [(job,) for job in left]
        self.unanswered.difference_update(given_up)
        self._wait_again(again)
        size = math.isqrt(max(len(twice) - 1, 0)) + 1
        self._suspects += [tuple(twice[first : first + size]) for first in range(0, len(twice), size)]
        return given_up

    def put_back(self, held: Iterable[Chunk]) -> None:
        """A worker has died with some chunks before it simulated any of them. Their jobs wait again."""
        for chunk in held:
            left = self._left(chunk)
            if chunk.alone:
                self._suspects.appendleft(tuple(left))
            else:
                self._wait_again(left)

    def _left(self, chunk: Chunk) -> list[int]:
        """Jobs of a chunk that are not answered."""
        return [job for job in chunk.jobs if job in self.unanswered]

    def _wait_again(self, jobs: list[int]) -> None:
        self._cost_left += float(self._costs[jobs].sum())
        self._pending = sorted(self._pending + jobs, key=lambda job: (-self._costs[job], job))
