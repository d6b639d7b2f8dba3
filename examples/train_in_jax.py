"""Train a packer in JAX alone: PPO with a small network, whose episodes are part of the jitted program.

    python examples/train_in_jax.py --updates 50 --pallets 64

With ``--engine mjx-warp`` the pallets never leave the GPU (``--pallets 1024 --boxes 80``). The program needs no library
except JAX: it contains Adam and the network, so that you can replace them with your own. One small network scores every
candidate place, so that what it learns from one place applies to all places.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

import petmjx.jax
from petmjx.plans.order_generator import draw_order

OPTIONS: dict[str, Any] = {
    "actions": "candidates",
    "n_candidates": 24,
    "mask": "support_50",
    "gap_mm": 6.0,  # free space that a robot needs to put boxes beside each other
    "inside_mm": 20.0,
    "max_height_mm": 2000.0,
    "cell_mm": 50.0,
    "longest_wait_s": 2.0,  # each step waits for the box that trembles longest on any pallet
    "rewards": {"utilisation": 20, "fall": 2},
}

GAMMA, TRACE, CLIP, ENTROPY, PARTS = 1.0, 0.95, 0.2, 0.003, 8
"""Parameters of PPO (Schulman et al. 2017) with generalised advantages (Schulman et al. 2016): discount, decay of the
advantage's trace, clipping range, weight of the entropy, and number of minibatches."""

WIDTH = 64
"""Number of units of each hidden layer."""

CARTONS = ((8, 6), (6, 8), (12, 8), (6, 4))
"""Sizes of common cartons in cells of the height map. How low such a carton could stand next, and on how many level
places, shows how good a pile is."""


class Seen(NamedTuple):
    """What the network sees of a pallet: (s,) numbers of the pallet's state; (a, f) features of each candidate place;
    (a,) whether each candidate is legal."""

    state: jax.Array
    candidates: jax.Array
    mask: jax.Array


class Step(NamedTuple):
    """One step of all pallets; arrays (t, n, …) have the axes step and pallet. ``total``: sum of the rewards of an
    episode so far."""

    seen: Seen
    action: jax.Array
    chance: jax.Array
    value: jax.Array
    reward: jax.Array
    over: jax.Array
    total: jax.Array


class Learner(NamedTuple):
    """Everything that training changes: the networks, Adam's moments and number of steps, the pallets, and the random
    key."""

    layers: Any
    moments: Any
    n_steps: jax.Array
    pallets: Any
    key: jax.Array


def largest_over(cells: jax.Array, along: int, length: int) -> jax.Array:
    """The largest of ``length`` neighbouring cells along an axis, for each cell."""
    done = 1
    while done < length:
        shift = min(done, length - done)
        n = cells.shape[along] - shift
        cells = jnp.maximum(
            jax.lax.slice_in_dim(cells, 0, n, axis=along), jax.lax.slice_in_dim(cells, shift, n + shift, axis=along)
        )
        done += shift
    return cells


def of_piles(cells: jax.Array) -> jax.Array:
    """(…, f) features of height maps (…, x, y) in m: mean height, roughness, and the free places of common cartons."""
    steps = (jnp.abs(jnp.diff(cells, axis=axis)).mean(axis=(-2, -1)) for axis in (-2, -1))
    columns = [cells.mean(axis=(-2, -1)), cells.max(axis=(-2, -1)), 5 * sum(steps)]
    x, y = cells.ndim - 2, cells.ndim - 1
    for carton in CARTONS:
        tops, bottoms = cells, -cells
        for axis, length in zip((x, y), carton, strict=True):
            tops, bottoms = largest_over(tops, axis, length), largest_over(bottoms, axis, length)
        level = tops + bottoms < 0.001
        columns += [tops.min(axis=(-2, -1)), level.mean(axis=(-2, -1))]
    return jnp.stack(columns, axis=-1)


