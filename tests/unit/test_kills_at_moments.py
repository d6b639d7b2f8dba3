"""Tests of runs that are killed, or whose disk becomes full, at certain moments. The results written before are kept,
and the run can be continued.

tests/support/kills_at_moments.py tests all moments, which takes minutes.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.kills_at_moments import KINDS, Run, fill
from support.programs import run_program


@pytest.mark.parametrize(
    ("kind", "lasts", "at"),
    [
        ("unordered", False, 12),  # while run.json is written
        ("unordered", False, 20),  # during placements
        ("unordered", False, 40),  # while a part of a table is written
        ("unordered", True, 60),
        ("in order", False, 80),  # while run.json is written at the end
        ("resumed", False, 9),
        ("resumed", True, 25),
        ("other order", False, 30),  # while rows get other ranks (positions in the table)
        ("other order", True, 40),
        ("merged", False, 50),
    ],
)
def test_a_disk_that_is_full(kind: str, lasts: bool, at: int, tmp_path: Path) -> None:
    assert fill(Run(kind, tmp_path), tmp_path / "out", at, lasts)


def test_a_kill(tmp_path: Path) -> None:
    script = Path(__file__).parents[1] / "support" / "kills_at_moments.py"
    printed = run_program(script, str(tmp_path / "runs"), "37", "1", "1", folder=tmp_path)
    assert printed.count("killed at") == len(KINDS)
