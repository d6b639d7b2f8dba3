"""Boxes released with any pose and velocity, in worlds without rules, for ``petmjx.release``."""

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
"""Height of the carrier's centre, m, if the ground is a plane. Every scene has a carrier; it is buried so deep that no
box comes near. The carrier is held there, so that the floor does not push it out."""

_BURIED_HALF_M: Final = 0.1


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground on which boxes fall. The top of the ground is at z = 0, and it does not move.

    Attributes:
        carrier: carrier of each scene.
        floor_z: height of the floor, m.
        friction: the floor's sliding, torsional and rolling coefficients.
        is_plane: True: boxes touch the floor alone.
    """

    carrier: Body
    floor_z: float
    friction: tuple[float, float, float]
    is_plane: bool

    @classmethod
    def plane(cls, physics: Physics) -> Ground:
        """An infinite plane, with the friction of carriers."""
        place, half = np.array([0.0, 0.0, _BURIED_M]), np.full(3, _BURIED_HALF_M)
        buried = Body.solid(place, half, physics.carrier_mass_kg, physics.carrier_friction)
        return cls(buried, 0.0, physics.carrier_friction, is_plane=True)

    @classmethod
    def of_carrier(cls, sim: Simulation) -> Ground:
        """The carrier of these options, its front-left corner at the origin, as in plans.

        Raises:
            ValueError: its extent depends on the plan.
        """
        physics, boards, extent = sim.physics, pallet(sim.carrier), extent_m(sim.carrier)
        if extent is None:
            raise ValueError("its extent depends on the plan")
        if boards is not None:
            body = body_of(boards, physics)
        else:
            half = np.array([extent[0] / 2, extent[1] / 2, physics.carrier_half_height_m])
            body = Body.solid(half * (1, 1, -1), half, physics.carrier_mass_kg, physics.carrier_friction)
        return cls(with_walls(body, sim), floor_z_m(sim), physics.floor_friction, is_plane=False)

    @property
    def smooth(self) -> Ground:
        """The ground with a sliding friction of 0. The larger of two coefficients counts, so the coefficient of the
        boxes does."""
        friction = self.carrier.friction.copy()
        friction[:, 0] = 0.0
        return replace(
            self, carrier=replace(self.carrier, friction=friction), friction=(0.0, self.friction[1], self.friction[2])
        )


@dataclass(frozen=True, eq=False)
class FreeBodies:
    """Worlds with equal numbers of boxes, and the steps after which poses are recorded.

    Attributes:
        scenes: n worlds. Boxes are released at ``start_pos``, turned by ``start_quat``; the carriers are held.
        velocity: (n, k, 6) velocities at release: m/s along the world's axes, and rad/s about the boxes' own.
        steps: (s,) rising numbers of steps after which poses are recorded; 0: at release.
        on_plane: True: boxes touch the floor alone, so that engines may ignore the carrier.
    """

    scenes: tuple[Scene, ...]
    velocity: FloatArray
    steps: NDArray[np.int32]
    on_plane: bool

    @property
    def n_boxes(self) -> int:
        """Number of boxes of each world."""
        return int(self.velocity.shape[1])

    def part(self, worlds: slice) -> FreeBodies:
        """Some of the worlds."""
        return replace(self, scenes=self.scenes[worlds], velocity=self.velocity[worlds])

    @property
    def pose(self) -> FloatArray:
        """(n, k, 7) positions of release, m, and quaternions (w, x, y, z)."""
        return np.array([np.hstack([scene.start_pos, scene.start_quat]) for scene in self.scenes])


def inertia_box(inertia: FloatArray, mass: FloatArray) -> FloatArray:
    """(…, 3) half extents of solid boxes with these (…, 3) principal moments, kg·m², and (…) masses, kg.

    A box of half extents a, b, c has I_x = m/3 · (b² + c²), and likewise for y and z, so a² = 3/(2m) · (I_y + I_z −
    I_x). NaN if no body has these moments: the largest may not exceed the sum of the other two.
    """
    total = inertia.sum(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        half: FloatArray = np.sqrt(1.5 * (total - 2 * inertia) / mass[..., None])
    return half
