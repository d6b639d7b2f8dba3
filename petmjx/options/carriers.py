"""Carriers: built-in carriers (``Carrier``), and carriers that users define by boards in a TOML file
(``OwnCarrier``)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Final, Self

from pydantic import BeforeValidator, Discriminator, Field, StrictFloat, Tag, ValidationInfo, model_validator

from petmjx.common.checked_records import TABLE, VALUE, CheckedRecord, complaint, shape, shown_value, similar
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_name
from petmjx.common.toml_files import read_toml
from petmjx.common.units import MM_PER_M
from petmjx.options.materials import STEEL, WOOD
from petmjx.options.walls import USUAL_WALLS, Side, Walls


class Carrier(StrEnum):
    """The built-in carriers, on which boxes stand.

    Their extents and walls are in this module (``CARRIER_EXTENT_M``, ``WALLS_OF_CARRIERS``), their boards in
    ``petmjx.world.carrier_boards.BOARDS_OF_CARRIERS``. Carriers that may also be items of a plan have an entry in
    ``petmjx.plans.plan_fields.PALLET_KINDS``.
    """

    FOOTPRINT = "footprint"
    EURO_PALLET = "euro-pallet"
    ROLLCONTAINER = "rollcontainer"
    EPAL_1 = "epal-1"
    GMA_48X40 = "gma-48x40"
    PET_EUR = "pet-eur"
    ROLLCONTAINER_GRID = "rollcontainer-grid"
    ROLLCONTAINER_2 = "rollcontainer-2"
    ROLLCONTAINER_3 = "rollcontainer-3"
    ROLLCONTAINER_4 = "rollcontainer-4"
    GITTERBOX = "gitterbox"
    CONTAINER_20FT = "container-20ft"
    TRAILER = "trailer"


CARRIER_EXTENT_M: dict[Carrier, tuple[float, float] | None] = {
    Carrier.FOOTPRINT: None,
    Carrier.EURO_PALLET: (1.2, 0.8),
    Carrier.ROLLCONTAINER: (0.8, 0.7),
    Carrier.EPAL_1: (1.2, 0.8),
    Carrier.GMA_48X40: (1.219, 1.016),
    Carrier.PET_EUR: (1.2, 0.8),
    **dict.fromkeys(
        (Carrier.ROLLCONTAINER_GRID, Carrier.ROLLCONTAINER_2, Carrier.ROLLCONTAINER_3, Carrier.ROLLCONTAINER_4),
        (0.8, 0.7),
    ),
    Carrier.GITTERBOX: (1.2, 0.8),
    Carrier.CONTAINER_20FT: (5.867, 2.33),
    Carrier.TRAILER: (13.6, 2.48),
}
"""Extents of each built-in carrier along x and y, m. None means that the carrier is as large as the plan's bounding
box."""

_GRID_WALLS: Final = Walls(sides=(), height_mm=1500.0, gap_mm=5.0, thickness_mm=30.0, mass_kg_m2=6.0, material=STEEL)
"""Walls made of a lattice of steel tubes. The sizes and masses are typical; no source was found that states them for a
real model."""

WALLS_OF_CARRIERS: Final[Mapping[Carrier, Walls]] = {
    Carrier.ROLLCONTAINER_GRID: _GRID_WALLS,
    Carrier.ROLLCONTAINER_2: _GRID_WALLS.changed(sides=("left", "right")),
    Carrier.ROLLCONTAINER_3: _GRID_WALLS.changed(sides=("left", "right", "back")),
    Carrier.ROLLCONTAINER_4: _GRID_WALLS.changed(sides=tuple(Side)),
    Carrier.GITTERBOX: Walls(
        sides=tuple(Side), height_mm=800.0, gap_mm=0.0, thickness_mm=17.5, mass_kg_m2=18.0, material=STEEL
    ),
    Carrier.CONTAINER_20FT: Walls(
        sides=tuple(Side), height_mm=2350.0, gap_mm=0.0, thickness_mm=50.0, mass_kg_m2=33.0, material=STEEL
    ),
    Carrier.TRAILER: Walls(
        sides=(Side.RIGHT,), height_mm=1600.0, gap_mm=0.0, thickness_mm=50.0, mass_kg_m2=30.0, material=WOOD
    ),
}
"""The walls of built-in carriers. The walls of ``rollcontainer-grid`` stand only on sides that the user names.

