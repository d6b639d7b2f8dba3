"""Bodies of a scene and their shapes. A shape is a solid box that is fixed to its body.

The origin of a body's frame is its centre of mass. The frame's axes are parallel to the edges of its shapes and count
as principal axes. So the inertia matrix of every body is diagonal, and MuJoCo's qpos and qvel describe the centre of
mass.
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
    """A body of one or more boxes, such as the carrier with its boards.

    Attributes:
        pos: (3,) centre of mass, m.
        mass: mass, kg.
        half_size: (s, 3) half extents of the shapes, m.
        shape_pos: (s, 3) centres of the shapes in the body's frame, m.
        friction: (s, 3) sliding, torsional and rolling coefficients of the shapes.
        inertia_box: (3,) half extents of the solid box that has the body's mass and moments of inertia, m: MuJoCo's
            equivalent inertia box.
        surface: (s,) surface number of each shape (petmjx/world/friction_pairs.py); None: all 0.
        walls: sides of a carrier that have a wall. Walls are the last shapes, in this order; all others are boards.
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
        """A body that is one solid box."""
        return cls(pos, mass, half_size[None], np.zeros((1, 3)), np.array([friction]), half_size)

    @classmethod
    def of_boards(cls, center: FloatArray, half_size: FloatArray, mass: FloatArray, friction: FloatArray) -> Body:
        """A body made of boards. Each board is a solid box.

        The edges of the boards count as the principal axes of the body. Boards may be unbalanced, but products of
        inertia are neglected: for a pallet without one of its outer deck boards, these products are a few per cent of
        the moments. The principal axes would matter only if the carrier turned, and the carrier stands on the floor.

        Args:
            center: (s, 3) centres of the boards, m.
            half_size: (s, 3) half extents, m.
            mass: (s,) masses of the boards, kg.
            friction: (s, 3) as in ``Body``.
        """
        pos = mass @ center / mass.sum()
        place = center - pos
        second = np.einsum("s,si,si->i", mass, place, place) + mass @ half_size**2 / 3
        return cls(pos, float(mass.sum()), half_size, place, friction, np.sqrt(3 * second / mass.sum()))

    def with_walls(
        self, center: FloatArray, half_size: FloatArray, mass: FloatArray, friction: FloatArray, sides: Sequence[Side]
    ) -> Body:
        """This body with walls added, one for each side. Arguments as for ``of_boards``."""
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
        """(s, 3) centres, (s, 3, 3) rotations and (s, 3) half extents of the shapes if the body has this pose."""
        turns = np.tile(rotations(quat[None]), (len(self.half_size), 1, 1))
        return pos + np.einsum("sij,sj->si", turns, self.shape_pos), turns, self.half_size

    @property
    def n_boards(self) -> int:
        """Number of shapes that are not walls. These shapes are the first ones of the body."""
        return len(self.half_size) - len(self.walls)

    def without_walls(self, sides: Collection[Side]) -> Body:
        """This body without the walls of these sides. The body keeps the mass of these walls, so that its frame stays
        the same.

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
        """(s, 6) full extents of the shapes and their centres in the body's frame, m, as pages and tables need them."""
        return np.hstack([2 * self.half_size, self.shape_pos])

    @property
    def room(self) -> Room:
        """The space between the walls, with the body at its planned place."""
        face, top = np.array([[-np.inf] * 2, [np.inf] * 2]), np.full((2, 2), -np.inf)
        center, half = (self.pos + self.shape_pos)[self.n_boards :], self.half_size[self.n_boards :]
        for row, side in enumerate(self.walls):
            at, inwards = (int(side.is_far), side.axis), -1 if side.is_far else 1
            face[at] = center[row, side.axis] + inwards * half[row, side.axis]
            top[at] = center[row, 2] + half[row, 2]
        return Room(face, top)

    @property
    def low(self) -> FloatArray:
        """(3,) the lowest coordinates of all shapes, with the body at its planned place, m."""
        low: FloatArray = (self.pos + self.shape_pos - self.half_size).min(axis=0)
        return low

    @property
    def high(self) -> FloatArray:
        """(3,) the highest coordinates of all shapes, m."""
        high: FloatArray = (self.pos + self.shape_pos + self.half_size).max(axis=0)
        return high


