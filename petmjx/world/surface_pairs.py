"""Tables of pairs of surfaces: the values of contacts that depend on materials, such as friction
(``petmjx.options.materials.PAIR_TABLES`` lists them all).

Without a table, the friction between two shapes is the larger of their coefficients. Tables are needed if coefficients
are given for pairs of materials, or for boards. Each shape then has a surface, numbered from 1, and a table has an
entry for each pair of surfaces. Two boxes have the same surface if they have the same material. Two boards have the
same surface if they have the same material and coefficient. The floor has surface 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.options.materials import PAIR_TABLES, check_pairs
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.carrier_boards import carrier_surfaces

MOST_SURFACES: Final = 16
"""Largest number of surfaces of a world, including surface 0. On a device, the tables of a world have this number of
rows, one per surface."""

NOT_GIVEN: Final = -1.0
"""Marks a number that is not given in a table of pairs of surfaces. A contact without a friction of its pair has the
larger friction coefficient of the two shapes, as is usual in MuJoCo. All other values that are not given are the values
of ``Physics``."""

Pairs = Mapping[str, FloatArray]
"""Name of a ``PairTable`` → (k, k, …) table of a world, with an entry for each pair of surfaces. A table without any
value is left out."""


def scaled_pairs(pairs: Pairs, of_boards: NDArray[np.intp] | None, box_factor: float, carrier_factor: float) -> Pairs:
    """The tables, with their friction multiplied by a factor for boxes and a factor for the carrier.

    An entry for a box and the carrier is multiplied by the larger of the two factors, since a contact without an entry
    has the larger one of its two bodies' coefficients.

    Args:
        of_boards: surface numbers of the carrier's boards. If ``of_boards`` is None, boards have no surface numbers.
        box_factor, carrier_factor: the two factors.
    """
    if "friction" not in pairs:
        return pairs
    friction = pairs["friction"]
    factor = np.full(len(friction), box_factor)
    if of_boards is not None:
        factor[of_boards] = carrier_factor
    scaled = np.where(friction == NOT_GIVEN, NOT_GIVEN, friction * np.maximum.outer(factor, factor))
    return {**pairs, "friction": scaled}


_ENTRY_OF_TABLE: Final = {table.name: table.entry for table in PAIR_TABLES}


def filled_up(pairs: Pairs, name: str) -> FloatArray:
    """(``MOST_SURFACES``, ``MOST_SURFACES``, …) the table of this name. Entries that ``pairs`` lacks are
    ``NOT_GIVEN``."""
    filled = np.full((MOST_SURFACES, MOST_SURFACES, *_ENTRY_OF_TABLE[name]), NOT_GIVEN)
    if name in pairs:
        n = len(pairs[name])
        filled[:n, :n] = pairs[name]
    return filled


_UNKNOWN_MATERIAL: Final = ""
"""Stands for the material of a box if the plan gives no material."""


class Surfaces(NamedTuple):
    """The surfaces of a world.

    Attributes:
        of_boxes: (n,) surface number of each box.
        of_boards: (s,) surface number of each board and wall of the carrier.
        pairs: the tables of pairs of surfaces.
    """

    of_boxes: NDArray[np.intp]
    of_boards: NDArray[np.intp]
    pairs: Pairs


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
    surfaces = [*((None, material) for material in of_boxes), *of_boards]
    if 1 + len(surfaces) > MOST_SURFACES:
        raise InputError(
            f"plan {printable_name(plan.plan_id)}: boxes and boards may have at most {MOST_SURFACES - 1} different "
            f"surfaces (combinations of material and friction), got {len(surfaces)}"
        )
    pairs = {}
    for table in PAIR_TABLES:
        values = np.full((1 + len(surfaces), 1 + len(surfaces), *table.entry), np.nan)
        for row, one in enumerate(of_boxes, start=1):
            for column, (friction, other) in enumerate(surfaces, start=1):
                entry = table.between(one, other, friction, sim)
                values[row, column] = values[column, row] = entry  # None becomes NaN
        # a friction that is unknown is not given either: bodies of such pairs never touch (check_pairs)
        if not np.isnan(values).all():
            pairs[table.name] = np.nan_to_num(values, nan=NOT_GIVEN)
    return Surfaces(
        np.array([1 + of_boxes.index(material) for material in materials]),
        np.array([1 + len(of_boxes) + of_boards.index(board) for board in boards]),
        pairs,
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
