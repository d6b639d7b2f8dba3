"""The rules for quiet, rest and explosions in one world on C MuJoCo (docs/rules.md, sections 5 and 7).

Twin: ``Rules`` in petmjx/engines/mjx/rules.py.
"""

from __future__ import annotations

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco import box_motion
from petmjx.engines.mujoco.jitter import Jitter
from petmjx.engines.mujoco.timetable import NEVER
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene


class QuietRule:
    """Decides at each look whether the pallet is quiet. The numbers are in ``petmjx.options.simulation.Quiet``.

    The caller looks every ``poll_steps`` steps.
    """

    def __init__(self, sim: Simulation, scene: Scene) -> None:
        self._sim, self._rule = sim, sim.quiet
        self._waits_for_creep = sim.waits_for_rest
        self._steps = 0
        self.trembling = Jitter()
        self._first: FloatArray = np.zeros(0)
        self.extend(scene)

    def extend(self, scene: Scene) -> None:
        """Adopt the world's scene after boxes were added."""
        self._radius_m = np.linalg.norm(scene.half_size, axis=1)

    def restart(self) -> None:
        """Start the count of quiet steps again, for another wait."""
        self._steps = 0

    @property
    def holds(self) -> bool:
        """Whether the last look found the pallet quiet."""
        return self._steps >= self._rule.steps

    def look(self, pose: FloatArray, velocity: FloatArray, has_failed: bool, adapts: bool = True) -> bool:
        """Take one look. Returns whether the pallet is quiet, apart from boxes that tremble.

        Args:
            pose: (k, 7) poses of the placed boxes, in m and as unit quaternions.
            velocity: (k, 6) velocities, linear in m/s and angular in rad/s.
            has_failed: whether a box has dropped or tilted too far. If so, the rule does not wait for creep.
            adapts: whether the wait ends as soon as the pallet is quiet. If so, trembling boxes are searched for.
        """
        rule, radius = self._rule, self._radius_m[: len(velocity)]
        speed = box_motion.speed(velocity, radius)
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
            self._steps = 0  # the wait is over, although the pallet is not quiet
        return True

    def is_slow(self, velocity: FloatArray, boxes: slice) -> bool:
        """Whether these boxes are as slow as the boxes of a quiet pallet."""
        return bool((box_motion.speed(velocity, self._radius_m[boxes]) < self._rule.quiet_m_s).all())

    def motion(self, before: FloatArray, after: FloatArray, velocity: FloatArray, seconds: float) -> tuple[bool, bool]:
        """Two answers: whether any point of a box moved, or moves now, faster than ``still_m_s``; and whether the world
        has to wait because of such boxes. The world does not wait for trembling boxes slower than ``slow_m_s``.

        Args:
            before, after: (k, 7) poses, ``seconds`` apart. A rocking box that reversed between these poses has hardly
                moved on average.
            velocity: (k, 6) current velocities.
        """
        rule, radius = self._rule, self._radius_m[: len(after)]
        moved = box_motion.moved(before, after, radius)
        trembles = self.trembling.which(len(after))
        turns = self._waits_for_creep & ~trembles & (box_motion.speed(velocity, radius) > rule.still_m_s)
        most = np.where(trembles, rule.slow_m_s, rule.still_m_s)
        return bool((turns | (moved > rule.still_m_s * seconds)).any()), bool((turns | (moved > most * seconds)).any())


class Explosion:
    """Finds simulations that cannot be right: accelerations are large for some time, and no failed box causes them.

    When light boxes land, or tipping boxes hit something, accelerations reach 240 rad/s² for a few steps. A single such
    sample is not an explosion. So samples right after a placement do not count. After one violent sample, the following
    samples must be violent, too, over at least the number of steps that a box needs to land.

    Args:
        landing: number of steps that a box needs to land.
    """

    def __init__(self, landing: int) -> None:
        self._landing, self._fast_since = landing, NEVER

    def seen(self, step: int, placed_at: int, too_fast: bool) -> bool:
        """Whether the world explodes, judged after the sample of a step.

        Args:
            placed_at: the step after which the last box was placed; the current step while a box is carried.
            too_fast: whether an acceleration is above its threshold although no sign of failure has been seen.
        """
        if step - placed_at < self._landing:
            return False
        self._fast_since = min(self._fast_since, step) if too_fast else NEVER
        return too_fast and step - self._fast_since >= self._landing
