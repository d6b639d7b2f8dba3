"""Boxes that are released with any pose and velocity, without the rules by which plans are placed.

For ``petmjx.release``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.carriers import extent_m
from petmjx.options.physics import Physics
from petmjx.options.simulation import Simulation
from petmjx.world.body_shapes import Body
from petmjx.world.carrier_boards import body_of, floor_z_m, pallet, with_walls
from petmjx.world.scene import Scene

_BURIED_M: Final = -100.0
"""Height of the carrier's centre if the ground is a plane, m. Every scene needs a carrier. In scenes whose ground is a
plane, the carrier is buried so deep that no box gets near it. The buried carrier is held in place, so that the floor
does not push it out."""

_BURIED_HALF_M: Final = 0.1


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground on which boxes fall. The ground's top is at z = 0, and the ground does not move.

    Attributes:
        carrier: the carrier of each scene.
        floor_z: height of the floor, m.
        friction: sliding, torsional and rolling coefficients of the floor.
        is_plane: whether the ground is a plane, so that boxes touch only the floor.
    """

    carrier: Body
    floor_z: float
    friction: tuple[float, float, float]
    is_plane: bool

    @classmethod
    def plane(cls, physics: Physics) -> Ground:
        """An infinite plane with the friction of carriers."""
        place, half = np.array([0.0, 0.0, _BURIED_M]), np.full(3, _BURIED_HALF_M)
        buried = Body.solid(place, half, physics.carrier_mass_kg, physics.carrier_friction)
        return cls(buried, 0.0, physics.carrier_friction, is_plane=True)

    @classmethod
    def of_carrier(cls, sim: Simulation) -> Ground:
        """The carrier that ``sim`` chooses, with its front-left corner at the origin, as in plans.

        Raises:
            ValueError: the carrier's length and width depend on the plan.
        """
        physics, boards, extent = sim.physics, pallet(sim.carrier), extent_m(sim.carrier)
        if extent is None:
            raise ValueError("the carrier's extent depends on the plan")
        if boards is not None:
            body = body_of(boards, physics)
        else:
            half = np.array([extent[0] / 2, extent[1] / 2, physics.carrier_half_height_m])
            body = Body.solid(half * (1, 1, -1), half, physics.carrier_mass_kg, physics.carrier_friction)
        return cls(with_walls(body, sim), floor_z_m(sim), physics.floor_friction, is_plane=False)

    @property
    def smooth(self) -> Ground:
        """The ground with a sliding friction of 0. A contact uses the larger coefficient of the two bodies, so contacts
        with this ground have the friction of the box."""
        friction = self.carrier.friction.copy()
        friction[:, 0] = 0.0
        return replace(
            self, carrier=replace(self.carrier, friction=friction), friction=(0.0, self.friction[1], self.friction[2])
        )


@dataclass(frozen=True, eq=False)
class FreeBodies:
    """Worlds in which equal numbers of boxes are released, and the steps after which the poses are recorded.

    Attributes:
        scenes: n scenes. Boxes are released at ``start_pos`` with orientation ``start_quat``. Carriers do not move.
        velocity: (n, k, 6) velocities of the boxes at release: 3 components along the world's axes, m/s, then 3 about
            the boxes' own axes, rad/s.
        steps: (s,) numbers of steps after which the poses are recorded, rising. The number 0 stands for the poses at
            release.
        on_plane: whether boxes touch only the floor, so that engines may ignore the carrier.
    """

    scenes: tuple[Scene, ...]
    velocity: FloatArray
    steps: NDArray[np.int32]
    on_plane: bool

    @property
    def n_boxes(self) -> int:
        """Number of boxes per world."""
        return int(self.velocity.shape[1])

    def part(self, worlds: slice) -> FreeBodies:
        """A copy of this object with only the given worlds."""
        return replace(self, scenes=self.scenes[worlds], velocity=self.velocity[worlds])

    @property
    def pose(self) -> FloatArray:
        """(n, k, 7) positions, m, and orientations as quaternions (w, x, y, z) of the boxes at release."""
        return np.array([np.hstack([scene.start_pos, scene.start_quat]) for scene in self.scenes])


def inertia_box(inertia: FloatArray, mass: FloatArray) -> FloatArray:
    """(…, 3) half extents of solid boxes with these (…, 3) principal moments, kg·m², and (…) masses, kg.

    A box with half extents a, b, c has I_x = m/3 · (b² + c²), and likewise for y and z. So a² = 3/(2m) · (I_y + I_z −
    I_x). The result is NaN if the largest moment exceeds the sum of the other two, which no body can have.
    """
    total = inertia.sum(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        half: FloatArray = np.sqrt(1.5 * (total - 2 * inertia) / mass[..., None])
    return half
