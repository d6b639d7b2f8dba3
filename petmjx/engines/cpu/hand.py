"""The hand that carries a box to its place, in a world on C MuJoCo (docs/rules.md, section 4).

Twins: ``petmjx/engines/warp/kernel/hand.py``, ``petmjx/engines/batch/hand.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from petmjx.units import FloatArray
from petmjx.world.placing import progress, rate_1_s, stuck_steps
from petmjx.world.scene import Scene
from petmjx.world.turned import turned


@dataclass(eq=False)
class Hand:
    """One box on its way.

    Attributes:
        begin, end: (3,) origins of its frame at the way's ends, m.
        quat: (4,) how it is held.
        steps: of the way; ``taken``: steps since it began.
    """

    scene: Scene
    box: int
    begin: FloatArray
    end: FloatArray
    quat: FloatArray
    steps: int
    gravity_m_s2: float
    timestep_s: float
    taken: int = 0

    @property
    def has_arrived(self) -> bool:
        """Whether the point that it follows is at the place."""
        return self.taken >= self.steps

    @property
    def gives_up(self) -> bool:
        """Whether it has waited long enough for the box to come to rest."""
        return self.taken >= self.steps + stuck_steps(self.timestep_s)

    def wrench(self, pose: FloatArray, velocity: FloatArray) -> FloatArray:
        """(6,) force, N, and moment, N·m, in world axes, that act during the step to come.

        The spring and the damper are between the box and the point that it should follow. To them comes the force that
        moves a free box along with that point to the last digit; together they are limited, and so is the moment. The
        weight comes on top.

        Args:
            pose: (7,) of its frame, m and quaternion.
            velocity: (6,) of its frame, m/s, and in the box's axes rad/s.
        """
        mass, half_size = float(self.scene.mass[self.box]), self.scene.half_size[self.box]
        most_n, rate = self.scene.placing.force_n, rate_1_s(self.timestep_s)
        before, now, next_ = (progress(self.taken + k, self.steps) for k in (-1, 0, 1))
        way = self.end - self.begin
        ahead = self.begin + now * way - pose[:3]
        lag = (now - before) / self.timestep_s * way - velocity[:3]
        along = (next_ - 2.0 * now + before) / self.timestep_s**2 * way
        force = _limited(mass * (along + rate**2 * ahead + 2.0 * rate * lag), most_n)
        force[2] += mass * self.gravity_m_s2
        squares = self.scene.inertia_boxes[self.box + 1] ** 2
        inertia = mass / 3.0 * (squares.sum() - squares)
        askew = _rotation_vector(pose[3:], self.quat)
        moment = inertia * (rate**2 * askew - 2.0 * rate * velocity[3:])
        moment = _limited(moment, most_n * float(half_size.max()))
        return np.concatenate((force, turned(pose[3:], moment)))


def _limited(vector: FloatArray, most: float) -> FloatArray:
    """A vector, or one of the same direction that is not longer than this."""
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)


def _rotation_vector(quat: FloatArray, wanted: FloatArray) -> FloatArray:
    """(3,) rotation from one orientation to another, in the axes of the first, rad; for small angles."""
    w, u = quat[0], quat[1:]
    real = w * wanted[0] + u @ wanted[1:]
    imaginary = w * wanted[1:] - wanted[0] * u - np.cross(u, wanted[1:])
    return np.asarray(2.0 * (imaginary if real >= 0 else -imaginary))
