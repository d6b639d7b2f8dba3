"""Splits the jobs of a run into groups, whose worlds are on the device at the same time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import takewhile

from petmjx.common.errors import InputError
from petmjx.engines.protocol import GrowingJobs, JobsInParts
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.world.job import Job


class Groups:
    """Splits jobs into equal groups, in order.

    ``bool(groups)`` is False when no group follows. It fetches the next part of the jobs if that is needed and made,
    and raises the ``InputError`` of a refused part.

    Args:
        size: most worlds of a group.
        left: worlds of a group that the group before may have left to it (``GroupHandover``).
        granule: as for ``KernelFeatures.of``.

    Attributes:
        needs: features of all known jobs, so that all groups have the same kernels.
        first: the number of the first job of the latest group.
    """

    grows = False
    """Whether jobs may be appended (``GrowingJobs``)."""

    def __init__(self, jobs: Sequence[Job], size: int, left: int, granule: int) -> None:
        self.needs, self.first = KernelFeatures({}), 0
        self._size, self._left, self._granule = size, left, granule
        self._more = jobs.next_part if isinstance(jobs, JobsInParts) else None
        self._part: Sequence[Job] = ()
        """The next part, until its jobs have been checked for room."""
        self._dealt: list[Job] = []
        self._known: Sequence[Job] = ()
        self._next: Sequence[Job] = ()
        self._each = 0
        self._meet(jobs[:], self.needs)

    @staticmethod
    def of(jobs: Sequence[Job], size: int, left: int, granule: int) -> Groups:
        """The groups of these jobs. Jobs that come in parts are removed from their list."""
        groups = (GrowingGroups if isinstance(jobs, GrowingJobs) else Groups)(jobs, size, left, granule)
        if isinstance(jobs, JobsInParts):
            jobs.clear()
        return groups

    def __bool__(self) -> bool:
        return bool(self._find_next())

    @property
    def recorded(self) -> bool:
        """Whether a world of the next group is recorded."""
        return any(job.record is not None for job in self._find_next())

    def take(self) -> list[Job]:
        """The jobs of the next group. Until the group after it is taken, the caller may append ``waiting`` jobs to this
        very list."""
        group = list(self._find_next())
        self.first += len(self._dealt)
        self._dealt, self._next = group, ()
        return group

    def following(self) -> Sequence[Job]:
        """The jobs of the next group, without taking them. None at the end, while the next part is being made, if jobs
        may be appended, or if the part is refused. The error of a refused part is raised when it is taken, after the
        outcomes of the group before."""
        try:
            return self._find_next()
        except InputError:
            return ()

    def waiting(self, most: int) -> list[Job]:
        """At most ``most`` jobs that may join the latest group. They follow the group's own jobs."""
        return []

    def _find_next(self) -> Sequence[Job]:
        if not self._next:
            if not self._known and self._more is not None:
                self._part = self._part or self._more() or ()
                self._meet(self._part, self.needs)
                self._part = ()
            self._next, self._known = self._known[: self._each], self._known[self._each :]
        return self._next

    def _meet(self, jobs: Sequence[Job], needs: KernelFeatures) -> None:
        """Add jobs, after all earlier jobs have been taken. ``needs``: features of other jobs that also count. After an
        error nothing has changed."""
        if jobs:
            needs |= KernelFeatures.of(jobs, self._granule)
            most = self._size - (self._left if len(jobs) > self._size or self._more is not None else 0)
            self._each = math.ceil(len(jobs) / math.ceil(len(jobs) / most))
        self.needs, self._known = needs, jobs


class GrowingGroups(Groups):
    """Groups to whose jobs more may be appended. An appended job joins the latest group if its kernels have the job's
    features."""

    grows = True

    def __init__(self, jobs: Sequence[Job], size: int, left: int, granule: int) -> None:
        super().__init__(jobs, size, left, granule)
        self._jobs = jobs
        self._end = len(jobs)
        """Number of jobs whose features ``needs`` includes."""

    def following(self) -> Sequence[Job]:
        return ()

    def waiting(self, most: int) -> list[Job]:
        begin = self.first + len(self._dealt)
        return list(takewhile(self.needs.know, self._jobs[begin : begin + most]))

    def _find_next(self) -> Sequence[Job]:
        begin = self.first + len(self._dealt)
        if begin >= self._end:
            jobs = self._jobs[begin:]
            self._meet(jobs, KernelFeatures({}))
            self._end = begin + len(jobs)
        return self._jobs[begin : min(begin + self._each, self._end)]
