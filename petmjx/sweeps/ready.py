"""The ready-made sweep files: in ``sweeps/`` of a checkout, or their copies in an installed package."""

from __future__ import annotations

from pathlib import Path

from petmjx.basics.errors import InputError

_PACKAGE = Path(__file__).resolve().parents[1]
_FOLDERS = (_PACKAGE / "ready_sweeps", _PACKAGE.parent / "sweeps")
"""The wheel has ``sweeps/`` as ``petmjx/ready_sweeps`` (pyproject.toml). In a checkout it is beside the package."""


def ready_sweeps() -> dict[str, Path]:
    """Name → file of each ready-made sweep, sorted by name."""
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    return {} if folder is None else {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find_sweep(name_or_path: str | Path) -> Path:
    """The file of a sweep: a path to one, or the name of a ready-made one such as ``eumos``.

    Raises:
        InputError: there is no such file or name; the line lists the ready-made names.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    ready = ready_sweeps()
    if str(name_or_path) in ready:
        return ready[str(name_or_path)]
    raise InputError(f"{name_or_path}: no such sweep file; ready-made sweeps are {', '.join(ready) or 'not installed'}")
