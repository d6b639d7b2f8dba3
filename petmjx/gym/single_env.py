"""``petmjx/Palletizing-v0``: an environment with one pallet. Each step places one box on the pallet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.gym.curriculum import level_of
from petmjx.gym.episodes import Episodes
from petmjx.gym.observation_spaces import Observation
from petmjx.show.picture_window import PictureWindow

_FIRST: Final = np.zeros(1, np.int64)


def spaces_of(episodes: Episodes) -> tuple[spaces.Dict, spaces.Discrete]:
    """The Gymnasium spaces of the observations and of the actions of one episode."""
    boxes: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(low, high, shape, kind) for name, (shape, low, high, kind) in episodes.spaces.items()
    }
    return spaces.Dict(boxes), spaces.Discrete(episodes.n_actions)


class PalletizingEnv(gym.Env[Observation, np.int64]):
    """Boxes arrive one after another. Each action places one box on the pallet, and a simulation shows whether the
    pallet stands.

    An episode ends when the pallet does not stand, or when no remaining box has a legal place. Boxes for which there is
    no legal place are left out. docs/loop.md has the details.

    Args:
        render_mode: "rgb_array" for pictures of 480 × 480 pixels per pallet (needs EGL and the extra ``show``); "human"
            for pictures in a window after each step (needs a display); None for no pictures.
        options: fields of ``petmjx.gym.environment_options.PalletizingOptions``, arguments of ``petmjx.Pallets``, and
            fields of ``petmjx.Simulation``.

    Raises:
        InputError: an option is unusable.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 4}  # noqa: RUF012  # as Gymnasium has it

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        check_render_mode(render_mode)
        self.render_mode = render_mode
        self.episodes = Episodes(1, {"engine": "mujoco", **options})
        self._ended = True
        self._window: PictureWindow | None = None
        self.observation_space: Any
        self.observation_space, self.action_space = spaces_of(self.episodes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode. Equal seeds give equal episodes.

        Args:
            options: a dict that may have the entry ``level``, from 0 to 1. The entry ``level`` sets the level of
                difficulty of the new episode and of all later episodes.
        """
        super().reset(seed=seed)
        if (level := level_of(options, 1)) is not None:
            self.episodes.set_level(_FIRST, level)
        self.episodes.begin(_FIRST, [self.np_random])
        self._ended = False
        self._show()
        return self._observed(), self._info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Place a box on the pallet. An illegal action changes nothing."""
        if not self.action_space.contains(action):
            raise InputError(
                f"action must be a whole number from 0 to {self.episodes.n_actions - 1}, {shown_value(action)}"
            )
        if self._ended:
            raise InputError("the episode has ended, or none has begun: call reset")
        stepped = self.episodes.step(_FIRST, np.array([action], np.int64))
        terms = {f"reward_{name}": float(values[0]) for name, values in stepped.terms.items()}
        ends = bool(stepped.terminated[0]), bool(stepped.truncated[0])
        self._ended = any(ends)
        self._show()
        return self._observed(), float(stepped.reward[0]), *ends, self._info() | terms

    def render(self) -> NDArray[np.uint8] | None:
        """A picture of the pallet; None if the picture is shown in a window."""
        if self.render_mode == "rgb_array":
            return self.episodes.picture(0)
        self._show()
        return None

    def _show(self) -> None:
        if self.render_mode == "human":
            if self._window is None:
                self._window = PictureWindow("petmjx", 1 / self.metadata["render_fps"])
            self._window.show(self.episodes.picture(0))

    def action_masks(self) -> NDArray[np.bool_]:
        """(a,) mask of legal actions. Libraries for policies with masks call a method of this name."""
        masks: NDArray[np.bool_] = self.episodes.table.legal[0].copy()
        return masks

    def close(self) -> None:
        """Release the engine, and close the window."""
        if self._window is not None:
            self._window.close()
        self.episodes.pallets.close()

    def _observed(self) -> Observation:
        return {name: values[0] for name, values in self.episodes.observed(_FIRST).items()}

    def _info(self) -> dict[str, Any]:
        return {name: values[0] for name, values in self.episodes.info_of(_FIRST).items()}


def check_render_mode(render_mode: str | None, modes: Sequence[str] = PalletizingEnv.metadata["render_modes"]) -> None:
    """Raise InputError unless the mode is None or one of ``modes``."""
    if render_mode is not None and render_mode not in modes:
        raise InputError(f"render_mode must be None or {' or '.join(modes)}, got {render_mode!r}")
