"""Tests of scores with confidence: shares of worlds with errors that stand, coin tosses (plans that may stand or fall),
and files with errors."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from support.command_line import write
from support.equal_runs import assert_same, tables
from support.outcomes import make_outcome
from support.plans import make_plan, stack

import petmjx
from petmjx.cli.console import print_tables
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Flag, Reason, Verdict
from petmjx.options.simulation import Simulation
from petmjx.packers.handmade_plans import HANDMADE
from petmjx.plans.bundled import bundled_path
from petmjx.plans.plan_reader import load_plans
from petmjx.results.run_writer import RunWriter
from petmjx.runs.confidence import READY_MADE, confidence_sweep, contradiction_mask, write_confidence
from petmjx.runs.ready_sweeps import ready_sweeps
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.show.run_tables import run_tables
from petmjx.world.scene import Scene

STANDS = make_plan("stands", stack(2, 100.0))
HALF = make_plan("half", stack(2, 200.0))
"""The upper carton hangs over by half of its 400 mm."""
FALLS = make_plan("falls", stack(2, 260.0))
PLANS = [STANDS, HALF, FALLS]

QUICK: dict[str, Any] = {"confidence": 4, "placing": "exact"}
"""Few worlds, in which no hand carries boxes: that takes most of the steps."""

SLOPPY = """
[axes]
placement_error_mm = 2
"""


def score(**options: Any) -> petmjx.RunResults:
    return petmjx.score(options.pop("plans", PLANS), engine="mujoco", **options)


def summary_of(results: petmjx.RunResults) -> pd.DataFrame:
    assert results.summary is not None
    return results.summary.set_index("plan_id")


def test_far_from_an_edge_all_worlds_say_the_same_and_half_over_it_they_do_not() -> None:
    results = score(confidence=8)
    summary = summary_of(results)
    assert summary["n_standing"].to_dict()["stands"] == 8
    assert summary["n_standing"].to_dict()["falls"] == 0
    assert 0 < summary["n_standing"].to_dict()["half"] < 8
    assert summary["n_worlds"].tolist() == [8] * 3
    assert summary["coin_toss"].to_dict() == {"stands": False, "falls": False, "half": True}
    assert summary.loc["stands", "high"] == 1
    assert 0.6 < summary.loc["stands", "low"] < 0.7
    worlds = results.worlds
    assert len(worlds) == 3 * 9
    drawn = worlds[worlds["variant"] > 0]
    assert drawn["friction_tolerance_rel"].unique().tolist() == ["uniform(-0.5, 0.3)"]
    assert repr(results).split(": ")[1].startswith("27 worlds")
    assert results.units("summary")["share"] == "1"


def test_hand_made_plans_are_far_from_an_edge() -> None:
    expected = {plan.plan_id: 4 if plan.expected == "stable" else 0 for plan in HANDMADE}
    plans = [plan for plan in load_plans(bundled_path()).plans if plan.plan_id in expected]
    assert summary_of(score(plans=plans, confidence=4))["n_standing"].to_dict() == expected


def test_the_nominal_world_is_that_of_a_plain_score() -> None:
    plain, sure = score().worlds.set_index("plan_id"), score(confidence=4)
    worlds = sure.worlds[sure.worlds["variant"] == 0].set_index("plan_id").loc[plain.index]
    pd.testing.assert_frame_equal(worlds[plain.columns], plain, check_exact=True)
    summary = summary_of(sure).loc[plain.index]
    for name in ("verdict", "reason", "margin"):
        assert summary[name].tolist() == plain[name].tolist()


def test_more_worlds_are_the_same_worlds_and_more() -> None:
    runs = (score(plans=[HALF], confidence=n).worlds.sort_values("variant", ignore_index=True) for n in (4, 6))
    few, many = runs
    pd.testing.assert_frame_equal(few, many.head(5), check_exact=True)


def test_errors_of_another_robot(tmp_path: Path) -> None:
    exact = write(tmp_path / "exact.toml", "[simulation]\ninterval_s = 0.5\n[axes]\nplacement_error_x_mm = 0.01")
    results = score(plans=[STANDS], confidence=4, errors=exact)
    assert results.info["config"]["sweep"]["file"] == str(exact)
    assert results.info["config"]["simulation"]["interval_s"] == 0.5
    assert "yaw_error_deg" not in results.worlds
    assert (
        score(plans=[STANDS], confidence=4, errors=exact, interval_s=0.6).info["config"]["simulation"]["interval_s"]
        == 0.6
    )


def test_the_ready_made_errors_are_a_sweep_too() -> None:
    results = petmjx.sweep(READY_MADE, [STANDS], engine="mujoco")
    assert len(results.worlds) == 16
    assert results.summary is not None
    assert results.summary["low"].notna().all()
    definition = confidence_sweep(16, None, {})
    assert definition.file == str(ready_sweeps()[READY_MADE])
    assert (definition.replicates, definition.nominal) == (16, True)


GAP = petmjx.Plan.from_boxes(
    "gap",
    size_mm=[(300, 200, 120)] * 3,
    corner_mm=[(0, 0, 0), (600, 0, 0), (300, 0, 0)],
    mass_kg=[6.0] * 3,
)
"""A plan whose last carton is placed between the two others."""


def room_m(scene: Scene) -> float:
    """Width of the gap between the first two boxes − width of the third box, m."""
    x, half = scene.start_pos[:, 0], scene.half_size[:, 0]
    return float((x[1] - half[1]) - (x[0] + half[0]) - 2 * half[2])


def test_a_box_could_not_be_placed_where_its_gap_is_too_narrow_and_stands_there_placed_exactly(tmp_path: Path) -> None:
    errors = write(tmp_path / "x.toml", "seed = 3\n[axes]\nplacement_error_x_mm = 2\nsize_tolerance_mm = 1")
    options = {"plans": [GAP], "confidence": 12, "errors": errors}
    results = score(**options, exact_too=True, out=tmp_path / "both")
    every = SweepPlan(confidence_sweep(12, errors, {}), [GAP])
    room = np.array([room_m(scene) for _, scene in every.scenes(every.groups())])[1:]
    sure = np.abs(room) > 0.001  # nearer to 0, the verdict is open: contacts of edges give way, and gaps are 0.1 mm
    assert 2 < (sure & (room < 0)).sum() < 12
    carried = results.worlds[results.worlds["placing"] == "hand"]
    missed = (carried["flags"].to_numpy() & int(Flag.NOT_PLACED)) != 0
    assert missed[sure].tolist() == (room < 0)[sure].tolist()
    assert ((carried["verdict"] == "stable").to_numpy() == ~missed).all()
    (row,) = results.summary.to_dict("records")  # type: ignore[union-attr]
    n = int(missed.sum())
    assert (row["n_standing"], row["n_not_placed"], row["n_fell"]) == (12 - n, n, 0)
    assert (row["n_standing_exact"], row["share_exact"]) == (12, 1.0)
    assert (row["only_carried"], row["only_exact"]) == (0, n)
    assert row["p_value"] == pytest.approx(2 * 0.5**n)
    assert row["placing_matters"] is True
    console = Console(width=120, file=StringIO())
    print_tables(run_tables(results), console)
    printed = console.file.getvalue()  # type: ignore[attr-defined]  # it is a StringIO
    assert re.search(rf"could not be placed │ +{n} ", printed)
    assert "plans that stand more often, beyond chance, if boxes are placed exactly: gap" in printed
    alone = score(**options | {"confidence": 4}).worlds.set_index("replicate", drop=False)
    same = carried.set_index("replicate", drop=False)
    columns = [name for name in alone if name not in ("variant", "placing")]
    pd.testing.assert_frame_equal(alone[columns].iloc[1:], same.loc[alone.index[1:], columns], check_exact=True)
    assert petmjx.load_run(tmp_path / "both").summary.equals(results.summary)  # type: ignore[union-attr]


def test_how_boxes_are_placed_is_an_axis_of_sweeps(tmp_path: Path) -> None:
    file = write(tmp_path / "x.toml", "nominal = true\n[axes]\nplacing = ['hand', 'drop', 'exact']")
    worlds = petmjx.sweep(file, [STANDS], engine="mujoco").worlds.sort_values("variant")
    assert worlds["placing"].fillna("").tolist() == ["", "hand", "drop", "exact"]
    nominal, hand, drop, exact = worlds["n_steps"].tolist()
    assert nominal == exact != drop
    assert hand > 1.5 * exact
    with pytest.raises(InputError, match=r"axes\.placing needs simulation\.placing='auto', 'hand' or 'tines'"):
        petmjx.sweep(file, [STANDS], engine="mujoco", schedule="fixed")


def test_exact_too_is_about_boxes_that_are_carried() -> None:
    with pytest.raises(InputError, match="exact_too needs the option confidence"):
        score(exact_too=True)
    with pytest.raises(InputError, match="so it needs placing='auto', 'hand' or 'tines'"):
        score(confidence=4, exact_too=True, placing="exact")


REFUSED = {
    "search": ("[axes]\nprofile = 'eumos-40509'\n[search]", "[search]"),
    "profile": ("[axes]\nplacement_error_mm = 2\nprofile = 'eumos-40509'", "axes.profile contradicts confidence"),
    "sample": ("mode = 'sample'\nsample = 3\n[axes]\nyaw_error_deg = 2", 'mode = "sample" contradicts confidence'),
    "several": (
        "[axes]\nplacement_error_mm = [2, 3]",
        "axes.placement_error_mm: confidence needs one error, got 2",
    ),
    "factor": (
        SLOPPY + "friction_factor = 0.8",
        "axes.friction_factor contradicts confidence: its value is not random",
    ),
    "calm": ("[axes]\ndrop_height_mm = 5", "no axis is random, so every world would be the same"),
    "nothing": ("nominal = true", "no axis is random"),
}


@pytest.mark.parametrize(("text", "expected"), REFUSED.values(), ids=REFUSED)
def test_files_that_hold_more_than_errors_are_refused(text: str, expected: str, tmp_path: Path) -> None:
    file = write(tmp_path / "x.toml", text)
    with pytest.raises(InputError) as caught:
        score(confidence=4, errors=file)
    assert str(caught.value).startswith(f"{file}: {expected}")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"confidence": 3}, "confidence must be from 4 to 100000, got 3"),
        ({"confidence": "many"}, "confidence must be a whole number, got 'many'"),
        ({"errors": "x.toml"}, "errors needs the option confidence (the number of worlds)"),
        ({"confidence": 4, "errors": "x.toml"}, "x.toml: no such sweep file; ready-made sweeps are chain-film-road, "),
    ],
)
def test_options_that_are_refused(options: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        score(**options)
    assert str(caught.value).startswith(expected)


def test_sweeps_have_no_confidence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown option confidence"):
        petmjx.sweep(write(tmp_path / "x.toml", SLOPPY), PLANS, confidence=8)


def test_shards_give_the_same_and_runs_go_on(tmp_path: Path) -> None:
    unsharded = score(**QUICK, out=tmp_path / "whole")
    expected = tables(unsharded)
    for share in (1, 2):
        score(**QUICK, shard=f"{share}/2", out=tmp_path / str(share))
    merged = petmjx.merge_runs([tmp_path / str(share) for share in (1, 2)], tmp_path / "merged")
    assert_same(merged, expected)
    assert merged.units("summary") == unsharded.units("summary")

    (tmp_path / "whole/worlds/part-00000.parquet").unlink()
    again = score(**QUICK, out=tmp_path / "whole", resume=True)
    assert_same(again, expected)
    with pytest.raises(InputError, match=r"another run \(confidence is 5, was 4\)"):
        score(**QUICK | {"confidence": 5}, out=tmp_path / "whole", resume=True)
    other = write(tmp_path / "x.toml", "seed = 1" + SLOPPY)
    with pytest.raises(InputError, match=r"errors\.axes\.yaw_error_deg is none"):
        score(**QUICK, errors=other, out=tmp_path / "whole", resume=True)
    with pytest.raises(InputError, match=r"another run \(confidence is none, was 4\)"):
        score(placing="exact", out=tmp_path / "whole", resume=True)


def written(
    folder: Path, counts: Sequence[int], nominal: Verdict = Verdict.STABLE, ids: Sequence[str] = "a"
) -> petmjx.RunResults:
    """A run of plans with equal results. ``counts`` has the numbers of worlds that stand, fall and are invalid."""
    kinds = zip(Verdict, counts, strict=False)
    verdicts = [nominal, *(verdict for verdict, count in kinds for _ in range(count))]
    with RunWriter(folder, {"command": "score"}) as run:
        for plan_id, (variant, verdict) in itertools.product(ids, enumerate(verdicts)):
            reason = {Verdict.UNSTABLE: Reason.SHIFT, Verdict.INVALID: Reason.NONFINITE}.get(verdict, Reason.NONE)
            outcome = make_outcome(1, verdict, reason, flags=Flag.NONE)
            run.add(make_plan(plan_id, 1), variant, "fixed", outcome)
        run.flush()
        write_confidence(run)
    return petmjx.load_run(folder)


@pytest.mark.parametrize(
    ("counts", "share", "toss"),
    [
        ((16, 0), 1.0, False), ((12, 4), 0.75, False), ((11, 5), 0.6875, True), ((5, 11), 0.3125, True),
        ((4, 12), 0.25, False), ((0, 16), 0.0, False), ((2, 2, 12), 0.5, True), ((0, 0, 4), np.nan, False),
    ],
)  # fmt: skip
def test_a_coin_toss_has_one_half_in_its_interval(
    counts: tuple[int, ...], share: float, toss: bool, tmp_path: Path
) -> None:
    (row,) = written(tmp_path, counts).summary.to_dict("records")
    assert row["share"] == pytest.approx(share, nan_ok=True)
    assert row["coin_toss"] is toss
    assert row["n_worlds"] == sum(counts)
    assert np.isnan(row["low"]) == np.isnan(share)


@pytest.mark.parametrize(
    ("nominal", "counts", "expected"),
    [
        (Verdict.STABLE, (1, 15), True), (Verdict.STABLE, (7, 9), False), (Verdict.STABLE, (16, 0), False),
        (Verdict.UNSTABLE, (16, 0), True), (Verdict.UNSTABLE, (0, 16), False), (Verdict.INVALID, (16, 0), False),
    ],
)  # fmt: skip
def test_shares_against_the_nominal_verdict(
    nominal: Verdict, counts: tuple[int, int], expected: bool, tmp_path: Path
) -> None:
    assert contradiction_mask(written(tmp_path, counts, nominal).summary).tolist() == [expected]


@pytest.mark.parametrize("n_plans", [12, 50])
def test_what_is_printed_names_the_plans_to_think_about(n_plans: int, tmp_path: Path) -> None:
    for counts, line in (((8, 8), "coin toss: "), ((0, 16), "most worlds contradict the nominal verdict: ")):
        results = written(tmp_path / str(counts[0]), counts, ids=[f"plan-{k:02}" for k in range(n_plans)])
        console = Console(width=80, file=StringIO())
        print_tables(run_tables(results), console)
        printed = console.file.getvalue()  # type: ignore[attr-defined]  # it is a StringIO
        names = ", ".join(f"plan-{k:02}" for k in range(10))
        assert f"{line}{names} and {n_plans - 10} more, in summary\n" in printed
        assert ("worlds with errors" in printed) == (n_plans <= 40)
        assert ("of 16" in printed) == (n_plans <= 40)
        assert max(map(len, printed.replace(names, "").replace(str(results.path), "").splitlines())) <= 80


def test_the_default_simulation_is_that_of_a_score() -> None:
    assert confidence_sweep(4, None, {}).simulation == Simulation()
