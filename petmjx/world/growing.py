"""The scenes of worlds to which boxes are added one by one. A scene is made when it is asked for: a packer places
thousands of boxes at a time, and reads few scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.world.next_boxes import Blank, NextBoxes, Stacks
from petmjx.world.scene import Scene

_FIRST_ROOM = 16


class GrowingScenes:
    """The scenes of n worlds with one carrier.

    Args:
        scenes: at first.
        blank: what is the same of all boxes that are added.
    """

    def __init__(self, scenes: Sequence[Scene], blank: Blank) -> None:
        n = len(scenes)
        self._blank, self._carrier = blank, scenes[0].carrier
        self._made = list(scenes)
        """Of each world a scene with its first boxes, perhaps all."""
        self._count = np.zeros(n, np.int64)
        self._half_size, self._target = (np.full((n, _FIRST_ROOM, 3), np.nan) for _ in range(2))
        self._mass: FloatArray = np.full((n, _FIRST_ROOM), np.nan)
        self.set(range(n), scenes)

    def __len__(self) -> int:
        return len(self._made)

    def __getitem__(self, world: int) -> Scene:
        scene, n = self._made[world], int(self._count[world])
        if scene.n_boxes < n:
            rest = NextBoxes(*(values[world, scene.n_boxes : n] for values in self._columns))
            for row in range(len(rest)):
                scene = self._blank.with_box(scene, rest, row)
            self._made[world] = scene
        return scene

    def set(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Worlds have these scenes now."""
        for world, scene in zip(worlds, scenes, strict=True):
            self._make_room(scene.n_boxes)
            self._made[world], self._count[world] = scene, scene.n_boxes
            for table, values in zip(self._columns, (scene.half_size, scene.target, scene.mass), strict=True):
                table[world, : scene.n_boxes], table[world, scene.n_boxes :] = values, np.nan

    def add(self, worlds: Sequence[int], boxes: NextBoxes) -> None:
        """Each of these worlds has one box more."""
        rows, at = np.asarray(worlds, np.intp), self._count[worlds]
        self._make_room(int(at.max(initial=0)) + 1)
        for table, values in zip(self._columns, (boxes.half_size, boxes.target, boxes.mass), strict=True):
            table[rows, at] = values
        self._count[rows] += 1

    def copy(self, sources: Sequence[int], into: Sequence[int]) -> None:
        """Give worlds the scenes of others."""
        for world, made in zip(into, [self._made[source] for source in sources], strict=True):
            self._made[world] = made
        for table in (self._count, *self._columns):
            table[np.asarray(into, np.intp)] = table[np.asarray(sources, np.intp)]

    def stacks(self, worlds: Sequence[int]) -> Stacks:
        """The boxes of these worlds, which may be named more than once, in arrays as wide as the fullest needs."""
        rows = np.asarray(worlds, np.intp)
        width = int(self._count[rows].max(initial=0))
        half_size, target, mass = (table[rows, :width] for table in self._columns)
        carrier = self._carrier
        friction = float(self._blank.friction[0])
        return Stacks(half_size, target, mass, carrier.mass, float(carrier.friction[:, 0].max()), friction)

    @property
    def _columns(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self._half_size, self._target, self._mass

    def _make_room(self, n_boxes: int) -> None:
        """Columns for so many boxes, and for as many again."""
        if n_boxes <= self._mass.shape[1]:
            return
        self._half_size, self._target, self._mass = (_widened(table, 2 * n_boxes) for table in self._columns)


def _widened(table: FloatArray, width: int) -> FloatArray:
    wide: FloatArray = np.full((len(table), width, *table.shape[2:]), np.nan)
    wide[:, : table.shape[1]] = table
    return wide
