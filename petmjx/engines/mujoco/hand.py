"""The hand (a limited force and moment) that carries a box to its place on C MuJoCo (docs/rules.md, section 4).

Other engines have the hand in ``petmjx/engines/warp/kernels/hand.py`` and ``petmjx/engines/mjx/hand.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.timetable import NEVER
from petmjx.world.approach_paths import progress
from petmjx.world.hand import AT_PLACE_M, LOWERING_STEPS, MISSED_M, lowering_rate_1_s, rate_1_s, stuck_steps
from petmjx.world.rotation import rotated_vectors
from petmjx.world.scene import Scene


@dataclass(eq=False)
class Hand:
    """The hand that carries one box along a straight path.

    Attributes:
        begin, end: (3,) positions of the box's frame at the two ends of the path, m.
        quat: (4,) quaternion of the orientation in which the hand holds the box.
        steps: number of steps of the path.
        falls: whether the hand releases the box at the end of the path, so that the box falls from there.
        taken: number of steps since the path began.
        lowered_from: value of ``taken`` at which the hand begins to set the box down.
        short_m: distance of the box from the end of the path after the last step, m.
    """

    scene: Scene
    box: int
    begin: FloatArray
    end: FloatArray
    quat: FloatArray
    steps: int
    falls: bool
    gravity_m_s2: float
    timestep_s: float
    taken: int = 0
    lowered_from: int = NEVER
    short_m: float = 0.0

    @property
    def missed(self) -> bool:
        """Whether the box is released too far from its place to count as placed."""
        return self.short_m > MISSED_M

    def has_let_go(self, pose: FloatArray, slow: bool) -> bool:
        """Whether the hand releases the box after this step. The hand waits until the box has arrived and is at rest.
        Unless the box is meant to fall, the hand then sets the box down, and only then releases it.

        Args:
            pose: (7,) position (m) and quaternion of the box's frame.
            slow: whether the box is as slow as the boxes of a quiet pallet.
        """
        self.taken += 1
        self.short_m = float(np.linalg.norm(self.end - pose[:3]))
        patience = stuck_steps(self.timestep_s)
        if self.lowered_from != NEVER:
            since = self.taken - self.lowered_from
            return since >= patience or (slow and since >= LOWERING_STEPS)
        if self.taken < self.steps + (0 if slow else patience):
            return False
        if self.falls and self.short_m <= AT_PLACE_M:
            return True
        self.lowered_from = self.taken
        return False

    def wrench(self, pose: FloatArray, velocity: FloatArray) -> FloatArray:
        """(6,) force (N) and moment (N·m) of the hand on the box during the next step, in world axes (docs/rules.md,
        section 4).

        Args:
            pose: (7,) position (m) and quaternion of the box's frame.
            velocity: (6,) velocity of this frame, m/s, followed by the angular velocity in the box's axes, rad/s.
        """
        mass, half_size = float(self.scene.mass[self.box]), self.scene.half_size[self.box]
        most_n, weight_n = self.scene.placing.force_n, mass * self.gravity_m_s2
        squares = self.scene.inertia_boxes[self.box + 1] ** 2
        inertia = mass / 3.0 * (squares.sum() - squares)
        if self.lowered_from != NEVER:
            damping = lowering_rate_1_s(self.timestep_s)
            force = _limited(-mass * damping * velocity[:3], most_n + weight_n)
            moment = -damping * inertia * velocity[3:]
        else:
            rate = rate_1_s(self.timestep_s)
            before, now, next_ = (progress(self.taken + k, self.steps) for k in (-1, 0, 1))
            way = self.end - self.begin
            ahead = self.begin + now * way - pose[:3]
            lag = (now - before) / self.timestep_s * way - velocity[:3]
            along = (next_ - 2.0 * now + before) / self.timestep_s**2 * way
            force = _limited(mass * (along + rate**2 * ahead + 2.0 * rate * lag), most_n)
            force[2] += weight_n
            moment = inertia * (rate**2 * _rotation_vector(pose[3:], self.quat) - 2.0 * rate * velocity[3:])
        moment = _limited(moment, most_n * float(half_size.max()))
        return np.concatenate((force, rotated_vectors(pose[3:], moment)))


def _limited(vector: FloatArray, most: float) -> FloatArray:
    """The vector, shortened to the length ``most`` if it is longer."""
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)


def _rotation_vector(quat: FloatArray, target_quat: FloatArray) -> FloatArray:
    """(3,) rotation vector from ``quat`` to ``target_quat``, in the axes of ``quat``, rad. The result is exact only for
    small angles.
    """
    w, u = quat[0], quat[1:]
    real = w * target_quat[0] + u @ target_quat[1:]
    imaginary = w * target_quat[1:] - target_quat[0] * u - np.cross(u, target_quat[1:])
    return np.asarray(2.0 * (imaginary if real >= 0 else -imaginary))
