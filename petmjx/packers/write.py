"""The tables of a comparison as files."""

from __future__ import annotations

from pathlib import Path

from petmjx.checked import reason
from petmjx.errors import InputError
from petmjx.packers.compare import PackerComparison
from petmjx.text import printable


def write_comparison(found: PackerComparison, folder: Path) -> None:
    """Write each table into a folder, as NAME.parquet and NAME.csv; those that are there are replaced.

    Raises:
        InputError: the folder or a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, table in found.tables.items():
            table.to_parquet(folder / f"{name}.parquet", index=False)
            table.to_csv(folder / f"{name}.csv", index=False)
    except OSError as error:
        raise InputError(f"{printable(str(folder))}: cannot be written: {reason(error)}") from error
