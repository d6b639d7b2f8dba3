"""Conventions of input (``InputConventions``): the units of plans, and the point of a box that coordinates describe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, cast

import numpy as np

from petmjx.common.argument_checks import text_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import LENGTHS_MM, MASSES_KG, PLAN_UNITS, FloatArray, plan_units
from petmjx.options.run_options import Anchor
from petmjx.plans.plan_fields import FARTHEST_MM, LARGEST_KG, LARGEST_MM, SMALLEST_KG, SMALLEST_MM

ANCHORS: Final[Mapping[str, tuple[float, float, float]]] = {
    "corner": (0.0, 0.0, 0.0),
    "centre": (0.5, 0.5, 0.5),
    "base-centre": (0.5, 0.5, 0.0),
    "far-corner": (1.0, 1.0, 1.0),
    "top-centre": (0.5, 0.5, 1.0),
    "corner-x": (1.0, 0.0, 0.0),
    "corner-y": (0.0, 1.0, 0.0),
    "corner-xy": (1.0, 1.0, 0.0),
    "corner-z": (0.0, 0.0, 1.0),
    "corner-xz": (1.0, 0.0, 1.0),
    "corner-yz": (0.0, 1.0, 1.0),
}
"""Name of a point of a box → its offset from the front-left-bottom corner, as shares of the box's extents."""


class Limits(NamedTuple):
    """The range of a value, in the unit of the input, and the unit's name."""

    smallest: float
    largest: float
    unit: str


@dataclass(frozen=True, slots=True)
class InputConventions:
    """The units of plans, and the point of a box that coordinates describe.

    Attributes:
        units: units of lengths and masses, such as "cm,g".
        anchor: the point, as a name of ``ANCHORS``.
    """

    units: str = PLAN_UNITS
    anchor: Anchor = "corner"

    @classmethod
    def checked(cls, units: Any, anchor: Any) -> InputConventions:
        """Make conventions from unchecked values. A value of None means the default.

        Raises:
            InputError: the units or the anchor is unknown.
        """
        units, anchor = PLAN_UNITS if units is None else units, "corner" if anchor is None else anchor
        text_of(units, "units")
        if not isinstance(anchor, str) or anchor not in ANCHORS:
            raise InputError(f"anchor must be one of {', '.join(ANCHORS)}, {shown_value(anchor)}")
        try:
            return cls(",".join(plan_units(units)), cast(Anchor, anchor))
        except ValueError as error:
            raise InputError(f"units {error}, {shown_value(units)}") from None

    @property
    def length_mm(self) -> float:
        """Length of one unit of sizes, mm."""
        return LENGTHS_MM[self._length_units[0]][0]

    @property
    def place_mm(self) -> float:
        """Length of one unit of coordinates, mm."""
        return LENGTHS_MM[self._length_units[1]][0]

    @property
    def _length_units(self) -> tuple[str, str]:
        sizes, _, places = plan_units(self.units)[0].partition("/")
        return sizes, places or sizes

    @property
    def mass_kg(self) -> float:
        """Mass of one unit of mass, kg."""
        return MASSES_KG[plan_units(self.units)[1]][0]

    @property
    def sizes(self) -> Limits:
        """The allowed range of sizes."""
        return self._lengths(SMALLEST_MM, LARGEST_MM, self._length_units[0])

    @property
    def weights(self) -> Limits:
        """The allowed range of masses."""
        factor, name = MASSES_KG[plan_units(self.units)[1]]
        return Limits(SMALLEST_KG / factor, LARGEST_KG / factor, name)

    @property
    def coordinates(self) -> Limits:
        """The allowed range of coordinates."""
        return self._lengths(-FARTHEST_MM, FARTHEST_MM, self._length_units[1])

    def _lengths(self, low_mm: float, high_mm: float, unit: str) -> Limits:
        factor, name = LENGTHS_MM[unit]
        return Limits(low_mm / factor, high_mm / factor, name)

    def corner_mm(self, coordinates_mm: FloatArray, size_mm: FloatArray) -> FloatArray:
        """(n, 3) front-left-bottom corners, mm, computed from the points in the input and the extents of the boxes as
        placed."""
        if self.anchor == "corner":
            return coordinates_mm
        corner: FloatArray = coordinates_mm - np.array(ANCHORS[self.anchor]) * size_mm
        return corner


USUAL_CONVENTIONS: Final = InputConventions()
"""The defaults: millimetres and kilograms, and front-left-bottom corners."""
