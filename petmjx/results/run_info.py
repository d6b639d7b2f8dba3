"""Gathers the entries of ``run.json`` while worlds finish, and knows where the tables are kept."""

from __future__ import annotations

import contextlib
import platform
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from petmjx.common.errors import PetmjxError
from petmjx.plans.order_matching import OrderCheck
from petmjx.plans.plan_set import Skipped
from petmjx.results.memory_tables import MemoryTables
from petmjx.results.order_columns import counts_block, orders_block
from petmjx.results.run_file import write_run_file
from petmjx.results.run_reader import FINISHED
from petmjx.results.run_table_files import Tables
from petmjx.results.run_tables import LISTED, Parts
from petmjx.results.schema import SCHEMA_VERSION, Param
from petmjx.results.world_counts import WorldCounts

RUNNING: Final = "running"
"""The status of a run that has not ended, or that was killed."""


class RunInfo:
    """Gathers the entries of ``run.json``, except the list of files.

    Attributes:
        skipped: plans and files that are not simulated, each with the reason.
        warnings: warnings about the whole run, each once.
        odd_plans: a line for each plan with overlapping, floating or outside boxes.
        timings: seconds by name.
        earlier_s: timings of the resumed run, to which ``timings`` are added.
        head: entries that are known when the run begins.
    """

    def __init__(
        self,
        config: Mapping[str, Any],
        identity: Mapping[str, Any] | None,
        orders: OrderCheck | None,
        params: Sequence[Param],
        versions: Mapping[str, str],
        device: str,
        expected_worlds: int | None,
    ) -> None:
        self.skipped: list[Skipped] = []
        self.warnings: dict[str, None] = {}
        self.odd_plans: list[str] = []
        self.timings: dict[str, float] = {}
        self.earlier_s: dict[str, float] = {}
        self.status = RUNNING
        self.error: str | None = None
        self.orders = orders
        self._started = time.monotonic()
        self.head: dict[str, Any] = {
            "started": now(),
            "resumed": [],
            "config": dict(config),
            **({"identity": identity} if identity else {}),
            "versions": {"python": platform.python_version(), **versions},
            "device": device,
            "expected_worlds": expected_worlds,
            "params": [{"name": p.name, "unit": p.unit, "description": p.description} for p in params],
        }

    def skip(self, skipped: Skipped) -> None:
        """Record a plan or a file that is not simulated, with the reason."""
        self.skipped.append(skipped)

    def warn(self, message: str) -> None:
        """Record a warning about the whole run."""
        self.warnings[message] = None

    def entries(self, counts: WorldCounts) -> dict[str, Any]:
        """The entries as of now.

        Args:
            counts: counts of the written worlds.
        """
        seconds = Counter(self.earlier_s)
        seconds.update({**self.timings, "wall_s": round(time.monotonic() - self._started, 3)})
        return {
            "schema_version": SCHEMA_VERSION,
            "status": self.status,
            **({"error": self.error} if self.error else {}),
            **self.head,
            "updated": now(),
            "counts": {
                **counts.as_json(),
                "skipped_plans": len(self.skipped),
                "odd_plans": len(self.odd_plans),
                **({"orders": counts_block(self.orders)} if self.orders else {}),
            },
            "timings": dict(seconds),
            "skipped": [_as_json(skipped) for skipped in self.skipped],
            "warnings": [*self.warnings, *self.odd_plans],
            **({"orders": orders_block(self.orders)} if self.orders else {}),
        }


class RunFolder(RunInfo):
    """Keeps a run's tables and ``run.json``.

    Attributes:
        out_dir: the folder.
    """

    def _hold(self, out_dir: str | Path | None) -> None:
        """Set the folder; None: tables are kept in memory."""
        self._lock = threading.Lock()  # protects gathered rows, tables and run.json
        self._is_behind = False  # whether run.json could not be written the last time
        self._in_memory = out_dir is None
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.out_dir = Path(out_dir or "")
        self._tables: Tables = MemoryTables() if self._in_memory else Tables(self.out_dir)

    @property
    def parts(self) -> Parts:
        """The files of the tables, as they are now."""
        return self._tables.parts

    @property
    def counts(self) -> WorldCounts:
        """Counts of the written worlds."""
        raise NotImplementedError

    @property
    def info(self) -> dict[str, Any]:
        """The entries of ``run.json`` as of now, without the digest. Counts are of worlds on disk."""
        return {**self.entries(self.counts), LISTED: self.parts.digests}

    def _write_info(self) -> None:
        if not self._in_memory:
            self._is_behind = True
            with self._writing():
                write_run_file(self.info, self.out_dir)
            self._is_behind = False

    def write_summary(self, answers: pa.Table) -> None:
        """Write a sweep's table ``summary`` (petmjx.results.schema.summary_table). An old one is replaced.

        Raises:
            PetmjxError: the file cannot be written.
        """
        with self._lock, self._writing():
            self._tables.write_first("summary", answers)

    @contextlib.contextmanager
    def _unless_temporary(self) -> Iterator[None]:
        """Delete a temporary folder if the run did not finish."""
        try:
            yield
        finally:
            if self._temporary is not None and self.status != FINISHED:
                self._temporary.cleanup()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise PetmjxError(f"{self.out_dir}: cannot write results: {error.strerror or error}") from error


def _as_json(skipped: Skipped) -> dict[str, Any]:
    entry = {"plan_id": skipped.plan_id or "", "source": skipped.source, "error": skipped.message}
    return entry if skipped.number is None else {**entry, "number": skipped.number}


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
