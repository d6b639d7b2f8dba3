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
"""The environment variable that JAX or Warp itself uses for its folder. This variable takes precedence over petmjx's
variable."""


def wanted_folder(kind: Kind) -> Path:
    """The folder for compiled programs according to the environment. Whether the folder is writable is not checked.

    Raises:
        RuntimeError: there is no home folder, and no variable names a folder.
    """
    if folder_text := os.environ.get(VARIABLES[kind]):
        return Path(folder_text)
    folder_text = os.environ.get("PETMJX_CACHE_DIR")
    return (Path(folder_text) if folder_text else Path.home() / ".cache" / "petmjx") / kind


def why_not_written(kind: Kind) -> str:
    """Why the wanted folder cannot be used; "" if it can."""
    try:
        folder = wanted_folder(kind)
    except RuntimeError as error:
        return f"no home folder: {reason(error)}"
    fault = _why_unusable(folder)
    return f"{printable(str(folder))} cannot be written: {fault}" if fault else ""


def cache_folder(kind: Kind) -> Path:
    """A writable folder for compiled programs: the wanted one, or else a temporary one.

    Raises:
        EngineUnavailable: neither is writable.
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
    """Why there is no folder for compiled programs at all; None if there is one."""
    try:
        cache_folder(kind)
    except EngineUnavailable as error:
        return str(error)
    return None


@functools.cache
def _why_unusable(folder: Path) -> str:
    """Why nothing can be written into a folder; "" if something can. A missing folder is created."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Warp makes a folder for each of its versions; if root made one in a user's home, the user cannot write to it
        for place in (folder, *(entry for entry in folder.iterdir() if entry.is_dir() and entry.name[:1].isdigit())):
            with tempfile.TemporaryFile(dir=place):
                pass
    except (OSError, ValueError) as error:
        return reason(error)
    return ""


@functools.cache
def temporary_folder() -> Path:
    """A temporary folder that only this user can write to. Raises OSError.

    All processes of the user share this folder. If the folder of this name belongs to another user, this process gets a
    folder of its own.
    """
    folder = Path(tempfile.gettempdir()) / f"petmjx-cache-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    # anyone who can write to this folder can make this user run their programs
    is_ours = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
    if is_ours and not _why_unusable(folder):
        return folder
    folder = Path(tempfile.mkdtemp(prefix="petmjx-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
