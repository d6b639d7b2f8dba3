"""The rows of results have the order in which the plans were given, with one row per plan. Skipped plans can be
recognised."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import pyarrow as pa
import pytest
from support.fake_engine import LargestFirst
from support.plan_files import placement
from support.plans import make_plan, stack

import petmjx
from petmjx.results.run_writer import RunWriter
from petmjx.results.world_ranks import PlanOrder, WorldRanks

PLANS = [make_plan(f"plan-{(7 * k) % 20:02}", stack(1 + (5 * k) % 4)) for k in range(20)]
"""The plans are sorted neither by id nor by size."""
IDS = [plan.plan_id for plan in PLANS]


def score(plans: Any, **options: Any) -> petmjx.RunResults:
    return petmjx.score(plans, engine=LargestFirst(), **options)


def is_in_order(results: petmjx.RunResults, ids: list[str] = IDS) -> None:
    """Check the order of rows in Python, and in the files for readers that know nothing of petmjx."""
    assert results.worlds.plan_id.tolist() == ids
    assert results.boxes.drop_duplicates(["plan_id", "variant"]).plan_id.tolist() == ids
    for _, box in results.boxes.groupby(["plan_id", "variant"]).box:
        assert box.tolist() == [*range(len(box))]
    for table, frame in (("worlds", results.worlds), ("boxes", results.boxes)):
        files = f"'{results.path}/{table}/*.parquet'"
        read = duckdb.sql(f"SELECT plan_id, variant FROM {files} ORDER BY rank").fetchall()
        assert read == list(zip(frame.plan_id, frame.variant, strict=True))


@pytest.fixture(params=[1_000, 3])
def parts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests run twice: with all worlds in one part (file), and with many parts."""
    defaults = RunWriter.__init__.__kwdefaults__
    assert defaults is not None
    monkeypatch.setitem(defaults, "worlds_per_part", request.param)


@pytest.mark.usefixtures("parts")
def test_row_k_is_plan_k(tmp_path: Path) -> None:
    results = score(PLANS, out=tmp_path / "run")
    is_in_order(results)
    assert results.worlds.index.equals(pd.RangeIndex(20))
    for k, plan in enumerate(PLANS):
        assert results.worlds.n_boxes[k] == plan.n_boxes
        assert results.worlds.verdict[k] == LargestFirst.verdict(plan.n_boxes)
    assert results.attempts.plan_id.tolist() == sorted(results.attempts.plan_id, key=IDS.index)
    assert results.plans.plan_id.tolist() == IDS
    assert results.skipped.empty


