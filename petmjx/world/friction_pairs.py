"""Tables of friction and landings for pairs of surfaces, and the surfaces of a plan's world.

Usually, the friction between two shapes is the larger of their own coefficients. A table is used if other coefficients
are given for pairs. Each shape has a surface, numbered from 1. The table holds the coefficient of sliding friction for
each pair of surfaces. The floor, and all shapes without a surface of their own, have surface 0. Surfaces follow from
the materials of boxes and boards, and from the friction that boards have of their own.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.options.materials import check_pairs, friction_between, kinetic_share_between, landing_between
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.carrier_boards import carrier_surfaces

MOST_SURFACES: Final = 16
"""Number of rows of a world's table on devices, including surface 0."""

LARGER: Final = -1.0
"""Marks an entry without a coefficient: the larger coefficient of the two shapes counts, as is usual in MuJoCo."""


USUAL: Final = -1.0
"""Marks an entry without a restitution, landing time or share of kinetic friction: the value of the physics counts."""


def no_landings(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k, 2) a table of landings in which no entry has a value."""
    return np.full((n_surfaces, n_surfaces, 2), USUAL)


def no_pairs(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k) a table of friction in which no entry has a coefficient."""
    return np.full((n_surfaces, n_surfaces), LARGER)


def scaled_pairs(
    table: FloatArray | None, of_boards: NDArray[np.intp] | None, box_factor: float, carrier_factor: float
) -> FloatArray | None:
    """(k, k) the table, with the friction of boxes and carrier multiplied by factors.

    For a pair of surfaces the larger of the two factors counts, just as the larger coefficient counts for a pair
    without an entry.

    Args:
        of_boards: the surfaces of the carrier's boards; None: the boards have no surface of their own.
    """
    if table is None:
        return None
    factor = np.full(len(table), box_factor)
    if of_boards is not None:
        factor[of_boards] = carrier_factor
    return np.where(table == LARGER, LARGER, table * np.maximum.outer(factor, factor))


def filled_up(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``) a world's friction table, padded with rows without entries.

    Raises:
        ValueError: the table has too many rows.
    """
    filled = no_pairs()
    if table is not None:
        if len(table) > MOST_SURFACES:
            raise ValueError(f"at most {MOST_SURFACES} surfaces, got {len(table)}")
        filled[: len(table), : len(table)] = table
    return filled


def filled_up_shares(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``) a world's kinetic shares, padded with rows without entries."""
    filled = np.full((MOST_SURFACES, MOST_SURFACES), USUAL)
    if table is not None:
        filled[: len(table), : len(table)] = table
    return filled


def filled_up_landings(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``, 2) a world's table of landings, padded with rows without entries."""
    filled = no_landings()
    if table is not None:
        filled[: len(table), : len(table)] = table
    return filled


_NOT_SAID: Final = ""
"""Stands for the material of a box if the plan does not give one."""


class Surfaces(NamedTuple):
    """The surfaces of a world.

    Attributes:
        of_boxes: (n,) surface of each box.
        of_boards: (s,) surface of each board and wall of the carrier.
        friction: (k, k) coefficients between surfaces, or ``LARGER``.
        landing: (k, k, 2) restitution and landing time, s, between surfaces.
        kinetic: (k, k) friction of sliding surfaces, as a share of friction at rest, or ``USUAL``; None: no pair has a
            share of its own.
    """

    of_boxes: NDArray[np.intp]
    of_boards: NDArray[np.intp]
    friction: FloatArray
    landing: FloatArray
    kinetic: FloatArray | None


