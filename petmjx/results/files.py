"""A run's folder: which files it has, and how they are written.

    DIR/run.json                    options, versions, device, counts, what was skipped
    DIR/worlds/part-*.parquet       one row per world
    DIR/boxes/part-*.parquet        one row per box of each world
    DIR/attempts/part-*.parquet     one row per attempt, for worlds that needed more than one
    DIR/histories/part-*.parquet    worlds that were recorded: one row per frame and placed box
    DIR/frames/part-*.parquet       one row per frame: the carrier, and what shakes it
    DIR/contacts/part-*.parquet     one row per contact of each frame, if details were recorded
    DIR/summary/part-*.parquet      sweeps: the answers
    DIR/plans/part-*.parquet        a row a plan, with its digest: what a run was of
    DIR/.lock                       while a run writes there

Every file appears whole or not at all. Parts with the same number belong together. The boxes of a part, and all else
that it has, are written before its worlds. What is without its worlds is left from a crash, and not read.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from petmjx.errors import InputError

RUN_FILE: Final = "run.json"
OF_SOME_WORLDS: Final = ("attempts", "histories", "frames", "contacts")
"""Tables of which a part may be missing: none of its worlds has a row there."""

TABLES: Final = ("worlds", "boxes", *OF_SOME_WORLDS, "summary", "plans")

_PART: Final = re.compile(r"part-\d{5,}\.parquet")
_TEMPORARY: Final = re.compile(r"\.(part-\d{5,}\.parquet|run\.json)(\.[0-9a-f]{32})?\.tmp")


def part_name(number: int) -> str:
    """File name of a part: the same in ``worlds``, ``boxes`` and all other tables of worlds."""
    return f"part-{number:05d}.parquet"


def part_number(file: Path) -> int:
    """The number in a part's file name."""
    return int(file.stem.removeprefix("part-"))


def part_files(folder: Path, table: str) -> list[Path]:
    """The files of a table's parts, in order."""
    return sorted(_named(folder / table, _PART), key=part_number)


def write_table(table: pa.Table, path: Path) -> None:
    """Write one Parquet file so that it appears whole or not at all. The run's folder is never made anew."""
    path.parent.mkdir(exist_ok=True)
    with _replacing(path) as file:
        pq.write_table(table, file, compression="zstd", compression_level=1)


def write_csv(table: pa.Table, path: Path) -> None:
    """Write one CSV file so that it appears whole or not at all."""
    with _replacing(path) as file:
        pa_csv.write_csv(table, file)


def write_text(text: str, path: Path) -> None:
    """Write one UTF-8 text file so that it appears whole or not at all. What is no UTF-8, as names of files may be, is
    escaped as in JSON."""
    with _replacing(path) as file:
        file.write(text.encode(errors="backslashreplace"))


def copy_file(source: Path, path: Path) -> None:
    """Copy one file so that it appears whole or not at all."""
    path.parent.mkdir(exist_ok=True)
    with source.open("rb") as original, _replacing(path) as file:
        shutil.copyfileobj(original, file)


def why_unwritable(file: Path) -> str:
    """Why a file cannot be written, as far as can be seen before it is tried; "" if nothing speaks against it."""
    folder = file.parent
    if file.is_dir():
        return "is a folder"
    if not folder.is_dir():
        return f"{folder} is not a folder"
    return "" if os.access(folder, os.W_OK | os.X_OK) else f"{folder} is not writable"


def holds_run(folder: Path) -> bool:
    """Whether a folder has a run, or parts of one. The table ``plans`` alone is none: it comes before ``run.json``."""
    return (folder / RUN_FILE).exists() or any(part_files(folder, table) for table in TABLES if table != "plans")


def make_room(folder: Path, overwrite: bool) -> None:
    """Make sure that a folder has no run: refuse one that has, or delete the run's files (and no others).

    ``run.json`` is deleted first: after a crash the folder then has no run, instead of a run without some parts.

    Raises:
        InputError: the folder has a run, and ``overwrite`` is not set.
        OSError: the folder cannot be written.
    """
    if holds_run(folder):
        if not overwrite:
            what = "a run already"
            if not (folder / RUN_FILE).exists():
                what = f"tables of a run without its {RUN_FILE}, so that it cannot be resumed"
            raise InputError(f"{folder}: holds {what}; name another folder with --out, or pass --overwrite")
        (folder / RUN_FILE).unlink(missing_ok=True)
        for file in (file for table in TABLES for file in part_files(folder, table)):
            file.unlink()


def tidy(folder: Path) -> None:
    """Take away the temporary files that killed runs have left.

    Raises:
        InputError: one of the run's files or folders is a link, which might lead anywhere.
    """
    for path in (folder / RUN_FILE, *(folder / table for table in TABLES)):
        files = [file for file in (path, *_named(path, _PART), *_named(path, _TEMPORARY)) if file.is_symlink()]
        if files:
            raise InputError(f"{files[0]}: is a link; petmjx writes and removes files of its own only")
    for place in (folder, *(folder / table for table in TABLES)):
        for file in _named(place, _TEMPORARY):
            file.unlink()


def drop_unfinished_parts(folder: Path) -> None:
    """Take away boxes and all else of a part whose worlds were not written any more."""
    whole = {file.name for file in part_files(folder, "worlds")}
    for file in (file for table in ("boxes", *OF_SOME_WORLDS) for file in part_files(folder, table)):
        if file.name not in whole:
            file.unlink()


def _named(folder: Path, pattern: re.Pattern[str]) -> list[Path]:
    """The files of a folder, if it is one, with names of petmjx's own."""
    return [file for file in folder.iterdir() if pattern.fullmatch(file.name)] if folder.is_dir() else []


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """A hidden file beside ``path``. After the body it is brought to disk and renamed to ``path``."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(16)}.tmp")
    # a name that nobody knows, and never a file that is there already: nothing can be planted in its place
    how = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with open(os.open(temporary, how, 0o666), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    descriptor = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