@pytest.mark.usefixtures("parts")
def test_so_they_do_after_all_that_may_happen(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        petmjx.score(PLANS, engine=LargestFirst(interrupt_after=8), out=tmp_path / "run")
    cut = petmjx.load_run(tmp_path / "run")
    assert cut.worlds.plan_id.tolist() == [plan_id for plan_id in IDS if plan_id in {*cut.worlds.plan_id}]
    assert [IDS[k] for k in cut.worlds.index] == cut.worlds.plan_id.tolist()
    is_in_order(score(PLANS, out=tmp_path / "run", resume=True))
    is_in_order(score(PLANS[::-1], out=tmp_path / "run", resume=True), IDS[::-1])
    shards = [score(PLANS, out=tmp_path / f"{i}", shard=f"{i}/3").path for i in (1, 2, 3)]
    of_second = petmjx.load_run(shards[1]).worlds
    assert [IDS[k] for k in of_second.index] == of_second.plan_id.tolist()
    merged = petmjx.merge_runs(shards[::-1], tmp_path / "merged")
    is_in_order(merged)
    pd.testing.assert_frame_equal(merged.worlds, score(PLANS, out=tmp_path / "whole").worlds)


@pytest.mark.usefixtures("parts")
def test_worlds_of_a_plan_come_together(tmp_path: Path) -> None:
    results = score(PLANS, out=tmp_path / "run", confidence=4)
    is_in_order(results, [plan_id for plan_id in IDS for _ in range(5)])
    assert results.worlds.variant.tolist() == [*range(5)] * 20
    assert results.worlds.index.equals(pd.RangeIndex(100))
    assert results.summary is not None
    assert results.summary.plan_id.tolist() == IDS


def test_rows_without_ranks_are_sorted_by_plan_then_by_variant() -> None:
    worlds = [("a", 1), ("b", 2), ("c", 0), ("b", 0), ("a", 0), ("b", 1), ("a", 0)]
    plan_ids, variants = zip(*worlds, strict=True)
    table = pa.table({"plan_id": plan_ids, "variant": variants, "row": range(7)})
    rows = PlanOrder(("b", "a"), (0, 1)).ordered(table).to_pydict()
    assert list(zip(rows["plan_id"], rows["variant"], strict=True)) == [
        ("b", 0), ("b", 1), ("b", 2), ("a", 0), ("a", 0), ("a", 1), ("c", 0),
    ]  # fmt: skip
    assert rows["row"] == [3, 5, 1, 4, 6, 0, 2]


def test_what_is_skipped_leaves_a_gap_and_is_told(tmp_path: Path) -> None:
    file, damaged = tmp_path / "plans.json", tmp_path / "damaged.json"
    thin = placement(size=(400, 300, 0.5))
    good = [placement()]
    file.write_text(json.dumps({"a": good, "bad": [], "b": good, "thin": [thin], "c": good}))
    damaged.write_text('{"d": 5')
    results = score([file, damaged])
    assert results.worlds.plan_id.to_dict() == {0: "a", 2: "b", 4: "c"}
    with pytest.raises(KeyError):
        results.worlds.verdict[1]
    skipped = results.skipped
    assert skipped.plan_id.tolist() == ["bad", "thin", ""]
    assert skipped.number.tolist() == [1, 3, pd.NA]
    assert "placement 0" in skipped.error[1]
    assert results.plans.number.tolist() == [0, 2, 4]


def test_a_plan_that_is_given_twice_has_two_rows() -> None:
    plan, other = make_plan("p", 1), make_plan("p", 2)
    results = score([plan, plan, make_plan("p#2", 3), other])
    assert results.worlds.plan_id.tolist() == ["p", "p#3", "p#2", "p#4"]
    assert results.worlds.n_boxes.tolist() == [1, 1, 3, 2]
    assert any("repeat ids" in warning for warning in results.info["warnings"])


def test_ranks_of_a_score_are_the_numbers_of_its_plans(tmp_path: Path) -> None:
    """In a shard, too, a row has the rank that it has in the whole run."""
    score(PLANS, out=tmp_path / "run")
    assert sorted(pd.read_parquet(tmp_path / "run/worlds")["rank"]) == [*range(20)]
    shard = score(PLANS, out=tmp_path / "shard", shard="2/3")
    read = pd.read_parquet(tmp_path / "shard/worlds").sort_values("rank")
    assert read.plan_id.tolist() == [IDS[rank] for rank in read["rank"]] == shard.worlds.plan_id.tolist()
    assert 0 < len(read) < 20


def test_ranks_of_a_search_have_gaps() -> None:
    """Plans of a search have different numbers of variants, so the ranks have gaps."""
    ranks = WorldRanks(["b", "a"])
    worlds = [("b", 0), ("b", 7), ("a", 0), ("a", 3), ("unknown", 0)]
    numbers = [ranks.rank(*world) for world in worlds]
    assert numbers == sorted({*numbers})
    table = pa.table(
        {"plan_id": [plan for plan, _ in worlds[::-1]], "variant": [variant for _, variant in worlds[::-1]]}
    )
    assert ranks.ranked(table).column_names == ["plan_id", "variant", "rank"]
    assert ranks.ranked(table)["rank"].to_pylist() == numbers
