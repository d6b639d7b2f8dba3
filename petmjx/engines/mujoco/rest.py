"""The rules that detect quiet and rest in a world on C MuJoCo (docs/rules.md, section 5).

The class ``Rules`` in petmjx/engines/mjx/rules.py has the same rules in JAX.
"""

from __future__ import annotations

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco import box_motion
from petmjx.engines.mujoco.trembling import Trembling
from petmjx.options.simulation import Simulation
from petmjx.world.scene import Scene


class QuietRule:
    """Decides whether the pallet is quiet, that is, whether all boxes are slow. ``petmjx.options.quiet.Quiet``
    defines the limits.

    The caller must call ``look`` every ``poll_steps`` steps.
    """

    def __init__(self, sim: Simulation, scene: Scene) -> None:
        self._sim, self._rule = sim, sim.quiet
        self._waits_for_creep = sim.waits_for_rest
        self._steps = 0
        self.trembling = Trembling()
        self._first: FloatArray = np.zeros(0)
        self.extend(scene)

    def extend(self, scene: Scene) -> None:
        """Use a scene with additional boxes from now on."""
        self._radius_m = np.linalg.norm(scene.half_size, axis=1)

    def restart(self) -> None:
        """Set the number of quiet steps to 0, for another wait."""
        self._steps = 0

    @property
    def holds(self) -> bool:
        """Whether the pallet was quiet at the last check (``look``)."""
        return self._steps >= self._rule.steps

    def look(self, pose: FloatArray, velocity: FloatArray, has_failed: bool, adapts: bool = True) -> bool:
        """Check once whether the boxes are slow. Returns whether the pallet is quiet, not counting trembling boxes.

        Args:
            pose: (k, 7) positions (m) and unit quaternions of the placed boxes.
            velocity: (k, 6) velocities (m/s), followed by angular velocities (rad/s).
            has_failed: whether a box has dropped or tilted too far. If ``has_failed`` is True, the rule does not wait
                for creeping boxes.
            adapts: whether the wait ends as soon as the pallet is quiet. If ``adapts`` is True, the rule also looks for
                trembling boxes.
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
            creeps = speed >= np.maximum(rule.slow_m_s, rule.slowing * self._first)
            faster = speed > np.maximum(rule.still_m_s, self._first)
            if ((creeps | faster) & ~self.trembling.staying(np.zeros(len(speed)), self._sim)).any():
                self._steps, self._first = rule.poll_steps, speed
                return False
        if trembles.any():
            self._steps = 0  # the wait ends, but the pallet does not count as quiet
        return True

    def is_slow(self, velocity: FloatArray, boxes: slice) -> bool:
        """Whether these boxes are as slow as the boxes of a quiet pallet."""
        return bool((box_motion.speed(velocity, self._radius_m[boxes]) < self._rule.quiet_m_s).all())

    def motion(self, before: FloatArray, after: FloatArray, velocity: FloatArray, seconds: float) -> tuple[bool, bool]:
        """Two answers about the boxes at the end of a world. First, whether any point of a box moved, or moves now,
        faster than ``still_m_s``. Second, whether the world must wait longer for this reason. The world waits neither
        for trembling boxes that are slower than ``slow_m_s``, nor for boxes that stay near their places.

        Args:
            before, after: (k, 7) poses at two times that are ``seconds`` apart. The average speed of a rocking box that
                turned back between these times is small, so ``velocity`` is used, too.
            velocity: (k, 6) current velocities, m/s and rad/s.
        """
        rule, radius = self._rule, self._radius_m[: len(after)]
        moved = box_motion.moved(before, after, radius)
        trembles, stays = self.trembling.which(len(after)), self.trembling.staying(moved, self._sim)
        turns = self._waits_for_creep & ~trembles & ~stays & (box_motion.speed(velocity, radius) > rule.still_m_s)
        most = np.where(trembles, rule.slow_m_s, rule.still_m_s)
        waits = turns | (~stays & (moved > most * seconds))
        return bool((turns | (moved > rule.still_m_s * seconds)).any()), bool(waits.any())
