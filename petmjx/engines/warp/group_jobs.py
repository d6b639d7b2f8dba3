"""The jobs of a run by the group: those whose worlds the device has at the same time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import takewhile

from petmjx.common.errors import InputError
from petmjx.engines.protocol import GrowingJobs, JobsInParts
from petmjx.engines.warp.kernel_features import KernelFeatures
from petmjx.world.job import Job


class Groups:
    """Deals jobs in their order, in groups of equal size. It is true as long as a next group is known; whoever asks for
    that takes the next part, if it is made, and meets the ``InputError`` of one that is refused.

    Args:
        size: most worlds of a group.
        left: so many of them may have been left by the group before (``handover.Left``).
        granule: as of ``KernelFeatures``.

    Attributes:
        needs: of all jobs that are known, so that groups have the same kernels.
        first: the number of the first job of the group that was dealt last.
    """

    grows = False
    """Whether jobs may be appended (``GrowingJobs``)."""

    def __init__(self, jobs: Sequence[Job], size: int, left: int, granule: int) -> None:
        self.needs, self.first = KernelFeatures({}), 0
        self._size, self._left, self._granule = size, left, granule
        self._more = jobs.next_part if isinstance(jobs, JobsInParts) else None
        self._part: Sequence[Job] = ()
        """The next part, until it is known that there is room for its jobs."""
        self._dealt: list[Job] = []
        self._known: Sequence[Job] = ()
        self._next: Sequence[Job] = ()
        self._each = 0
        self._meet(jobs[:], self.needs)

    @staticmethod
    def of(jobs: Sequence[Job], size: int, left: int, granule: int) -> Groups:
        """For these jobs. Those that come in parts are taken out of their list."""
        groups = (GrowingGroups if isinstance(jobs, GrowingJobs) else Groups)(jobs, size, left, granule)
        if isinstance(jobs, JobsInParts):
            jobs.clear()
        return groups

    def __bool__(self) -> bool:
        return bool(self._find_next())

    @property
    def recorded(self) -> bool:
        """Whether a world of the next group is."""
        return any(job.record is not None for job in self._find_next())

    def take(self) -> list[Job]:
        """The next group. Jobs that are ``waiting`` may be appended to it, to this very list, before another one is
        dealt."""
        group = list(self._find_next())
        self.first += len(self._dealt)
        self._dealt, self._next = group, ()
        return group

    def following(self) -> Sequence[Job]:
        """The jobs of the next group; none at the end, as long as they are being made, and where jobs may be appended.
        Nor if they are refused: that is raised where they are taken, when the group before has given its outcomes."""
        try:
            return self._find_next()
        except InputError:
            return ()

    def waiting(self, most: int) -> list[Job]:
        """Jobs that may join the group that was dealt last, at most so many. They follow its own."""
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
        """Jobs that are known from now on; all others have been dealt. ``needs``: of those that count beside them.
        After an error all is as before."""
        if jobs:
            needs |= KernelFeatures.of(jobs, self._granule)
            most = self._size - (self._left if len(jobs) > self._size or self._more is not None else 0)
            self._each = math.ceil(len(jobs) / math.ceil(len(jobs) / most))
        self.needs, self._known = needs, jobs


class GrowingGroups(Groups):
    """Jobs may be appended, and join a group whose kernels know what they have."""

    grows = True

    def __init__(self, jobs: Sequence[Job], size: int, left: int, granule: int) -> None:
        super().__init__(jobs, size, left, granule)
        self._jobs = jobs
        self._end = len(jobs)
        """Jobs of all kinds that ``needs`` is of are before this one."""

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
