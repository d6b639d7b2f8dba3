"""The table of worlds on mjx-warp's device, with one row per world. Rows of ended worlds are given to further jobs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.host_to_device import Batch, put_into, tables
from petmjx.engines.mjx.padded_sizes import padded_rows
from petmjx.engines.mjx.scene_rows import more_shapes
from petmjx.engines.mjx.timetable import Timetable, build_timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds, device_array
from petmjx.engines.mjx.world_state import State, Status, put_resized, take_rows
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Flag
from petmjx.engines.warp.kernel_features import KernelFeatures, size_of
from petmjx.engines.warp.long_worlds import most_steps
from petmjx.options.simulation import Simulation
from petmjx.world.job import Excitation, Job

OVERFLOW_BITS = int(Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW)

_take, _put_resized = jax.jit(take_rows), jax.jit(put_resized, donate_argnums=0)


@partial(jax.jit, donate_argnums=0)
def _put_profiles(profiles: jax.Array, rows: jax.Array, samples: jax.Array) -> jax.Array:
    return profiles.at[rows].set(samples)


@dataclass
class TableRun:
    """Options that all worlds of a table have in common.

    Attributes:
        needs: features and sizes that the table's kernels need.
        message: progress message while the worlds of the table are simulated.
        long_leave: whether long worlds leave the device (petmjx.engines.warp.long_worlds).
    """

    sim: Simulation
    timetable: Timetable
    needs: KernelFeatures
    progress: Progress
    message: str = ""
    long_leave: bool = False

    @classmethod
    def of(cls, needs: KernelFeatures, sim: Simulation, progress: Progress, *, long_leave: bool = False) -> TableRun:
        """The options of a run whose kernels need the features and sizes ``needs``."""
        return cls(sim, build_timetable(sim, needs.most_boxes), needs, progress, progress.message, long_leave)

    def with_most_steps(self, worlds: Worlds, jobs: Sequence[Job]) -> Worlds:
        """The constants ``worlds`` of the jobs' worlds, in which the field ``most_steps`` is set: the number of steps
        after which each world leaves the device."""
        if not self.long_leave:
            return worlds
        steps = np.full(len(worlds.most_steps), NEVER, np.int32)
        steps[: len(jobs)] = most_steps(jobs, self.sim)
        return worlds._replace(most_steps=device_array(steps))


class RunningWorlds(NamedTuple):
    """The worlds of a table that have not ended and move to another table.

    Attributes:
        jobs, stream_numbers: the jobs of these worlds, and the stream numbers of the jobs.
        states: one row per world, followed by rows that belong to no world.
    """

    jobs: list[Job]
    stream_numbers: list[int]
    states: State


@dataclass
class WorldTable(Batch):
    """Worlds of all sizes on the device, and the buffers for their recorded frames.

    ``jobs`` has the latest job of each row that has been used.

    Attributes:
        stream_numbers: stream number of the job in each row.
        live: (row,) whether the world in each row has not ended.
        slices: number of time slices that have begun.
        since: (row,) number of the first slice of the world in each row. In earlier slices, the row had another world.
    """

    run: TableRun
    stream_numbers: list[int]
    frames: dict[str, jax.Array] | None = None
    slices: int = 0
    live: NDArray[np.bool_] = field(init=False)
    since: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        self.live = np.arange(self.rows) < len(self.jobs)
        self.since = np.zeros(self.rows, np.int64)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.table.status)

    def status(self) -> NDArray[np.int32]:
        """(row,) statuses of the worlds after all slices that have begun, in the CPU's memory. The call waits for these
        slices."""
        return np.asarray(self.table.status)

    def status_after(self, slice_number: int, status: NDArray[np.int32]) -> NDArray[np.int32]:
        """(row,) statuses of the worlds after a slice. Worlds that joined after this slice have the status
        ``RUNNING``."""
        running: NDArray[np.int32] = np.where(self.since > slice_number, np.int32(Status.RUNNING), status)
        return running

    def ended(self, status: NDArray[np.int32]) -> NDArray[np.intp]:
        """Row numbers of the worlds that have just reached their end or left the device. A settled world that waits for
        its drive (motion of the carrier) is not included.
        """
        settled = np.flatnonzero(self.live & (status == Status.SETTLED))
        is_end = self.live & np.isin(status, (Status.FINISHED, Status.PAUSED, Status.LEFT))
        is_end[[row for row in settled.tolist() if self.jobs[row].drive is None]] = True
        return np.flatnonzero(is_end)

    def fits(self, job: Job) -> bool:
        """Whether a job can get a row: its world must fit into the buffers of the table and of its block size
        (``size_of``), and the kernels must have the features that it needs. A recorded world never fits, and no world
        fits into a table that records worlds."""
        needs = self.run.needs
        has_blocks = job.scene.n_boxes <= needs.widths.get(size_of(job), 0)
        has_blocks &= more_shapes(job.scene) <= self.boards
        has_times = job.scene.n_boxes < len(self.run.timetable.one_by_one_end)
        excitation = _excitation(job)
        has_steps = excitation is None or len(excitation.samples) <= self.profiles.shape[1]
        return has_blocks and has_times and has_steps and needs.know(job) and job.record is None and self.recorder.idle

    def add(self, jobs: Sequence[Job], stream_numbers: Sequence[int], at_once: int) -> NDArray[np.intp]:
        """Put jobs that fit into free rows. Returns the row numbers. There are fewer rows than jobs if the table has no
        room for all their profiles (motions of the carrier).

        Args:
            at_once: number of rows that are written at a time. XLA compiles a program for each such number.
        """
        jobs = jobs[: self._with_profiles(jobs)]
        free = np.flatnonzero(~self.live)[: len(jobs)]
        for first in range(0, len(free), at_once):
            some, rows = jobs[first : first + at_once], free[first : first + at_once]
            width, sim, timetable = self.table.qpos.shape[1], self.run.sim, self.run.timetable
            worlds, states = tables(some, at_once, width, self.profile_rows, sim, timetable, self.boards)
            self.worlds = put_into(self.worlds, rows, self.run.with_most_steps(worlds, some))
            self.table = put_into(self.table, rows, states)
        for row, job, stream_number in zip(free.tolist(), jobs, stream_numbers, strict=False):
            if row < len(self.jobs):
                self.jobs[row], self.stream_numbers[row] = job, stream_number
            else:
                self.jobs.append(job)
                self.stream_numbers.append(stream_number)
        self.live[free], self.since[free] = True, self.slices
        return free

    def _with_profiles(self, jobs: Sequence[Job]) -> int:
        """Write the profiles of jobs into profile rows that no running world needs. Returns the number of jobs whose
        profiles had room.
        """
        if all(job.drive is None for job in jobs):
            return len(jobs)
        live = [self.jobs[row] for row in np.flatnonzero(self.live).tolist()]
        needed = {id(excitation) for excitation in map(_excitation, live) if excitation is not None}
        # excitations that no world needs are forgotten: Python may free them and give their ids to other excitations
        self.profile_rows = {key: row for key, row in self.profile_rows.items() if key in needed}
        free = sorted({*range(len(self.profiles))} - {*self.profile_rows.values()}, reverse=True)
        rows, samples = list[int](), list[NDArray[np.float32]]()
        fitting = len(jobs)
        for index, excitation in enumerate(map(_excitation, jobs)):
            if excitation is None or id(excitation) in self.profile_rows:
                continue
            if not free:
                fitting = index
                break
            rows.append(free.pop())
            self.profile_rows[id(excitation)] = rows[-1]
            padded = np.zeros(self.profiles.shape[1:], np.float32)
            padded[: len(excitation.samples)] = excitation.samples
            samples.append(padded)
        if rows:
            repeated = np.resize(np.arange(len(rows)), padded_rows(len(rows)))
            at = np.array(rows, np.int32)[repeated]
            self.profiles = _put_profiles(self.profiles, device_array(at), device_array(np.stack(samples)[repeated]))
        return fitting

    def end(self, rows: NDArray[np.intp]) -> None:
        """Free the rows of worlds that have ended."""
        self.live[rows] = False

    def take_running(self) -> RunningWorlds | None:
        """The worlds that have not ended, for another table; None if all worlds have ended."""
        rows = np.flatnonzero(self.live)
        if not len(rows):
            return None
        jobs, stream_numbers = [self.jobs[row] for row in rows], [self.stream_numbers[row] for row in rows]
        padded = np.resize(rows, padded_rows(len(rows))).astype(np.int32)
        return RunningWorlds(jobs, stream_numbers, _take(self.table, device_array(padded)))

    def put_running(self, running: RunningWorlds) -> None:
        """Let worlds of another table continue in the first rows, which already have their jobs. The two tables may
        have different numbers of box columns, but both have enough columns for these worlds."""
        rows = np.arange(len(running.jobs))
        self.table = put_into(self.table, rows, running.states, _put_resized)

    def retry(self, rows: NDArray[np.int64]) -> None:
        """Prepare worlds that overflowed their buffers to continue with larger buffers. Each flag of overflow is
        replaced by ``Flag.RERUN_AFTER_OVERFLOW``, since the results with larger buffers are valid."""
        flags = (self.table.flags[rows] & ~OVERFLOW_BITS) | int(Flag.RERUN_AFTER_OVERFLOW)
        self.table = self.table._replace(flags=self.table.flags.at[rows].set(flags))


def _excitation(job: Job) -> Excitation | None:
    return job.drive.excitation if job.drive is not None else None
