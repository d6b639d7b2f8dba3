"""Tests of the packer ``balanced``. Independent computations of geometry and statics check the packings."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from shapely import MultiPoint, Point
from support.command_line import only_line, run, write
from support.packings import EPS, EURO, check_sound, corners, least_slack_mm, orders, targets
from support.plan_files import order

from petmjx.common import parallel_map as parallel_module
from petmjx.common.errors import InputError
from petmjx.common.parallel_map import ordered_results
from petmjx.packers.balanced_packer import PREFERENCE_SETS, pack_balanced
from petmjx.packers.baseline_packer import PackRules, PlacedBox, pack_best
from petmjx.packers.left_out_items import LeftOutItems
from petmjx.packers.pile_balance import MARGIN_M, Balance, hull_planes
from petmjx.packers.sample_plans import as_placements, generate, generate_one, pack_orders
from petmjx.plans.order import TARGET_EXTENT_MM, Item
from petmjx.plans.order_generator import draw_order


@settings(max_examples=60, deadline=None)
@given(items=orders, extent=targets)
def test_every_packing_is_sound(items: list[Item], extent: tuple[int, int]) -> None:
    placed = pack_balanced(items, extent)
    check_sound(placed, items, extent)
    assert placed == pack_balanced(items, extent)


@pytest.mark.parametrize("index", [1, 4, 6])
def test_high_pallets_keep_their_balance_box_by_box(index: int) -> None:
    """On dense pallets, whether a box tips depends on the loads of the boxes above it."""
    drawn = draw_order(9, index)
    placed = pack_balanced(drawn.items, TARGET_EXTENT_MM[drawn.target])
    assert min(least_slack_mm(placed[:count]) for count in range(1, len(placed) + 1)) > -EPS


def test_what_fits_easily_is_placed_as_a_whole() -> None:
    items = draw_order(0, 3).items
    assert len(pack_balanced(items, EURO)) == len(items)


def test_boxes_left_out_are_told_by_their_numbers(tmp_path: Path) -> None:
    orders_file = {"fits": order(), "some": order(4, **{"height/mm": 2500}), "none": order(2, **{"length/mm": 1300})}
    orders_file["none"]["item_sequence"]["1"]["length/mm"] = 1300
    left_out: list[LeftOutItems] = []
    path = write(tmp_path / "orders.json", orders_file)
    packed = dict(pack_orders(path, packer="balanced", on_left_out=left_out.append))
    assert {plan_id: len(plan) for plan_id, plan in packed.items()} == {"fits": 3, "some": 3}
    assert left_out == [LeftOutItems("some", 4, (2,)), LeftOutItems("none", 2, (1, 2))]


def test_equal_boxes_that_find_no_place_are_counted() -> None:
    item = Item("jam", "1", "", 1100.0, 700.0, 900.0, 10.0)
    assert len(pack_balanced([item] * 3, EURO)) == 2  # the third one would reach above 2 m


def test_it_packs_denser_than_the_baseline_and_leaves_out_less() -> None:
    heights, left = [], np.zeros(2, dtype=int)
    for index in range(12):
        drawn = draw_order(5, index)
        extent = TARGET_EXTENT_MM[drawn.target]
        both = (
            pack_best(drawn.items, extent, PackRules(), np.random.default_rng(index)),
            pack_balanced(drawn.items, extent),
        )
        left += [len(drawn.items) - len(placed) for placed in both]
        heights.append([corners(placed)[1][:, 2].max() for placed in both])
    means = np.mean(heights, axis=0)
    assert means[1] < 0.95 * means[0]
    assert left[1] <= left[0]


def test_the_other_tastes_are_for_orders_that_do_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    tight = next(
        drawn
        for drawn in (draw_order(0, index) for index in (27, 593, 529))
        if len(packed_with(drawn.items, 1, drawn.target, monkeypatch)) < len(drawn.items)
    )
    first = packed_with(tight.items, 1, tight.target, monkeypatch)
    every = packed_with(tight.items, len(PREFERENCE_SETS), tight.target, monkeypatch)
    assert len(every) > len(first)


def packed_with(items: tuple[Item, ...], n_sets: int, target: str, monkeypatch: pytest.MonkeyPatch) -> list[PlacedBox]:
    monkeypatch.setattr("petmjx.packers.balanced_packer.PREFERENCE_SETS", PREFERENCE_SETS[:n_sets])
    return pack_balanced(items, TARGET_EXTENT_MM[target])


# -- the class Balance -------------------------------------------------------------------------------------------------


def put(pile: Balance, x: float, y: float, z: float, size: tuple[float, float, float], mass: float) -> bool:
    rest = pile.rest((x, y, z), size[:2], mass)
    if rest is not None:
        pile.add((x, y, z), size, rest)
    return rest is not None


def test_a_bridge_shares_its_load_by_the_lever_rule() -> None:
    """If a weight of 3 kg is at a quarter of the distance between two narrow supports, the supports carry it 3:1."""
    pile = Balance(5)
    assert put(pile, 0, 0, 0, (100, 300, 200), 1.0)
    assert put(pile, 700, 0, 0, (100, 300, 200), 1.0)
    assert put(pile, 0, 0, 200, (800, 300, 50), 2.0)
    assert put(pile, 175, 50, 250, (100, 200, 100), 3.0)  # centre at x = 225: (225 - 50) / 700 = 1/4
    left, right, bridge, weight = pile.loads
    assert weight[0] == pytest.approx(3.0)
    assert bridge[0] == pytest.approx(5.0)
    # the supports are 100 mm wide: their forces differ from those of the lever rule by at most (100 / 700)² / 3
    assert left[0] - 1.0 == pytest.approx(1.0 + 3 * 0.75, rel=0.01)
    assert right[0] - 1.0 == pytest.approx(1.0 + 3 * 0.25, rel=0.02)
    assert left[0] + right[0] == pytest.approx(7.0)


def test_an_overhang_is_judged_by_the_margin() -> None:
    size = (400.0, 300.0, 200.0)
    for overhang, holds in ((179.0, True), (181.0, False), (220.0, False)):
        pile = Balance(2)
        assert put(pile, 0, 0, 0, size, 5.0)
        assert put(pile, overhang, 0, 200, size, 5.0) is holds, overhang
    assert MARGIN_M == 0.020


def test_a_box_that_would_tip_one_below_is_refused() -> None:
    """Each box alone is well supported, but the weight of the third box would tip the second box over the edge of the
    first box."""
    pile = Balance(3)
    assert put(pile, 0, 0, 0, (400, 300, 200), 5.0)
    assert put(pile, 170, 0, 200, (400, 300, 200), 5.0)
    assert not put(pile, 300, 0, 400, (400, 300, 200), 5.0)
    assert put(pile, 100, 0, 400, (400, 300, 200), 5.0)  # at this place, the box is a counterweight


def test_nothing_below_is_no_support() -> None:
    assert Balance(1).rest((0, 0, 100), (100, 100), 1.0) is None


@settings(max_examples=40, deadline=None)
@given(items=orders)
def test_no_weight_is_lost_on_its_way_down(items: list[Item]) -> None:
    """The loads of the boxes on the carrier add up to the weight of all boxes, and to its moments."""
    placed = pack_balanced(items, EURO)
    pile = Balance(len(placed))
    low, high = corners(placed)
    for box, start, end in zip(placed, low, high, strict=True):
        put(pile, *start, tuple(end - start), box.item.weight_kg)
    on_carrier = pile.loads[low[: pile.n, 2] <= 0].sum(axis=0)
    middles = (low + high)[:, :2] / 2 / 1000
    weights = np.array([box.item.weight_kg for box in placed])
    assert pile.n == len(placed)
    assert on_carrier == pytest.approx([weights.sum(), *(weights @ middles)], rel=1e-9)


@settings(max_examples=60, deadline=None)
@example(rectangles=[(0.0, 1.0, 0.5, 0.5), (5e-324, 0.0, 0.5, 0.5)], point=(0.25, 0.5))
@given(
    rectangles=st.lists(st.tuples(*[st.floats(0, 1)] * 2, *[st.floats(0.05, 0.5)] * 2), min_size=1, max_size=5),
    point=st.tuples(st.floats(-0.2, 1.7), st.floats(-0.2, 1.7)),
)
def test_planes_are_those_of_the_convex_hull(
    rectangles: list[tuple[float, float, float, float]], point: tuple[float, float]
) -> None:
    low = np.array([rectangle[:2] for rectangle in rectangles])
    high = low + np.array([rectangle[2:] for rectangle in rectangles])
    margin = 0.01
    beyond = float((hull_planes(low, high, margin) @ [1.0, *point]).max())
    hull = MultiPoint([(x, y) for a, b in zip(low, high, strict=True) for x in (a[0], b[0]) for y in (a[1], b[1])])
    inside = hull.convex_hull.contains(Point(point))
    distance = hull.convex_hull.exterior.distance(Point(point))
    if inside:
        assert beyond == pytest.approx(margin - distance, abs=1e-9)
    else:
        assert beyond > margin - 1e-9


# -- packers by name, in several processes -----------------------------------------------------------------------------


def test_both_packers_get_the_same_orders_and_the_baseline_is_what_it_was() -> None:
    plan_id, placements = generate_one(0, 7, packer="balanced")
    baseline_id, baseline = generate_one(0, 7, loose_share=0.0)
    assert plan_id == baseline_id == "s7-000000"
    assert Counter(entry["item"]["id"] for entry in baseline) <= Counter(entry["item"]["id"] for entry in placements)
    drawn = draw_order(7, 0)
    assert placements == as_placements(pack_balanced(drawn.items, TARGET_EXTENT_MM[drawn.target]))


def test_a_packer_that_is_named_packs_no_plan_loosely(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strict = dict(generate(12, 7, loose_share=0.0))
    assert dict(generate(12, 7, packer="baseline")) == strict
    assert generate_one(2, 7, packer="baseline")[1] == strict["s7-000002"]
    packed = tmp_path / "plans.json"
    command = ("samples", "-n", "12", "--seed", "7", "--workers", "1", "-o", packed, "--overwrite")
    assert run(*command, "--packer", "baseline") == 0
    assert json.loads(packed.read_text()) == strict
    assert "loosely" not in capsys.readouterr().out
    assert run(*command) == 0
    assert json.loads(packed.read_text()) == dict(generate(12, 7)) != strict
    assert "about 50 % of these plans are packed loosely on purpose" in capsys.readouterr().out


def test_processes_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel_module, "ALONE", 4)
    left_out: dict[int, list[LeftOutItems]] = {1: [], 2: []}
    plans = {
        workers: list(generate(24, 2, workers=workers, on_left_out=left_out[workers].append)) for workers in left_out
    }
    assert plans[1] == plans[2]
    assert left_out[1] == left_out[2] != []


def test_few_tasks_are_done_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel_module, "process_pool", None)
    assert list(ordered_results(abs, range(-5, 0), workers=8)) == [5, 4, 3, 2, 1]


def test_an_unknown_packer_is_one_line(tmp_path: Path) -> None:
    line = "unknown packer balancd; did you mean balanced"
    with pytest.raises(InputError, match=line):
        generate(1, 0, packer="balancd")
    with pytest.raises(InputError, match=line):
        pack_orders(tmp_path / "orders.json", packer="balancd")


def test_the_command_tells_what_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    packed = tmp_path / "plans.json"
    assert run("samples", "-n", "12", "--packer", "balanced", "--workers", "1", "-o", packed) == 0
    assert capsys.readouterr().out == f"12 plans in {packed}\n"
    assert list(json.loads(packed.read_text())) == [f"s0-{index:06d}" for index in range(12)]
    tall = write(tmp_path / "orders.json", {"tall": order(3, **{"height/mm": 2500})})
    assert run("samples", "--orders", tall, "--packer", "balanced", "-o", packed, "--overwrite") == 0
    assert capsys.readouterr().out.splitlines() == [
        "order tall: 1 of 3 boxes is left out: item 2",
        f"1 plan in {packed}; 1 box of 1 order left out",
    ]
    for name, hints in {
        "best": "there are baseline, balanced, learned, physical",
        "physicl": "did you mean physical?",
    }.items():
        assert run("samples", "-n", "1", "--packer", name, "-o", packed, "--overwrite") == 2
        assert f"unknown packer {name}; {hints}" in only_line(capsys.readouterr().err)


def test_real_orders_are_packed_and_hold_more_than_the_baseline_places(real_data: Path) -> None:
    placed = {}
    for packer in ("baseline", "balanced"):
        plans = dict(pack_orders(real_data / "5_bed-bpp.json", packer=packer))
        placed[packer] = sum(map(len, plans.values()))
    assert placed["balanced"] > placed["baseline"]
