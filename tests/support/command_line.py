"""What tests of the command line share: files, runs, and the one line of an error."""

from __future__ import annotations

import json
from pathlib import Path

from petmjx.cli import main


def write(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def only_line(stderr: str) -> str:
    """The one line an error is allowed to take."""
    lines = stderr.strip().splitlines()
    assert len(lines) == 1, stderr
    assert lines[0].startswith("petmjx: ")
    return lines[0]