def seen(env: Any, observation: Any) -> Seen:
    """An observation as features of size about 1. The features of a candidate describe its place, and the pile with the
    box on this place."""
    cells = observation.height_map / 1000
    side = OPTIONS["cell_mm"]
    turned, x, y, z, dx, dy, dz, mass, support, inside, pile = jnp.moveaxis(observation.candidates, -1, 0)
    covers = []
    for start, length, count in ((x, dx, cells.shape[0]), (y, dy, cells.shape[1])):
        middle = (jnp.arange(count) + 0.5) * side
        covers.append((middle >= start[:, None]) & (middle < (start + length)[:, None]))
    under = covers[0][:, :, None] & covers[1][:, None, :]
    after = jnp.where(under, (z + dz)[:, None, None] / 1000, cells)
    below = jnp.where(under, z[:, None, None] / 1000 - cells, 0.0).mean(axis=(1, 2))
    extent = jnp.array(cells.shape) * side
    aside = (
        jnp.minimum(start, end - start - length) for start, length, end in ((x, dx, extent[0]), (y, dy, extent[1]))
    )
    place = [turned, z / 1000, dx / 500, dy / 500, dz / 500, mass / 10, support, inside / 200, pile / 200, 10 * below]
    place += [distance / 500 for distance in aside]
    now, then = of_piles(cells), of_piles(after)
    candidates = jnp.concatenate([jnp.stack(place, axis=1), then, then - now], axis=1)
    box = observation.boxes[0] / jnp.array([500.0, 500.0, 500.0, 10.0])
    left = observation.left / 40
    state = jnp.concatenate([now, box, jnp.stack([left, jnp.minimum(left, 0.25), observation.mass / 300])])
    return Seen(state, jnp.where(observation.action_mask[:, None], candidates, 0.0), observation.action_mask)


def fresh(key: jax.Array, sizes: list[int]) -> list[tuple[jax.Array, jax.Array]]:
    """New layers of a network, with random weights."""
    keys = jax.random.split(key, len(sizes) - 1)
    return [
        (
            jax.random.normal(k, (rows, columns)) * jnp.sqrt(2 / rows) * (0.01 if columns == sizes[-1] else 1.0),
            jnp.zeros(columns),
        )
        for k, rows, columns in zip(keys, sizes, sizes[1:], strict=False)
    ]


def applied(layers: Any, x: jax.Array) -> jax.Array:
    """The outputs of a network for the inputs x."""
    for weights, bias in layers[:-1]:
        x = jax.nn.relu(x @ weights + bias)
    out: jax.Array = x @ layers[-1][0] + layers[-1][1]
    return out


def network(layers: Any, x: Seen) -> tuple[jax.Array, jax.Array]:
    """Logarithms of the candidates' probabilities, and the value of the state."""
    state = jnp.broadcast_to(x.state[..., None, :], (*x.candidates.shape[:-1], x.state.shape[-1]))
    scores = applied(layers["score"], jnp.concatenate([x.candidates, state], axis=-1))[..., 0]
    chances = jax.nn.log_softmax(jnp.where(x.mask, scores, -1e9))
    return chances, applied(layers["value"], x.state)[..., 0]


def rollout(env: Any, steps: int, layers: Any, pallet: Any, key: jax.Array) -> tuple[Any, Step, jax.Array]:
    """Play ``steps`` steps on one pallet; a new episode begins after each end. Also returns the value of the state
    after the last step."""

    def one(pallet: Any, key: jax.Array) -> tuple[Any, Step]:
        state, observation, total = pallet
        act_key, reset_key = jax.random.split(key)
        x = seen(env, observation)
        chances, value = network(layers, x)
        action = jax.random.categorical(act_key, chances)
        after, timestep = env.step(state, action)
        anew, first = env.reset(reset_key)
        total += timestep.reward
        pallet = jax.tree.map(
            lambda new, old: jnp.where(timestep.last(), new, old),
            (anew, first.observation, jnp.float32(0.0)),
            (after, timestep.observation, total),
        )
        return pallet, Step(x, action, chances[action], value, timestep.reward, timestep.last(), total)

    pallet, batch = jax.lax.scan(one, pallet, jax.random.split(key, steps))
    return pallet, batch, network(layers, seen(env, pallet[1]))[1]


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
    """The loss of PPO: the clipped objective, the error of the values, and the entropy."""
    chances, value = network(layers, batch.seen)
    ratio = jnp.exp(jnp.take_along_axis(chances, batch.action[..., None], axis=-1)[..., 0] - batch.chance)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    gain = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage).mean()
    entropy = -(jnp.exp(chances) * jnp.where(batch.seen.mask, chances, 0.0)).sum(axis=-1).mean()
    return -gain + 0.5 * ((value - returns) ** 2).mean() - ENTROPY * entropy


def adam(layers: Any, slopes: Any, moments: Any, count: jax.Array, rate: float) -> tuple[Any, Any]:
    """A step of Adam (Kingma and Ba 2015)."""
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments[0], slopes)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, moments[1], slopes)
    scale = jnp.sqrt(1 - 0.999**count) / (1 - 0.9**count)
    layers = jax.tree.map(lambda w, m, v: w - rate * scale * m / (jnp.sqrt(v) + 1e-8), layers, first, second)
    return layers, (first, second)


