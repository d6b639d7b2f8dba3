"""Train a packer with PPO of RLlib (``pip install 'ray[rllib]' torch``), with masks of legal actions.

    python examples/train_with_rllib.py --updates 20

RLlib steps single environments, each on an engine of its own, in ``--runners`` processes.
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.examples.rl_modules.classes.action_masking_rlm import ActionMaskingTorchRLModule
from ray.tune.registry import register_env


class FlatWithMask(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Observations in the form that RLlib's module for masks needs: one vector, and the mask beside it."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        shown = env.observation_space
        assert isinstance(shown, spaces.Dict)
        self._names = [name for name in shown if name != "action_mask"]
        width = sum(int(np.prod(shown[name].shape or ())) for name in self._names)
        actions = int(shown["action_mask"].shape[0])  # type: ignore[index]  # a mask has a shape
        self.observation_space = spaces.Dict(
            {
                "action_mask": spaces.Box(0.0, 1.0, (actions,), np.float32),
                "observations": spaces.Box(0.0, 1.0, (width,), np.float32),
            }
        )

    def observation(self, observation: Any) -> dict[str, Any]:
        flat = np.concatenate([observation[name].ravel() for name in self._names])
        return {"action_mask": observation["action_mask"].astype(np.float32), "observations": flat}


def make(options: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    """The environment, made in the process in which RLlib needs it."""
    return FlatWithMask(gymnasium.make("petmjx.gym:petmjx/Palletizing-v0", scaled=True, engine="mujoco", **options))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=20)
    parser.add_argument("--steps", type=int, default=1024, help="between two updates")
    parser.add_argument("--runners", type=int, default=0, help="processes; 0: this one")
    parser.add_argument("--pallets", type=int, default=8, help="of each process")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()

    register_env("palletizing", make)
    options = {"mask": "support_50", "rewards": {"utilisation": 20, "fall": 2}, "threads": 1}
    start: Any = PPOConfig  # PPOConfig has no types
    config = (
        start()
        .environment("palletizing", env_config=options)
        .env_runners(num_env_runners=arguments.runners, num_envs_per_env_runner=arguments.pallets)
        .rl_module(rl_module_spec=RLModuleSpec(module_class=ActionMaskingTorchRLModule))
        .training(train_batch_size_per_learner=arguments.steps, minibatch_size=min(256, arguments.steps), num_epochs=4)
        .debugging(seed=arguments.seed)
    )
    algorithm = config.build_algo()
    for update in range(1, arguments.updates + 1):
        result = algorithm.train()["env_runners"]
        print(f"update {update}: return {result.get('episode_return_mean', np.nan):.3f}", flush=True)
    algorithm.stop()


if __name__ == "__main__":
    main()
