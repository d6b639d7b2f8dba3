"""The last worlds of a group go on beside those of the next one: alone they would leave most of the device idle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.batch.state import State, put_rows, take_rows
from petmjx.engines.batch.worlds import Worlds, uploaded
from petmjx.world.job import Job

Table = TypeVar("Table", State, Worlds)

_put, _take = jax.jit(put_rows), jax.jit(take_rows)


def put_from(table: Table, first_row: int, count: int, values: Table) -> Table:
    """A table of a group in which the rows from this one on are the first ``count`` of ``values``."""
    length, end = len(jax.tree.leaves(values)[0]), len(jax.tree.leaves(table)[0])
    rows = np.full(length, end, np.int32)  # beyond the end: they are dropped
    rows[:count] = first_row + np.arange(count)
    put: Table = _put(table, uploaded(rows), values)
    return put


@dataclass(eq=False)
class Left:
    """Worlds of a group that have not ended.

    Attributes:
        jobs: of these worlds.
        numbers: of their rows in the group, and later those of the jobs in the run.
        table: their states, a row each; rows beyond them are of no world.
    """

    jobs: list[Job]
    numbers: list[int]
    table: State

    @classmethod
    def of(cls, rows: NDArray[np.int64], jobs: Sequence[Job], table: State, most: int) -> Left:
        """Some rows of a table.

        Args:
            most: rows of the new table, at least as many; the same in all groups, so that it is compiled once.
        """
        padded = np.resize(rows, most).astype(np.int32)
        return cls([jobs[row] for row in rows.tolist()], rows.tolist(), _take(table, uploaded(padded)))

    def put_into(self, table: State, first_row: int) -> State:
        """A table in which these worlds have the rows from this one on, with their states. Where it has other columns
        they begin anew, with the same results."""
        columns, before = ([values.shape[1:] for values in jax.tree.leaves(each)] for each in (table, self.table))
        if columns != before:
            return table
        return put_from(table, first_row, len(self.jobs), self.table)


@dataclass
class Handover:
    """What a group leaves to the next one of a run.

    Attributes:
        most: worlds that it may leave: more than the device has lanes. None by default.
        left: what the last one has left.
    """

    most: int = 0
    left: Left | None = None

    def take(self) -> Left | None:
        """What the last group has left, once."""
        left, self.left = self.left, None
        return left

    def number(self, numbers: Sequence[int]) -> None:
        """Say which jobs of the run have the rows of the last group."""
        if self.left is not None:
            self.left.numbers = [numbers[row] for row in self.left.numbers]
