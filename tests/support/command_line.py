"""Helpers for tests of the command line: plans, files, runs, and the single line of an error."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from petmjx.cli import main


def placement(corner: Sequence[float], **item: Any) -> dict[str, Any]:
    """A box of 400 × 300 × 200 mm and 5 kg as in plan files. ``item``: other fields of the box's item."""
    size = {"length/mm": 400, "width/mm": 300, "height/mm": 200}
    fields = {"article": "carton", "id": "1", "product_group": "test", **size, "weight/kg": 5.0, "sequence": 1, **item}
    return {"item": fields, "orientation": 0, "flb_coordinates": list(corner)}


TOWER = [placement((0, 0, 0)), placement((0, 0, 200))]
OVERHANG = [placement((0, 0, 0)), placement((260, 0, 200))]
"""A tower that stands, and a plan with a box that falls, since more than half of this box overhangs."""


def write(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def run_process(*arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run petmjx in a process of its own. ``options`` are those of ``subprocess.run``."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.run([sys.executable, "-m", "petmjx", *map(str, arguments)], text=True, check=False, **streams)


def run_with_closed(descriptor: int, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run petmjx in a process whose stdout (1) or stderr (2) is closed. A shell closes it: Python would fork this
    process to do so, which JAX's threads do not survive."""
    command = ["sh", "-c", f'exec "$@" {descriptor}>&-', "sh", sys.executable, "-m", "petmjx", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def only_line(stderr: str) -> str:
    """The error message, which must be a single line."""
    lines = stderr.strip().splitlines()
    assert len(lines) == 1, stderr
    assert lines[0].startswith("petmjx: ")
    return lines[0]
