"""Safe reading of files that users name: reading always ends, even if a path leads to a device or a FIFO, and the size
is limited. Pipes that are named on a command line are read, too (``named_pipes``)."""

from __future__ import annotations

import errno
import os
import re
import select
import stat
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

_BLOCK: Final = 1 << 20

MOST_BYTES: Final = 4 << 30
"""Largest size of a file of plans or of a table: 40 times the size of 10,003 generated plans, which take about 105
MB."""
MOST_RATIO: Final = 100
FREE_BYTES: Final = 64 << 20
"""Limits of compression. A file is refused if it unpacks to more than ``FREE_BYTES`` and to more than ``MOST_RATIO``
times its own size, because no real table of plans can be compressed that much. Gzip compresses plans to a tenth or a
thirtieth of their size, and zeros to a thousandth. Parquet compresses results to a tenth of their size."""

_KINDS: Final = (
    (stat.S_ISDIR, errno.EISDIR, "Is a directory"),
    (stat.S_ISFIFO, errno.EINVAL, "it is a FIFO, not a file"),
    (stat.S_ISSOCK, errno.EINVAL, "it is a socket, not a file"),
    (stat.S_ISCHR, errno.EINVAL, "it is a device, not a file"),
    (stat.S_ISBLK, errno.EINVAL, "it is a device, not a file"),
)


_WRITER_S: Final = 5.0
"""Time for which petmjx waits for a program to open a FIFO for writing."""
_WAIT_MS: Final = 250


class _Pipes:
    """The pipes that are named on a command line, and the content of the pipes that have been read.

    Attributes:
        words: the words of the command line, and the parts of these words between "=" and ",", as in
            ``--plans=/dev/stdin``. A path counts as named on the command line if it is one of these texts.
    """

    def __init__(self, words: frozenset[str]) -> None:
        self.words = words
        self._lock = threading.Lock()
        self._descriptors: dict[tuple[int, int], int] = {}
        """(device, inode) of a pipe → descriptor of a file in memory that holds the content of the pipe."""
        self._faults: dict[tuple[int, int], OSError] = {}

    def file_of(self, path: Path) -> Path:
        """The file in memory with the content of a pipe; any other path is returned unchanged. Raises OSError."""
        if str(path) not in self.words or not hasattr(os, "memfd_create"):  # only Linux has files in memory
            return path
        status = os.stat(path)
        if not stat.S_ISFIFO(status.st_mode):
            return path
        with self._lock:
            key = status.st_dev, status.st_ino
            if key in self._faults:
                raise self._faults[key]
            if key not in self._descriptors:
                try:
                    self._descriptors[key] = _content_of_pipe(path)
                except OSError as error:
                    self._faults[key] = error
                    raise
            return Path(f"/proc/self/fd/{self._descriptors[key]}")

    def close(self) -> None:
        with self._lock:
            for descriptor in self._descriptors.values():
                os.close(descriptor)
            self._descriptors.clear()


_pipes: _Pipes | None = None
"""The pipes that are named on the command line that this process runs. If ``_pipes`` is None, no command line runs. A
process runs at most one command line, and all threads share this variable."""


@contextmanager
def named_pipes(words: Iterable[str]) -> Iterator[None]:
    """Context of the command line, in which pipes that are arguments of the command are read like files: ``<(…)`` of a
    shell, FIFOs, and ``/dev/stdin``. A pipe is read once, to its end; its content stays in memory until the context
    ends. Pipes are read only on Linux, and are refused on other systems."""
    global _pipes
    parts = {part for word in words for part in (word, *re.split(r"[=,]", word))}
    before, _pipes = _pipes, _Pipes(frozenset(parts - {""}))
    try:
        yield
    finally:
        _pipes.close()
        _pipes = before


def _content_of_pipe(path: Path) -> int:
    """Read a pipe to its end, and return the descriptor of a file in memory with its content.

    Raises:
        OSError: the pipe cannot be read, no program writes to it, or its content is too large.
    """
    pipe = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    content = os.memfd_create("petmjx")
    try:
        poll = select.poll()
        poll.register(pipe, select.POLLIN | select.POLLHUP)
        deadline, has_writer, n_bytes = time.monotonic() + _WRITER_S, False, 0
        while True:
            # The kernel reports a hang-up only if a program had opened the pipe for writing, and has closed it.
            has_writer |= any(event & select.POLLHUP for _, event in poll.poll(0))
            try:
                block = os.read(pipe, _BLOCK)
            except BlockingIOError:  # a program has opened the pipe, and has not written yet
                has_writer = True
                poll.poll(_WAIT_MS)
                continue
            if block:
                has_writer, n_bytes = True, n_bytes + len(block)
                if n_bytes > MOST_BYTES:
                    raise _too_large(MOST_BYTES)
                while block:
                    block = block[os.write(content, block) :]
            elif has_writer:
                return content
            elif time.monotonic() > deadline:
                raise OSError(errno.EINVAL, "it is a FIFO to which no program writes")
            else:
                time.sleep(_WAIT_MS / 1000)
    except BaseException:
        os.close(content)
        raise
    finally:
        os.close(pipe)


def regular_file(path: Path) -> Path:
    """The path from which a file is read. For a pipe that is named on the command line, this is the path of a file in
    memory with the content of the pipe; for any other file, it is the path itself. Raises OSError."""
    return path if _pipes is None else _pipes.file_of(path)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading. FIFOs, sockets and devices are refused at once, because reading some of them
    would never end. Pipes that are named on the command line count as files (``named_pipes``).

    Raises:
        OSError: the file cannot be read, or is not a regular file; ``strerror`` has the reason.
        ValueError: the name is impossible for a file, such as a name with a null character.
    """
    # The path is checked before opening, because opening a device may have an effect. The opened file is checked again,
    # because the path may have changed in between.
    path = regular_file(path)
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
