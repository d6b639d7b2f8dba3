"""Tests of KPIs: comparison with BED-BPP's own numbers, BED-BPP's rule of support, stability from runs, and
submissions."""

from __future__ import annotations

import errno
import itertools
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.command_line import only_line, run, write
from support.plan_files import order_for, placement, tower
from support.runs import leave_unfinished, relisted

import petmjx
from petmjx.analysis.kpi_files import write_kpis
from petmjx.analysis.kpis import COLUMNS, direct_support
from petmjx.common.units import FloatArray
from petmjx.plans.plan_reader import load_plans

pytestmark = pytest.mark.usefixtures("in_tmp_path")

PUBLISHED = (
    *(f"kpi_{number}" for number in range(1, 7)),
    "eval_score_pal_ratio",
    "eval_score_height",
    "eval_score_absolute_n_stable_pal_items",
)


def rate(plans: dict[str, Any], orders: dict[str, Any] | None = None, **options: Any) -> petmjx.analysis.kpis.Kpis:
    orders = {name: order_for(plan) for name, plan in plans.items()} if orders is None else orders
    return petmjx.kpis(write(Path("plans.json"), plans), write(Path("orders.json"), orders), **options)


# BED-BPP's own numbers


@pytest.fixture
def reference(real_data: Path) -> dict[str, Any]:
    return json.loads((real_data.parent / "reference" / "bed_bpp_kpis.json").read_text())["plans"]


def test_the_published_kpis(real_data: Path, reference: dict[str, Any]) -> None:
    table = petmjx.kpis(
        real_data / "packing_plan_5-bed-bpp.json", real_data / "5_bed-bpp.json", assume_stable=True
    ).plans.set_index("plan_id")
    assert set(table.index) == set(reference)
    for plan_id, values in reference.items():
        for name in PUBLISHED:
            assert table.loc[plan_id, name] == pytest.approx(values[name], abs=1e-9), (plan_id, name)
        assert table.loc[plan_id, "n_ordered"] == values["n_items"]
        assert table.loc[plan_id, "target"] == values["target"]
        # BED-BPP's height is the last whole millimetre below the top
        assert table.loc[plan_id, "height_below_2m_m"] == pytest.approx(values["eval_score_height"] + 0.001, abs=1e-9)


def test_the_published_support(real_data: Path, reference: dict[str, Any]) -> None:
    plans = {plan.plan_id: plan for plan in load_plans(real_data / "packing_plan_5-bed-bpp.json")}
    extents = {"euro-pallet": (1200, 800), "rollcontainer": (800, 700)}
    for plan_id, values in reference.items():
        plan = plans[plan_id]
        share, _ = direct_support(plan.corner_mm, plan.size_mm, extents[values["target"]])
        np.testing.assert_allclose(share, values["support"], rtol=0, atol=1e-6)


# BED-BPP's rule of support, millimetre by millimetre

EXTENT = (24, 18)


def on_a_raster(corner: FloatArray, size: FloatArray) -> tuple[FloatArray, Sequence[int]]:
    """The supported share of each box, and the number of boxes below. The shares and numbers are computed as by
    BED-BPP's evaluator: from a map with the topmost box at each square millimetre."""
    last, height = np.zeros(EXTENT, dtype=int), np.zeros(EXTENT)
    shares, numbers = [], []
    for box, ((x, y, z), (dx, dy, dz)) in enumerate(zip(corner.astype(int), size.astype(int), strict=True)):
        here = np.s_[x : x + dx, y : y + dy]
        below = {number - 1 for number in last[here][height[here] >= z - 5].flat if number}
        share = 0.0
        for other in below:
            length = [
                max(
                    0,
                    min(corner[box][axis] + size[box][axis], corner[other][axis] + size[other][axis])
                    - max(corner[box][axis], corner[other][axis]),
                )
                for axis in (0, 1)
            ]
            share += length[0] * length[1] / (dx * dy)
        shares.append(share if below else 1.0)
        numbers.append(len(below))
        last[here], height[here] = box + 1, z + dz
    return np.array(shares), numbers


@st.composite
def piles(draw: st.DrawFn) -> tuple[FloatArray, FloatArray]:
    """Random boxes that may overlap, float, hide each other, and reach beyond the target's far edges."""
    n = draw(st.integers(1, 12))
    corner = [
        (draw(st.integers(0, EXTENT[0] - 1)), draw(st.integers(0, EXTENT[1] - 1)), draw(st.integers(0, 40)))
        for _ in range(n)
    ]
    size = [tuple(draw(st.integers(1, 20)) for _ in range(3)) for _ in range(n)]
    return np.array(corner, dtype=float), np.array(size, dtype=float)