``gitterbox`` is 1200 × 800 × 800 mm inside and has a mass of about 85 kg (UIC 435-3). ``container-20ft`` is 5867 × 2330
× 2350 mm inside (the smallest inner sizes of 1CC, ISO 668) and has a mass of about 2.2 t. ``trailer`` has only a
headboard. The headboard is at the end in +x, because braking pushes the load towards this end. The inner length and
width of ``trailer`` are usual for trailers."""

TARGETS = (Carrier.EURO_PALLET, Carrier.ROLLCONTAINER)
"""The carriers that orders of BED-BPP name as their target."""

MOST_BOARDS: Final = 64
"""Largest number of boards of a carrier. Engines check every pair of a board and a box for contacts, and the engine
``mjx-jax`` compiles code for each pair."""

TOUCH_MM: Final = 0.5
"""Largest gap or overlap with which two boards count as touching, mm. The value is the rounding error of lengths in
whole millimetres; boxes have the same tolerance (``petmjx.plans.plan_warnings.DEFAULT_TOLERANCE_MM``)."""

_SHORTEST_MM, _LONGEST_MM, _HIGHEST_MM = 200.0, 6000.0, 1500.0
"""Smallest and largest length of a carrier's longer side, and largest height of a carrier, mm. Real examples: the
longer side of a half-size dolly is 400 mm, a pallet is 100 to 170 mm high, and the base of a roll container about 200
mm. If the longer side is below 200 mm, the user has probably given lengths in cm, inches or metres."""
_THINNEST_MM: Final = 0.001
"""Smallest extent of a board, mm. Even if a user gives the extents in metres by mistake, the numbers are above this
limit. So the check of single boards passes, and the check of the whole carrier can suggest the right unit."""
_LIGHTEST_KG, _HEAVIEST_KG = 1.0, 5000.0
"""Smallest and largest mass of a carrier, kg. A carrier of cardboard has 2 kg. Lighter carriers are refused, because a
load of a thousand times the carrier's mass would sink deeply into the carrier."""
_LIGHTEST_KG_M3, _HEAVIEST_KG_M3 = 5.0, 12_000.0
"""Smallest and largest density of a board, kg/m³. Foam has 15 kg/m³, wood 400 to 800 kg/m³, steel 7,850 kg/m³ and lead
11,340 kg/m³."""
_LEVEL_MM: Final = 10.0
"""A depth below the carrier's highest point, mm. A board whose upper face is less than ``_LEVEL_MM`` below the highest
point belongs to the carrier's top, unless another board lies on it. All boards of the top must end at the same height.
"""
_ROUNDING_MM: Final = 1e-6
_UNITS: Final = ((1000.0, "metres"), (25.4, "inches"), (10.0, "centimetres"))
_USUAL_MM: Final = (300.0, 2500.0)
"""Usual range of the longer side of a carrier, mm. If the side is too short in mm, but is in this range in another
unit, an error message suggests that unit."""

Place = Annotated[StrictFloat, Field(ge=0, le=_LONGEST_MM)]
Length = Annotated[StrictFloat, Field(ge=_THINNEST_MM, le=_LONGEST_MM)]
Mass = Annotated[StrictFloat, Field(gt=0, le=_HEAVIEST_KG)]
Coefficient = Annotated[StrictFloat, Field(ge=0, le=100)]


_MOST_NAME: Final = 100
Name = Annotated[str, Field(max_length=_MOST_NAME)]


