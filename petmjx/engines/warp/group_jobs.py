"""Splits the jobs of a run into groups, whose worlds are on the device at the same time."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from itertools import takewhile
from typing import Any, Final

from petmjx.common.errors import InputError
from petmjx.engines.job_stream import JobStream
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.world.job import Job

GROWTH: Final = 8
"""Factor by which each part is larger than the one before, while more jobs are being made. So a GPU begins after half a
second, and works on most parts for as long as it takes to make the next one."""

LARGEST_PART: Final = 2
"""Most jobs of a part, in groups. They are split into equal groups."""


class Groups:
    """Takes the jobs of a stream in parts, and splits each part into equal groups, in order.

    ``bool(groups)`` is False when no group follows. It waits for the next part, and raises the ``InputError`` of a
    refused one.

    Args:
        size: most worlds of a group.
        left: worlds of a group that the group before may have left to it (``GroupHandover``).
        granule: as for ``KernelFeatures.of``.

    Attributes:
        needs: features of all known jobs, so that all groups have the same kernels.
        first: the number of the first job of the latest group.
    """

    grows = False
    """Whether jobs may join the latest group (``waiting``)."""

    def __init__(self, jobs: JobStream[Any], size: int, left: int, granule: int) -> None:
        self.needs, self.first = KernelFeatures({}), 0
        self._jobs, self._size, self._left, self._granule = jobs, size, left, granule
        self._most = max(LARGEST_PART * (size - left), 1)
        self._part_size = min(jobs.begin_with, self._most)
        self._part: Sequence[Job] = ()
        """The next part, until its jobs have been checked for room."""
        self._dealt: list[Job] = []
        self._known: Sequence[Job] = ()
        self._next: Sequence[Job] = ()
        self._equal_size = 0

    @staticmethod
    def of(jobs: JobStream[Any], size: int, left: int, granule: int) -> Groups:
        """The groups of these jobs."""
        kind = GrowingGroups if jobs.feedback else Groups
        return kind(jobs, size, left, granule)

    def __bool__(self) -> bool:
        return bool(self._find_next(wait=True))

    @property
    def recorded(self) -> bool:
        """Whether a world of the next group is recorded."""
        return any(job.record is not None for job in self._find_next(wait=True))

    def take(self) -> list[Job]:
        """The jobs of the next group. Until the group after it is taken, the caller may append jobs of ``join`` to this
        very list."""
        group = list(self._find_next(wait=True))
        self.first += len(self._dealt)
        self._dealt, self._next = group, ()
        return group

    def following(self) -> Sequence[Job]:
        """The jobs of the next group, without taking them. None at the end, while the next part is being made, if jobs
        may be appended, or if the part is refused. The error of a refused part is raised when it is taken, after the
        outcomes of the group before."""
        try:
            return self._find_next(wait=False)
        except InputError:
            return ()

    def waiting(self, most: int) -> list[Job]:
        """At most ``most`` jobs that may join the latest group (``join``). They follow the group's own jobs."""
        return []

    def join(self, count: int) -> list[Job]:
        """Take so many of the ``waiting`` jobs."""
        return self._jobs.take(count, wait=False)

    def _find_next(self, *, wait: bool) -> Sequence[Job]:
        if not self._next:
            if not self._known:
                size = self._part_size
                most = self._most if self._jobs.closed else size
                self._part = self._part or self._jobs.take(most, least=size, wait=wait)
                self._meet(self._part)
                self._part = ()
            self._next, self._known = self._known[: self._equal_size], self._known[self._equal_size :]
        return self._next

    def _meet(self, jobs: Sequence[Job]) -> None:
        """Split the jobs of a new part. After an error nothing has changed."""
        if jobs:
            needs = self.needs | KernelFeatures.of(jobs, self._granule)
            shares = len(jobs) > self._size or not self._jobs.ended
            self._equal_size = _equal(len(jobs), self._size - (self._left if shares else 0))
            self.needs, self._known = needs, jobs
            self._part_size = min(GROWTH * self._part_size, self._most)


class GrowingGroups(Groups):
    """Groups that jobs may join. A job joins the latest group if its kernels have the job's features."""

    grows = True

    def following(self) -> Sequence[Job]:
        return ()

    def waiting(self, most: int) -> list[Job]:
        return list(takewhile(self.needs.know, self._jobs.peek(most))) if not self._known else []

    def _find_next(self, *, wait: bool) -> Sequence[Job]:
        if not self._next:
            least = 1 if self._dealt else self._jobs.begin_with
            if not self._known and (jobs := self._jobs.peek(sys.maxsize, least=least, wait=wait)):
                needs = KernelFeatures.of(jobs, self._granule)
                self._known = self._jobs.take(len(jobs))
                self.needs, self._equal_size = needs, _equal(len(jobs), self._size)
            self._next, self._known = self._known[: self._equal_size], self._known[self._equal_size :]
        return self._next


def _equal(count: int, most: int) -> int:
    """The size of as few equal groups as have at most ``most`` each."""
    return math.ceil(count / math.ceil(count / most))
