"""``petmjx/Palletizing-v0`` as a vector environment of Stable-Baselines3: in each step, one engine simulates n pallets.
The environment provides masks of legal actions for MaskablePPO of sb3-contrib. This module needs petmjx's extra
``sb3``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.gym.curriculum import level_of
from petmjx.gym.vector_env import PalletizingVectorEnv

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise EngineUnavailable(
        "petmjx.gym.PalletizingVecEnv needs stable_baselines3, which is not installed: pip install 'petmjx[sb3]'"
    ) from error


class PalletizingVecEnv(VecEnv):  # type: ignore[misc, unused-ignore]  # where Stable-Baselines3 is not installed
    """n environments with a pallet each, for ``MaskablePPO("MultiInputPolicy", env)`` and other algorithms of
    Stable-Baselines3.

    When an episode ends, the next one begins in the same step. The last observation of the ended episode is
    ``info["terminal_observation"]``. ``info["episode"]`` has the return ``r`` of the ended episode, its length ``l``
    and the time ``t`` in s, in the form of ``VecMonitor``, so ``VecMonitor`` is not needed.
    ``info["TimeLimit.truncated"]`` is true if the episode ended because of too many illegal actions.

    Args:
        num_envs: number n of environments.
        options: as for ``PalletizingVectorEnv``. Observations are scaled unless ``scaled=False``.

    Raises:
        InputError: an option is unusable.
        EngineUnavailable: Stable-Baselines3 is not installed, or the engine cannot run on this machine.
    """

    def __init__(self, num_envs: int = 16, **options: Any) -> None:
        self.env = PalletizingVectorEnv(num_envs, AutoresetMode.SAME_STEP, **{"scaled": True, **options})
        super().__init__(num_envs, self.env.single_observation_space, self.env.single_action_space)
        self._actions: Any = None
        self._return = np.zeros(num_envs)
        self._length = np.zeros(num_envs, np.int64)
        self._began_s = time.monotonic()

    def reset(self) -> dict[str, NDArray[Any]]:
        """Begin all episodes. If the method ``seed`` was called before, the new episodes have the seeds that it set."""
        level = [options["level"] for options in self._options if "level" in options]
        if len(level) not in (0, self.num_envs):
            raise InputError("options: give all environments a level, or none")
        observed, info = self.env.reset(seed=self._seeds, options={"level": np.array(level)} if level else None)
        self.reset_infos = self._separate(info)
        self._return[:] = self._length[:] = 0
        self._reset_seeds()
        self._reset_options()
        return observed

    def set_options(self, options: Any = None) -> None:
        """Set the options of the next reset: one dict for all environments, or a list with a dict for each environment.
        A dict may have the entry ``level``, the level of difficulty from 0 to 1.

        Raises:
            InputError: an option is unknown, or a level is not a number.
        """
        for single in options if isinstance(options, list) else [options]:
            level_of(single, 1)
        super().set_options(options)

    def step_async(self, actions: Any) -> None:
        """Store the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, NDArray[Any]], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carry out the stored actions, which place a box on each pallet."""
        observed, reward, terminated, truncated, info = self.env.step(self._actions)
        over = terminated | truncated
        self._return += reward
        self._length += 1
        infos = self._separate(info)
        if over.any():
            last = self._separate(info["final_info"])
            for row in np.flatnonzero(over).tolist():
                self.reset_infos[row] = infos[row]
                infos[row] = last[row] | {
                    "terminal_observation": info["final_obs"][row],
                    "TimeLimit.truncated": bool(truncated[row]),
                    "episode": {
                        "r": float(self._return[row]),
                        "l": int(self._length[row]),
                        "t": round(time.monotonic() - self._began_s, 6),
                    },
                }
            self._return[over] = self._length[over] = 0
        return observed, reward.astype(np.float32), over, infos

    def close(self) -> None:
        """Release the engine."""
        self.env.close()

    def action_masks(self, row: int) -> NDArray[np.bool_]:
        """(a,) mask of the legal actions of one environment."""
        masks: NDArray[np.bool_] = self.env.episodes.table.legal[row].copy()
        return masks

    def get_images(self) -> Sequence[NDArray[np.uint8]]:
        """A picture of each pallet; needs ``render_mode="rgb_array"``."""
        return self.env.render() or ()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """A list with an attribute of each environment: ``level``, ``action_masks``, or an attribute that is the same
        for all environments, such as ``render_mode``."""
        rows = self._rows(indices)
        if attr_name == "level":
            return [float(self.env.episodes.level[row]) for row in rows]
        if attr_name in self._methods:
            return [partial(self._methods[attr_name], row) for row in rows]
        # the method has_attr turns the AttributeError of a missing attribute into False
        value = getattr(self.env, attr_name)
        return [value for _ in rows]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set the attribute ``level``, which is the level of difficulty from the next episode on. The value is one
        number, or a number for each environment. Only the attribute ``level`` can be set.

        Raises:
            InputError: the name is not ``level``, there is no curriculum, a level is not from 0 to 1, the number of
                levels is wrong, or an environment does not exist.
        """
        if attr_name != "level":
            raise InputError(f"set_attr: only level can be set, got {attr_name!r}")
        self.env.episodes.set_level(np.asarray(self._rows(indices), np.int64), value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call the method ``action_masks`` or ``render`` of each environment, and return the results."""
        if method_name not in self._methods:
            raise AttributeError(f"an environment has only the methods {', '.join(self._methods)}, got {method_name!r}")
        return [self._methods[method_name](row, *method_args, **method_kwargs) for row in self._rows(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Whether each environment already does what a wrapper would do: True for the wrapper ``Monitor``, False for
        all other wrappers."""
        return [wrapper_class is Monitor for _ in self._rows(indices)]

    def _rows(self, indices: Any) -> list[int]:
        """The numbers of the environments that ``indices`` selects. Negative numbers count from the end, as in a list.
        A boolean mask is refused.

        Raises:
            InputError: the indices are neither a whole number nor a list of whole numbers, an environment does not
                exist, or an environment is named twice.
        """
        n = self.num_envs
        some = range(n) if indices is None else [indices] if isinstance(indices, int | np.integer) else indices
        try:
            rows = list(some)
        except TypeError:
            raise InputError(f"indices must be a whole number or a list of them, {shown_value(indices)}") from None
        for row in rows:
            if isinstance(row, bool) or not isinstance(row, int | np.integer) or not -n <= row < n:
                raise InputError(f"indices: there are environments 0 to {n - 1}, {shown_value(row)}")
        numbers = [int(row) % n for row in rows]
        if len({*numbers}) < len(numbers):
            raise InputError(f"indices: an environment is named twice, {shown_value(indices)}")
        return numbers

    @property
    def _methods(self) -> dict[str, Callable[..., Any]]:
        return {"action_masks": self.action_masks, "render": self.env.episodes.picture}

    def _separate(self, info: dict[str, Any]) -> list[dict[str, Any]]:
        """Split ``info``, which has arrays for all environments, into one dict for each environment."""
        names = [name for name in info if not name.startswith(("_", "final_"))]
        columns = [info[name].tolist() for name in names]
        if not names:
            return [{} for _ in range(self.num_envs)]
        return [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]
