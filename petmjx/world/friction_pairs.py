"""Tables of friction and landings by pairs of surfaces, and the surfaces of a plan's world.

A table is used if the coefficient between two shapes is not the larger of their own coefficients. Shapes have surfaces,
numbered from 1. The table has the coefficient of sliding friction of each pair of surfaces. The floor and all shapes
without a surface of their own have surface 0. Surfaces follow from the materials of boxes and boards, and from the
boards' own friction.
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
"""Rows of a world's table on devices, surface 0 included."""

LARGER: Final = -1.0
"""Marks an entry without a coefficient: the larger coefficient of the two shapes counts, as everywhere in
MuJoCo."""


USUAL: Final = -1.0
"""Marks an entry without a restitution, a time of a landing, or a share of kinetic friction: the value of the physics
counts."""


def no_landings(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k, 2) a table of landings without entries."""
    return np.full((n_surfaces, n_surfaces, 2), USUAL)


def no_pairs(n_surfaces: int = MOST_SURFACES) -> FloatArray:
    """(k, k) a table of friction without entries."""
    return np.full((n_surfaces, n_surfaces), LARGER)


def scaled_pairs(
    table: FloatArray | None, of_boards: NDArray[np.intp] | None, box_factor: float, carrier_factor: float
) -> FloatArray | None:
    """(k, k) a table with the friction of boxes and carrier changed by factors.

    Between two surfaces the larger factor counts, as the larger coefficient does for a pair without an entry.

    Args:
        of_boards: the surfaces of the carrier's boards; None: the boards have no surfaces of their own.
    """
    if table is None:
        return None
    factor = np.full(len(table), box_factor)
    if of_boards is not None:
        factor[of_boards] = carrier_factor
    return np.where(table == LARGER, LARGER, table * np.maximum.outer(factor, factor))


def filled_up(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``) a world's table, padded with rows without entries.

    Raises:
        ValueError: the table has more rows.
    """
    filled = no_pairs()
    if table is not None:
        if len(table) > MOST_SURFACES:
            raise ValueError(f"at most {MOST_SURFACES} surfaces, got {len(table)}")
        filled[: len(table), : len(table)] = table
    return filled


def filled_up_shares(table: FloatArray | None) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``) a world's shares of kinetic friction, padded with rows without entries."""
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
"""The material of a box without a material in the plan."""


class Surfaces(NamedTuple):
    """The surfaces of a world.

    Attributes:
        of_boxes: (n,) surface of each box.
        of_boards: (s,) surface of each board and wall of the carrier.
        friction: (k, k) coefficients between surfaces, or ``LARGER``.
        landing: (k, k, 2) restitution and time of a landing, s, between surfaces.
        kinetic: (k, k) friction of sliding surfaces, as a share of friction at rest, or ``USUAL``; None: no
            pair has a share.
    """

    of_boxes: NDArray[np.intp]
    of_boards: NDArray[np.intp]
    friction: FloatArray
    landing: FloatArray
    kinetic: FloatArray | None


def find_surfaces(plan: Plan, sim: Simulation) -> Surfaces | None:
    """The surfaces of a plan's boxes and of its carrier's boards and walls.

    None if boxes have no materials and boards have no friction of their own, and with pyramidal cones, which have no
    friction by pairs. Between a box and a board the friction of the board counts if it has one, otherwise the friction
    of the two materials. If a box has no material, the larger coefficient of two shapes counts.

    Raises:
        InputError: friction between two of the materials is not known, or there are too many surfaces.
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
            f"plan {printable_name(plan.plan_id)}: at most {MOST_SURFACES - 1} surfaces of boxes and boards, got "
            f"{len(of_boxes) + len(of_boards)}"
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
    """Check that friction between all materials of all plans is known; a line if materials or stiffness have no effect.

    Raises:
        InputError: as ``find_surfaces``.
    """
    plans = list(plans)
    with_materials = [plan for plan in plans if plan.materials]
    notes = []
    if not sim.physics.has_own_friction and any(plan.stiffness_n_mm is not None for plan in plans):
        notes.append("stiffness has no effect: with pyramidal cones all contacts follow physics alone")
    if not with_materials:
        return notes
    if not sim.physics.has_own_friction:
        return [*notes, "materials have no effect: with pyramidal cones only the friction of boxes and carrier counts"]
    for plan in with_materials:
        find_surfaces(plan, sim)
    return notes


def _pair_friction(one: str, other: str, sim: Simulation) -> float:
    """The entry of a table for a pair of materials. Bodies of an unknown pair never touch (``check_pairs``)."""
    friction = friction_between(one, other, sim.friction_pairs) if one and other else None
    return LARGER if friction is None else friction


def _kinetic(one: str, other: str, sim: Simulation) -> float:
    """The entry of a table of shares of kinetic friction for a pair of materials."""
    share = kinetic_share_between(one, other, sim.friction_pairs) if one and other else None
    return USUAL if share is None else share


def _landing(one: str, other: str, sim: Simulation) -> tuple[float, float]:
    """The entry of a table of landings for a pair of materials."""
    if not (one and other):
        return USUAL, USUAL
    restitution, landing_s = landing_between(one, other, sim.landing_pairs)
    return USUAL if restitution is None else restitution, USUAL if landing_s is None else landing_s
