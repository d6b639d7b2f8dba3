"""Generated, packed, hand-made and bundled plans: statistics, geometry, reproducibility, bad orders."""

from __future__ import annotations

import gzip
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command_line import run, write
from support.plan_files import order

from petmjx.common.errors import InputError
from petmjx.packers.baseline_packer import MAX_HEIGHT_MM, PackRules, in_hull_of_rectangles
from petmjx.packers.handmade_plans import CARTON, HANDMADE, bundled_plans
from petmjx.packers.left_out_items import LeftOutItems
from petmjx.packers.sample_plans import LOOSE_SUPPORT, generate, generate_one, pack_orders, write_samples
from petmjx.plans.bedbpp_writer import write_plans
from petmjx.plans.bundled import bundled_path
from petmjx.plans.order import TARGET_EXTENT_MM
from petmjx.plans.order_generator import MAX_BOXES, MIN_BOXES, catalogue, draw_order
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan_reader import load_plans

N = 100
SEED = 7

STATISTICS_TOLERANCE_BOXES = 4.2
"""Three standard errors of the mean number of boxes of 100 drawn orders, whose standard deviation is 14."""

Plan = list[dict[str, Any]]


@pytest.fixture(scope="module")
def plans() -> dict[str, Plan]:
    return dict(generate(N, SEED))


@pytest.fixture(scope="module")
def strict_plans() -> dict[str, Plan]:
    return dict(generate(25, SEED, loose_share=0.0))


