"""Bounded reading of files that users name, also of Parquet: whatever a path leads to, the read ends."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

_BLOCK: Final = 1 << 20

MOST_BYTES: Final = 4 << 30
"""Largest size of a file of plans or of a table: 100 times BED-BPP's 10,003 plans, which take some 40 MB."""
MOST_RATIO: Final = 100
FREE_BYTES: Final = 64 << 20
"""Bounds of compression. A file that unpacks to more than `FREE_BYTES` and to more than `MOST_RATIO` times its own size
is refused: no real table of plans is packed so densely. Gzip packs plans to a tenth or a thirtieth, and zeros to a
thousandth; Parquet packs results to a tenth."""

_KINDS: Final = (
    (stat.S_ISDIR, errno.EISDIR, "Is a directory"),
    (stat.S_ISFIFO, errno.EINVAL, "it is a FIFO, not a file"),
    (stat.S_ISSOCK, errno.EINVAL, "it is a socket, not a file"),
    (stat.S_ISCHR, errno.EINVAL, "it is a device, not a file"),
    (stat.S_ISBLK, errno.EINVAL, "it is a device, not a file"),
)


def open_regular(path: Path) -> BinaryIO:
    """A regular file to read from. FIFOs, sockets and devices are refused without waiting: some of them never end.

    Raises:
        OSError: the file cannot be read, or is no regular file; ``strerror`` says which.
        ValueError: no file can have this name.
    """
    # checked before opening, since opening a device may have an effect; checked again, since the path may have changed
    _check(os.stat(path))
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        _check(os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: Path, most: int) -> bytearray:
    """The bytes of a regular file. A file that changes meanwhile is read to its end.

    Args:
        most: largest size in bytes. A larger file is refused, before it is read if its size is known.

    Raises:
        OSError: the file cannot be read, is no regular file, or is too large; ``strerror`` says which.
        ValueError: no file can have this name.
    """
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise _too_large(most)
        data = bytearray()
        while block := os.read(file.fileno(), _BLOCK):
            data += block
            if len(data) > most:
                raise _too_large(most)
        return data


def _check(status: os.stat_result) -> None:
    for is_kind, number, text in _KINDS:
        if is_kind(status.st_mode):
            raise OSError(number, text)


def _too_large(most: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than {size(most)}")


def size(n_bytes: int) -> str:
    """A number of bytes in messages: "4 GiB", "16 MiB"."""
    return f"{n_bytes >> 30} GiB" if n_bytes >= 1 << 30 else f"{n_bytes >> 20} MiB"


def allowed_bytes(file_bytes: int, free: int = FREE_BYTES, most: int = MOST_BYTES) -> int:
    """Number of bytes that a file of this size may unpack to. The rule is the same for gzip and Parquet."""
    return min(most, max(free, MOST_RATIO * file_bytes))
