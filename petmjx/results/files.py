"""A run's folder: which files it has, and how they are written.

    DIR/run.json                    options, versions, device, counts, what was skipped
    DIR/worlds/part-*.parquet       one row per world
    DIR/boxes/part-*.parquet        one row per box of each world
    DIR/attempts/part-*.parquet     one row per attempt, for worlds that needed more than one
    DIR/summary/part-*.parquet      sweeps: the answers

Every file appears whole or not at all. Parts with the same number belong together. The boxes of a part are written
before its worlds. Boxes without their worlds are left from a crash, and ``load_run`` does not read them.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import pyarrow as pa
import pyarrow.parquet as pq

from petmjx.errors import InputError

RUN_FILE: Final = "run.json"
TABLES: Final = ("worlds", "boxes", "attempts", "summary")


def part_name(number: int) -> str:
    """File name of a part: the same in ``worlds``, ``boxes`` and ``attempts``."""
    return f"part-{number:05d}.parquet"


def part_files(folder: Path, table: str) -> list[Path]:
    """The files of a table's parts, in order."""
    return sorted((folder / table).glob("part-*.parquet"))


def write_table(table: pa.Table, path: Path) -> None:
    """Write one Parquet file so that it appears whole or not at all."""
    with _replacing(path) as file:
        pq.write_table(table, file, compression="zstd", compression_level=1)


def write_text(text: str, path: Path) -> None:
    """Write one UTF-8 text file so that it appears whole or not at all."""
    with _replacing(path) as file:
        file.write(text.encode())


def make_room(folder: Path, overwrite: bool) -> None:
    """Make the folder if it is not there. If it has a run, refuse it, or delete the run's files (and no others).

    ``run.json`` is deleted first: after a crash the folder then has no run, instead of a run without some parts.

    Raises:
        InputError: the folder has a run, and ``overwrite`` is not set.
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = [file for table in TABLES for file in part_files(folder, table)]
    if not overwrite and (parts or (folder / RUN_FILE).exists()):
        raise InputError(f"{folder}: holds a run already; name another folder with --out, or pass --overwrite")
    (folder / RUN_FILE).unlink(missing_ok=True)
    leftovers = [file for table in TABLES for file in (folder / table).glob(".part-*.parquet.tmp")]
    for file in (*parts, *leftovers):
        file.unlink()


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """A hidden file beside ``path``. After the body it is brought to disk and renamed to ``path``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") as file:
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
