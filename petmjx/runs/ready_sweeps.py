"""Ready-made sweep files, by name. They are in the folder ``sweeps/`` of a checkout, and in an installed package."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name

_PACKAGE = Path(__file__).resolve().parents[1]
_FOLDERS = (_PACKAGE / "ready_sweeps", _PACKAGE.parent / "sweeps")
"""Folders of ready-made sweep files. The wheel has ``sweeps/`` as ``petmjx/ready_sweeps`` (pyproject.toml). In a
checkout, ``sweeps/`` is beside the package."""


def ready_sweeps() -> dict[str, Path]:
    """Name → file of each ready-made sweep, sorted by name."""
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    return {} if folder is None else {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find_sweep(name_or_path: str | Path) -> Path:
    """The path of a sweep file. The argument is this path, or the name of a ready-made sweep such as ``eumos``.

    Raises:
        InputError: there is no such file and no ready-made sweep with this name. The message lists the ready-made
            sweeps.
    """
    path = Path(name_or_path)
    with suppress(OSError, ValueError):  # for example, the name is too long or has a null character
        if path.is_file():
            return path
    files_by_name = ready_sweeps()
    if str(name_or_path) in files_by_name:
        return files_by_name[str(name_or_path)]
    ready_names = ", ".join(files_by_name) or "not installed"
    fault = "no such sweep file"
    with suppress(OSError, ValueError):
        if path.exists():
            fault = f"is {'a folder' if path.is_dir() else 'a device'}, not a sweep file"
    raise InputError(f"{printable_name(str(name_or_path))}: {fault}; ready-made sweeps are {ready_names}")
