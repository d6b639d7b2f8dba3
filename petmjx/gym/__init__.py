"""Environments for reinforcement learning with Gymnasium. Importing this package registers the environment
``petmjx/Palletizing-v0``. The package needs petmjx's extra ``gym``.

``gymnasium.make("petmjx.gym:petmjx/Palletizing-v0")`` imports this package. ``PalletizingVecEnv`` is the environment
for Stable-Baselines3, and needs petmjx's extra ``sb3``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from petmjx.common.errors import EngineUnavailable

if TYPE_CHECKING:
    from petmjx.gym.sb3_vec_env import PalletizingVecEnv as PalletizingVecEnv

try:
    from gymnasium.envs.registration import register, registry
except ImportError as error:
    raise EngineUnavailable("petmjx.gym needs gymnasium, which is not installed: pip install 'petmjx[gym]'") from error

ENVIRONMENT: Final = "Palletizing-v0"

if f"petmjx/{ENVIRONMENT}" not in registry:
    register(
        f"petmjx/{ENVIRONMENT}",
        entry_point="petmjx.gym.single_env:PalletizingEnv",
        vector_entry_point="petmjx.gym.vector_env:PalletizingVectorEnv",
    )


def __getattr__(name: str) -> Any:
    if name == "PalletizingVecEnv":
        # this module is imported only on request, because it loads Stable-Baselines3 and PyTorch
        from petmjx.gym.sb3_vec_env import PalletizingVecEnv

        return PalletizingVecEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
