"""Bodies of a scene and their shapes. A shape is a solid box that is fixed to its body.

The origin of a body's frame is the centre of mass. Its axes are those of the shapes, which are taken for the principal
axes. So the inertia matrix of any number of bodies is diagonal, and MuJoCo's qpos and qvel are those of the centre of
mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.physics import Triple
from petmjx.world.rotation import rotations


@dataclass(frozen=True, eq=False)
class Body:
    """A body of one or more boxes, such as the carrier with its boards.

    Attributes:
        pos: (3,) centre of mass, m.
        mass: kg.
        half_size: (s, 3) half extents of its shapes, m.
        shape_pos: (s, 3) their centres in the body's frame, m.
        friction: (s, 3) their sliding, torsional and rolling coefficients.
        inertia_box: (3,) half extents of the solid box that has the body's mass and moments of inertia, m: MuJoCo's
            equivalent inertia box.
        surface: (s,) numbers of their surfaces (petmjx/world/friction_pairs.py); None: all 0.
    """

    pos: FloatArray
    mass: float
    half_size: FloatArray
    shape_pos: FloatArray
    friction: FloatArray
    inertia_box: FloatArray
    surface: NDArray[np.intp] | None = None

    @classmethod
    def solid(cls, pos: FloatArray, half_size: FloatArray, mass: float, friction: Triple) -> Body:
        """One solid box."""
        return cls(pos, mass, half_size[None], np.zeros((1, 3)), np.array([friction]), half_size)

    @classmethod
    def of_boards(cls, center: FloatArray, half_size: FloatArray, mass: FloatArray, friction: FloatArray) -> Body:
        """Boards that are solid boxes.

        Their axes are taken for the principal axes of the body. Products of inertia of boards that do not balance are
        left out: a few per cent of the moments for a pallet without one of its outer deck boards. They would matter
        only if the carrier turned, and it stands on the floor.

        Args:
            center: (s, 3) of each board, m.
            half_size: (s, 3) m.
            mass: (s,) kg.
            friction: (s, 3).
        """
        pos = mass @ center / mass.sum()
        place = center - pos
        second = np.einsum("s,si,si->i", mass, place, place) + mass @ half_size**2 / 3
        return cls(pos, float(mass.sum()), half_size, place, friction, np.sqrt(3 * second / mass.sum()))

    def shapes_at(self, pos: FloatArray, quat: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(s, 3) centres, (s, 3, 3) rotations and (s, 3) half extents of its shapes when the body is at this pose."""
        turns = np.tile(rotations(quat[None]), (len(self.half_size), 1, 1))
        return pos + np.einsum("sij,sj->si", turns, self.shape_pos), turns, self.half_size

    @property
    def boards(self) -> FloatArray:
        """(s, 6) extents of its shapes and their places in the body's frame, m, as pages and tables have them."""
        return np.hstack([2 * self.half_size, self.shape_pos])

    @property
    def low(self) -> FloatArray:
        """(3,) the lowest corner of all shapes with the body at its planned place, m."""
        low: FloatArray = (self.pos + self.shape_pos - self.half_size).min(axis=0)
        return low

    @property
    def high(self) -> FloatArray:
        """(3,) the highest corner, m."""
        high: FloatArray = (self.pos + self.shape_pos + self.half_size).max(axis=0)
        return high


@dataclass(frozen=True, eq=False)
class Pieces:
    """The shapes of a box that is made of several solid boxes.

    Attributes:
        box: number of the box.
        half_size: (s, 3) half extents, m.
        pos: (s, 3) their middles, seen from the box's middle, m.
    """

    box: int
    half_size: FloatArray
    pos: FloatArray


@dataclass(frozen=True, eq=False)
class Shapes:
    """The shapes of a scene's bodies, body after body: those of the carrier, then those of the boxes in packing order.

    Attributes:
        body: (s,) number of the box to which a shape belongs, or ``CARRIER``.
        half_size, pos, friction: (s, 3) as in ``Body``.
        surface: (s,) as in ``Body``.
    """

    body: NDArray[np.intp]
    half_size: FloatArray
    pos: FloatArray
    friction: FloatArray
    surface: NDArray[np.intp]

    def of(self, body: int) -> range:
        """The rows of a body's shapes."""
        begin, end = np.searchsorted(self.body, [body, body + 1]).tolist()
        return range(begin, end)
