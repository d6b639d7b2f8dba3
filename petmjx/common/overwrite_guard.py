"""Checks that all commands make before they write files: whether a file exists, whether petmjx wrote it, and whether it
may be replaced."""

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
"""Function that tells whether petmjx wrote a regular file."""


def check_outputs(
    files: Iterable[Path],
    *,
    overwrite: bool,
    inputs: Iterable[Path] = (),
    folder: Path | None = None,
    is_ours: IsOurs = lambda file: True,
) -> None:
    """Check that files may be written. Nothing is changed on disk.

    Three kinds of files are never replaced: inputs, links (which may lead anywhere) and folders. If the user named only
    a folder, and petmjx chooses the names of the files, then files that petmjx did not write are never replaced either.
    All other files may be replaced if ``overwrite`` is set.

    Args:
        files: the files to be written. Names in ``/dev`` may always be written.
        inputs: files that the command reads, and folders whose files the command reads.
        folder: the folder that the user named, if the user did not name the files. The folder may be a link, and need
            not exist.
        is_ours: function that tells whether petmjx wrote a file of ``folder``.

    Raises:
        InputError: a file may not be written. The message names the first such file and the reason.
    """
    read = list(inputs)
    if folder is not None:
        check_folder(folder)
    for file in files:
        if folder is not None:
            _check_way(file, folder)
        elif str(file.absolute()).startswith("/dev/"):  # no check, since /dev/stdout may be a link to a file
            continue
        _check(file, overwrite, read, None if folder is None else is_ours)


def check_folder(folder: Path) -> None:
    """Check that a path is a folder or can become one. Nothing is changed on disk.

    Raises:
        InputError: the path, or a path above it, exists but is not a folder.
    """
    with _path_errors(folder):
        ancestor = next((path for path in (folder, *folder.parents) if os.path.lexists(path)), folder)
        usable = ancestor.is_dir() or not os.path.lexists(ancestor)
        kind = "a file" if ancestor.is_file() else "not a folder"
    if not usable:
        content = f"is {kind}" if ancestor == folder else f"cannot be written: {_name(ancestor)} is {kind}"
        raise InputError(f"{_name(folder)}: {content}; name a folder")


def _check_way(file: Path, folder: Path) -> None:
    """Check the folders between the named folder and the file. petmjx makes these folders itself, so none of them may
    be a link or a file."""
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
            raise InputError(f"{_name(file)}: is an input, so it cannot be written; name another {kind}")
        if stat.S_ISLNK(mode):
            raise InputError(_link(file))
    if stat.S_ISDIR(mode):
        raise InputError(f"{_name(file)}: cannot be written: is a folder")
    if is_ours is None:
        if stat.S_ISREG(mode) and not overwrite:
            raise InputError(
                f"{_name(file)}: exists already; name another file, or pass {option('--overwrite', 'True')}"
            )
        return  # existing FIFOs and devices are no obstacle: if the user names one, it is written to
    if not stat.S_ISREG(mode):
        raise InputError(f"{_name(file)}: cannot be written: is not a regular file")
    if not is_ours(file):
        raise InputError(
            f"{_name(file)}: was not written by petmjx, so petmjx does not replace it; name another folder"
        )
    if not overwrite:
        raise InputError(f"{_name(file)}: exists already; name another folder, or pass {option('--overwrite', 'True')}")


def _is_read(file: Path, source: Path) -> bool:
    """Whether a path leads to the input file ``source``, or into the input folder ``source``."""
    target, read = file.resolve(), source.resolve()
    if read in (target, *target.parents):
        return True
    return os.path.exists(file) and os.path.exists(source) and os.path.samefile(file, source)


@contextmanager
def _path_errors(path: Path) -> Iterator[None]:
    """Context in which a path is examined: a system error becomes an InputError that names the path."""
    try:
        yield
    # these errors are raised, for example, if the name contains a NUL, or if links form a circle
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{_name(path)}: cannot be written: {reason(error)}") from error


def _link(path: Path) -> str:
    return f"{_name(path)}: is a link, and petmjx does not write through links; name another path"


def _name(path: Path) -> str:
    return printable(str(path))
