"""The options of a carrier's walls (``Walls``): which sides have a wall, how high the walls are, and which walls are
open.

Defaults, units, checks and descriptions are defined only here. docs/carriers.md explains the options to users.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, Final, Self

from pydantic import Field, StrictFloat, field_validator, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, complaint, within


class Side(StrEnum):
    """The sides of a carrier. As in plans, the origin is the carrier's front-left corner."""

    LEFT = "left"
    RIGHT = "right"
    FRONT = "front"
    BACK = "back"

    @property
    def axis(self) -> int:
        """The axis that is perpendicular to a wall on this side: 0 for x, 1 for y."""
        return 0 if self in (Side.LEFT, Side.RIGHT) else 1

    @property
    def is_far(self) -> bool:
        """Whether a wall on this side is at that end of the axis at which the coordinate is larger."""
        return self in (Side.RIGHT, Side.BACK)


class Walls(CheckedRecord):
    """The walls around a carrier's top. A ``Walls`` can be made from a list of sides, or from a mapping.

    A wall is a rigid upright plate along a whole side, and part of the carrier's body. If a field is None, the
    carrier's own value is used (``petmjx.options.carriers.walls_of``), or, if the carrier has none, the value from
    ``USUAL_WALLS``.
    """

    sides: Annotated[tuple[Side, ...] | None, CliFlag("--walls", "SIDE,…")] = Field(
        None,
        description="sides of the carrier that have a wall: left (at x = 0), right, front (at y = 0), back; by "
        "default the carrier's own walls (docs/carriers.md)",
    )
    open: Annotated[tuple[Side, ...], CliFlag("--open-walls", "SIDE,…")] = Field(
        (),
        description="sides of the carrier whose wall is open, like a door: nothing can lean on an open wall, but the "
        "wall keeps its mass",
    )
    height_mm: Annotated[float | None, within(1, 4000)] = Field(
        None,
        description="height of the walls above the carrier's top, mm; by default the height of the carrier's "
        "walls, else 1500",
    )
    gap_mm: Annotated[float | None, within(-200, 500)] = Field(
        None,
        description="distance of the walls from the sides of the carrier's top, mm; negative: the walls stand on the "
        "top, as collars do; by default as for the carrier's walls, else 0",
    )
    thickness_mm: Annotated[float | None, within(1, 500)] = Field(
        None, description="thickness of the walls, mm; by default as for the carrier's walls, else 30"
    )
    mass_kg_m2: Annotated[float | None, within(0, 1000)] = Field(
        None, description="mass of the walls per area, kg/m²; by default as for the carrier's walls, else 6"
    )
    friction: Annotated[StrictFloat, Field(ge=0, le=100)] | None = Field(
        None,
        description="coefficient of sliding friction between walls and boxes; by default the friction between the "
        "materials of walls and boxes, else physics.carrier_friction",
    )
    material: Annotated[str, Field(max_length=100)] | None = Field(
        None,
        description="material of the walls, for friction by materials; by default the material of the carrier's "
        "walls, else wood",
    )

    @model_validator(mode="before")
    @classmethod
    def _from_sides(cls, values: Any) -> Any:
        return values if isinstance(values, Mapping | Walls) else {"sides": values}

    @field_validator("sides", "open", mode="before")
    @classmethod
    def _from_text(cls, value: Any) -> Any:
        if isinstance(value, str):  # the command line passes the sides as text
            return tuple(side.strip() for side in value.split(",") if side.strip())
        return value

    @field_validator("sides", "open")
    @classmethod
    def _each_side_once(cls, value: tuple[Side, ...] | None) -> tuple[Side, ...] | None:
        for at, side in enumerate(value or ()):
            if side in (value or ())[:at]:
                raise complaint(f"names {side} twice", at)
        return None if value is None else tuple(side for side in Side if side in value)

    def or_of(self, other: Walls) -> Self:
        """A copy of these walls, in which each field that is not set has the value from ``other``."""
        missing = [name for name in type(self).model_fields if getattr(self, name) is None]
        return self.model_copy(
            update={name: getattr(other, name) for name in missing} | {"open": self.open or other.open}
        )

    @property
    def standing(self) -> tuple[Side, ...]:
        """The sides that have a wall which is not open. Boxes can lean only on such walls."""
        return tuple(side for side in self.sides or () if side not in self.open)

    def check_open(self) -> None:
        """Check that every side in ``open`` has a wall, since only a wall can be open. The error names the field as
        ``walls.open``, because this record is the field ``walls`` of other records."""
        for at, side in enumerate(self.open):
            if side not in (self.sides or ()):
                raise complaint(f"is {side}, but the carrier has no wall on this side", "walls", "open", at)

    def room_fault(self, extent_mm: Sequence[float]) -> str | None:
        """The error text if the walls leave no room for boxes on a carrier's top; None if there is room.

        With a negative gap, walls stand inside the carrier's sides, so boxes have less room. The length of a wall,
        which must be positive, is the length of the carrier's side plus two gaps, even if the adjacent sides have no
        walls.

        Args:
            extent_mm: extents of the carrier's top along x and y, mm.
        """
        gap_mm, axes = self.gap_mm or 0.0, [side.axis for side in self.sides or ()]
        for axis, name in enumerate("xy"):
            gaps = 2 if 1 - axis in axes else axes.count(axis)
            if gaps and extent_mm[axis] + gaps * gap_mm <= 0:
                return f"walls.gap_mm of {gap_mm:g} leaves no room on a carrier of {extent_mm[axis]:g} mm along {name}"
        return None


USUAL_WALLS: Final = Walls(
    sides=(), height_mm=1500.0, gap_mm=0.0, thickness_mm=30.0, mass_kg_m2=6.0, friction=None, material="wood"
)
"""The values of fields of ``Walls`` that neither the user nor the carrier sets. The mass per area is an assumption. It
is derived from roll containers with three walls, which have a mass of 40 to 45 kg in all, a base of about 25 kg, and
walls of about 3 m²."""
