"""Carriers made of boards: pallets with gaps between their boards, like real pallets.

A board is a cuboid, given as (front-left-bottom corner, size), mm. In this module, the pallet's front-left corner is at
the origin, and its bottom is at z = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.options.carriers import TOUCH_MM, Carrier, OwnCarrier, walls_of
from petmjx.options.materials import STEEL, TRAILER_FLOOR, WOOD
from petmjx.options.physics import Physics, Triple
from petmjx.options.simulation import Simulation
from petmjx.world.body_shapes import Body

Board = tuple[Triple, Triple]


@dataclass(frozen=True)
class Pallet:
    """A pallet made of boards.

    Attributes:
        boards: corner and size of each board, mm.
        masses_kg: mass of each board.
        frictions: coefficient of sliding friction of each board. An entry None stands for ``Physics.carrier_friction``.
            If ``frictions`` is empty, all boards have ``Physics.carrier_friction``.
        materials: material of each board. If ``materials`` is empty, all boards are wooden.
    """

    boards: tuple[Board, ...]
    masses_kg: tuple[float, ...]
    frictions: tuple[float | None, ...] = ()
    materials: tuple[str, ...] = ()

    @property
    def height_mm(self) -> float:
        """Height of the top of the deck above the floor."""
        return max(corner[2] + size[2] for corner, size in self.boards)

    @property
    def deck_mm(self) -> FloatArray:
        """(b, 2, 2) lowest and highest corner (x, y) of each board that reaches the top of the pallet."""
        corner, size = np.array(self.boards, np.float64).swapaxes(0, 1)
        end = corner + size
        on_top = end[:, 2] >= self.height_mm - TOUCH_MM
        return np.stack([corner, end], axis=1)[on_top, :, :2]


def _spread(length: float, widths: tuple[float, ...]) -> list[float]:
    """Positions along ``length`` at which boards of the given widths begin, mm. The outer boards are flush with the
    ends, and all gaps are equal."""
    gap = (length - sum(widths)) / (len(widths) - 1)
    return [sum(widths[:k]) + k * gap for k in range(len(widths))]


def _by_volume(boards: Sequence[Board], mass_kg: float) -> tuple[float, ...]:
    """The mass of each board, kg, if the boards have the mass ``mass_kg`` in all, and the same density."""
    volume = np.array([size for _, size in boards]).prod(axis=1)
    return tuple((mass_kg * volume / volume.sum()).tolist())


def _epal_1() -> Pallet:
    """The EPAL 1 pallet of EN 13698-1: 1200 × 800 × 144 mm, about 25 kg. The pallet has five deck boards on three cross
    boards, nine blocks, and three bottom boards."""
    length, width, board, block = 1200.0, 800.0, 22.0, 78.0
    deck, rows, columns = (145.0, 100.0, 145.0, 100.0, 145.0), (100.0, 145.0, 100.0), (145.0, 145.0, 145.0)
    x, y = _spread(length, columns), _spread(width, rows)
    top = 2 * board + block
    boards: list[Board] = []
    boards += [((0, at, top), (length, wide, board)) for at, wide in zip(_spread(width, deck), deck, strict=True)]
    boards += [((at, 0, board + block), (wide, width, board)) for at, wide in zip(x, columns, strict=True)]
    for at_x, long in zip(x, columns, strict=True):
        boards += [((at_x, at_y, board), (long, wide, block)) for at_y, wide in zip(y, rows, strict=True)]
    boards += [((0, at, 0), (length, wide, board)) for at, wide in zip(y, rows, strict=True)]
    return Pallet(tuple(boards), _by_volume(boards, 25.0))


def _gma() -> Pallet:
    """The GMA pallet of 48 × 40 in, as commonly built. The pallet has seven deck boards (two are 140 mm wide, five are
    89 mm), three stringers of 38 × 89 mm, and five bottom boards. Boards are 16 mm thick. The mass is 20 kg."""
    length, width, board, stringer, high = 1219.0, 1016.0, 16.0, 38.0, 89.0
    deck, bottom = (140.0, *[89.0] * 5, 140.0), (140.0, *[89.0] * 3, 140.0)
    boards: list[Board] = []
    boards += [
        ((at, 0, board + high), (wide, width, board)) for at, wide in zip(_spread(length, deck), deck, strict=True)
    ]
    boards += [((0, at, board), (length, stringer, high)) for at in _spread(width, (stringer,) * 3)]
    boards += [((at, 0, 0), (wide, width, board)) for at, wide in zip(_spread(length, bottom), bottom, strict=True)]
    return Pallet(tuple(boards), _by_volume(boards, 20.0))


def _pet_eur() -> Pallet:
    """The pallet of PET-Physics, the reference implementation (its file ``eur-pallet.xml`` of commit 7031863).

    The pallet consists of 20 cuboids of 2 kg each, some of which overlap by 4 mm. In simulations of PET-Physics, the
    pallet's deck is 5 mm above z = 0. In simulations of petmjx, the deck is at z = 0, as for all carriers.
    """
    middle, bottom_mm = np.array([600.0, 400.0, 0.0]), -72.0
    half_and_place: list[tuple[Triple, Triple]] = [((600, 75, 15), (0, y, 62)) for y in (-325, 0, 325)]
    half_and_place += [((600, 60, 15), (0, y, 62)) for y in (-162.5, 162.5)]
    half_and_place += [((75, 400, 7), (x, 0, 44)) for x in (-525, 0, 525)]
    half_and_place += [((68, 58, 44.5), (x, y, -7.5)) for x in (-532, 0, 532) for y in (-342, 0, 342)]
    half_and_place += [((600, 58, 10), (0, y, -62)) for y in (-342, 0, 342)]
    boards = []
    for half, place in half_and_place:
        x, y, z = (middle + place - half).tolist()
        boards.append(((x, y, z - bottom_mm), (2 * half[0], 2 * half[1], 2 * half[2])))
    return Pallet(tuple(boards), (2.0,) * len(boards))


def _rollcontainer_grid() -> Pallet:
    """The base of a roll container: 14 bars of 8 mm with gaps of 53 mm, on four tubes of 30 mm. The base is 200 mm high
    and weighs 25 kg.

    The bars are typical ones: no source was found for the bars of a certain maker. Length and width are as for the
    target ``rollcontainer`` in plans. Castors are modelled as blocks that do not roll, like the feet of a pallet.
    """
    length, width, bar, tube, castor, top = 800.0, 700.0, 8.0, 30.0, 60.0, 200.0
    under = top - bar - tube
    boards: list[Board] = [((at, 0, top - bar), (bar, width, bar)) for at in _spread(length, (bar,) * 14)]
    boards += [((0, at, under), (length, tube, tube)) for at in _spread(width, (tube,) * 4)]
    boards += [((x, y, 0), (castor, castor, under)) for x in (0.0, length - castor) for y in (0.0, width - castor)]
    return Pallet(tuple(boards), _by_volume(boards, 25.0), materials=(STEEL,) * len(boards))


def _gitterbox() -> Pallet:
    """The base of a steel box pallet: a floor of 30 mm on four feet. The base is 150 mm high and weighs 25 kg. UIC
    435-3 gives the sizes of the whole box pallet. The feet are modelled as plain blocks."""
    length, width, floor, foot, top = 1200.0, 800.0, 30.0, 100.0, 150.0
    boards: list[Board] = [((0, 0, top - floor), (length, width, floor))]
    boards += [((x, y, 0), (foot, foot, top - floor)) for x in (0.0, length - foot) for y in (0.0, width - foot)]
    return Pallet(tuple(boards), _by_volume(boards, 25.0), materials=(STEEL,) * len(boards))


def _container_20ft() -> Pallet:
    """The floor of a 20 ft container: 28 mm of wood on a frame. The floor is modelled as one slab, which is 150 mm high
    and weighs 900 kg."""
    boards: list[Board] = [((0, 0, 0), (5867.0, 2330.0, 150.0))]
    return Pallet(tuple(boards), (900.0,))


def _trailer() -> Pallet:
    """The floor of a semi-trailer: wood on a frame. The floor is modelled as one slab, which is 150 mm high and weighs
    6 t including the frame."""
    boards: list[Board] = [((0, 0, 0), (13600.0, 2480.0, 150.0))]
    return Pallet(tuple(boards), (6000.0,), materials=(TRAILER_FLOOR,))


BOARDS_OF_CARRIERS: Final[Mapping[Carrier, Callable[[], Pallet]]] = {
    Carrier.EPAL_1: _epal_1,
    Carrier.GMA_48X40: _gma,
    Carrier.PET_EUR: _pet_eur,
    **dict.fromkeys(
        (Carrier.ROLLCONTAINER_GRID, Carrier.ROLLCONTAINER_2, Carrier.ROLLCONTAINER_3, Carrier.ROLLCONTAINER_4),
        _rollcontainer_grid,
    ),
    Carrier.GITTERBOX: _gitterbox,
    Carrier.CONTAINER_20FT: _container_20ft,
    Carrier.TRAILER: _trailer,
}
"""Built-in carrier → function that makes its boards. Built-in carriers without an entry are slabs."""


@lru_cache(maxsize=16)
def pallet(carrier: Carrier | OwnCarrier) -> Pallet | None:
    """The boards of a carrier; None if the carrier is a slab."""
    if isinstance(carrier, OwnCarrier):
        boards = tuple((board.corner_mm, board.size_mm) for board in carrier.boards)
        return Pallet(boards, carrier.masses_kg, carrier.frictions, carrier.materials)
    return BOARDS_OF_CARRIERS[carrier]() if carrier in BOARDS_OF_CARRIERS else None


def body_of(board_pallet: Pallet, physics: Physics) -> Body:
    """The body of a pallet, with the pallet's deck at z = 0."""
    corner, size = (mm_to_m(np.array(part, np.float64)) for part in zip(*board_pallet.boards, strict=True))
    corner[:, 2] -= board_pallet.height_mm / MM_PER_M
    friction = np.tile(physics.carrier_friction, (len(size), 1))
    for board, sliding in enumerate(board_pallet.frictions):
        if sliding is not None:
            friction[board, 0] = sliding
    return Body.of_boards(corner + size / 2, size / 2, np.array(board_pallet.masses_kg), friction)


