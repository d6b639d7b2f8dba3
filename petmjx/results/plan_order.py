"""The order in which plans were given, and sorting of rows by it: by plan, then by variant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from petmjx.results.run_tables import Parts

_MOST_VARIANTS: Final = 1 << 32


@dataclass(frozen=True, eq=False)
class PlanOrder:
    """The plans of a run in the order in which they were given.

    Attributes:
        plan_ids: ids of all plans; empty if the run does not say.
        numbers: place of each plan among the plans given, counting skipped plans.
    """

    plan_ids: Sequence[str]
    numbers: Sequence[int]

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """The order in the table ``plans``.

        Raises:
            InputError: the table is damaged.
        """
        plan_ids: list[str] = []
        numbers: list[int | None] = []
        for part in parts.table("plans", ("plan_id", "number")):
            plan_ids += part["plan_id"].to_pylist()
            numbers += part["number"].to_pylist()
        return cls(plan_ids, [at if number is None else number for at, number in enumerate(numbers)])

    @cached_property
    def _ids(self) -> pa.Array:
        return pa.array(self.plan_ids, pa.string())

    def places(self, plan_ids: pa.ChunkedArray) -> NDArray[np.int64]:
        """(n,) places of plans in the order given; unknown plans come last."""
        places = pc.index_in(plan_ids, value_set=self._ids)
        return np.asarray(pc.fill_null(places, len(self.plan_ids)), dtype=np.int64)

    def keys(self, table: pa.Table) -> NDArray[np.int64]:
        """(n,) sort keys of worlds. Different worlds have different keys."""
        return self.places(table["plan_id"]) * _MOST_VARIANTS + np.asarray(table["variant"], dtype=np.int64)

    def ordered(self, table: pa.Table) -> pa.Table:
        """The rows in order. The rows of one world keep their order."""
        if not self.plan_ids or not len(table):
            return table
        keys = self.keys(table)
        return table if is_sorted(keys) else table.take(np.argsort(keys, kind="stable"))

    def index(self, plan_ids: pd.Series) -> pd.Index:
        """The numbers of plans, as the index of a frame with one row per plan."""
        number_of = dict(zip(self.plan_ids, self.numbers, strict=True))
        numbers = [number_of.get(plan_id, -1) for plan_id in plan_ids]
        plain = not number_of or numbers == list(range(len(numbers)))
        return pd.RangeIndex(len(plan_ids)) if plain else pd.Index(numbers, dtype="int64")


def is_sorted(keys: NDArray[np.int64]) -> bool:
    """Whether the numbers never decrease."""
    return bool((keys[1:] >= keys[:-1]).all())
