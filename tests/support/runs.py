"""Runs as they are left behind."""

from __future__ import annotations

import json
from pathlib import Path


def leave_unfinished(folder: Path) -> None:
    """Say of a run that it was interrupted."""
    file = folder / "run.json"
    info = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps(info | {"status": "interrupted"}), encoding="utf-8")
