"""For bundled plans the story (``petmjx.tell``: what happens to the pallet, in words) agrees with the run."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.histories import assert_tells

import petmjx
from petmjx.plans.bundled import bundled_path

MOST_BOXES = 20
"""Larger plans show no further reason, and take five times as long."""


@pytest.mark.slow
def test_the_story_of_a_bundled_plan_is_the_runs(tmp_path: Path) -> None:
    plans = [plan for plan in petmjx.load_plans(bundled_path()) if plan.n_boxes <= MOST_BOXES]
    run = petmjx.score(plans, engine="mujoco", out=tmp_path / "run")
    assert set(run.worlds["reason"].fillna("")) == {"", "drop", "shift"}
    for plan_id in run.worlds["plan_id"]:
        story = petmjx.tell(plan_id, run, details=False)
        assert story.note == ""
        assert_tells(story, run)
