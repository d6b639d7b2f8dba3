"""Ratings of packers refer to the given orders. Whatever other packers enter, ratings are from 0 to 1, and the rating
of an honest packer does not change."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.command_line import write
from support.plan_files import order_for, placement
from support.runs import relisted

import petmjx
from petmjx.analysis.packer_kpis import compare_with_orders
from petmjx.analysis.packer_rating import ratings
from petmjx.analysis.packer_runs import plans_of
from petmjx.common.errors import InputError, PlanWarning
from petmjx.options.carriers import Carrier
from petmjx.plans.order import Item, Order
from petmjx.plans.plan import Plan
from petmjx.results.plan_lookup import PlanLookup
from petmjx.show.leaderboard import entries
from petmjx.show.leaderboard.entry_replays import Replay, Sample

pytest.importorskip("scipy")

Rng = np.random.Generator


# A thousand random entries, which are rated from given verdicts.


def order_of(rng: Rng) -> Order:
    """A random order of up to nine items, with three different sizes that fit beside each other. Two items may be
    equal."""
    sizes = ((300, 200, 150), (200, 150, 100), (250, 100, 90))
    kinds = [Item(f"a{k}", str(k), "", *sizes[k % 3], 2.0 + k) for k in range(5)]
    return Order("euro-pallet", tuple(kinds[k] for k in rng.integers(0, 5, rng.integers(3, 10))))


def plan_of(plan_id: str, goods: list[tuple[str, str, tuple[float, float, float], float]], over: bool = False) -> Plan:
    """A plan of these boxes, in rows on the target, or, if ``over`` is true, beyond the target's edge."""
    ids, articles, sizes, masses = zip(*goods, strict=True)
    corner = np.array([(2000.0 * (k + 1), 0, 0) if over else (300.0 * (k % 3), 0, 10.0 * k) for k in range(len(goods))])
    return Plan(plan_id, "test", np.array(sizes, float), corner, np.array(masses), ids, articles, np.arange(len(goods)))


def draw_plan(rng: Rng, plan_id: str, order: Order) -> tuple[Plan | None, int]:
    """A random plan for an order, and the number of its boxes that are as ordered. None instead of a plan: the packer
    has no plan for the order."""
    goods: list[tuple[str, str, tuple[float, float, float], float]] = []
    right = 0
    for item in order.items:
        size, kg = (item.length_mm, item.width_mm, item.height_mm), item.weight_kg
        fate = rng.integers(0, 4)
        if fate == 0:  # the box is as ordered, and has both names, only the article, or no name
            names = [(item.item_id, item.article), ("", item.article), ("", "")][rng.integers(0, 3)]
            goods.append((*names, size, kg))
            right += 1
        elif fate == 1:  # the box has another size or mass than ordered
            factor = float(rng.choice([0.05, 0.5, 0.98, 1.02, 2.0]))
            by_size = bool(rng.integers(0, 2))
            scaled = tuple(side * (factor if by_size else 1.0) for side in size)
            goods.append((item.item_id, item.article, scaled, kg * (1.0 if by_size else factor)))  # type: ignore[arg-type]
    # repeated boxes count if the order has more equal items than the plan has boxes
    ordered = [(ordered_item.article, ordered_item.length_mm, ordered_item.weight_kg) for ordered_item in order.items]
    for _ in range(rng.integers(0, 4)):
        item = order.items[rng.integers(0, len(order.items))]
        goods.append((item.item_id, item.article, (item.length_mm, item.width_mm, item.height_mm), item.weight_kg))
    for _ in range(rng.integers(0, 20) if rng.integers(0, 2) else 0):
        goods.append(("77", "gold", (40.0, 40.0, 40.0), 0.1))
    if not goods or rng.integers(0, 6) == 0:
        return None, 0
    kinds = {(item.item_id, item.length_mm, item.weight_kg): 0 for item in order.items}
    for names, _, size, kg in goods:
        key = (names or _id_by_mass(order, kg), size[0], kg)
        if key in kinds:
            kinds[key] += 1
    order_counts = {key: sum(key[1:] == entry[1:] for entry in ordered) for key in kinds}
    right = sum(min(count, order_counts[key]) for key, count in kinds.items())
    over = len(goods) > 1 and rng.integers(0, 5) == 0
    return plan_of(plan_id, [goods[k] for k in rng.permutation(len(goods))], over), 0 if over else right


def _id_by_mass(order: Order, kg: float) -> str:
    """The id of the item with this mass. (Each article has a mass of its own.)"""
    return next((item.item_id for item in order.items if item.weight_kg == kg), "")


