"""Tests of the packer ``learned``: the boxes that it sees, the candidates that it may choose, and the probabilities
that it predicts."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from support.command_line import only_line, run, write
from support.packings import check_sound, orders, targets
from support.plan_files import order
from support.plans import make_plan, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.common.parallel_map import ordered_results
from petmjx.packers import learned_packer as learned_module
from petmjx.packers.balanced_packer import PREFERENCE_SETS
from petmjx.packers.free_space import AIR, LARGE, LEVEL_MM, SMALL, free_space
from petmjx.packers.height_map import CELL_MM, HeightMap
from petmjx.packers.item_stream import ItemStream, by_taste, pack_stream
from petmjx.packers.learned_candidates import COARSE_MM, LEAST_SUPPORT, FourSidedStream, lowest_first
from petmjx.packers.learned_features import NAMES, features
from petmjx.packers.learned_packer import CLEARANCE_MM, LEARNED, Policy, pack_learned, published_policy
from petmjx.packers.packer_registry import LEFT_OUT_REASONS
from petmjx.packers.packing_state import Packing
from petmjx.packers.policy_network import likely
from petmjx.packers.sample_plans import generate
from petmjx.packers.stability_features import NAMES as STABILITY_NAMES
from petmjx.plans.order import TARGET_EXTENT_MM, Item, Order
from petmjx.plans.order_generator import draw_order

DRAWN = draw_order(5, 3)
EXTENT = TARGET_EXTENT_MM[DRAWN.target]
LARGEST_FILE = 5_000_000


@settings(max_examples=15, deadline=None)
@given(items=orders, extent=targets)
def test_its_packings_are_sound_and_apart(items: list[Item], extent: tuple[int, int]) -> None:
    for look_ahead in (1, 4):
        placed = pack_learned(items, extent, look_ahead)
        check_sound(placed, items, extent, CLEARANCE_MM, LEAST_SUPPORT)


def test_what_has_not_come_yet_changes_nothing() -> None:
    items = list(DRAWN.items)
    first = pack_learned(items[:20], EXTENT)
    other = [replace(item, length_mm=item.length_mm + 40.0, item_id="other") for item in items[20:]]
    assert pack_learned([*items[:20], *other], EXTENT)[: len(first)] == first
    # with a look-ahead of five, only the next five boxes are seen
    seen = FourSidedStream(items, EXTENT, CLEARANCE_MM, 5)
    assert len(seen.seen) == 5
    assert {items[i] for i in range(5)} >= {items[0]}
    assert set(seen.places().kind.tolist()) == set(seen.seen)


def test_with_a_look_ahead_boxes_wait_for_their_turn() -> None:
    """If the packer sees the whole order, the packing differs from that made box by box. No box is placed twice."""
    far = pack_learned(DRAWN.items, EXTENT, 60)
    assert [box.item for box in far] != [box.item for box in pack_learned(DRAWN.items, EXTENT)]
    check_sound(far, DRAWN.items, EXTENT, CLEARANCE_MM, LEAST_SUPPORT)


def test_plans_depend_on_the_order_alone() -> None:
    one = partial(_packed, seed=5)
    assert list(ordered_results(one, range(2), 2, alone=1, chunk=1)) == [one(index) for index in range(2)]
    assert list(generate(1, 5, packer=LEARNED)) == list(generate(2, 5, packer=LEARNED))[:1]


def _packed(index: int, seed: int) -> list[tuple[float, ...]]:
    drawn = draw_order(seed, index)
    return [box.corner_mm for box in pack_learned(drawn.items, TARGET_EXTENT_MM[drawn.target])]


# ---------------------------------------------------------------------- streams


def test_the_rule_on_a_stream_is_that_of_balanced() -> None:
    """If the rule of ``balanced`` sees all boxes of a stream, its packing is that of the packer ``balanced``."""
    packing = Packing(DRAWN.items, EXTENT, PREFERENCE_SETS[0])
    packing.fill()
    stream = ItemStream(DRAWN.items, EXTENT, 0.0, len(DRAWN.items))
    assert pack_stream(stream, by_taste) == packing.placed


def test_a_copy_of_a_stream_goes_its_own_way() -> None:
    """A copy of a stream does not depend on the original: it packs as the original did, although the original has gone
    on."""

    def go_on(stream: FourSidedStream) -> None:
        for _ in range(6):
            chosen = lowest_first(stream)
            assert chosen is not None
            stream.put(chosen)

    stream = FourSidedStream(DRAWN.items, EXTENT, CLEARANCE_MM, 3)
    go_on(stream)
    twin = stream.copy()
    go_on(stream)
    assert len(twin.placed) == 6
    go_on(twin)
    assert twin.placed == stream.placed
    np.testing.assert_array_equal(twin.masses, stream.masses)
    for name in ("surface", "coarse"):
        np.testing.assert_array_equal(getattr(twin, name).height, getattr(stream, name).height)
    np.testing.assert_array_equal(twin.places().corner_mm, stream.places().corner_mm)


def test_places_say_where_the_box_would_rest() -> None:
    stream = FourSidedStream(DRAWN.items, EXTENT, CLEARANCE_MM, 3)
    for _ in range(12):
        chosen = lowest_first(stream)
        assert chosen is not None
        stream.put(chosen)
    places = stream.places()
    low, high = stream.boxes
    for corner, size in zip(places.corner_mm, places.size_mm, strict=True):
        end = corner + size
        meets = ((np.minimum(end, high) - np.maximum(corner, low))[:, :2] > 1e-6).all(axis=1)
        assert corner[2] == pytest.approx(high[meets, 2].max(initial=0.0))
        assert (end[:2] <= np.array(stream.extent_mm) + 1e-6).all()
    assert ((places.support >= LEAST_SUPPORT - 1e-9) & (places.support <= 1 + 1e-9)).all()
    rows = features(stream, places)
    assert rows.shape == (len(places), len(NAMES))
    assert np.isfinite(rows).all()
    assert (rows[:, NAMES.index("support")] == places.support).all()


def test_places_are_on_all_sides() -> None:
    """Candidates are on all sides of the pile: if the pile is mirrored, so are the candidates. The candidates of
    ``balanced`` are among them."""
    items = DRAWN.items[:14]
    straight, plain = FourSidedStream(items, EXTENT, CLEARANCE_MM), ItemStream(items, EXTENT, CLEARANCE_MM)
    mirrored = FourSidedStream(items, EXTENT, CLEARANCE_MM)
    extent = np.array(straight.extent_mm)
    for _ in items[:-1]:
        places, table = straight.places(0.5), plain._table
        seen = np.flatnonzero(plain._kind_of == plain.seen[0])
        point, column = np.nonzero(table.open[:, seen] & (table.carried[:, seen] >= (0.5 - 1e-9) * table.area[seen]))
        theirs = zip(seen[column], *table.points[point].T, table.z[point, seen[column]], strict=True)
        base = places.size_mm[:, :2]
        keys = {_key(*corner) for corner in zip(places.shape, *places.corner_mm.T, strict=True)}
        assert {_key(*corner) for corner in theirs} <= keys
        corner, other = places.corner_mm.copy(), mirrored.places(0.5)
        corner[:, 0] = extent[0] - corner[:, 0] - base[:, 0]
        mirror_keys = {_key(*place) for place in zip(other.shape, *other.corner_mm.T, strict=True)}
        assert {_key(*place) for place in zip(places.shape, *corner.T, strict=True)} == mirror_keys
        chosen = by_taste(plain)
        if chosen is None:
            for stream in (plain, straight, mirrored):
                stream.skip()
            continue
        put_at(straight, chosen.shape, chosen.corner_mm)
        plain.put(chosen)
        width = float(plain.boxes[1][-1, 0] - plain.boxes[0][-1, 0])
        x, y, z = chosen.corner_mm
        put_at(mirrored, chosen.shape, (float(extent[0]) - x - width, y, z))


def put_at(stream: FourSidedStream, shape: int, corner: tuple[float, float, float]) -> None:
    """Place the next box at the candidate with the given shape and corner."""
    places = stream.places(0.5)
    here = np.flatnonzero((places.shape == shape) & (np.abs(places.corner_mm - corner).max(axis=1) < 1e-6))
    chosen = stream.keeps_balance(places, int(here[0]))
    assert chosen is not None
    stream.put(chosen)


def _key(shape: int, *corner: float) -> tuple[float, ...]:
    return (int(shape), *(round(float(side), 3) for side in corner))


def test_room_is_where_typical_cartons_could_stand() -> None:
    """The features of free space are compared with loops over all places of all typical cartons, on a pile with
    steps."""
    surface, rng = HeightMap(EXTENT, COARSE_MM), np.random.default_rng(2)
    for top in (150.0, 230.0, 300.0):
        low = np.array([*rng.uniform(0, 400, 2), 0.0])
        surface.put(low, np.array([*(low[:2] + rng.uniform(200, 400, 2)), top]))
    low = np.array([[0.0, 0.0, 100.0], [300.0, 200.0, 350.0]])
    high = low + np.array([400.0, 300.0, 120.0])
    measures = free_space(surface, low, high)
    for row in range(2):
        height = surface.height.copy()
        (x0, y0), (x1, y1) = surface.lines(low)[row], surface.lines(high)[row]
        height[x0:x1, y0:y1] = high[row, 2]
        for name, cartons in (("small", SMALL), ("large", LARGE)):
            lowest, level = [], []
            for turns in cartons:
                costs = []
                for wide, deep in turns:
                    windows = np.lib.stride_tricks.sliding_window_view(height, (wide, deep))
                    top, mean = windows.max(axis=(2, 3)), windows.mean(axis=(2, 3))
                    costs.append((top + AIR * (top - mean)).min())
                    level.append((top - mean < LEVEL_MM).mean())
                lowest.append(min(costs))
            assert measures[f"room_{name}"][row] == pytest.approx(np.mean(lowest) / 1000, abs=1e-4)
            assert measures[f"level_{name}"][row] == pytest.approx(np.mean(level))
    nowhere = free_space(HeightMap((120.0, 90.0), COARSE_MM), np.zeros((1, 3)), np.full((1, 3), 80.0))
    assert (nowhere["room_small"], nowhere["level_large"]) == (2.0, 0.0)  # there is no place for any carton


def test_sums_over_the_surface_are_those_of_its_cells() -> None:
    surface, rng = HeightMap((1206.0, 806.0)), np.random.default_rng(0)
    for top in range(100, 1100, 100):
        low = rng.uniform(0, 600, 3)
        surface.put(low, np.array([low[0] + 300, low[1] + 200, top]))
    low, high = rng.integers(-3, 20, (30, 2)), rng.integers(20, 60, (30, 2))
    count, height, square = surface.over(low, high)
    for row in range(30):
        (x0, y0), (x1, y1) = np.maximum(low[row], 0), high[row]
        cells = surface.height[x0:x1, y0:y1]
        assert (count[row], height[row]) == (cells.size, pytest.approx(cells.sum()))
        assert square[row] == pytest.approx((cells**2).sum())
    assert surface.height.shape == (round(1206 / CELL_MM), round(806 / CELL_MM))


# ---------------------------------------------------------------------- the networks


def policy_that_is(chance: float) -> Policy:
    """The published policy, but with a network that predicts the same probability to stand for every placement."""
    head = published_policy().head
    logit = np.array(np.log(chance / (1 - chance)))
    return replace(published_policy(), head=replace(head, linear=0 * head.linear, out=0 * head.out, constant=logit))


def test_nothing_is_placed_that_is_more_likely_to_fall() -> None:
    assert pack_learned(DRAWN.items, EXTENT, policy=policy_that_is(0.4)) == []
    some = pack_learned(DRAWN.items, EXTENT, policy=policy_that_is(0.6))
    assert len(some) > 20
    assert len(pack_learned(DRAWN.items, EXTENT, policy=policy_that_is(0.999))) >= len(some)


def test_the_surest_is_taken_where_none_is_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    chances = iter([0.7, 0.9, 0.6, *[0.5] * 100])
    monkeypatch.setattr(learned_module, "likely", lambda head, rows: np.array([next(chances)]))
    stream = FourSidedStream(DRAWN.items, EXTENT, CLEARANCE_MM, 3)
    for _ in range(8):
        chosen = lowest_first(stream)
        assert chosen is not None
        stream.put(chosen)
    places, _ = published_policy().seen(stream) or pytest.fail("no candidates")
    choice = published_policy().take(stream, places, -np.arange(len(places), dtype=float))
    assert choice is not None
    assert choice.chance == 0.9


def test_the_weights_are_small_and_in_the_package(tmp_path: Path) -> None:
    with files("petmjx.packers").joinpath("learned.npz").open("rb") as file:
        content = file.read()
    assert len(content) < LARGEST_FILE
    published_policy().save(tmp_path / "again.npz")
    again = Policy.load(tmp_path / "again.npz")
    kept = published_policy().taste.arrays("taste")
    assert all((values == kept[name]).all() for name, values in again.taste.arrays("taste").items())
    assert (len(again.taste.mean), len(again.head.mean)) == (len(NAMES), len(STABILITY_NAMES))


def test_chances_are_right_for_placements_that_were_kept_aside() -> None:
    """The predicted probabilities are right for 800 placements of orders that were not used for training. The
    placements were simulated on a GPU (docs/packers.md)."""
    with np.load(Path(__file__).parents[1] / "support" / "held_out_placements.npz") as file:
        features, stands = file["features"].astype(float), file["stands"].astype(float)
    chances = likely(published_policy().head, features)
    assert ((chances >= 0) & (chances <= 1)).all()
    brier, constant = np.mean((chances - stands) ** 2), stands.mean() * (1 - stands.mean())
    assert brier < 0.6 * constant
    assert chances.mean() == pytest.approx(stands.mean(), abs=0.01)


def test_chances_tell_safe_placements_from_others() -> None:
    column, leaning = make_plan("column", stack(3)), stack(3)
    safe = petmjx.placement_stability(column)
    assert ((safe > 0.95) & (safe <= 1)).all()
    corners = column.corner_mm.copy()
    corners[2, 0] += 0.48 * column.size_mm[2, 0]  # nearly half of the box hangs over
    over = petmjx.placement_stability(replace(column, corner_mm=corners))
    assert over[2] < safe[2] - 0.01
    assert (over[:2] == safe[:2]).all()
    corners[2, 2] += 500
    assert petmjx.placement_stability(replace(column, corner_mm=corners))[2] == 0
    sunk = petmjx.placement_stability(replace(column, corner_mm=column.corner_mm - (0, 0, 5)))
    assert sunk[0] == 0  # the lowest box begins inside the carrier
    with pytest.raises(InputError, match="plan must be a plan"):
        petmjx.placement_stability(leaning)  # type: ignore[arg-type]


# ---------------------------------------------------------------------- the command


def test_the_command_says_what_is_left_out_and_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = {"fits": order(5), "tall": order(3, **{"height/mm": 2500})}
    source, out = write(tmp_path / "orders.json", content), tmp_path / "plans.json"
    how = ("samples", "--orders", source, "-o", out, "--overwrite", "--workers", "1")
    assert run(*how, "--packer", "learned", "--lookahead", "3") == 0
    assert capsys.readouterr().out.splitlines() == [
        f"order tall: 1 of 3 boxes is left out: item 2: {LEFT_OUT_REASONS[LEARNED]}",
        f"2 plans in {out}; 1 box of 1 order left out",
    ]
    assert run(*how, "--packer", "balanced", "--lookahead", "3") == 2
    assert "--lookahead needs the packer 'learned'" in only_line(capsys.readouterr().err)
    with pytest.raises(InputError, match="look_ahead needs the packer 'learned'"):
        next(generate(1, 0, packer="balanced", look_ahead=2))
    with pytest.raises(InputError, match="look_ahead must be"):
        next(generate(1, 0, packer="learned", look_ahead=0))


def test_an_order_without_boxes_left_is_no_error() -> None:
    assert pack_learned((), EXTENT) == []
    large = replace(DRAWN.items[0], length_mm=1300.0, width_mm=1300.0)
    assert pack_learned((large, large), EXTENT, 2) == []
    assert Order("euro-pallet", ()).items == ()
