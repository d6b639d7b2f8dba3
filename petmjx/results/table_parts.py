"""Writes and deletes the table files of a run in progress, and keeps the list of the files that belong to the run.

If a run has no folder, its tables stay in memory as long as each table is small enough for a single file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from petmjx.common.errors import InputError
from petmjx.results.result_files import copy_file, write_table
from petmjx.results.run_folder import OF_WORLDS, delete_others, part_name, part_number
from petmjx.results.run_table_reader import Parts, check_columns
from petmjx.results.world_ranks import WorldRanks


class Tables:
    """The tables of a run, on disk or in memory (``MemoryParts``). All methods raise ``OSError`` if a file cannot be
    written.

    New files get new numbers, so old and new files exist side by side until ``run.json`` lists the new files. If the
    run is killed, its folder therefore has either the old or the new state.

    Attributes:
        parts: the files that belong to the run.
    """

    def __init__(self, folder: Path, parts: Parts | None = None) -> None:
        self._folder = folder
        self.parts = parts or Parts(folder, {})

    def write(self, table: str, number: int, content: pa.Table) -> dict[Path, str]:
        """Write a table, or a part of it, as a new file. Returns file → digest. The file belongs to the run only after
        a call of ``add``. If the tables are in memory, the table is kept there, and the result is empty."""
        path = self._folder / table / part_name(number)
        if isinstance(self.parts, MemoryParts):
            self.parts.tables[path] = content
            return {}
        return {path: write_table(content, path)}

    def add(self, digests: Mapping[Path, str]) -> None:
        """Add written files to the run. ``digests``: file → digest."""
        self.parts = self.parts.plus(digests)

    def replace_worlds(self, digests: Mapping[Path, str]) -> None:
        """Put the files ``digests`` in place of all files of ``worlds``, ``boxes`` and the other tables whose rows are
        about worlds."""
        self.parts = self.parts.without(*OF_WORLDS).plus(digests)

    def write_only(self, table: str, content: pa.Table) -> None:
        """Write a table that has a single file. The earlier file of this table then no longer belongs to the run."""
        digests = self.write(table, self.parts.next_number(table), content)
        self.parts = self.parts.without(table).plus(digests)

    def copies(self, others: Parts, ranks: WorldRanks | None) -> Iterator[tuple[Path, str]]:
        """Copy the tables that have rows about worlds, of this run or of another run. Each file is copied to a file
        with an unused number. Yields each copy with its digest. The copies belong to the run only after ``add`` or
        ``replace_worlds``.

        Args:
            ranks: new ranks for the rows. If ``ranks`` is None, the rows keep their ranks, and the files are copied
                byte by byte.

        Raises:
            InputError: a file that is to be copied is damaged or missing.
        """
        first = self.parts.next_number(*OF_WORLDS)
        others.check_tables(OF_WORLDS)
        for table in OF_WORLDS:
            for file in others.files(table):
                number = first + part_number(file)
                if ranks is not None:
                    yield from self.write(table, number, ranks.ranked(others.read(file))).items()
                    continue
                path = self._folder / table / part_name(number)
                try:
                    yield path, copy_file(file, path)
                except FileNotFoundError:
                    raise InputError(
                        f"{file}: missing, although the table `worlds` has a file with the same number"
                    ) from None

    def delete_others(self) -> None:
        """Delete all parts and temporary files that are in the folder but do not belong to the run."""
        delete_others(self._folder, self.parts.files)


@dataclass(frozen=True, eq=False)
class MemoryParts(Parts):
    """The tables of a run that are kept in memory. Each part of a table is stored under the path that its file would
    have in the run's folder."""

    tables: dict[Path, pa.Table] = field(default_factory=dict)

    def files(self, table: str) -> list[Path]:
        """The paths of the parts of a table, in order."""
        return [file for file in self.tables if file.parent.name == table]

    def columns(self, file: Path) -> list[str]:
        """The names of the columns of one part of a table."""
        names: list[str] = self.tables[file].column_names
        return names

    def read(self, file: Path, columns: Sequence[str] | None = None) -> pa.Table:
        """One part of a table, or some of its columns."""
        check_columns(file, self.columns(file), columns)
        return self.tables[file] if columns is None else self.tables[file].select(list(columns))

    def plus(self, digests: Mapping[Path, str]) -> Parts:
        """Return this object unchanged, because a table in memory belongs to the run as soon as it is written, and has
        no digest."""
        return self

    def without(self, *tables: str) -> Parts:
        """Return this object unchanged, because no table in memory replaces an earlier table."""
        return self

    def write(self, folder: Path) -> dict[Path, str]:
        """Write the tables as files. Returns the digest of each file. Raises OSError."""
        return {folder / file: write_table(table, folder / file) for file, table in self.tables.items()}
