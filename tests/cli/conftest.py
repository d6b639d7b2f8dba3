"""Fixtures for the tests of several commands."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.command_line import OVERHANG, TOWER, write


@pytest.fixture
def plans(tmp_path: Path) -> Path:
    """A file with two plans: a tower that stands, and a box that overhangs by more than half and falls."""
    return write(tmp_path / "plans.json", {"tower": TOWER, "overhang": OVERHANG})
