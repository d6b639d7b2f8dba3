"""Safe reading of files that users name: reading always ends, also if a path leads to a device or a FIFO, and the size
is limited."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

_BLOCK: Final = 1 << 20

MOST_BYTES: Final = 4 << 30
"""Largest size of a file of plans or of a table: 100 times the size of the 10,003 plans of the benchmark BED-BPP, which
take about 40 MB."""
MOST_RATIO: Final = 100
FREE_BYTES: Final = 64 << 20
"""Limits of compression. A file is refused if it unpacks to more than ``FREE_BYTES`` and to more than ``MOST_RATIO``
times its own size, because no real table of plans can be compressed that much. Gzip compresses plans to a tenth or a
thirtieth, and zeros to a thousandth; Parquet compresses results to a tenth."""

_KINDS: Final = (
    (stat.S_ISDIR, errno.EISDIR, "Is a directory"),
    (stat.S_ISFIFO, errno.EINVAL, "it is a FIFO, not a file"),
    (stat.S_ISSOCK, errno.EINVAL, "it is a socket, not a file"),
    (stat.S_ISCHR, errno.EINVAL, "it is a device, not a file"),
    (stat.S_ISBLK, errno.EINVAL, "it is a device, not a file"),
)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading. FIFOs, sockets and devices are refused at once, because reading some of them
    would never end.

    Raises:
        OSError: the file cannot be read, or is not a regular file; ``strerror`` has the reason.
        ValueError: the name is impossible for a file, such as a name with a null character.
    """
    # The path is checked before opening, because opening a device may have an effect. The opened file is checked again,
    # because the path may have changed in between.
    _check(os.stat(path))
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        _check(os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: Path, most: int) -> bytearray:
    """Read the bytes of a regular file. If the file grows during the reading, the new bytes are read, too.

    Args:
        most: largest size in bytes. A larger file is refused, if possible before it is read.

    Raises:
        OSError: the file cannot be read, is not a regular file, or is too large; ``strerror`` has the reason.
        ValueError: the name is impossible for a file, such as a name with a null character.
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
    """A number of bytes as messages show it, such as "4 GiB" or "16 MiB"."""
    return f"{n_bytes >> 30} GiB" if n_bytes >= 1 << 30 else f"{n_bytes >> 20} MiB"


def allowed_bytes(file_bytes: int, free: int = FREE_BYTES, most: int = MOST_BYTES) -> int:
    """Largest number of bytes to which a file of ``file_bytes`` bytes may unpack. The limit is the same for gzip and
    Parquet."""
    return min(most, max(free, MOST_RATIO * file_bytes))
