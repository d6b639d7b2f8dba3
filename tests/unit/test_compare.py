"""Tests of the comparison of two runs, and of its tables. The differences between the runs are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.outcomes import dropped_outcome, make_outcome, make_plan

from petmjx.analysis.run_comparison import FORCE_FLOOR_N, compare_runs, thresholds_of
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import Param
from petmjx.show.compare_tables import comparison_tables

FLOAT32 = 1e-6
"""Tolerance of values that the table ``boxes`` stores as float32: ten times the relative rounding error."""

CONFIG = {"sim": Simulation().model_dump(mode="json")}


def write(folder: Path, outcomes: dict[str, Outcome], config: dict[str, Any] = CONFIG, **options: Any) -> Path:
    with RunWriter(folder, config, **options) as run:
        for plan_id, outcome in outcomes.items():
            run.add(make_plan(plan_id, outcome.n_boxes), 0, "fixed", outcome)
    return folder


def row_of(frame: pd.DataFrame, metric: str, group: str) -> dict[str, Any]:
    (row,) = frame[(frame.metric == metric) & (frame.group == group)].to_dict("records")
    return {str(name): value for name, value in row.items()}


def shifted(by_m: float) -> Outcome:
    """The outcome of ``make_outcome`` with the last box moved along x by ``by_m``."""
    outcome = make_outcome()
    outcome.boxes.shift_m[2, 0] += by_m
    outcome.boxes.pos[2, 0] += by_m
    return outcome


def test_a_run_agrees_with_itself(tmp_path: Path) -> None:
    run = write(tmp_path / "a", {"s": make_outcome(), "d": dropped_outcome()})
    result = compare_runs(run, run)
    assert result.agreement == 1.0
    assert result.flips.empty
    assert result.notes == ()
    assert repr(result) == f"Comparison({run} and {run}: 2 of 2 worlds agree)"
    assert (result.n_not_stable, result.same_reason, result.same_culprit) == (1, 1, 1)
    assert result.worlds.largest.dropna().max() == 0
    assert result.boxes.largest.dropna().max() == 0


def test_known_differences(tmp_path: Path) -> None:
    a = write(tmp_path / "a", {name: make_outcome() for name in "wxyz"})
    moved = {name: shifted(by) for name, by in zip("wxyz", (0.0, 0.001, 0.002, 0.004), strict=True)}
    result = compare_runs(a, write(tmp_path / "b", moved))
    row = row_of(result.boxes, "shift_x_m", "both stable")
    assert row["n"] == 12
    assert row["median"] == 0.0
    # the 12 differences are 0 (nine times), 1, 2 and 4 mm; the 95 % quantile is at index 10.45 of the sorted list
    assert row["p95"] == pytest.approx(0.0029, rel=FLOAT32)
    assert row["largest"] == pytest.approx(0.004, rel=FLOAT32)
    assert (row["plan_id"], row["variant"], row["box"]) == ("z", 0, 2)
    assert (row["a"], row["b"]) == pytest.approx((0.003, 0.007), rel=FLOAT32)
    # the largest component was 6 mm, along y; x of box 2 is 3, 4, 5 and 7 mm in the worlds of run b, so only the
    # largest component of world z changes, by 1 mm
    world = row_of(result.worlds, "max_shift_m", "both stable")
    assert (world["n"], world["plan_id"]) == (4, "z")
    assert world["largest"] == pytest.approx(0.001)
    assert world["p95"] == pytest.approx(0.00085)
    assert row_of(result.boxes, "position_m", "both stable")["largest"] == pytest.approx(0.004, rel=1e-4)


def test_angle_between_orientations(tmp_path: Path) -> None:
    half = np.radians(0.1) / 2
    turned = make_outcome(quat=np.tile([-np.cos(half), 0.0, 0.0, -np.sin(half)], (3, 1)))
    result = compare_runs(write(tmp_path / "a", {"w": make_outcome()}), write(tmp_path / "b", {"w": turned}))
    # a quaternion and its negative are the same orientation; float32 is precise enough for 0.1°
    assert row_of(result.boxes, "orientation_deg", "both stable")["largest"] == pytest.approx(0.1, rel=1e-4)


def test_relative_force_differences_have_a_floor(tmp_path: Path) -> None:
    a = make_outcome(max_top_force_n=np.array([0.0, 5.0, 100.0]))
    b = make_outcome(max_top_force_n=np.array([1.0, 7.0, 110.0]))
    result = compare_runs(write(tmp_path / "a", {"w": a}), write(tmp_path / "b", {"w": b}))
    row = row_of(result.boxes, "max_top_force_n relative", "both stable")
    assert FORCE_FLOOR_N == 10.0
    assert row["median"] == pytest.approx(0.1)  # the median of 1/10, 2/10 and 10/100
    assert row["largest"] == pytest.approx(0.2)
    assert row["box"] == 1
    assert row_of(result.boxes, "max_top_force_n", "both stable")["largest"] == pytest.approx(10.0)


def test_flips_say_how_far_from_the_thresholds(tmp_path: Path) -> None:
    fell = make_outcome(
        verdict=Verdict.UNSTABLE,
        reason=Reason.SHIFT,
        culprit=1,
        first_sign_s=0.6,
        shift_m=np.array([[0, 0, 0], [0.021, 0, 0], [0, 0, 0]]),
    )
    a = write(tmp_path / "a", {"w": make_outcome(), "v": make_outcome()})
    b = write(tmp_path / "b", {"w": fell, "v": make_outcome()})
    result = compare_runs(a, b)
    assert result.agreement == 0.5
    assert result.confusion.loc["stable", "unstable"] == 1
    assert result.confusion.loc["stable", "stable"] == 1
    assert result.confusion.to_numpy().sum() == 2
    (flip,) = result.flips.to_dict("records")
    assert (flip["plan_id"], flip["verdict_a"], flip["verdict_b"]) == ("w", "stable", "unstable")
    assert (flip["reason_a"], flip["reason_b"], flip["culprit_b"]) == ("", "shift", 1)
    assert flip["shift_margin_m_a"] == pytest.approx(0.006 - 0.02)
    assert flip["shift_margin_m_b"] == pytest.approx(0.001)
    assert flip["tilt_margin_deg_b"] == pytest.approx(3 - 20)
    # metrics of a world with different verdicts are not compared
    assert row_of(result.worlds, "max_shift_m", "same verdict")["n"] == 1


def test_groups_keep_collapses_apart(tmp_path: Path) -> None:
    far = dropped_outcome()
    far.boxes.shift_m[1, 0] = 1.5
    a = write(tmp_path / "a", {"s": make_outcome(), "d": dropped_outcome()})
    result = compare_runs(a, write(tmp_path / "b", {"s": make_outcome(), "d": far}))
    assert row_of(result.worlds, "max_shift_m", "same verdict")["largest"] == pytest.approx(1.496)
    assert row_of(result.worlds, "max_shift_m", "both stable")["largest"] == 0.0
    drop = row_of(result.worlds, "first_drop_s", "both stable")
    assert drop["n"] == 0
    assert pd.isna(drop["largest"])
    # in the world that collapses, the third box was never placed, so it has no difference
    assert row_of(result.boxes, "shift_x_m", "same verdict")["n"] == 5


def test_thresholds_come_from_the_run(tmp_path: Path) -> None:
    sim = Simulation(thresholds=Thresholds(shift_m=0.05))
    info = load_run(write(tmp_path, {}, {"anywhere": [], "sim": sim.model_dump(mode="json")})).info
    assert thresholds_of(info).shift_m == 0.05
    assert thresholds_of({"config": {}}) == Thresholds()


def test_worlds_that_one_run_alone_has(tmp_path: Path) -> None:
    a = write(tmp_path / "a", {"x": make_outcome(), "y": make_outcome()})
    b = write(tmp_path / "b", {"y": make_outcome(), "z": make_outcome()})
    result = compare_runs(a, b)
    assert result.n_common == 1
    assert result.only_a.plan_id.tolist() == ["x"]
    assert result.only_b.plan_id.tolist() == ["z"]


@pytest.mark.parametrize("outcomes", [{}, {"other": make_outcome()}])
def test_nothing_in_common(tmp_path: Path, outcomes: dict[str, Outcome]) -> None:
    result = compare_runs(write(tmp_path / "a", outcomes), write(tmp_path / "b", {"w": make_outcome()}))
    assert result.n_common == 0
    assert result.agreement is None
    assert result.to_dict()["agreement"] is None
    assert (result.worlds.n == 0).all()
    assert "no world is in both runs" in result.notes
    lines = [str(table) for table in comparison_tables(result)]
    assert not any("max(a" in line for line in lines)  # only tables have a line that explains %


def test_notes_on_what_does_not_fit(tmp_path: Path) -> None:
    a = write(tmp_path / "a", {"w": make_outcome(n=3)})
    b = write(tmp_path / "b", {"w": make_outcome(n=2)}, {"sim": {"thresholds": {"shift_m": 0.1}}})
    notes = compare_runs(a, b).notes
    assert any("different thresholds" in note for note in notes)
    assert any("1 of 1 plan is not the same in a and b" in note for note in notes)


def test_notes_on_variants_that_mean_something_else(tmp_path: Path) -> None:
    for folder, level in (("a", 0.4), ("b", 0.5)):
        with RunWriter(tmp_path / folder, CONFIG, params=[Param("level_g", "g")]) as run:
            run.add(make_plan(), 1, "fixed", make_outcome(), params={"level_g": level})
    assert compare_runs(tmp_path / "a", tmp_path / "b").notes == (
        "variants with the same number have different values of level_g in a and b",
    )


def test_a_world_twice_in_one_run_is_refused(tmp_path: Path) -> None:
    with RunWriter(tmp_path, CONFIG) as run:
        for _ in range(2):
            run.add(make_plan(), 0, "fixed", make_outcome())
    with pytest.raises(InputError, match="more than once"):
        compare_runs(tmp_path, tmp_path)


def test_infinite_metrics_are_no_difference(tmp_path: Path) -> None:
    wild = make_outcome(max_lin_acc=np.array([1.0, np.inf, np.nan]))
    run = write(tmp_path, {"w": wild})
    row = row_of(compare_runs(run, run).boxes, "max_lin_acc", "same verdict")
    assert (row["n"], row["largest"]) == (1, 0.0)


def test_json(tmp_path: Path) -> None:
    a = write(tmp_path / "a", {"[bold]s": make_outcome(), "d": make_outcome()})
    b = write(tmp_path / "b", {"[bold]s": shifted(0.004), "d": dropped_outcome()})
    result = compare_runs(a, b)
    as_json = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert as_json["confusion"]["stable"] == {"stable": 1, "unstable": 1, "invalid": 0}
    assert as_json["flips"][0]["culprit_a"] is None
    assert as_json["flips"][0]["culprit_b"] == 1
    assert {row["group"] for row in as_json["boxes"]} == {"same verdict", "both stable"}
