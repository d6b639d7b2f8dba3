"""Worlds in groups: the base of the MJX engines. What a group is taken through is the engine's own."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.config import Check, Schedule, Simulation
from petmjx.engines.base import Engine, Progress, RunLock
from petmjx.engines.batch.outcomes import handed_on, started_states
from petmjx.engines.batch.recorder import Recorder
from petmjx.engines.batch.setup import set_up_jax
from petmjx.engines.batch.state import NEVER, State, Status, Worlds, fresh_state, put_rows, upload_worlds, uploaded
from petmjx.engines.batch.timetable import Timetable, build_timetable
from petmjx.verdict import Flag, Outcome
from petmjx.world.job import Job

OVERFLOW_BITS = int(Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW)

MAX_GROWTH = 8
"""Largest factor for buffers that overflow; they are doubled each time. A world that needs more is invalid."""

MAX_LANES = 1 << 16
MIN_LANES = 16
"""With fewer lanes than this, no useful amount of memory is saved."""

_put = jax.jit(put_rows)


@dataclass
class Run:
    """One run: what its groups have in common.

    ``capacities``: of the placement stages ("") and of the stages of each kind of drive, or by another key of the
    engine's own. ``lane_limit``: most lanes, lowered when device memory runs out.
    """

    sim: Simulation
    timetable: Timetable
    capacities: dict[str, list[int]]
    progress: Progress
    jobs: Sequence[Job] = ()
    """All jobs of the run, to which more may be appended: ``GrowingJobs``."""
    lane_limit: int = MAX_LANES


@dataclass
class Group:
    """Worlds that go through the stages together."""

    run: Run
    jobs: list[Job]
    worlds: Worlds
    table: State
    profiles: jax.Array
    profile_rows: dict[int, int]
    """``id`` of an excitation → its row in ``profiles``."""
    recorder: Recorder
    frames: dict[str, jax.Array] | None = None
    """Room for frames on the device, of engines that have some there."""

    def status(self) -> NDArray[np.int32]:
        """Statuses of the jobs' rows, on the host."""
        return np.asarray(self.table.status)[: len(self.jobs)]

    def handed_on(self, status: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which jobs are at their end, by the statuses of their rows."""
        return handed_on(status, self.driven)

    @cached_property
    def driven(self) -> NDArray[np.bool_]:
        """Jobs with a drive."""
        return np.array([job.drive is not None for job in self.jobs], bool)

    def add(self, jobs: Sequence[Job], worlds: Worlds, table: State) -> None:
        """Put more jobs into the rows behind those that are taken. Tables have a row for each of them at least."""
        first, rows = len(self.jobs), np.full(len(table.status), len(self.table.status), np.int32)
        rows[: len(jobs)] = np.arange(first, first + len(jobs))
        self.worlds = _put(self.worlds, uploaded(rows), worlds)
        self.table = _put(self.table, uploaded(rows), table)
        self.jobs += jobs
        self.__dict__.pop("driven", None)  # is worked out anew

    def overflowed(self) -> NDArray[np.int64]:
        """Rows that a stage returned unchanged, because a buffer was too small."""
        flags = np.asarray(self.table.flags)[: len(self.jobs)]
        return np.flatnonzero((flags & OVERFLOW_BITS != 0) & (self.status() != Status.FINISHED))

    def retry(self, rows: NDArray[np.int64]) -> None:
        """Clear the overflow bits and set the bit for a re-run: in larger buffers the result is valid."""
        flags = (self.table.flags[rows] & ~OVERFLOW_BITS) | int(Flag.RERUN_AFTER_OVERFLOW)
        self.table = self.table._replace(flags=self.table.flags.at[rows].set(flags))

    def give_up(self, rows: NDArray[np.int64], flag: Flag) -> None:
        """End worlds that cannot be simulated on this device."""
        flags = self.table.flags.at[rows].set(self.table.flags[rows] | int(flag))
        self.table = self.table._replace(flags=flags, status=self.table.status.at[rows].set(Status.FINISHED))


class GroupEngine(Engine, ABC):
    """Simulates worlds in groups on one JAX device.

    Args:
        lanes: most worlds at the same time; fewer if there are fewer worlds, or if memory runs out.
        group_size: worlds whose states are on the device at the same time; it bounds memory for any number of jobs.
    """

    name = "mjx"

    def __init__(self, lanes: int | None, group_size: int) -> None:
        set_up_jax()
        self.lanes, self.group_size = lanes, group_size
        self._running = RunLock(self.name)

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        """Simulate each job once. Outcomes come as worlds reach their end.

        Raises:
            RuntimeError: an earlier run of the same thread has not ended. (Runs of other threads are waited for.)
        """
        if not jobs:
            return
        progress = progress or Progress()
        first = 0
        with self._running:
            while first < len(jobs):  # more may have been appended
                rest = jobs[first:]
                timetable = build_timetable(sim, max(job.scene.n_boxes for job in rest))
                run = Run(sim, timetable, self._choose_capacities(rest, sim), progress, jobs)
                size = math.ceil(len(rest) / math.ceil(len(rest) / self.group_size))
                end = len(jobs)
                while first < end:
                    group = list(jobs[first : min(first + size, end)])
                    yield from self._run_group(run, group, first)
                    first += len(group)  # a group may have taken more

    @abstractmethod
    def _choose_capacities(self, jobs: Sequence[Job], sim: Simulation) -> dict[str, list[int]]:
        """The sizes for which programs are compiled: ``Run.capacities``."""

    @abstractmethod
    def _run_group(self, run: Run, jobs: list[Job], first_job: int) -> Iterator[Outcome]:
        """Outcomes of a group of jobs, which may take more of the run's jobs behind them; these are appended to it."""

    def _load_group(self, run: Run, jobs: list[Job], most: int = 0) -> Group:
        """The tables of a group. ``most``: rows for as many jobs, if there are fewer now."""
        width = max(max(capacities) for capacities in run.capacities.values())
        excitations = {id(job.drive.excitation): job.drive.excitation for job in jobs if job.drive}
        steps = max([len(e.samples) for e in excitations.values()], default=1)
        profiles = np.zeros((max(len(excitations), 1), steps, 3), np.float32)
        for row, excitation in enumerate(excitations.values()):
            profiles[row, : len(excitation.samples)] = excitation.samples
        profile_rows = {key: row for row, key in enumerate(excitations)}
        rows = 1 << (max(len(jobs), most) - 1).bit_length()
        worlds, table = self._tables(run, jobs, rows, width, profile_rows)
        recorder = Recorder(jobs, run.sim)
        return Group(run, jobs, worlds, table, uploaded(profiles), profile_rows, recorder)

    @staticmethod
    def _tables(
        run: Run, jobs: Sequence[Job], rows: int, width: int, profile_rows: dict[int, int]
    ) -> tuple[Worlds, State]:
        """Constants and first states of jobs, for tables of so many rows and box columns."""
        sim, timetable = run.sim, run.timetable
        worlds = upload_worlds(jobs, rows, width, profile_rows, sim)
        static = sim.check is Check.STATIC
        ends = np.full(rows, NEVER, np.int32)
        if sim.schedule is Schedule.FIXED:
            for row, job in enumerate(jobs):
                if job.drive is None and not job.keep_state:
                    n = job.scene.n_boxes
                    ends[row] = timetable.static_end if static else timetable.one_by_one_end[n]
        fresh = fresh_state(worlds, all_placed=static, ends=uploaded(ends), rest_steps=timetable.rest_steps)
        return worlds, started_states(jobs, fresh)


def is_out_of_memory(error: Exception) -> bool:
    """Whether an error of JAX, XLA or Warp says that device memory ran out, or one of Python that the host's did."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(
        words in text for words in ("resource_exhausted", "out of memory", "failed to allocate")
    )
