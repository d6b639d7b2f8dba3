"""Runs of sweeps: every placement is simulated once, drives start at the exact step, the batches do not change the
worlds, and the answers are right."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.fake_engine import end_without_physics
from support.plan_files import placement
from support.plans import make_plan, make_scene, stack
from support.sweeps import EUMOS_GRID, QUICK, Recorder, leaning, write_sweep

import petmjx
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.running_metrics import OracleMetrics
from petmjx.engines.mujoco.world_run import WorldRun
from petmjx.engines.protocol import Progress, takes_stream
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.runs.forked_worlds import Batching
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_run import SweepRun
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.job import Job

SOONEST, LATEST = 200 + 115, 200 + 250
"""Smallest and largest number of steps of a drive with EUMOS's profile: 0.4 s at 2 ms, and at most 0.5 s until the
pallet rests."""


def test_32_profiles_cost_one_placement_and_32_profiles_to_the_step(tmp_path: Path) -> None:
    grid = EUMOS_GRID.replace("from = 0.05, to = 0.8, step = 0.05", "from = 0.1, to = 0.8, step = 0.1")
    plan = SweepPlan(load_sweep(write_sweep(tmp_path, QUICK + grid), plans_given=True), [leaning("a")])
    engine, progress = Recorder(2), Progress()
    run = SweepRun(plan, engine, progress=progress)
    worlds = list(run.worlds())
    (placements, _), (drives, _) = engine.batches
    assert [job.keep_state for job in placements] == [True]
    assert len(drives) == len(worlds) == 32
    assert all(job.start is drives[0].start and job.start is not None for job in drives)
    (alone,) = MujocoEngine(1).run([Job(placements[0].scene, keep_state=True)], run.sim)
    steps = [world.outcome.n_steps for world in worlds]
    assert progress.world_steps == alone.n_steps + sum(steps)
    assert (run.tally.placements, run.tally.placement_steps) == (1, alone.n_steps)
    assert (run.tally.drives, run.tally.drive_steps) == (32, sum(steps))
    assert min(steps) == SOONEST
    assert LATEST in steps
    waited_for = [world.outcome for world in worlds if world.outcome.n_steps > LATEST]
    assert 0 < len(waited_for) < 8
    # worlds with these reasons may still change until they rest
    assert {outcome.reason for outcome in waited_for} <= {Reason.NONE, Reason.SHIFT}
    assert not any(Flag.MOVING in outcome.flags for outcome in waited_for)
    assert sorted(world.variant.index for world in worlds) == list(range(1, 33))


MIXED = (
    """
seed = 3
replicates = 2
nominal = true
"""
    + QUICK
    + """
[axes]
placement_error_mm = [0, 3]
profile = "eumos-40509"
direction = [0, 90]
level = [0.3, 0.55]
"""
)


def sorted_tables(results: petmjx.RunResults) -> list[pd.DataFrame]:
    worlds = results.worlds.sort_values(["plan_id", "variant"], ignore_index=True)
    boxes = results.boxes.sort_values(["plan_id", "variant", "box"], ignore_index=True)
    assert results.summary is not None
    return [worlds, boxes, results.summary]


SEARCH = (
    QUICK
    + """
