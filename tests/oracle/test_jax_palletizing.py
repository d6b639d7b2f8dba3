"""``petmjx.jax.Palletizing`` has the episodes of the Gymnasium environment with the same actions.

``petmjx.jax.Palletizing`` also works under jit, vmap and scan.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import petmjx.jax
from petmjx.common.errors import InputError
from petmjx.jax import REASONS, StepType
from petmjx.jax.extreme_places import Candidates
from petmjx.jax.free_cells import Pile
from petmjx.packers.learned_candidates import FourSidedStream, lowest_first
from petmjx.packers.pile_balance import Balance
from petmjx.plans.order_generator import draw_order

pytestmark = pytest.mark.usefixtures("few_spare_worlds")

TABLE = pd.DataFrame(
    {
        "order_id": [0, 0, 0, 0, 1, 1],
        "length_mm": [600, 2000, 400, 300, 200, 400],
        "width_mm": [400, 300, 400, 200, 200, 300],
        "height_mm": [300, 300, 200, 400, 700, 250],
        "weight_kg": [8.0, 5.0, 6.0, 3.0, 4.0, 7.0],
    }
)
"""The second box of the first order fits nowhere on the pallet, so the environment leaves it out."""

OPTIONS: dict[str, Any] = {
    "orders": TABLE,
    "action_cell_mm": 200,
    "cell_mm": 100,
    "mask": "geometry",
    "look_ahead": 2,
    "gap_mm": 5,
}
TERMS = dict.fromkeys(("placed", "utilisation", "fall", "margin", "load", "height", "illegal"), 1.0)


@pytest.fixture(scope="module")
def env(few_spare_worlds: None) -> petmjx.jax.Palletizing:
    return petmjx.jax.Palletizing(**OPTIONS, rewards=TERMS, most_boxes=4, engine="mujoco", most_illegal=2)


@pytest.fixture(scope="module")
def reset(env: petmjx.jax.Palletizing) -> Any:
    """``env.reset``, compiled once. Without ``jax.jit``, JAX compiles each of its operations."""
    return jax.jit(env.reset)


@pytest.fixture(scope="module")
def step(env: petmjx.jax.Palletizing) -> Any:
    return jax.jit(env.step)


@pytest.mark.parametrize("order", [0, 1])
def test_an_episode_is_that_of_the_gymnasium_environment(reset: Any, step: Any, order: int) -> None:
    pytest.importorskip("gymnasium", reason="gymnasium is not installed (extra: gym)")
    from petmjx.gym.single_env import PalletizingEnv

    table = TABLE[TABLE.order_id == order]
    gym = PalletizingEnv(**{**OPTIONS, "orders": table}, rewards=TERMS, actions="cells", most_illegal=2)
    rng = np.random.default_rng(order)
    for _ in range(3):
        expected, _ = gym.reset(seed=0)
        state, timestep = reset(jax.random.key(0), order)
        assert bool(timestep.first())
        while True:
            seen = timestep.observation
            for name in ("height_map", "boxes", "action_mask"):
                np.testing.assert_array_equal(getattr(seen, name), expected[name], name)
            np.testing.assert_allclose(seen.load_map, expected["load_map"], rtol=1e-5)
            assert (int(seen.left), float(seen.mass)) == (expected["left"][0], expected["mass"][0])
            if timestep.last():
                break
            legal = np.flatnonzero(expected["action_mask"])
            action = rng.choice(legal) if rng.random() < 0.9 else gym.episodes.n_actions - 1
            expected, reward, terminated, truncated, info = gym.step(action)
            state, timestep = step(state, action)
            assert float(timestep.reward) == pytest.approx(reward, rel=1e-4, abs=1e-6)
            assert bool(timestep.last()) == (terminated or truncated)
            assert float(timestep.discount) == float(not terminated)
            if expected["action_mask"][action] or info["illegal"] == 0:
                assert REASONS[int(timestep.extras["reason"])] == info["reason"]
            for name in ("placed", "left_out", "illegal"):
                assert int(timestep.extras[name]) == info[name], name
            assert float(timestep.extras["utilisation"]) == pytest.approx(info["utilisation"], rel=1e-5)


def test_vmapped_and_scanned_it_is_as_one_by_one(env: petmjx.jax.Palletizing) -> None:
    keys = jax.random.split(jax.random.key(1), 4)

    def rolled(key: jax.Array) -> Any:
        def step(carry: Any, step_key: jax.Array) -> Any:
            state, timestep = carry
            mask = timestep.observation.action_mask
            action = jax.random.categorical(step_key, jnp.where(mask, 0.0, -jnp.inf))
            state, timestep = env.step(state, jnp.where(mask.any(), action, 0))
            return (state, timestep), (timestep, action)

        return jax.lax.scan(step, env.reset(key), jax.random.split(key, 4))[1]

    alone = jax.jit(rolled)
    many, actions = jax.jit(jax.vmap(rolled))(keys)
    for row, key in enumerate(keys):
        one, own_actions = alone(key)
        np.testing.assert_array_equal(actions[row], own_actions)
        for ours, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(many), strict=True):
            np.testing.assert_allclose(ours, theirs[row], rtol=1e-6)
    assert (many.step_type == StepType.LAST).any()
    assert (many.extras["reward_placed"].sum(axis=1) > 0).all()


def test_specs_fit_and_what_is_wrong_is_one_line(env: petmjx.jax.Palletizing, reset: Any) -> None:
    state, timestep = reset(jax.random.key(0), 0)
    for name, seen in timestep.observation._asdict().items():
        spec = env.observation_spec[name]
        assert (spec.shape, spec.dtype) == (seen.shape, seen.dtype), spec.name
        assert spec.generate_value().shape == spec.shape
        values = np.asarray(seen)  # JAX would compile each comparison
        assert (values >= spec.minimum).all(), spec.name
        assert (values <= spec.maximum).all(), spec.name
    assert env.action_spec.num_values == env.num_actions == 2 * 6 * 4
    assert env.reward_spec.shape == env.discount_spec.shape == ()
    for options, message in (
        ({"mask": "centre"}, "unknown mask 'centre'"),
        ({"orders": TABLE[1:2]}, "orders: no box of any order fits on the empty carrier"),
        ({"carrier": "footprint"}, "carrier: the size of footprint depends"),
        ({"rewards": {"plced": 1}}, "rewards: unknown term 'plced'"),
        ({"look_ahead": 0}, "look_ahead must be at least 1"),
        ({"actions": "candidate"}, "unknown actions 'candidate'; did you mean candidates"),
        ({"gap_mm": -1}, "gap_mm must be at least 0"),
        ({"inside_mm": 20}, "inside_mm needs actions='candidates'"),
        ({"actions": "candidates", "n_candidates": 0}, "n_candidates must be at least 1"),
    ):
        with pytest.raises(InputError, match=message):
            petmjx.jax.Palletizing(**{**OPTIONS, **options})
    with pytest.raises(InputError, match=r"action must be a whole number, got 0\.5"):
        env.step(state, 0.5)  # type: ignore[arg-type]
    for order in (1.5, "a", np.float32(1), [0, 1], 2**70):
        with pytest.raises(InputError, match="order must be a whole number, got"):
            env.reset(jax.random.key(0), order)  # type: ignore[arg-type]


def test_candidates_of_many_states_are_asked_in_one_call() -> None:
    """Under vmap the boxes of all states are placed in one call.

    That call needs more settled worlds than there is room for with one state.
    """
    state = petmjx.jax.empty(1, engine="mujoco", most_boxes=2)
    before = len(state.host._pallets)
    corners = np.array([[[10.0 * row, 0.0, 0.0]] for row in range(20)], np.float32)
    size, mass = np.array([[400.0, 300.0, 200.0]], np.float32), np.array([6.0], np.float32)
    states, report = jax.jit(jax.vmap(lambda corner: petmjx.jax.place(state, size, corner, mass)))(corners)
    assert report.stable.all()
    assert len(state.host._pallets) > before
    above = corners + np.array([0.0, 0.0, 200.0], np.float32)
    tried = jax.jit(jax.vmap(lambda one, corner: petmjx.jax.try_all(one, size, corner, mass, np.array([0]))))(
        states, above
    )
    assert tried.stable.all()
    assert tried.n_boxes.tolist() == [[2]] * 20


MOST = 16
"""Largest number of boxes of the piles in the tests below."""


def pile_of(low: Any, high: Any) -> Pile:
    padding = ((0, MOST - len(low)), (0, 0))
    size, corner = (jnp.asarray(np.pad(values, padding), jnp.float32) for values in (high - low, low))
    return Pile(size, corner, jnp.arange(MOST) < len(low))


@pytest.mark.parametrize("gap_mm", [0.0, 6.0])
def test_candidates_are_the_places_of_the_packer_learned(gap_mm: float) -> None:
    """Without a gap between boxes, the candidates are all places of the packer ``learned``, from all four corners.

    With a gap, the candidates are some of those places. The packer counts the part of a base that is over a gap as
    borne; the candidates do not.
    """
    candidates = Candidates((1200.0, 800.0), 160, 2000.0, 0.5, gap_mm, 0.0)
    look = jax.jit(lambda pile, *box: candidates.ways(candidates.view(pile, candidates.no_boxes(MOST)), *box))
    stream, n_compared = FourSidedStream(draw_order(33, 0).items[:MOST], (1200.0, 800.0), gap_mm), 0
    for item in draw_order(33, 0).items[:MOST]:
        low, high = stream.bare_boxes
        size = jnp.array([item.length_mm, item.width_mm, item.height_mm], jnp.float32)
        ways = look(pile_of(low, high), size, jnp.float32(item.weight_kg))
        legal = np.asarray(ways.legal)
        rows = np.column_stack([ways.corner_mm, ways.size_mm])[legal]
        ours = {tuple(row) for row in rows.round(2).tolist()}
        assert len(ours) == len(rows) < candidates.count, "each place once, and all of them"
        places = stream.places(0.5)
        bare = places.size_mm - [gap_mm, gap_mm, 0.0]
        theirs = {tuple(row) for row in np.column_stack([places.corner_mm, bare]).round(2).tolist()}
        assert ours <= theirs
        assert len(ours) > 0.7 * len(theirs)
        if not gap_mm:
            assert ours == theirs
        n_compared += len(ours)
        best = rows[0, :3]
        assert best[2] == pytest.approx(places.corner_mm[:, 2].min(), abs=20.0), "the first one is low"
        chosen = lowest_first(stream)
        assert chosen is not None
        stream.put(chosen)
    assert n_compared > 300


MISSED_MM = 5.0
"""By how many mm a margin may be too small. The corners of a convex hull are searched in 32 directions only, so the
hull may be too small."""


def test_the_balance_of_a_pile_is_that_of_the_packer_balanced() -> None:
    """Compare with the packer ``balanced``: margins of all candidates, and which candidates keep the pile in balance.

    The pile grows by candidates that are chosen at random.
    """
    free, strict = (Candidates((1200.0, 800.0), 40, 2000.0, 0.3, 0.0, inside) for inside in (0.0, 20.0))

    @jax.jit
    def look(pile: Pile, statics: Any, *box: jax.Array) -> Any:
        return [kind.ways(kind.view(pile, statics), *box) for kind in (free, strict)]

    put, rng, statics = jax.jit(strict.put), np.random.default_rng(5), strict.no_boxes(MOST)
    balance, low, high = Balance(MOST), np.zeros((0, 3)), np.zeros((0, 3))
    n_kept = n_lost = 0
    for row, item in enumerate(draw_order(33, 3).items[:MOST]):
        pile, mass = pile_of(low, high), jnp.float32(item.weight_kg)
        ways, kept = look(pile, statics, jnp.array([item.length_mm, item.width_mm, item.height_mm]), mass)
        kept_places = {tuple(box) for box in np.column_stack([kept.corner_mm, kept.size_mm])[kept.legal].tolist()}
        good = []
        for at in np.flatnonzero(ways.legal):
            corner, extents = np.asarray(ways.corner_mm[at], float), np.asarray(ways.size_mm[at], float)
            x, y, z = corner.tolist()
            base = (float(extents[0]), float(extents[1]))
            margins, rest = (
                balance.margins_m((x, y, z), base, item.weight_kg),
                balance.rest((x, y, z), base, float(mass)),
            )
            values = dict(zip(free.features, np.asarray(ways.features[at]).tolist(), strict=True))
            for name, margin_m in (("inside", margins.own_m), ("below", margins.pile_m)):
                assert -MISSED_MM < values[name] - 1000 * margin_m < 0.1, name
            is_kept = (*corner, *extents) in kept_places
            n_kept, n_lost = n_kept + is_kept, n_lost + (rest is None)
            assert rest is not None or not is_kept
            if min(values["inside"], values["below"]) > 20:
                assert is_kept
            if is_kept:
                good.append((corner, extents, rest))
        corner, extents, rest = good[int(rng.integers(len(good)))]
        assert rest is not None
        statics = put(statics, jnp.int32(row), jnp.float32(extents), jnp.float32(corner), mass, pile)
        x, y, z = extents.tolist()
        balance.add((float(corner[0]), float(corner[1]), float(corner[2])), (x, y, z), rest)
        np.testing.assert_allclose(np.asarray(statics.load)[: row + 1], balance.loads, rtol=1e-4, atol=1e-5)
        low, high = np.vstack([low, corner]), np.vstack([high, corner + extents])
    assert n_kept > 100
    assert n_lost > 20


def test_boxes_keep_their_gap_and_an_order_can_be_chosen() -> None:
    table = pd.DataFrame(
        {
            "order_id": [0] * 2 + [1] * 8,
            "length_mm": [600] * 2 + [390] * 8,
            "width_mm": [400] * 2 + [390] * 8,
            "height_mm": [300] * 2 + [200] * 8,
            "weight_kg": [5.0] * 10,
        }
    )
    env = petmjx.jax.Palletizing(
        orders=table, actions="candidates", n_candidates=8, gap_mm=10.0, inside_mm=20.0, most_boxes=8, engine="mujoco"
    )
    assert env.num_orders == 2
    step = jax.jit(env.step)
    state, timestep = jax.jit(env.reset)(jax.random.key(0), 9)  # beyond the last order: the last order is packed
    assert int(timestep.observation.left) == 8
    while not timestep.last():
        seen = timestep.observation
        assert seen.candidates.shape == (8, len(env.features))
        assert not np.asarray(seen.candidates)[~np.asarray(seen.action_mask)].any()
        state, timestep = step(state, int(np.flatnonzero(seen.action_mask)[0]))
    assert int(timestep.extras["placed"]) == 8
    low = np.asarray(state.corner_mm)
    high = low + np.asarray(state.size_mm)
    for i in range(8):
        for j in range(i):
            level = max(low[i, 2], low[j, 2]) < min(high[i, 2], high[j, 2]) - 0.01
            apart = np.maximum(low[i] - high[j], low[j] - high[i])[:2].max()
            assert not level or apart >= 10 - 0.01
    # 3 × 2 of these bases fit on 1200 × 800 mm with gaps of 10 mm, and the other two boxes stand on them
    assert (low[:, 2] < 1).sum() == 6
    assert (high <= [1200.01, 800.01, 1800]).all()
