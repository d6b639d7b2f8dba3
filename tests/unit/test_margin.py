"""Tests of the margin of a world (its distance from the thresholds): its definition, its sign, and equal margins for
outcomes of all engines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command_line import write
from support.outcomes import make_boxes, make_outcome
from support.plans import make_plan, stack

import petmjx
from petmjx.analysis.run_comparison import compare_runs
from petmjx.engines.margin import margin_of
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Flag, Reason, Verdict, judge
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.runs.forked_worlds import SettledPlacement
from petmjx.runs.sweep_file import nominal_sweep
from petmjx.runs.sweep_worlds import SweepPlan

LIMITS = Thresholds()
STANDS = make_plan("stands", stack(2, 100.0))
FALLS = make_plan("falls", stack(2, 260.0))


def boxes(shift_m: float = 0.0, tilt_deg: float = 0.0, dropped: bool = False, **changes: Any) -> BoxMetrics:
    """Metrics of three boxes. The second box has the given values."""
    values = {
        "shift_m": np.array([[0.0, 0, 0], [0, -shift_m, 0], [0, 0, 0]]),
        "max_tilt_deg": np.array([0.0, tilt_deg, 0]),
        "dropped": np.array([False, dropped, False]),
    }
    return make_boxes(3, **values | changes)


def margin(metrics: BoxMetrics, n_placed: int = 3, thresholds: Thresholds = LIMITS) -> float:
    return margin_of(judge(Flag.NONE, metrics, n_placed, thresholds)[0], metrics, n_placed, thresholds)


@pytest.mark.parametrize(
    ("metrics", "expected"),
    [
        (boxes(), 1.0),
        (boxes(shift_m=0.005), 0.75),
        (boxes(shift_m=0.005, tilt_deg=18.0), 0.1),
        (boxes(shift_m=0.02), 0.0),
        (boxes(shift_m=0.03, tilt_deg=1.0), -0.5),
        (boxes(tilt_deg=40.0), -1.0),
        (boxes(dropped=True), -1.0),
        (boxes(shift_m=0.001, tilt_deg=19.0, dropped=True), -1.0),
        (boxes(shift_m=0.5, dropped=True), -24.0),
    ],
)
def test_the_margin_is_one_less_the_largest_excess(metrics: BoxMetrics, expected: float) -> None:
    assert margin(metrics) == pytest.approx(expected)


def test_only_placed_boxes_count() -> None:
    unplaced = boxes(shift_m=np.nan, tilt_deg=np.nan)
    assert margin(unplaced, n_placed=1) == 1.0
    assert np.isnan(margin(unplaced, n_placed=0))


def test_invalid_worlds_have_none() -> None:
    assert np.isnan(margin_of(Verdict.INVALID, boxes(), 3, LIMITS))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("limit_m", [0.02, 0.03, 0.1, 0.007])
def test_the_sign_is_that_of_the_verdict(limit_m: float, dtype: type[np.floating[Any]]) -> None:
    at = dtype(limit_m)
    thresholds = Thresholds(shift_m=limit_m)
    for value in (np.nextafter(at, dtype(0)), at, np.nextafter(at, dtype(1))):
        metrics = boxes()
        metrics.shift_m = np.array([[value, 0, 0]] * 3, dtype)
        verdict, _ = judge(Flag.NONE, metrics, 3, thresholds)
        actual = margin(metrics, thresholds=thresholds)
        assert (actual >= 0) == (verdict is Verdict.STABLE)
        assert actual == pytest.approx(0, abs=1e-6)


def test_a_world_that_was_shaken_though_it_did_not_stand_has_the_smaller_margin() -> None:
    placed = replace(make_outcome(verdict=Verdict.UNSTABLE, reason=Reason.SHIFT), margin=-0.2)
    shaken = replace(make_outcome(), margin=0.9)
    plan = SweepPlan(nominal_sweep(Simulation()), [STANDS])
    group = next(plan.groups())
    for at_rest, margin in ((placed, -0.2), (replace(make_outcome(), margin=0.5), 0.9)):
        assert SettledPlacement(group, plan.scene(group), at_rest, ()).shaken(shaken, LIMITS).margin == margin


def test_results_have_it(tmp_path: Path) -> None:
    results = petmjx.score([STANDS, FALLS], engine="mujoco", out=tmp_path / "out")
    worlds, shift = results.worlds.set_index("plan_id"), "max_shift_m"
    assert worlds.loc["stands", "margin"] == pytest.approx(1 - worlds.loc["stands", "max_tilt_deg"] / 20, abs=1e-6)
    assert worlds.loc["falls", "margin"] <= -1
    assert worlds.loc["falls", "margin"] <= 1 - worlds.loc["falls", shift] / 0.02 + 1e-6
    assert results.units("worlds")["margin"] == "1"


def test_flips_say_within_which_margin_they_are(tmp_path: Path) -> None:
    strict = {"thresholds": {"shift_m": 0.004}}
    file = write(tmp_path / "x.toml", "nominal = true")
    folders = [tmp_path / "a", tmp_path / "b"]
    floating = make_plan("floats", (*stack(1), ((400.0, 300.0, 200.0), (0.0, 0.0, 205.0), 5.0)))
    petmjx.score(floating, engine="mujoco", out=folders[0])
    petmjx.sweep(file, floating, engine="mujoco", out=folders[1], **strict)
    comparison = compare_runs(*folders)
    (flip,) = comparison.flips.to_dict("records")
    assert flip["margin_a"] > 0 > flip["margin_b"]
    assert (
        comparison.flips_within
        == comparison.to_dict()["flips_within"]
        == min(abs(flip["margin_a"]), abs(flip["margin_b"]))
    )