[axes]
friction_factor = [0.6, 1.0]
profile = "eumos-40509"
direction = ["+x", "+y"]
[search]
upper = 1.0
"""
)


COARSE_SEARCH = SEARCH + "tolerance = 0.05\n"
"""A search with fewer tests, for tests of how a search finds its answer."""


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> petmjx.RunResults:
    """The sweep ``MIXED`` of two plans, on one thread."""
    file = write_sweep(tmp_path_factory.mktemp("mixed"), MIXED)
    return petmjx.sweep(file, [leaning("a"), leaning("b", 3)], engine="mujoco", threads=1)


def assert_same_in_other_batches(one: petmjx.RunResults, file: Path, plans: list[petmjx.Plan]) -> None:
    """Check that several threads, another order of plans and small batches change no table of a sweep."""
    batching = Batching(placements=2, worlds=5, drives=3)
    other = petmjx.sweep(file, plans[::-1], engine="mujoco", threads=3, batching=batching)
    assert len(one.worlds) >= 18
    for mine, theirs in zip(sorted_tables(one), sorted_tables(other), strict=True):
        pd.testing.assert_frame_equal(mine, theirs, check_exact=True)


def test_threads_order_and_batches_change_no_grid(mixed: petmjx.RunResults, tmp_path: Path) -> None:
    assert_same_in_other_batches(mixed, write_sweep(tmp_path, MIXED), [leaning("a"), leaning("b", 3)])


def test_threads_order_and_batches_change_no_search(tmp_path: Path) -> None:
    file = write_sweep(tmp_path, SEARCH + "tolerance = 0.2\n")
    plans = [leaning("stands", 2, 90.0), leaning("falls", 2, -380.0)]
    assert_same_in_other_batches(petmjx.sweep(file, plans, engine="mujoco", threads=1), file, plans)


def test_a_collapsed_placement_is_not_shaken_and_worlds_have_parameters(tmp_path: Path) -> None:
    text = MIXED.replace("early_stop = false", "")
    engine = Recorder(2)
    results = petmjx.sweep(write_sweep(tmp_path, text), [leaning("stands"), leaning("falls", 2, -380.0)], engine=engine)
    worlds = results.worlds.set_index(["plan_id", "variant"]).sort_index()
    # 4 drives start from the exact placement, and 4 from each of 2 replicates with an error
    assert worlds.loc["stands"].index.tolist() == worlds.loc["falls"].index.tolist() == [*range(13)]
    falls = worlds.loc["falls"]
    assert set(falls["verdict"]) == {"unstable"}
    assert (falls["n_steps"].drop(index=0) == 0).all()
    assert (falls["flags"].drop(index=0) & int(Flag.FORKED) != 0).all()
    assert falls["sign_in_profile_s"].isna().all()
    assert not falls["eumos_passed"].drop(index=0).astype(bool).any()
    assert len([job for jobs, _ in engine.batches for job in jobs if job.start is not None]) == 12
    stands = worlds.loc["stands"]
    nominal = stands.loc[0]
    assert (nominal["verdict"], nominal["mode"]) == ("stable", "")
    assert pd.isna(nominal["profile"])
    assert np.isnan(nominal["level_g"])
    assert np.isfinite(nominal["rest_top_force_n"])
    slides = stands[stands["level_g"] == 0.55]
    assert set(slides["mode"]) == {"slide"}
    assert slides["sign_in_profile_s"].between(0.2, 0.9).all()
    assert (slides["eumos_permanent_share"] > 0).all()
    assert results.units("worlds")["level_g"] == "g"
    assert results.units("worlds")["eumos_foot_permanent_m"] == "m"


def test_the_summary_has_shares_with_intervals_and_units(mixed: petmjx.RunResults) -> None:
    results = mixed
    assert results.summary is not None
    summary = results.summary.query("scope == 'plan'").set_index(["plan_id", "axis", "value"])
    worlds = results.worlds
    chosen = worlds[(worlds["plan_id"] == "b") & (worlds["level_g"] == 0.3)]
    row = summary.loc[("b", "level_g", "0.3")]
    assert row["n_worlds"] == len(chosen) == 6
    assert row["n_standing"] == (chosen["verdict"] == "stable").sum()
    assert row["n_eumos_passed"] == chosen["eumos_passed"].sum()
    deformations = ["eumos_elastic_share", "eumos_permanent_share", "eumos_foot_permanent_m"]
    pd.testing.assert_series_equal(row[deformations], chosen[deformations].max(), check_names=False, check_dtype=False)
    assert row["n_draws"] == 0  # the placement without an error is the same in every replicate
    assert pd.isna(row["low"])
    drawn = summary.loc[("b", "placement_error_mm", "3")]
    # each replicate is one draw, although it is simulated at several levels and directions
    assert drawn["n_draws"] == 2
    assert drawn["low"] <= drawn["share"] <= drawn["high"]
    total = results.summary.query("scope == 'all' and axis == ''").iloc[0]
    assert pd.isna(total["plan_id"])
    assert total["n_worlds"] == len(worlds) == 26
    both = results.summary.query("scope == 'all' and axis == 'placement_error_mm' and value == '3'").iloc[0]
    assert both["n_draws"] == 4  # each plan has its own random numbers
    units = results.units("summary")
    assert units["share"] == units["n_eumos"] == "1"
    assert units["plan_id"] == ""


def test_drawn_axes_are_divided_into_ranges(tmp_path: Path) -> None:
    text = """
