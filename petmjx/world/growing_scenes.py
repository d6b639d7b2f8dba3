"""Scenes of worlds to which boxes are added one by one, and arrays with the next box of each world.

A packer adds thousands of boxes at a time, but needs the scenes of few worlds. So the boxes of all worlds are kept in
arrays. A scene is made from the arrays only when it is requested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.scene import OF_BOXES, Scene, build_scene, half_size_and_target

FIRST_COLUMNS: Final = 16
"""Number of columns with which an array of boxes is made. The array has one row per world and one column per box. The
array is widened when a world gets more boxes (``widened_table``)."""


class OpenScenes:
    """The scenes of n worlds that have the same carrier.

    Args:
        scenes: the scenes at the start.
        blank: the empty carrier, with the values that all added boxes share.
    """

    def __init__(self, scenes: Sequence[Scene], blank: EmptyCarrier) -> None:
        n = len(scenes)
        self._blank, self._carrier = blank, scenes[0].carrier
        self._scenes: NDArray[np.object_] = np.empty(n, object)
        """The scene of each world as it was when it was last requested (``__getitem__``). Boxes that were added later
        are only in the arrays ``_half_size``, ``_target`` and ``_mass`` until the next request."""
        self._count = np.zeros(n, np.int64)
        self._half_size, self._target = (np.full((n, FIRST_COLUMNS, 3), np.nan) for _ in range(2))
        self._mass: FloatArray = np.full((n, FIRST_COLUMNS), np.nan)
        self.set(range(n), scenes)

    def __len__(self) -> int:
        return len(self._scenes)

    def __getitem__(self, world: int) -> Scene:
        scene: Scene = self._scenes[world]
        n = int(self._count[world])
        if scene.n_boxes < n:
            added_boxes = NextBoxes(*(values[world, scene.n_boxes : n] for values in self._columns))
            for row in range(len(added_boxes)):
                scene = self._blank.with_box(scene, added_boxes, row)
            self._scenes[world] = scene
        return scene

    def set(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Replace the scenes of ``worlds`` by ``scenes``."""
        for world, scene in zip(worlds, scenes, strict=True):
            self._make_room(scene.n_boxes)
            self._scenes[world], self._count[world] = scene, scene.n_boxes
            for table, values in zip(self._columns, (scene.half_size, scene.target, scene.mass), strict=True):
                table[world, : scene.n_boxes], table[world, scene.n_boxes :] = values, np.nan

    def add(self, worlds: Sequence[int], boxes: NextBoxes) -> None:
        """Add one box to each of the given worlds."""
        rows, at = np.asarray(worlds, np.intp), self._count[worlds]
        self._make_room(int(at.max(initial=0)) + 1)
        for table, values in zip(self._columns, (boxes.half_size, boxes.target, boxes.mass), strict=True):
            table[rows, at] = values
        self._count[rows] += 1

    def copy(self, sources: Sequence[int], into: Sequence[int]) -> None:
        """Replace the scene of each world in ``into`` by the scene of the world at the same position in ``sources``."""
        rows, copied = np.asarray(into, np.intp), np.asarray(sources, np.intp)
        n_used = int(max(self._count[rows].max(initial=0), self._count[copied].max(initial=0)))
        for table in (self._scenes, self._count, *(columns[:, :n_used] for columns in self._columns)):
            table[rows] = table[copied]

    def stacks(self, worlds: Sequence[int]) -> Stacks:
        """The boxes of the given worlds, in arrays with as many columns as the fullest world has boxes. ``worlds`` may
        contain a world several times."""
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
        """Widen the arrays if they have fewer than ``n_boxes`` columns."""
        self._half_size, self._target, self._mass = (widened_table(table, n_boxes, np.nan) for table in self._columns)


def widened_table(values: NDArray[Any], columns: int, fill: float = 0.0) -> NDArray[Any]:
    """The table ``values``, widened to at least ``columns`` columns: the number of columns is doubled until it is large
    enough, and new columns have the value ``fill``."""
    while values.shape[1] < columns:
        values = np.concatenate([values, np.full_like(values, fill)], axis=1)
    return values