def run_of(plans: Mapping[str, Plan], verdicts: Mapping[str, str], with_orders: bool) -> Any:
    """The parts of a run that a rating reads: its worlds without errors, and its table ``plans``, whose counts need not
    be true."""
    ids = list(plans)
    boxes = [plan.n_boxes for plan in plans.values()]
    worlds = {"plan_id": ids, "variant": 0, "verdict": [verdicts[name] for name in ids], "reason": "", "n_boxes": boxes}
    columns = {"plan_id": ids, "volume_m3": 0.1, "height_m": 1.0, "extent_x_m": 1.0, "extent_y_m": 0.5}
    if with_orders:
        columns |= {"ordered_boxes": 10_000, "left_out": 0, "not_ordered": 0, "resized": 0}
    return SimpleNamespace(worlds=pd.DataFrame(worlds), plans=pd.DataFrame(columns), carrier=Carrier.FOOTPRINT, info={})


def test_hundreds_of_entries_are_rated_from_0_to_1_and_honest_ones_do_not_move() -> None:
    rng = np.random.default_rng(56)
    orders = {f"o{k}": order_of(rng) for k in range(2)}
    n_ordered = sum(len(order.items) for order in orders.values())
    honest: dict[str, Plan] = {}
    for name, order in orders.items():
        goods = [
            (item.item_id, item.article, (item.length_mm, item.width_mm, item.height_mm), item.weight_kg)
            for item in order.items
        ]
        honest[name] = plan_of(name, goods)
    plans: dict[str, dict[str, Plan]] = {"all": honest, "one": {"o1": honest["o1"]}}
    verdicts = {"all": dict.fromkeys(orders, "stable"), "one": {"o1": "stable"}}
    expected = {"all": 1.0, "one": len(orders["o1"].items) / n_ordered}
    for number in range(300):
        name = f"stranger {number}"
        plans[name], verdicts[name], standing = {}, {}, 0
        for plan_id, order in orders.items():
            plan, right = draw_plan(rng, plan_id, order)
            if plan is not None:
                plans[name][plan_id] = plan
                verdicts[name][plan_id] = str(rng.choice(["stable", "stable", "unstable", "invalid"]))
                standing += right * (verdicts[name][plan_id] == "stable")
        if rng.integers(0, 3) == 0:  # the packer also has plans for orders that nobody gave
            plans[name]["own"], verdicts[name]["own"] = honest["o0"], "stable"
        expected[name] = standing / n_ordered
    runs = {
        name: run_of(some, verdicts[name], len(runs_of) % 3 == 1)
        for runs_of, (name, some) in zip(plans, plans.items(), strict=True)
    }

    def rated(names: list[str]) -> pd.DataFrame:
        against = compare_with_orders({name: plans[name] for name in names}, orders)
        return ratings(plans_of({name: runs[name] for name in names}, against), names, 0.95).set_index("packer")

    alone, everybody = rated(["all", "one"]), rated(list(plans))
    assert everybody["rating"].between(0, 1).all()
    assert everybody["rating"].to_dict() == pytest.approx({name: expected[name] for name in everybody.index})
    assert (everybody["low"] <= everybody["rating"]).all()
    assert (everybody["rating"] <= everybody["high"]).all()
    assert everybody["standing_boxes"].le(n_ordered).all()
    columns = [name for name in alone.columns if name != "rank"]
    pd.testing.assert_frame_equal(everybody.loc[["all", "one"], columns], alone.loc[["all", "one"], columns])
    assert everybody.loc["all", "rank"] == 1
    assert everybody["rating"].nunique() > 5  # the random entries get many different ratings


def test_without_orders_a_run_that_was_compared_with_them_says_how_many_boxes_there_are() -> None:
    """The honest run was compared with its orders. Another packer enters a run with four times as many boxes, which was
    not compared with orders. The rating of the honest packer does not become lower."""
    item = Item("a", "1", "", 300, 200, 150, 2.0)
    order = Order("euro-pallet", (item,) * 3)
    good = plan_of("o", [("1", "a", (300, 200, 150), 2.0)] * 3)
    many = plan_of("o", [("9", "b", (40, 40, 40), 0.1)] * 12)
    honest = run_of({"o": good}, {"o": "stable"}, with_orders=False)
    honest.plans = honest.plans.assign(ordered_boxes=len(order.items), left_out=1, not_ordered=0, resized=1)
    runs = {"honest": honest, "many": run_of({"o": many}, {"o": "stable"}, with_orders=False)}
    table = ratings(plans_of(runs), list(runs), 0.95).set_index("packer")
    assert table.loc["honest", "rating"] == pytest.approx(1 / 3)
    assert table["rating"].between(0, 1).all()


