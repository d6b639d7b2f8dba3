"""The rules for quiet and for rest (docs/rules.md, section 5), for one world of the C engine. Twin: ``Rules``."""

from __future__ import annotations

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.engines.cpu.trembling import Trembling
from petmjx.metrics import motion_np
from petmjx.options.config import Simulation
from petmjx.world.scene import Scene


class QuietRule:
    """Counts the looks at a pallet and says whether it is quiet. Its numbers: ``petmjx.options.config.Quiet``.

    The caller looks every ``poll_steps``.
    """

    def __init__(self, sim: Simulation, scene: Scene) -> None:
        self._sim, self._rule = sim, sim.quiet
        self._waits_for_creep = sim.waits_for_rest
        self._steps = 0
        self.trembling = Trembling()
        self._first: FloatArray = np.zeros(0)
        self.extend(scene)

    def extend(self, scene: Scene) -> None:
        """The world's scene has more boxes."""
        self._radius_m = np.linalg.norm(scene.half_size, axis=1)

    def restart(self) -> None:
        """Another wait begins: the count starts again."""
        self._steps = 0

    @property
    def holds(self) -> bool:
        """Whether the last look found the pallet quiet."""
        return self._steps >= self._rule.steps

    def look(self, pose: FloatArray, velocity: FloatArray, has_failed: bool, adapts: bool = True) -> bool:
        """One look; whether it finds the pallet quiet, but for boxes that tremble.

        Args:
            pose: (k, 7) of the placed boxes, in m and unit quaternions.
            velocity: (k, 6), linear in m/s and angular in rad/s.
            has_failed: whether a box has dropped or tilted too far; then creep is not waited for.
            adapts: whether the wait depends on what is seen: then it is looked which boxes tremble.
        """
        rule, radius = self._rule, self._radius_m[: len(velocity)]
        speed = motion_np.speed(velocity, radius)
        if self._waits_for_creep and adapts:
            self.trembling = self.trembling.after_look(self._sim, pose, speed, radius)
        trembles = self.trembling.which(len(speed))
        speed = np.where(trembles, 0.0, speed)
        if not (speed < rule.quiet_m_s).all():
            self._steps = 0
            return False
        if self._steps == 0:
            self._first = speed
        self._steps += rule.poll_steps
        if self._steps < rule.steps:
            return False
        if self._waits_for_creep and not has_failed:
            creeps = (speed >= np.maximum(rule.slow_m_s, rule.slowing * self._first)).any()
            faster = (speed > np.maximum(rule.still_m_s, self._first)).any()
            if creeps or faster:
                self._steps, self._first = rule.poll_steps, speed
                return False
        if trembles.any():
            self._steps = 0  # the wait is over, but the pallet is not quiet
        return True

    def is_slow(self, velocity: FloatArray, boxes: slice) -> bool:
        """Whether these boxes are slower than a quiet pallet's."""
        return bool((motion_np.speed(velocity, self._radius_m[boxes]) < self._rule.quiet_m_s).all())

    def motion(self, before: FloatArray, after: FloatArray, velocity: FloatArray, seconds: float) -> tuple[bool, bool]:
        """Whether a point of a box moved faster than ``still_m_s``, or does now, and whether a world with such boxes
        has to wait: not if they tremble, up to ``slow_m_s``.

        Args:
            before, after: (k, 7) poses, so many ``seconds`` apart: on the average a box that rocks has not moved while
                it turns round.
            velocity: (k, 6) now.
        """
        rule, radius = self._rule, self._radius_m[: len(after)]
        moved = motion_np.moved(before, after, radius)
        trembles = self.trembling.which(len(after))
        turns = self._waits_for_creep & ~trembles & (motion_np.speed(velocity, radius) > rule.still_m_s)
        most = np.where(trembles, rule.slow_m_s, rule.still_m_s)
        return bool((turns | (moved > rule.still_m_s * seconds)).any()), bool((turns | (moved > most * seconds)).any())
