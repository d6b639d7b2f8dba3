"""``petmjx.jax.Palletizing``: as the Gymnasium environment with the same actions; under jit, vmap and scan."""

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

TABLE = pd.DataFrame(
    {
        "order_id": [0, 0, 0, 0, 1, 1],
        "length_mm": [600, 2000, 400, 300, 200, 400],
        "width_mm": [400, 300, 400, 200, 200, 300],
        "height_mm": [300, 300, 200, 400, 700, 250],
        "weight_kg": [8.0, 5.0, 6.0, 3.0, 4.0, 7.0],
    }
)
"""Of the first order the second box has no place: it is left out."""

OPTIONS: dict[str, Any] = {"orders": TABLE, "action_cell_mm": 200, "cell_mm": 100, "mask": "geometry", "look_ahead": 2}
TERMS = dict.fromkeys(("placed", "utilisation", "fall", "margin", "load", "height", "illegal"), 1.0)


@pytest.fixture(scope="module")
def env() -> petmjx.jax.Palletizing:
    return petmjx.jax.Palletizing(**OPTIONS, rewards=TERMS, most_boxes=4, engine="mujoco", most_illegal=2)


def key_of(env: petmjx.jax.Palletizing, order: int) -> jax.Array:
    """A key that begins with this order."""
    return next(key for key in map(jax.random.key, range(50)) if env.reset(key)[0].order == order)


@pytest.mark.parametrize("order", [0, 1])
def test_an_episode_is_that_of_the_gymnasium_environment(env: petmjx.jax.Palletizing, order: int) -> None:
    pytest.importorskip("gymnasium", reason="gymnasium is not installed (extra: gym)")
    from petmjx.gym.env import PalletizingEnv

    table = TABLE[TABLE.order_id == order]
    gym = PalletizingEnv(**{**OPTIONS, "orders": table}, rewards=TERMS, actions="cells", most_illegal=2)
    rng, step = np.random.default_rng(order), jax.jit(env.step)
    for _ in range(3):
        expected, _ = gym.reset(seed=0)
        state, timestep = env.reset(key_of(env, order))
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


def test_specs_fit_and_what_is_wrong_is_one_line(env: petmjx.jax.Palletizing) -> None:
    _, timestep = env.reset(jax.random.key(0))
    for name, seen in timestep.observation._asdict().items():
        spec = env.observation_spec[name]
        assert (spec.shape, spec.dtype) == (seen.shape, seen.dtype), spec.name
        assert spec.generate_value().shape == spec.shape
        assert (seen >= spec.minimum).all(), spec.name
        assert (seen <= spec.maximum).all(), spec.name
    assert env.action_spec.num_values == env.num_actions == 2 * 6 * 4
    assert env.reward_spec.shape == env.discount_spec.shape == ()
    for options, message in (
        ({"mask": "centre"}, "unknown mask 'centre'"),
        ({"orders": TABLE[1:2]}, "orders: no box of any order fits on the empty carrier"),
        ({"carrier": "footprint"}, "carrier: footprint depends"),
        ({"rewards": {"plced": 1}}, "rewards: unknown term 'plced'"),
        ({"look_ahead": 0}, "look_ahead must be at least 1"),
    ):
        with pytest.raises(InputError, match=message):
            petmjx.jax.Palletizing(**{**OPTIONS, **options})
    state, _ = env.reset(jax.random.key(0))
    with pytest.raises(InputError, match="action must be a whole number, got float32 of shape"):
        env.step(state, 0.5)  # type: ignore[arg-type]


def test_candidates_of_many_states_are_asked_in_one_call() -> None:
    """Under vmap the rows of all states are one call, with more settled worlds than one state has room for."""
    state = petmjx.jax.empty(1, engine="mujoco", most_boxes=2)
    before = len(state.host._pallets)
    corners = jnp.stack([jnp.array([[10.0 * row, 0.0, 0.0]]) for row in range(20)])
    size, mass = jnp.array([[400.0, 300.0, 200.0]]), jnp.array([6.0])
    states, report = jax.vmap(lambda corner: petmjx.jax.place(state, size, corner, mass))(corners)
    assert report.stable.all()
    assert len(state.host._pallets) > before
    tried = jax.vmap(
        lambda one, corner: petmjx.jax.try_all(one, size, corner + jnp.array([[0, 0, 200.0]]), mass, jnp.array([0]))
    )(states, corners)
    assert tried.stable.all()
    assert tried.n_boxes.tolist() == [[2]] * 20