# Leaderboards made of plan files and runs.

SIZE = (400, 300, 200)
GOOD = [placement((0, 0, 0), SIZE), placement((0, 0, 200), SIZE, sequence=2)]
FALLS = [placement((0, 0, 0), SIZE), placement((300, 0, 200), SIZE, sequence=2)]
ORDERS = {f"o{k}": order_for(GOOD) for k in range(4)}
OPTIONS: dict[str, Any] = {"engine": "mujoco", "threads": 1, "stories": 0}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with orders, with a file of plans that stand, with a file of plans that fall except for one, and with a
    run of each file."""
    folder = tmp_path_factory.mktemp("ratings")
    write(folder / "orders.json", ORDERS)
    write(folder / "honest.json", dict.fromkeys(ORDERS, GOOD))
    write(folder / "falling.json", dict.fromkeys(ORDERS, FALLS) | {"o3": GOOD})
    for name in ("honest", "falling"):
        petmjx.score(folder / f"{name}.json", engine="mujoco", threads=1, out=folder / name)
    return folder


def board(made: Path, out: Path, packers: dict[str, Path], **options: Any) -> dict[str, Any]:
    petmjx.leaderboard(packers, out, **{"orders": made / "orders.json", **OPTIONS, **options})
    return dict(json.loads((out / "leaderboard.json").read_text(encoding="utf-8")))


def rating_of(data: Mapping[str, Any]) -> dict[str, float]:
    return {row["packer"]: row["rating"] for row in data["rating"]}


def forged(run: Path, change: Callable[[pa.Table], pa.Table], folder: Path) -> Path:
    """A copy of a run whose table ``worlds`` was changed. run.json lists the changed file with its new digest."""
    shutil.copytree(run, folder)
    (file,) = (folder / "worlds").iterdir()
    pq.write_table(change(pq.read_table(file)), file)
    relisted(folder)
    return folder


def with_column(name: str, value: Callable[[Any], Any]) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        at = table.column_names.index(name)
        values = pa.array([value(cell) for cell in table[name].to_pylist()], table.schema.field(at).type)
        return table.set_column(at, table.schema.field(at), values)

    return change


GENTLE: dict[str, Any] = {"thresholds": {"tilt_deg": 90, "shift_m": 9}, "check": "static", "duration_s": 0.01}
"""Options under which boxes that fall count as stable."""

ALL_STAND = with_column("verdict", lambda verdict: "stable")


def test_a_run_with_forged_verdicts_is_not_rated_and_an_honest_one_does_not_move(made: Path, tmp_path: Path) -> None:
    forger = forged(made / "falling", ALL_STAND, tmp_path / "forger")
    alone = board(made, tmp_path / "alone", {"honest": made / "honest", "falling": made / "falling"})
    assert rating_of(alone) == {"honest": 1.0, "falling": 0.25}
    assert alone["refused"] == []
    assert {sample["packer"]: sample["differ"] for sample in alone["simulated_again"]} == {"honest": [], "falling": []}
    assert {len(sample["plans"]) for sample in alone["simulated_again"]} == {4}
    packers = {"honest": made / "honest", "forger": forger}
    with pytest.warns(PlanWarning, match=r"forger is not rated: 3 of 4 plans .* stable in the run, but unstable by"):
        data = board(made, tmp_path / "board", packers)
    (row,) = data["rating"]
    same = next(rating_row for rating_row in alone["rating"] if rating_row["packer"] == "honest")
    assert row == same
    assert [entry["packer"] for entry in data["refused"]] == ["forger"]
    assert data["refused"][0]["why"] in data["notes"]
    assert "forger is not rated" in (tmp_path / "board" / "index.html").read_text(encoding="utf-8")
    assert not (tmp_path / "board" / "plans" / "forger.json").exists()
    assert "forger" not in data["command"]


def test_stories_contradict_a_run_as_well(made: Path, tmp_path: Path) -> None:
    forger = forged(made / "falling", ALL_STAND, tmp_path / "forger")
    packers = {"honest": made / "honest", "forger": forger}
    with pytest.warns(PlanWarning, match="forger is not rated"):
        data = board(made, tmp_path / "board", packers, replays=0, stories=4)
    assert rating_of(data) == {"honest": 1.0}
    assert {story["packer"] for story in data["stories"]} == {"honest"}


def test_a_run_under_gentle_thresholds_is_simulated_as_the_board_does(made: Path, tmp_path: Path) -> None:
    petmjx.score(made / "falling.json", engine="mujoco", threads=1, out=tmp_path / "gentle", **GENTLE)
    assert (petmjx.load_run(tmp_path / "gentle").worlds["verdict"] == "stable").all()
    with pytest.warns(PlanWarning, match="gentle is not rated"):
        data = board(made, tmp_path / "board", {"honest": made / "honest.json", "gentle": tmp_path / "gentle"})
    assert rating_of(data) == {"honest": 1.0}
    assert "thresholds" not in data["command"]


def test_runs_that_all_have_the_same_options_are_simulated_with_these(made: Path, tmp_path: Path) -> None:
    for name in ("honest", "falling"):
        petmjx.score(made / f"{name}.json", engine="mujoco", threads=1, out=tmp_path / name, **GENTLE)
    data = board(made, tmp_path / "board", {name: tmp_path / name for name in ("honest", "falling")})
    assert rating_of(data) == {"honest": 1.0, "falling": 1.0}
    assert "check=static" in data["command"]
    with pytest.warns(PlanWarning, match="falling is not rated"):
        again = board(
            made, tmp_path / "named", {name: tmp_path / name for name in ("honest", "falling")}, check="one-by-one"
        )
    assert rating_of(again) == {"honest": 1.0}


def test_a_run_that_says_more_boxes_than_its_plans_have_is_not_rated(made: Path, tmp_path: Path) -> None:
    forger = forged(made / "honest", with_column("n_boxes", lambda boxes: 500), tmp_path / "forger")
    with pytest.warns(PlanWarning, match="forger is not rated: plan o0 has 2 boxes, and 500 in the run"):
        data = board(made, tmp_path / "board", {"honest": made / "honest", "forger": forger})
    assert rating_of(data) == {"honest": 1.0}


def test_a_run_whose_plans_are_gone_is_not_rated(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    find = entries.find_plans

    def of_honest(info: Any, records: Any, plan_ids: Any, *more: Any) -> PlanLookup:
        gone = any("falling" in record.source for record in records.values())
        return PlanLookup({}, tuple(plan_ids), (), ()) if gone else find(info, records, plan_ids, *more)

    monkeypatch.setattr(entries, "find_plans", of_honest)
    with pytest.warns(PlanWarning, match="falling is not rated: the files of its plans were not found"):
        data = board(made, tmp_path / "board", {name: made / name for name in ("honest", "falling")})
    assert rating_of(data) == {"honest": 1.0}
    with pytest.raises(InputError, match="no packer is left to rate: x is not rated: the files of its plans"):
        board(made, tmp_path / "other", {"x": made / "falling", "y": made / "falling"})


STRANGERS: dict[str, dict[str, Any]] = {
    "foreign": {
        name: [placement((30 * k, 0, 0), (20, 20, 20), id="x", article="y", **{"weight/kg": 0.005}) for k in range(40)]
        for name in ORDERS
    },
    "twice": {
        name: [placement((400 * k, 0, 0), SIZE) for k in range(3)] + [placement((0, 300, 0), SIZE)] for name in ORDERS
    },
    "tiny": {
        name: [placement((30 * k, 0, 0), (20, 20, 20), **{"weight/kg": 0.005}) for k in range(2)] for name in ORDERS
    },
    "heavy": {name: [placement((400 * k, 0, 0), SIZE, **{"weight/kg": 6.0}) for k in range(2)] for name in ORDERS},
    "weighted": {name: [box | {"item": box["item"] | {"com_length/mm": -190.0}} for box in FALLS] for name in ORDERS},
    "spread": {name: [placement((2000 * k, 0, 0), SIZE) for k in range(2)] for name in ORDERS},
    "half": {"o0": GOOD, "o1": GOOD},
    "elsewhere": {"p": GOOD, "o0": GOOD},
}
RATED = {
    "foreign": 0.0,
    "twice": 1.0,
    "tiny": 0.0,
    "heavy": 0.0,
    "weighted": 0.0,
    "spread": 0.5,
    "half": 0.5,
    "elsewhere": 0.25,
}


def test_strangers_of_all_kinds_on_one_board_and_by_kpis(made: Path, tmp_path: Path) -> None:
    """Every second packer enters a run that was made without orders, the other packers enter files."""
    packers: dict[str, Path] = {"honest": made / "honest.json"}
    for number, (name, plans) in enumerate(STRANGERS.items()):
        packers[name] = write(tmp_path / f"{name}.json", plans)
        kpis = petmjx.kpis(packers[name], made / "orders.json", assume_stable=True)
        assert kpis.summary["rating"] == kpis.summary["rating_if_all_stood"] == RATED[name]
        if number % 2:
            petmjx.score(packers[name], engine="mujoco", threads=1, out=tmp_path / name)
            packers[name] = tmp_path / name
    data = board(made, tmp_path / "board", packers, replays=1)
    assert rating_of(data) == RATED | {"honest": 1.0}
    notes = "\n".join(data["notes"])
    for line in (
        "160 boxes of foreign were not ordered; the first: plan o0, y (x)",
        "8 boxes of twice were not ordered",
        "8 boxes of tiny have other sizes or masses than ordered; the first: plan o0, ",
        "8 boxes of heavy have other sizes or masses than ordered",
        "8 boxes of weighted have other centres of mass, stiffnesses or kinds than ordered; the first: plan o0, ",
        "4 boxes of spread are not on their orders' targets",
        "no KPIs of 1 plan of elsewhere: no order was given for these ids (p)",
    ):
        assert line in notes


def test_orders_that_nobody_packed_count(made: Path, tmp_path: Path) -> None:
    half = write(tmp_path / "half.json", STRANGERS["half"])
    data = board(made, tmp_path / "board", {"a": half, "b": half})
    assert rating_of(data) == {"a": 0.5, "b": 0.5}
    assert [row["n_missing"] for row in data["rating"]] == [2, 2]
    assert "2 orders (4 boxes) are packed by nobody: o2, o3" in data["notes"]


def test_plans_without_names_are_rated_by_size_and_mass(made: Path, tmp_path: Path) -> None:
    bare = {
        name: [placement(tuple(box["flb_coordinates"]), SIZE, id="", article="") for box in GOOD] for name in ORDERS
    }
    data = board(
        made, tmp_path / "board", {"bare": write(tmp_path / "bare.json", bare), "honest": made / "honest.json"}
    )
    assert rating_of(data) == {"bare": 1.0, "honest": 1.0}
    left_out = {row["packer"]: row["left_out"] for row in data["packers"] if row["size"] == "all"}
    assert left_out == {"bare": 0.0, "honest": 0.0}
    assert "8 boxes of bare have neither id nor article; matched by size and mass" in data["notes"]


# Which replays (repeated simulations of a sample) contradict a run.


@pytest.mark.parametrize(
    ("exact", "firm", "near", "same", "refused"),
    [
        (True, 0, 0, 8, False),
        (True, 1, 0, 7, True),
        (True, 0, 1, 7, False),  # near a threshold, another machine may give another verdict
        (True, 0, 1, 0, False),
        (True, 0, 3, 2, True),  # but not if most of the replayed plans have another verdict
        (False, 1, 0, 15, False),  # another engine may give another verdict for one plan of many
        (False, 2, 0, 14, True),
        (False, 0, 4, 4, False),
        (False, 0, 5, 4, True),
    ],
)
def test_which_replays_contradict_a_run(exact: bool, firm: int, near: int, same: int, refused: bool) -> None:
    rows = [("unstable", -1.5, 0)] * firm + [("unstable", -0.02, 0)] * near + [("stable", 0.9, 0)] * same
    replays = [
        Replay.judged(f"p{k}", "stable", verdict, "", margin, flags) for k, (verdict, margin, flags) in enumerate(rows)
    ]
    sample = Sample("a", "mujoco", exact, tuple(replays))
    assert bool(sample.refusal) == refused
    assert bool(sample.note) == (bool(firm + near) and not refused)
    assert len(sample.with_replays(replays).replays) == len(replays)


def test_what_is_near_a_threshold() -> None:
    def near(
        verdict: str, margin: float, flags: petmjx.engines.verdict.Flag = petmjx.engines.verdict.Flag.NONE
    ) -> bool:
        return Replay.judged("p", "stable", verdict, "", margin, int(flags)).near

    flag = petmjx.engines.verdict.Flag
    assert not near("unstable", -1.0)
    assert not near("unstable", -1.0, flag.EARLY_STOP | flag.FORKED)
    assert near("unstable", -0.05)
    assert near("invalid", float("nan"))
    for doubt in (flag.SINKING, flag.MOVING, flag.KNIFE_EDGE, flag.TIMESTEP):
        assert near("unstable", -1.0, doubt)
