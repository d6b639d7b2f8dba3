"""The worlds that a run's folder already has, for a run that goes on with it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Final

import numpy as np
import pyarrow as pa

from petmjx.basics.errors import InputError
from petmjx.results.counts import COUNTED, WorldCounts
from petmjx.results.listed import Parts

_COLUMNS: Final = ("plan_id", "variant", *COUNTED, "culprit", "n_steps")


class Recorded:
    """Which worlds there are, and what their rows in the table ``worlds`` say.

    Args:
        parts: of a run; None: there is no world.
        columns: of ``worlds``, beside those that every run has.

    Raises:
        InputError: a part is damaged or missing, or has a world that another one has too.
    """

    def __init__(self, parts: Parts | None = None, columns: Sequence[str] = ()) -> None:
        for boxes in parts.files("boxes") if parts is not None else ():
            if not boxes.is_file():
                raise InputError(f"{boxes}: missing, though the worlds of this part are there")
        tables = parts.table("worlds", [*_COLUMNS, *columns]) if parts is not None else []
        self._table = pa.concat_tables(tables) if tables else None
        self._spans: dict[str, tuple[int, int]] = {}
        self._last: tuple[str | None, dict[int, int]] = None, {}
        self._sorted = self._variants = np.empty(0, np.int64)
        if self._table is not None:
            self._index(self._table, parts)

    def _index(self, table: pa.Table, parts: Parts | None) -> None:
        """Sort the rows by plan and variant: some bytes a world, where a dictionary of all would take hundreds."""
        plans = table["plan_id"].combine_chunks().dictionary_encode()
        plan = np.asarray(plans.indices, dtype=np.int64)
        variant = np.asarray(table["variant"], dtype=np.int64)
        self._sorted = np.lexsort((variant, plan))
        self._variants, plan = variant[self._sorted], plan[self._sorted]
        ids = plans.dictionary.to_pylist()
        twice = np.flatnonzero((plan[1:] == plan[:-1]) & (self._variants[1:] == self._variants[:-1]))
        if len(twice):
            plan_id, number = ids[plan[twice[0]]], self._variants[twice[0]]
            raise InputError(f"{parts and parts.folder}: has plan {plan_id}, variant {number} more than once")
        ends = np.searchsorted(plan, np.arange(len(ids) + 1)).tolist()
        self._spans = dict(zip(ids, itertools.pairwise(ends), strict=True))

    def __len__(self) -> int:
        return self._table.num_rows if self._table is not None else 0

    def __contains__(self, world: tuple[str, int]) -> bool:
        plan_id, variant = world
        return variant in self._rows_of(plan_id)

    def n_of(self, plan_id: str) -> int:
        """How many worlds of a plan there are."""
        first, end = self._spans.get(plan_id, (0, 0))
        return end - first

    def _rows_of(self, plan_id: str) -> dict[int, int]:
        """Variant → row of a plan's worlds. Runs ask plan by plan, so that of the last one is kept."""
        if self._last[0] != plan_id:
            span = slice(*self._spans.get(plan_id, (0, 0)))
            rows = dict(zip(self._variants[span].tolist(), self._sorted[span].tolist(), strict=True))
            self._last = plan_id, rows
        return self._last[1]

    def row(self, plan_id: str, variant: int) -> dict[str, Any] | None:
        """Column → value of one world, null as None; None where it is not recorded."""
        row = self._rows_of(plan_id).get(variant)
        return None if row is None else {name: values[row] for name, values in self._values.items()}

    def counts(self) -> WorldCounts:
        """How many worlds came to what."""
        counts = WorldCounts()
        if self._table is not None:
            counts.add_worlds(self._table)
        return counts

    def _column(self, name: str) -> list[Any]:
        values: list[Any] = self._table.column(name).to_pylist() if self._table is not None else []
        return values

    @cached_property
    def _values(self) -> dict[str, list[Any]]:
        return {name: self._column(name) for name in self._table.column_names} if self._table is not None else {}
