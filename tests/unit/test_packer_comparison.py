"""Packers compared by their runs: from known verdicts, the comparison computes the expected numbers."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from rich.console import Console
from support import plans
from support.outcomes import dropped_outcome, make_outcome

import petmjx
from petmjx.analysis.packer_comparison import ALL_SIZES, compare_packers, size_names, write_comparison
from petmjx.analysis.run_comparison import compare_runs
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.results.plan_digests import records_of
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_writer import RunWriter
from petmjx.show.packer_tables import packer_tables

CONFIG = {"command": "score", "simulation": Simulation().model_dump(mode="json"), "engine": "mujoco"}
IDENTITY = {"command": "score", "simulation": CONFIG["simulation"], "engine": "mujoco", "shard": None}

INVALID = {"verdict": Verdict.INVALID, "reason": Reason.NONFINITE}


def write(folder: Path, worlds: dict[str, Outcome], shapes: dict[str, Plan] | None = None, **config: Any) -> Path:
    """Write a run with one world per plan. The plans are ``shapes``; a plan without a shape has three cartons on top of
    each other."""
    made = {plan_id: (shapes or {}).get(plan_id, plans.make_plan(plan_id)) for plan_id in worlds}
    with RunWriter(folder, CONFIG | config, manifest=Manifest(IDENTITY, records_of(list(made.values())))) as run:
        for plan_id, outcome in worlds.items():
            run.add(made[plan_id], 0, "adaptive", outcome)
    return folder


def stands() -> Outcome:
    return make_outcome()


def falls(reason: Reason = Reason.SHIFT) -> Outcome:
    return make_outcome(verdict=Verdict.UNSTABLE, reason=reason, culprit=0)


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    """Runs of two packers a and b for the orders o0 … o9. The plans of both packers stand for 5 orders, only that of a
    for 1, only that of b for 3, and neither for 1."""
    a = write(tmp_path / "a", {f"o{k}": stands() if k < 6 else falls() for k in range(10)})
    b = write(tmp_path / "b", {f"o{k}": dropped_outcome() if k in (5, 9) else stands() for k in range(10)})
    return a, b


def only(frame: pd.DataFrame, **where: Any) -> dict[str, Any]:
    for name, value in where.items():
        frame = frame[frame[name] == value]
    (row,) = frame.to_dict("records")
    return {str(name): value for name, value in row.items()}


def printed(comparison: Any, columns: int, **options: Any) -> str:
    out = StringIO()
    console = Console(file=out, width=columns, color_system=None)
    for table in packer_tables(comparison, **options):
        console.print(table)
    return out.getvalue()


def test_shares_pairs_and_decided_orders(two: tuple[Path, Path]) -> None:
    comparison = petmjx.compare_packers(two)
    assert repr(comparison) == "PackerComparison(a 60.0 %, b 80.0 % of 10 orders)"
    row = only(comparison.packers, size=ALL_SIZES, packer="b")
    assert (row["n"], row["n_stable"], row["share"]) == (10, 8, 0.8)
    assert (row["low"], row["high"]) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    pair = only(comparison.pairs, size=ALL_SIZES)
    assert [pair[name] for name in ("both", "only_a", "only_b", "neither")] == [5, 1, 3, 1]
    assert pair["difference"] == pytest.approx(0.2)
    assert pair["low"] < 0.2 < pair["high"]
    assert pair["p"] == pair["p_holm"] == pytest.approx(2 * (1 + 4) / 16)
    assert comparison.decided[["plan_id", "won_by", "reason"]].values.tolist() == [
        ["o6", "b", "shift"],
        ["o7", "b", "shift"],
        ["o8", "b", "shift"],
        ["o5", "a", "drop"],
    ]
    assert only(comparison.reasons, lost_by="b") == {"a": "a", "b": "b", "lost_by": "b", "reason": "drop", "n": 1}
    assert comparison.notes == ("10 plans of 10 are the same in all runs",)


def test_the_order_of_runs_turns_the_sign_and_nothing_else(two: tuple[Path, Path]) -> None:
    forward, back = compare_packers(two), compare_packers(two[::-1])
    forth, again = only(forward.pairs, size=ALL_SIZES), only(back.pairs, size=ALL_SIZES)
    assert (forth["low"], forth["high"]) == pytest.approx((-again["high"], -again["low"]))
    assert forth["p"] == again["p"]
    assert {*forward.decided["plan_id"]} == {*back.decided["plan_id"]}


def test_missing_and_invalid_orders_are_told_and_not_compared(tmp_path: Path) -> None:
    a = write(tmp_path / "a", {"x": stands(), "y": make_outcome(**INVALID), "z": stands()})
    b = write(tmp_path / "b", {"x": falls(), "y": stands()})
    comparison = compare_packers([a, b])
    of_a, of_b = (only(comparison.packers, size=ALL_SIZES, packer=name) for name in "ab")
    assert (of_a["n"], of_a["n_orders"], of_a["n_invalid"], of_a["n_missing"]) == (1, 3, 1, 0)
    assert (of_b["n"], of_b["n_orders"], of_b["n_invalid"], of_b["n_missing"]) == (1, 3, 0, 1)
    assert (of_a["share_at_worst"], of_b["share_at_worst"]) == pytest.approx((2 / 3, 1 / 3))
    assert comparison.plans.set_index(["plan_id", "packer"]).loc[("z", "b"), "verdict"] == "missing"
    text = printed(comparison, 100)
    assert "2 of 3 orders are not compared: a 1 invalid, b 1 missing" in text
    assert "share that stands if missing and invalid plans count as unstable: a 66.7 %, b 33.3 %" in text


def test_no_common_order(tmp_path: Path) -> None:
    comparison = compare_packers([write(tmp_path / "a", {"x": stands()}), write(tmp_path / "b", {"y": stands()})])
    assert "no order has a valid verdict from every packer" in comparison.notes
    assert only(comparison.pairs, size=ALL_SIZES)["n"] == 0
    assert json.dumps(comparison.to_dict(), allow_nan=False)
    text = printed(comparison, 80)
    assert "2 of 2 orders are not compared: a 1 missing, b 1 missing" in text
    assert "McNemar" not in text


def test_three_packers_are_corrected_by_holm(tmp_path: Path) -> None:
    worlds = {
        "a": {f"o{k}": stands() for k in range(8)},
        "b": {f"o{k}": falls() for k in range(8)},
        "c": {f"o{k}": falls() if k < 6 else stands() for k in range(8)},
    }
    comparison = compare_packers({name: write(tmp_path / name, orders) for name, orders in worlds.items()})
    overall = comparison.pairs[comparison.pairs["size"] == ALL_SIZES]
    assert overall[["a", "b"]].values.tolist() == [["a", "b"], ["a", "c"], ["b", "c"]]
    assert overall["p"].tolist() == pytest.approx([2 / 2**8, 2 / 2**6, 0.5])
    assert overall["p_holm"].tolist() == pytest.approx([3 * 2 / 2**8, 2 * 2 / 2**6, 0.5])


def test_utilisation_has_one_target_for_all_packers(tmp_path: Path) -> None:
    """One packer's plan is too long for a roll container. So the target of the order is a euro pallet for both
    packers."""
    flat = plans.make_plan("o", [((400.0, 300.0, 200.0), (450.0 * k, 0.0, 0.0), 5.0) for k in range(2)])
    a = write(tmp_path / "a", {"o": make_outcome(n=2)}, {"o": flat})
    b = write(tmp_path / "b", {"o": stands()})
    comparison = compare_packers([a, b])
    of_a, of_b = (only(comparison.plans, packer=name) for name in "ab")
    assert (of_a["height_m"], of_b["height_m"]) == pytest.approx((0.2, 0.6))
    assert (of_a["volume_m3"], of_b["volume_m3"]) == pytest.approx((0.048, 0.072))
    assert of_a["kpi_2"] == pytest.approx(0.048 / (1.2 * 0.8 * 0.2))
    assert of_b["kpi_2"] == pytest.approx(0.072 / (1.2 * 0.8 * 0.6))
    alone = compare_packers([b, write(tmp_path / "c", {"o": stands()})])
    assert alone.plans["kpi_2"].tolist() == pytest.approx([0.072 / (0.8 * 0.7 * 0.6)] * 2)
    on = {**CONFIG["simulation"], "carrier": "euro-pallet"}  # type: ignore[dict-item]
    named = [write(tmp_path / name, {"o": stands()}, simulation=on) for name in "de"]
    assert compare_packers(named).plans["kpi_2"].tolist() == pytest.approx([0.072 / (1.2 * 0.8 * 0.6)] * 2)


def test_sizes_of_orders_are_bins() -> None:
    boxes = pd.Series([1, 20, 21, 40, 80, 81, 500])
    names = ["1 to 20", "1 to 20", "21 to 40", "21 to 40", "61 to 80", "over 80", "over 80"]
    assert size_names(boxes).tolist() == names


def test_sizes_are_those_of_the_largest_plan(tmp_path: Path) -> None:
    tall = {name: plans.make_plan(name, 25) for name in "xy"}
    a = write(tmp_path / "a", {name: make_outcome(n=25) for name in "xy"}, tall)
    b = write(tmp_path / "b", {"x": make_outcome(n=25), "y": falls()}, {"x": tall["x"]})
    comparison = compare_packers([a, b])
    assert only(comparison.packers, packer="b", size="21 to 40")["n_stable"] == 1
    assert set(comparison.packers["size"]) == {ALL_SIZES, "21 to 40"}


def test_sizes_without_a_compared_order_are_not_shown(tmp_path: Path) -> None:
    tall, large = plans.make_plan("t", 25), plans.make_plan("l", 45)
    both = {"x": stands(), "t": make_outcome(n=25)}
    a = write(tmp_path / "a", both | {"l": make_outcome(n=45)}, {"t": tall, "l": large})
    text = printed(compare_packers([a, write(tmp_path / "b", both, {"t": tall})]), 80)
    assert "1 to 20" in text
    assert "21 to 40" in text
    assert "41 to 60" not in text


def test_one_plan_that_is_the_same(tmp_path: Path) -> None:
    comparison = compare_packers([write(tmp_path / name, {"x": stands()}) for name in "ab"])
    assert comparison.notes == ("1 plan of 1 is the same in all runs",)


def test_doubts_are_notes(tmp_path: Path) -> None:
    other = {**CONFIG["simulation"], "check": "static"}  # type: ignore[dict-item]
    a = write(tmp_path / "a", {"x": stands()})
    b = write(tmp_path / "b", {"x": stands()}, simulation=other, engine="mjx-warp")
    notes = compare_packers([a, b]).notes
    assert "b was simulated with other options than a: check" in notes
    assert "simulated by different engines: mjx-warp, mujoco" in notes


def test_runs_of_before_say_that_they_have_no_utilisation(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "old", CONFIG) as run:
        run.add(plans.make_plan("x"), 0, "adaptive", stands())
    comparison = compare_packers([tmp_path / "old", write(tmp_path / "b", {"x": stands()})])
    assert any("the utilisation of old is unknown" in note for note in comparison.notes)
    assert np.isnan(only(comparison.packers, size=ALL_SIZES, packer="old")["kpi_2"])


def test_what_cannot_be_compared_is_one_line(tmp_path: Path) -> None:
    a = write(tmp_path / "a", {"x": stands()})
    (tmp_path / "deeper").mkdir()
    same = write(tmp_path / "deeper" / "a", {"x": stands()})
    swept = write(tmp_path / "swept", {"x": stands()}, command="sweep")
    assert list(compare_packers([a, same]).runs) == [str(a), str(same)]
    for runs, text in (
        ([a], "at least two runs"),
        (str(a), "at least two runs"),
        ([a, a], "given twice"),
        ([a, swept], "is a sweep; packers are compared by runs of 'petmjx score'"),
        ([a, tmp_path / "none"], "no such folder"),
    ):
        with pytest.raises(InputError, match=text):
            compare_packers(runs)
    with pytest.raises(InputError, match="confidence must be between 0 and 1"):
        compare_packers([a, same], confidence=95)


@pytest.mark.parametrize("columns", [80, 120])
def test_tables_fit_into_the_terminal(two: tuple[Path, Path], columns: int) -> None:
    names = {"[bold]a packer with a long name 📦[/]": two[0], "b": two[1]}
    text = printed(compare_packers(names), columns, max_rows=2)
    lines = text.splitlines()
    assert max(map(len, lines)) <= columns
    assert "kpi_2" in text
    assert "+20.00" in text
    assert "[bold]" in text
    assert "o6, o7 and 1 more (all with -o)" in " ".join(text.split())


def test_files_hold_all_tables(two: tuple[Path, Path], tmp_path: Path) -> None:
    comparison = compare_packers(two)
    write_comparison(comparison, tmp_path / "deep" / "out")
    for name, table in comparison.tables.items():
        read = pd.read_parquet(tmp_path / "deep" / "out" / f"{name}.parquet")
        pd.testing.assert_frame_equal(read, table, check_dtype=False)
        fields = pq.read_schema(tmp_path / "deep" / "out" / f"{name}.parquet")
        assert all(b"unit" in field.metadata and field.metadata[b"description"] for field in fields)
        assert len(pd.read_csv(tmp_path / "deep" / "out" / f"{name}.csv")) == len(table)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: is a file; name a folder"):
        write_comparison(comparison, tmp_path / "file")


# -- the comparison of simulators recognises other plans by their digests
# ------------------------------------------------


def test_metrics_of_other_plans_are_not_compared(tmp_path: Path) -> None:
    heavier = plans.make_plan("y", plans.stack(3, kg=6.0))
    a = write(tmp_path / "a", {"x": stands(), "y": stands()})
    b = write(tmp_path / "b", {"x": stands(), "y": stands()}, {"y": heavier})
    comparison = compare_runs(a, b)
    assert comparison.other_plans == ("y",)
    assert any("1 of 2 plans is not the same in a and b" in note and "--packers" in note for note in comparison.notes)
    assert comparison.n_common == 2
    assert only(comparison.worlds, metric="max_shift_m", group="both stable")["n"] == 1
    assert only(comparison.boxes, metric="max_tilt_deg", group="both stable")["n"] == 3


def test_differences_have_a_sign_where_it_means_something(tmp_path: Path) -> None:
    later = dropped_outcome()
    later.first_sign_s = 1.0
    more = make_outcome(max_tilt_deg=np.array([1.0, 2.0, 2.5]))
    a = write(tmp_path / "a", {"x": dropped_outcome(), "y": make_outcome()})
    comparison = compare_runs(a, write(tmp_path / "b", {"x": later, "y": more}))
    assert only(comparison.worlds, metric="first_sign_s", group="same verdict")["mean"] == pytest.approx(0.6)
    assert only(comparison.boxes, metric="max_tilt_deg", group="both stable")["mean"] == pytest.approx(
        -0.5 / 3, rel=1e-5
    )
    for metric in ("shift_x_m", "position_m", "orientation_deg"):
        assert np.isnan(only(comparison.boxes, metric=metric, group="both stable")["mean"])
