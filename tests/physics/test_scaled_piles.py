"""If all lengths of a pile are scaled, and the thresholds that are lengths as well, no verdict changes unless the world
has a flag for doubtful cases."""

from __future__ import annotations

import pandas as pd

from benchmarks.scaled_piles import changes, scaled
from petmjx.engines.verdict import Flag

SEED = 43242
"""Seed of the 500 piles in docs/validation.md. The tests use the first of these piles."""


def test_no_verdict_of_a_scaled_pile_changes() -> None:
    worlds = scaled(SEED, 6, "mujoco", factors=(0.5, 2.0))
    assert len(worlds) == 12
    assert set(worlds["verdict"]) == {"stable", "unstable"}
    assert not [plan_id for plan_id, _, flagged in changes(worlds) if not flagged]


def test_changes_are_found() -> None:
    worlds = pd.DataFrame(
        [
            ("same", "stable", 0),
            ("same", "stable", int(Flag.KNIFE_EDGE)),
            ("says so", "stable", 0),
            ("says so", "unstable", int(Flag.KNIFE_EDGE)),
            ("silent", "stable", int(Flag.LEANS)),
            ("silent", "unstable", 0),
        ],
        columns=["plan_id", "verdict", "flags"],
    )
    assert [(plan_id, flagged) for plan_id, _, flagged in changes(worlds)] == [("says so", True), ("silent", False)]
