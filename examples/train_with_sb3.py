"""Train a packer with MaskablePPO of sb3-contrib (extra ``sb3``), on a curriculum.

    python examples/train_with_sb3.py --steps 200000 --engine mjx-warp-cpu

The policy learns on orders that grow and are placed more and more inexactly. On a GPU: ``--engine mjx-warp --pallets
2048``.
"""

from __future__ import annotations

import argparse
from typing import Any

from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback

import petmjx.gym


class Harder(BaseCallback):  # type: ignore[misc]  # Any where Stable-Baselines3 is not installed
    """Raises the level of all environments with the steps, from 0 to 1 at half of the steps."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self._steps = steps

    def _on_rollout_start(self) -> None:
        self.training_env.set_attr("level", min(1.0, 2 * self.num_timesteps / self._steps))

    def _on_step(self) -> bool:
        return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--pallets", type=int, default=64)
    parser.add_argument("--rollout", type=int, default=32, help="steps of each pallet between two updates")
    parser.add_argument("--mask", default="support_50")
    parser.add_argument("--engine", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default=None, help="file for the model")
    arguments = parser.parse_args()

    options: dict[str, Any] = {
        "mask": arguments.mask,
        "n_candidates": 16,
        "cell_mm": 100,
        "rewards": {"utilisation": 20, "fall": 2},
        "curriculum": {"boxes": (8, 80), "sizes": (0.5, 1.0), "errors": (0.0, 1.0)},
        "level": 0.0,
    }
    env = petmjx.gym.PalletizingVecEnv(arguments.pallets, engine=arguments.engine, **options)
    batch = min(1024, arguments.pallets * arguments.rollout)
    model = MaskablePPO(
        "MultiInputPolicy", env, n_steps=arguments.rollout, batch_size=batch, n_epochs=4, seed=arguments.seed, verbose=1
    )
    model.learn(arguments.steps, callback=Harder(arguments.steps))
    if arguments.out is not None:
        model.save(arguments.out)
    env.close()


if __name__ == "__main__":
    main()
