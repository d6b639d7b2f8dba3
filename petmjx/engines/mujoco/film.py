"""Stretch film around a pallet on C MuJoCo. The law of the film is in petmjx/world/film.py.

Other engines have the law in ``petmjx/engines/warp/kernels/film.py`` and ``petmjx/engines/mjx/film.py``.
"""

from __future__ import annotations

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.world.film import SLACK_M, film_of, spring_rate_1_s
from petmjx.world.scene import Scene


class ActingFilm:
    """Stretch film that holds boxes at the places that they had when the film was wound around them.

    Args:
        pos: (n, 3) the boxes' centres of mass when the film is wound around them, relative to the carrier's centre of
            mass, m.
    """

    def __init__(self, scene: Scene, timestep_s: float, pos: FloatArray) -> None:
        self._film, self._mass = film_of(scene), scene.mass[:, None]
        self._rate_1_s = spring_rate_1_s(timestep_s)
        self._home, self._anchor = pos.copy(), pos.copy()

    def forces(self, pos: FloatArray, vel: FloatArray) -> FloatArray:
        """(n, 3) forces of the film on the boxes during the next step, N. If the film slips on a box, the point of the
        film that holds the box (its anchor) moves with the box.

        Args:
            pos, vel: (n, 3) positions (m) and velocities (m/s) of the boxes' centres of mass, relative to the carrier's
                centre of mass.
        """
        rate, hold = self._rate_1_s, self._film.hold[:, None]
        spring = self._mass * rate**2 * (self._anchor - pos)
        slips = np.linalg.norm(spring, axis=1, keepdims=True)
        spring = np.where(slips > hold, spring * (hold / np.maximum(slips, 1e-30)), spring)
        self._anchor = pos + spring / (self._mass * rate**2)
        force = spring - 2.0 * rate * self._mass * vel
        length = np.linalg.norm(force, axis=1, keepdims=True)
        press = self._film.press.copy()
        drawn_in = np.sign(press[:, :2]) * (pos - self._home)[:, :2]
        press[:, :2] *= np.clip(1.0 - drawn_in / SLACK_M, 0.0, 1.0)
        return np.asarray(np.where(length > hold, force * (hold / np.maximum(length, 1e-30)), force) + press)
