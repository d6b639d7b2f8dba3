"""Options of a carrier's walls (``Walls``): the sides with a wall, the height of walls, and the open walls.

Defaults, units, checks and descriptions are written only here. docs/carriers.md explains them to users.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, Final, Self

from pydantic import Field, StrictFloat, field_validator, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, complaint, within


class Side(StrEnum):
    """The sides of a carrier, as in plans, whose origin is its front-left corner."""

    LEFT = "left"
    RIGHT = "right"
    FRONT = "front"
    BACK = "back"

    @property
    def axis(self) -> int:
        """The axis on which the wall stands upright: 0 for x, 1 for y."""
        return 0 if self in (Side.LEFT, Side.RIGHT) else 1

    @property
    def is_far(self) -> bool:
        """Whether the wall is at the upper end of its axis."""
        return self in (Side.RIGHT, Side.BACK)


class Walls(CheckedRecord):
    """Walls around a carrier's deck. Made from a list of sides, or from a table.

    A wall is an upright plate along a whole side. A wall is rigid, and belongs to the carrier's body. None: the value
    of the carrier itself (``petmjx.options.carriers.walls_of``), else ``USUAL``.
    """

    sides: Annotated[tuple[Side, ...] | None, CliFlag("--walls", "SIDE,…")] = Field(
        None,
        description="sides of the carrier that have a wall: left (at x = 0), right, front (at y = 0), back; by "
        "default those of the carrier, of which rollcontainer-2, -3 and -4, gitterbox and container-20ft have some",
    )
    open: Annotated[tuple[Side, ...], CliFlag("--open-walls", "SIDE,…")] = Field(
        (),
        description="walls that are open, as a door is: nothing leans on them, but their mass stays",
    )
    height_mm: Annotated[float | None, within(1, 4000)] = Field(
        None, description="height of the walls above the carrier's top, mm; by default the carrier's, else 1500"
    )
    gap_mm: Annotated[float | None, within(-200, 500)] = Field(
        None,
        description="distance of the walls from the sides of the carrier's top, mm; negative: they stand on it, as "
        "collars do; by default the carrier's, else 0",
    )
    thickness_mm: Annotated[float | None, within(1, 500)] = Field(
        None, description="thickness of the walls, mm; by default the carrier's, else 30"
    )
    mass_kg_m2: Annotated[float | None, within(0, 1000)] = Field(
        None, description="mass of the walls by area, kg/m²; by default the carrier's, else 6"
    )
    friction: Annotated[StrictFloat, Field(ge=0, le=100)] | None = Field(
        None,
        description="coefficient of sliding friction between walls and boxes; by default as for boards that have "
        "none, by materials or physics.carrier_friction",
    )
    material: Annotated[str, Field(max_length=100)] | None = Field(
        None, description="what the walls are made of, for friction by materials; by default the carrier's, else wood"
    )

    @model_validator(mode="before")
    @classmethod
    def _from_sides(cls, values: Any) -> Any:
        return values if isinstance(values, Mapping | Walls) else {"sides": values}

    @field_validator("sides", "open", mode="before")
    @classmethod
    def _from_text(cls, value: Any) -> Any:
        if isinstance(value, str):  # of a command line
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
        """The same walls, with values of ``other`` where these walls have none."""
        missing = [name for name in type(self).model_fields if getattr(self, name) is None]
        return self.model_copy(
            update={name: getattr(other, name) for name in missing} | {"open": self.open or other.open}
        )

    @property
    def standing(self) -> tuple[Side, ...]:
        """The sides whose walls bear: those that are not open."""
        return tuple(side for side in self.sides or () if side not in self.open)

    def check_open(self) -> None:
        """Complain of an open wall where there is none, as the record that has these ``walls`` does."""
        for at, side in enumerate(self.open):
            if side not in (self.sides or ()):
                raise complaint(f"is {side}, where the carrier has no wall", "walls", "open", at)

    def room_fault(self, extent_mm: Sequence[float]) -> str | None:
        """The error text for walls that leave no room on a carrier's top; None if they do.

        A wall narrows the room by the gap. Along the other axis, walls end at the gaps of both sides.

        Args:
            extent_mm: extents of the carrier's top along x and y, mm.
        """
        gap_mm, axes = self.gap_mm or 0.0, [side.axis for side in self.sides or ()]
        for axis, name in enumerate("xy"):
            gaps = 2 if 1 - axis in axes else axes.count(axis)
            if gaps and extent_mm[axis] + gaps * gap_mm <= 0:
                return f"walls.gap_mm of {gap_mm:g} leaves no room on a carrier of {extent_mm[axis]:g} mm along {name}"
        return None


USUAL: Final = Walls(
    sides=(), height_mm=1500.0, gap_mm=0.0, thickness_mm=30.0, mass_kg_m2=6.0, friction=None, material="wood"
)
"""Values that neither the user nor the carrier gives. The mass is an assumption: roll containers with three sides have
40 to 45 kg, of which some 25 kg are the base, and some 3 m² are sides."""
