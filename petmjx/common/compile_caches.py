"""Where compiled programs are kept: JAX's and Warp's, under ``$PETMJX_CACHE_DIR`` (default: ``~/.cache/petmjx``).

A folder that cannot be written, such as that of a home that is read-only, is no reason to stop: a temporary one of the
user's own takes its place.
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
"""In which environment variable JAX and Warp themselves look for their folder; it comes before petmjx's."""


def wanted_folder(kind: Kind) -> Path:
    """The folder for compiled programs that was asked for; it may be one that cannot be written.

    Raises:
        RuntimeError: there is no home folder, and no other one was named.
    """
    if named := os.environ.get(VARIABLES[kind]):
        return Path(named)
    named = os.environ.get("PETMJX_CACHE_DIR")
    return (Path(named) if named else Path.home() / ".cache" / "petmjx") / kind


def why_not_written(kind: Kind) -> str:
    """Why the folder that was asked for cannot be used; "" if it can."""
    try:
        folder = wanted_folder(kind)
    except RuntimeError as error:
        return f"no home folder: {reason(error)}"
    why = _why_unusable(folder)
    return f"{printable(str(folder))} cannot be written: {why}" if why else ""


def cache_folder(kind: Kind) -> Path:
    """The folder for compiled programs, which can be written: the one that was asked for, or a temporary one.

    Raises:
        EngineUnavailable: neither can be written.
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
    """Why nothing can be written into a folder, which is made if it is not there; "" if it can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Warp makes a folder for each of its versions; one that root has made in a user's home cannot be written
        for place in (folder, *(entry for entry in folder.iterdir() if entry.is_dir() and entry.name[:1].isdigit())):
            with tempfile.TemporaryFile(dir=place):
                pass
    except (OSError, ValueError) as error:
        return reason(error)
    return ""


@functools.cache
def temporary_folder() -> Path:
    """A folder among the temporary ones that only this user can write: the same for all processes where nobody else has
    its name, else one of this process. Raises OSError.
    """
    folder = Path(tempfile.gettempdir()) / f"petmjx-cache-{os.getuid()}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    status = folder.lstat()
    # whoever could put files there could have this user run them
    is_ours = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
    if is_ours and not _why_unusable(folder):
        return folder
    folder = Path(tempfile.mkdtemp(prefix="petmjx-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
