"""Processes that check the outcomes of a sweep: the same processes serve its placements and its drives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from support.command_line import write
from support.plans import make_plan, stack

import petmjx
from petmjx.engines.protocol import Engine
from petmjx.engines.subprocess.check_pool import CheckPool

FOUR_DRIVES = """
nominal = false
[simulation]
settle_s = 0.4
rest_s = 0.5
[axes]
profile = "eumos-40509"
level = [0.2, 0.3]
direction = ["+x", "+y"]
"""


def test_placements_and_drives_have_the_same_processes_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The processes start while boxes are placed, and end with the sweep. The results equal those without the
    processes."""
    file, plans = write(tmp_path / "x.toml", FOUR_DRIVES), [make_plan("a", stack(2)), make_plan("b", stack(2, -380.0))]
    alone = petmjx.sweep(file, plans, engine="mujoco", threads=1)
    begun: list[CheckPool[Any]] = []
    looks: list[int] = []
    exchanged = CheckPool[Any].exchanged

    def lookers_for(engine: Engine, worlds: int) -> CheckPool[Any]:
        assert worlds == len(alone.worlds)
        begun.append(CheckPool(1))
        return begun[0]

    def counted(self: CheckPool[Any], outcomes: Any, *args: Any, **how: Any) -> Any:
        assert self is begun[0]
        looks.append(len(outcomes))
        return exchanged(self, outcomes, *args, **how)

    monkeypatch.setattr("petmjx.runs.sweep_run.check_pool_for", lookers_for)
    monkeypatch.setattr(CheckPool, "exchanged", counted)
    results = petmjx.sweep(file, plans, engine="mujoco", threads=1)
    assert len(begun) == 1
    assert begun[0]._processes == []
    assert sum(looks) == 2 + 4  # two placements, and the four drives of the placement that stands
    for mine, theirs in ((alone.worlds, results.worlds), (alone.boxes, results.boxes)):
        pd.testing.assert_frame_equal(mine, theirs, check_exact=True)
