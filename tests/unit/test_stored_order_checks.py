"""Plans compared with their orders: which boxes are counted, what a run stores of the comparison, and that the
comparison changes no world."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from support.command_line import write
from support.equal_runs import SEARCH, tables
from support.plan_files import order_of, tower
from support.plans import make_plan
from support.runs import edit_info, relisted
from test_tables import read, row

import petmjx
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.plans import order_checks
from petmjx.plans.order_checks import OrderCounts, PlanOrderCounts, check_orders
from petmjx.results.plan_digests import PlanRecord
from petmjx.results.run_writer import RunWriter
from petmjx.results.table_parts import Parts

A, B, C, D = (make_plan(name, boxes) for name, boxes in zip("abcd", (2, 3, 2, 1), strict=True))
PLANS = [A, B, C, D]
ORDERS: dict[str, Any] = {
    "b": order_of(B, "jam", "jam", "oil"),
    "a": order_of(A),
    "c": order_of(C, "jam", without=1),
    "lost": order_of(A),
}
"""Orders of the plans. Plan `a` has all boxes of its order. Plan `b` leaves out 3 of 6 boxes. Plan `c` has another box
in place of an ordered one. Plan `d` has no order, and the order `lost` has no plan."""

OF_PLANS = {"a": PlanOrderCounts(2, 0, 0), "b": PlanOrderCounts(6, 3, 0), "c": PlanOrderCounts(2, 1, 1)}
COUNTS = OrderCounts(
    orders=4,
    ordered_boxes=10,
    left_out=4,
    not_ordered=1,
    plans_leaving_out=2,
    plans_without_order=1,
    orders_without_plan=1,
    boxes_without_plan=2,
)
LINES = [
    "plan b: 3 of 6 ordered boxes are left out (2 × jam, 1 × oil)",
    "plan c: 1 of 2 ordered boxes is left out (1 × jam); 1 box was not ordered (1 × article-1 (item-1))",
]


@pytest.fixture
def orders(tmp_path: Path) -> Path:
    return write(tmp_path / "orders.json", ORDERS)


def score(**options: Any) -> petmjx.RunResults:
    return petmjx.score(**{"plans": PLANS, "engine": "mujoco", "check": "static", "duration_s": 0.05, **options})


class Idle(MujocoEngine):
    """An engine that must not get a job."""

    def run(self, jobs: Any, *arguments: Any) -> Any:
        assert not list(jobs)
        return iter(())


# The counts of the comparison.


def test_what_is_left_out_and_what_was_not_ordered(orders: Path) -> None:
    check = check_orders(orders, PLANS)
    assert check.of_plan == OF_PLANS
    assert check.counts == COUNTS
    assert check.lines == LINES
    assert check.without_plan == ["lost"]
    assert check.unusable == []


def test_packed_orders_are_compared_too(tmp_path: Path) -> None:
    file = tmp_path / "orders"
    file.write_bytes(gzip.compress(json.dumps(ORDERS).encode()))
    assert check_orders(file, PLANS).counts == COUNTS


def test_boxes_are_told_apart_by_id_and_article_together(tmp_path: Path) -> None:
    order = order_of(B)
    order["item_sequence"]["1"]["id"] = "other"
    check = check_orders(write(tmp_path / "orders.json", {"b": order}), [B])
    assert check.of_plan == {"b": PlanOrderCounts(3, 1, 1)}
    assert check.lines == [
        "plan b: 1 of 3 ordered boxes is left out (1 × article-0 (other)); 1 box was not ordered (1 × article-0 "
        "(item-0))"
    ]


def test_neither_sequence_nor_the_order_of_boxes_matters(tmp_path: Path) -> None:
    order = order_of(B)
    order["item_sequence"] = {str(10 - int(key)): item for key, item in order["item_sequence"].items()}
    assert check_orders(write(tmp_path / "orders.json", {"b": order}), [B]).of_plan == {"b": PlanOrderCounts(3, 0, 0)}


def test_of_a_part_of_the_plans_it_is_not_known_which_orders_have_none(orders: Path) -> None:
    check = check_orders(orders, [A], all_plans=False)
    assert (check.counts.orders_without_plan, check.counts.boxes_without_plan) == (None, None)
    assert check.without_plan == []
    assert check.counts.ordered_boxes == 2
    counts = score(limit=1, orders=orders).info["counts"]["orders"]
    assert counts["orders_without_plan"] is None


def test_of_long_lists_the_beginning_is_kept(orders: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order_checks, "MOST_LISTED", 1)
    check = check_orders(orders, PLANS)
    assert check.lines == LINES[:1]
    assert check.counts == COUNTS
    many = {"b": order_of(B, *(f"jam-{number}" for number in range(7)))}
    (line,) = check_orders(write(orders, many), [B]).lines
    assert line.endswith("(1 × jam-0, 1 × jam-1, 1 × jam-2, 1 × jam-3, 1 × jam-4, 2 more articles)")


def test_an_unusable_order_is_named_and_not_compared(tmp_path: Path) -> None:
    bad = order_of(A)
    bad["item_sequence"]["2"]["weight/kg"] = -1
    file = write(tmp_path / "orders.json", {**ORDERS, "a": bad})
    check = check_orders(file, PLANS)
    message = f"{file}: order a, item 2: weight/kg must be > 0, got -1"
    assert check.unusable == [message]
    assert (check.counts.orders, check.counts.unusable_orders, check.counts.plans_without_order) == (3, 1, 2)
    assert "a" not in check.of_plan
    with pytest.raises(petmjx.InputError) as caught:
        check_orders(file, PLANS, strict=True)
    assert str(caught.value) == message
    with pytest.raises(petmjx.InputError, match=r"no usable order \(1 unusable\); the first: .*order a, item 2"):
        check_orders(write(file, {"a": bad}), PLANS)


def test_shards_count_each_order_once(orders: Path) -> None:
    checks = [check_orders(orders, PLANS, takes=petmjx.RunOptions(shard=f"{i}/3").takes) for i in (1, 2, 3)]
    for name, total in vars(COUNTS).items():
        assert sum(getattr(check.counts, name) for check in checks) == total
    assert sorted(line for check in checks for line in check.lines) == LINES
    assert all(check.of_plan == OF_PLANS for check in checks)
    assert len({check.digest for check in checks}) == 1


# What a run stores of the comparison.


def test_a_run_has_them_beside_its_verdicts(orders: Path) -> None:
    plain, results = score(), score(orders=orders)
    assert results.info["counts"].pop("orders") == vars(COUNTS)
    block = results.info["orders"]
    assert (block["file"], block["plans"], block["without_plan"]) == (str(orders), LINES, ["lost"])
    assert results.info["config"].pop("orders") == str(orders)
    assert results.info["counts"] == plain.info["counts"]
    assert results.info["config"] == plain.info["config"]
    assert results.info["identity"] == plain.info["identity"]
    assert "orders" not in plain.info
    table = results.plans.set_index("plan_id")
    assert {
        plan_id: PlanOrderCounts(*table.loc[plan_id, [*PlanOrderCounts._fields]]) for plan_id in OF_PLANS
    } == OF_PLANS
    assert table.loc["d", [*PlanOrderCounts._fields]].isna().all()
    assert {results.units("plans")[name] for name in PlanOrderCounts._fields} == {"1"}
    assert list(plain.plans) == ["plan_id", *PlanRecord._fields]
    for name, expected in tables(plain).items():
        assert tables(results)[name].equals(expected)


def test_a_plan_that_cannot_be_used_leaves_its_order_without_one(orders: Path) -> None:
    results = score(plans=[A, make_plan("b", [((0.1, 300.0, 200.0), (0.0, 0.0, 0.0), 0.005)])], orders=orders)
    assert [entry["plan_id"] for entry in results.info["skipped"]] == ["b"]
    assert results.info["orders"]["without_plan"] == ["b", "c", "lost"]


def test_sweeps_have_them_too(orders: Path, tmp_path: Path) -> None:
    file = write(
        tmp_path / "search.toml", SEARCH.replace("[0, 90]", "[0]").replace("tolerance = 0.1", "tolerance = 0.5")
    )
    results = petmjx.sweep(file, [A, C], engine="mujoco", orders=orders)
    assert results.info["counts"]["orders"]["left_out"] == 1
    assert list(results.plans["left_out"]) == [0, 1]


def test_a_run_of_an_older_petmjx_has_no_table_of_plans(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}):
        pass
    assert petmjx.load_run(tmp_path).plans.empty


def test_a_resumed_run_has_the_orders_of_its_last_command(orders: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    before = score(out=out).plans
    worlds = (out / "worlds" / "part-00000.parquet").read_bytes()

    def resumed(orders: Path | None) -> petmjx.RunResults:
        return score(out=out, resume=True, orders=orders, engine=Idle(threads=1))

    added = resumed(orders)
    assert added.info["counts"]["orders"] == vars(COUNTS)
    assert list(added.plans["left_out"].dropna()) == [0, 3, 1]
    changed = resumed(write(tmp_path / "others.json", {"d": order_of(D, "jam")}))
    assert list(changed.plans["left_out"].dropna()) == [1]
    assert changed.info["orders"]["without_plan"] == []
    dropped = resumed(None)
    assert "orders" not in dropped.info
    assert "orders" not in dropped.info["counts"]
    assert dropped.plans.equals(before)
    assert (out / "worlds" / "part-00000.parquet").read_bytes() == worlds


def test_a_kill_while_orders_are_added_leaves_no_finished_run(
    orders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    score(out=out)

    def kill(*arguments: Any) -> None:
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(Parts, "replaced", kill)
        with pytest.raises(MemoryError):
            score(out=out, resume=True, orders=orders)
    assert petmjx.load_run(out).info["status"] == "running"
    assert score(out=out, resume=True, orders=orders).info["counts"]["orders"] == vars(COUNTS)


# Shards (the shares of a divided run).


def shards_of(folder: Path, *orders: Path | None) -> list[Path]:
    """Make one shard per file of orders; each shard is compared with the orders of its own file."""
    folders = [folder / f"shard-{number}" for number, _ in enumerate(orders, 1)]
    for number, file in enumerate(orders, 1):
        score(out=folders[number - 1], shard=f"{number}/{len(orders)}", orders=file)
    return folders


def test_merged_shards_have_the_orders_of_the_whole_run(orders: Path, tmp_path: Path) -> None:
    full_run = score(orders=orders)
    copy = write(tmp_path / "copy.json", ORDERS)
    merged = petmjx.merge_runs(shards_of(tmp_path, orders, copy, orders), tmp_path / "merged")
    assert merged.info["counts"] == full_run.info["counts"]
    assert merged.plans.equals(full_run.plans)
    assert merged.info["orders"]["digest"] == full_run.info["orders"]["digest"]
    assert sorted(merged.info["orders"]["plans"]) == LINES
    assert merged.info["orders"]["without_plan"] == ["lost"]


def test_unusable_orders_are_no_shard_s(tmp_path: Path) -> None:
    file = write(tmp_path / "orders.json", {**ORDERS, "bad": 5})
    merged = petmjx.merge_runs(shards_of(tmp_path, file, file), tmp_path / "merged")
    assert merged.info["counts"]["orders"]["unusable_orders"] == 1
    assert len(merged.info["orders"]["unusable"]) == 1


def test_shards_of_other_orders_are_not_merged_before_they_have_the_same(orders: Path, tmp_path: Path) -> None:
    one, two = shards_of(tmp_path, orders, None)
    line = f"^{two}: was checked against other orders than {one}; resume one of the two runs with resume=True and"
    with pytest.raises(petmjx.InputError, match=line):
        petmjx.merge_runs([one, two], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()
    score(out=two, shard="2/2", orders=orders, resume=True, engine=Idle(threads=1))
    assert petmjx.merge_runs([one, two], tmp_path / "merged").info["counts"]["orders"] == vars(COUNTS)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda info: info["orders"].pop("digest"), "orders.digest is missing"),
        (lambda info: info["counts"]["orders"].update(left_out="4"), "counts.orders.left_out must be a whole number"),
        (lambda info: info["counts"].pop("orders"), "counts.orders is missing"),
        (lambda info: info.pop("orders"), "orders is missing"),
    ],
)
def test_a_damaged_run_json_is_one_line(orders: Path, tmp_path: Path, change: Any, message: str) -> None:
    score(out=tmp_path / "run", orders=orders)
    edit_info(tmp_path / "run", change)
    with pytest.raises(petmjx.InputError, match=f"run.json: damaged: {message}"):
        petmjx.load_run(tmp_path / "run")


def test_shards_whose_table_has_lost_its_columns_are_not_merged(orders: Path, tmp_path: Path) -> None:
    one, two = shards_of(tmp_path, orders, orders)
    plain = score(out=tmp_path / "plain").path / "plans" / "part-00000.parquet"
    (one / "plans" / "part-00000.parquet").write_bytes(plain.read_bytes())
    with pytest.raises(petmjx.InputError, match="damaged part, it differs from what the run wrote"):
        petmjx.merge_runs([one, two], tmp_path / "merged")
    relisted(one)
    with pytest.raises(petmjx.InputError, match="damaged part, it has no column ordered_boxes"):
        petmjx.merge_runs([one, two], tmp_path / "merged")


@pytest.mark.usefixtures("in_tmp_path")
def test_orders_of_plans_without_ids_are_told_apart_by_article() -> None:
    (plan,) = read(row(), row(sequence=2))
    length, width, height = plan.item_size_mm[0].tolist()
    sizes = {"length/mm": length, "width/mm": width, "height/mm": height, "weight/kg": float(plan.mass_kg[0])}
    item = {**tower(1)[0]["item"], "article": "carton", **sizes}
    items = {str(number): {**item, "id": str(number)} for number in (1, 2, 3)}
    orders = {"A": {"item_sequence": items, "properties": {"target": "euro-pallet"}}}
    assert check_orders(write(Path("orders.json"), orders), [plan]).of_plan["A"] == (3, 1, 0, 0)
