"""A group of worlds that mjx-warp has on its device at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.base import Progress
from petmjx.engines.batch.state import State, Status
from petmjx.engines.batch.timetable import Timetable
from petmjx.engines.batch.upload import Batch
from petmjx.engines.batch.worlds import Worlds
from petmjx.engines.warp.ahead import Ahead
from petmjx.engines.warp.groups import Groups
from petmjx.engines.warp.handover import Handover, put_from
from petmjx.engines.warp.needs import Needs
from petmjx.options.config import Simulation
from petmjx.verdict import Flag
from petmjx.world.job import Job

MAX_GROWTH = 8
"""Largest factor for buffers that overflow; they are doubled each time. A world that needs more is invalid."""

OVERFLOW_BITS = int(Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW)


@dataclass
class Run:
    """What the groups of a run have in common.

    Attributes:
        needs: what its kernels know and have room for.
        groups: the run's jobs; None: those of one group.
        handover: from each group to the next one.
        ahead: the tables of the next one.
    """

    sim: Simulation
    timetable: Timetable
    needs: Needs
    progress: Progress
    groups: Groups | None = None
    handover: Handover = field(default_factory=Handover)
    ahead: Ahead = field(default_factory=Ahead)

    @property
    def grows(self) -> bool:
        """Whether more jobs may be appended."""
        return self.groups is not None and self.groups.grows

    def waits_for_host(self, jobs: Sequence[Job]) -> bool:
        """Whether the next slice of a group of jobs waits until the host has made outcomes of the last one: more jobs
        may follow from these, or the host takes frames of recorded worlds away."""
        return self.grows or any(job.record is not None for job in jobs)


@dataclass
class Group(Batch):
    """Worlds of all sizes, and room for their frames on the device."""

    run: Run
    frames: dict[str, jax.Array] | None = None

    def status(self) -> NDArray[np.int32]:
        """Statuses of the jobs' rows, on the host."""
        return np.asarray(self.table.status)[: len(self.jobs)]

    def handed_on(self, status: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which jobs are at their end, by the statuses of their rows, and not on the way to a drive."""
        ended: NDArray[np.bool_] = (status == Status.FINISHED) | ((status == Status.SETTLED) & ~self.driven)
        return ended

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """Jobs with a drive."""
        return np.array([job.drive is not None for job in self.jobs], bool)

    def add(self, jobs: Sequence[Job], worlds: Worlds, table: State) -> None:
        """Put more jobs into the rows behind those that are taken. Tables have a row for each of them at least."""
        first, count = len(self.jobs), len(jobs)
        self.worlds = put_from(self.worlds, first, count, worlds)
        self.table = put_from(self.table, first, count, table)
        self.jobs += jobs
        self.__dict__.pop("driven", None)  # is worked out anew

    def retry(self, rows: NDArray[np.int64]) -> None:
        """Clear the overflow bits and set the bit for a re-run: in larger buffers the result is valid."""
        flags = (self.table.flags[rows] & ~OVERFLOW_BITS) | int(Flag.RERUN_AFTER_OVERFLOW)
        self.table = self.table._replace(flags=self.table.flags.at[rows].set(flags))
