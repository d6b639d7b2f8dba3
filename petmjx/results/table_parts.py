"""The parts (files) of a run's tables: writes parts, reads them, and checks that they have not changed since the run
wrote them.

New files get new numbers, so old and new files exist side by side until ``run.json`` lists the new files. If the run is
killed, its folder therefore has either the old or the new state. If a run has no folder, its tables stay in memory
(``MemoryParts``) as long as each table is small enough for a single file.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import pyarrow as pa
import pyarrow.parquet as pq

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.parquet_files import OversizedFile, decoded_bytes, open_for_arrow, read_within
from petmjx.common.safe_read import allowed_bytes, open_regular, size
from petmjx.results.result_files import copy_file, digest_of, write_table
from petmjx.results.run_folder import OF_WORLDS, part_name, part_number
from petmjx.results.schema import check_version, schema_version_of

MOST_AT_ONCE: Final = 8
"""Number of parts of a table that are read at the same time."""

LISTED: Final = "parts"
"""The entry of ``run.json`` that lists the run's files: table → file name → digest. Files that this entry does not list
were left by a killed run, and are not read."""


FREE_BYTES: Final = 256 << 20
"""Memory that the tables of a run may take even if their files are small, bytes. Files can be small because boxes at
rest and columns without values are compressed to a hundredth. For larger tables, the limit depends on their size on
disk."""

MOST_TABLE_BYTES: Final = 1 << 40
"""Upper limit for the memory of a table, bytes. The limit is so high because the memory of the machine is the real
limit for the tables of large runs."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The files of a run's tables. Each file is checked once, when it is first read.

    Attributes:
        folder: the run's folder.
        digests: table → file name → digest of the file.
    """

    folder: Path
    digests: dict[str, dict[str, str]]
    _checked: set[Path] = field(default_factory=set, repr=False)

    @classmethod
    def of(cls, folder: Path, info: Mapping[str, Any]) -> Self:
        """The files of the run in a folder, as listed in ``info``, the content of ``run.json``."""
        return cls(folder, info[LISTED])

    def files(self, table: str) -> list[Path]:
        """The files of a table that ``run.json`` lists, sorted by number, even if they are missing on disk."""
        return sorted((self.folder / table / name for name in self.digests.get(table, ())), key=part_number)

    def read(self, file: Path, columns: Sequence[str] | None = None) -> pa.Table:
        """Read one of the run's files as a table, or some of its columns.

        Raises:
            InputError: the file is missing, was changed after the run wrote it, lacks one of the columns, or was
                written by a newer petmjx.
        """
        self.check(file)
        return read_part(file, columns)

    def columns(self, file: Path) -> list[str]:
        """The names of the columns of one file. Raises InputError like :meth:`read`."""
        self.check(file)
        with open_part(file) as parquet:
            names: list[str] = parquet.schema_arrow.names
        return names

    def table(self, table: str, columns: Sequence[str] | None = None) -> list[pa.Table]:
        """Read all parts of a table in parallel. The method raises the same errors as :meth:`read`."""
        files = self.files(table)
        if len(files) < 2:
            return [self.read(file, columns) for file in files]
        self._check_size(files, columns)
        with ThreadPoolExecutor(MOST_AT_ONCE, thread_name_prefix="petmjx-parts") as pool:
            return list(pool.map(lambda file: self.read(file, columns), files))

    def _check_size(self, files: Sequence[Path], columns: Sequence[str] | None) -> None:
        """Check that the tables in the given files, all together, do not take too much memory. Raises InputError."""
        needed = file_bytes = 0
        for file in files:
            self.check(file)
            with open_part(file) as parquet:
                needed += decoded_bytes(parquet, columns)
            file_bytes += file.stat().st_size
        if needed > allowed_bytes(file_bytes, FREE_BYTES, MOST_TABLE_BYTES):
            raise InputError(
                f"{files[0].parent}: the rows of the table would take {size(needed)}, too much for files of this size"
            )

    def check_tables(self, tables: Iterable[str]) -> None:
        """Apply :meth:`check` to all files of the given tables."""
        for file in (file for table in tables for file in self.files(table)):
            self.check(file)

    def write(self, table: str, number: int, content: pa.Table) -> dict[Path, str]:
        """Write a table, or a part of it, as a new file. Returns file → digest. The file belongs to the run only after
        a call of :meth:`plus`. Raises OSError."""
        path = self.folder / table / part_name(number)
        return {path: write_table(content, path)}

    def copy(self, file: Path, number: int) -> dict[Path, str]:
        """Copy a file of another run byte by byte, as a new file of the same table. Returns copy → digest. The copy
        belongs to the run only after a call of :meth:`plus`.

        Raises:
            InputError: ``file`` is missing.
            OSError: the copy cannot be written.
        """
        path = self.folder / file.parent.name / part_name(number)
        try:
            return {path: copy_file(file, path)}
        except FileNotFoundError:
            raise InputError(f"{file}: missing, although the table `worlds` has a file with the same number") from None

    def replaced(self, table: str, content: pa.Table) -> Parts:
        """Write a table as a single new file. Returns a copy of this list of files in which this file replaces the
        files of the table. Raises OSError."""
        digests = self.write(table, self.next_number(table), content)
        return self.without(table).plus(digests)

    def plus(self, digests: Mapping[Path, str]) -> Parts:
        """A copy of this list of files to which further files are added. ``digests``: further file → digest."""
        listed = {table: dict(files) for table, files in self.digests.items()}
        for file, digest in digests.items():
            listed.setdefault(file.parent.name, {})[file.name] = digest
        return Parts(self.folder, listed, {*self._checked, *digests})

    def without(self, *tables: str) -> Parts:
        """A copy of this list of files, without the files of the given tables."""
        remaining = {table: dict(files) for table, files in self.digests.items() if table not in tables}
        return Parts(self.folder, remaining, set(self._checked))

    def without_numbers(self, numbers: Collection[int]) -> Parts:
        """A copy of this list of files without the files that have one of the given numbers. Only files of tables with
        rows about worlds, such as ``worlds`` and ``boxes``, are left out."""
        removed_names = {part_name(number) for number in numbers}
        remaining = {
            table: {
                name: digest for name, digest in files.items() if table not in OF_WORLDS or name not in removed_names
            }
            for table, files in self.digests.items()
        }
        return Parts(self.folder, remaining, set(self._checked))

    def with_worlds(self) -> Parts:
        """A copy of this list of files for a run from which the user has deleted a file of ``worlds``, so that the
        worlds in this file are simulated again. The copy lacks the deleted file, and the files of the other tables with
        the same number.
        """
        missing = [part_number(file) for file in self.files("worlds") if not file.exists()]
        # If the run has histories, no file is left out, because it is unknown which histories belong to the deleted
        # worlds.
        return self if self.files("frames") else self.without_numbers(missing)

    def lacking_boxes(self) -> list[int]:
        """The numbers of the parts of the run that have a file of ``worlds`` but no file of ``boxes``."""
        have = {part_number(file) for file in self.files("boxes")}
        return [number for number in map(part_number, self.files("worlds")) if number not in have]

    def next_number(self, *tables: str) -> int:
        """A number for the next file, which is larger than the number of any file of the given tables."""
        return 1 + max((part_number(file) for table in tables for file in self.files(table)), default=-1)

    def check(self, file: Path) -> None:
        """Check that a file has not changed since the run wrote it.

        Raises:
            InputError: the file is missing or has changed.
        """
        if file in self._checked:
            return
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: the run's folder is gone")
        expected = self.digests[file.parent.name][file.name]
        try:
            with open_regular(file) as stream:
                digest = digest_of(stream)
        except FileNotFoundError:
            raise InputError(f"{file}: missing, though the run wrote it; {self._cure(file)}") from None
        except OSError as error:
            raise InputError(f"{file}: damaged part, it cannot be read: {error.strerror or error}") from error
        if digest != expected:
            raise InputError(f"{file}: damaged part, it differs from what the run wrote; {self._cure(file)}")
        self._checked.add(file)

    def _cure(self, file: Path) -> str:
        """The end of an error message: how to repair the run if this file is missing or damaged."""
        if file.parent.name == "summary":
            return f"use {option('--resume', 'True')} to make it again"
        if file.parent.name not in OF_WORLDS or self.files("frames"):
            return f"simulate the run again, with {option('--overwrite', 'True')}"
        worlds = self.folder / "worlds" / file.name
        delete = f"delete {worlds} and " if file != worlds or file.exists() else ""
        return f"{delete}use {option('--resume', 'True')} to simulate its worlds again"


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

    def write(self, table: str, number: int, content: pa.Table) -> dict[Path, str]:
        """Keep a table, or a part of it. The result is empty."""
        self.tables[self.folder / table / part_name(number)] = content
        return {}

    def plus(self, digests: Mapping[Path, str]) -> Parts:
        """Return this object unchanged, because a table in memory belongs to the run as soon as it is written, and has
        no digest."""
        return self

    def without(self, *tables: str) -> Parts:
        """Return this object unchanged, because no table in memory replaces an earlier table."""
        return self

    def save(self, folder: Path) -> Parts:
        """Write the tables as files into a folder. Raises OSError."""
        digests = {folder / file: write_table(table, folder / file) for file, table in self.tables.items()}
        return Parts(folder, {}).plus(digests)


def read_part(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Read one Parquet file, or some of its columns.

    Raises:
        InputError: the file is missing or damaged, lacks one of the columns, or was written by a newer petmjx.
    """
    with open_part(file) as parquet:
        schema = parquet.schema_arrow
        check_version(file, schema_version_of(schema.metadata))
        check_columns(file, schema.names, columns)
    try:
        with open_for_arrow(file) as stream:
            return read_within(stream, columns, free=FREE_BYTES, most=MOST_TABLE_BYTES)
    except OversizedFile as error:
        raise InputError(f"{file}: damaged part, {error}") from error
    except (pa.ArrowException, OSError, ValueError) as error:
        raise InputError(f"{file}: damaged part, it is not a whole Parquet file") from error


def check_columns(file: Path, names: Collection[str], columns: Sequence[str] | None) -> None:
    """Check that a part of a table, which has the columns ``names``, has the columns that are to be read.

    Raises:
        InputError: the part lacks a column.
    """
    for name in columns or ():
        if name not in names:
            raise InputError(f"{file}: damaged part, it has no column {name}")


@contextlib.contextmanager
def open_part(file: Path) -> Iterator[pq.ParquetFile]:
    """Open a file that is a part of a table of any run.

    Raises:
        InputError: the file is missing, or is not a whole Parquet file.
    """
    try:
        with open_for_arrow(file) as stream, pq.ParquetFile(stream) as parquet:
            yield parquet
    except FileNotFoundError:
        raise InputError(f"{file}: missing, although the table `worlds` has a file with the same number") from None
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{file}: damaged part, it is not a whole Parquet file") from error
