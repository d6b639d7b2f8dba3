"""Bodies of a scene and their shapes. A shape is a solid cuboid that is fixed to its body.

The origin of a body's frame is the body's centre of mass. The frame's axes are parallel to the edges of the body's
shapes, and are used as principal axes. So the inertia matrix of every body is diagonal, and MuJoCo's ``qpos`` and
``qvel`` describe the centre of mass.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.physics import Triple
from petmjx.options.walls import Side
from petmjx.world.rotation import rotations


@dataclass(frozen=True, eq=False)
class Body:
    """A body of one or more shapes, such as the carrier with its boards.

    Attributes:
        pos: (3,) centre of mass, m.
        mass: mass of the body, kg.
        half_size: (s, 3) half extents of the shapes, m.
        shape_pos: (s, 3) centres of the shapes in the body's frame, m.
        friction: (s, 3) sliding, torsional and rolling coefficients of the shapes.
        inertia_box: (3,) half extents of the solid box that has the body's mass and moments of inertia, m: MuJoCo's
            equivalent inertia box.
        surface: (s,) surface number of each shape (petmjx/world/surface_pairs.py). If ``surface`` is None, every shape
            has the surface 0.
        walls: sides of a carrier that have a wall. The walls are the body's last shapes, in the order of ``walls``; all
            other shapes are boards.
    """

    pos: FloatArray
    mass: float
    half_size: FloatArray
    shape_pos: FloatArray
    friction: FloatArray
    inertia_box: FloatArray
    surface: NDArray[np.intp] | None = None
    walls: tuple[Side, ...] = ()

    @classmethod
    def solid(cls, pos: FloatArray, half_size: FloatArray, mass: float, friction: Triple) -> Body:
        """A body that is one solid cuboid."""
        return cls(pos, mass, half_size[None], np.zeros((1, 3)), np.array([friction]), half_size)

    @classmethod
    def of_boards(cls, center: FloatArray, half_size: FloatArray, mass: FloatArray, friction: FloatArray) -> Body:
        """A body made of boards. Each board is a solid cuboid.

        The edges of the boards are used as the principal axes of the body: products of inertia are neglected. For a
        pallet without one of its outer deck boards, these products are a few per cent of the moments of inertia.
        Products of inertia would matter only if the carrier turned, but it stands on the floor.

        Args:
            center: (s, 3) centres of the boards, m.
            half_size: (s, 3) half extents of the boards, m.
            mass: (s,) masses of the boards, kg.
            friction: (s, 3) sliding, torsional and rolling coefficients of the boards.
        """
        pos = mass @ center / mass.sum()
        place = center - pos
        second = np.einsum("s,si,si->i", mass, place, place) + mass @ half_size**2 / 3
        return cls(pos, float(mass.sum()), half_size, place, friction, np.sqrt(3 * second / mass.sum()))

    def with_walls(
        self, center: FloatArray, half_size: FloatArray, mass: FloatArray, friction: FloatArray, sides: Sequence[Side]
    ) -> Body:
        """This body with additional walls, one for each of ``sides``. The other arguments are as in ``of_boards``, with
        one row per wall."""
        boards = self.pos + self.shape_pos
        body = Body.of_boards(
            np.vstack([self.pos, center]),
            np.vstack([self.inertia_box, half_size]),
            np.append(self.mass, mass),
            np.vstack([self.friction[:1], friction]),
        )
        return replace(
            body,
            half_size=np.vstack([self.half_size, half_size]),
            shape_pos=np.vstack([boards, center]) - body.pos,
            friction=np.vstack([self.friction, friction]),
            walls=tuple(sides),
        )

    def shapes_at(self, pos: FloatArray, quat: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Three arrays for a body with the position ``pos``, m, and the orientation ``quat``, a quaternion (w, x, y,
        z): (s, 3) centres, (s, 3, 3) rotation matrices and (s, 3) half extents of its shapes, m."""
        turns = np.tile(rotations(quat[None]), (len(self.half_size), 1, 1))
        return pos + np.einsum("sij,sj->si", turns, self.shape_pos), turns, self.half_size

    @property
    def n_boards(self) -> int:
        """Number of shapes that are not walls. In arrays, shapes that are not walls come before the walls."""
        return len(self.half_size) - len(self.walls)

    def without_walls(self, sides: Collection[Side]) -> Body:
        """This body without the walls on ``sides``. The body's mass still includes the removed walls, so that the
        centre of mass stays the same.

        Raises:
            ValueError: the body has no wall on one of the sides.
        """
        if missing := [side for side in sides if side not in self.walls]:
            raise ValueError(f"the carrier has no wall on the side {missing[0]}")
        stays_closed = np.array([True] * self.n_boards + [side not in sides for side in self.walls])
        of_shapes = {name: getattr(self, name)[stays_closed] for name in ("half_size", "shape_pos", "friction")}
        surface = None if self.surface is None else self.surface[stays_closed]
        return replace(self, **of_shapes, surface=surface, walls=tuple(s for s in self.walls if s not in sides))

    @property
    def boards(self) -> FloatArray:
        """(s, 6) full extents of the shapes along x, y and z, and the shapes' centres in the body's frame, m."""
        return np.hstack([2 * self.half_size, self.shape_pos])

    @property
    def room(self) -> Room:
        """The space between the walls, if the body is at its planned place."""
        face, top = np.array([[-np.inf] * 2, [np.inf] * 2]), np.full((2, 2), -np.inf)
        center, half = (self.pos + self.shape_pos)[self.n_boards :], self.half_size[self.n_boards :]
        for row, side in enumerate(self.walls):
            at, inwards = (int(side.is_far), side.axis), -1 if side.is_far else 1
            face[at] = center[row, side.axis] + inwards * half[row, side.axis]
            top[at] = center[row, 2] + half[row, 2]
        return Room(face, top)

    @property
    def low(self) -> FloatArray:
        """(3,) lowest x, y and z of any shape, m, if the body is at its planned place."""
        low: FloatArray = (self.pos + self.shape_pos - self.half_size).min(axis=0)
        return low

    @property
    def high(self) -> FloatArray:
        """(3,) highest x, y and z of any shape, m, if the body is at its planned place."""
        high: FloatArray = (self.pos + self.shape_pos + self.half_size).max(axis=0)
        return high


