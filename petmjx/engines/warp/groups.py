"""The jobs of a run by the group: those whose worlds the device has at the same time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import takewhile

from petmjx.engines.base import GrowingJobs, JobsInParts
from petmjx.engines.warp.needs import Needs
from petmjx.world.job import Job


class Groups:
    """Deals jobs in their order, in groups of equal size.

    Args:
        size: most worlds of a group.
        left: so many of them may have been left by the group before (``Handover``).
        granule: as of ``Needs``.

    Attributes:
        needs: of all jobs that are known, so that groups have the same kernels.
        first: the number of the first job of the group that was dealt last.
        grows: whether jobs may be appended (``GrowingJobs``).
    """

    def __init__(self, jobs: Sequence[Job], size: int, left: int, granule: int) -> None:
        self.grows = isinstance(jobs, GrowingJobs)
        self.needs, self.first = Needs({}), 0
        self._jobs, self._size, self._left, self._granule = jobs, size, left, granule
        self._next: Sequence[Job] = ()
        self._next_part: Sequence[Job] = ()

    def __iter__(self) -> Iterator[list[Job]]:
        """Each group. Meanwhile jobs that are ``waiting`` may be appended to it."""
        self._meet(self._jobs[:])
        if isinstance(self._jobs, JobsInParts):
            self._jobs.clear()
        while part := self._next_part:
            self._next_part = ()
            begin, each = self.first, self._each(part)
            while (at := self.first - begin) < len(part):
                group = list(part[at : at + each])
                self._next = () if self.grows else part[at + each : at + 2 * each]
                yield group
                self.first += len(group)
            if self.grows:
                self.needs = Needs({})
                self._meet(self._jobs[self.first :])
            else:
                self.following()

    def following(self) -> Sequence[Job]:
        """The jobs of the next group: none at the end, as long as they are being made, and where jobs may be
        appended."""
        if not self._next and not self.grows:
            if not self._next_part and isinstance(self._jobs, JobsInParts):
                self._meet(self._jobs.next_part() or ())
            self._next = self._next_part[: self._each(self._next_part)]
        return self._next

    def waiting(self, group: Sequence[Job], most: int) -> list[Job]:
        """Jobs that follow those of the group and may join them, at most so many."""
        if not self.grows:
            return []
        begin = self.first + len(group)
        return list(takewhile(self.needs.know, self._jobs[begin : begin + most]))

    def _meet(self, part: Sequence[Job]) -> None:
        """Jobs that are known now."""
        self._next_part = part
        if part:
            self.needs |= Needs.of(part, self._granule)

    def _each(self, part: Sequence[Job]) -> int:
        """Jobs of a group."""
        several = len(part) > self._size or isinstance(self._jobs, JobsInParts)
        most = self._size - (self._left if several else 0)
        return math.ceil(len(part) / max(math.ceil(len(part) / most), 1))
