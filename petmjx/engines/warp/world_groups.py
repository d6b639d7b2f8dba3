"""A group of worlds that are on mjx-warp's device at the same time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.host_to_device import Batch
from petmjx.engines.mjx.timetable import Timetable, build_timetable
from petmjx.engines.mjx.world_constants import Worlds, device_array
from petmjx.engines.mjx.world_state import State, Status, put_rows
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Flag
from petmjx.engines.warp.kernel_features import KernelFeatures, size_of
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

MAX_GROWTH = 8
"""Largest growth of buffers. They double with each overflow. A world that needs more is invalid."""

OVERFLOW_BITS = int(Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW)

Table = TypeVar("Table", State, Worlds)

_put = jax.jit(put_rows)


def put_from(table: Table, first_row: int, count: int, values: Table, put: Callable[..., Table] = _put) -> Table:
    """The table with the first ``count`` rows of ``values`` in its rows from ``first_row`` on.

    Args:
        put: a function like ``put_rows``.
    """
    length, end = len(jax.tree.leaves(values)[0]), len(jax.tree.leaves(table)[0])
    rows = np.full(length, end, np.int32)  # rows beyond the end are dropped
    rows[:count] = first_row + np.arange(count)
    return put(table, device_array(rows), values)


@dataclass
class Run:
    """Options that the worlds of a group have in common.

    Attributes:
        needs: features and sizes of the group's kernels.
        message: the progress message while its worlds are simulated.
    """

    sim: Simulation
    timetable: Timetable
    needs: KernelFeatures
    progress: Progress
    message: str = ""

    @classmethod
    def of(cls, needs: KernelFeatures, sim: Simulation, progress: Progress) -> Run:
        """The run options of worlds with these needs."""
        return cls(sim, build_timetable(sim, needs.most_boxes), needs, progress, progress.message)


@dataclass
class Group(Batch):
    """Worlds of all sizes on the device, and the buffers for their frames."""

    run: Run
    frames: dict[str, jax.Array] | None = None

    def status(self) -> NDArray[np.int32]:
        """Statuses of the jobs' rows, on the host."""
        return np.asarray(self.table.status)[: len(self.jobs)]

    def handed_on(self, status: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which jobs have reached their end, by the statuses of their rows. A settled world that waits for its drive
        has not."""
        ended: NDArray[np.bool_] = (status == Status.FINISHED) | ((status == Status.SETTLED) & ~self.driven)
        return ended

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """Mask of the jobs with a drive."""
        return np.array([job.drive is not None for job in self.jobs], bool)

    def fits(self, job: Job) -> bool:
        """Whether a job can join the group: the tables, and the blocks of its size, have room for it."""
        known = job.drive is None or id(job.drive.excitation) in self.profile_rows
        has_blocks = job.scene.n_boxes <= self.run.needs.widths.get(size_of(job), 0)
        has_blocks &= len(job.scene.carrier.half_size) <= self.boards
        has_times = job.scene.n_boxes < len(self.run.timetable.one_by_one_end)
        return known and has_blocks and has_times and job.record is None and self.recorder.idle

    def add(self, jobs: Sequence[Job], worlds: Worlds, table: State) -> None:
        """Put more jobs into the rows after the used ones. ``worlds`` and ``table`` have at least a row for each of
        them."""
        first, count = len(self.jobs), len(jobs)
        self.worlds = put_from(self.worlds, first, count, worlds)
        self.table = put_from(self.table, first, count, table)
        self.jobs += jobs
        self.__dict__.pop("driven", None)  # is computed anew

    def retry(self, rows: NDArray[np.int64]) -> None:
        """Clear the overflow bits and set the bit for a re-run. In larger buffers the result is valid."""
        flags = (self.table.flags[rows] & ~OVERFLOW_BITS) | int(Flag.RERUN_AFTER_OVERFLOW)
        self.table = self.table._replace(flags=self.table.flags.at[rows].set(flags))
