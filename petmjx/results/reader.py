"""Reads a run's folder into pandas data frames. The files in it: petmjx.results.files."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from petmjx.bounded import open_regular, read_regular
from petmjx.errors import InputError
from petmjx.plans.ordered import Ordered
from petmjx.results.counts import COUNTED, Counts
from petmjx.results.files import OF_SOME_WORLDS, RUN_FILE, part_files
from petmjx.results.run_file import check_run_file
from petmjx.results.schema import SCHEMA_VERSION, plans_schema, schema_version_of, schemas
from petmjx.text import counted, one_line
from petmjx.verdict import Verdict

MOST_RUN_FILE_BYTES: Final = 1 << 30
"""A million lines about skipped plans take 200 MB."""

FINISHED: Final = "finished"
"""The status of a run that came to its end."""


@dataclass(frozen=True, eq=False)
class RunResults:
    """The results of a run. Tables are read when they are first used.

    Attributes:
        path: the run's folder.
        info: ``run.json``.
    """

    path: Path
    info: dict[str, Any]

    def __repr__(self) -> str:
        counts = self.info.get("counts", {})
        config = self.info.get("config", {})
        what = "world" if config.get("command") == "sweep" or "sweep" in config else "plan"
        verdicts = ", ".join(f"{counts.get(verdict.value, 0):,} {verdict.value}" for verdict in Verdict)
        status = self.unfinished or FINISHED
        return f"RunResults({self.path}: {counted(counts.get('worlds', 0), what)}, {verdicts}; {status})"

    @property
    def unfinished(self) -> str | None:
        """How the run ended if not at its end, such as ``interrupted``: then worlds are missing. Else None."""
        status = str(self.info.get("status", "unknown"))
        return None if status == FINISHED else status

    def doubts(self, name: str) -> list[str]:
        """A line if the run is not finished, which is called ``name`` there; else none."""
        return [f"{name} is not finished ({self.unfinished})"] if self.unfinished else []

    @cached_property
    def worlds(self) -> pd.DataFrame:
        """One row per world. ``culprit`` is a nullable integer; other missing numbers are NaN."""
        frame = self._read("worlds")
        frame["culprit"] = frame["culprit"].astype("Int32")
        return frame

    @cached_property
    def boxes(self) -> pd.DataFrame:
        """One row per box of each world, in packing order."""
        return self._read("boxes")

    @cached_property
    def attempts(self) -> pd.DataFrame:
        """One row per attempt, for worlds that needed more than one; often empty."""
        return self._read("attempts")

    @cached_property
    def histories(self) -> pd.DataFrame:
        """One row per frame and placed box of each world that was recorded; often empty."""
        return self._read("histories")

    @cached_property
    def frames(self) -> pd.DataFrame:
        """One row per frame of each world that was recorded: the carrier, and what shook it."""
        return self._read("frames")

    @cached_property
    def contacts(self) -> pd.DataFrame:
        """One row per contact of each frame, for worlds that were recorded with details."""
        return self._read("contacts")

    @cached_property
    def plans(self) -> pd.DataFrame:
        """One row per plan, also those of other shards; empty in runs of petmjx before 0.2. Missing counts are null."""
        parts = [read_part(file) for file in part_files(self.path, "plans")]
        frame: pd.DataFrame = pa.concat_tables(parts or [plans_schema().empty_table()]).to_pandas()
        return frame.astype({name: "Int32" for name in frame.columns if name in Ordered._fields})

    @cached_property
    def summary(self) -> pd.DataFrame | None:
        """The answers of a sweep or of a score with confidence; None if the run has none."""
        files = part_files(self.path, "summary")
        return pa.concat_tables([read_part(file) for file in files]).to_pandas() if files else None

    def units(self, table: str) -> dict[str, str]:
        """Column → unit of a table: ``""`` for text, ``"1"`` for counts; empty if the run has no such table."""
        files = part_files(self.path, table)
        schema = read_part(files[0]).schema if files else pa.schema([])
        return {column.name: (column.metadata or {}).get(b"unit", b"").decode() for column in schema}

    def _read(self, table: str) -> pd.DataFrame:
        files = [self.path / table / file.name for file in part_files(self.path, "worlds")]
        parts = [read_part(file) for file in files if table not in OF_SOME_WORLDS or file.exists()]
        parts = parts or [schemas()[table].empty_table()]
        frame: pd.DataFrame = pa.concat_tables(parts, promote_options="default").to_pandas()
        return frame


def load_run(path: str | Path) -> RunResults:
    """Open the folder of a run.

    Raises:
        InputError: there is no run, ``run.json`` cannot be read, or a newer petmjx wrote the results. The tables raise
            it too when they are read, for a damaged or missing part.
    """
    folder = Path(path)
    info = read_info(folder)
    expected = info.get("counts", {}).get("worlds")
    if isinstance(expected, int):
        found = sum(_rows(file) for file in part_files(folder, "worlds"))
        if found != expected and info.get("status") == FINISHED:
            raise InputError(
                f"{folder}: {counted(found, 'world')} on disk, though the run finished with {expected:,}: parts were "
                "taken away or added"
            )
        if found != expected:  # killed after a part was written, before run.json was
            info["counts"] |= _counted(folder).as_json()
    return RunResults(folder, info)


def read_info(folder: Path) -> dict[str, Any]:
    """``run.json`` as it stands there.

    Raises:
        InputError: no run there, an unreadable or damaged ``run.json``, or results of a newer petmjx.
    """
    file = folder / RUN_FILE
    try:
        info = json.loads(read_regular(file, MOST_RUN_FILE_BYTES).decode())
    except (FileNotFoundError, NotADirectoryError):
        there = "not a folder" if folder.exists() else "no such folder"
        there = "no run of petmjx there (it has no run.json)" if folder.is_dir() else there
        raise InputError(f"{folder}: {there}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: cannot be read: {one_line(error)}") from error
    if not isinstance(info, dict) or not isinstance(info.get("schema_version"), int):
        raise InputError(f"{file}: not written by petmjx (it names no schema_version)")
    _check_version(file, info["schema_version"])
    check_run_file(info, file)
    return info


def told_apart(info: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """The warnings of a ``run.json``: about the whole run, and a line for each odd plan. The latter come last."""
    warnings = list(info.get("warnings", []))
    first_odd = len(warnings) - info.get("counts", {}).get("odd_plans", len(warnings))
    return warnings[:first_odd], warnings[first_odd:]


def _counted(folder: Path) -> Counts:
    """The counts of the worlds on disk."""
    counts = Counts()
    for file in part_files(folder, "worlds"):
        counts.add_worlds(read_part(file, COUNTED))
    return counts


def _rows(file: Path) -> int:
    """How many worlds a part has, without reading them."""
    with _opened(file) as parquet:
        rows: int = parquet.metadata.num_rows
    return rows


def read_part(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """One Parquet file, or some of its columns.

    Raises:
        InputError: missing, damaged, without one of the columns, or of a newer petmjx.
    """
    with _opened(file) as parquet:
        table = parquet.read(None if columns is None else list(columns))
    _check_version(file, schema_version_of(table.schema.metadata))
    for name in columns or ():
        if name not in table.column_names:
            raise InputError(f"{file}: damaged part, it has no column {name}")
    return table


@contextlib.contextmanager
def _opened(file: Path) -> Iterator[pq.ParquetFile]:
    """A part, in whatever folder.

    Raises:
        InputError: missing, or not a whole Parquet file.
    """
    # Python opens the file: Arrow waits for FIFOs, reads "s3:" as a scheme, "a=1" in a folder's name as a column, and
    # knows no names that are not UTF-8
    try:
        with open_regular(file) as stream, pq.ParquetFile(stream) as parquet:
            yield parquet
    except FileNotFoundError:
        raise InputError(f"{file}: missing, though the worlds of this part are there") from None
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{file}: damaged part, it is not a whole Parquet file") from error


def _check_version(file: Path, version: int) -> None:
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{file}: written by a newer petmjx (schema {version}; this one reads up to {SCHEMA_VERSION}): update it"
        )
