"""Stories: a world of a run, simulated again or as it was recorded, and the messages if neither is possible."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.histories import Forgetful, assert_equal, assert_tells
from support.plan_files import placement, tower
from support.plans import make_plan, stack
from support.runs import edit_info, keep_nothing, relisted

import petmjx
from petmjx.common.errors import EngineUnavailable, InputError, PetmjxError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Verdict
from petmjx.plans.plan import Plan

SWEEP = """
nominal = true
[simulation]
settle_s = 0.3
rest_s = 0.3
[axes]
profile = ["eumos-40509"]
level = [0.2, 1.5]
"""


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    file = tmp_path / "plans.json"
    overhang = [placement(), placement(corner=(450, 0, 220), sequence=2)]
    file.write_text(json.dumps({"tower": tower(2), "overhang": overhang}))
    return file


def test_a_story_is_the_runs(plan_file: Path, tmp_path: Path) -> None:
    run = petmjx.score(plan_file, engine="mujoco", out=tmp_path / "run", check="static", duration_s=1.0)
    for plan_id in ("tower", "overhang"):
        story = petmjx.tell(plan_id, run.path)
        assert_tells(story, run)
        assert (story.engine, story.note, story.variant, story.values) == ("mujoco", "", 0, {})
        assert story.options["check"] == "static"
        assert story.history.contacts is not None


def test_a_recorded_story_is_played(plan_file: Path, tmp_path: Path) -> None:
    run = petmjx.score(plan_file, engine="mujoco", out=tmp_path / "run", record="failed", record_interval_s=0.1)
    story = petmjx.tell("overhang", run)
    assert_tells(story, run)
    assert np.diff(story.history.time_s).max() == pytest.approx(0.1)
    assert story.history.contacts is None
    fresh = petmjx.tell("overhang", run, interval_s=0.1, details=False)
    assert_equal(story.history, fresh.history)
    np.testing.assert_allclose(story.outcome.boxes.max_tilt_deg, fresh.outcome.boxes.max_tilt_deg, rtol=1e-6)
    np.testing.assert_array_equal(story.scene.half_size, fresh.scene.half_size)
    assert petmjx.tell("overhang", run, details=True).history.contacts is not None


@pytest.mark.parametrize("searched", [False, True], ids=["grid", "search"])
def test_stories_of_a_sweep_have_placement_and_drive(searched: bool, plan_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    search = "[search]\nlower = 0.1\nupper = 1.5\ntolerance = 0.2\nsections = 2\n"
    file.write_text(SWEEP.replace("level = [0.2, 1.5]\n", search) if searched else SWEEP)
    run = petmjx.sweep(file, plan_file, engine="mujoco", out=tmp_path / "run", record="tower", record_interval_s=0.1)
    assert set(run.histories["plan_id"]) == {"tower"}
    variants = run.worlds.loc[run.worlds["plan_id"] == "tower", "variant"].tolist()
    assert sorted(run.histories["variant"].unique()) == sorted(variants)
    for variant in variants:
        played = petmjx.tell("tower", run, variant=variant)
        story = petmjx.tell("tower", run, variant=variant, interval_s=0.1, details=False)
        assert_tells(story, run)
        assert story.name == played.name == f"tower, variant {variant}"
        assert_equal(played.history, story.history)
        assert (story.drive is None) == (variant == 0)
        if variant:
            assert played.values["level_g"] == story.values["level_g"]
            assert story.drive is not None
            assert played.drive is not None
            assert played.drive.scale == story.drive.scale == story.values["level_g"]
            driven = story.history.drive.any(axis=1)
            assert not driven[0]
            assert driven.any()
    fallen = run.worlds[(run.worlds["plan_id"] == "overhang") & (run.worlds["variant"] > 0)].iloc[0]
    undriven = petmjx.tell("overhang", run, variant=int(fallen["variant"]))
    assert undriven.drive is None
    assert (undriven.outcome.verdict, undriven.outcome.reason) == (fallen["verdict"], fallen["reason"])


def test_a_story_without_a_run(plan_file: Path) -> None:
    story = petmjx.tell("tower", plan_file, engine="mujoco", check="static", duration_s=0.5)
    assert story.outcome.verdict is Verdict.STABLE
    assert story.history.time_s[0] == 0.0
    assert petmjx.tell("hand-one-box").plan.plan_id == "hand-one-box"


def test_another_engine_takes_the_place_of_one_that_cannot_run(
    plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = petmjx.score(plan_file, engine="mujoco", out=tmp_path / "run")
    edit_info(run.path, lambda info: info["config"].update(engine="mjx-warp"))

    from petmjx.analysis import story as module

    def make_engine(name: str, **options: Any) -> MujocoEngine:
        if name == "mjx-warp":
            raise EngineUnavailable("engine mjx-warp cannot run here: no CUDA device")
        return MujocoEngine(1)

    monkeypatch.setattr(module, "make_engine", make_engine)
    note = petmjx.tell("overhang", run.path).note
    assert note.startswith("simulated on mujoco: engine mjx-warp cannot run here: no CUDA device; as in the run: unst")
    changed = run.worlds.assign(verdict="stable", reason="", culprit=pd.NA)
    changed.to_parquet(run.path / "worlds" / "part-00000.parquet")
    relisted(run.path)
    note = petmjx.tell("overhang", run.path).note
    assert "; in the run: stable; here: unstable by tilt, first box 1" in note


def test_what_a_story_needs_and_is_not_there_is_said_in_a_line(plan_file: Path, tmp_path: Path) -> None:
    run = petmjx.score(plan_file, engine="mujoco", out=tmp_path / "run").path
    file = tmp_path / "x.toml"
    file.write_text(SWEEP)
    swept = petmjx.sweep(file, plan_file, engine="mujoco", out=tmp_path / "swept", limit=1).path
    moved = plan_file.rename(tmp_path / "moved.json")

    def refused(line: str, *arguments: Any, **options: Any) -> None:
        with pytest.raises(InputError, match=line) as error:
            petmjx.tell(*arguments, **options)
        assert "\n" not in str(error.value)

    refused("run: plan nothing is not among its 2 plans", "nothing", run)
    assert petmjx.tell("tower", run).outcome.verdict is Verdict.STABLE, "the run has kept it"
    for folder in (run, swept):
        keep_nothing(folder)
    refused("run: plan tower came from .*plans.json, which no longer exists", "tower", run)
    assert petmjx.tell("tower", run, plans=moved).outcome.verdict is Verdict.STABLE
    refused("swept: plan tower has no variant 7", "tower", swept, plans=moved, variant=7)
    refused("run: plan tower has no variant 1", "tower", run, plans=moved, variant=1)
    refused("schedule: a world of a run has the run's options; drop this option", "tower", run, schedule="fixed")
    refused("the arguments variant and plans select a world of a run", "tower", moved, variant=1)
    refused("plan none is not among the 2 plans read", "none", moved)
    refused("no such file", "tower", tmp_path / "nowhere")
    refused("interval_s must be > 0, got -1", "tower", moved, interval_s=-1)
    with pytest.raises(PetmjxError, match="plan tower: there are no frames: engine forgetful records no histories"):
        petmjx.tell("tower", moved, engine=Forgetful(1))
    file.write_text(SWEEP.replace("1.5", "1.4"))
    refused("x.toml: the sweep file has changed since the run .*swept", "tower", swept, plans=moved)
    file.unlink()
    refused("swept: the sweep file from which the run was made no longer exists", "tower", swept, plans=moved)
    plan_file.write_text(json.dumps({"tower": tower(3)}))
    refused("plans.json: plan tower has changed since .*run simulated it", "tower", run)


def test_plans_in_memory_are_found_where_they_are_given(tmp_path: Path) -> None:
    plans: list[Plan] = [make_plan("stands", 1), make_plan("falls", stack(2, 250.0))]
    run = petmjx.score(plans, engine="mujoco", out=tmp_path / "run")
    assert_tells(petmjx.tell("falls", run, plans=plans), run)
