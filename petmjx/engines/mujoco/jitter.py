"""Finds trembling boxes on C MuJoCo (docs/rules.md, section 5). petmjx/engines/mjx/jitter.py does the same in JAX."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco import box_motion
from petmjx.options.simulation import Simulation


def _no_boxes() -> NDArray[np.bool_]:
    return np.zeros(0, bool)


@dataclass(frozen=True)
class Jitter:
    """The state of the search for trembling boxes after a *look* (a check whether the pallet is quiet). Each look makes
    a new ``Jitter``.

    Attributes:
        boxes: (n,) whether each box trembles. n is the number of placed boxes at the looks since the last placement.
        looks: number of looks with this number of boxes.
        home: (n, 7) poses of the boxes at the beginning of the measured period.
        path_m: (n,) length of each box's path since the first look of the period, m.
        away_m: (n,) largest distance of each box from ``home`` in the period, m.
    """

    boxes: NDArray[np.bool_] = field(default_factory=_no_boxes)
    looks: int = 0
    home: FloatArray | None = None
    path_m: FloatArray | float = 0.0
    away_m: FloatArray | float = 0.0

    def which(self, n: int) -> NDArray[np.bool_]:
        """(n,) whether each of the n placed boxes trembles. Shortly after a placement, no box counts as trembling,
        since the boxes have been checked too few times.
        """
        return self.boxes if len(self.boxes) == n else np.zeros(n, bool)

    def after_look(self, sim: Simulation, pose: FloatArray, speed_m_s: FloatArray, radius_m: FloatArray) -> Self:
        """The state after another look at the boxes during a wait.

        Args:
            pose: (n, 7) positions (m) and quaternions of the boxes.
            speed_m_s: (n,) speed of each box's fastest point, m/s.
            radius_m: (n,) half diagonals of the boxes, m.
        """
        rule = sim.quiet
        period, look_s = rule.tremble_looks, rule.poll_steps * sim.physics.timestep_s
        if len(pose) != len(self.boxes):
            return replace(self, boxes=np.zeros(len(pose), bool), looks=1, home=None)
        boxes, home, path, away = self.boxes, self.home, self.path_m, self.away_m
        if home is not None:
            path, away = path + speed_m_s * look_s, np.maximum(away, box_motion.moved(home, pose, radius_m))
        if self.looks % period == 0:
            if home is not None:
                least = rule.slow_m_s * period * look_s
                boxes = (path >= least) & (away < np.minimum(rule.tremble_share * path, least))
            home, path, away = pose.copy(), 0.0, 0.0
        return replace(self, boxes=boxes, looks=self.looks + 1, home=home, path_m=path, away_m=away)
