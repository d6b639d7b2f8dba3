"""Worlds of a large run by the part that they come to in the end, so that no part is written twice.

Smaller runs write parts as worlds finish, and sort them in the end (petmjx.results.row_order). Of a million worlds that
would be to write the run again. Engines get worlds in the order given, some ten thousand at a time, so that all worlds
of a part finish within a short time of each other: they wait for each other in memory. Where that takes too long, what
is there of a part is written early, and once more with the rest of it.
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
from petmjx.results.run_tables import Parts
from petmjx.results.table_files import Tables
from petmjx.results.world_counts import WorldCounts

LARGE: Final = 50_000
"""Runs of more worlds have their parts in order from the beginning."""

LARGE_PART: Final = 10_000
"""Worlds of such a part: of ``worlds`` a megabyte, of ``boxes`` with 43 a world 30. A million worlds are 100 parts."""

MOST_WAITING_BYTES: Final = 512 << 20
"""Of tables that wait in memory: 130,000 worlds of 43 boxes."""

PIECE_WORLDS: Final = 500
"""Worlds of a part whose rows become a piece of its tables: without ``boxes`` it takes a tenth of the memory."""


@dataclass(frozen=True)
class Places:
    """The place of each world in a run whose plans all have the same variants.

    Attributes:
        plan_ids: of the run's own plans, in the order given.
        n_variants: of each plan; they are numbered without a gap.
        first: the number of the first one.
        per_part: worlds of a part.
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
        """Which of all worlds it is, from 0."""
        return self._place[plan_id] * self.n_variants + variant - self.first

    def size(self, number: int) -> int:
        """Worlds of a part."""
        return min(self.per_part, self.n_worlds - number * self.per_part)

    def ranks(self, table: pa.Table) -> NDArray[np.int64] | None:
        """(n,) of each row's world; None where a row is of a world that the run does not have."""
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
    """The worlds of a part that are in memory, and where the others are.

    Attributes:
        pieces: tables of the worlds that came before ``rows``, by name.
        n_pieces: their worlds.
        nbytes: of pieces, and of the metrics of rows.
        since_s: when the first of them came (monotonic clock).
        early: numbers of parts that were written too early.
        n_early: their worlds.
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
        """One world more."""
        if not self.count:
            self.since_s = time.monotonic()
        self.rows.append(row)
        self.nbytes += row.block.nbytes

    def make_piece(self, schemas: Mapping[str, pa.Schema]) -> None:
        """Of the rows, if there are any."""
        if self.rows:
            piece = dict(Part(0, self.rows).tables(schemas))
            self.nbytes += sum(table.nbytes for table in piece.values()) - sum(row.block.nbytes for row in self.rows)
            # one assignment: an interrupt before it keeps the rows, one after it the piece
            self.rows, self.pieces, self.n_pieces = [], [*self.pieces, piece], self.n_pieces + len(self.rows)

    def written_early(self, number: int) -> None:
        """What is in memory is in a part with this number now."""
        self.early.append(number)
        self.n_early += self.count
        self.rows, self.pieces, self.n_pieces, self.nbytes = [], [], 0, 0


class DestinationBuffer:
    """Gathers worlds by part, and writes them.

    Args:
        schemas: of their tables.

    Attributes:
        counts: of worlds that are written.
    """

    def __init__(self, places: Places, schemas: Mapping[str, pa.Schema]) -> None:
        self._places, self._schemas = places, schemas
        self._waiting: dict[int, _DestinationPart] = {}
        self._next_early = places.n_parts
        self._nbytes = 0  # of all that waits; to add it up for each world takes longer than to keep the world
        self.counts = WorldCounts()

    def goes_on(self, parts: Parts, counts: WorldCounts) -> bool:
        """Take up parts that are there; False where they are in another order, or of other sizes."""
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
        """Keep one more world; returns the parts to write now: its own if that is whole, all if they take too much
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
        """Parts of which a world waits for longer than this."""
        now = time.monotonic()
        return [n for n, waiting in self._waiting.items() if waiting.count and now - waiting.since_s >= seconds]

    def due_s(self, seconds: float) -> float | None:
        """In which time :meth:`late` will name a part; None: no world waits."""
        since = min((waiting.since_s for waiting in self._waiting.values() if waiting.count), default=None)
        return None if since is None else max(since + seconds - time.monotonic(), 0.0)

    def left(self, early: bool = False) -> list[int]:
        """Parts of which worlds wait; ``early``: also those that were written in pieces and are whole."""
        return [n for n, waiting in self._waiting.items() if waiting.count or (early and self._whole(n))]

    def write(self, number: int, tables: Tables) -> bool:
        """Write what there is of a part; returns whether parts that were written early are of no more use. Raises
        OSError."""
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
        """The tables of a part, in order, from what was written early and from pieces; ``worlds`` comes last."""
        for name in ("boxes", "attempts", "worlds"):
            tables = [parts.read(file) for file in parts.numbered(name, early)]
            tables += [piece[name] for piece in pieces if name in piece]
            if tables:
                table = pa.concat_tables(tables)
                ranks = self._places.ranks(table)
                assert ranks is not None
                yield name, table.take(np.argsort(ranks, kind="stable"))
