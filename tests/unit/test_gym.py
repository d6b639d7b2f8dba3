"""Tests of the environment ``petmjx/Palletizing-v0``: Gymnasium's checks, comparison of the vector environment with
single environments, orders, masks, and rewards."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("gymnasium", reason="gymnasium is not installed (extra: gym)")

import gymnasium as gym
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from support.programs import run_program

import petmjx.gym
from benchmarks import episodes as episodes_module
from benchmarks.episodes import SETTINGS, episodes
from petmjx.common.errors import InputError, PlanWarning
from petmjx.engines.engine_registry import make_engine
from petmjx.gym.actions import _in_turn
from petmjx.gym.item_queues import Queues
from petmjx.gym.single_env import PalletizingEnv
from petmjx.gym.vector_env import PalletizingVectorEnv
from petmjx.loop.episode_orders import STRENGTH, Boxes, Orders
from petmjx.plans.masses_and_densities import SET_KG_M3
from petmjx.plans.order import Item, Order
from petmjx.plans.order_generator import draw_order
from petmjx.show.pictures.picture_files import why_nothing_is_drawn

NAME = "petmjx/Palletizing-v0"


def order(*sizes: tuple[float, float, float], kg: float = 5.0) -> Order:
    items = tuple(Item("a", str(k), "", *size, kg) for k, size in enumerate(sizes))
    return Order("euro-pallet", items, tuple(range(1, len(items) + 1)))


FEW = [
    order((600, 400, 200), (600, 400, 300), (400, 300, 200)),
    order((300, 200, 100), (800, 600, 200)),
    order((200, 200, 500), (100, 100, 900), (2000, 300, 200)),  # the last box is longer than the carrier
]
SMALL: dict[str, Any] = {"orders": FEW, "n_candidates": 6, "cell_mm": 200, "threads": 1, "engine": "mujoco"}


def legal(mask: Any, rng: np.random.Generator) -> int:
    actions = np.flatnonzero(mask)
    return int(rng.choice(actions)) if len(actions) else 0


def assert_equal(one: Any, other: Any) -> None:
    assert set(one) == set(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"actions": "cells", "action_cell_mm": 400, "mask": "geometry"},
        {"mask": "sure", "scaled": True, "sides": "all", "open_pallets": 2, "errors": 1.0},
        {"curriculum": {"boxes": (1, 3), "sizes": (0, 1)}, "level": 0.5, "buffer": 1},
    ],
)
def test_gymnasium_finds_nothing_wrong(options: dict[str, Any]) -> None:
    env = gym.make(NAME, **{**SMALL, "look_ahead": 2, "buffer": 2, **options})
    check_env(env.unwrapped, skip_render_check=True)


def test_gymnasium_makes_it_in_a_fresh_interpreter() -> None:
    """Gymnasium makes the environment in a new interpreter. The module is named, since Gymnasium 1 loads no plug-ins.
    The environment is made twice, to check that a second import does not register it again."""
    program = """
import gymnasium
for _ in range(2):
    print(type(gymnasium.make("petmjx.gym:petmjx/Palletizing-v0", engine="mujoco").unwrapped).__name__)
print(type(gymnasium.make_vec("petmjx.gym:petmjx/Palletizing-v0", num_envs=2, engine="mujoco")).__name__)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["PalletizingEnv", "PalletizingEnv", "PalletizingVectorEnv"]
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    assert "gymnasium.envs" not in project["project"].get("entry-points", {}), "nobody reads it"


