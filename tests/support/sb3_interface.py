"""The interface of Stable-Baselines3's vector environments, for machines without Stable-Baselines3, which needs
PyTorch.

The interface follows the documentation of ``VecEnv``, and has what ``petmjx.gym.PalletizingVecEnv`` gets from its base
class.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import pytest


class VecEnv:
    """Stores the spaces, and the seeds and options for the next reset."""

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs, self.observation_space, self.action_space = num_envs, observation_space, action_space
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self._reset_seeds()
        self._reset_options()
        self.render_mode = self.get_attr("render_mode")[0]  # type: ignore[attr-defined]

    def _reset_seeds(self) -> None:
        self._seeds: list[int | None] = [None] * self.num_envs

    def _reset_options(self) -> None:
        self._options: list[dict[str, Any]] = [{}] * self.num_envs

    def seed(self, seed: int) -> None:
        self._seeds = [seed + row for row in range(self.num_envs)]

    def set_options(self, options: dict[str, Any]) -> None:
        self._options = [options] * self.num_envs

    def has_attr(self, name: str) -> bool:
        try:
            self.get_attr(name)  # type: ignore[attr-defined]
        except AttributeError:
            return False
        return True

    def step(self, actions: Any) -> Any:
        self.step_async(actions)  # type: ignore[attr-defined]
        return self.step_wait()  # type: ignore[attr-defined]

    def _get_indices(self, indices: Any) -> Any:
        return range(self.num_envs) if indices is None else [indices] if isinstance(indices, int) else indices


class Monitor:
    """A class of which only the name is needed."""


def stand_in(monkeypatch: pytest.MonkeyPatch) -> type[Any]:
    """The class ``PalletizingVecEnv`` based on this interface, with the class ``Monitor`` in its module."""
    for name, members in (
        ("stable_baselines3", {}),
        ("stable_baselines3.common", {}),
        ("stable_baselines3.common.monitor", {"Monitor": Monitor}),
        ("stable_baselines3.common.vec_env", {"VecEnv": VecEnv}),
    ):
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "petmjx.gym.sb3_vec_env", raising=False)
    from petmjx.gym import PalletizingVecEnv

    del sys.modules["petmjx.gym.sb3_vec_env"]  # so that no other test gets this module
    made: type[Any] = PalletizingVecEnv
    return made
