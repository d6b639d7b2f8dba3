"""``petmjx/Palletizing-v0`` as a vector environment: in each step, one engine simulates n pallets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from petmjx.common.argument_checks import integer_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.gym.curriculum import level_of
from petmjx.gym.episodes import Episodes
from petmjx.gym.observation_spaces import Observation
from petmjx.gym.single_env import PalletizingEnv, check_render_mode, spaces_of
from petmjx.loop.engine_setup import MOST_PALLETS

Info = dict[str, Any]


class PalletizingVectorEnv(VectorEnv[Observation, NDArray[np.int64], NDArray[Any]]):
    """n environments with a pallet each. The results are bit-identical to the results of n ``PalletizingEnv``, but all
    pallets are simulated in one call.

    Args:
        num_envs: number n of environments.
        autoreset_mode: when a new episode begins after an episode has ended. NEXT_STEP: a new episode begins in the
            next step, which ignores the action. SAME_STEP: a new episode begins in the same step; the last observation
            and information of the ended episode are then in ``info``. DISABLED: a new episode begins when ``reset`` is
            called.
        render_mode: "rgb_array" for pictures; None for no pictures.
        options: as for ``PalletizingEnv``, except that the default engine is ``auto``.

    Raises:
        InputError: an option is unusable.
    """

    metadata = {  # noqa: RUF012  # as Gymnasium has it
        **PalletizingEnv.metadata,
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            names = ", ".join(mode.value for mode in AutoresetMode)
            raise InputError(f"autoreset_mode must be one of {names}, got {autoreset_mode!r}") from None
        self.num_envs, self.render_mode = integer_of(num_envs, "num_envs", 1, MOST_PALLETS), render_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.episodes = Episodes(self.num_envs, options)
        self.single_observation_space, self.single_action_space = spaces_of(self.episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.arange(self.num_envs)
        self._rngs: list[np.random.Generator] = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._over = np.ones(self.num_envs, bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin the episodes of all environments, or only of the environments for which the mask
        ``options["reset_mask"]`` (n,) is true.

        Args:
            options: a dict with the entries ``reset_mask`` and ``level``. ``level`` is one number or an array (n,),
                from 0 to 1, and sets the level of difficulty of the new episodes and of all later episodes.
            seed: seed of the first environment, to which 1 is added for each further environment; or a list with a seed
                for each environment.
        """
        level = level_of(options, self.num_envs, "reset_mask")
        mask = None if options is None else options.get("reset_mask")
        rows = self._all if mask is None else np.flatnonzero(self._checked_mask(mask))
        seeds = [seed + row for row in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        if (seeds is not None and not isinstance(seeds, Sequence | np.ndarray)) or isinstance(seeds, str):
            raise InputError(f"seed must be a whole number or a list of them, {shown_value(seeds)}")
        if seeds is not None and len(seeds) != self.num_envs:
            raise InputError(f"seed must have {self.num_envs} numbers, got {len(seeds)}")
        for row in rows.tolist():
            if seeds is not None and seeds[row] is not None:
                self._rngs[row], _ = seeding.np_random(seeds[row])
        if level is not None:
            self.episodes.set_level(rows, level[rows])
        self._begin(rows)
        return self.episodes.observed(self._all), self._info(rows)

    def step(self, actions: Any) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Carry out one action in each environment whose episode is running. Each action places a box."""
        chosen = np.asarray(actions)
        if chosen.shape != (self.num_envs,) or chosen.dtype.kind not in "iu":
            raise InputError(f"actions must be {self.num_envs} whole numbers, got shape {chosen.shape}")
        if not ((chosen >= 0) & (chosen < self.episodes.n_actions)).all():
            raise InputError(f"actions must be from 0 to {self.episodes.n_actions - 1}")
        anew = np.flatnonzero(self._over)
        if anew.size and self.autoreset_mode is not AutoresetMode.NEXT_STEP:
            raise InputError(f"the episode of environment {anew[0]} is over: reset it")
        going = np.flatnonzero(~self._over)
        self._begin(anew)
        reward, terminated, truncated = np.zeros(self.num_envs), *(np.zeros(self.num_envs, bool) for _ in range(2))
        info: Info = {}
        if going.size:
            stepped = self.episodes.step(going, chosen[going])
            reward[going], terminated[going], truncated[going] = stepped.reward, stepped.terminated, stepped.truncated
            terms = {f"reward_{name}": values for name, values in stepped.terms.items()}
            info = self._spread(going, terms)
        self._over = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            ended_rows = np.flatnonzero(self._over)
            info |= self._final(ended_rows, info)
            self._begin(ended_rows)
        return self.episodes.observed(self._all), reward, terminated, truncated, info | self._info(self._all)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each pallet."""
        if self.render_mode is None:
            return None
        return tuple(self.episodes.picture(row) for row in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """Release the engine."""
        self.episodes.pallets.close()

    def _begin(self, rows: NDArray[np.int64]) -> None:
        self.episodes.begin(rows, [self._rngs[row] for row in rows.tolist()])
        self._over[rows] = False

    def _info(self, rows: NDArray[np.int64]) -> Info:
        return self._spread(rows, self.episodes.info_of(rows))

    def _spread(self, rows: NDArray[np.int64], values: dict[str, NDArray[Any]]) -> Info:
        """Convert values of some environments to Gymnasium's form: arrays for all environments, and masks that tell
        which environments have a value."""
        info: Info = {}
        known = np.zeros(self.num_envs, bool)
        known[rows] = True
        for name, row_values in values.items():
            table = np.zeros(self.num_envs, row_values.dtype)
            if row_values.dtype == object:
                table[:] = None
            table[rows] = row_values
            info[name], info[f"_{name}"] = table, known.copy()
        return info

    def _final(self, rows: NDArray[np.int64], so_far: Info) -> Info:
        """The last observations and information of the episodes that ended in this step, in Gymnasium's form."""
        observations = self.episodes.observed(rows)
        last = np.empty(len(rows), object)
        last[:] = [{name: values[at] for name, values in observations.items()} for at in range(len(rows))]
        info = self._spread(rows, {"final_obs": last})
        terms = {name: values[rows] for name, values in so_far.items() if name.startswith("reward_")}
        final_info = self._spread(rows, terms | self.episodes.info_of(rows))
        return info | {"final_info": final_info, "_final_info": info["_final_obs"].copy()}

    def _checked_mask(self, mask: Any) -> NDArray[np.bool_]:
        reset_mask = np.asarray(mask)
        if reset_mask.shape != (self.num_envs,) or reset_mask.dtype != bool or not reset_mask.any():
            raise InputError(f"options: reset_mask must be {self.num_envs} booleans, at least one of them true")
        return reset_mask
