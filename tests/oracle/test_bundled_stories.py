"""For bundled plans the story (``petmjx.tell``: what happens to the pallet, in words) agrees with the run."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.histories import assert_tells

import petmjx
from petmjx.plans.bundled import bundled_path

MOST_BOXES = 8
"""Larger plans take many times as long."""

SHIFTS = "s0-001784"
"""The smallest bundled plan in which a box shifts."""


@pytest.mark.slow
def test_the_story_of_a_bundled_plan_is_the_runs(tmp_path: Path) -> None:
    plans = [p for p in petmjx.load_plans(bundled_path()) if p.n_boxes <= MOST_BOXES or p.plan_id == SHIFTS]
    run = petmjx.score(plans, engine="mujoco", out=tmp_path / "run")
    assert set(run.worlds["reason"].fillna("")) == {"", "drop", "shift"}
    for plan_id in run.worlds["plan_id"]:
        story = petmjx.tell(plan_id, run, details=False)
        assert story.note == ""
        assert_tells(story, run)
