"""Sorts the parts of a run, written as worlds finished, into the order in which plans were given."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from petmjx.results.plan_order import PlanOrder, is_sorted
from petmjx.results.run_folder import part_name, write_all_hidden
from petmjx.results.run_tables import Parts, open_part

SORTED: Final = ("boxes", "attempts", "worlds")
"""The tables that are sorted. Histories are not sorted: they are large, and readers find them by their worlds
(petmjx.results.run_reader)."""

BYTES_AT_A_TIME: Final = 256 << 20
"""Bytes of a table, as Parquet counts them, that are sorted in memory at a time: 50,000 worlds of 43 boxes. A larger
run is read several times, once for each share of this size."""


@dataclass(frozen=True)
class SortedParts:
    """Sorted parts that are written but not yet renamed to their final paths.

    Attributes:
        hidden: final path → path of the hidden file.
        digests: final path → digest.
    """

    hidden: dict[Path, Path] = field(default_factory=dict)
    digests: dict[Path, str] = field(default_factory=dict)

    def remove(self) -> None:
        """Delete the files that were not renamed."""
        for file in self.hidden.values():
            file.unlink(missing_ok=True)


def sort_parts(
    parts: Parts, given: PlanOrder, first: int, worlds_per_part: int, bytes_at_a_time: int = BYTES_AT_A_TIME
) -> SortedParts | None:
    """Write the parts of a run once more, sorted; None if they are sorted already.

    Args:
        first: number of the first new part.
        worlds_per_part: most worlds in a part.
        bytes_at_a_time: limit of the bytes that are sorted at a time.

    Raises:
        InputError: a part is damaged.
        OSError: a file cannot be written.
    """
    tables = parts.table("worlds", ("plan_id", "variant"))
    keys = np.concatenate([np.empty(0, np.int64), *(given.keys(table) for table in tables)])
    if is_sorted(keys):
        return None
    keys.sort()
    done = SortedParts()
    try:
        for table in SORTED:
            share = _worlds_at_a_time(parts, table, len(keys), worlds_per_part, bytes_at_a_time)
            for low in range(0, len(keys), share):
                rows, ranks = _rows(parts, table, given, keys, low, low + share)
                made = {
                    parts.folder / table / part_name(first + number): part
                    for number, part in _cut(rows, ranks, worlds_per_part)
                    if len(part) or table != "attempts"
                }
                for place, (hidden, digest) in write_all_hidden(made).items():
                    done.hidden[place], done.digests[place] = hidden, digest
    except BaseException:
        done.remove()
        raise
    return done


def _worlds_at_a_time(parts: Parts, table: str, worlds: int, worlds_per_part: int, most: int) -> int:
    """How many worlds are sorted at a time: a multiple of ``worlds_per_part``."""
    size = 0
    for file in parts.files(table):
        with open_part(file) as parquet:
            groups = parquet.metadata.num_row_groups
            size += sum(parquet.metadata.row_group(group).total_byte_size for group in range(groups))
    shares = -(-size // most) or 1
    per_share = -(-worlds // shares)
    return -(-per_share // worlds_per_part) * worlds_per_part


def _rows(
    parts: Parts, table: str, given: PlanOrder, keys: NDArray[np.int64], low: int, high: int
) -> tuple[pa.Table, NDArray[np.int64]]:
    """The rows of the worlds from rank ``low`` to ``high`` in order, and the rank of each row's world."""
    pieces, of = [], []
    for part in parts.table(table):
        ranks = np.searchsorted(keys, given.keys(part))
        chosen = np.flatnonzero((ranks >= low) & (ranks < high))
        pieces.append(part if len(chosen) == len(ranks) else part.take(chosen))
        of.append(ranks[chosen])
    if not pieces:
        return pa.table({}), np.empty(0, np.int64)
    ranks = np.concatenate(of)
    order = np.argsort(ranks, kind="stable")
    return pa.concat_tables(pieces, promote_options="default").take(order), ranks[order]


def _cut(rows: pa.Table, ranks: NDArray[np.int64], worlds_per_part: int) -> Iterator[tuple[int, pa.Table]]:
    """(number, rows) of each part."""
    if not len(ranks):
        return
    numbers = range(int(ranks[0]) // worlds_per_part, int(ranks[-1]) // worlds_per_part + 1)
    for number in numbers:
        start, end = np.searchsorted(ranks, (number * worlds_per_part, (number + 1) * worlds_per_part))
        yield number, rows.slice(start, end - start)
