"""Tests of petmjx's functions for Python."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from support.command_line import write
from support.plan_files import placement
from support.plans import make_plan, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan_set import PlanSet, Skipped
from petmjx.plans.plan_sources import find_plan, gather_plans, usable_plans
from petmjx.runs.simulate import RunStart
from petmjx.runs.study import MAX_WORLDS, FinishedWorld, Nominal

STANDS = make_plan("stands", stack(2, 100.0))
FALLS = make_plan("falls", stack(2, 260.0))
"""The upper carton hangs over by more than half of its 400 mm."""
PLANS = [STANDS, FALLS]
STATIC = {"engine": "mujoco", "check": "static", "duration_s": 0.1}
"""Options with which a run is short."""


class Witness:
    """A watcher of runs that remembers all calls of its methods."""

    def __init__(self) -> None:
        self.starts: list[RunStart] = []
        self.done: list[str] = []

    def begin(self, start: RunStart) -> None:
        self.starts.append(start)

    def world_done(self, world: FinishedWorld) -> None:
        self.done.append(world.plan.plan_id)


def test_results_are_data_frames() -> None:
    witness = Witness()
    results = petmjx.score(PLANS, engine="mujoco", watcher=witness)
    worlds = results.worlds.set_index("plan_id")
    assert worlds["verdict"].to_dict() == {"stands": "stable", "falls": "unstable"}
    assert worlds.loc["falls", "culprit"] == 1
    assert len(results.boxes) == 4
    assert results.attempts.empty
    assert results.info["counts"]["worlds"] == 2
    (start,) = witness.starts
    assert (start.what, start.total, start.choice.name) == ("plan", 2, "mujoco")
    assert start.size.startswith("2 plans, about ")
    assert start.progress.worlds_done == 2
    assert sorted(witness.done) == ["falls", "stands"]


def test_a_score_is_a_sweep_with_one_variant(tmp_path: Path) -> None:
    witness = Witness()
    scored = petmjx.score(PLANS, engine="mujoco", interval_s=0.5)
    file = write(tmp_path / "x.toml", "nominal = true\n[simulation]\ninterval_s = 0.5")
    swept = petmjx.sweep(file, PLANS, engine="mujoco", watcher=witness)
    assert witness.starts[0].what == "world"
    for mine, theirs, keys in (
        (scored.worlds, swept.worlds, ["plan_id"]),
        (scored.boxes, swept.boxes, ["plan_id", "box"]),
    ):
        mine, theirs = (frame.sort_values(keys, ignore_index=True) for frame in (mine, theirs))
        pd.testing.assert_frame_equal(mine, theirs[mine.columns], check_exact=True)


def test_more_than_a_million_plans_must_be_meant() -> None:
    plans = [make_plan("p", stack(1))] * (MAX_WORLDS + 1)
    with pytest.raises(InputError, match="1,000,001 plans, more than 1,000,000: pass allow_large=True to confirm"):
        Nominal(Simulation(), plans, RunOptions())
    assert Nominal(Simulation(), plans, RunOptions(allow_large=True)).total == MAX_WORLDS + 1


def test_options_of_a_sweep_replace_those_of_its_file(tmp_path: Path) -> None:
    file = write(tmp_path / "x.toml", "nominal = true\n[simulation]\nthresholds = { shift_m = 0.03, tilt_deg = 15 }")
    results = petmjx.sweep(file, [STANDS], thresholds={"shift_m": 0.04}, **STATIC)
    sim = results.info["config"]["simulation"]
    assert (sim["thresholds"]["shift_m"], sim["thresholds"]["tilt_deg"]) == (0.04, 15)
    assert sim["duration_s"] == 0.1


def test_a_path_that_no_file_can_have_is_refused() -> None:
    for name in ("out", "orders"):
        with pytest.raises(InputError, match=rf"{name} must be a path without NUL characters, got 'a\\x00b'"):
            petmjx.score(PLANS, **STATIC, **{name: "a\0b"})


def test_given_engines_and_physics_are_used(tmp_path: Path) -> None:
    fine = {"name": "reference", "timestep_s": 0.001}
    results = petmjx.score([STANDS], engine=MujocoEngine(1), physics=fine, out=tmp_path / "out")
    assert results.path == tmp_path / "out"
    physics = results.info["config"]["simulation"]["physics"]
    assert (physics["name"], physics["cone"], physics["timestep_s"]) == ("custom", "pyramidal", 0.001)
    assert results.info["config"]["engine_reason"] == "given"


def test_thresholds_decide() -> None:
    """A box is planned 100 mm, half its height, above another box. The upper box falls and lands flat, so only its
    shift can exceed a threshold."""
    floats = make_plan("floats", [*stack(1), ((400.0, 300.0, 200.0), (0.0, 0.0, 300.0), 5.0)])
    limits: dict[str, Thresholds] = {"shift": Thresholds(), "": Thresholds(shift_m=0.2)}
    for reason, thresholds in limits.items():
        results = petmjx.score(floats, engine="mujoco", thresholds=thresholds)
        assert results.worlds["reason"].tolist() == [reason]
        assert results.info["config"]["simulation"]["thresholds"]["shift_m"] == thresholds.shift_m
    assert petmjx.score(FALLS, engine="mujoco").worlds["reason"].tolist() == ["drop"]


def gathered(plans: Any, **options: Any) -> PlanSet:
    return gather_plans(plans, Simulation(), RunOptions(**options))


def test_sources_of_plans() -> None:
    assert [plan.plan_id for plan in gathered(FALLS)] == ["falls"]
    assert len(gathered(PLANS, limit=1)) == 1
    assert len(gathered(PlanSet(PLANS), limit=1)) == 1
    assert len(gathered(None)) >= 20
    with pytest.raises(InputError, match="either paths or Plan objects"):
        gathered([STANDS, "plans.json"])
    with pytest.raises(InputError, match="no plan files"):
        gathered([])


@pytest.mark.parametrize("wrapped", [list, PlanSet])
def test_plans_with_one_id_are_named_apart(wrapped: type) -> None:
    plans = [make_plan("twice", 1), make_plan("once", 1), make_plan("twice", 2)]
    plan_set = gathered(wrapped(plans), strict=True)
    assert [(plan.plan_id, plan.n_boxes) for plan in plan_set] == [("twice", 1), ("once", 1), ("twice#2", 2)]
    assert plan_set.notes == ["1 plan repeats an id and is called twice#2"]
    assert len(gathered(wrapped(plans), limit=2)) == 2


def test_a_plan_is_found_by_its_id_or_why_not_is_said() -> None:
    plan_set = PlanSet(PLANS, [Skipped("p.json", "bad", "p.json: plan bad: has no placement")])
    assert find_plan(plan_set, "falls") is FALLS
    with pytest.raises(InputError, match=r"^p\.json: plan bad: has no placement$"):
        find_plan(plan_set, "bad")
    with pytest.raises(InputError, match=r"^plan none is not among the 2 plans read$"):
        find_plan(plan_set, "none")


def test_a_box_that_the_size_reduction_eats_is_named() -> None:
    thin = make_plan("thin", stack(2, size_mm=(400.0, 300.0, 0.05), kg=0.005))
    results = petmjx.score([STANDS, thin], engine="mujoco")
    [skipped] = results.info["skipped"]
    assert skipped["error"] == (
        "plans.json: plan thin, placement 0: a side of 0.05 mm vanishes under the size reduction of 0.1 mm"
    )
    with pytest.raises(InputError, match="no usable plan"):
        petmjx.score([thin], engine="mujoco")
    with pytest.raises(InputError, match="plan thin, placement 0"):
        petmjx.score([STANDS, thin], engine="mujoco", strict=True)
    assert len(usable_plans(thin, Simulation(size_reduction_mm=0), RunOptions())) == 1


def test_plans_of_up_to_512_boxes_are_taken(tmp_path: Path) -> None:
    piles = {f"of {n}": [placement(sequence=k) for k in range(1, n + 1)] for n in (512, 513)}
    plan_set = gather_plans(write(tmp_path / "plans.json", piles), Simulation(), RunOptions())
    assert [plan.plan_id for plan in plan_set] == ["of 512"]
    assert "has 513 boxes" in plan_set.skipped[0].message


@pytest.mark.parametrize("function", [petmjx.score, petmjx.sweep])
def test_help_lists_every_option(function: Any) -> None:
    parameters = inspect.signature(function).parameters
    for record in (Simulation, RunOptions):
        for name, field in record.model_fields.items():
            assert parameters[name].default == field.default
            assert parameters[name].kind is inspect.Parameter.KEYWORD_ONLY
            assert f"    {name}: {field.description}." in function.__doc__


def test_no_carrier_loses_its_name() -> None:
    carriers = ["container-20ft", "epal-1", "euro-pallet", "footprint", "gitterbox", "gma-48x40", "pet-eur", "trailer"]
    carriers += ["rollcontainer", "rollcontainer-2", "rollcontainer-3", "rollcontainer-4", "rollcontainer-grid"]
    assert {*map(str, petmjx.Carrier)} >= {*carriers}


@pytest.mark.parametrize("function", [petmjx.score, petmjx.sweep])
def test_bad_options_are_one_line(function: Any, tmp_path: Path) -> None:
    first = write(tmp_path / "x.toml", "nominal = true") if function is petmjx.sweep else PLANS
    for options, line in (
        ({"intervall_s": 1.0}, "unknown option intervall_s; did you mean interval_s?"),
        ({"physics": {"gravity_m_s2": -9.81}}, "gravity_m_s2 must be > 0, got -9.81"),
        (
            {"carrier": "raft"},
            f"carrier must be {', '.join(map(repr, map(str, petmjx.Carrier)))} or a TOML file of boards, got 'raft'",
        ),
        ({"threads": 0}, "threads must be ≥ 1, got 0"),
    ):
        with pytest.raises(InputError) as caught:
            function(first, **({"plans": PLANS} if function is petmjx.sweep else {}), **options)
        assert str(caught.value).endswith(line)
        assert "\n" not in str(caught.value)