def find_surfaces(plan: Plan, sim: Simulation) -> Surfaces | None:
    """The surfaces of a plan's boxes and of its carrier's boards and walls.

    The result is None if neither boxes have materials nor boards have friction of their own. The result is also None
    with pyramidal cones, which have no friction by pairs. Between a box and a board, the friction of the board counts
    if it has one, otherwise the friction of the two materials. If a box has no material, the larger coefficient of the
    two shapes counts.

    Raises:
        InputError: the friction between two of the materials is unknown, or there are too many surfaces.
    """
    boards = carrier_surfaces(sim)
    materials = plan.materials or (_NOT_SAID,) * plan.n_boxes
    has_materials = any(materials)
    if not sim.physics.has_own_friction or not (has_materials or any(friction is not None for friction, _ in boards)):
        return None
    of_boxes, of_boards = sorted(set(materials)), sorted(set(boards), key=repr)
    if has_materials:
        of_materials = [material for friction, material in of_boards if friction is None]
        check_pairs([material for material in materials if material], of_materials, sim.friction_pairs)
    if 1 + len(of_boxes) + len(of_boards) > MOST_SURFACES:
        raise InputError(
            f"plan {printable_name(plan.plan_id)}: boxes and boards may have at most {MOST_SURFACES - 1} different "
            f"surfaces, got {len(of_boxes) + len(of_boards)}"
        )
    table = no_pairs(1 + len(of_boxes) + len(of_boards))
    landing, kinetic = no_landings(len(table)), np.full(table.shape, USUAL)
    for row, one in enumerate(of_boxes, start=1):
        for column, other in enumerate(of_boxes, start=1):
            table[row, column] = _pair_friction(one, other, sim)
            landing[row, column] = _landing(one, other, sim)
            kinetic[row, column] = _kinetic(one, other, sim)
        for column, (friction, material) in enumerate(of_boards, start=1 + len(of_boxes)):
            table[row, column] = table[column, row] = (
                friction if friction is not None else _pair_friction(one, material, sim)
            )
            landing[row, column] = landing[column, row] = _landing(one, material, sim)
            if friction is None:
                kinetic[row, column] = kinetic[column, row] = _kinetic(one, material, sim)
    surface_of = {material: row for row, material in enumerate(of_boxes, start=1)}
    surface_of_board = {board: row for row, board in enumerate(of_boards, start=1 + len(of_boxes))}
    return Surfaces(
        np.array([surface_of[material] for material in materials]),
        np.array([surface_of_board[board] for board in boards]),
        table,
        landing,
        kinetic if (kinetic != USUAL).any() else None,
    )


def check_surfaces(plans: Iterable[Plan], sim: Simulation) -> list[str]:
    """Check that friction is known between all materials of all plans. Returns a line if materials or stiffness have
    no effect.

    Raises:
        InputError: see ``find_surfaces``.
    """
    plans = list(plans)
    with_materials = [plan for plan in plans if plan.materials]
    notes = []
    if not sim.physics.has_own_friction and any(plan.stiffness_n_mm is not None for plan in plans):
        notes.append("stiffness has no effect: with pyramidal cones, all contacts have the stiffness that physics sets")
    if not with_materials:
        return notes
    if not sim.physics.has_own_friction:
        return [*notes, "materials have no effect: with pyramidal cones only the friction of boxes and carrier counts"]
    for plan in with_materials:
        find_surfaces(plan, sim)
    return notes


def _pair_friction(one: str, other: str, sim: Simulation) -> float:
    """A pair's entry in the table of friction. Bodies of an unknown pair never touch (``check_pairs``)."""
    friction = friction_between(one, other, sim.friction_pairs) if one and other else None
    return LARGER if friction is None else friction


def _kinetic(one: str, other: str, sim: Simulation) -> float:
    """A pair's entry in the table of shares of kinetic friction. A pair is two materials."""
    share = kinetic_share_between(one, other, sim.friction_pairs) if one and other else None
    return USUAL if share is None else share


def _landing(one: str, other: str, sim: Simulation) -> tuple[float, float]:
    """A pair's entry in the table of landings. A pair is two materials."""
    if not (one and other):
        return USUAL, USUAL
    restitution, landing_s = landing_between(one, other, sim.landing_pairs)
    return USUAL if restitution is None else restitution, USUAL if landing_s is None else landing_s