@settings(max_examples=300, deadline=None)
@given(piles())
def test_support_is_that_of_a_raster(pile: tuple[FloatArray, FloatArray]) -> None:
    share, n_below = direct_support(*pile, EXTENT)
    expected, numbers = on_a_raster(*pile)
    np.testing.assert_allclose(share, expected, atol=1e-12)
    assert n_below.tolist() == list(numbers)


def test_hidden_and_half_hidden_supporters() -> None:
    """A thin box lies on a large box. A third box on the thin box counts as supported also by the visible part of the
    large box."""
    corner = np.array([[0, 0, 0], [0, 0, 10], [0, 0, 11.0]])
    for width, below in ((10.0, 2), (20.0, 1)):
        size = np.array([[20, 10, 10], [width, 10, 1], [20, 10, 5.0]])
        share, n_below = direct_support(corner, size, EXTENT)
        assert n_below[2] == below
        assert share[2] == (1.5 if below == 2 else 1)


def test_a_heap_of_the_largest_size_takes_no_longer_than_others() -> None:
    """A heap of 512 boxes that all overlap, with 130,816 pairs, takes no longer than other plans."""
    rng = np.random.default_rng(0)
    corner = np.concatenate((rng.uniform(0, 600, (512, 2)), rng.uniform(0, 50, (512, 1))), axis=1)
    begin = time.process_time()
    share, n_below = direct_support(corner, np.full((512, 3), 600.0), (1200, 800))
    assert time.process_time() - begin < 10
    assert (share >= 0).all()
    assert n_below.max() > 1


# columns and ratings computed by hand


def test_columns_by_hand() -> None:
    """The plan has two boxes side by side on the target, and a rotated box across both. One of the four ordered boxes
    is left out."""
    plan = [
        placement((0, 0, 0), (400, 300, 200)),
        placement((400, 0, 0), (400, 300, 200)),
        placement((300, 0, 200), (300, 200, 1801), orientation=1),
    ]
    kpis = rate({"A": plan}, {"A": order_for(plan, more=1)}, assume_stable=True)
    row = kpis.plans.iloc[0]
    volume = 2 * 400 * 300 * 200 + 300 * 200 * 1801
    assert row["kpi_1"] == 0.25
    assert row["kpi_2"] == pytest.approx(volume / (1200 * 800 * 2001))
    assert row["kpi_3"] == 2.001
    assert row["kpi_4"] == pytest.approx(1.0)
    assert row["kpi_5"] == 1.0
    assert row["n_pal_items"] == 3
    assert row["eval_score_pal_ratio"] == 0.75
    # the top is at 2.001 m, above 2 m; BED-BPP accepts it, since its last whole millimetre is 2.000 m
    assert row["eval_score_height"] == 2.0
    assert row["height_below_2m_m"] == 0.2
    assert row["volume_m3"] == pytest.approx(volume / 1e9)
    assert row["utilisation_2m"] == pytest.approx(2 * 400 * 300 * 200 / (1200 * 800 * 2000))
    assert kpis.summary["rating"] == 0.75
    assert rate({"A": plan[:2]}).plans["kpi_5"].isna().all()


def test_orders_and_plans_without_each_other() -> None:
    plans = {"A": tower(2), "B": tower(1), "bad": []}
    orders = {"A": order_for(plans["A"]), "lost": order_for(tower(6)), "odd": {}}
    kpis = rate(plans, orders, assume_stable=True)
    assert kpis.plans["plan_id"].tolist() == ["A"]
    assert kpis.summary["rating"] == 2 / 8
    assert kpis.notes[:2] == (
        "1 plan has no order and no KPIs (B)",
        "1 order (6 boxes) has no plan, and counts as not stable in the ratings (lost)",
    )
    assert [line.partition(": ")[2] for line in kpis.skipped] == [
        "plan bad: has no placement",
        "order odd: properties.target must be one of euro-pallet, rollcontainer, got null",
    ]
    with pytest.raises(petmjx.InputError, match="plan bad"):
        rate(plans, orders, strict=True)
    with pytest.raises(
        petmjx.InputError, match=r"no plan has an order: 1 plan and 1 usable order have no id in common$"
    ):
        rate({"A": tower(1)}, {"B": order_for(tower(1))})
    with pytest.raises(
        petmjx.InputError, match=r"; the first unusable order: orders\.json: order A: properties.target must be"
    ):
        rate({"A": tower(1)}, {"A": {}})
    with pytest.warns(petmjx.PlanWarning, match=r"orders\.json: holds plans: the boxes of each are an order"):
        kpis = rate({"A": tower(1)}, {"A": tower(2)})
    assert kpis.plans["kpi_1"].tolist() == [0.5]