@dataclass(frozen=True, eq=False)
class Room:
    """The space between the walls of one or several carriers.

    Attributes:
        face: (…, 2, 2) x or y of the inner face of each of the four walls of a carrier, m; infinite if there is no
            wall. Along axis −2, the entries are for the wall at the low end and for the wall at the high end. Along
            axis −1, the entries are for x and for y.
        top: (…, 2, 2) z of the upper edge of each wall, m, with the same axes as ``face``.
    """

    face: FloatArray
    top: FloatArray

    @classmethod
    def of(cls, carriers: Sequence[Body]) -> Room:
        """The spaces between the walls of m carriers, as arrays (m, 2, 2)."""
        rooms = [carrier.room for carrier in carriers]
        return cls(np.array([room.face for room in rooms]), np.array([room.top for room in rooms]))

    def __getitem__(self, row: int) -> Room:
        return Room(self.face[row], self.top[row])

    def gaps(self, place: FloatArray, half: FloatArray, least_m: float) -> FloatArray:
        """(…, n, 2, 2) gap between each box and each wall, m; negative if the box overlaps the wall.

        The gap is infinite if there is no wall, if the box is above the wall, or if the box's middle is beyond the
        wall's inner face.

        Args:
            place: (…, n, 3) middles of the boxes, m.
            half: (…, n, 3) half extents of the boxes along x, y and z, m.
            least_m: length by which a box must reach below the wall's top, m. A box that reaches less far down counts
                as above the wall.
        """
        inwards, beside = self._inwards(place, half, least_m)
        gap: FloatArray = np.where(beside & (inwards > 0), inwards - half[..., None, :2], np.inf)
        return gap

    def depths(self, place: FloatArray, half: FloatArray, least_m: float) -> FloatArray:
        """(…, n, 2, 2) length by which each box reaches beyond the inner face of each wall, m; 0 if the box does not
        reach the face.

        The length is also positive if the box's middle is beyond the inner face, or if the box is wholly behind the
        wall.

        Args:
            place, half, least_m: as in ``gaps``.
        """
        inwards, beside = self._inwards(place, half, least_m)
        depth: FloatArray = np.where(beside, np.maximum(half[..., None, :2] - inwards, 0.0), 0.0)
        return depth

    def _inwards(self, place: FloatArray, half: FloatArray, least_m: float) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Two arrays (…, n, 2, 2): the distances of boxes' middles from walls' inner faces, m, positive between the
        walls; and whether each box reaches below the top of each wall."""
        inwards = (place[..., None, :2] - self.face[..., None, :, :]) * np.array([[1.0], [-1.0]])
        return inwards, (place - half)[..., None, None, 2] < self.top[..., None, :, :] - least_m


@dataclass(frozen=True, eq=False)
class Shapes:
    """The shapes of a scene's bodies: first the shapes of the carrier, then the shapes of each box in packing order.

    Attributes:
        body: (s,) number of the box to which each shape belongs, or ``CARRIER``.
        half_size: (s, 3) half extents of the shapes, m.
        pos: (s, 3) centres of the shapes in their bodies' frames, m.
        friction: (s, 3) sliding, torsional and rolling coefficients of the shapes.
        surface: (s,) surface number of each shape (petmjx/world/surface_pairs.py).
    """

    body: NDArray[np.intp]
    half_size: FloatArray
    pos: FloatArray
    friction: FloatArray
    surface: NDArray[np.intp]

    def of(self, body: int) -> range:
        """The rows of this object's arrays that belong to one body."""
        begin, end = np.searchsorted(self.body, [body, body + 1]).tolist()
        return range(begin, end)
