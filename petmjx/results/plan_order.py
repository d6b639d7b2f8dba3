"""The order in which plans were given, and rows in that order: plan after plan, of each variant after variant."""

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
        plan_ids: all of them; none where the run does not say.
        numbers: which of the plans given each one is, counting those that were skipped.
    """

    plan_ids: Sequence[str]
    numbers: Sequence[int]

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """What the table ``plans`` says.

        Raises:
            InputError: it is damaged.
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
        """(n,) places of plans in the order given; those that it does not have come last."""
        places = pc.index_in(plan_ids, value_set=self._ids)
        return np.asarray(pc.fill_null(places, len(self.plan_ids)), dtype=np.int64)

    def keys(self, table: pa.Table) -> NDArray[np.int64]:
        """(n,) numbers by which worlds are sorted; those of two worlds differ."""
        return self.places(table["plan_id"]) * _MOST_VARIANTS + np.asarray(table["variant"], dtype=np.int64)

    def ordered(self, table: pa.Table) -> pa.Table:
        """The rows in order; rows of one world stay as they are."""
        if not self.plan_ids or not len(table):
            return table
        keys = self.keys(table)
        return table if is_sorted(keys) else table.take(np.argsort(keys, kind="stable"))

    def index(self, plan_ids: pd.Series) -> pd.Index:
        """The numbers of plans, as the index of a frame with a row a plan."""
        number_of = dict(zip(self.plan_ids, self.numbers, strict=True))
        numbers = [number_of.get(plan_id, -1) for plan_id in plan_ids]
        plain = not number_of or numbers == list(range(len(numbers)))
        return pd.RangeIndex(len(plan_ids)) if plain else pd.Index(numbers, dtype="int64")


def is_sorted(keys: NDArray[np.int64]) -> bool:
    """Whether numbers do not fall."""
    return bool((keys[1:] >= keys[:-1]).all())
