"""Train a packer with physics in the loop: PPO with a linear policy over candidate places, in NumPy alone.

    python examples/train_with_physics.py --updates 30 --pallets 16

The policy learns which of the lowest places to take, on generated orders. The reward is the number of standing boxes.
You can replace ``Policy`` with your own network, which gets ``observed["candidates"]``, (pallets, places, features),
and the mask. The program needs the extra ``gym``. On a GPU: ``--engine mjx-warp --pallets 2048``.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from petmjx.gym.actions import FEATURES

Array = NDArray[np.float64]

LENGTHS = ("x", "y", "z", "length_x", "length_y", "height")


def prepared(candidates: NDArray[Any]) -> Array:
    """(n, a, f) features of size about 1: lengths in metres, masses in units of ten kilograms, and some products."""
    features = candidates.astype(np.float64)
    for name in LENGTHS:
        features[..., FEATURES.index(name)] /= 1000
    features[..., FEATURES.index("mass")] /= 10
    x, y, z, mass, support = (features[..., FEATURES.index(name)] for name in ("x", "y", "z", "mass", "support"))
    products: Array = np.stack([x * y, z * z, z * mass, support**2], axis=-1)
    return np.asarray(np.concatenate([features, products], axis=-1), np.float64)


class Policy:
    """A policy: softmax of a linear function of each candidate's features. It also has a linear function for the value
    of a state."""

    def __init__(self, features: int) -> None:
        self.weights: Array = np.zeros(features)
        self.value: Array = np.zeros(3)

    def shares(self, features: Array, mask: NDArray[Any]) -> Array:
        """(n, a) probabilities of the actions; 0 for illegal actions."""
        logits = np.where(mask, features @ self.weights, -np.inf)
        shares = np.exp(logits - logits.max(axis=-1, keepdims=True))
        return np.asarray(shares / shares.sum(axis=-1, keepdims=True), np.float64)

    def improve(self, batch: Batch, *, epochs: int = 4, clip: float = 0.2, rate: float = 0.3) -> None:
        """Maximise PPO's clipped objective (Schulman et al. 2017), by its gradient: the gradient of log π is φ(a) − Σ π
        φ."""
        advantage = batch.returns - batch.states @ self.value
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        rows = np.arange(len(batch.actions))
        for _ in range(epochs):
            shares = self.shares(batch.features, batch.mask)
            ratio = shares[rows, batch.actions] / batch.chances
            counts = np.where(advantage > 0, ratio < 1 + clip, ratio > 1 - clip)
            chosen = batch.features[rows, batch.actions]
            slope = chosen - np.einsum("na,naf->nf", shares, batch.features)
            self.weights += rate * np.mean((counts * ratio * advantage)[:, None] * slope, axis=0)
        self.value = np.asarray(np.linalg.lstsq(batch.states, batch.returns, rcond=None)[0], np.float64)


@dataclass
class Batch:
    """Steps of all pallets: features of observations, actions, and results."""

    features: Array
    mask: NDArray[Any]
    states: Array
    actions: NDArray[np.int64]
    chances: Array
    returns: Array


def collect(env: Any, observed: Any, policy: Policy, steps: int, rng: np.random.Generator) -> tuple[Batch, Any, Any]:
    """Play some steps on all pallets. A new episode begins in the step in which the previous one ends."""
    seen: list[tuple[Any, ...]] = []
    ended = []
    for _ in range(steps):
        features, mask = prepared(observed["candidates"]), observed["action_mask"] == 1
        shares = policy.shares(features, mask)
        actions = (shares.cumsum(axis=1) > rng.random((len(shares), 1))).argmax(axis=1)
        state = np.column_stack([np.ones(len(shares)), observed["left"][:, 0] / 50, observed["mass"][:, 0] / 300])
        observed, reward, terminated, truncated, info = env.step(actions)
        over = terminated | truncated
        seen.append((features, mask, state, actions, shares[np.arange(len(shares)), actions], reward, over))
        if over.any():
            final = info["final_info"]
            ended += list(zip(final["utilisation"][over], final["verdict"][over] == "stable", strict=True))
    features, mask, states, actions, chances, rewards, over = (np.array(values) for values in zip(*seen, strict=True))
    returns = np.zeros_like(rewards)
    ahead = states[-1] @ policy.value
    for step in reversed(range(steps)):
        ahead = returns[step] = rewards[step] + np.where(over[step], 0.0, ahead)
    flat: list[Any] = [
        values.reshape(-1, *values.shape[2:]) for values in (features, mask, states, actions, chances, returns)
    ]
    return Batch(*flat), observed, ended


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=30)
    parser.add_argument("--pallets", type=int, default=16)
    parser.add_argument("--steps", type=int, default=32, help="steps of each pallet between two updates")
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    env = gymnasium.make_vec(
        "petmjx.gym:petmjx/Palletizing-v0",
        num_envs=arguments.pallets,
        vectorization_mode="vector_entry_point",
        autoreset_mode="SameStep",
        engine=arguments.engine,
        n_candidates=16,
        mask="support_50",  # without the mask "physics": the policy has to learn which places are safe
        rewards={"utilisation": 20, "fall": 2, "height": 0.5},
    )
    observed, _ = env.reset(seed=arguments.seed)
    rng = np.random.default_rng(arguments.seed)
    policy = Policy(prepared(observed["candidates"]).shape[-1])
    for update in range(1, arguments.updates + 1):
        batch, observed, ended = collect(env, observed, policy, arguments.steps, rng)
        policy.improve(batch)
        share, stand = np.mean(ended, axis=0) if ended else (np.nan, np.nan)
        print(
            f"update {update}: return {batch.returns.mean():.3f}, {len(ended)} episodes, "
            f"utilisation {share:.3f}, standing {stand:.2f}",
            flush=True,
        )
    names = [*FEATURES, "x·y", "z²", "z·mass", "support²"]
    print("weights:", ", ".join(f"{name} {weight:+.2f}" for name, weight in zip(names, policy.weights, strict=True)))
    env.close()


if __name__ == "__main__":
    main()
