"""How boxes are placed (``placing``): as an option, as an axis of sweeps, and as a field of plans."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.plans import make_plan, make_scene

import petmjx
from petmjx.common.errors import InputError
from petmjx.options.placing import Placing, Way
from petmjx.options.simulation import Simulation
from petmjx.plans.plan_writer import save_plans
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.sweep_cost import work_of
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.approach_paths import approach_path_of
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.scene import Scene, build_scene
from petmjx.world.variants import PlacementChange, Variant, apply

BOXES = [((300.0, 300.0, 300.0), (0.0, 0.0, 0.0), 6.0), ((300.0, 300.0, 300.0), (300.0, 0.0, 0.0), 6.0)]
SD_2 = Distribution(DistributionShape.NORMAL, 0.0, 2.0)


def varied(sim: Simulation, **changes: Any) -> Scene:
    return apply(make_scene(BOXES, sim), "plan", Variant(1, PlacementChange(**changes)), seed=1)


@pytest.mark.parametrize("error", ["x_mm", "yaw_deg", "size_mm"])
def test_worlds_with_errors_are_placed_by_hand_unless_told_otherwise(error: str) -> None:
    sim = Simulation()
    assert approach_path_of(make_scene(BOXES, sim), sim) is None
    assert varied(sim, **{error: SD_2}).placing.name is Way.HAND
    assert varied(sim, mass_rel=Distribution(DistributionShape.NORMAL, 0.0, 0.02)).placing.appears
    assert varied(Simulation(placing="exact"), **{error: SD_2}).placing.name is Way.EXACT
    assert varied(Simulation(placing="tines"), **{error: SD_2}).placing.name is Way.TINES


@pytest.mark.parametrize("options", [{"schedule": "fixed"}, {"check": "static"}, {"physics": "reference"}])
def test_nobody_is_carried_where_nobody_waits(options: dict[str, Any]) -> None:
    sim = Simulation(**options)
    assert approach_path_of(varied(sim, x_mm=SD_2), sim) is None


@pytest.mark.parametrize(
    ("options", "displaced", "carried"),
    [
        ({}, 0, 3),
        ({"placing": "exact"}, 3, 0),
        ({"placing": "hand"}, 0, 3),
        ({"placing": "exact", "schedule": "fixed"}, 0, 0),
        ({"check": "static"}, 0, 0),
    ],
)
def test_estimates_know_which_placements_have_errors(options: dict[str, Any], displaced: int, carried: int) -> None:
    work = work_of(SweepPlan(confidence_sweep(3, None, options), (make_plan("two", BOXES),)))
    assert (work.placements, work.displaced, work.carried) == (4, displaced, carried)


def test_a_name_stands_for_a_table_and_numbers_change_it() -> None:
    assert Simulation(placing="hand").placing == Placing(name=Way.HAND)
    assert Simulation(placing={"name": "hand", "force_n": 30}).placing.force_n == 30
    assert Simulation(placing="drop").changed(placing={"height_mm": 7}).placing == Placing(name=Way.DROP, height_mm=7)


def test_the_numbers_are_axes(tmp_path: Path) -> None:
    file = tmp_path / "sweep.toml"
    file.write_text(
        'simulation = { placing = "hand" }\n[axes]\nplacing_force_n = [20, 60]\nplacing_height_mm = 8\n'
        "placing_side_mm = 9\nplacing_speed_m_s = 0.2\n",
        encoding="utf-8",
    )
    plan = SweepPlan(load_sweep(file, plans_given=True), (make_plan("two", BOXES),))
    placings = [plan.scene(group).placing for group in plan.groups()]
    assert placings == [Placing(name=Way.HAND, force_n=f, height_mm=8, side_mm=9, speed_m_s=0.2) for f in (20, 60)]


def test_a_plan_says_from_where_its_boxes_come(tmp_path: Path) -> None:
    size, corner = [box[0] for box in BOXES], [box[1] for box in BOXES]
    plan = petmjx.Plan.from_boxes("p", size_mm=size, corner_mm=corner, mass_kg=[6, 6], approach_deg=[None, 90.0])
    sim = Simulation(placing="hand")
    for name in ("plan.json", "plan.csv", "plan.parquet"):
        save_plans(plan, tmp_path / name)
        (read,) = petmjx.load_plans(tmp_path / name).plans
        np.testing.assert_array_equal(read.approach_deg, [np.nan, 90.0])
        path = approach_path_of(build_scene(read, sim), sim)
        assert path is not None
        np.testing.assert_allclose(path.offset * 1000, [[0, 0, 5], [0, -5, 5]], atol=1e-9)
    plain = petmjx.Plan.from_boxes("p", size_mm=size, corner_mm=corner, mass_kg=[6, 6])
    assert plain.approach_deg is None


@pytest.mark.parametrize(
    ("value", "fault"), [(700, "must be from -360 to 360 (degrees), got 700"), ("x", "must be a number")]
)
def test_an_unusable_approach_costs_its_plan(tmp_path: Path, value: Any, fault: str) -> None:
    file = tmp_path / "plan.json"
    save_plans(make_plan("p", BOXES), file)
    plans = json.loads(file.read_text(encoding="utf-8"))
    plans["p"][1]["approach_deg"] = value
    plans["q"] = plans["p"][:1]
    file.write_text(json.dumps(plans), encoding="utf-8")
    plan_set = petmjx.load_plans(file)
    assert [plan.plan_id for plan in plan_set.plans] == ["q"]
    assert f"plan p, placement 1: approach_deg {fault}" in plan_set.skipped[0].message


def test_a_run_goes_on_only_with_the_same_placing(tmp_path: Path) -> None:
    options = {"engine": "mujoco", "threads": 1, "out": tmp_path}
    petmjx.score([make_plan("p", BOXES[:1])], **options)
    with pytest.raises(InputError, match="placing"):
        petmjx.score([make_plan("p", BOXES[:1])], resume=True, placing="hand", **options)


def test_a_run_goes_on_only_with_the_same_approaches(tmp_path: Path) -> None:
    plan = make_plan("p", BOXES[:1])
    options = {"engine": "mujoco", "threads": 1, "out": tmp_path, "placing": "hand"}
    petmjx.score([replace(plan, approach_deg=np.array([0.0]))], **options)
    for other in (np.array([90.0]), None):
        with pytest.raises(InputError, match="plan p differs"):
            petmjx.score([replace(plan, approach_deg=other)], resume=True, **options)


def test_tines_tilt_a_box_by_half_of_the_threshold_at_most() -> None:
    """The tilt with which a box is released must not count as a sign of failure. A box 28 mm wide would be tilted by
    21° on the tines."""
    sim = Simulation(placing="tines")
    path = approach_path_of(make_scene([((28.0, 300.0, 20.0), (0.0, 0.0, 0.0), 0.5)], sim), sim)
    assert path is not None
    tilt_deg = 2 * np.degrees(np.arccos(abs(path.quat[0, 0])))
    assert tilt_deg == pytest.approx(sim.thresholds.tilt_deg / 2)


def test_a_pair_of_materials_is_given_once() -> None:
    pairs = [{"between": ["film", "wood"], "friction": 0.7}, {"between": ["Wood", "film "], "friction": 0.1}]
    with pytest.raises(InputError, match=r"friction_pairs\[1\] is about the same materials as friction_pairs\[0\]"):
        Simulation(friction_pairs=pairs)


def test_a_plan_file_s_table_is_no_plan() -> None:
    with pytest.raises(InputError, match=r"got a dict; petmjx\.load_plans reads dictionaries"):
        petmjx.score({"plan": []})  # type: ignore[arg-type]
