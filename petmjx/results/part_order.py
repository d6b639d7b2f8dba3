"""Buffers worlds by destination part, so that a large run is written in plan order without a final sort.

Smaller runs write parts as worlds finish and sort them at the end (petmjx.results.row_order). A run of a million worlds
would have to be written twice for that. Engines get worlds in the order given, about ten thousand at a time. So all
worlds of a part finish within a short time, and they wait in memory until the part is complete. If that takes too long,
the finished worlds of the part are written early. They are written once more together with the rest of the part.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from petmjx.results.part_buffer import Part, Row
from petmjx.results.run_folder import part_number
from petmjx.results.run_table_files import Tables
from petmjx.results.run_tables import Parts
from petmjx.results.world_counts import WorldCounts

LARGE: Final = 50_000
"""Runs with more worlds than this write their parts in order from the beginning."""

LARGE_PART: Final = 10_000
"""Worlds in a part of a large run: 1 MB of ``worlds``, and 30 MB of ``boxes`` at 43 boxes a world. A million worlds are
100 parts."""

MOST_WAITING_BYTES: Final = 512 << 20
"""Largest memory of waiting tables: 130,000 worlds of 43 boxes."""

PIECE_WORLDS: Final = 500
"""When this number of rows of a part waits, they become a piece: tables, which take a tenth of the memory if ``boxes``
is not kept."""


@dataclass(frozen=True)
class Places:
    """The rank of each world in a run whose plans all have the same variants.

    Attributes:
        plan_ids: ids of the plans of this run, in the order given.
        n_variants: variants of each plan, numbered without a gap.
        first: number of the first variant.
        per_part: worlds in a part.
    """

    plan_ids: Sequence[str]
    n_variants: int
    first: int
    per_part: int = LARGE_PART
    _place: dict[str, int] = field(init=False, default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self._place.update({plan_id: at for at, plan_id in enumerate(self.plan_ids)})

    @property
    def n_worlds(self) -> int:
        return len(self.plan_ids) * self.n_variants

    @property
    def n_parts(self) -> int:
        return -(-self.n_worlds // self.per_part)

    def rank(self, plan_id: str, variant: int) -> int:
        """The place of a world among all worlds, from 0."""
        return self._place[plan_id] * self.n_variants + variant - self.first

    def size(self, number: int) -> int:
        """Number of worlds in a part."""
        return min(self.per_part, self.n_worlds - number * self.per_part)

    def ranks(self, table: pa.Table) -> NDArray[np.int64] | None:
        """(n,) rank of each row's world; None if a row belongs to a world that the run does not have."""
        plans = table["plan_id"].combine_chunks().dictionary_encode()
        place = np.array([self._place.get(plan_id, -1) for plan_id in plans.dictionary.to_pylist()], dtype=np.int64)
        of_plan = place[np.asarray(plans.indices)]
        variant = np.asarray(table["variant"], dtype=np.int64) - self.first
        if (of_plan < 0).any() or (variant < 0).any() or (variant >= self.n_variants).any():
            return None
        ranks: NDArray[np.int64] = of_plan * self.n_variants + variant
        return ranks


@dataclass
class _DestinationPart:
    """A part that is not complete yet: its worlds in memory, and the numbers of parts that hold its early worlds.

    Attributes:
        pieces: tables by name, of the worlds that came before ``rows``.
        n_pieces: number of worlds in ``pieces``.
        nbytes: memory of ``pieces`` and of the metrics of ``rows``.
        since_s: arrival of the first world in memory (monotonic clock).
        early: numbers of the parts that were written early.
        n_early: number of worlds in these parts.
    """

    rows: list[Row] = field(default_factory=list)
    pieces: list[dict[str, pa.Table]] = field(default_factory=list)
    n_pieces: int = 0
    nbytes: int = 0
    since_s: float = 0.0
    early: list[int] = field(default_factory=list)
    n_early: int = 0

    @property
    def count(self) -> int:
        """Worlds in memory."""
        return self.n_pieces + len(self.rows)

    def add(self, row: Row) -> None:
        """Add one world."""
        if not self.count:
            self.since_s = time.monotonic()
        self.rows.append(row)
        self.nbytes += row.block.nbytes

    def make_piece(self, schemas: Mapping[str, pa.Schema]) -> None:
        """Turn the rows into a piece."""
        if self.rows:
            piece = dict(Part(0, self.rows).tables(schemas))
            self.nbytes += sum(table.nbytes for table in piece.values()) - sum(row.block.nbytes for row in self.rows)
            # one assignment: an interrupt before it leaves the rows, an interrupt after it leaves the piece
            self.rows, self.pieces, self.n_pieces = [], [*self.pieces, piece], self.n_pieces + len(self.rows)

    def written_early(self, number: int) -> None:
        """Note that the worlds in memory were written early, in the part with this number."""
        self.early.append(number)
        self.n_early += self.count
        self.rows, self.pieces, self.n_pieces, self.nbytes = [], [], 0, 0


