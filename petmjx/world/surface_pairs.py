"""Tables with the friction and the landings (bounces after impacts) of pairs of surfaces.

Without a table, the friction between two shapes is the larger of their coefficients. A table of friction is needed if
coefficients are given for pairs of materials, or for boards. Each shape then has a surface, numbered from 1. The table
holds the coefficient of sliding friction for each pair of surfaces. Two boxes have the same surface if they have the
same material. Two boards have the same surface if they have the same material and coefficient. The floor has surface 0.
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
"""Largest number of surfaces of a world, including surface 0. On a GPU, a world's tables of friction and landings have
this number of rows, one per surface."""

NOT_GIVEN: Final = -1.0
"""Marks an entry without a value in a table of pairs of surfaces. A contact with such an entry has the larger friction
coefficient of the two shapes, as is usual in MuJoCo. Its restitution, its landing time (time in which a landing box is
stopped) and its kinetic friction as a share of static friction are those of ``Physics``."""


def scaled_pairs(
    table: FloatArray | None, of_boards: NDArray[np.intp] | None, box_factor: float, carrier_factor: float
) -> FloatArray | None:
    """(k, k) the table of friction, multiplied by a factor for boxes and a factor for the carrier.

    An entry for a box and the carrier is multiplied by the larger of the two factors, since a contact without an entry
    has the larger one of its two bodies' coefficients.

    Args:
        table: (k, k) the table of friction. If ``table`` is None, the result is None.
        of_boards: surface numbers of the carrier's boards. If ``of_boards`` is None, boards have no surface numbers.
        box_factor, carrier_factor: the two factors.
    """
    if table is None:
        return None
    factor = np.full(len(table), box_factor)
    if of_boards is not None:
        factor[of_boards] = carrier_factor
    return np.where(table == NOT_GIVEN, NOT_GIVEN, table * np.maximum.outer(factor, factor))


def filled_up(table: FloatArray | None, entry: tuple[int, ...] = ()) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``, …) a world's table with an entry for each pair of surfaces: friction,
    kinetic friction, or landings (restitution and landing time). Entries that ``table`` lacks are ``NOT_GIVEN``.

    Args:
        table: (k, k, …) the table. If ``table`` is None, no entry has a value.
        entry: shape of an entry: (2,) for landings, () for friction.
    """
    filled = np.full((MOST_SURFACES, MOST_SURFACES, *entry), NOT_GIVEN)
    if table is not None:
        filled[: len(table), : len(table)] = table
    return filled


_UNKNOWN_MATERIAL: Final = ""
"""Stands for the material of a box if the plan gives no material."""


class Surfaces(NamedTuple):
    """The surfaces of a world.

    Attributes:
        of_boxes: (n,) surface number of each box.
        of_boards: (s,) surface number of each board and wall of the carrier.
        friction: (k, k) coefficient of sliding friction between two surfaces; ``NOT_GIVEN`` if the larger friction of
            the two bodies acts.
        landing: (k, k, 2) coefficient of restitution between two surfaces, and time in which a landing box is stopped,
            s. ``NOT_GIVEN``: the value of ``Physics`` acts.
        kinetic: (k, k) kinetic friction between two surfaces as a share of their static friction. ``NOT_GIVEN``: the
            share of ``Physics`` acts. If ``kinetic`` is None, no pair has a share of its own.
    """

    of_boxes: NDArray[np.intp]
    of_boards: NDArray[np.intp]
    friction: FloatArray
    landing: FloatArray
    kinetic: FloatArray | None


def find_surfaces(plan: Plan, sim: Simulation) -> Surfaces | None:
    """The surfaces of a plan's boxes and of its carrier's boards and walls.

    The result is None if no box has a material and no board has a coefficient of its own. The result is also None if
    the physics uses pyramidal friction cones, since pyramidal cones allow no friction of pairs. Between a box and a
    board, the coefficient of the board is used if it has one, otherwise the coefficient of the two materials. If a box
    has no material, the larger coefficient of the two shapes is used.

    Raises:
        InputError: the friction between two of the materials is unknown, or there are too many surfaces.
    """
    boards = carrier_surfaces(sim)
    materials = plan.materials or (_UNKNOWN_MATERIAL,) * plan.n_boxes
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
            f"surfaces (combinations of material and friction), got {len(of_boxes) + len(of_boards)}"
        )
    n = 1 + len(of_boxes) + len(of_boards)
    table, landing, kinetic = np.full((n, n), NOT_GIVEN), np.full((n, n, 2), NOT_GIVEN), np.full((n, n), NOT_GIVEN)
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
        kinetic if (kinetic != NOT_GIVEN).any() else None,
    )


def check_surfaces(plans: Iterable[Plan], sim: Simulation) -> list[str]:
    """Check that friction is known between all materials of each plan. Returns notes for the user if materials or
    stiffness have no effect.

    Raises:
        InputError: for one of the plans, ``find_surfaces`` raises an error.
    """
    plans = list(plans)
    with_materials = [plan for plan in plans if plan.materials]
    notes = []
    if not sim.physics.has_own_friction and any(plan.stiffness_n_mm is not None for plan in plans):
        notes.append("stiffness has no effect: with pyramidal cones, physics options set the stiffness of all contacts")
    if not with_materials:
        return notes
    if not sim.physics.has_own_friction:
        return [
            *notes,
            "materials have no effect: with pyramidal cones, physics options set the friction of all contacts",
        ]
    for plan in with_materials:
        find_surfaces(plan, sim)
    return notes


def _pair_friction(one: str, other: str, sim: Simulation) -> float:
    """The entry of two materials in the table of friction.

    A pair without known friction also gets ``NOT_GIVEN``, which has no effect: ``check_pairs`` has made sure that
    bodies with this pair of materials never touch.
    """
    friction = friction_between(one, other, sim.friction_pairs) if one and other else None
    return NOT_GIVEN if friction is None else friction


def _kinetic(one: str, other: str, sim: Simulation) -> float:
    """The entry of two materials in the table of kinetic friction as a share of static friction."""
    share = kinetic_share_between(one, other, sim.friction_pairs) if one and other else None
    return NOT_GIVEN if share is None else share


def _landing(one: str, other: str, sim: Simulation) -> tuple[float, float]:
    """The entry of two materials in the table of restitutions and landing times."""
    if not (one and other):
        return NOT_GIVEN, NOT_GIVEN
    restitution, landing_s = landing_between(one, other, sim.landing_pairs)
    return NOT_GIVEN if restitution is None else restitution, NOT_GIVEN if landing_s is None else landing_s
