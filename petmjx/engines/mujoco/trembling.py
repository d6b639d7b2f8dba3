"""Finds boxes that tremble or stay on C MuJoCo (docs/rules.md, section 5). petmjx/engines/mjx/trembling.py does the
same in JAX."""

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


def _most_away_m(sim: Simulation, path_m: FloatArray | float) -> FloatArray:
    """(n,) limit of how far each box may be from its pose at the beginning of a period of measurement, m. Only a box
    that was nearer than its limit during the whole period can count as trembling or staying. ``path_m``: length of each
    box's path in the period, m."""
    rule = sim.quiet
    still_m = rule.still_m_s * rule.tremble_looks * rule.poll_steps * sim.physics.timestep_s
    return np.asarray(rule.tremble_share * np.maximum(path_m, still_m))


@dataclass(frozen=True)
class Trembling:
    """The state of the search for boxes that tremble or stay. Each *look* (a check whether the pallet is quiet) makes a
    new ``Trembling``.

    Attributes:
        boxes: (n,) whether each box trembles. n is the number of placed boxes at the looks since the last placement.
        stayed: (n,) for the last complete period of measurement, whether each box always was near the place that it had
            when the period began.
        looks: number of looks since the last placement.
        home: (n, 7) poses of the boxes at the beginning of the present period of measurement.
        path_m: (n,) length of each box's path since the first look of the present period, m.
        away_m: (n,) largest distance of each box from ``home`` in the present period, m.
    """

    boxes: NDArray[np.bool_] = field(default_factory=_no_boxes)
    stayed: NDArray[np.bool_] = field(default_factory=_no_boxes)
    looks: int = 0
    home: FloatArray | None = None
    path_m: FloatArray | float = 0.0
    away_m: FloatArray | float = 0.0

    def which(self, n: int) -> NDArray[np.bool_]:
        """(n,) whether each of the n placed boxes trembles. Shortly after a placement, no box counts as trembling,
        since the boxes have been checked too few times.
        """
        return self.boxes if len(self.boxes) == n else np.zeros(n, bool)

    def staying(self, moved_m: FloatArray, sim: Simulation) -> NDArray[np.bool_]:
        """(n,) whether each of the n placed boxes stays. A box stays if two conditions hold: in the last complete
        period of measurement, the box always was near the place that it had when the period began (``stayed``); and the
        same is true of the present period so far. As with ``which``, no box counts as staying shortly after a
        placement.

        Args:
            moved_m: (n,) distances by which the boxes moved in the last ``still_steps`` steps, m, if the world is at
                its end; zeros if the caller only checks whether the pallet is quiet (a look). The larger of this
                distance and ``away_m`` counts.
        """
        if len(self.boxes) != len(moved_m):
            return np.zeros(len(moved_m), bool)
        return np.asarray(self.stayed & (np.maximum(self.away_m, moved_m) < _most_away_m(sim, self.path_m)))

    def after_look(self, sim: Simulation, pose: FloatArray, speed_m_s: FloatArray, radius_m: FloatArray) -> Self:
        """The state after one more check of the boxes during a wait.

        Args:
            pose: (n, 7) positions (m) and quaternions of the boxes.
            speed_m_s: (n,) speed of each box's fastest point, m/s.
            radius_m: (n,) half diagonals of the boxes, m.
        """
        rule = sim.quiet
        period, look_s = rule.tremble_looks, rule.poll_steps * sim.physics.timestep_s
        if len(pose) != len(self.boxes):
            nothing = np.zeros(len(pose), bool)
            return replace(self, boxes=nothing, stayed=nothing, looks=1, home=None, path_m=0.0, away_m=0.0)
        boxes, stayed, home, path, away = self.boxes, self.stayed, self.home, self.path_m, self.away_m
        if home is not None:
            path, away = path + speed_m_s * look_s, np.maximum(away, box_motion.moved(home, pose, radius_m))
        if self.looks % period == 0:
            if home is not None:
                least = rule.slow_m_s * period * look_s
                stayed = away < np.minimum(_most_away_m(sim, path), least)
                boxes = stayed & (path >= least)
            home, path, away = pose.copy(), 0.0, 0.0
        return replace(self, boxes=boxes, stayed=stayed, looks=self.looks + 1, home=home, path_m=path, away_m=away)
