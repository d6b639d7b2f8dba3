"""For every bundled plan the story (``petmjx.tell``: what happens to the pallet, in words) agrees with the run."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.histories import assert_tells

import petmjx


@pytest.mark.slow
def test_the_story_of_every_bundled_plan_is_the_runs(tmp_path: Path) -> None:
    run = petmjx.score(engine="mujoco", out=tmp_path / "run")
    assert set(run.worlds["verdict"]) == {"stable", "unstable"}
    for plan_id in run.worlds["plan_id"]:
        story = petmjx.tell(plan_id, run, details=False)
        assert story.note == ""
        assert_tells(story, run)