# stability from runs

FALLS = [placement((0, 0, 0), (300, 300, 200)), placement((290, 0, 200), (300, 300, 200))]


@pytest.fixture
def runs() -> dict[str, Path]:
    """Runs, with both kinds of check, of a tower that stands and a plan in which a box falls."""
    write(Path("plans.json"), {"stands": tower(2), "falls": FALLS})
    for check in ("static", "one-by-one"):
        petmjx.score("plans.json", engine="mujoco", check=check, duration_s=3, out=check)
    return {check: Path(check) for check in ("static", "one-by-one")}


def test_stability_comes_from_runs(runs: dict[str, Path]) -> None:
    plans = {"stands": tower(2), "falls": FALLS}
    kpis = rate(plans, run=runs["static"])
    assert kpis.plans.set_index("plan_id")["kpi_6"].to_dict() == {"stands": 1, "falls": 0}
    assert kpis.plans.set_index("plan_id")["verdict"].to_dict() == {"stands": "stable", "falls": "unstable"}
    assert kpis.summary["rating"] == kpis.summary["rating_by_verdict"] == 0.5
    assert kpis.notes == ()
    both = rate(plans, run=[runs["one-by-one"], runs["static"]])
    assert both.summary == kpis.summary
    in_memory = [petmjx.score("plans.json", engine="mujoco", check=check, duration_s=3) for check in runs]
    assert rate(plans, run=in_memory[0]).summary == kpis.summary
    assert rate(plans, run=[in_memory[1], runs["static"]]).summary == kpis.summary
    assert "but the run in memory was made with --check one-by-one" in rate(plans, run=in_memory[1]).notes[0]
    with pytest.raises(petmjx.InputError, match="run must be a path, got 5"):
        rate(plans, run=[5])
    with pytest.raises(petmjx.InputError, match="run must be a list of runs or folders, got 5"):
        rate(plans, run=5)
    alone = rate(plans, run=runs["one-by-one"])
    assert alone.plans["kpi_6"].isna().all()
    assert alone.summary["rating"] is None
    assert alone.summary["rating_by_verdict"] == 0.5
    assert alone.notes == (
        "kpi_6 needs a run with --check static, but the run one-by-one was made with --check one-by-one: "
        "give also --run DIR with a run made by 'petmjx score PLANS --check static --out DIR'",
    )


def test_a_run_that_is_not_finished_is_told(runs: dict[str, Path]) -> None:
    leave_unfinished(runs["static"])
    assert rate({"stands": tower(2)}, run=runs["static"]).notes == ("static is not finished (interrupted)",)


def test_runs_that_do_not_fit(runs: dict[str, Path]) -> None:
    with pytest.raises(petmjx.InputError, match="static: plan stands differs from the simulated one"):
        rate({"stands": tower(3)}, run=runs["static"])
    kpis = rate({"stands": tower(2), "new": tower(1)}, run=runs["static"])
    assert kpis.plans.set_index("plan_id")["kpi_6"].isna().to_dict() == {"stands": False, "new": True}
    assert (
        "1 plan is not in the run, or is invalid there, so the column kpi_6 is empty, which counts as not stable in "
        "the rating (new)" in kpis.notes
    )
    assert kpis.summary["rating"] == 2 / 3
    with pytest.raises(petmjx.InputError, match="no such folder"):
        rate({"stands": tower(2)}, run="nowhere")


def test_the_command_with_a_run_of_some_plans_only(runs: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    plans = {"stands": tower(2), "new": tower(1)}
    write(Path("some.json"), plans)
    write(Path("orders.json"), {name: order_for(plan) for name, plan in plans.items()})
    assert run("kpis", "some.json", "--orders", "orders.json", "--run", str(runs["static"])) == 0
    rows = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line}
    assert "stable" in rows["stands"]
    assert rows["new"].count("-") >= 2


