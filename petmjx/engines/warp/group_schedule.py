"""The sequence of groups in a run: prefetch of the next group's rows, and handover of a group's last worlds.

The last worlds of a group go on beside those of the next group. Alone they would leave most of the device idle. A
thread begins the rows of the next group while the device simulates the group before. Else the device would wait for
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.scene_rows import Rows, rows_of
from petmjx.engines.mjx.world_constants import device_array
from petmjx.engines.mjx.world_state import State, put_resized, take_rows
from petmjx.engines.protocol import Progress
from petmjx.engines.warp.block_queues import Queues
from petmjx.engines.warp.group_jobs import Groups
from petmjx.engines.warp.world_groups import Group, Run, put_from
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

_take, _put = jax.jit(take_rows), jax.jit(put_resized)


@dataclass(eq=False)
class GroupHandover:
    """Worlds of a group that go on in the next one.

    Attributes:
        jobs: the jobs of these worlds.
        numbers: the numbers of the jobs in their run.
        rows: rows of the worlds in their group.
        ready: the next group, in which these worlds have the last rows, and its queues, made while the current group
            goes on; None: there was no room for the tables of both.
        emitted: mask of worlds whose outcomes are known.
        table: the states, a row a world; spare rows belong to no world.
    """

    jobs: list[Job]
    numbers: list[int]
    rows: NDArray[np.int64]
    ready: tuple[Group, Queues] | None = None
    emitted: NDArray[np.bool_] = field(init=False)
    table: State = field(init=False)

    def leave(self, table: State, emitted: NDArray[np.bool_], most: int) -> None:
        """Copy the states of these worlds from the table of their group.

        Args:
            emitted: (row,) mask for all worlds of the group.
            most: rows of the new table, at least one a world. The same in all groups, so that the program is compiled
                once.
        """
        self.emitted = emitted[self.rows]
        self.table = _take(table, device_array(np.resize(self.rows, most).astype(np.int32)))

    def put_into(self, table: State, first_row: int) -> State:
        """The table with the states of these worlds, in rows from ``first_row`` on. The table may have more or fewer
        box columns than the states, but at least as many as the worlds need."""
        return put_from(table, first_row, len(self.jobs), self.table, _put)


@dataclass(eq=False)
class RowPrefetcher:
    """Prefetches the rows of jobs' scenes in a thread. The rows stay on the host, and are loaded onto the device when
    the group before is down to its last worlds."""

    _thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "petmjx-tables"))
    _begun: tuple[Sequence[Job], int, Future[Rows]] | None = None

    def prepare(self, groups: Groups, sim: Simulation) -> None:
        """Begin the rows of the next group's jobs as soon as these are known, with the box columns of that group."""
        jobs = groups.following()
        if jobs and (self._begun is None or self._begun[0] is not jobs):
            width = groups.needs.of_sizes(jobs).most_boxes
            self._begun = jobs, width, self._thread.submit(rows_of, [job.scene for job in jobs], width, sim)

    @property
    def ready(self) -> bool:
        """Whether rows have been begun, and are made or have failed."""
        return self._begun is not None and self._begun[2].done()

    def take(self, jobs: Sequence[Job], width: int) -> Rows | None:
        """The rows of the first of these jobs; they can be taken once. None if they have not been begun or have failed;
        then the caller makes them and gets the error."""
        if self._begun is None:
            return None
        begun, columns, rows = self._begun
        same = columns == width and len(begun) <= len(jobs)
        if not same or any(one is not other for one, other in zip(begun, jobs, strict=False)):
            return None
        self._begun = None
        return None if rows.exception() is not None else rows.result()

    def close(self) -> None:
        """Drop the rows, and wait for the thread if it is making some."""
        self._begun = None
        self._thread.shutdown(cancel_futures=True)


class GroupStart(NamedTuple):
    """The jobs of a group that begins, with their numbers in the run: its own jobs, then those left by the group
    before."""

    run: Run
    jobs: list[Job]
    numbers: list[int]
    left: GroupHandover | None = None


@dataclass(eq=False)
class GroupSequence:
    """The groups of a run.

    Attributes:
        most_left: worlds that a group may leave to the next one. 0: it leaves none.
        alone: whether there is one job in all.
        left: worlds that the last group has left.
        ahead: prefetches the rows of the next group.
        in_flight: number → job, for jobs that have begun and have no outcome yet.
    """

    groups: Groups
    sim: Simulation
    progress: Progress
    most_left: int
    alone: bool
    left: GroupHandover | None = None
    ahead: RowPrefetcher = field(default_factory=RowPrefetcher)
    in_flight: dict[int, Job] = field(default_factory=dict)

    @property
    def waits_for_host(self) -> bool:
        """Whether each slice of the next group waits until the host has made the outcomes of the slice before. It does
        if more jobs may follow from outcomes, or if the host must fetch frames of recorded worlds."""
        return self.groups.grows or self.groups.recorded

    def next_run(self) -> Run:
        """The run options of the next group."""
        return Run.of(self.groups.needs, self.sim, self.progress)

    def next_is_due(self, rest: int, most: int, blocks: int) -> bool:
        """Whether to make the tables of the next group now. Also begins the prefetch of its rows as soon as its jobs
        are known.

        Args:
            rest: worlds of this group that have not ended.
            most: number of these worlds up to which tables are made.
            blocks: blocks of the device. While more worlds than this are left, tables are not due before their rows are
                prefetched.
        """
        self.ahead.prepare(self.groups, self.sim)
        return 0 < rest <= most and bool(self.groups.following()) and (rest <= blocks or self.ahead.ready)

    def begin(self) -> GroupStart:
        """The next group."""
        jobs = self.groups.take()
        numbers = list(range(self.groups.first, self.groups.first + len(jobs)))
        self.in_flight.update(zip(numbers, jobs, strict=True))
        run = self.next_run()  # after ``in_flight``: if memory runs out here, these jobs are lost, not begun for ever
        left, self.left = self.left, None
        if left is not None:
            jobs, numbers = jobs + left.jobs, numbers + left.numbers
        return GroupStart(run, jobs, numbers, left)

    def join(self, jobs: list[Job], numbers: list[int]) -> None:
        """Record that waiting jobs have joined the current group."""
        numbers += range(self.groups.first + len(numbers), self.groups.first + len(numbers) + len(jobs))
        self.in_flight.update(zip(numbers[-len(jobs) :], jobs, strict=True))

    def lose(self) -> dict[int, Job]:
        """Remove and return the jobs without an outcome, whose states are lost."""
        lost, self.in_flight, self.left = self.in_flight, {}, None
        return lost

    def close(self) -> None:
        """Stop the prefetch."""
        self.ahead.close()
