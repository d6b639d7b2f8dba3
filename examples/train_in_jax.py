"""Train a packer in JAX alone: PPO with a small network, whose episodes are part of the jitted program.

    python examples/train_in_jax.py --updates 50 --pallets 64

With ``--engine mjx-warp`` the pallets never leave the GPU (``--pallets 2048``). Needs no library beside JAX: Adam and
the network are written out, so that you can put your own in their place.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

import petmjx.jax

GAMMA, TRACE, CLIP, ENTROPY = 1.0, 0.95, 0.2, 0.01
"""Of PPO (Schulman et al. 2017) with generalised advantages (Schulman et al. 2016)."""


class Step(NamedTuple):
    """A step of all pallets: (t, n, …)."""

    seen: jax.Array
    mask: jax.Array
    action: jax.Array
    chance: jax.Array
    value: jax.Array
    reward: jax.Array
    over: jax.Array


def seen(observation: Any, highest_mm: float) -> jax.Array:
    """An observation as one vector of numbers of about 1."""
    boxes = observation.boxes / jnp.array([1000.0, 1000.0, 1000.0, 10.0])
    return jnp.concatenate([(observation.height_map / highest_mm).ravel(), boxes.ravel()])


def fresh(key: jax.Array, sizes: list[int]) -> list[tuple[jax.Array, jax.Array]]:
    """The layers of a network."""
    keys = jax.random.split(key, len(sizes) - 1)
    return [
        (
            jax.random.normal(k, (rows, columns)) * jnp.sqrt(2 / rows) * (0.01 if columns == sizes[-1] else 1.0),
            jnp.zeros(columns),
        )
        for k, rows, columns in zip(keys, sizes, sizes[1:], strict=False)
    ]


def network(layers: Any, x: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Logarithms of the actions' chances, and the value."""
    for weights, bias in layers[:-1]:
        x = jnp.tanh(x @ weights + bias)
    out = x @ layers[-1][0] + layers[-1][1]
    logits = jnp.where(mask, out[..., :-1], -1e9)
    return jax.nn.log_softmax(logits), out[..., -1]


def rollout(env: Any, steps: int, layers: Any, carry: Any, key: jax.Array) -> tuple[Any, Step, jax.Array]:
    """Steps of one pallet, with a new episode after each end. Returns also the value of the next state."""

    def one(carry: Any, key: jax.Array) -> tuple[Any, Step]:
        state, observation = carry
        act_key, reset_key = jax.random.split(key)
        x = seen(observation, env.observation_spec["height_map"].maximum)
        chances, value = network(layers, x, observation.action_mask)
        action = jax.random.categorical(act_key, chances)
        after, timestep = env.step(state, action)
        anew = env.reset(reset_key)
        carry = jax.tree.map(
            lambda new, old: jnp.where(timestep.last(), new, old),
            (anew[0], anew[1].observation),
            (after, timestep.observation),
        )
        step = Step(x, observation.action_mask, action, chances[action], value, timestep.reward, timestep.last())
        return carry, step

    carry, batch = jax.lax.scan(one, carry, jax.random.split(key, steps))
    x = seen(carry[1], env.observation_spec["height_map"].maximum)
    return carry, batch, network(layers, x, carry[1].action_mask)[1]


def advantages(batch: Step, last: jax.Array) -> jax.Array:
    """(t, n) generalised advantages."""

    def back(carry: Any, step: Step) -> tuple[Any, jax.Array]:
        ahead, value = carry
        goes = 1.0 - step.over
        error = step.reward + GAMMA * goes * value - step.value
        ahead = error + GAMMA * TRACE * goes * ahead
        return (ahead, step.value), ahead

    return jax.lax.scan(back, (jnp.zeros_like(last), last), batch, reverse=True)[1]


def loss(layers: Any, batch: Step, advantage: jax.Array, returns: jax.Array) -> jax.Array:
    """PPO's clipped objective, the error of values, and the entropy."""
    chances, value = network(layers, batch.seen, batch.mask)
    ratio = jnp.exp(jnp.take_along_axis(chances, batch.action[..., None], axis=-1)[..., 0] - batch.chance)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage).mean()
    entropy = -(jnp.exp(chances) * jnp.where(batch.mask, chances, 0.0)).sum(axis=-1).mean()
    return -gain + 0.5 * ((value - returns) ** 2).mean() - ENTROPY * entropy


def adam(layers: Any, slopes: Any, moments: Any, count: jax.Array, rate: float) -> tuple[Any, Any]:
    """A step of Adam (Kingma and Ba 2015)."""
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments[0], slopes)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, moments[1], slopes)
    scale = jnp.sqrt(1 - 0.999**count) / (1 - 0.9**count)
    layers = jax.tree.map(lambda w, m, v: w - rate * scale * m / (jnp.sqrt(v) + 1e-8), layers, first, second)
    return layers, (first, second)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=50)
    parser.add_argument("--pallets", type=int, default=64)
    parser.add_argument("--steps", type=int, default=16, help="steps of each pallet between two updates")
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--boxes", type=int, default=20, help="most boxes of a pallet")
    parser.add_argument("--cell-mm", type=float, default=200.0, help="side of the cells of actions and of the map")
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    env = petmjx.jax.Palletizing(
        action_cell_mm=arguments.cell_mm,
        cell_mm=arguments.cell_mm,
        mask="support_50",  # without the mask of physics: safety is to be learned
        rewards={"utilisation": 20, "fall": 2},
        most_boxes=arguments.boxes,
        engine=arguments.engine,
    )
    key, net_key, reset_key = jax.random.split(jax.random.key(arguments.seed), 3)
    state, timestep = jax.jit(jax.vmap(env.reset))(jax.random.split(reset_key, arguments.pallets))
    carry = state, timestep.observation
    width = seen(jax.tree.map(lambda values: values[0], timestep.observation), 1.0).size
    layers = fresh(net_key, [width, 64, 64, env.num_actions + 1])
    moments = (jax.tree.map(jnp.zeros_like, layers),) * 2
    play = jax.jit(jax.vmap(partial(rollout, env, arguments.steps), in_axes=(None, 0, 0), out_axes=(0, 1, 0)))

    @jax.jit
    def improve(layers: Any, moments: Any, count: jax.Array, batch: Step, last: jax.Array) -> tuple[Any, Any]:
        advantage = advantages(batch, last)
        returns = advantage + batch.value
        for epoch in range(arguments.epochs):
            slopes = jax.grad(loss)(layers, batch, advantage, returns)
            layers, moments = adam(layers, slopes, moments, count + epoch + 1.0, arguments.rate)
        return layers, moments

    for update in range(arguments.updates):
        key, play_key = jax.random.split(key)
        carry, batch, last = play(layers, carry, jax.random.split(play_key, arguments.pallets))
        layers, moments = improve(layers, moments, jnp.float32(update * arguments.epochs), batch, last)
        ended = int(batch.over.sum())
        episode = float(batch.reward.sum()) / max(ended, 1)
        print(f"update {update + 1}: {ended} episodes, about {episode:.3f} a return", flush=True)


if __name__ == "__main__":
    main()
