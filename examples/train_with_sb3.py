"""Train a packer with MaskablePPO of sb3-contrib (extra ``sb3``), on a curriculum.

    python examples/train_with_sb3.py --steps 200000 --engine mjx-warp-cpu

During the training, orders grow and boxes are placed more and more inexactly. On a GPU: ``--engine mjx-warp --pallets
2048``. One small network scores every candidate place, so that what it learns from one place applies to all places.
"""

from __future__ import annotations

import argparse
from typing import Any

import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

import petmjx.gym

OPTIONS: dict[str, Any] = {
    "mask": "support_50",
    "n_candidates": 16,
    "cell_mm": 100,
    "max_height_mm": 2000,
    "gap_mm": 6,  # free space that a robot needs to put boxes beside each other
    "rewards": {"utilisation": 20, "fall": 2},
    "curriculum": {"boxes": (8, 80), "sizes": (0.5, 1.0), "errors": (0.0, 1.0)},
    "level": 0.0,
}

WIDTH = 64
"""Number of units of each hidden layer."""


class Scores(nn.Module):  # type: ignore[misc]  # the base class is Any if PyTorch is not installed
    """A network that scores candidates and estimates the value of a state. It replaces Stable-Baselines3's two
    networks.

    Args:
        space: space of the observations. SB3 passes an observation as one flat vector, with its parts in the order of
            their names.
    """

    def __init__(self, space: Any) -> None:
        super().__init__()
        sizes = {name: int(torch.tensor(part.shape).prod()) for name, part in sorted(space.items())}
        self._names, self._sizes, self._shape = list(sizes), list(sizes.values()), space["candidates"].shape
        rest = sum(sizes.values()) - sizes["candidates"] - sizes["action_mask"]
        self.state = nn.Sequential(nn.Linear(rest, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU())
        self.score = nn.Sequential(nn.Linear(WIDTH + self._shape[1], WIDTH), nn.ReLU(), nn.Linear(WIDTH, 1))
        self.critic = nn.Sequential(nn.Linear(rest, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU())
        self.latent_dim_pi, self.latent_dim_vf = self._shape[0], WIDTH

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(m, a) scores of the candidates, and (m, WIDTH) features from which the value is computed."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """(m, a) scores of the candidates."""
        candidates, rest = self._separate(features)
        state = self.state(rest)[:, None].expand(-1, self._shape[0], -1)
        return self.score(torch.cat([candidates, state], dim=2))[..., 0]

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """(m, WIDTH) features from which the value is computed."""
        return self.critic(self._separate(features)[1])

    def _separate(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        parts = dict(zip(self._names, features.split(self._sizes, dim=1), strict=True))
        rest = [part for name, part in parts.items() if name not in ("candidates", "action_mask")]
        return parts["candidates"].reshape(-1, *self._shape), torch.cat(rest, dim=1)


class ScoringPolicy(MaskableMultiInputActorCriticPolicy):  # type: ignore[misc]  # the base class is Any if SB3 is not installed
    """A policy whose logits are the scores of the candidates."""

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = Scores(self.observation_space)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class Harder(BaseCallback):  # type: ignore[misc]  # the base class is Any if SB3 is not installed
    """Raises the level of the curriculum in all environments with the number of steps, from 0 to 1. The level is 1 from
    half of the steps on."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_rollout_start(self) -> None:
        self.training_env.set_attr("level", min(1.0, 2 * self.num_timesteps / self._steps))

    def _on_step(self) -> bool:
        return True


def learner(env: Any, rollout: int = 32, seed: int = 0) -> Any:
    """MaskablePPO with the network above. Between two updates, each pallet makes ``rollout`` steps."""
    steps = env.num_envs * rollout
    return MaskablePPO(
        ScoringPolicy,
        env,
        n_steps=rollout,
        batch_size=min(max(256, steps // 16), steps),
        n_epochs=4,
        learning_rate=1e-3,
        gamma=0.995,
        ent_coef=0.003,
        seed=seed,
        verbose=1,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--pallets", type=int, default=64)
    parser.add_argument("--rollout", type=int, default=32, help="steps of each pallet between two updates")
    parser.add_argument("--mask", default=OPTIONS["mask"])
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default=None, help="file for the model")
    arguments = parser.parse_args()

    options = OPTIONS | {"mask": arguments.mask}
    env = petmjx.gym.PalletizingVecEnv(arguments.pallets, engine=arguments.engine, **options)
    model = learner(env, arguments.rollout, arguments.seed)
    model.learn(arguments.steps, callback=Harder(arguments.steps))
    if arguments.out is not None:
        model.save(arguments.out)
    env.close()


if __name__ == "__main__":
    main()
