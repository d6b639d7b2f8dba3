"""Gymnasium environments: importing this package registers ``petmjx/Palletizing-v0``. Needs the extra ``gym``."""

from __future__ import annotations

from petmjx.common.errors import EngineUnavailable

ENVIRONMENT = "Palletizing-v0"


def register_environments() -> None:
    """Register the environment with Gymnasium, in the namespace ``petmjx``. Gymnasium calls this through an entry
    point."""
    from gymnasium.envs.registration import current_namespace, register, registry

    name = ENVIRONMENT if current_namespace == "petmjx" else f"petmjx/{ENVIRONMENT}"
    if f"petmjx/{ENVIRONMENT}" not in registry:
        register(
            name,
            entry_point="petmjx.gym.env:PalletizingEnv",
            vector_entry_point="petmjx.gym.vector_env:PalletizingVectorEnv",
        )


try:
    import gymnasium as _gymnasium
except ImportError as error:
    raise EngineUnavailable("petmjx.gym needs gymnasium, not installed: pip install 'petmjx[gym]'") from error
assert _gymnasium
register_environments()