mode = "sample"
sample = 30
[simulation]
check = "static"
duration_s = 0.3
[axes]
friction_factor = { from = 0.2, to = 1.0 }
mass_factor = [0.5, 1.5]
"""
    results = petmjx.sweep(write_sweep(tmp_path, text), [leaning("a")], engine="mujoco")
    assert results.summary is not None
    friction = results.summary.query("plan_id == 'a' and axis == 'friction_factor'")
    assert friction["n_worlds"].sum() == 30
    assert set(friction["value"]) <= {f"{0.2 + 0.1 * k:.4g} to {0.3 + 0.1 * k:.4g}" for k in range(8)}
    assert set(results.summary.query("axis == 'mass_factor'")["value"]) == {"0.5", "1.5"}
    assert "sign_in_profile_s" not in results.worlds


def test_a_search_finds_the_largest_level_survived(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    plans = [leaning("stands"), leaning("falls", 2, -380.0)]
    results = petmjx.sweep(write_sweep(tmp_path, SEARCH), plans, engine="mujoco", out=folder)
    assert results.summary is not None
    summary = results.summary.set_index(["plan_id", "friction_factor", "direction_deg"])
    answer = summary.loc[("stands", 1.0, 0.0)]
    # sliding begins at 0.5 g; since the level is held for only 0.3 s, a shift of 20 mm needs a little more
    assert 0.5 <= answer["largest_level_g"] <= 0.56
    assert answer["first_failed_level_g"] == pytest.approx(answer["largest_level_g"] + 0.01)
    assert answer["mode"] == "slide"
    assert answer["article"] == f"article-{answer['box']}"
    assert 0.2 <= answer["sign_in_profile_s"] <= 0.9
    assert summary.loc[("stands", 0.6, 0.0), "largest_level_g"] < 0.4
    worlds = results.worlds
    mine = worlds.query("plan_id == 'stands' and friction_factor == 1 and direction_deg == 0").set_index("level_g")
    assert len(mine) == answer["n_tests"]
    assert mine.loc[answer["largest_level_g"], "verdict"] == "stable"
    assert mine.loc[answer["first_failed_level_g"], "verdict"] == "unstable"
    assert answer["eumos_passed"] == mine.loc[answer["largest_level_g"], "eumos_passed"]
    fallen = summary.loc[("falls", 1.0, 0.0)]
    assert not fallen["stands_at_rest"]
    assert np.isnan(fallen["largest_level_g"])
    assert (fallen["box"], fallen["mode"], fallen["n_tests"]) == (1, "tilt", 0)
    # there is one row without a simulation for each search of this plan
    assert worlds.query("plan_id == 'falls'")["n_steps"].tolist() == [0] * 4
    assert results.units("summary")["largest_level_g"] == "g"


class _Rounds:
    """An engine that takes jobs in lists and counts its runs."""

    name = "mujoco"

    def __init__(self) -> None:
        self.runs = 0

    def run(self, jobs: Any, sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        self.runs += 1
        yield from MujocoEngine(2).run(jobs, sim, progress)


class _OneRun(_Rounds):
    """The same engine as one that takes a stream of jobs."""

    @takes_stream
    def run(self, jobs: Any, sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        yield from super().run(jobs, sim, progress)


def test_the_searches_of_a_sweep_do_not_wait_for_one_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine that takes a stream makes all placements and tests in one run. Answers and worlds are those of an
    engine that needs a run for each round of tests."""
    monkeypatch.setattr(WorldRun, "run", end_without_physics)
    plans = [leaning("a"), leaning("b", 2, -100.0)]
    tables = {}
    for streams in (True, False):
        engine = _OneRun() if streams else _Rounds()
        results = petmjx.sweep(write_sweep(tmp_path, COARSE_SEARCH), plans, engine=engine)
        assert results.summary is not None
        # with rounds, there is one run for the placements, and one run for each round of a search
        assert (engine.runs == 1) == streams
        order = ["plan_id", "variant"]
        tables[streams] = results.worlds.sort_values(order).reset_index(drop=True), results.summary
    assert results.summary.largest_level_g.nunique() > 1
    for one, other in zip(*tables.values(), strict=True):
        pd.testing.assert_frame_equal(
            one.drop(columns="wall_s", errors="ignore"), other.drop(columns="wall_s", errors="ignore")
        )


class _NeverBelieved(Recorder):
    """An engine all of whose outcomes are invalid."""

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for outcome in super().run(jobs, sim, progress):
            yield replace(outcome, verdict=Verdict.INVALID, reason=Reason.NONFINITE)


def test_states_are_never_shared_between_timesteps(tmp_path: Path) -> None:
    engine = _NeverBelieved(1)
    results = petmjx.sweep(write_sweep(tmp_path, QUICK + EUMOS_GRID), [leaning("a", 1)], engine=engine)
    assert len(engine.batches) == 4
    assert {sim.physics.timestep_s for _, sim in engine.batches} == {0.002}
    assert set(results.worlds["reason"]) == {"nonfinite"}
    assert results.worlds["mode"].unique().tolist() == ["nonfinite"]
    assert results.worlds["eumos_passed"].isna().all()