class Board(CheckedRecord):
    """A cuboid that is part of a carrier: a board, block, stringer or bar."""

    name: Name = Field("", description="name of the board in messages")
    corner_mm: tuple[Place, Place, Place] = Field(
        description="front-left-bottom corner of the board, mm; the origin is the carrier's front-left corner on the "
        "floor"
    )
    size_mm: tuple[Length, Length, Length] = Field(description="extents of the board along x, y and z, mm")
    mass_kg: Mass | None = Field(
        None,
        description="mass of the board, kg; by default, the carrier's mass_kg is divided among the boards by their "
        "volumes",
    )
    friction: Coefficient | None = Field(
        None,
        description="coefficient of sliding friction between the board and boxes; by default the carrier's friction",
    )
    material: Name = Field("", description="material of the board; by default the carrier's material")

    @property
    def volume_mm3(self) -> float:
        return math.prod(self.size_mm)


class OwnCarrier(CheckedRecord):
    """A carrier that a user defines. Lengths are in mm. x and y are measured from the carrier's front-left corner, z
    from the floor.

    A carrier is refused if it could not stand, or if its definition is probably a mistake. This is so if boards overlap
    or are not connected, if no board is on the floor, if the top is not level, or if no real carrier has such extents
    or masses.
    """

    name: Name = Field("", description="name of the carrier; by default the name of its file")
    mass_kg: Mass | None = Field(
        None, description="mass of all boards together, kg; give it only if no board has a mass of its own"
    )
    friction: Coefficient | None = Field(
        None, description="coefficient of sliding friction of the boards that have no friction of their own"
    )
    material: Name = Field(
        WOOD,
        description="material of the boards that have no material of their own; friction between two materials depends "
        "on it",
    )
    walls: Walls = Field(
        Walls(), description="walls around the carrier's top; they have the same fields as the option 'walls'"
    )
    boards: Annotated[tuple[Board, ...], Field(min_length=1, max_length=MOST_BOARDS)] = Field(
        description="one table [[boards]] for each board, with corner_mm, size_mm and mass_kg"
    )

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Extents of the carrier along x, y and z, mm. The extent along z is the height of the carrier's top above the
        floor."""
        return self._end(0), self._end(1), self._end(2)

    def _end(self, axis: int) -> float:
        return max(board.corner_mm[axis] + board.size_mm[axis] for board in self.boards)

    @property
    def masses_kg(self) -> tuple[float, ...]:
        """Mass of each board, kg."""
        if self.mass_kg is None:
            return tuple(board.mass_kg or 0.0 for board in self.boards)
        volume = sum(board.volume_mm3 for board in self.boards)
        return tuple(self.mass_kg * board.volume_mm3 / volume for board in self.boards)

    @property
    def frictions(self) -> tuple[float | None, ...]:
        """The coefficient of friction of each board. None means that the board has the value ``carrier_friction`` of
        ``petmjx.Physics``."""
        return tuple(self.friction if board.friction is None else board.friction for board in self.boards)

    @property
    def materials(self) -> tuple[str, ...]:
        """The material of each board."""
        return tuple(board.material or self.material for board in self.boards)

    @model_validator(mode="after")
    def _opens_its_walls(self) -> Self:
        self.walls.check_open()  # walls are checked here, so that the message names the carrier's file
        return self

    @model_validator(mode="after")
    def _can_be_a_carrier(self) -> Self:
        for check in (_check_sizes, _check_masses, _check_origin, _check_one_piece, _check_top, _check_stand):
            check(self)
        return self


# Checks of a carrier. Each check raises an error of one line.


def _board_label(carrier: OwnCarrier, board: int) -> str:
    name = carrier.boards[board].name
    return f"boards[{board}]" + (f" ({printable_name(name)})" if name else "")


def _check_sizes(carrier: OwnCarrier) -> None:
    x, y, height = carrier.size_mm
    extents = f": the boards together are {x:g} × {y:g} × {height:g} mm"
    longer = max(x, y)
    if longer < _SHORTEST_MM:
        low, high = _USUAL_MM
        units = " or ".join(name for factor, name in _UNITS if low <= factor * longer <= high)
        note = f"is that in {units}? Lengths are in mm" if units else f"no side reaches {_SHORTEST_MM:g} mm"
        raise complaint(f"{extents}: {note}")
    if longer > _LONGEST_MM:
        raise complaint(f"{extents}: no side may be longer than {_LONGEST_MM:g} mm")
    if height > _HIGHEST_MM:
        raise complaint(f"{extents}: a carrier is at most {_HIGHEST_MM:g} mm high")


def _check_masses(carrier: OwnCarrier) -> None:
    for number, board in enumerate(carrier.boards):
        location = ("boards", number, "mass_kg")
        if carrier.mass_kg is None and board.mass_kg is None:
            raise complaint("is missing: give a mass to each board, or give the carrier's mass_kg", *location)
        if carrier.mass_kg is not None and board.mass_kg is not None:
            raise complaint("contradicts the carrier's mass_kg: drop one of them", *location)
    for number, (board, mass_kg) in enumerate(zip(carrier.boards, carrier.masses_kg, strict=True)):
        density = mass_kg / (board.volume_mm3 / MM_PER_M**3)
        if not _LIGHTEST_KG_M3 <= density <= _HEAVIEST_KG_M3:
            than = "heavier than lead; is the mass in grams?" if density > _HEAVIEST_KG_M3 else "lighter than foam"
            raise complaint(
                f": {_board_label(carrier, number)}: a mass of {mass_kg:.4g} kg means {density:.3g} kg/m³, {than}"
            )
    total = sum(carrier.masses_kg)
    if not _LIGHTEST_KG <= total <= _HEAVIEST_KG:
        limits = f"from {_LIGHTEST_KG:g} to {_HEAVIEST_KG:g} kg"
        raise complaint(f": the boards together have {total:.4g} kg, but must have {limits}")


def _check_origin(carrier: OwnCarrier) -> None:
    for axis, name in enumerate("xyz"):
        least = min(board.corner_mm[axis] for board in carrier.boards)
        if least > _ROUNDING_MM:
            fault = (
                "no board is on the floor, z = 0" if name == "z" else "the carrier's front-left corner is the origin"
            )
            raise complaint(f": the least {name} of all boards is {least:g} mm, but must be 0: {fault}")


def _check_one_piece(carrier: OwnCarrier) -> None:
    n = len(carrier.boards)
    joined = [{board} for board in range(n)]
    for one, two in itertools.combinations(range(n), 2):
        shared = min(_shared_mm(carrier.boards[one], carrier.boards[two]))
        if shared > TOUCH_MM:
            pair_text = f"{_board_label(carrier, one)} and {_board_label(carrier, two)}"
            raise complaint(f": {pair_text} overlap by {shared:.3g} mm")
        if shared >= -TOUCH_MM:
            joined[one].add(two)
            joined[two].add(one)
    piece, queue = {0}, [0]
    while queue:
        neighbours = joined[queue.pop()] - piece
        piece |= neighbours
        queue += neighbours
    apart = sorted(set(range(n)) - piece)
    if apart:
        raise complaint(
            f": {_board_label(carrier, apart[0])} is separate from {_board_label(carrier, 0)}: a carrier must be in "
            "one piece"
        )


def _shared_mm(one: Board, two: Board) -> tuple[float, ...]:
    """The lengths by which two boards overlap along x, y and z, mm. A negative length is a gap between the boards."""
    return tuple(
        min(one.corner_mm[k] + one.size_mm[k], two.corner_mm[k] + two.size_mm[k])
        - max(one.corner_mm[k], two.corner_mm[k])
        for k in range(3)
    )


def _check_top(carrier: OwnCarrier) -> None:
    height = carrier.size_mm[2]
    for number, board in enumerate(carrier.boards):
        lower = height - board.corner_mm[2] - board.size_mm[2]
        if _ROUNDING_MM < lower < _LEVEL_MM and not any(_bears(board, other) for other in carrier.boards):
            level = f"a carrier's top must be level, and the highest board ends at {height:g} mm"
            raise complaint(f": {_board_label(carrier, number)} ends {lower:.3g} mm below the top: {level}")


def _bears(lower: Board, upper: Board) -> bool:
    *sides, gap = _shared_mm(lower, upper)
    return min(sides) > TOUCH_MM and abs(gap) <= TOUCH_MM and upper.corner_mm[2] > lower.corner_mm[2]


def _check_stand(carrier: OwnCarrier) -> None:
    """Check that the carrier does not tip over: its centre of mass must be above the convex hull of the boards on the
    floor.

    The directions from the centre of mass to the corners of these boards are sorted by angle. The centre of mass is
    above the hull if no two neighbouring directions differ by 180° or more.
    """
    masses = carrier.masses_kg
    x, y = (
        sum(
            mass * (board.corner_mm[k] + board.size_mm[k] / 2)
            for mass, board in zip(masses, carrier.boards, strict=True)
        )
        / sum(masses)
        for k in (0, 1)
    )
    on_floor = [board for board in carrier.boards if board.corner_mm[2] <= _ROUNDING_MM]
    corners = [
        (board.corner_mm[0] + i * board.size_mm[0] - x, board.corner_mm[1] + j * board.size_mm[1] - y)
        for board in on_floor
        for i, j in itertools.product((0, 1), repeat=2)
    ]
    angles = sorted(math.atan2(dy, dx) for dx, dy in corners)
    widest = max(b - a for a, b in itertools.pairwise([*angles, angles[0] + 2 * math.pi]))
    if widest >= math.pi:
        place_text = f"its centre of mass, at x = {x:.4g} and y = {y:.4g} mm, is not over the boards on the floor"
        raise complaint(f": the carrier tips over: {place_text}")


# Carriers from options and from files.


def read_carrier(path: Path) -> OwnCarrier:
    """Read a carrier from its TOML file.

    Raises:
        InputError: the file does not define a valid carrier. The message is one line with the file, the board and the
            field, such as "mine.toml: boards[3].size_mm[2] must be > 0, got 0".
    """
    tables = read_toml(path)
    try:
        return OwnCarrier.read({"name": printable(path.stem)[:_MOST_NAME], **tables})
    except InputError as error:
        raise InputError(f"{printable(str(path))}: {error}") from None


def carrier_given(value: Any, info: ValidationInfo) -> Any:
    """Validator of options whose value is a carrier: the name of a built-in carrier, or the path of a TOML file.

    If the value is a mapping or a record, the validator returns it unchanged, because other code checks it later. A
    path in a sweep file is relative to the folder of the sweep file.
    """
    if isinstance(value, str) and value in set(Carrier):
        return Carrier(value)
    if isinstance(value, Path) or (isinstance(value, str) and value.lower().endswith(".toml")):
        folder = info.context.parent if isinstance(info.context, Path) else Path()
        return read_carrier(folder / value)
    if isinstance(value, Mapping | OwnCarrier):
        return value
    names = ", ".join(f"'{name}'" for name in Carrier)
    close = similar(value, Carrier) if isinstance(value, str) else ""
    raise ValueError(f"must be {names} or a TOML file of boards, {shown_value(value)}{close}")


AnyCarrier = Annotated[
    Annotated[Carrier, Tag(VALUE)] | Annotated[OwnCarrier, Tag(TABLE)],
    Discriminator(shape),
    BeforeValidator(carrier_given),
]
"""A built-in carrier, or a carrier that a user defines."""


def extent_m(carrier: Carrier | OwnCarrier) -> tuple[float, float] | None:
    """The extents of a carrier along x and y, m. None means that the carrier is as large as the plan's bounding box."""
    if isinstance(carrier, Carrier):
        return CARRIER_EXTENT_M[carrier]
    x, y, _ = carrier.size_mm
    return x / MM_PER_M, y / MM_PER_M


def walls_of(carrier: Carrier | OwnCarrier, walls: Walls) -> Walls:
    """The walls of a carrier, with a value for each field except possibly ``friction``. A field that the user does not
    set has the carrier's value, or, if the carrier has none, the value from ``USUAL_WALLS``."""
    of_carrier = carrier.walls if isinstance(carrier, OwnCarrier) else WALLS_OF_CARRIERS.get(carrier, USUAL_WALLS)
    return walls.or_of(of_carrier).or_of(USUAL_WALLS)
