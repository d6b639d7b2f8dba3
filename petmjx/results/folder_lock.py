"""A lock that lets only one run at a time write into a folder. When the process that holds the lock ends, even by a
kill, the lock ends, too.

The package ``filelock`` is no alternative, for three reasons. ``filelock`` uses any file with the name of the lock as a
lock, even a file of the user. ``filelock`` does not tell which process holds the lock. On file systems without locks,
the lock file of ``filelock`` remains if the process is killed.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError

LOCK_FILE: Final = ".lock"
"""Name of the file that locks a run's folder while a run writes into the folder. If a run is killed, its lock ends, so
the next run can lock the file."""

_OURS: Final = re.compile(rb"\d*\n?")

_NO_LOCKS: Final = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)
"""Numbers of the system errors that file systems without locks return."""


@contextlib.contextmanager
def held_folder_lock(folder: Path) -> Iterator[bool]:
    """Lock a folder for one run. Yields whether the folder's file system supports locks.

    Raises:
        InputError: another run is writing into the folder, or the name of the lock file belongs to a folder, a link, or
            a file that petmjx did not write.
        OSError: the folder is not writable.
    """
    descriptor = _lock_descriptor(folder)
    try:
        _check_ours(descriptor, folder)
        has_locks = True
        try:
            _take(descriptor, folder)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            has_locks = False
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        try:
            yield has_locks
        finally:
            # the lock file is removed before the lock is released, so that the next run sees either a new lock file or
            # none
            with contextlib.suppress(OSError):
                (folder / LOCK_FILE).unlink()
    finally:
        os.close(descriptor)


def _lock_descriptor(folder: Path) -> int:
    try:
        return os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    except OSError as error:
        if error.errno not in (errno.ELOOP, errno.EISDIR):
            raise
        raise _not_ours(folder) from None


def _check_ours(descriptor: int, folder: Path) -> None:
    """Raise InputError if the lock file contains anything but the number of a process. Such a file may belong to the
    user, and petmjx would overwrite and later delete it."""
    if not stat.S_ISREG(os.fstat(descriptor).st_mode) or not _OURS.fullmatch(os.pread(descriptor, 32, 0)):
        raise _not_ours(folder)


def _not_ours(folder: Path) -> InputError:
    return InputError(
        f"{folder / LOCK_FILE}: was not made by petmjx, which locks a run's folder with a file of this name; "
        f"name another folder with {option('--out')}"
    )


def _take(descriptor: int, folder: Path) -> None:
    """Lock the lock file. If another process deleted this file in the meantime, make and lock a new file."""
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _in_use(descriptor, folder) from None
        if _is_in(descriptor, folder):
            return
        second_descriptor = _lock_descriptor(folder)
        os.dup2(second_descriptor, descriptor, inheritable=False)
        os.close(second_descriptor)


def _is_in(descriptor: int, folder: Path) -> bool:
    try:
        status = os.stat(folder / LOCK_FILE, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return os.path.samestat(status, os.fstat(descriptor))


def _in_use(descriptor: int, folder: Path) -> InputError:
    pid = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip()
    who = f" (process {pid})" if pid.isdigit() else ""
    return InputError(
        f"{folder}: another run{who} is writing there; wait until it ends, or name another folder with "
        f"{option('--out')}"
    )
