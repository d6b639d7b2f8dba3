"""Worlds on their way to a run's tables: those that are gathered for a part, and a part that a thread writes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

import pyarrow as pa

from petmjx.results.counts import WorldCounts
from petmjx.results.parts import Part, Pending, Row
from petmjx.results.shield import shielded
from petmjx.results.tables import Tables

HISTORY_BYTES_PER_PART: Final = 64 << 20
"""Histories of a part, in memory: of about 60 worlds of 43 boxes, a third as many with details."""


class _Beside(NamedTuple):
    """A part that a thread writes, with what was written before it, and the digests of its files to come."""

    pending: Pending
    digests: Future[dict[Path, str]]


class Gathering:
    """Gathers worlds for one part after the other. A thread may write a part while the next one is gathered; it counts
    when it has landed, and is gathered again if it cannot be written. Whoever calls holds a lock.
    """

    def __init__(self) -> None:
        self._pending = Pending(Part(0))
        self._beside: _Beside | None = None
        self._thread = ThreadPoolExecutor(1, "petmjx-part")

    @property
    def counts(self) -> WorldCounts:
        """Of the worlds in parts that count."""
        beside = self._beside
        return (self._pending if beside is None else beside.pending).counts

    @property
    def part(self) -> Part:
        """The one that is gathered."""
        return self._pending.part

    def begin(self, number: int, counts: WorldCounts | None = None) -> None:
        """Gather for the part of this number, with no world so far; none may be on its way.

        Args:
            counts: of the parts that count, if it is known better.
        """
        self._pending = Pending(Part(number), counts or self._pending.counts)

    def add(self, row: Row) -> None:
        """Gather one more world."""
        if not self.part.rows:
            self._pending.since_s = time.monotonic()
        self.part.add(row)

    def is_old(self, seconds: float) -> bool:
        """Whether the first world of the part came so long ago."""
        return bool(self.part.rows) and time.monotonic() - self._pending.since_s >= seconds

    def is_full(self, worlds: int) -> bool:
        """Whether the part has so many worlds, or as large histories as one may have."""
        return len(self.part.rows) >= worlds or self.part.history_bytes >= HISTORY_BYTES_PER_PART

    def write(self, tables: Tables, schemas: Mapping[str, pa.Schema]) -> None:
        """Write the part; none is beside it. Raises ``OSError`` where it cannot be written."""
        tables.write_part(self.part.number, self.part.tables(schemas))
        # one assignment: an interrupt before it writes the same part again
        self._pending = self._pending.following()

    def write_beside(self, tables: Tables, schemas: Mapping[str, pa.Schema]) -> None:
        """Let the thread write the part; none is beside it."""
        with shielded(afterwards=True):
            digests = self._thread.submit(tables.files_of, self.part.number, self.part.tables(schemas))
            self._beside, self._pending = _Beside(self._pending, digests), self._pending.following()

    def land(self, tables: Tables, *, wait: bool) -> bool:
        """Let the part count that the thread has written; whether there was one.

        Args:
            wait: until it is written.

        Raises:
            OSError: it could not be written. Its worlds are gathered again, before those that came since.
        """
        if self._beside is None or not (wait or self._beside.digests.done()):
            return False
        pending, digests = self._beside
        error = digests.exception()  # an interrupt while this waits changes nothing
        with shielded(afterwards=True):
            self._beside = None
            if error is None:
                tables.parts.add(digests.result())
            else:
                for row in self.part.rows:
                    pending.part.add(row)
                self._pending = pending
        if error is not None:
            raise error
        return True

    def close(self) -> None:
        """No part is written beside others any more."""
        self._thread.shutdown()