_ONE_MM: Final = np.full((1, 3), 100.0)


@dataclass(frozen=True, eq=False)
class NextBoxes:
    """One box for each of m worlds. Units are as in ``Scene``.

    Attributes:
        half_size: (m, 3) half extents of the boxes, m.
        target: (m, 3) planned middles, at which boxes are also released, m.
        mass: (m,) masses, kg.
    """

    half_size: FloatArray
    target: FloatArray
    mass: FloatArray

    @classmethod
    def of(cls, size_mm: FloatArray, corner_mm: FloatArray, mass_kg: FloatArray, sim: Simulation) -> NextBoxes:
        """The next boxes, bit-identical to the boxes of ``build_scene``.

        Args:
            size_mm: (m, 3) extents of the boxes along x, y and z in their planned orientation.
            corner_mm: (m, 3) planned corners (front left bottom) of the boxes.
            mass_kg: (m,) masses of the boxes.
        """
        return cls(*half_size_and_target(size_mm, corner_mm, sim), mass_kg)

    def __len__(self) -> int:
        return len(self.mass)

    def take(self, rows: NDArray[np.intp]) -> NextBoxes:
        """The boxes in the given rows."""
        return NextBoxes(self.half_size[rows], self.target[rows], self.mass[rows])


@dataclass(frozen=True, eq=False)
class Stacks:
    """The planned boxes of m worlds that have the same carrier. The fullest world has k boxes.

    If a world has fewer than k boxes, the values in its last columns are NaN.

    Attributes:
        half_size, target: (m, k, 3) half extents and planned middles of the boxes, m.
        mass: (m, k) masses of the boxes, kg.
        carrier_mass: mass of the carrier, kg.
        carrier_friction, box_friction: coefficients of sliding friction of the carrier and of every box.
    """

    half_size: FloatArray
    target: FloatArray
    mass: FloatArray
    carrier_mass: float
    carrier_friction: float
    box_friction: float

    def with_next(self, boxes: NextBoxes) -> tuple[FloatArray, FloatArray]:
        """(m, k + 1, 3) half extents and (m, k + 1, 3) planned middles, m, after one box was added to each world."""
        m = len(boxes)
        tables = []
        count = np.isfinite(self.mass).sum(axis=1)
        for before, new in ((self.half_size, boxes.half_size), (self.target, boxes.target)):
            table = np.concatenate([before, np.full((m, 1, 3), np.nan)], axis=1)
            table[np.arange(m), count] = new
            tables.append(table)
        return tables[0], tables[1]


class EmptyCarrier:
    """A carrier without boxes, and the properties (such as friction) that are equal for all boxes added later."""

    def __init__(self, sim: Simulation) -> None:
        plan = Plan("", "", _ONE_MM, np.zeros((1, 3)), np.ones(1), ("",), ("",), np.ones(1, np.int64))
        self._one = build_scene(plan, sim)
        self.scene = self._one.first(0)
        self.friction = self._one.friction[0]
        self.surface = 0 if self._one.surface is None else int(self._one.surface[0])

    def with_box(self, scene: Scene, boxes: NextBoxes, row: int) -> Scene:
        """The scene with one more box: the box ``row`` of ``boxes``. The box's extents, place and mass are as in
        ``boxes``. All other properties of the box are the same as for all added boxes."""
        place = boxes.target[row]
        box_values = {"half_size": boxes.half_size[row], "mass": boxes.mass[row], "target": place, "start_pos": place}
        grown: dict[str, Any] = {}
        for name in OF_BOXES:
            before = getattr(scene, name)
            if before is not None:
                value = box_values[name] if name in box_values else getattr(self._one, name)[0]
                grown[name] = np.concatenate([before, np.asarray(value)[None]])
        return replace(scene, **grown)
