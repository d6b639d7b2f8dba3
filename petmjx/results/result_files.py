"""Writes files of results: Parquet, CSV and text. A file never appears half-written, and its digest is returned."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, Final

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

ROWS_PER_GROUP: Final = 131_072
"""Number of rows in a row group of a Parquet file. A row group of the table ``boxes`` has a few megabytes, so that
readers can process one group at a time. A part (file) of the table ``worlds`` is a single row group."""

DIGEST_BYTES: Final = 16
_BLOCK: Final = 1 << 20

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