def geometry(plan: Plan) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) lowest and highest corners of the boxes as placed, mm."""
    low = np.array([placement["flb_coordinates"] for placement in plan], dtype=float)
    size = []
    for placement in plan:
        item = placement["item"]
        base = [item["length/mm"], item["width/mm"]]
        size.append((base[::-1] if placement["orientation"] == 1 else base) + [item["height/mm"]])
    return low, low + np.array(size, dtype=float)


def support_shares(plan: Plan) -> list[float]:
    """Share of each box's base that rests on the carrier or on boxes placed before it. Computed box by box, in another
    way than by the packer."""
    low, high = geometry(plan)
    shares = []
    for k in range(len(plan)):
        if low[k, 2] == 0:
            shares.append(1.0)
            continue
        carried = 0.0
        for j in range(k):
            if high[j, 2] == low[k, 2]:
                x = min(high[j, 0], high[k, 0]) - max(low[j, 0], low[k, 0])
                y = min(high[j, 1], high[k, 1]) - max(low[j, 1], low[k, 1])
                carried += max(x, 0) * max(y, 0)
        shares.append(carried / float(np.prod((high - low)[k, :2])))
    return shares


def n_overlapping_pairs(plan: Plan) -> int:
    low, high = geometry(plan)
    shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    return int(np.triu((shared > 0).all(axis=2), 1).sum())


def test_generated_plans_have_the_keys_of_bed_bpp(plans: dict[str, Plan]) -> None:
    assert list(plans)[:2] == ["s7-000000", "s7-000001"]
    keys = {"article", "id", "product_group", "length/mm", "width/mm", "height/mm", "weight/kg", "sequence"}
    for plan in plans.values():
        assert [placement["item"]["sequence"] for placement in plan] == list(range(1, len(plan) + 1))
        for placement in plan:
            assert set(placement) == {"item", "orientation", "flb_coordinates"}
            assert set(placement["item"]) == keys
            assert placement["orientation"] in (0, 1)


def test_packed_plans_hold_43_plus_minus_14_boxes(plans: dict[str, Plan]) -> None:
    counts = np.array([len(plan) for plan in plans.values()])
    assert abs(counts.mean() - 43) < STATISTICS_TOLERANCE_BOXES
    assert abs(counts.std() - 14) < STATISTICS_TOLERANCE_BOXES
    assert counts.max() <= MAX_BOXES


def test_an_order_of_the_smallest_articles_that_is_still_too_much_has_fewer_boxes() -> None:
    """Order 4029 of this seed has no smaller article left to exchange."""
    drawn = draw_order(33446, 4029)
    length, width = TARGET_EXTENT_MM[drawn.target]
    volume_m3 = sum(item.volume_m3 for item in drawn.items)
    assert MIN_BOXES <= len(drawn.items) <= MAX_BOXES
    assert volume_m3 <= 0.7 * length * width * 2000 * 1e-9


def test_orders_have_about_half_as_many_distinct_articles_as_boxes() -> None:
    shares = []
    for index in range(N):
        items = draw_order(SEED, index).items
        assert MIN_BOXES <= len(items) <= MAX_BOXES
        shares.append(len({item.item_id for item in items}) / len(items))
    assert 0.45 < np.mean(shares) < 0.6


def test_one_id_is_one_article_in_all_plans(plans: dict[str, Plan]) -> None:
    seen: dict[str, tuple[Any, ...]] = {}
    for plan in plans.values():
        for placement in plan:
            item = {key: value for key, value in placement["item"].items() if key != "sequence"}
            assert seen.setdefault(item["id"], tuple(item.values())) == tuple(item.values())


def test_cartons_have_sizes_weights_and_densities_of_groceries() -> None:
    articles = catalogue(SEED)
    sizes = np.array([(item.length_mm, item.width_mm, item.height_mm) for item in articles])
    weights = np.array([item.weight_kg for item in articles])
    volumes = np.array([item.volume_m3 for item in articles])
    assert sizes.min() >= 100
    assert sizes.max() <= 600
    assert (sizes[:, 0] >= sizes[:, 1]).all()
    assert weights.min() >= 0.2
    assert weights.max() <= 20
    assert np.ptp(weights) > 10
    density = weights / volumes
    assert density.min() > 59  # the range is 60 to 900 kg/m³ before the weight is rounded to grams
    assert density.max() < 901
    assert np.corrcoef(np.log(volumes), np.log(weights))[0, 1] > 0.6


def test_boxes_stand_inside_their_target_below_2_m(plans: dict[str, Plan]) -> None:
    for index, plan in enumerate(plans.values()):
        low, high = geometry(plan)
        assert (low >= 0).all()
        assert (high.max(axis=0)[:2] <= TARGET_EXTENT_MM[draw_order(SEED, index).target]).all()
        assert high[:, 2].max() <= MAX_HEIGHT_MM


def test_boxes_do_not_overlap(plans: dict[str, Plan], strict_plans: dict[str, Plan]) -> None:
    assert [plan_id for plan_id, plan in plans.items() if n_overlapping_pairs(plan)] == []
    assert [plan_id for plan_id, plan in strict_plans.items() if n_overlapping_pairs(plan)] == []


def test_few_boxes_are_left_out(plans: dict[str, Plan]) -> None:
    ordered = sum(len(draw_order(SEED, index).items) for index in range(N))
    assert sum(map(len, plans.values())) > 0.97 * ordered


def test_strict_plans_keep_the_support_rule(strict_plans: dict[str, Plan]) -> None:
    for plan in strict_plans.values():
        assert min(support_shares(plan)) >= PackRules().min_support - 1e-9


def test_loose_plans_use_the_freedom_they_have_and_no_more() -> None:
    least = [min(support_shares(plan)) for _, plan in generate(25, SEED, loose_share=1.0)]
    assert min(least) >= LOOSE_SUPPORT[0] - 1e-9
    assert np.median(least) < LOOSE_SUPPORT[1]


def test_no_box_is_put_below_one_that_stands(plans: dict[str, Plan]) -> None:
    """A robot can reach every place from above: a box that covers another box is placed after it."""
    for plan in list(plans.values())[:40]:
        low, high = geometry(plan)
        shared = np.minimum(high[:, None, :2], high[None, :, :2]) - np.maximum(low[:, None, :2], low[None, :, :2])
        covers = (shared > 0).all(axis=2) & (low[:, None, 2] >= high[None, :, 2])
        above, below = np.nonzero(covers)
        assert (above > below).all()


def test_fewer_plans_are_a_prefix_and_a_plan_is_made_alone(plans: dict[str, Plan]) -> None:
    assert list(generate(10, SEED)) == list(plans.items())[:10]
    assert generate_one(93, SEED) == ("s7-000093", plans["s7-000093"])
    assert dict(generate(3, SEED + 1))["s8-000000"] != plans["s7-000000"]


def test_hull_of_two_supports_holds_the_middle_but_not_the_side() -> None:
    low, high = np.array([[0.0, 0.0], [8.0, 0.0]]), np.array([[1.0, 2.0], [9.0, 2.0]])
    assert in_hull_of_rectangles(np.array([4.0, 1.0]), low, high)
    assert not in_hull_of_rectangles(np.array([4.0, 2.5]), low, high)
    assert not in_hull_of_rectangles(np.array([4.0, 1.0]), low[:1], high[:1])


def test_written_samples_read_back_plain_and_gzipped(tmp_path: Path, plans: dict[str, Plan]) -> None:
    seen: list[int] = []
    write_samples(tmp_path / "plans.json", 4, SEED, progress=seen.append)
    assert seen == [1, 2, 3, 4]
    written = json.loads((tmp_path / "plans.json").read_text(encoding="utf-8"))
    assert list(written.items()) == list(plans.items())[:4]
    for name in ("a.json.gz", "b.json.gz"):
        write_samples(tmp_path / name, 4, SEED)
    assert (tmp_path / "a.json.gz").read_bytes() == (tmp_path / "b.json.gz").read_bytes()
    assert json.loads(gzip.decompress((tmp_path / "a.json.gz").read_bytes())) == written


@pytest.mark.parametrize(
    ("n", "seed", "loose_share", "text"),
    [
        (0, 0, 0.5, "at least 1"),
        (200_001, 0, 0.5, "n must be at most 200,000, got 200001"),
        (1, -1, 0.5, "seed must be at least 0"),
        (1, 0, 1.5, "loose_share must be at most 1"),
        (1, 0, float("nan"), "loose_share must be finite"),
    ],
)
def test_unusable_options_are_refused(n: int, seed: int, loose_share: float, text: str) -> None:
    with pytest.raises(InputError, match=text):
        generate(n, seed, loose_share=loose_share)


def test_a_path_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written") as caught:
        write_samples(tmp_path / "missing" / "plans.json", 1, 0)
    assert "\n" not in str(caught.value)


def test_orders_become_plans_and_half_millimetres_survive(tmp_path: Path) -> None:
    packed = dict(pack_orders(write(tmp_path / "orders.json", {"o1": order()})))
    (plan,) = packed.values()
    assert [placement["flb_coordinates"][2] for placement in plan] == [0, 0, 0]
    assert {placement["item"]["height/mm"] for placement in plan} == {200.5}
    assert n_overlapping_pairs(plan) == 0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"weight/kg": -1}, "item 2: weight/kg must be > 0, got -1"),
        ({"length/mm": float("nan")}, "item 2: length/mm must be finite, got NaN"),
        ({"width/mm": 10**400}, "item 2: width/mm must be finite, got an integer of more than 60 digits"),
        ({"height/mm": "200"}, 'item 2: height/mm must be a number, got "200"'),
        ({"height/mm": True}, "item 2: height/mm must be a number, got true"),
        ({"id": None}, "item 2: id must be a string, got null"),
        (
            {"com_height/mm": -101},
            "item 2: com_height/mm must be inside the box, less than half of 200.5 from the middle, got -101",
        ),
    ],
)
def test_a_bad_item_is_named_and_the_other_orders_are_packed(
    tmp_path: Path, changes: dict[str, Any], text: str
) -> None:
    path = write(tmp_path / "orders.json", {"bad": order(**changes), "good": order()})
    with pytest.raises(InputError) as caught:
        list(pack_orders(path))
    assert str(caught.value) == f"{path}: order bad, {text}"
    skipped: list[InputError] = []
    assert [plan_id for plan_id, _ in pack_orders(path, on_bad_order=skipped.append)] == ["good"]
    assert len(skipped) == 1


def test_without_a_usable_order_no_file_is_touched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    orders = write(tmp_path / "orders.json", {"bad": order(id=None)})
    (tmp_path / "plans.json").write_text("kept")
    assert run("samples", "--orders", str(orders), "-o", str(tmp_path / "plans.json"), "--overwrite") == 2
    skipped, error = capsys.readouterr().err.splitlines()
    assert skipped.startswith(f"skipped: {orders}: order bad, item 2: id")
    assert error == f"petmjx: {tmp_path / 'plans.json'}: there is no plan to write"
    assert (tmp_path / "plans.json").read_text() == "kept"


@pytest.mark.parametrize(
    ("record", "text"),
    [
        ([], "must be an object, got a list"),
        ({**order(), "properties": {"target": "ship"}}, "properties.target must be one of"),
        ({**order(), "properties": None}, "properties.target must be one of"),
        ({**order(), "item_sequence": {}}, "item_sequence must be"),
        ({**order(), "item_sequence": {"x": {}}}, "keys of item_sequence must be whole numbers, got 'x'"),
        ({**order(), "item_sequence": {"1": 5}}, "item 1: must be an object, got 5"),
    ],
)
def test_a_bad_order_is_one_line(tmp_path: Path, record: object, text: str) -> None:
    with pytest.raises(InputError, match="order o1") as caught:
        list(pack_orders(write(tmp_path / "orders.json", {"o1": record})))
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("cut.json", b'{"o1": {'),
        ("empty.json", b""),
        ("binary.json", b"\xff\xfe\x00"),
        ("list.json", b"[]"),
        ("cut.json.gz", gzip.compress(b"{}", mtime=0)[:-6]),
        ("none.json", b"{}"),
        ("no-gzip.json.gz", b"{"),
        ("digits.json", b"[" + b"9" * 5000 + b"]"),
        ("block.json.gz", gzip.compress(b"{}", mtime=0)[:10] + b"\xff" * 20),
        ("damaged.json.gz", gzip.compress(b"{}" * 50, mtime=0)[:12] + b"\xff" * 20),
    ],
)
def test_a_file_that_holds_no_orders_is_one_line(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=name) as caught:
        list(pack_orders(tmp_path / name))
    assert "\n" not in str(caught.value)


def test_items_beyond_a_physical_range_are_refused_with_the_range(tmp_path: Path) -> None:
    for changes, text in (
        ({"length/mm": 1e300}, "item 2: length/mm must be from 1 to 4000 (mm), got 1e+300"),
        ({"weight/kg": 1e-9}, "item 2: weight/kg must be from 0.001 to 10000 (kg), got 1e-09"),
        ({"product_group": 3}, "item 2: product_group must be a string, got 3"),
    ):
        with pytest.raises(InputError, match=re.escape(text)):
            list(pack_orders(write(tmp_path / "orders.json", {"o1": order(**changes)})))
    with pytest.raises(InputError, match="order o1: must have at most 512 items, got 513"):
        list(pack_orders(write(tmp_path / "orders.json", {"o1": order(513)})))


def test_a_centre_of_mass_may_be_anywhere_inside_the_box(tmp_path: Path) -> None:
    com_mm = {"com_length/mm": -199.0, "com_width/mm": 149.0, "com_height/mm": 100.0}
    ((_, read),) = read_orders(write(tmp_path / "orders.json", {"o1": order(**com_mm)}))
    assert [item.com_mm for item in read.items] == [None, (-199.0, 149.0, 100.0), None]


def test_repeated_order_ids_are_told(tmp_path: Path) -> None:
    text = json.dumps(order())
    skipped: list[InputError] = []
    path = write(tmp_path / "orders.json", f'{{"a": {text}, "a": {text}, "b": {text}}}')
    assert [plan_id for plan_id, _ in pack_orders(path, on_bad_order=skipped.append)] == ["a", "b"]
    assert [str(error) for error in skipped] == [f"{path}: order a: repeated order id"]


def test_boxes_that_find_no_place_are_named(tmp_path: Path) -> None:
    """Items are named by their numbers in the order. An order of which no item fits gives no plan."""
    orders = {"fits": order(), "some": order(4, **{"height/mm": 2500}), "none": order(2, **{"length/mm": 1300})}
    orders["none"]["item_sequence"]["1"]["length/mm"] = 1300
    left_out: list[LeftOutItems] = []
    packed = dict(pack_orders(write(tmp_path / "orders.json", orders), on_left_out=left_out.append))
    assert {plan_id: len(plan) for plan_id, plan in packed.items()} == {"fits": 3, "some": 3}
    assert left_out == [LeftOutItems("some", 4, (2,)), LeftOutItems("none", 2, (1, 2))]
    assert [str(leftover) for leftover in left_out] == [
        "order some: 1 of 4 boxes is left out: item 2",
        "order none: 2 of 2 boxes are left out: items 1, 2",
    ]


def test_a_missing_orders_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        list(pack_orders(tmp_path / "none.json"))


def test_real_orders_are_packed(real_data: Path) -> None:
    path = real_data / "5_bed-bpp.json"
    ordered = {order_id: len(record["item_sequence"]) for order_id, record in json.loads(path.read_text()).items()}
    left_out: list[LeftOutItems] = []
    packed = dict(pack_orders(path, on_left_out=left_out.append))
    assert list(packed) == list(ordered)
    missing = {leftover.order_id: len(leftover.numbers) for leftover in left_out}
    assert {plan_id: ordered[plan_id] - len(plan) for plan_id, plan in packed.items() if plan_id in missing} == missing
    assert sum(missing.values()) == sum(ordered.values()) - sum(map(len, packed.values())) > 0
    for plan_id, plan in packed.items():
        # the three orders for roll containers have more boxes than fit below 2 m
        assert len(plan) >= 0.6 * ordered[plan_id]
        assert n_overlapping_pairs(plan) == 0
        assert min(support_shares(plan)) >= PackRules().min_support - 1e-9


def test_handmade_geometry_is_what_the_reasons_say() -> None:
    plans = {plan.plan_id: plan for plan in HANDMADE}
    assert len(plans) == len(HANDMADE) >= 10
    assert {plan.expected for plan in HANDMADE} == {"stable", "unstable"}
    for plan in HANDMADE:
        assert n_overlapping_pairs(list(plan.placements)) == 0, plan.plan_id
    for name, share in (("45", 0.55), ("55", 0.45)):
        assert support_shares(list(plans[f"hand-overhang-{name}"].placements))[1] == pytest.approx(share)
    assert support_shares(list(plans["hand-bridge"].placements))[2] == pytest.approx(2 / 3)
    assert min(support_shares(list(plans["hand-staircase"].placements))) == pytest.approx(0.6)
    assert support_shares(list(plans["hand-over-corner"].placements))[1] == pytest.approx(0.36)
    tower_low, tower_high = geometry(list(plans["hand-tower"].placements))
    assert tower_high[:, 2].max() == 1840
    assert (tower_low[:, :2] == 0).all()


@pytest.mark.parametrize(
    ("plan_id", "overhang"), [("hand-harmonic-stack", 0.45), ("hand-overhang-45", 0.45), ("hand-overhang-55", 0.55)]
)
def test_common_centres_of_leaning_stacks(plan_id: str, overhang: float) -> None:
    """For each box, the common centre of all boxes above it is ``overhang`` lengths away from the box's centre."""
    (plan,) = [plan for plan in HANDMADE if plan.plan_id == plan_id]
    low, high = geometry(list(plan.placements))
    centre = (low + high)[:, 0] / 2
    for k in range(len(centre) - 1):
        assert centre[k + 1 :].mean() - centre[k] == pytest.approx(overhang * CARTON[0])


def test_bundled_set_is_what_its_generator_makes(tmp_path: Path) -> None:
    write_plans(tmp_path / "again.json", bundled_plans())
    assert (tmp_path / "again.json").read_text(encoding="utf-8") == bundled_path().read_text(encoding="utf-8")


def test_bundled_set_is_read_without_a_complaint() -> None:
    plan_set = load_plans(bundled_path())
    assert not plan_set.skipped
    sizes = sorted(plan.n_boxes for plan in plan_set.plans)
    assert 22 <= len(sizes) <= 28
    assert sum(10 <= n <= 20 for n in sizes) >= 6
    assert sizes[-2] > 40