def begin(env: Any, pallets: int, key: jax.Array) -> Learner:
    """A learner with new networks and this number of pallets."""
    key, score_key, value_key, reset_key = jax.random.split(key, 4)
    state, timestep = jax.vmap(env.reset)(jax.random.split(reset_key, pallets))
    x = seen(env, jax.tree.map(lambda values: values[0], timestep.observation))
    s, f = len(x.state), x.candidates.shape[1]
    layers = {"score": fresh(score_key, [f + s, WIDTH, WIDTH, 1]), "value": fresh(value_key, [s, WIDTH, WIDTH, 1])}
    moments = (jax.tree.map(jnp.zeros_like, layers),) * 2
    return Learner(layers, moments, jnp.float32(0.0), (state, timestep.observation, jnp.zeros(pallets)), key)


def update(env: Any, steps: int, epochs: int, rate: float, learner: Learner) -> tuple[Learner, dict[str, jax.Array]]:
    """Play ``steps`` steps on each pallet, then train ``epochs`` times on them. The function is pure, so ``jax.vmap``
    can train several seeds."""
    key, play_key, order_key = jax.random.split(learner.key, 3)
    n = len(learner.pallets[1].left)
    play = jax.vmap(partial(rollout, env, steps), in_axes=(None, 0, 0), out_axes=(0, 1, 0))
    pallets, batch, last = play(learner.layers, learner.pallets, jax.random.split(play_key, n))
    advantage = advantages(batch, last)
    returns = advantage + batch.value
    rows = jax.tree.map(lambda values: values.reshape(steps * n, *values.shape[2:]), (batch, advantage, returns))
    size = max(steps * n // PARTS, 1)

    def improve(carry: Any, part: jax.Array) -> tuple[Any, None]:
        layers, moments, count = carry
        slopes = jax.grad(loss)(layers, *jax.tree.map(lambda values: values[part], rows))
        layers, moments = adam(layers, slopes, moments, count + 1, rate)
        return (layers, moments, count + 1), None

    orders = jax.vmap(lambda k: jax.random.permutation(k, steps * n))(jax.random.split(order_key, epochs))
    parts = orders[:, : steps * n // size * size].reshape(-1, size)
    carry, _ = jax.lax.scan(improve, (learner.layers, learner.moments, learner.n_steps), parts)
    ended = batch.over.sum()
    episodes = {"episodes": ended, "return": (batch.total * batch.over).sum() / jnp.maximum(ended, 1)}
    return Learner(*carry, pallets, key), episodes


def packed(env: Any, layers: Any, order: jax.Array, key: jax.Array) -> tuple[Any, jax.Array]:
    """Pack an order with the policy's most likely actions. Returns the pallet and its return."""

    def one(carry: Any) -> Any:
        state, timestep, total = carry
        state, timestep = env.step(state, network(layers, seen(env, timestep.observation))[0].argmax())
        return state, timestep, total + timestep.reward

    state, _, total = jax.lax.while_loop(
        lambda carry: ~carry[1].last(), one, (*env.reset(key, order), jnp.float32(0.0))
    )
    return state, total


def environment(boxes: int, engine: str, seed: int, orders: int) -> Any:
    """An environment of pallets with at most ``boxes`` boxes, and drawn orders of this seed."""
    drawn = [draw_order(seed, number) for number in range(orders)]
    return petmjx.jax.Palletizing(**OPTIONS, orders=drawn, most_boxes=boxes, engine=engine)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=50)
    parser.add_argument("--pallets", type=int, default=64)
    parser.add_argument("--steps", type=int, default=16, help="steps of each pallet between two updates")
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--boxes", type=int, default=20, help="most boxes of a pallet")
    parser.add_argument("--orders", type=int, default=256, help="number of drawn orders")
    parser.add_argument("--held-out", type=int, default=16, help="other orders, packed at the end; 0: none")
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    env = environment(arguments.boxes, arguments.engine, 0, arguments.orders)
    learner = jax.jit(lambda key: begin(env, arguments.pallets, key))(jax.random.key(arguments.seed))
    learn = jax.jit(lambda learner: update(env, arguments.steps, arguments.epochs, arguments.rate, learner))
    for number in range(arguments.updates):
        learner, episodes = learn(learner)
        count, value = int(episodes["episodes"]), float(episodes["return"])
        print(f"update {number + 1}: {count} episodes with a mean return of {value:.3f}", flush=True)
    if not arguments.held_out:
        return
    others = environment(arguments.boxes, arguments.engine, 1, arguments.held_out)
    pack = jax.jit(jax.vmap(lambda layers, order: packed(others, layers, order, learner.key)[1], in_axes=(None, 0)))
    returns = pack(learner.layers, jnp.arange(others.num_orders))
    print(f"{len(returns)} other orders: a mean return of {returns.mean():.3f}")


if __name__ == "__main__":
    main()
