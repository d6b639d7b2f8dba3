"""The path of the bundled plans."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def bundled_path() -> Path:
    """The file of the bundled plans. :mod:`petmjx.packers.handmade_plans` selects these plans and writes the file."""
    return Path(str(files(__package__) / "bundled.json"))
