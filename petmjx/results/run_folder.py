"""The layout of a run's folder, and how its files are written.

    DIR/run.json                    options, versions, device, counts, skipped plans
    DIR/worlds/part-*.parquet       one row per world
    DIR/boxes/part-*.parquet        one row per box of each world
    DIR/attempts/part-*.parquet     one row per attempt, for worlds that needed more than one
    DIR/histories/part-*.parquet    recorded worlds: one row per frame and placed box
    DIR/frames/part-*.parquet       one row per frame: pose of the carrier, and what shakes it
    DIR/contacts/part-*.parquet     one row per contact of each frame, if details were recorded
    DIR/summary/part-*.parquet      sweeps, chains and scores with confidence: their results
    DIR/plans/part-*.parquet        one row per plan of the run, with its digest
    DIR/placements/part-*.parquet   one row per box of the run's plans, with all fields
    DIR/.lock                       exists while a run writes

A file never appears half-written. Tables are written as several files, called parts. A part belongs to the run only if
``run.json`` lists it with its digest (petmjx.results.run_table_reader). Parts that are not listed were left by a killed
run. Parts of ``worlds``, ``boxes`` and ``attempts`` with the same number hold the same worlds. Parts of ``histories``,
``frames`` and ``contacts`` with the same number also hold the same worlds.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import BinaryIO, Final

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from petmjx.common.arrow_files import open_for_arrow
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.safe_read import read_regular

RUN_FILE: Final = "run.json"
OF_SOME_WORLDS: Final = ("attempts", "histories", "frames", "contacts")
"""Tables in which some worlds have no rows. A part of a run is a group of its worlds; a table has a file for each part,
with the number of the part in its name (``part_name``). If no world of a part has a row in one of these tables, this
table has no file for this part."""

OF_WORLDS: Final = ("worlds", "boxes", *OF_SOME_WORLDS)
TABLES: Final = (*OF_WORLDS, "summary", "plans", "placements")

ROWS_PER_GROUP: Final = 131_072
"""Number of rows in a row group of a Parquet file. A group of ``boxes`` has a few megabytes, so that readers can
process one group at a time. A part of ``worlds`` is a single group."""

DIGEST_BYTES: Final = 16
_BLOCK: Final = 1 << 20

_PART: Final = re.compile(r"part-\d{5,}\.parquet")
_HIDDEN: Final = re.compile(r"\.(part-\d{5,}\.parquet|run\.json)\.[0-9a-f]{32}\.tmp")
MOST_RUN_FILE_BYTES: Final = 1 << 30
"""Largest accepted size of ``run.json``, bytes. A million lines about skipped plans take 200 MB."""


def part_name(number: int) -> str:
    """Name of the file that is the part ``number`` of a table. Parts of different tables with the same number hold the
    same worlds."""
    return f"part-{number:05d}.parquet"


def part_number(file: Path) -> int:
    """The number of a part, read from the name of its file."""
    return int(file.stem.removeprefix("part-"))


def part_files(folder: Path, table: str) -> list[Path]:
    """The files of a table, sorted by number."""
    return sorted(_own_files(folder / table, _PART), key=part_number)


Write = Callable[[BinaryIO], object]
"""A function that writes the content of a file into a binary stream."""


def parquet(table: pa.Table) -> Write:
    """A function that writes a table as Parquet. Measured values hardly repeat, so Parquet stores them without a
    dictionary of values. A dictionary would double the time and take more space."""
    repeats = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
    return lambda file: pq.write_table(
        table, file, compression="zstd", compression_level=1, row_group_size=ROWS_PER_GROUP, use_dictionary=repeats
    )


def csv(table: pa.Table) -> Write:
    """A function that writes a table as CSV."""
    return lambda file: pa_csv.write_csv(table, file)


def text(content: str) -> Write:
    """A function that writes a text as UTF-8. Characters that UTF-8 cannot encode, as in some file names, are escaped
    as in JSON."""
    return lambda file: file.write(content.encode(errors="backslashreplace"))


def write_together(files: Mapping[Path, Write]) -> dict[Path, str]:
    """Write several files, and return the digest of each file. All files are first written under hidden names. When all
    files are complete, they are renamed. The folders of the files must exist.

    Raises:
        OSError: a file cannot be written. If an error is raised, existing files are unchanged.
    """
    hidden: dict[Path, Path] = {}
    digests: dict[Path, str] = {}
    try:
        for path, write in files.items():
            hidden[path] = path.with_name(f".{path.name}.{secrets.token_hex(16)}.tmp")
            digests[path] = _write(hidden[path], write)
        for path, temporary in hidden.items():
            os.replace(temporary, path)
        for folder in {path.parent for path in hidden}:
            _flush_folder(folder)
    except BaseException:
        for temporary in hidden.values():
            temporary.unlink(missing_ok=True)
        raise
    return digests


def _flush_folder(folder: Path) -> None:
    """Flush the names of a folder's files to disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_table(table: pa.Table, path: Path) -> str:
    """Write one Parquet file and return its digest. The file never appears half-written. If the run's folder was
    deleted, it is not created again."""
    path.parent.mkdir(exist_ok=True)
    return write_together({path: parquet(table)})[path]