def test_ten_millimetres_along_z(runs: dict[str, Path]) -> None:
    """BED-BPP's rule uses only the shift along z: a shift of exactly 10 mm is stable, whatever petmjx's verdict is."""
    file = next((runs["static"] / "boxes").iterdir())
    table = pq.read_table(file)
    for shift, expected in ((0.01, 1), (-0.0101, 0), (0.0101, 0)):
        shifts = np.where(table["plan_id"].to_pandas() == "stands", shift, 1.0).astype(np.float32)
        number = table.column_names.index("shift_z_m")
        changed = table.set_column(number, table.schema.field(number), [shifts])
        pq.write_table(changed, file)
        relisted(runs["static"])
        kpis = rate({"stands": tower(2)}, run=runs["static"])
        assert kpis.plans["kpi_6"].tolist() == [expected]
        assert kpis.plans["verdict"].tolist() == ["stable"]


# files and the command


def test_files(capsys: pytest.CaptureFixture[str]) -> None:
    plans = {'=HYPERLINK("x")': tower(2), "B, \x1b[31m": tower(1)}
    kpis = rate(plans, assume_stable=True)
    write_kpis(kpis, "out", xlsx=True)
    table = pq.read_table("out/kpis.parquet")
    assert table.column_names == [column.name for column in COLUMNS]
    assert all(field.metadata[b"description"] for field in table.schema)
    assert table.schema.field("kpi_3").metadata[b"unit"] == b"m"
    csv = pd.read_csv("out/kpis.csv")
    assert csv["plan_id"].tolist() == list(plans)
    assert csv["kpi_4"].tolist() == table["kpi_4"].to_pylist()
    assert json.loads(Path("out/summary.json").read_text())["rating"] == kpis.summary["rating"]
    sheet = openpyxl.load_workbook("out/kpis.xlsx")["orderwise"]
    (_, first, second) = sheet.iter_rows()
    assert (first[0].value, first[0].data_type) == ('=HYPERLINK("x")', "s")
    assert second[0].value == "B, \\u001b[31m"


def test_a_damaged_workbook_is_kept() -> None:
    kpis = rate({"A": tower(1)}, assume_stable=True)
    write_kpis(kpis, "out", xlsx=True)
    workbook = Path("out/kpis.xlsx")
    content = bytearray(workbook.read_bytes())
    name = b"docProps/core.xml"
    content[content.index(name) + len(name)] ^= 0xFF  # the first byte of the compressed member
    workbook.write_bytes(content)
    with pytest.raises(petmjx.InputError, match=r"kpis\.xlsx: was not written by petmjx"):
        write_kpis(kpis, "out", xlsx=True, overwrite=True)
    assert workbook.read_bytes() == content


@pytest.mark.parametrize("at", [1, 3, 4])
def test_on_a_full_disk_all_files_are_as_they_were(at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    kpis = rate({"A": tower(1)}, assume_stable=True)
    write_kpis(kpis, "before")
    before = {file: file.read_bytes() for file in Path("before").iterdir()}
    calls = itertools.count(1)

    def full(descriptor: int) -> None:
        if next(calls) == at:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    for folder in ("before", "new"):
        with pytest.raises(petmjx.InputError, match=f"{folder}: cannot be written: No space left on device"):
            write_kpis(rate({"A": tower(1), "B": tower(2)}, assume_stable=True), folder, xlsx=True, overwrite=True)
        calls = itertools.count(1)
    assert {file: file.read_bytes() for file in Path("before").iterdir()} == before
    assert not list(Path("new").iterdir())


@pytest.mark.parametrize("columns", ["80", "120"])
def test_the_command(columns: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    plans = {f"plan-with-a-long-name-{number}": tower(number) for number in (1, 2)}
    write(Path("plans.json"), plans)
    write(Path("orders.json"), {name: order_for(plan) for name, plan in plans.items()})
    assert run("kpis", "plans.json", "--orders", "orders.json", "--assume-stable", "-o", "out") == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= int(columns)
    assert "rating" in printed
    assert "KPIs in out" in printed
    assert run("kpis", "plans.json", "--orders", "orders.json", "--assume-stable", "--json") == 0
    assert json.loads(capsys.readouterr().out)["rating"] == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--xlsx"], "--xlsx needs --out DIR"),
        (
            ["--leaderboard", "doe"],
            "--leaderboard name doe: must be SURNAME_ALGORITHM_TASK or DATE_SURNAME_ALGORITHM_TASK",
        ),
        (["--run", "nowhere"], "nowhere: no such folder"),
        (["--run", "nowhere", "--assume-stable"], "give either runs or --assume-stable"),
    ],
)
def test_the_command_refuses(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"A": tower(1)})
    write(Path("orders.json"), {"A": order_for(tower(1))})
    assert run("kpis", "plans.json", "--orders", "orders.json", *arguments) == 2
    assert only_line(capsys.readouterr().err).startswith(f"petmjx: {message}")
