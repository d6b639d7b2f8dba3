"""What is about to be written: what is there already, whose it is, and whether it may be replaced. All commands ask
here."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from petmjx.common.checked_records import option, reason
from petmjx.common.errors import InputError
from petmjx.common.text import printable

IsOurs = Callable[[Path], bool]
"""Whether petmjx wrote a regular file."""


def check_outputs(
    files: Iterable[Path],
    *,
    overwrite: bool,
    inputs: Iterable[Path] = (),
    folder: Path | None = None,
    is_ours: IsOurs = lambda file: True,
) -> None:
    """Check that files may be written. Nothing is changed.

    Never replaced are: what is read; links, which may lead anywhere; folders; and in a folder, where names are petmjx's
    own choice, files that somebody else put there. Other files are replaced with ``overwrite``.

    Args:
        files: what would be written. Names in ``/dev`` are always free.
        inputs: files that are read, and folders in which all is read.
        folder: the folder that was named, if its files were not; it may be a link, and need not be there.
        is_ours: whether petmjx wrote a file of ``folder``.

    Raises:
        InputError: the first that may not be written, and why.
    """
    read = list(inputs)
    if folder is not None:
        _check_folder(folder)
    for file in files:
        if folder is not None:
            _check_way(file, folder)
        elif str(file.absolute()).startswith("/dev/"):  # /dev/stdout is a link, and may lead to a file
            continue
        _check(file, overwrite, read, None if folder is None else is_ours)


def _check_folder(folder: Path) -> None:
    with _path_errors(folder):
        ancestor = next((path for path in (folder, *folder.parents) if os.path.lexists(path)), folder)
        usable = ancestor.is_dir() or not os.path.lexists(ancestor)
    if not usable:
        raise InputError(f"{_name(folder)}: cannot be written: {_name(ancestor)} is not a folder")


def _check_way(file: Path, folder: Path) -> None:
    """Folders between the one that was named and the file are petmjx's own: no links, no files."""
    between = [parent for parent in file.parents if parent != folder and parent.is_relative_to(folder)]
    for parent in reversed(between):
        with _path_errors(parent):
            if parent.is_symlink():
                raise InputError(_link(parent))
            if os.path.lexists(parent) and not parent.is_dir():
                raise InputError(f"{_name(parent)}: is not a folder; name another folder")


def _check(file: Path, overwrite: bool, inputs: Iterable[Path], is_ours: IsOurs | None) -> None:
    kind = "file" if is_ours is None else "folder"
    with _path_errors(file):
        try:
            mode = os.lstat(file).st_mode
        except FileNotFoundError:
            return
        if any(_is_read(file, input_path) for input_path in inputs):
            raise InputError(f"{_name(file)}: is read, so it cannot be written too; name another {kind}")
        if stat.S_ISLNK(mode):
            raise InputError(_link(file))
    if stat.S_ISDIR(mode):
        raise InputError(f"{_name(file)}: cannot be written: is a folder")
    if is_ours is None:
        if stat.S_ISREG(mode) and not overwrite:
            raise InputError(
                f"{_name(file)}: exists already; name another file, or pass {option('--overwrite', 'True')}"
            )
        return  # a FIFO or a device that somebody names is written to
    if not stat.S_ISREG(mode):
        raise InputError(f"{_name(file)}: cannot be written: is no regular file")
    if not is_ours(file):
        raise InputError(f"{_name(file)}: was not written by petmjx, which would replace it; name another folder")
    if not overwrite:
        raise InputError(f"{_name(file)}: exists already; name another folder, or pass {option('--overwrite', 'True')}")


def _is_read(file: Path, source: Path) -> bool:
    """Whether a path leads to what is read, or into a folder in which all is read."""
    target, read = file.resolve(), source.resolve()
    if read in (target, *target.parents):
        return True
    return os.path.exists(file) and os.path.exists(source) and os.path.samefile(file, source)


@contextmanager
def _path_errors(path: Path) -> Iterator[None]:
    """System errors while a path is looked at become an InputError that names it."""
    try:
        yield
    except (OSError, ValueError, RuntimeError) as error:  # a name with NUL; links in a circle
        raise InputError(f"{_name(path)}: cannot be written: {reason(error)}") from error


def _link(path: Path) -> str:
    return f"{_name(path)}: is a link; petmjx writes and removes only its own files"


def _name(path: Path) -> str:
    return printable(str(path))
