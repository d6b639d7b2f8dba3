"""Writes and deletes the table files of a run in progress, and keeps the list of files that count."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa

from petmjx.common.errors import InputError
from petmjx.results.row_order import SORTED, SortedParts
from petmjx.results.run_folder import (
    OF_WORLDS,
    appear,
    copy_file,
    drop_parts,
    part_name,
    part_number,
    write_hidden,
    write_table,
)
from petmjx.results.run_tables import Parts


class Tables:
    """A run's tables on disk. All methods raise ``OSError`` where a file cannot be written.

    New files have new numbers, so that old and new files exist side by side until ``run.json`` lists the new ones. A
    killed run is then either in the old or in the new state.

    Attributes:
        parts: the files that count.
    """

    def __init__(self, folder: Path, parts: Parts | None = None) -> None:
        self._folder = folder
        self._placements: Future[tuple[Path, str] | None] | None = None
        self._content: Callable[[], pa.Table | None] = lambda: None  # makes the table placements
        self.parts = parts or Parts(folder, {})

    def write_plans(self, plans: pa.Table, placements: Callable[[], pa.Table | None] = lambda: None) -> bool:
        """Write the table ``plans`` unless an equal one exists; returns whether it was written. A table with other
        content is not overwritten.

        A thread writes ``placements`` if it is missing, while the first worlds are simulated. That table counts once it
        has landed.
        """
        if self._placements is None and not self.parts.files("placements"):
            self._content = placements
            self._begin_placements()
        if [plans] == self.parts.table("plans"):
            return False
        number = self.parts.next_number("plans")
        self.parts = self.parts.without("plans")
        self.write_part(number, [("plans", plans)])
        return True

    def _begin_placements(self) -> None:
        thread = ThreadPoolExecutor(1, "petmjx-plans")
        self._placements = thread.submit(self._write_placements)
        thread.shutdown(wait=False)

    def _write_placements(self) -> tuple[Path, str] | None:
        content = self._content()
        return None if content is None else write_hidden(content, self._folder / "placements" / part_name(0))

    def land_placements(self, *, wait: bool) -> bool:
        """Let the table that the thread has written count; returns whether one landed. With ``wait`` it waits until the
        thread has ended.

        After an error the thread begins again, and the next call may let the table count.
        """
        if self._placements is None or not (wait or self._placements.done()):
            return False
        self._placements.exception()  # an interrupt here changes nothing
        try:
            written = self._placements.result()
            if written is not None:
                hidden, digest = written
                place = self._folder / "placements" / part_name(0)
                appear({place: hidden})
                self.parts.add({place: digest})
        except Exception:
            self.drop_placements()
            self._begin_placements()
            raise
        self._placements = None
        return written is not None

    def drop_placements(self) -> None:
        """Wait for the thread, and delete its file if it does not count."""
        if self._placements is not None:
            with contextlib.suppress(Exception):
                if (written := self._placements.result()) is not None:
                    written[0].unlink(missing_ok=True)
            self._placements = None

    def write_part(self, number: int, tables: Iterable[tuple[str, pa.Table]]) -> None:
        """Write the tables of a part, by name. No file counts before all are written."""
        self.parts.add(self.files_of(number, tables))

    def files_of(self, number: int, tables: Iterable[tuple[str, pa.Table]]) -> dict[Path, str]:
        """As :meth:`write_part`, but no file counts. Returns the digest of each file."""
        digests: dict[Path, str] = {}
        for table, content in tables:
            place = self._folder / table / part_name(number)
            digests[place] = write_table(content, place)
        return digests

    def forget(self, numbers: Collection[int]) -> None:
        """Let the parts of worlds with these numbers no longer count, since other parts have replaced them.
        :meth:`drop_others` deletes the files."""
        self.parts = self.parts.without_numbers(numbers)

    def write_first(self, table: str, content: pa.Table) -> None:
        """Write the only part of a table. It replaces an existing one."""
        self.write_part(0, [(table, content)])

    def copies_of(self, others: Parts) -> dict[Path, str]:
        """Copy the worlds of another run. The copies do not count yet. Returns the digest of each file.

        Raises:
            InputError: a file of the other run is damaged or missing.
        """
        first = self.parts.next_number(*OF_WORLDS)
        others.check_tables(OF_WORLDS)
        digests: dict[Path, str] = {}
        for file in (file for table in OF_WORLDS for file in others.files(table)):
            place = self._folder / file.parent.name / part_name(first + part_number(file))
            try:
                digests[place] = copy_file(file, place)
            except FileNotFoundError:
                raise InputError(f"{file}: missing, though the worlds of this part are there") from None
        return digests

    def replace(self, done: SortedParts) -> None:
        """Let sorted parts replace the present ones, whose files stay until :meth:`drop_others`."""
        try:
            appear(done.hidden)
        except OSError:
            done.remove()
            raise
        self.parts = self.parts.without(*SORTED)
        self.parts.add(done.digests)

    def drop_others(self) -> None:
        """Delete the parts that do not count."""
        drop_parts(self._folder, self.parts.files)