class DestinationBuffer:
    """Gathers worlds by destination part and writes the parts.

    Args:
        places: gives the rank of each world.
        schemas: schemas of the tables.

    Attributes:
        counts: counts of the written worlds.
    """

    def __init__(self, places: Places, schemas: Mapping[str, pa.Schema]) -> None:
        self._places, self._schemas = places, schemas
        self._waiting: dict[int, _DestinationPart] = {}
        self._next_early = places.n_parts
        self._nbytes = 0  # of all waiting parts: adding this up for every world would be slow
        self.counts = WorldCounts()

    def goes_on(self, parts: Parts, counts: WorldCounts) -> bool:
        """Resume from existing parts. False if these are in another order or of other sizes."""
        self.counts = counts
        for file in parts.files("worlds"):
            number, ranks = part_number(file), self._places.ranks(parts.read(file, ("plan_id", "variant")))
            if ranks is None or not len(ranks):
                return False
            home = int(ranks[0]) // self._places.per_part
            if (ranks // self._places.per_part != home).any():
                return False
            if number < self._places.n_parts:
                if number != home or len(ranks) < self._places.size(home) or (np.diff(ranks) <= 0).any():
                    return False
                continue
            waiting = self._waiting.setdefault(home, _DestinationPart())
            waiting.early.append(number)
            waiting.n_early += len(ranks)
            self._next_early = max(self._next_early, number + 1)
        return True

    def add(self, row: Row) -> list[int]:
        """Add one world; returns the parts to write now: its part if that is complete, all parts if they take too much
        memory."""
        number = self._places.rank(row.plan.plan_id, row.cells["variant"]) // self._places.per_part
        waiting = self._waiting.setdefault(number, _DestinationPart())
        before = waiting.nbytes
        waiting.add(row)
        if len(waiting.rows) == PIECE_WORLDS:
            waiting.make_piece(self._schemas)
        self._nbytes += waiting.nbytes - before
        if self._nbytes > MOST_WAITING_BYTES:
            return self.left()
        return [number] if self._whole(number) else []

    def late(self, seconds: float) -> list[int]:
        """Parts with a world that has waited longer than ``seconds``."""
        now = time.monotonic()
        return [n for n, waiting in self._waiting.items() if waiting.count and now - waiting.since_s >= seconds]

    def due_s(self, seconds: float) -> float | None:
        """Time until :meth:`late` names a part, s; None: no world waits."""
        since = min((waiting.since_s for waiting in self._waiting.values() if waiting.count), default=None)
        return None if since is None else max(since + seconds - time.monotonic(), 0.0)

    def left(self, early: bool = False) -> list[int]:
        """Parts with waiting worlds. With ``early`` also parts whose worlds were all written early, in several
        parts."""
        return [n for n, waiting in self._waiting.items() if waiting.count or (early and self._whole(n))]

    def write(self, number: int, tables: Tables) -> bool:
        """Write the worlds of a part that have come. Returns whether parts that were written early became obsolete.
        Raises OSError."""
        tables.land_placements(wait=False)
        waiting, is_complete = self._waiting[number], self._whole(number)
        before = waiting.nbytes
        waiting.make_piece(self._schemas)
        self._nbytes += waiting.nbytes - before
        early = waiting.early if is_complete else []
        tables.write_part(
            number if is_complete else self._next_early, self._joined(tables.parts, early, waiting.pieces)
        )
        tables.forget(early)
        for piece in waiting.pieces:
            self.counts.add_worlds(piece["worlds"])
        self._nbytes -= waiting.nbytes
        if is_complete:
            del self._waiting[number]
        else:
            waiting.written_early(self._next_early)
            self._next_early += 1
        return bool(early)

    def _whole(self, number: int) -> bool:
        waiting = self._waiting[number]
        return waiting.n_early + waiting.count == self._places.size(number)

    def _joined(
        self, parts: Parts, early: Sequence[int], pieces: Sequence[Mapping[str, pa.Table]]
    ) -> Iterator[tuple[str, pa.Table]]:
        """The tables of a part in order, joined from early parts and from pieces; ``worlds`` comes last."""
        for name in ("boxes", "attempts", "worlds"):
            tables = [parts.read(file) for file in parts.numbered(name, early)]
            tables += [piece[name] for piece in pieces if name in piece]
            if tables:
                table = pa.concat_tables(tables)
                ranks = self._places.ranks(table)
                assert ranks is not None
                yield name, table.take(np.argsort(ranks, kind="stable"))
