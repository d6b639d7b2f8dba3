"""The drive (motion of the carrier, or force on it) of a world on C MuJoCo, step by step."""

from __future__ import annotations

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.film import ActingFilm
from petmjx.engines.mujoco.live_world import LiveWorld
from petmjx.engines.mujoco.timetable import NEVER
from petmjx.world.job import FORCE, Drive
from petmjx.world.scene import Scene


class ActingDrive:
    """A drive that begins after a given step. The force or acceleration of the drive is an array with one row per step.

    Args:
        begin: the step after which the drive begins.
        gravity: (3,) gravity, m/s².

    Attributes:
        holds_carrier: whether the drive prescribes the carrier's acceleration, in which case the carrier is clamped.
    """

    def __init__(self, drive: Drive, begin: int, total_mass: float, gravity: FloatArray) -> None:
        self.begin, self._gravity = begin, gravity
        self.holds_carrier = drive.excitation.kind != FORCE
        self._film: ActingFilm | None = None
        # After the rows of the excitation, the array has a row of zeros, since nothing acts after the excitation's end.
        self._rows: FloatArray = np.vstack((drive.rows(total_mass), np.zeros((1, 3))))
        self._changes = begin + np.flatnonzero((self._rows[1:] != self._rows[:-1]).any(axis=1)) + 1

    def wrap(self, scene: Scene, timestep_s: float, live: LiveWorld) -> None:
        """Put stretch film around the boxes at their current places."""
        if scene.wrap.holds:
            self._film = ActingFilm(scene, timestep_s, live.from_carrier()[0])

    def next_change(self, step: int) -> int:
        """Number of the next step after which the force or gravity changes. With film, the force changes after every
        step."""
        if self._film is not None:
            return step + 1
        place = int(np.searchsorted(self._changes, step, side="right"))
        return int(self._changes[place]) if place < len(self._changes) else NEVER

    def acts(self, step: int) -> bool:
        """Whether the drive acts during the step after ``step``."""
        return step - self.begin < len(self._rows) - 1

    def act(self, step: int, live: LiveWorld) -> None:
        """Set the force or gravity that acts during the step after ``step``."""
        row = self._rows[min(step - self.begin, len(self._rows) - 1)]
        forces = None if self._film is None else self._film.forces(*live.from_carrier())
        if forces is not None:
            live.set_box_forces(forces)
        if self.holds_carrier:
            live.set_gravity(self._gravity - row)
        else:
            live.set_carrier_force(row if forces is None else row - forces.sum(axis=0))
