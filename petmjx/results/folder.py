"""A run's folder while it is written, or what takes its place in memory: ``run.json``, the tables of plans and answers.

Worlds: petmjx.results.writer.
"""

from __future__ import annotations

import contextlib
import tempfile
import weakref
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from petmjx.errors import PetmjxError
from petmjx.plans.plan import Plan
from petmjx.results.counts import WorldCounts
from petmjx.results.info import RunInfo
from petmjx.results.listed import LISTED, Parts
from petmjx.results.manifest import Manifest
from petmjx.results.memory import MemoryTables
from petmjx.results.plain import plain
from petmjx.results.reader import FINISHED, RunResults, load_run
from petmjx.results.run_file import write_run_file
from petmjx.results.tables import Tables


class RunFolder(RunInfo):
    """Keeps a run's tables and ``run.json``.

    Attributes:
        out_dir: the folder.
    """

    def _hold(self, out_dir: str | Path | None, manifest: Manifest | None) -> None:
        """Name the folder; None: tables are held in memory."""
        self._in_memory = out_dir is None
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.out_dir = Path(out_dir or "")
        self._tables: Tables = MemoryTables() if self._in_memory else Tables(self.out_dir)
        self._manifest = manifest

    @property
    @abstractmethod
    def counts(self) -> WorldCounts:
        """Of the worlds that are written."""

    @property
    def parts(self) -> Parts:
        """The files of the tables, as they are now."""
        return self._tables.parts

    @property
    def info(self) -> dict[str, Any]:
        """What ``run.json`` says now, without its digest. Counts are of worlds on disk."""
        return {**self.entries(self.counts), LISTED: self.parts.digests}

    def _write_plans(self) -> bool:
        """Write the table ``plans`` if there is none that says the same; returns whether it did."""
        if self._manifest is None:
            return False
        return self._tables.write_plans(self._manifest.table(self.orders.of_plan if self.orders else None))

    def write_summary(self, answers: pa.Table) -> None:
        """Write a sweep's table ``summary`` (petmjx.results.schema.summary_table). An old one is replaced.

        Raises:
            PetmjxError: the file cannot be written.
        """
        with self._writing():
            self._tables.write_first("summary", answers)

    def results(self, held: Mapping[str, Plan] | None = None) -> RunResults:
        """What was written, after the end.

        Args:
            held: the run's plans by id, if they are in no file.
        """
        if self._in_memory:
            return RunResults(self.parts, plain(self.info), held or {})
        results = load_run(self.out_dir, held)
        if self._temporary is not None:
            weakref.finalize(results, self._temporary.cleanup)
        return results

    @contextlib.contextmanager
    def _unless_temporary(self) -> Iterator[None]:
        """Take away a temporary folder if the run has not come to its end."""
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

    def _write_info(self) -> None:
        if not self._in_memory:
            with self._writing():
                write_run_file(self.info, self.out_dir)
