"""Environments for training: scaled observations, sides of boxes, several pallets, curricula, Stable-Baselines3."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("gymnasium", reason="gymnasium is not installed (extra: gym)")

from support.sb3_interface import Monitor, stand_in

import petmjx
from petmjx.common.errors import InputError
from petmjx.gym.actions import FEATURES, PALLET, SIDES, UPRIGHT
from petmjx.gym.curriculum import Curriculum
from petmjx.gym.environment_options import PalletizingOptions
from petmjx.gym.observation_spaces import BOX_KG, LEFT, LOAD_N, PALLET_KG
from petmjx.gym.single_env import PalletizingEnv
from petmjx.gym.vector_env import PalletizingVectorEnv
from petmjx.loop.episode_orders import Boxes, Orders

REPOSITORY = Path(__file__).parents[2]
THREADS: dict[str, Any] = {"threads": 1, "engine": "mujoco"}


def table(*sizes: tuple[float, float, float], kg: float = 5.0, **columns: Any) -> pd.DataFrame:
    sides = dict(zip(("length_mm", "width_mm", "height_mm"), np.array(sizes).T, strict=True))
    return pd.DataFrame({"order_id": 0, **sides, "weight_kg": kg, **columns})


def first_legal(observed: dict[str, Any]) -> int:
    return int(np.flatnonzero(observed["action_mask"])[0])


def test_scaled_observations_are_the_raw_ones_on_scales_that_end_at_1() -> None:
    orders = table((600, 400, 300), (600, 400, 200), (400, 300, 200), kg=8.0)
    raw, scaled = (PalletizingEnv(orders=orders, scaled=on, look_ahead=2, **THREADS) for on in (False, True))
    (before, _), (shown, _) = raw.reset(seed=0), scaled.reset(seed=0)
    for _ in range(2):
        action = int(np.flatnonzero(before["action_mask"])[-1])  # the last legal place, which is the highest
        before, shown = raw.step(action)[0], scaled.step(action)[0]
    assert before["load_map"].max() > 50
    longest = 1800.0  # the largest of 1200, 800 and the largest height
    saturated = {"load_map": LOAD_N, "left": LEFT, "mass": PALLET_KG}
    for name, values in before.items():
        assert raw.observation_space[name].contains(values), name
        assert scaled.observation_space[name].contains(shown[name]), name
        assert np.isfinite(raw.observation_space[name].high.astype(float)).all()
        assert raw.observation_space[name].high.max() < 1e8
        assert (scaled.observation_space[name].low == 0).all()
        assert (scaled.observation_space[name].high == 1).all()
        if name in saturated:
            np.testing.assert_allclose(shown[name], values / (values + saturated[name]), rtol=1e-6)
    np.testing.assert_allclose(shown["height_map"] * longest, before["height_map"], rtol=1e-6)
    np.testing.assert_allclose(shown["carrier"], np.array([1200, 800, 1800]) / longest, rtol=1e-6)
    mass = FEATURES.index("mass")
    legal = before["action_mask"] == 1
    np.testing.assert_allclose(shown["candidates"][legal][:, mass], 8 / (8 + BOX_KG), rtol=1e-6)
    z = FEATURES.index("z")
    np.testing.assert_allclose(shown["candidates"][:, z] * longest, before["candidates"][:, z], rtol=1e-5)
    np.testing.assert_array_equal(shown["action_mask"], before["action_mask"])


def test_boxes_stand_on_the_sides_that_the_order_allows() -> None:
    """The sides of a box of 600 × 400 × 200 mm that may be vertical: only its height, or its height and its length.
    ``sides="all"`` allows all six orientations."""
    orders = table((600, 400, 200), (600, 400, 200), upright=["h", "lh"])
    heights = {}
    for number, sides in enumerate(("order", "all")):
        env = PalletizingEnv(orders=orders, sides=sides, look_ahead=2, buffer=2, n_candidates=500, **THREADS)
        observed, _ = env.reset(seed=0)
        names = (*FEATURES, UPRIGHT)
        assert observed["candidates"].shape[1] == len(names)
        legal = observed["candidates"][observed["action_mask"] == 1]
        box, height, upright = (legal[:, names.index(name)] for name in ("box", "height", UPRIGHT))
        for one in range(2):
            heights[sides, one] = set(zip(height[box == one].tolist(), upright[box == one].tolist(), strict=True))
        ways = {tuple(row) for row in legal[box == 1][:, names.index("length_x") : names.index("height") + 1].tolist()}
        assert len(ways) == (4, 6)[number]
        action = int(np.flatnonzero(observed["candidates"][:, names.index("height")] == 600)[0])
        *_, info = env.step(action)
        assert info["verdict"] == "stable"
        size = env.episodes.pallets.boxes([0])[0][0, 0]
        assert sorted(size.tolist()) == [200, 400, 600]
        assert size[2] == 600
    assert heights["order", 0] == {(200, 0)}
    assert heights["order", 1] == {(200, 0), (600, 2)}
    assert heights["all", 0] == heights["all", 1] == {(200, 0), (400, 1), (600, 2)}
    assert sorted(map(tuple, SIDES.tolist())) == sorted({tuple(side) for side in SIDES.tolist()})
    cubes = PalletizingEnv(orders=table((200, 200, 200)), sides="all", **THREADS)
    assert len(np.flatnonzero(cubes.reset(seed=0)[0]["action_mask"])) == 1, "a cube has one side"
    with pytest.raises(InputError, match=r'^orders: row 0: upright must be letters of l, w and h, or empty, got "x"'):
        Orders(table((1, 1, 1), upright=["x"]))
    assert Orders(table((1, 1, 1), upright=[""])).lie is False, "empty: the height"
    with pytest.raises(InputError, match='orders: order 0, row 1: weight_kg must be a number, got "much"'):
        Orders(table((1, 1, 1), (1, 1, 1)).assign(weight_kg=["1", "much"]))


@pytest.mark.parametrize("actions", ["candidates", "cells"])
def test_several_open_pallets_take_the_boxes_of_one_order(actions: str) -> None:
    orders = table(*[(600, 400, 200)] * 4)
    options = {"orders": orders, "open_pallets": 2, "actions": actions, "action_cell_mm": 400, **THREADS}
    env = PalletizingEnv(**options, most_boxes=2)
    observed, _ = env.reset(seed=0)
    assert observed["height_map"].shape == (2, 24, 16)
    assert observed["mass"].shape == (2,)
    placed = []
    for step in range(4):
        legal = np.flatnonzero(observed["action_mask"])
        on = env.episodes.table.pallet[0, legal]
        assert set(on.tolist()) == ({0, 1} if step < 3 else {0})  # the second pallet is full from then on
        action = int(legal[on == (0, 1, 1, 0)[step]][0])
        observed, _, terminated, truncated, info = env.step(action)
        placed.append(env.episodes.pallets.n_boxes.tolist())
        assert not truncated
    assert placed == [[1, 0], [1, 1], [1, 2], [2, 2]]
    assert terminated
    assert (info["placed"], info["left_out"]) == (4, 0)
    assert observed["mass"].tolist() == [10, 10]
    assert info["utilisation"] == pytest.approx(4 * 0.6 * 0.4 * 0.2 / (2 * 1.2 * 0.8 * 1.8))
    if actions == "candidates":
        observed, _ = env.reset(seed=0)
        legal = observed["candidates"][observed["action_mask"] == 1]
        assert set(legal[:, (*FEATURES, PALLET).index(PALLET)].tolist()) == {0, 1}
    many = PalletizingVectorEnv(2, **options)
    assert len(many.episodes.pallets) == 4
    shown, _ = many.reset(seed=[0, 0])
    np.testing.assert_array_equal(shown["action_mask"][0], shown["action_mask"][1])


def test_a_curriculum_grows_with_the_level() -> None:
    orders = table((600, 400, 300), (200, 200, 100), (400, 300, 200), kg=6.0)
    env = PalletizingEnv(
        orders=orders, curriculum={"boxes": [1, 3], "sizes": (0, 1), "errors": (0, 2)}, look_ahead=3, **THREADS
    )
    seen = {}
    for level in (0.0, 0.5, 1.0):
        observed, _ = env.reset(seed=0, options={"level": level})
        seen[level] = observed["boxes"][: int(observed["left"][0]), :3]
        assert env.episodes._errors.tolist() == [2 * level]
    np.testing.assert_array_equal(seen[0.0], [[400, 300, 200]])  # the mean size of the order
    np.testing.assert_allclose(seen[0.5], [[500, 350, 250], [300, 250, 150]])
    np.testing.assert_array_equal(seen[1.0], orders[["length_mm", "width_mm", "height_mm"]])
    many = PalletizingVectorEnv(2, orders=orders, curriculum={"boxes": [1, 3]}, autoreset_mode="SameStep", **THREADS)
    shown, _ = many.reset(seed=0, options={"level": np.array([0.0, 1.0])})
    assert shown["left"].tolist() == [[1], [3]]
    for wrong, message in (
        ({"curriculum": {"size": (0, 1)}}, "curriculum: unknown entry 'size'; did you mean sizes"),
        ({"curriculum": {"sizes": (0, 2)}}, r"curriculum\.sizes must be .* 1"),
        ({"curriculum": {"sizes": 1}}, r"curriculum\.sizes must be two numbers"),
        ({"curriculum": [1]}, "curriculum must be a table"),
        ({"level": 2}, "level must be"),
        ({"sides": "any"}, "unknown sides 'any'"),
        ({"scaled": 1}, "scaled must be true or false"),
        ({"open_pallets": 0}, "open_pallets must be"),
        ({"errors": -1}, "errors must be"),
    ):
        with pytest.raises(InputError, match=message):
            PalletizingEnv(**wrong, **THREADS)
    with pytest.raises(InputError, match="level must be"):
        env.reset(options={"level": -1})
    same = Boxes(np.ones((2, 3)), np.ones(2), np.full(2, np.nan))
    assert Curriculum.of(PalletizingOptions()).order(same, 0.3) is same


def test_boxes_with_errors_are_placed_by_a_hand_beside_their_places() -> None:
    """The errors have about the size that docs/confidence.md states. The errors are twice as large at twice the
    strength, and the same when the pallet is built again."""
    strengths = np.repeat([0.0, 1.0, 2.0], 4)
    pallets = petmjx.Pallets(len(strengths), **THREADS)
    box = {"size_mm": (400, 300, 200), "mass_kg": 6.0}
    error = np.tile(np.arange(4), 3)
    planned = np.array([599.95, 349.95, 100.0])  # boxes are 0.1 mm smaller
    corner = (400, 200, 0)
    results = pallets.place(corner_mm=[corner] * 12, error=error, error_strength=strengths, **box)
    assert results.stable.all()
    off = (results.middle_mm[:, 0] - planned)[:, :2]
    assert np.abs(off[:4]).max() < 0.001
    sd_mm = np.sqrt((off[4:8] ** 2).mean())
    assert 0.5 < sd_mm < 5  # the standard deviation should be 2 mm; it is estimated from 8 numbers
    np.testing.assert_allclose(off[8:], 2 * off[4:8], atol=0.3)
    on_top = pallets.place(corner_mm=[(400, 200, 200)] * 12, error=error + 9, error_strength=strengths, **box)
    pallets.place(corner_mm=[(0, 0, 0)] * 12, **box)
    pallets.take_back()
    pallets.take_back()
    pallets.take_back()  # the last pallet is built again, without boxes
    pallets.place(corner_mm=[corner] * 12, error=error, error_strength=strengths, **box)
    again = pallets.place(corner_mm=[(400, 200, 200)] * 12, error=error + 9, error_strength=strengths, **box)
    np.testing.assert_array_equal(on_top.middle_mm, again.middle_mm)
    for wrong in ([-1] * 12, [0.5] * 12, [1]):
        with pytest.raises(InputError, match="'error' must be 12 whole numbers of at least 0"):
            pallets.place(corner_mm=[(0, 0, 0)] * 12, error=wrong, **box)


def test_episodes_with_errors_are_the_same_for_the_same_seed() -> None:
    orders = table((600, 400, 200), (600, 400, 200), (600, 400, 200))
    forces = []
    for seed in (3, 3, 4):
        env = PalletizingEnv(orders=orders, errors=1.0, **THREADS)
        observed, _ = env.reset(seed=seed)
        for _ in range(3):
            observed, *_ = env.step(int(np.flatnonzero(observed["action_mask"])[-1]))
        forces.append(env.episodes.pallets.results().middle_mm)
    np.testing.assert_array_equal(forces[0], forces[1])
    assert not np.array_equal(forces[0], forces[2])


def test_a_step_after_the_end_says_so() -> None:
    env = PalletizingEnv(orders=table((400, 300, 200)), **THREADS)
    with pytest.raises(InputError, match="the episode has ended, or none has begun: call reset"):
        env.step(0)
    env.reset(seed=0)
    assert env.step(0)[2]
    with pytest.raises(InputError, match="the episode has ended, or none has begun: call reset"):
        env.step(0)


def test_the_mask_sure_is_of_places_that_physics_allows() -> None:
    orders = table((600, 400, 200), (300, 200, 300), (500, 300, 200), (600, 400, 100))
    legal = {}
    for mask in ("sure", "physics"):
        env = PalletizingEnv(orders=orders, mask=mask, n_candidates=200, **THREADS)
        observed, _ = env.reset(seed=0)
        for _ in range(3):
            observed, *_ = env.step(first_legal(observed))
        places = observed["candidates"][observed["action_mask"] == 1]
        legal[mask] = {tuple(place) for place in places[:, 1:8].tolist()}
    assert legal["sure"]
    assert legal["sure"] <= legal["physics"]


def test_a_window_shows_each_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """If Matplotlib can only draw into files, one line reports this. If Matplotlib can draw into windows, every step
    draws a picture."""
    matplotlib = pytest.importorskip("matplotlib")
    monkeypatch.setattr(PalletizingEnv, "metadata", {**PalletizingEnv.metadata, "render_fps": 1000})
    env = PalletizingEnv(orders=table((400, 300, 200)), render_mode="human", **THREADS)
    monkeypatch.setattr(env.episodes, "picture", lambda row: np.full((8, 8, 3), row, np.uint8))
    matplotlib.use("agg")
    with pytest.raises(
        InputError, match="render_mode='human' needs a window, but Matplotlib's backend agg has no windows"
    ):
        env.reset(seed=0)
    monkeypatch.setattr(matplotlib, "get_backend", lambda: "tkagg")  # the backend agg draws what a window would show
    drawn = []
    monkeypatch.setattr("matplotlib.pyplot.pause", drawn.append)
    env.reset(seed=0)
    env.step(0)
    assert env.render() is None
    assert drawn == [0.001] * 3
    env.close()
    with pytest.raises(InputError, match="render_mode must be None or rgb_array, got 'human'"):
        PalletizingVectorEnv(2, render_mode="human", **THREADS)


@pytest.fixture(params=["interface", "stable_baselines3"])
def vec_env(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[type[Any], type[Any]]:
    """``PalletizingVecEnv`` and ``Monitor``: stand-ins with only their interface, and those of Stable-Baselines3."""
    if request.param == "interface":
        return stand_in(monkeypatch), Monitor
    monitor = pytest.importorskip("stable_baselines3.common.monitor", reason="no Stable-Baselines3 (extra: sb3)")
    return petmjx.gym.PalletizingVecEnv, monitor.Monitor


def test_the_vec_env_is_the_vector_environment_with_infos_of_each(vec_env: tuple[type[Any], type[Any]]) -> None:
    kind, monitor = vec_env
    orders = table((600, 400, 200), (400, 300, 200))
    options = {"orders": orders, "mask": "geometry", "most_illegal": 1, **THREADS}
    options |= {"curriculum": {"boxes": (2, 2)}, "level": 1.0}
    env = kind(3, **options)
    twin = PalletizingVectorEnv(3, "SameStep", scaled=True, **options)
    env.seed(5)
    observed, (expected, _) = env.reset(), twin.reset(seed=5)
    assert env.has_attr("action_masks")
    assert not env.has_attr("no such thing")
    assert env.env_is_wrapped(monitor) == [True] * 3
    assert env.env_is_wrapped(int) == [False] * 3
    assert [info["placed"] for info in env.reset_infos] == [0] * 3
    returns, lengths, ended = np.zeros(3), np.zeros(3, int), 0
    rng = np.random.default_rng(0)
    for step in range(8):
        for name, values in expected.items():
            np.testing.assert_array_equal(observed[name], values)
        masks = np.stack(env.env_method("action_masks"))
        np.testing.assert_array_equal(masks, observed["action_mask"] == 1)
        np.testing.assert_array_equal(env.get_attr("action_masks", 1)[0](), masks[1])
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])
        if step == 0:
            actions[2] = int(np.flatnonzero(~masks[2])[0])  # the only illegal action, which is allowed once
        last = observed
        observed, reward, over, infos = env.step(actions)
        expected, same, terminated, truncated, theirs = twin.step(actions)
        np.testing.assert_array_equal(reward, same.astype(np.float32))
        np.testing.assert_array_equal(over, terminated | truncated)
        returns += same
        lengths += 1
        for row in np.flatnonzero(over).tolist():
            info = infos[row]
            for name, values in theirs["final_obs"][row].items():
                np.testing.assert_array_equal(info["terminal_observation"][name], values)
            assert info["TimeLimit.truncated"] == (step == 0)
            assert info["verdict"] == theirs["final_info"]["verdict"][row]
            assert info["episode"]["r"] == pytest.approx(returns[row])
            assert info["episode"]["l"] == lengths[row]
            assert env.reset_infos[row]["placed"] == 0
            returns[row] = lengths[row] = 0
            ended += 1
        assert all(("episode" in info) == is_over for info, is_over in zip(infos, over, strict=True))
    assert last["height_map"].shape[0] == 3
    assert ended > 3
    env.set_attr("level", 0.5, [1])
    assert env.get_attr("level") == [1.0, 0.5, 1.0]
    env.set_attr("level", [0.5, 0.75], [1, -1])
    assert env.get_attr("level", -1) == [0.75] == env.get_attr("level")[2:]
    np.testing.assert_array_equal(env.env_method("action_masks", indices=-1)[0], env.action_masks(2))
    for value, line in (([0.1, 0.2], "level must be a number from 0 to 1, or 3 of them, got"), ("x", "level must be")):
        with pytest.raises(InputError, match=line):
            env.set_attr("level", value)
    assert env.get_attr("level") == [1.0, 0.5, 0.75], "a refused level changes nothing"
    for indices in (3, -4, [0, 3]):
        with pytest.raises(InputError, match=r"indices: there are environments 0 to 2, got (3|-4)"):
            env.get_attr("level", indices)
    for indices, line in (
        ([True, False, True], "indices: there are environments 0 to 2, got True"),
        (True, "indices: there are environments 0 to 2, got True"),
        ([0, -3], "indices: an environment is named twice, got"),
        (1.5, "indices must be a whole number or a list of them, got 1.5"),
        (slice(0, 2), "indices must be a whole number or a list of them, got slice"),
        ("01", "indices: there are environments 0 to 2, got '0'"),
    ):
        with pytest.raises(InputError, match=line):
            env.set_attr("level", 0.0, indices)
    assert env.get_attr("level", np.int64(1)) == [0.5] == env.get_attr("level", np.array([1]))
    for wrong in ({"lvel": 0.5}, [{}, {"lvel": 0.5}, {}]):
        with pytest.raises(InputError, match="options: unknown option 'lvel'; an environment has level"):
            env.set_options(wrong)
    env.set_options({"level": 0.25})
    env.reset()
    assert env.get_attr("level") == [0.25] * 3
    with pytest.raises(InputError, match="set_attr: only level can be set, got 'mask'"):
        env.set_attr("mask", "physics")
    with pytest.raises(AttributeError, match="an environment has only the methods action_masks, render"):
        env.env_method("jump")
    env.close()
    flat = kind(2, orders=orders, **THREADS)
    with pytest.raises(InputError, match="level: the environment has no curriculum"):
        flat.set_attr("level", 0.5)
    flat.close()


def test_maskable_ppo_trains_on_the_vec_env() -> None:
    ppo = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed (extra: sb3)").MaskablePPO
    env = petmjx.gym.PalletizingVecEnv(4, orders=table(*[(600, 400, 200)] * 3), cell_mm=200, **THREADS)
    model = ppo("MultiInputPolicy", env, n_steps=8, batch_size=16, seed=0).learn(64)
    assert model.ep_info_buffer
    assert all(info["l"] <= 3 for info in model.ep_info_buffer)


def test_without_stable_baselines3_the_line_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    program = "import sys; sys.modules['stable_baselines3'] = None; import petmjx.gym; petmjx.gym.PalletizingVecEnv"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "needs stable_baselines3, which is not installed: pip install 'petmjx[sb3]'" in done.stderr


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (5, "options must be a dict"),
        ({"levels": 1}, "options: unknown option 'levels'; an environment has level"),
        ({"level": [0.1, 0.2]}, "options: level must be a number from 0 to 1, or 3 of them"),
        ({"level": 2}, "level must be at most 1"),
    ],
)
def test_options_of_a_reset_are_refused_in_a_line(options: Any, line: str) -> None:
    orders = table((200, 200, 200))
    vector = PalletizingVectorEnv(3, orders=orders, **THREADS)
    for environment in (PalletizingEnv(orders=orders, **THREADS), vector):
        with pytest.raises(InputError, match=line.replace(", or 3 of them", "")):
            environment.reset(options=options)
    with pytest.raises(InputError, match="seed must be a whole number or a list of them"):
        vector.reset(seed=1.5)
