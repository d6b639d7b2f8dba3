"""Folders for compiled programs of JAX and Warp, under ``$PETMJX_CACHE_DIR`` (default: ``~/.cache/petmjx``).

If the folder cannot be written, as in a read-only home, petmjx uses a temporary folder of the user instead.
"""

from __future__ import annotations

import atexit
import functools
import os
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final, Literal

from petmjx.common.checked_records import reason
from petmjx.common.errors import EngineUnavailable
from petmjx.common.text import printable

Kind = Literal["jax", "warp"]

VARIABLES: Final[dict[Kind, str]] = {"jax": "JAX_COMPILATION_CACHE_DIR", "warp": "WARP_CACHE_PATH"}
"""The variables in which JAX and Warp themselves look for the folder of their compiled programs. The variables of JAX
and Warp take precedence over ``PETMJX_CACHE_DIR``."""


def wanted_folder(kind: Kind) -> Path:
    """The folder for compiled programs, according to environment variables. The folder may be missing or read-only.

    Raises:
        RuntimeError: there is no home folder, and no variable names a folder.
    """
    if folder_text := os.environ.get(VARIABLES[kind]):
        return Path(folder_text)
    folder_text = os.environ.get("PETMJX_CACHE_DIR")
    return (Path(folder_text) if folder_text else Path.home() / ".cache" / "petmjx") / kind


def why_not_written(kind: Kind) -> str:
    """The reason why compiled programs cannot be stored in ``wanted_folder``; "" if they can be stored there."""
    try:
        folder = wanted_folder(kind)
    except RuntimeError as error:
        return f"no home folder: {reason(error)}"
    fault = _why_unusable(folder)
    return f"{printable(str(folder))} cannot be written: {fault}" if fault else ""


def cache_folder(kind: Kind) -> Path:
    """A writable folder for compiled programs: ``wanted_folder`` if it is writable, otherwise a temporary folder.

    Raises:
        EngineUnavailable: no folder is writable.
    """
    if why := why_not_written(kind):
        try:
            return temporary_folder() / kind
        except OSError as error:
            raise EngineUnavailable(
                f"no folder for compiled programs: {why}, and no temporary one ({reason(error)}); set PETMJX_CACHE_DIR"
            ) from error
    return wanted_folder(kind)


def why_no_folder(kind: Kind) -> str | None:
    """The reason why there is no writable folder for compiled programs; None if there is one."""
    try:
        cache_folder(kind)
    except EngineUnavailable as error:
        return str(error)
    return None


@functools.cache
def _why_unusable(folder: Path) -> str:
    """The reason why nothing can be written into a folder; "" if the folder is writable. If the folder does not exist,
    it is created."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Warp makes a subfolder for each of its versions, and all of them must be writable. If root once ran Warp with
        # a user's cache, the user cannot write to the subfolder that root made.
        for place in (folder, *(entry for entry in folder.iterdir() if entry.name[:1].isdigit() and entry.is_dir())):
            with tempfile.TemporaryFile(dir=place):
                pass
    except (OSError, ValueError) as error:
        return reason(error)
    return ""


@functools.cache
def temporary_folder() -> Path:
    """A temporary folder that only this user can write to. Raises OSError if the folder cannot be made.

    All processes of the user share this folder. If another user owns a folder of this name, this process makes a folder
    that is used by no other process.
    """
    folder = Path(tempfile.gettempdir()) / f"petmjx-cache-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    # this process will run the programs in the folder, so no other user may be able to write to it
    is_ours = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
    if is_ours and not _why_unusable(folder):
        return folder
    folder = Path(tempfile.mkdtemp(prefix="petmjx-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