WALL_DEPTH_M: Final = 0.02
"""Largest depth to which walls reach below the carrier's top, m. Walls reach below the carrier's top so that no box
gets under them."""


def has_walls(sim: Simulation) -> bool:
    """Whether the carrier has walls. Walls that the option ``walls.open`` opens count as walls, too."""
    return bool(walls_of(sim.carrier, sim.walls).sides)


def with_walls(carrier: Body, sim: Simulation) -> Body:
    """A carrier with the walls that the options define, except open walls.

    A wall stands along a whole side, and also covers the ends of the adjacent walls.

    Args:
        carrier: the carrier without walls, with its top at z = 0.

    Raises:
        InputError: there is no room between the walls.
    """
    walls = walls_of(sim.carrier, sim.walls)
    if not walls.sides:
        return carrier
    if (fault := walls.room_fault(((carrier.high - carrier.low) * MM_PER_M).tolist())) is not None:
        raise InputError(fault)
    gap, thick, height = ((value or 0.0) / MM_PER_M for value in (walls.gap_mm, walls.thickness_mm, walls.height_mm))
    low, high = carrier.low[:2] - gap, carrier.high[:2] + gap
    below = min(WALL_DEPTH_M, -carrier.low[2] / 2)
    center, half = np.empty((len(walls.sides), 3)), np.empty((len(walls.sides), 3))
    for row, side in enumerate(walls.sides):
        along, across = 1 - side.axis, side.axis
        center[row, along], half[row, along] = (low + high)[along] / 2, (high - low)[along] / 2 + thick
        center[row, across] = high[across] + thick / 2 if side.is_far else low[across] - thick / 2
        half[row, across] = thick / 2
        center[row, 2], half[row, 2] = (height - below) / 2, (height + below) / 2
    area_m2 = 2 * height * np.array([half[row, 1 - side.axis] for row, side in enumerate(walls.sides)])
    friction = np.tile(sim.physics.carrier_friction, (len(half), 1))
    if walls.friction is not None:
        friction[:, 0] = walls.friction
    body = carrier.with_walls(center, half, (walls.mass_kg_m2 or 0.0) * area_m2, friction, walls.sides)
    return body.without_walls(walls.open)