@dataclass(frozen=True, eq=False)
class Room:
    """The space between the walls of one or several carriers.

    Attributes:
        face: (…, 2, 2) inner faces of the walls at the low and the high end of x and y, m; infinite without a wall.
        top: (…, 2, 2) heights of the tops of the walls, m.
    """

    face: FloatArray
    top: FloatArray

    @classmethod
    def of(cls, carriers: Sequence[Body]) -> Room:
        """The rooms of m carriers, stacked: arrays (m, 2, 2)."""
        rooms = [carrier.room for carrier in carriers]
        return cls(np.array([room.face for room in rooms]), np.array([room.top for room in rooms]))

    def __getitem__(self, row: int) -> Room:
        return Room(self.face[row], self.top[row])

    def gaps(self, place: FloatArray, half: FloatArray, least_m: float) -> FloatArray:
        """(…, n, 2, 2) gaps between boxes and walls, m; negative: the box overlaps the wall. The gap is infinite if
        there is no wall, if the box is above the wall, or if the box's middle is beyond the wall's inner face.

        Args:
            place, half: (…, n, 3) middles and half extents of the boxes along the axes, m.
            least_m: a box is beside a wall if it reaches below the wall's top by more than this, m.
        """
        inwards, beside = self._inwards(place, half, least_m)
        gap: FloatArray = np.where(beside & (inwards > 0), inwards - half[..., None, :2], np.inf)
        return gap

    def depths(self, place: FloatArray, half: FloatArray, least_m: float) -> FloatArray:
        """(…, n, 2, 2) lengths by which boxes reach beyond the inner faces of walls, m; 0 for boxes that do not reach
        the faces. Unlike in ``gaps``, the position of a box's middle does not matter: a box wholly behind a wall
        counts, too.

        Args:
            place, half, least_m: as in ``gaps``.
        """
        inwards, beside = self._inwards(place, half, least_m)
        depth: FloatArray = np.where(beside, np.maximum(half[..., None, :2] - inwards, 0.0), 0.0)
        return depth

    def _inwards(self, place: FloatArray, half: FloatArray, least_m: float) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(…, n, 2, 2) distances of boxes' middles from the walls' inner faces, inwards, m, and whether boxes reach
        below the tops of the walls."""
        inwards = (place[..., None, :2] - self.face[..., None, :, :]) * np.array([[1.0], [-1.0]])
        return inwards, (place - half)[..., None, None, 2] < self.top[..., None, :, :] - least_m


@dataclass(frozen=True, eq=False)
class Pieces:
    """The shapes of a box that is made up of several solid boxes.

    Attributes:
        box: number of the box.
        half_size: (s, 3) half extents, m.
        pos: (s, 3) middles, relative to the middle of the box, m.
    """

    box: int
    half_size: FloatArray
    pos: FloatArray


@dataclass(frozen=True, eq=False)
class Shapes:
    """The shapes of a scene's bodies: first those of the carrier, then those of each box in packing order.

    Attributes:
        body: (s,) number of the box to which each shape belongs, or ``CARRIER``.
        half_size, pos, friction: (s, 3) see ``Body``.
        surface: (s,) see ``Body``.
    """

    body: NDArray[np.intp]
    half_size: FloatArray
    pos: FloatArray
    friction: FloatArray
    surface: NDArray[np.intp]

    def of(self, body: int) -> range:
        """The rows that hold a body's shapes."""
        begin, end = np.searchsorted(self.body, [body, body + 1]).tolist()
        return range(begin, end)