def test_the_same_seed_is_the_same_episode_to_the_bit() -> None:
    runs = []
    for _ in range(2):
        env, rng, seen = PalletizingEnv(**SMALL, look_ahead=2), np.random.default_rng(3), []
        observed, _ = env.reset(seed=7)
        over = False
        while not over:
            observed, reward, terminated, truncated, info = env.step(legal(observed["action_mask"], rng))
            over = terminated or truncated
            seen.append({**observed, "reward": reward, **info})
        runs.append(seen)
    assert len(runs[0]) == len(runs[1]) > 1
    for one, other in zip(*runs, strict=True):
        assert_equal(one, other)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_vector_environment_is_as_many_single_ones(mode: AutoresetMode) -> None:
    options = {**SMALL, "mask": "geometry", "rewards": {"placed": 1, "fall": 1, "margin": 1, "load": 1, "illegal": 1}}
    many = gym.make_vec(NAME, num_envs=3, vectorization_mode="vector_entry_point", autoreset_mode=mode, **options)
    assert isinstance(many, PalletizingVectorEnv)
    single = SyncVectorEnv([lambda: PalletizingEnv(**options)] * 3, autoreset_mode=mode)
    assert many.single_observation_space == single.single_observation_space
    assert many.action_space == single.action_space
    (ours, infos), (theirs, expected) = many.reset(seed=4), single.reset(seed=4)
    assert_equal(ours, theirs)
    rng, ended = np.random.default_rng(1), 0
    for step in range(14):
        assert_equal(ours, theirs)
        assert many.observation_space.contains(ours)
        actions = np.array([legal(mask, rng) for mask in ours["action_mask"]])
        if step == 2:
            actions[0] = 5  # an action that is seldom legal
        ours, reward, terminated, truncated, infos = many.step(actions)
        theirs, *rest, expected = single.step(actions)
        for one, other in zip((reward, terminated, truncated), rest, strict=True):
            np.testing.assert_array_equal(one, other)
        over = terminated | truncated
        ended += over.sum()
        for name in ("verdict", "culprit", "placed", "left_out", "utilisation"):
            np.testing.assert_array_equal(infos[name], expected[name])
        if mode is AutoresetMode.SAME_STEP and over.any():
            np.testing.assert_array_equal(infos["_final_obs"], expected["_final_obs"])
            for row in np.flatnonzero(over):
                assert_equal(infos["final_obs"][row], expected["final_obs"][row])
                assert infos["final_info"]["reason"][row] == expected["final_info"]["reason"][row]
                assert infos["final_info"]["reward_margin"][row] == expected["final_info"]["reward_margin"][row]
    assert ended > 4


def test_masks_and_what_ends_an_episode() -> None:
    tall = [order((200, 200, 600), (600, 600, 200), (2000, 300, 200))]
    chosen: dict[str, int] = {}
    for mask in ("geometry", "support_50", "centre", "physics"):
        env = PalletizingEnv(**{**SMALL, "orders": tall, "n_candidates": 30, "mask": mask})
        observed, _ = env.reset(seed=0)
        corners = observed["candidates"][..., 2:5]
        observed, *_ = env.step(int(np.flatnonzero(observed["action_mask"])[0]))
        corners = observed["candidates"][observed["action_mask"] == 1][:, 2:5]
        chosen[mask] = int((corners[:, 2] == 600).sum())  # places on top of the tall box, beyond its edge
        if mask == "geometry":
            unsafe = int(np.flatnonzero(observed["candidates"][:, 4] == 600)[0])
            observed, reward, terminated, _, info = env.step(unsafe)
            assert terminated
            assert reward < 0
            assert info["verdict"] == "unstable"
            assert info["culprit"] == 1
            assert info["left_out"] == 0  # after a fall, no place is searched for the last box, which fits nowhere
            assert observed["boxes"][0, 0] == 2000
            assert not observed["action_mask"].any()
    assert chosen["geometry"] > 0
    assert chosen["support_50"] == chosen["centre"] == chosen["physics"] == 0


def test_the_mask_by_loads_keeps_boxes_off_weak_ones(tmp_path: Path) -> None:
    """The mask ``loads`` keeps boxes off weak boxes. A box of 10 kg presses with 98 N, so it may not stand on a box
    with a strength of 90 N, but on a box with 110 N."""
    sizes = {"length_mm": [600, 600], "width_mm": [400, 400], "height_mm": [200, 200], "weight_kg": [10, 10]}
    options = {**SMALL, "n_candidates": 30, "mask": "loads"}

    def on_top(**given: Any) -> set[bool]:
        """For each legal place of the second box, whether it is on the first box. Places beside the first box are
        always legal."""
        env = PalletizingEnv(**{**options, **given})
        observed, _ = env.reset(seed=0)
        observed, *_ = env.step(int(np.flatnonzero(observed["action_mask"])[0]))
        return set((observed["candidates"][observed["action_mask"] == 1][:, 4] > 0).tolist())

    assert on_top(orders=pd.DataFrame({**sizes, "strength_n": [90, np.nan]})) == {False}
    assert on_top(orders=pd.DataFrame({**sizes, "strength_n": [110, np.nan]})) == {False, True}
    table = tmp_path / "articles.toml"
    table.write_text("[articles.a]\nstrength_n = 90\n", encoding="utf-8")
    orders = [order((600, 400, 200), (600, 400, 200), kg=10)]
    assert on_top(orders=orders, articles=table) == {False}
    for wrong, message in (
        (
            {"orders": orders},
            "mask: 'loads' needs the strengths of boxes; give orders the column strength_n, or pass articles",
        ),
        (
            {"orders": pd.DataFrame({**sizes, "strength_n": [0, 1]})},
            "orders: order orders, row 0: strength_n must be from 0.01",
        ),
    ):
        with pytest.raises(InputError, match=message):
            on_top(**wrong)