def carrier_surfaces(sim: Simulation) -> list[tuple[float | None, str]]:
    """(coefficient of friction, material) of each shape of the carrier: first of its boards, then of the walls that are
    not open. The coefficient is None if ``Physics.carrier_friction`` applies."""
    board_pallet, walls = pallet(sim.carrier), walls_of(sim.carrier, sim.walls)
    count = 1 if board_pallet is None else len(board_pallet.boards)
    frictions, materials = ((), ()) if board_pallet is None else (board_pallet.frictions, board_pallet.materials)
    boards = zip(frictions or (None,) * count, materials or (WOOD,) * count, strict=True)
    return [*boards, *[(walls.friction, walls.material or "")] * len(walls.standing)]


def carrier_friction(sim: Simulation) -> float:
    """The largest coefficient of sliding friction of any board of the carrier."""
    board_pallet, usual = pallet(sim.carrier), sim.physics.carrier_friction[0]
    frictions = () if board_pallet is None else board_pallet.frictions
    return max((usual if friction is None else friction for friction in frictions), default=usual)


def floor_z_m(sim: Simulation) -> float:
    """Height of the floor, m. If the carrier is made of boards, its bottom is on the floor. If the carrier is a slab,
    the floor's height is ``Physics.floor_z_m``."""
    board_pallet = pallet(sim.carrier)
    return sim.physics.floor_z_m if board_pallet is None else -board_pallet.height_mm / MM_PER_M
