"""A batch of mjx-jax while it is simulated: its phases, its ended worlds, and the jobs that get their rows."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice, takewhile
from typing import Final, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.batch_step import Memory
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.host_to_device import Batch, put_into, tables
from petmjx.engines.mjx.readback import Readback, readbacks_of
from petmjx.engines.mjx.rollout import Program
from petmjx.engines.mjx.timetable import Timetable
from petmjx.engines.mjx.world_constants import device_array
from petmjx.engines.mjx.world_state import Status, select_rows
from petmjx.engines.protocol import Progress
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

REFILL_SHARE: Final = 8
"""While jobs wait, a batch is interrupted as soon as one in ``REFILL_SHARE`` of its rows holds a world that has
ended."""


class Phase(NamedTuple):
    """A phase of a batch: its program, the kind of its drive (None if the phase is the placement), and the table of
    profiles."""

    program: Program
    drive: str | None
    profiles: jax.Array


class EndedWorlds(NamedTuple):
    """Worlds of a batch that have ended.

    Attributes:
        picked: states and metrics, on the device.
        jobs: number of a row → job of the ended world that was in this row.
        indices: number of a row → index of this job.
    """

    picked: Sequence[Readback]
    jobs: Mapping[int, Job]
    indices: Mapping[int, int]
    recorder: Recorder


@dataclass
class BatchRun:
    """A batch, and how far it has come.

    Attributes:
        indices: number of a row → index of its job, for worlds without an outcome.
        refills: whether further jobs may get rows of ended worlds. Worlds can begin only in the first phase of a batch.
        phases: the phases that are left. The phase of the placement ends when no world is in its placement any more,
            and the phase of the drive ends when no world is in its drive any more.
        memory: the data that the solver keeps from one pass to the next in the present phase; None before the phase
            begins.
    """

    batch: Batch
    indices: dict[int, int]
    sim: Simulation
    refills: bool
    phases: list[Phase] = field(default_factory=list)
    memory: Memory | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.batch.table.status)

    @property
    def free(self) -> int:
        """Number of rows of worlds that have ended and have an outcome."""
        return self.rows - len(self.indices)

    @property
    def at_once(self) -> int:
        """The batch is interrupted when this number of its worlds has ended. Jobs are also added in groups of this
        number."""
        return max(self.rows // REFILL_SHARE, 1)

    def simulate(self, interrupts: Callable[[], bool], progress: Progress, lock: threading.Lock) -> None:
        """Step the batch until all its worlds have ended, or ``interrupts()`` is True between two chunks of passes.

        Args:
            lock: lock of the numbers in ``progress``.
        """
        batch, capacity = self.batch, self.batch.worlds.half.shape[1]
        while self.phases:
            program, drive, profiles = self.phases[0]
            if self.memory is None:
                self.memory = program.model.blank_memory(self.rows)
            going = (Status.RUNNING,) if drive is None else (Status.RUNNING, Status.SETTLED)
            label = f"{'place' if drive is None else 'drive'} capacity {capacity}"
            begin = time.perf_counter()
            while not (interrupted := interrupts()) and (running := int(np.isin(self._status(), going).sum())):
                progress.message = f"{label}: {running} worlds running"
                batch.table, self.memory, trail = program.chunk(batch.table, self.memory, batch.worlds, profiles)
                if not batch.recorder.idle:
                    batch.recorder.add_trail(trail)
                with lock:
                    progress.world_steps += int(np.asarray(trail.ran).sum())
            with lock:
                spent = f"{label} seconds"
                progress.extra[spent] = progress.extra.get(spent, 0) + time.perf_counter() - begin
                progress.extra[f"{label} lanes"] = max(progress.extra.get(f"{label} lanes", 0), self.rows)
            if interrupted:
                return
            del self.phases[0]
            self.memory, self.refills = None, False

    def ended(self) -> list[int]:
        """Numbers of the rows whose worlds have ended and have no outcome yet."""
        lasting: list[int] = [Status.RUNNING] if self.phases else []
        if self.phases and self.phases[-1].drive is not None:
            lasting.append(Status.SETTLED)  # its drive follows
        ends = ~np.isin(self._status(), lasting)
        return [row for row in self.indices if ends[row]]

    def take_ended(self) -> EndedWorlds:
        """The worlds that have ended. Their rows are free afterwards."""
        rows, batch = self.ended(), self.batch
        picked = readbacks_of(np.array(rows, np.int64), batch.table, batch.worlds, self.sim)
        jobs = {row: batch.jobs[row] for row in rows}
        return EndedWorlds(picked, jobs, {row: self.indices.pop(row) for row in rows}, batch.recorder)

    def fitting(self, waiting: Iterable[Job]) -> int:
        """Number of waiting jobs that get free rows. Jobs get rows in order, up to the first job that does not fit: a
        job whose world must be recorded, or whose profile is not in the table of profiles."""

        def fits(job: Job) -> bool:
            return job.record is None and (job.drive is None or id(job.drive.excitation) in self.batch.profile_rows)

        self.refills = self.refills and self.batch.recorder.idle
        count = len([*takewhile(fits, islice(waiting, self.free))]) if self.refills else 0
        self.refills = count > 0
        return count

    def add(self, jobs: Mapping[int, Job], timetable: Timetable) -> None:
        """Give free rows to jobs. ``jobs``: index → job. ``self.indices`` gets the jobs even if memory runs out."""
        batch, width = self.batch, self.batch.worlds.half.shape[1]
        free = [row for row in range(self.rows) if row not in self.indices]
        pairs = list(zip(free, jobs.items(), strict=False))
        for row, (index, job) in pairs:
            batch.jobs[row], self.indices[row] = job, index
        for first in range(0, len(pairs), self.at_once):
            some = pairs[first : first + self.at_once]
            new, at = [job for _, (_, job) in some], np.array([row for row, _ in some])
            worlds, states = tables(new, self.at_once, width, batch.profile_rows, self.sim, timetable, batch.boards)
            batch.worlds, batch.table = put_into(batch.worlds, at, worlds), put_into(batch.table, at, states)
        if pairs and self.memory is not None:
            blank = self.phases[0].program.model.blank_memory(self.rows)
            self.memory = select_rows(device_array(np.isin(np.arange(self.rows), free)), blank, self.memory)

    def _status(self) -> NDArray[np.int32]:
        """(row,) the status of each world."""
        return np.asarray(self.batch.table.status)