def write_text(content: str, path: Path) -> None:
    """Write one text file as UTF-8, with the escapes of :func:`text`. The file never appears half-written."""
    write_together({path: text(content)})


def copy_file(source: Path, path: Path) -> str:
    """Copy one file and return its digest. The copy never appears half-written."""
    path.parent.mkdir(exist_ok=True)
    with source.open("rb") as original:
        return write_together({path: lambda file: shutil.copyfileobj(original, file)})[path]


def digest_of(stream: BinaryIO) -> str:
    """Hexadecimal digest (BLAKE2b) of an open file, from the file's current position to its end. Reading a gigabyte
    takes a second."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    while block := stream.read(_BLOCK):
        digest.update(block)
    return digest.hexdigest()


def holds_run(folder: Path) -> bool:
    """Whether a folder has a ``run.json`` or a table of results. The tables ``plans`` and ``placements`` are ignored,
    since a run writes them before ``run.json``."""
    tables = (table for table in TABLES if table not in ("plans", "placements"))
    return (folder / RUN_FILE).exists() or any(part_files(folder, table) for table in tables)


def check_run_folder(folder: Path, overwrite: bool = False, resume: bool = False) -> None:
    """Check that a run may write into a folder. The folder is not changed.

    Args:
        overwrite: whether an existing run may be replaced.
        resume: whether an existing run may be resumed.

    Raises:
        InputError: the folder has a run, and neither option is set; or a file, a folder or a link that petmjx did not
            write has the name of a file of a run.
    """
    parts = {file: table for table in TABLES for file in part_files(folder, table)}
    hidden = [file for place in (folder, *(folder / table for table in TABLES)) for file in _own_files(place, _HIDDEN)]
    listed: Collection[Path] = ()

    def is_ours(file: Path) -> bool:
        if file.name == RUN_FILE:
            # if the run is resumed, the function that reads the run reports errors
            return resume or _listed_parts(file) is not None
        return file in hidden or file in listed or _is_part_of(parts[file], file)

    def check(*files: Path) -> None:
        check_outputs(files, overwrite=True, folder=folder, is_ours=is_ours)

    # ``check`` tests each path from the top down, so it also works for folders that do not exist yet
    check(folder / RUN_FILE, *(folder / table / "x" for table in TABLES))
    listed = _listed_parts(folder / RUN_FILE) or ()
    check(*parts, *hidden)
    if holds_run(folder) and not overwrite and not (resume and (folder / RUN_FILE).exists()):
        content = "a run already"
        if not (folder / RUN_FILE).exists():
            content = f"tables of a run without its {RUN_FILE}, so that it cannot be resumed"
        out, replace = option("--out"), option("--overwrite", "True")
        raise InputError(f"{folder}: holds {content}; name another folder with {out}, or pass {replace}")


def _listed_parts(run_file: Path) -> frozenset[Path] | None:
    """The files that a ``run.json`` lists; None if there is no ``run.json`` or petmjx did not write it."""
    try:
        tables = json.loads(read_regular(run_file, MOST_RUN_FILE_BYTES))["parts"]
        return frozenset(run_file.parent / table / name for table, names in tables.items() for name in names)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None


def _is_part_of(table: str, file: Path) -> bool:
    """Whether the metadata of a file state that petmjx wrote the file as a part of the table ``table``, in any run."""
    try:
        with open_for_arrow(file) as stream:
            metadata = pq.read_schema(stream).metadata or {}
    except (OSError, ValueError, pa.ArrowException):
        return False
    return metadata.get(b"table") == table.encode() and b"schema_version" in metadata


def make_room(folder: Path) -> None:
    """Delete the files of the run in a folder, and no other files. Call :func:`check_run_folder` first.

    ``run.json`` is deleted first. So if the process is killed meanwhile, the folder has no run, rather than a run with
    missing files.

    Raises:
        OSError: the folder is not writable.
    """
    if holds_run(folder):
        (folder / RUN_FILE).unlink(missing_ok=True)
        for file in (file for table in TABLES for file in part_files(folder, table)):
            file.unlink()


def tidy(folder: Path) -> None:
    """Delete the temporary files that killed runs have left. Call :func:`check_run_folder` first."""
    for place in (folder, *(folder / table for table in TABLES)):
        for file in _own_files(place, _HIDDEN):
            file.unlink()


def drop_parts(folder: Path, kept: Callable[[str], Collection[Path]]) -> None:
    """Delete the parts that a killed run has left.

    Args:
        kept: function that takes the name of a table and returns the files of this table that must stay.
    """
    for table in TABLES:
        files = kept(table)
        for file in part_files(folder, table):
            if file not in files:
                file.unlink()


def _own_files(folder: Path, pattern: re.Pattern[str]) -> list[Path]:
    """The files of a folder whose names match this pattern; an empty list if the path is not a folder."""
    return [file for file in folder.iterdir() if pattern.fullmatch(file.name)] if folder.is_dir() else []


def _write(path: Path, write: Write) -> str:
    """Write a new file and flush it to disk. Returns the digest of the file."""
    # No other program can have put a file or a link at this path: its name is random, and existing files are not
    # opened.
    open_flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    with open(os.open(path, open_flags, 0o666), "w+b") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
        file.seek(0)
        return digest_of(file)
