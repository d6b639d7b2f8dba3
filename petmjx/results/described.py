"""Tables that say of each column its unit and what it means, as files: Parquet, where both are metadata, and CSV."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import pandas as pd
import pyarrow as pa

from petmjx.results.files import Write, csv, parquet, write_together

Described = Mapping[str, tuple[str, str]]
"""Column → unit and meaning."""


def described_table(frame: pd.DataFrame, name: str, described: Described) -> pa.Table:
    """A data frame with unit and description of every column in its metadata; columns as in the frame.

    Raises:
        KeyError: a column is not described.
    """
    table = pa.Table.from_pandas(frame, preserve_index=False)
    fields = [
        column.with_metadata({"unit": described[column.name][0], "description": described[column.name][1]})
        for column in table.schema
    ]
    return table.cast(pa.schema(fields, metadata={"table": name}))


def write_described(
    folder: Path, tables: Iterable[tuple[str, pd.DataFrame, Described]], others: Mapping[str, Write] | None = None
) -> None:
    """Write tables as ``NAME.parquet`` and ``NAME.csv`` into a folder, which is made if it is not there; all or none.

    Args:
        others: name → content of more files.

    Raises:
        OSError: they cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = {folder / name: write for name, write in (others or {}).items()}
    for name, frame, described in tables:
        table = described_table(frame, name, described)
        files |= {folder / f"{name}.parquet": parquet(table), folder / f"{name}.csv": csv(table)}
    write_together(files)
