"""The next box of each of some worlds, in arrays: what a packer asks about, thousands at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.options.config import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.scene import OF_BOXES, Scene, build_scene, half_size_and_target

_ONE_MM: Final = np.full((1, 3), 100.0)


@dataclass(frozen=True, eq=False)
class NextBoxes:
    """One box for each of m worlds, as ``Scene`` has them.

    Attributes:
        half_size: (m, 3) half extents, m.
        target: (m, 3) planned middles, m, where they are also released.
        mass: (m,) kg.
    """

    half_size: FloatArray
    target: FloatArray
    mass: FloatArray

    @classmethod
    def of(cls, size_mm: FloatArray, corner_mm: FloatArray, mass_kg: FloatArray, sim: Simulation) -> NextBoxes:
        """As ``build_scene`` makes them of a plan's, to the last bit.

        Args:
            size_mm, corner_mm: (m, 3) as they stand; ``mass_kg``: (m,).
        """
        return cls(*half_size_and_target(size_mm, corner_mm, sim), mass_kg)

    def __len__(self) -> int:
        return len(self.mass)

    def take(self, rows: NDArray[np.intp]) -> NextBoxes:
        """Some of them."""
        return NextBoxes(self.half_size[rows], self.target[rows], self.mass[rows])


@dataclass(frozen=True, eq=False)
class Stacks:
    """The planned boxes of m worlds of one carrier, k columns; NaN where a world has fewer.

    Attributes:
        half_size, target: (m, k, 3) m; ``mass``: (m, k) kg.
        carrier_mass: kg; ``carrier_friction``, ``box_friction``: coefficients of sliding friction.
    """

    half_size: FloatArray
    target: FloatArray
    mass: FloatArray
    carrier_mass: float
    carrier_friction: float
    box_friction: float

    def with_next(self, boxes: NextBoxes) -> tuple[FloatArray, FloatArray]:
        """(m, k + 1, 3) half extents and planned middles with one box more each, m."""
        m = len(boxes)
        tables = []
        count = np.isfinite(self.mass).sum(axis=1)
        for before, new in ((self.half_size, boxes.half_size), (self.target, boxes.target)):
            table = np.concatenate([before, np.full((m, 1, 3), np.nan)], axis=1)
            table[np.arange(m), count] = new
            tables.append(table)
        return tables[0], tables[1]


class Blank:
    """The carrier of some options alone, and what is the same of all boxes that are put on it."""

    def __init__(self, sim: Simulation) -> None:
        plan = Plan("", "", _ONE_MM, np.zeros((1, 3)), np.ones(1), ("",), ("",), np.ones(1, np.int64))
        self._one = build_scene(plan, sim)
        self.scene = self._one.first(0)
        self.friction = self._one.friction[0]
        self.surface = 0 if self._one.surface is None else int(self._one.surface[0])

    def with_box(self, scene: Scene, boxes: NextBoxes, row: int) -> Scene:
        """A scene with one box more, of which only extents, place and mass are known."""
        place = boxes.target[row]
        box_values = {"half_size": boxes.half_size[row], "mass": boxes.mass[row], "target": place, "start_pos": place}
        grown: dict[str, Any] = {}
        for name in OF_BOXES:
            before = getattr(scene, name)
            if before is not None:
                value = box_values[name] if name in box_values else getattr(self._one, name)[0]
                grown[name] = np.concatenate([before, np.asarray(value)[None]])
        return replace(scene, **grown)