@pytest.mark.parametrize("mask", ["geometry", "support_75", "centre"])
@pytest.mark.parametrize(("buffer", "most"), [(2, 3), (5, 32), (8, 20), (12, 6)])
def test_each_box_of_the_buffer_has_its_share_of_candidates(mask: str, buffer: int, most: int) -> None:
    """Each box of the buffer gets an equal share of the candidates: its lowest places, or all of its places if it has
    fewer. If there are enough places, the table of candidates is full."""
    options = {"look_ahead": buffer + 2, "buffer": buffer, "mask": mask, "cell_mm": 200, "engine": "mujoco"}
    cut, full_env = (PalletizingEnv(**options, n_candidates=count, threads=1) for count in (most, 20_000))
    rng = np.random.default_rng(buffer)
    (observed, _), (everything, _) = (env.reset(seed=3) for env in (cut, full_env))
    for _ in range(4):
        size = len(observed["action_mask"])
        assert size == max(most, buffer)
        lists = [observation["candidates"][observation["action_mask"] == 1] for observation in (observed, everything)]
        kept, all_of = ([places[places[:, 0] == box] for box in range(buffer)] for places in lists)
        assert len(lists[0]) == min(size, len(lists[1]))
        for few, many in zip(kept, all_of, strict=True):
            assert len(few) >= min(len(many), size // buffer)
            np.testing.assert_array_equal(few, many[: len(few)])
        action = int(rng.integers(len(lists[0])))
        (same,) = np.flatnonzero((lists[1] == lists[0][action]).all(axis=1))
        observed, *_ = cut.step(action)
        everything, _, over, *_ = full_env.step(int(same))
        if over:
            break


def test_what_a_box_does_not_need_goes_to_the_others() -> None:
    """Candidates that a box does not need go to the other boxes. The expected shares are computed by adding a place for
    every box that still has a place, again and again, until the table is full."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        most, boxes = int(rng.integers(1, 40)), int(rng.integers(1, 8))
        counts = rng.integers(0, 20, (4, boxes)) * rng.integers(0, 2, (4, boxes))
        seen = np.repeat(np.arange(4 * boxes), counts.ravel())
        kept = _in_turn(seen // boxes, seen, most)
        poured = np.zeros_like(counts)
        for row, of in enumerate(counts):
            while poured[row].sum() < min(most, of.sum()):
                for box in np.flatnonzero(poured[row] < of):
                    poured[row, box] += poured[row].sum() < most
        np.testing.assert_array_equal(np.bincount(seen[kept], minlength=4 * boxes), poured.ravel())
        first = np.searchsorted(seen, seen[kept])
        assert (kept - first < poured.ravel()[seen[kept]]).all()  # the best places of each box are kept


def test_random_episodes_in_all_settings_show_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random episodes with all settings. ``python -m benchmarks loop episodes`` plays thousands of such episodes."""
    monkeypatch.setattr(episodes_module, "PALLETS", 5)
    summary = episodes(make_engine("mujoco", threads=1), 2 * len(SETTINGS), seed=5)
    assert summary["faults"] == {}
    assert summary["episodes"] >= 2 * len(SETTINGS)
    assert summary["placements"] > summary["episodes"]


def test_an_illegal_action_changes_nothing_and_many_end_the_episode() -> None:
    env = PalletizingEnv(**SMALL, most_illegal=2, rewards={"illegal": 3, "utilisation": 10})
    before, _ = env.reset(seed=1)
    illegal = int(np.flatnonzero(before["action_mask"] == 0)[0])
    observed, reward, terminated, truncated, info = env.step(illegal)
    assert_equal(observed, before)
    assert (reward, terminated, truncated, info["illegal"]) == (-3.0, False, False, 1)
    *_, truncated, _ = env.step(illegal)
    assert truncated
    for wrong in (illegal - env.episodes.n_actions, env.episodes.n_actions, 0.5, None):
        with pytest.raises(InputError, match="action must be a whole number from 0 to"):
            env.step(wrong)


def test_boxes_without_a_place_are_left_out_and_the_order_ends_the_episode() -> None:
    env = PalletizingEnv(**{**SMALL, "orders": FEW[2:]})
    observed, info = env.reset(seed=0)
    steps = 0
    while observed["action_mask"].any():
        observed, _, terminated, _, info = env.step(int(np.flatnonzero(observed["action_mask"])[0]))
        steps += 1
    assert terminated
    assert (steps, info["placed"], info["left_out"], info["verdict"]) == (2, 2, 1, "stable")
    assert info["utilisation"] == pytest.approx((0.2 * 0.2 * 0.5 + 0.1 * 0.1 * 0.9) / (1.2 * 0.8 * 1.8))


def test_orders_come_from_many_places(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    assert len(Orders().draw(rng)) >= 10
    table = pd.DataFrame({"length_mm": [400, 300], "width_mm": 200, "height_mm": 100, "weight_kg": [3, 4]})
    (tmp_path / "opai.txt").write_text("62 35.5 13\n61 34 6\n", encoding="utf-8")
    table.to_csv(tmp_path / "boxes.csv")
    pg = {"Pallet No": ["a", "a", "b"], "Pick_quantity_cs": ["2", "1", "1"], "Length_cm": ["35", "33.7", "10"]}
    pd.DataFrame(pg | {"Width_cm": 20.3, "Height_cm": 20.8, "Gross weight": 6.324}).to_excel(tmp_path / "pg.xlsx")
    sides = {"尺寸（L）": [24.5, None], "尺寸（W）": [35.5, 1], "尺寸（H）": [39, 1], "3月份发货量（件）": [3371, 1]}
    pd.DataFrame(sides).to_excel(tmp_path / "deli.xlsx")
    for source, count, size, kg in (
        (table, 2, (400, 200, 100), 3),
        (tmp_path / "boxes.csv", 2, (400, 200, 100), 3),
        (tmp_path / "opai.txt", 2, (620, 355, 130), 0.62 * 0.355 * 0.13 * SET_KG_M3),
        (tmp_path / "deli.xlsx", 1, (245, 355, 390), 0.245 * 0.355 * 0.39 * SET_KG_M3),
        (FEW, 3, (600, 400, 200), 5),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PlanWarning)  # notes on how files of other tools are read
            first = Orders(source)._all[0]  # type: ignore[index]
        assert len(first) == count
        assert first.size_mm[0] == pytest.approx(size)
        assert first.mass_kg[0] == pytest.approx(kg)
    with pytest.warns(PlanWarning, match="RoboBPP's pg.xlsx; 2 orders, 4 boxes; cm, kg"):
        pallets = Orders(tmp_path / "pg.xlsx")._all or []
    assert [len(boxes) for boxes in pallets] == [3, 1]
    assert pallets[0].mass_kg.tolist() == [6.324] * 3


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "bad.txt").write_text("1 2\n", encoding="utf-8")
    for options, message in (
        ({"mask": "suport_75"}, "unknown mask 'suport_75'"),
        ({"actions": "cell"}, "unknown actions 'cell'"),
        ({"buffer": 2}, "buffer must be at most look_ahead, 1, got 2"),
        ({"rewards": {"plced": 1}}, "rewards: unknown term 'plced'"),
        ({"orders": tmp_path / "bad.txt"}, "bad.txt: line 1: must have three lengths"),
        ({"orders": tmp_path / "none.json"}, "none.json: cannot be read"),
        ({"orders": [order((2000, 2000, 100))]}, "orders: none of 100 drawn orders has a box with a legal place"),
        ({"carrier": "footprint"}, "carrier: the size of footprint depends"),
        ({"render_mode": "window"}, "render_mode must be None or rgb_array or human"),
        ({"masks": "x"}, "unknown option masks"),
    ):
        with pytest.raises(InputError, match=message):
            PalletizingEnv(**{**SMALL, **options}).reset(seed=0)
    with pytest.raises(InputError, match="autoreset_mode must be one of"):
        PalletizingVectorEnv(2, autoreset_mode="never", **SMALL)
    many = PalletizingVectorEnv(2, **SMALL)
    many.reset(seed=0)
    with pytest.raises(InputError, match="actions must be from 0 to 5"):
        many.step([0, 6])


def test_the_example_of_training_runs(repository: Path, tmp_path: Path) -> None:
    few = ("--updates", "2", "--pallets", "2", "--steps", "6", "--engine", "mujoco")
    printed = run_program(repository / "examples" / "train_with_physics.py", *few, folder=tmp_path)
    assert "update 2: return" in printed
    weights = dict(re.findall(r"(\S+) ([+-]\d\.\d\d)(?:,|$)", printed.splitlines()[-1]))
    assert any(float(weight) for weight in weights.values()), "it has learned something"


def test_pictures() -> None:
    if why := why_nothing_is_drawn():
        pytest.skip(why)
    env = PalletizingEnv(**SMALL, render_mode="rgb_array")
    observed, _ = env.reset(seed=0)
    empty = env.render()
    env.step(int(np.flatnonzero(observed["action_mask"])[0]))
    placed = env.render()
    assert empty is not None
    assert placed is not None
    assert empty.shape == placed.shape == (480, 480, 3)
    assert (empty != placed).any(axis=2).mean() > 0.01


assert petmjx.gym


def test_boxes_without_a_place_are_left_out_in_few_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes for which there is no place are left out in few calls. In this test, there is no place for 50 boxes of
    three kinds, but for the box after them. Places are searched once for each kind: in the first call for the next box,
    in the second call for the two other kinds, in the third call for the last box."""
    sizes = [(600, 400, 200), *[(600, 400, 1900 + 10 * (number % 3)) for number in range(50)], (300, 200, 100)]
    rows = [(0, *size, 5.0) for size in sizes]
    orders = pd.DataFrame(rows, columns=["order_id", "length_mm", "width_mm", "height_mm", "weight_kg"])
    for options in ({}, {"buffer": 2, "look_ahead": 2}):  # with a buffer, boxes are examined one after another
        env = PalletizingEnv(orders=orders, engine="mujoco", mask="geometry", **options)
        fill, numbers = env.episodes._actions.fill, []

        def counted(table: Any, rows: Any, *boxes: Any, fill: Any = fill, numbers: Any = numbers) -> None:
            numbers.append(len(rows))
            fill(table, rows, *boxes)

        monkeypatch.setattr(env.episodes._actions, "fill", counted)
        observed, _ = env.reset(seed=0)
        assert numbers == [1]
        first_box = int(np.flatnonzero(observed["action_mask"])[0])
        observed, _, terminated, _, info = env.step(first_box)
        assert not terminated
        assert (info["left_out"], info["placed"]) == (50, 1)
        assert observed["boxes"][0].tolist() == [300.0, 200.0, 100.0, 5.0]
        assert observed["action_mask"].any()
        assert options or numbers == [1, 1, 1, 2]
        _, _, terminated, _, info = env.step(int(np.flatnonzero(observed["action_mask"])[0]))
        assert terminated
        assert info["placed"] == 2
        env.close()


def test_generated_orders_have_the_boxes_of_petmjx_samples() -> None:
    """The orders of episodes have the boxes that ``draw_order`` draws, in the same sequence. Boxes of one kind are
    equal."""
    orders = Orders(seed=33501)
    for number in (0, 7, 199_999):
        boxes, items = orders.numbered(number), draw_order(33501, number).items
        sizes = [(item.length_mm, item.width_mm, item.height_mm) for item in items]
        assert boxes.size_mm.tolist() == [list(size) for size in sizes]
        assert boxes.mass_kg.tolist() == [item.weight_kg for item in items]
        assert len({*zip(boxes.kind.tolist(), sizes, strict=True)}) == len({*boxes.kind.tolist()}) < len(items)


def test_queues_name_the_first_remaining_box_of_each_kind() -> None:
    size_mm = np.array([[300.0, 200.0, 100.0]] * 2 + [[400.0, 300.0, 200.0]] * 3 + [[300.0, 200.0, 100.0]])
    strength_n = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    queues = Queues(3, 1)
    for row in range(3):
        queues.begin(row, Boxes(size_mm, size_mm[:, 0] / 100, strength_n))
    rows = np.arange(3)
    queues.leave_out(rows, np.array([0, 1, 3]))
    of, position, boxes = queues.kinds(rows)
    assert list(zip(of.tolist(), position.tolist(), boxes[:, STRENGTH].tolist(), strict=True)) == [
        *((0, 0, 1.0), (0, 2, 3.0)),
        *((1, 0, 2.0), (1, 1, 3.0)),
        *((2, 0, 4.0), (2, 2, 6.0)),
    ]
