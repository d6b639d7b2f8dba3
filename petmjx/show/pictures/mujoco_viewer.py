"""Plays a story in MuJoCo's own viewer, with contact forces."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np

from petmjx.analysis.story import Story
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.options.simulation import Simulation
from petmjx.show.pictures.story_poses import Poses, poses_at
from petmjx.world.mujoco_model import build_spec, geom_bodies

_PARKED_M: Final = 100.0
"""Boxes that are not yet placed are kept at this distance from the origin, m. So far away, waiting boxes touch
nothing."""

_SPACE, _RIGHT, _LEFT, _HOME = 32, 262, 263, 268
"""Key codes of GLFW."""

_TICK_S: Final = 1 / 60


@dataclass
class Player:
    """Controls which time of a story is shown.

    Attributes:
        story: the story.
        speed: speed of playing, as a multiple of real time.
        time_s: the time that is shown, s.
        paused: whether the time stands still.
    """

    story: Story
    speed: float
    time_s: float = 0.0
    paused: bool = False

    def __post_init__(self) -> None:
        self.time_s = self.first_s

    @property
    def first_s(self) -> float:
        return float(self.story.history.time_s[0])

    @property
    def last_s(self) -> float:
        return float(self.story.history.time_s[-1])

    def press(self, key: int) -> None:
        """Handle a key: Space pauses, the arrows step by one frame, Home returns to the beginning."""
        if key == _SPACE:
            self.paused = not self.paused
        elif key == _HOME:
            self.time_s = self.first_s
        elif key in (_LEFT, _RIGHT):
            self.paused = True
            times = self.story.history.time_s
            later = np.searchsorted(times, self.time_s, side="right" if key == _RIGHT else "left")
            frame = int(later) - (0 if key == _RIGHT else 1)
            self.time_s = float(times[min(max(frame, 0), len(times) - 1)])

    def wait(self, seconds: float) -> None:
        """Advance the shown time by ``speed`` × ``seconds``, unless it stands still. ``seconds`` is the real time that
        has passed."""
        if not self.paused:
            self.time_s = min(self.time_s + self.speed * seconds, self.last_s)


def play(story: Story, speed: float = 1.0) -> None:
    """Open MuJoCo's viewer and play a story until its window is closed.

    Raises:
        InputError: there is no display, or the viewer cannot open its window.
    """
    check_display()
    import mujoco.viewer

    model, data = viewer_model(story)
    player = Player(story, speed)
    try:
        window = mujoco.viewer.launch_passive(model, data, key_callback=player.press)
    except Exception as error:
        raise InputError(f"{option('--viewer')}: MuJoCo's viewer cannot open its window: {one_line(error)}") from error
    with window:
        for flag in (mujoco.mjtVisFlag.mjVIS_CONTACTPOINT, mujoco.mjtVisFlag.mjVIS_CONTACTFORCE):
            window.opt.flags[flag] = True
        while window.is_running():
            with window.lock():
                show(story, player.time_s, model, data)
            window.sync()
            time.sleep(_TICK_S)
            player.wait(_TICK_S)


def check_display() -> None:
    """Check that windows can be opened.

    Raises:
        InputError: there is no display.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            f"{option('--viewer')}: no display here (DISPLAY is not set); pages, films and pictures need none"
        )


def viewer_model(story: Story) -> tuple[Any, Any]:
    """The exact MuJoCo model of a story's world with an additional light, and the model's data."""
    physics = Simulation(**story.options).physics
    spec = build_spec(story.scene, physics)
    spec.worldbody.add_light(pos=[0.0, 0.0, 6.0], dir=[0.0, 0.0, -1.0])
    spec.stat.center = [*story.scene.carrier.pos[:2], float(story.scene.target[:, 2].mean())]
    spec.stat.extent = 2.0 * float(
        story.scene.target[:, 2].max() + (story.scene.carrier.high - story.scene.carrier.low).max() / 2
    )
    model = spec.compile()
    return model, mujoco.MjData(model)


def show(story: Story, time_s: float, model: Any, data: Any) -> None:
    """Set MuJoCo's data to the state of a story's world at a time, including the contact forces at that time."""
    history = story.history
    poses = poses_at(history, time_s)
    data.qpos[:] = _qpos(story, poses)
    data.qvel[:] = 0.0
    frame = poses.frame
    if frame > 0 and history.n_placed[frame] == history.n_placed[frame - 1]:
        step_s = float(history.time_s[frame] - history.time_s[frame - 1])
        if step_s > 0:
            ends = [_qpos(story, poses_at(history, float(history.time_s[f]))) for f in (frame - 1, frame)]
            mujoco.mj_differentiatePos(model, data.qvel, step_s, *ends)
    data.time = time_s
    mujoco.mj_forward(model, data)
    waits = geom_bodies(model, range(story.plan.n_boxes)) >= poses.n_placed
    model.geom_rgba[:, 3] = np.where(waits, 0.0, 1.0)


def _qpos(story: Story, poses: Poses) -> FloatArray:
    """(7 (n + 1),) the model's ``qpos``: positions and orientations of the carrier and the n boxes."""
    waiting = np.arange(story.plan.n_boxes - poses.n_placed)
    parked = np.stack((_PARKED_M + 5.0 * waiting, 0 * waiting, _PARKED_M + 0.0 * waiting), axis=1)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(waiting), 1))
    placed = story.scene.frames(poses.pos, poses.quat)
    pos = np.concatenate((poses.carrier_pos[None], placed, parked))
    quat = np.concatenate((poses.carrier_quat[None], poses.quat, upright))
    lost = np.isnan(pos).any(axis=1)
    pos[lost], quat[lost] = (0.0, -_PARKED_M, _PARKED_M), (1.0, 0.0, 0.0, 0.0)
    return np.concatenate((pos, quat), axis=1).ravel()
