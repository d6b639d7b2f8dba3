"""Files that users name, opened for Arrow to read."""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from petmjx.basics.bounded import open_regular
from petmjx.basics.text import shown


def open_for_arrow(path: Path) -> pa.NativeFile:
    """A regular file that Arrow reads by itself. Parquet is read from no stream of Python's.

    Threads of Arrow's read Parquet, and one may still free what it read when the table is there. If Python read it, the
    thread asks the interpreter to free it; if that is ending, the process aborts ("terminate called without an active
    exception") or hangs: https://github.com/apache/arrow/issues/34314 and https://github.com/apache/arrow/issues/50482.

    Raises:
        OSError: it cannot be read, or is no regular file; ``strerror`` says which.
        ValueError: a name that no file can have.
    """
    # Python looks first: Arrow waits for FIFOs. Arrow's functions for paths read "s3:" as a scheme, "a=1" in a folder's
    # name as a column, and know no names that are not UTF-8; this one takes the bytes of any name.
    with open_regular(path):
        return pa.OSFile(os.fsencode(path))


def parquet_table(path: Path) -> pa.Table:
    """All of a Parquet file.

    Raises:
        OSError: it cannot be read, or is no regular file.
        pyarrow.ArrowException: it is not a whole Parquet file.
        ValueError: a name that no file can have, or two columns have one name.
    """
    with open_for_arrow(path) as stream, pq.ParquetFile(stream) as file:
        names = file.schema_arrow.names
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"the column {shown(twice)} is repeated")
        return file.read()
