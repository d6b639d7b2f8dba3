"""The last worlds of a group go on beside those of the next one: alone they would leave most of the device idle."""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.batch.state import State, put_resized, take_rows
from petmjx.engines.batch.worlds import uploaded
from petmjx.engines.warp.group import Group, put_from
from petmjx.engines.warp.queues import Queues
from petmjx.world.job import Job

_take, _put = jax.jit(take_rows), jax.jit(put_resized)


@dataclass(eq=False)
class Left:
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
        self.table = _take(table, uploaded(np.resize(self.rows, most).astype(np.int32)))

    def put_into(self, table: State, first_row: int) -> State:
        """A table in which these worlds have the rows from this one on, with their states. It may have other columns,
        for more boxes or fewer, but no fewer than they need."""
        return put_from(table, first_row, len(self.jobs), self.table, _put)