def test_a_hard_landing_is_no_sign_of_the_drive() -> None:
    scene = make_scene(2)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    metrics = OracleMetrics(scene, Thresholds())
    metrics.add_pose(0.2, scene.target - np.array([0.0, 0.0, 0.03]), upright)
    assert metrics.culprit == 0
    over = metrics.fork()
    over.begin_drive(scene.target + np.array([0.03, 0.0, 0.0]), upright)
    assert (over.culprit, over.first_sign_s) == (0, 0.2)
    metrics.begin_drive(scene.target, upright)
    assert metrics.culprit == -1
    metrics.add_pose(1.0, scene.target + np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0]]), upright)
    assert (metrics.culprit, metrics.first_sign_s) == (1, 1.0)


ASKEW = (((400, 300, 200), (0, 0, 0), 6.0), ((300, 200, 150), (50, 50, 260), 3.0))
"""The second box falls by 60 mm and then lies flat. So the placement does not stand, although no box dropped off the
pallet."""

GENTLE = QUICK.replace("early_stop = false", "") + '[axes]\nprofile = "eumos-40509"\nlevel = [0.05, 0.1]\n'


def test_what_does_not_stand_is_not_shaken_and_passes_nothing(tmp_path: Path) -> None:
    engine = Recorder(2)
    plans = [make_plan("askew", ASKEW), make_plan("stands", stack(2))]
    results = petmjx.sweep(write_sweep(tmp_path, GENTLE), plans, engine=engine)
    worlds = results.worlds.set_index("plan_id")
    askew, stands = worlds.loc["askew"], worlds.loc["stands"]
    assert set(askew["verdict"]) == {"unstable"}
    assert set(askew["reason"]) == {"shift"}
    assert (askew["n_steps"] == 0).all()
    assert set(askew["eumos_passed"]) == {False}
    assert askew["eumos_permanent_share"].isna().all()
    assert set(stands["eumos_passed"]) == {True}
    assert results.summary is not None
    summary = results.summary[results.summary["axis"] == ""]
    of_askew, of_all = summary[summary["plan_id"] == "askew"], summary[summary["scope"] == "all"]
    assert of_askew[["n_worlds", "n_eumos", "n_eumos_passed"]].to_numpy().tolist() == [[2, 2, 0]]
    assert of_all[["n_worlds", "n_eumos", "eumos_share"]].to_numpy().tolist() == [[4, 4, 0.5]]
    assert len([job for jobs, _ in engine.batches for job in jobs if job.start is not None]) == 2


def test_without_early_stop_it_is_shaken_but_passes_nothing(tmp_path: Path) -> None:
    file = write_sweep(tmp_path, GENTLE.replace("[axes]", "early_stop = false\n[axes]"))
    results = petmjx.sweep(file, [make_plan("askew", ASKEW)], engine="mujoco")
    assert (results.worlds["n_steps"] > 0).all()
    assert set(results.worlds["verdict"]) == {"unstable"}
    assert set(results.worlds["eumos_passed"]) == {False}
    assert results.worlds["eumos_permanent_share"].notna().all()


class _Forgiving(Recorder):
    """A fake engine. In its outcomes, placements do not stand, but after a drive all boxes are within their limits."""

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for outcome in super().run(jobs, sim, progress):
            if jobs[outcome.job].drive is None:
                yield replace(outcome, verdict=Verdict.UNSTABLE, reason=Reason.SHIFT, culprit=1, first_sign_s=0.4)
            else:
                yield outcome


def test_no_profile_makes_a_placement_stand(tmp_path: Path) -> None:
    file = write_sweep(tmp_path, GENTLE.replace("[axes]", "early_stop = false\n[axes]"))
    worlds = petmjx.sweep(file, [make_plan("a", stack(2))], engine=_Forgiving(1)).worlds
    assert worlds[["verdict", "reason", "culprit"]].to_numpy().tolist() == [["unstable", "shift", 1]] * 2
    assert set(worlds["eumos_passed"]) == {False}


def test_the_summary_is_of_petmjx_own_parts_wherever_they_lie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = write_sweep(tmp_path, "[axes]\nmass_factor = [0.9, 1.1]\n")
    (tmp_path / "s3:here/worlds").mkdir(parents=True)
    (tmp_path / "s3:here/worlds/notes.txt").write_text("mine")
    results = petmjx.sweep(file, leaning("a"), engine="mujoco", threads=1, out="s3:here")
    assert results.summary is not None
    assert results.summary.query("scope == 'all' and axis == ''").n_worlds.tolist() == [2]


def test_plans_may_lie_in_a_folder_of_any_name(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    (folder / "plans.json").write_text(json.dumps({"a": [placement()]}))
    file = write_sweep(folder, 'plans = "plans.json"\n[axes]\nmass_factor = 1.1\n')
    results = petmjx.sweep(file, engine="mujoco", threads=1, out=tmp_path / "out")
    assert results.worlds.plan_id.tolist() == ["a"]
    assert results.info["config"]["sweep"]["plans"] == [str(folder / "plans.json")]
