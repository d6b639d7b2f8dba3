"""The order of a run's worlds: by plan in the order of the input, then by variant.

Worlds end in any order, and the row of a world is written when the world ends. So each row has a column ``rank``, the
position of its world in the order of the run, and readers sort rows by this column. Runs of petmjx before 0.3 have no
ranks; their rows are sorted by the order of the table ``plans``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from petmjx.results.schema import RANK, RANK_COLUMN, data_frame, schemas
from petmjx.results.table_parts import Parts

if TYPE_CHECKING:
    import pandas as pd

MOST_VARIANTS: Final = 1 << 32
"""Number of ranks that a plan reserves if the numbers of its variants are unknown."""


class WorldRanks:
    """Computes the rank of each world: its position in the order of the run. If all plans of a whole run have the same
    variants, ranks are 0, 1, 2, … without gaps. In a search, ranks have gaps, since each plan reserves ranks for the
    largest possible number of variants.

    Args:
        plan_ids: ids of all plans in the order of the input, including the plans of other shards. Plans that
            ``plan_ids`` lacks come last, in the order in which they first get a rank.
        variants: numbers of the variants of each plan, or None if they are unknown, as in a search.
    """

    def __init__(self, plan_ids: Iterable[str] = (), variants: range | None = None) -> None:
        self._places = {plan_id: place for place, plan_id in enumerate(plan_ids)}
        self._variants = variants or range(MOST_VARIANTS)

    def rank(self, plan_id: str, variant: int) -> int:
        """The rank of one world. The first rank of a plan that ``plan_ids`` lacks gives the plan a place in the
        order."""
        place = self._places.setdefault(plan_id, len(self._places))
        return place * len(self._variants) + variant - self._variants.start

    def ranks(self, table: pa.Table) -> NDArray[np.int64]:
        """(n,) the rank of the world of each row."""
        plans = table["plan_id"].combine_chunks().dictionary_encode()
        first = np.array([self.rank(plan_id, 0) for plan_id in plans.dictionary.to_pylist()], dtype=np.int64)
        ranks: NDArray[np.int64] = first[np.asarray(plans.indices)] + np.asarray(table["variant"], dtype=np.int64)
        return ranks

    def ranked(self, table: pa.Table) -> pa.Table:
        """The rows of a table with a column of ranks, sorted by rank. Rows of the same world keep their order."""
        ranks = self.ranks(table)
        place = table.schema.get_field_index(RANK)
        if place >= 0:
            table = table.remove_column(place)
        table = table.add_column(table.schema.get_field_index("variant") + 1, RANK_COLUMN, pa.array(ranks))
        return _sorted_by(ranks, table)


def is_ranked(parts: Parts, plan_ids: Sequence[str]) -> bool:
    """Whether the rows of a run have ranks that match this order of plans. Either all tables of a run have ranks, or no
    table has ranks."""
    ranked = all(RANK in parts.columns(file) for file in parts.files("worlds"))
    return ranked and PlanOrder.of(parts).plan_ids == plan_ids


def frame_in_order(parts: Parts, table: str, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """The rows of a table as a data frame, sorted by the order of the run's worlds. Rows of the same world keep their
    order. A table without a file has no rows.

    Args:
        columns: names of the columns to read, which must include ``plan_id`` and ``variant``. If ``columns`` is None,
            all columns are read.

    Raises:
        InputError: a part is damaged or missing.
    """
    files = parts.files(table)
    if not files:
        return data_frame(schemas()[table].empty_table())
    if not all(RANK in parts.columns(file) for file in files):
        return data_frame(PlanOrder.of(parts).ordered(_joined(parts.table(table, columns))))
    rows = _joined(parts.table(table, None if columns is None else [*dict.fromkeys((*columns, RANK))]))
    return data_frame(_sorted_by(np.asarray(rows[RANK]), rows))


def _joined(tables: Sequence[pa.Table]) -> pa.Table:
    return pa.concat_tables(tables, promote_options="default")


@dataclass(frozen=True, eq=False)
class PlanOrder:
    """The plans of a run, in the order of the input.

    Attributes:
        plan_ids: ids of all plans; empty if they are unknown.
        numbers: position of each plan in the input, where skipped plans also have a position.
    """

    plan_ids: Sequence[str]
    numbers: Sequence[int]

    @classmethod
    def of(cls, parts: Parts) -> Self:
        """Read the order from the table ``plans``.

        Raises:
            InputError: the table is damaged.
        """
        plan_ids: list[str] = []
        numbers: list[int | None] = []
        for part in parts.table("plans", ("plan_id", "number")):
            plan_ids += part["plan_id"].to_pylist()
            numbers += part["number"].to_pylist()
        return cls(plan_ids, [at if number is None else number for at, number in enumerate(numbers)])

    def ordered(self, table: pa.Table) -> pa.Table:
        """The rows of the table, sorted by the order of the run's worlds. Rows of the same world keep their order, and
        rows of plans that the input lacks come last."""
        if not self.plan_ids or not len(table):
            return table
        places = pc.index_in(table["plan_id"], value_set=pa.array(self.plan_ids, pa.string()))
        places = np.asarray(pc.fill_null(places, len(self.plan_ids)), dtype=np.int64)
        return _sorted_by(places * MOST_VARIANTS + np.asarray(table["variant"], dtype=np.int64), table)

    def index(self, plan_ids: pd.Series) -> pd.Index:
        """The positions of plans in the input, as the index of a data frame with one row per plan."""
        import pandas as pd  # imported here, so that importing this module does not load pandas

        number_of = dict(zip(self.plan_ids, self.numbers, strict=True))
        numbers = [number_of.get(plan_id, -1) for plan_id in plan_ids]
        plain = not number_of or numbers == list(range(len(numbers)))
        return pd.RangeIndex(len(plan_ids)) if plain else pd.Index(numbers, dtype="int64")


def _sorted_by(keys: NDArray[np.int64], table: pa.Table) -> pa.Table:
    """The rows of a table, sorted by ``keys``, a number for each row. Rows with the same number keep their order."""
    is_sorted = bool((keys[1:] >= keys[:-1]).all())
    return table if is_sorted else table.take(np.argsort(keys, kind="stable"))
