"""The last worlds of a group go on beside those of the next one: alone they would leave most of the device idle.

The tables of the next group of worlds, begun by a thread while the device has the one before: it would wait.

A run on the device: which groups of worlds come one after another, and what goes on from each to the next.
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
        jobs: of these worlds.
        numbers: of the jobs in their run.
        rows: of the worlds in the group.
        ready: the group in which they are the last, and its queues, made while this one goes on; None: there was no
            room for the tables of both.
        emitted: those whose outcomes are known.
        table: their states, a row each; rows beyond them are of no world.
    """

    jobs: list[Job]
    numbers: list[int]
    rows: NDArray[np.int64]
    ready: tuple[Group, Queues] | None = None
    emitted: NDArray[np.bool_] = field(init=False)
    table: State = field(init=False)

    def leave(self, table: State, emitted: NDArray[np.bool_], most: int) -> None:
        """Take their states from the table of their group.

        Args:
            emitted: (row,) of all worlds of the group.
            most: rows of the new table, at least as many; the same in all groups, so that it is compiled once.
        """
        self.emitted = emitted[self.rows]
        self.table = _take(table, device_array(np.resize(self.rows, most).astype(np.int32)))

    def put_into(self, table: State, first_row: int) -> State:
        """A table in which these worlds have the rows from this one on, with their states. It may have other columns,
        for more boxes or fewer, but no fewer than they need."""
        return put_from(table, first_row, len(self.jobs), self.table, _put)


@dataclass(eq=False)
class RowPrefetcher:
    """Rows of some jobs' scenes, made before these are loaded. They are on the host: on the device they are loaded when
    the group before is down to its last worlds."""

    _thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "petmjx-tables"))
    _begun: tuple[Sequence[Job], int, Future[Rows]] | None = None

    def prepare(self, groups: Groups, sim: Simulation) -> None:
        """Begin the rows of the next group's jobs once these are known, with its box columns."""
        jobs = groups.following()
        if jobs and (self._begun is None or self._begun[0] is not jobs):
            width = groups.needs.of_sizes(jobs).most_boxes
            self._begun = jobs, width, self._thread.submit(rows_of, [job.scene for job in jobs], width, sim)

    @property
    def made(self) -> bool:
        """Whether rows have been begun and are there, or could not be made."""
        return self._begun is not None and self._begun[2].done()

    def take(self, jobs: Sequence[Job], width: int) -> Rows | None:
        """The rows of the first of some jobs, once; None if they have not been begun, or could not be made: whoever
        makes them then meets the error."""
        if self._begun is None:
            return None
        begun, columns, rows = self._begun
        same = columns == width and len(begun) <= len(jobs)
        if not same or any(one is not other for one, other in zip(begun, jobs, strict=False)):
            return None
        self._begun = None
        return None if rows.exception() is not None else rows.result()

    def close(self) -> None:
        """Nothing more is needed; rows that are being made are waited for."""
        self._begun = None
        self._thread.shutdown(cancel_futures=True)


class GroupStart(NamedTuple):
    """A group that begins: its own jobs, and those that the one before has left, with their numbers in the run."""

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
        left: what the last group has left.
        ahead: tables of the next one.
        asked: number → job of those that have begun and have no outcome.
    """

    groups: Groups
    sim: Simulation
    progress: Progress
    most_left: int
    alone: bool
    left: GroupHandover | None = None
    ahead: RowPrefetcher = field(default_factory=RowPrefetcher)
    asked: dict[int, Job] = field(default_factory=dict)

    @property
    def waits_for_host(self) -> bool:
        """Whether each slice of the next group waits until the host has made outcomes of the one before: more jobs may
        follow from these, or the host takes frames of recorded worlds away."""
        return self.groups.grows or self.groups.recorded

    def next_run(self) -> Run:
        """Of the next group."""
        return Run.of(self.groups.needs, self.sim, self.progress)

    def next_is_due(self, rest: int, most: int, blocks: int) -> bool:
        """Whether the tables of the next group are to be made. Their rows are begun on the host as soon as it is known.

        Args:
            rest: worlds of this group that have not ended.
            most: of them then.
            blocks: of the device. While more worlds are left, rows that are not there yet are made beside it.
        """
        self.ahead.prepare(self.groups, self.sim)
        return 0 < rest <= most and bool(self.groups.following()) and (rest <= blocks or self.ahead.made)

    def begin(self) -> GroupStart:
        """The next group."""
        jobs = self.groups.take()
        numbers = list(range(self.groups.first, self.groups.first + len(jobs)))
        self.asked.update(zip(numbers, jobs, strict=True))
        run = self.next_run()  # after that: where memory runs out for it, these are lost, and not begun again for ever
        left, self.left = self.left, None
        if left is not None:
            jobs, numbers = jobs + left.jobs, numbers + left.numbers
        return GroupStart(run, jobs, numbers, left)

    def join(self, jobs: list[Job], numbers: list[int]) -> None:
        """Jobs that were waiting are in a group now."""
        numbers += range(self.groups.first + len(numbers), self.groups.first + len(numbers) + len(jobs))
        self.asked.update(zip(numbers[-len(jobs) :], jobs, strict=True))

    def lose(self) -> dict[int, Job]:
        """The jobs without an outcome, whose states are lost. They are not of this course any more."""
        lost, self.asked, self.left = self.asked, {}, None
        return lost

    def close(self) -> None:
        """Nothing more is prepared."""
        self.ahead.close()
