"""Writes tables as Parquet and CSV files. The Parquet metadata has the unit and the description of every column."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from petmjx.common.overwrite_guard import IsOurs, check_outputs
from petmjx.common.parquet_files import open_for_arrow
from petmjx.common.safe_read import read_regular
from petmjx.results.result_files import Write, csv, parquet, write_together

Described = Mapping[str, tuple[str, str]]
"""Name of a column → the column's unit and description."""

_MOST_JSON_BYTES: Final = 1 << 28
_LONGEST_HEADER: Final = 1 << 20


def documented_table(frame: pd.DataFrame, name: str, described: Described) -> pa.Table:
    """A data frame as an Arrow table whose metadata have the unit and the description of every column.

    Raises:
        KeyError: a column has no description.
    """
    table = pa.Table.from_pandas(frame, preserve_index=False)
    fields = [
        column.with_metadata({"unit": described[column.name][0], "description": described[column.name][1]})
        for column in table.schema
    ]
    return table.cast(pa.schema(fields, metadata={"table": name}))


def write_documented_tables(
    folder: Path, tables: Iterable[tuple[str, pd.DataFrame, Described]], others: Mapping[str, Write] | None = None
) -> None:
    """Write tables as ``NAME.parquet`` and ``NAME.csv`` into a folder. Either all files are written, or none.

    The folder is created if it does not exist. Existing files are replaced, so call :func:`check_tables_free` first.

    Args:
        others: name of each additional file → the function that writes this file.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = {folder / name: write for name, write in (others or {}).items()}
    for name, frame, described in tables:
        table = documented_table(frame, name, described)
        files |= {folder / f"{name}.parquet": parquet(table), folder / f"{name}.csv": csv(table)}
    write_together(files)


def check_tables_free(
    folder: Path,
    tables: Iterable[str],
    *,
    overwrite: bool,
    inputs: Iterable[Path] = (),
    others: Mapping[str, IsOurs] | None = None,
) -> None:
    """Check that :func:`write_documented_tables` may replace all existing files that it would replace. Call this
    function before the tables are computed, which can take minutes.

    Args:
        tables: names of the tables.
        overwrite: whether tables that petmjx wrote into the folder earlier may be replaced.
        inputs: files that the command reads, which must not be replaced.
        others: name of each additional file → function that returns whether petmjx wrote an existing file of this name.

    Raises:
        InputError: an existing file of one of these names was not written by petmjx or must not be replaced, or
            ``folder`` is not a folder.
    """
    others = others or {}
    names = [*others, *(f"{name}{suffix}" for name in tables for suffix in (".parquet", ".csv"))]

    def is_ours(file: Path) -> bool:
        return others[file.name](file) if file.name in others else is_documented_table(file)

    check_outputs([folder / name for name in names], overwrite=overwrite, inputs=inputs, folder=folder, is_ours=is_ours)


def is_documented_table(file: Path) -> bool:
    """Whether a file looks like one that :func:`write_documented_tables` wrote. A Parquet file is recognised by its
    metadata. A CSV file must have the same columns as the Parquet file of the same name in its folder."""
    if file.suffix == ".csv":
        columns = _documented_columns(file.with_suffix(".parquet"))
        return columns is not None and _header(file) == columns
    return _documented_columns(file) is not None


def has_keys(file: Path, keys: Iterable[str]) -> bool:
    """Whether a file contains a JSON object with these keys."""
    try:
        content: Any = json.loads(read_regular(file, _MOST_JSON_BYTES))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(content, dict) and content.keys() >= set(keys)


def _documented_columns(file: Path) -> list[str] | None:
    """The columns of a Parquet file in which every column has a unit and a description. The result is None for any
    other file, and for a part of a run's table."""
    try:
        with open_for_arrow(file) as stream:
            schema = pq.read_schema(stream)
    except (OSError, ValueError, pa.ArrowException):
        return None
    if b"schema_version" in (schema.metadata or {}):  # the file is a part of a run's table
        return None
    described = all({b"unit", b"description"} <= (field.metadata or {}).keys() for field in schema)
    return list(schema.names) if described and len(schema) else None


def _header(file: Path) -> list[str]:
    """The column names in the first line of a CSV file that Arrow wrote."""
    try:
        with file.open("rb") as stream:
            line = stream.readline(_LONGEST_HEADER)
        return [name.strip('"') for name in line.decode().rstrip("\n").split(",")]
    except (OSError, ValueError):
        return []
