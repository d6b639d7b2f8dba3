"""Atomic writes of files that users name: at no time does a file exist half-written."""

from __future__ import annotations

import gzip
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.text import printable


def check_writable(file: Path) -> None:
    """Check that a file can be written, as far as this can be checked without writing.

    Raises:
        InputError: the path is a folder, or its parent is not a folder or is not writable.
    """
    folder = file.parent
    if file.is_dir():
        fault = "is a folder"
    elif not folder.is_dir():
        fault = f"{folder} is not a folder"
    else:
        fault = "" if os.access(folder, os.W_OK | os.X_OK) else f"{folder} is not writable"
    if fault:
        raise InputError(f"{printable(str(file))}: cannot be written: {printable(fault)}")


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Context in which a file or a folder is written: a system error becomes an InputError that names the path."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{printable(str(path))}: cannot be written: {reason(error)}") from error


@contextmanager
def atomic_write(file: Path) -> Iterator[Path]:
    """Context in which a file is written under a hidden name. Yields the path of the hidden file, which has the same
    folder and the same suffix as the file. At the end of the ``with`` block, the hidden file replaces the file.

    If the file is a link, its target is replaced. Existing paths that are not regular files, such as a FIFO or
    ``/dev/stdout``, are written to directly.

    Raises:
        InputError: the file cannot be written.
    """
    if "\0" in str(file):
        raise InputError(
            f"{printable(str(file))}: cannot be written: the name of a file cannot contain a NUL character"
        )
    target = file.resolve() if file.is_symlink() else file
    # no file can replace a path such as /dev/stdout, so it is written to directly
    direct = file.exists() and not file.is_file()
    temporary = file if direct else target.with_name(f".{secrets.token_hex(8)}.{target.name}")
    try:
        with write_errors(file):
            yield temporary
            if not direct:
                os.replace(temporary, target)
    except InputError as error:  # the message names the temporary file instead of the user's file
        raise InputError(str(error).replace(str(temporary), str(file))) from error
    finally:
        if not direct:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


def gzip_stream(stream: IO[bytes]) -> gzip.GzipFile:
    """A gzip stream that writes its compressed bytes to another stream. The stream stores no file name and no time, so
    its bytes depend only on the content."""
    return gzip.GzipFile(filename="", mode="wb", compresslevel=6, fileobj=stream, mtime=0)
