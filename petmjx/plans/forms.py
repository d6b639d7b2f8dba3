"""The forms in which plans come, and how they are recognised. Nothing here loads Arrow."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Protocol, runtime_checkable

from petmjx.basics.bounded import open_regular

PARQUET_MAGIC: Final = b"PAR1"
PARQUET_SUFFIX: Final = ".parquet"
CSV_SUFFIXES: Final = (".csv", ".csv.gz", ".tsv", ".tsv.gz")


@runtime_checkable
class SupportsArrow(Protocol):
    """A table of pandas, Polars, PyArrow and others (Arrow's PyCapsule interface)."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Its columns, for Arrow."""


def is_csv(path: Path) -> bool:
    """Whether a file is CSV by its name. Only that tells it from damaged JSON."""
    return path.name.lower().endswith(CSV_SUFFIXES)


def is_parquet_name(path: Path) -> bool:
    """Whether a file is Parquet by its name."""
    return path.suffix.lower() == PARQUET_SUFFIX


def is_parquet(path: Path) -> bool:
    """Whether a file is Parquet, by its name or its first bytes.

    Raises:
        OSError: it cannot be read, or is no regular file.
        ValueError: a name that no file can have.
    """
    with open_regular(path) as file:
        return is_parquet_name(path) or file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC
