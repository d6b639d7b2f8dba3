"""The layout of a run's folder, and what may be written into it (petmjx.results.result_files writes the files).

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

Tables are written as several files, called parts. A part belongs to the run only if ``run.json`` lists it with its
digest (petmjx.results.table_parts). Parts that are not listed were left by a killed run. Parts of ``worlds``,
``boxes`` and ``attempts`` with the same number hold the same worlds. Parts of ``histories``, ``frames`` and
``contacts`` with the same number also hold the same worlds.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.parquet_files import open_for_arrow
from petmjx.common.safe_read import read_regular

RUN_FILE: Final = "run.json"
OF_SOME_WORLDS: Final = ("attempts", "histories", "frames", "contacts")
"""Tables in which some worlds have no rows. The worlds of a run are divided into numbered groups, and a table has one
file for each group, with the number of the group in its name (``part_name``). If no world of a group has a row in one
of these tables, this table has no file for this group."""

OF_WORLDS: Final = ("worlds", "boxes", *OF_SOME_WORLDS)
TABLES: Final = (*OF_WORLDS, "summary", "plans", "placements")

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
    hidden = _hidden_files(folder)
    listed: Collection[Path] = ()

    def is_ours(file: Path) -> bool:
        if file.name == RUN_FILE:
            # when a run is resumed, the function that reads it later reports errors of its run.json
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


def delete_others(folder: Path, kept: Callable[[str], Collection[Path]]) -> None:
    """Delete the parts and the temporary files that killed runs have left, and the parts of a replaced run. Call
    :func:`check_run_folder` first.

    Args:
        kept: function that takes the name of a table and returns the files of this table that must stay.

    Raises:
        OSError: the folder is not writable.
    """
    parts = [file for table in TABLES for file in set(part_files(folder, table)) - set(kept(table))]
    for file in (*parts, *_hidden_files(folder)):
        file.unlink()


def _hidden_files(folder: Path) -> list[Path]:
    """The temporary files of a run's folder, whose writing is not finished."""
    return [file for place in (folder, *(folder / table for table in TABLES)) for file in _own_files(place, _HIDDEN)]


def _own_files(folder: Path, pattern: re.Pattern[str]) -> list[Path]:
    """The files of a folder whose names match this pattern; an empty list if the path is not a folder."""
    return [file for file in folder.iterdir() if pattern.fullmatch(file.name)] if folder.is_dir() else []
