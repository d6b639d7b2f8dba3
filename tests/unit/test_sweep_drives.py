"""Drives (motions of placed pallets) in sweeps: from which placement each drive starts, and what ends it."""

from __future__ import annotations

from collections import Counter
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
from support.sweeps import EUMOS_GRID, QUICK, Recorder, leaning, write_sweep

import petmjx
from petmjx.engines.verdict import Flag
from petmjx.runs.sweep_cost import job_bounds
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_run import SweepRun
from petmjx.runs.sweep_worlds import SweepPlan

STACKS = [leaning(f"of {n}", n) for n in (1, 3)]


def test_drives_start_from_their_own_placement(tmp_path: Path) -> None:
    grid = EUMOS_GRID.replace("from = 0.05, to = 0.8, step = 0.05", "from = 0.1, to = 0.2, step = 0.1")
    plan = SweepPlan(
        load_sweep(write_sweep(tmp_path, QUICK + grid), plans_given=True), [leaning(f"of {n}", n) for n in (1, 2, 3)]
    )
    engine = Recorder(1)
    run = SweepRun(plan, engine)
    assert {(world.plan.n_boxes, world.outcome.n_boxes) for world in run.worlds()} == {(1, 1), (2, 2), (3, 3)}
    drives = [job for batch, _ in engine.batches[1:] for job in batch]
    assert Counter(job.scene.n_boxes for job in drives if job.drive) == {1: 8, 2: 8, 3: 8}
    assert len({(job.scene.n_boxes, id(job.start)) for job in drives}) == 3


def test_worlds_of_a_placement_that_is_not_driven_are_final_before_any_drive(tmp_path: Path) -> None:
    plans = [leaning("falls", 2, 300.0), leaning("stands")]
    grid = EUMOS_GRID.replace("from = 0.05, to = 0.8, step = 0.05", "from = 0.2, to = 0.8, step = 0.3")
    text = QUICK.replace("early_stop = false", "") + grid
    sweep = load_sweep(write_sweep(tmp_path, text), plans_given=True)
    run = SweepRun(SweepPlan(sweep, plans), Recorder(1))
    assert [world.plan.plan_id for world in run.worlds()] == ["falls"] * 12 + ["stands"] * 12


@pytest.mark.parametrize("name", ["chain-film-truck", "chain-to-wrapper", "en-12195-1", "eumos-search", "radial-force"])
def test_the_bounds_of_a_sweep_hold_for_all_of_its_drives(name: str) -> None:
    """An engine reserves memory for these bounds before the drives exist."""
    plan = SweepPlan(load_sweep(Path(__file__).parents[2] / "sweeps" / f"{name}.toml", plans_given=True), STACKS)
    groups = list(plan.groups())
    worlds = [(group.plan, variant) for group in groups for variant in group.variants]
    if plan.sweep.search is not None:
        tests = product(groups, range(len(plan.search_items())), range(plan.sweep.search.sections))
        worlds = [(group.plan, plan.search_variant(group, item, level)) for group, item, level in tests]
    drives = [plan.drive(*world) for world in worlds]
    drives += [plan.leg_drive(*world, leg) for world in worlds for leg in world[1].legs]
    excitations = [drive.excitation for drive in drives if drive is not None]
    bounds = job_bounds(plan, groups)
    assert bounds.jobs == len(worlds)
    assert bounds.box_counts == {scene.n_boxes for _, scene in plan.scenes(groups)}
    assert bounds.drive_steps == max(len(excitation.samples) for excitation in excitations)
    assert bounds.excitations is None or bounds.excitations == len({id(excitation) for excitation in excitations})
    assert bounds.wraps == name.startswith("chain")


def test_early_stop_changes_no_answer_of_eumos_s_test(tmp_path: Path) -> None:
    """A world ends when the first box to fail is lost (tilted by more than 20°), but not before this box has swayed by
    more than EUMOS's test allows."""
    plans = [leaning("low"), leaning("tall", 6, 20.0)]
    grid = EUMOS_GRID.replace("from = 0.05, to = 0.8, step = 0.05", "from = 0.2, to = 0.8, step = 0.3")
    grid = grid.replace('["+x", "-x", "+y", "-y"]', '["-x", "+y"]')
    engine = Recorder(2)
    ended, full_run = (
        petmjx.sweep(write_sweep(tmp_path, text + grid), plans, engine=engine)
        for text in (QUICK.replace("early_stop = false", ""), QUICK)
    )
    jobs = [job for batch, sim in engine.batches if sim.early_stop for job in batch]
    allowed_m = {job.scene.n_boxes: job.drive.allowed_sway_m for job in jobs if job.drive}
    height_m = {plan.n_boxes: (plan.corner_mm + plan.size_mm)[:, 2].max() / 1000 for plan in plans}
    assert allowed_m == {n: pytest.approx(0.1 * height, rel=1e-3) for n, height in height_m.items()}
    for column in ("verdict", "culprit", "first_sign_s", "eumos_passed"):
        pd.testing.assert_series_equal(ended.worlds[column], full_run.worlds[column])
    fell = (ended.worlds["flags"] & int(Flag.EARLY_STOP)) > 0
    assert (ended.worlds["reason"][fell] == "tilt").any()
    assert (ended.worlds["n_steps"][fell] < full_run.worlds["n_steps"][fell]).all()
    assert full_run.worlds["eumos_passed"].any()


def test_tilting_tells_the_angle(tmp_path: Path) -> None:
    text = """
[simulation]
settle_s = 0.2
sample_interval_s = 0.04
[axes]
profile = "tilt"
"""
    (world,) = petmjx.sweep(write_sweep(tmp_path, text), [leaning("a", 1)], engine="mujoco").worlds.to_dict("records")
    # atan 0.5 = 26.57°; a box then needs some time to slide 20 mm, in which the carrier tilts further
    assert 26.5 < world["fail_angle_deg"] < 30.0
    assert world["fail_angle_deg"] == pytest.approx(5.0 * world["sign_in_profile_s"])
    assert world["mode"] in ("slide", "drop")
