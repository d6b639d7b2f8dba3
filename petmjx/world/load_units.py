"""Load units: pallets among the boxes of a plan, with boxes on them.

A pallet that stands on a trailer's floor, on a rack or on another load is an item of the plan, like a box. The item's
kind is the name of a pallet type, as for a carrier. The item's body has one shape per board, so that it slides, tips
and carries load as the real pallet does. The mass that the plan gives for the item is divided among the boards by
volume.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.options.carriers import Carrier
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import PALLET_SIZE_MM, PALLETS
from petmjx.world.body_shapes import Body, Pieces
from petmjx.world.carrier_boards import pallet


def with_pallets(
    plan: Plan, half_size: FloatArray, mass_center: FloatArray | None
) -> tuple[tuple[Pieces, ...], FloatArray | None, FloatArray | None]:
    """The boards of the pallets in a plan, and (n, 3) centres of mass and (n, 3) inertia boxes of all its boxes.

    The three results are the fields ``pieces``, ``mass_center`` and ``inertia_box`` of ``Scene``.

    Args:
        half_size: (n, 3) half extents of the boxes, m. Boards are scaled to the size of their pallet.
        mass_center: (n, 3) centres of mass that the plan gives, m. If ``mass_center`` is None, the centres of mass are
            in the boxes' middles.
    """
    if not plan.pallets:
        return (), mass_center, None
    centers = np.zeros_like(half_size) if mass_center is None else mass_center.copy()
    inertia_box, pieces = half_size.copy(), []
    for box, kind in plan.pallets.items():
        extent = np.array(PALLETS[kind])
        boards = _boards(kind, half_size[box])
        turned = abs(plan.size_mm[box, 0] - extent[0]) > PALLET_SIZE_MM
        if turned:
            order = [1, 0, 2]
            boards = replace(
                boards,
                pos=boards.pos[order],
                half_size=boards.half_size[:, order],
                shape_pos=boards.shape_pos[:, order],
                inertia_box=boards.inertia_box[order],
            )
        centers[box], inertia_box[box] = boards.pos, boards.inertia_box
        pieces.append(Pieces(box, boards.half_size, boards.pos + boards.shape_pos))
    return tuple(pieces), centers, inertia_box


def _boards(kind: str, half_size: FloatArray) -> Body:
    """The boards of a type of pallet, scaled to a pallet with (3,) half extents ``half_size``, m.

    The places of boards are relative to the middle of the pallet, m. The pallet is not rotated.
    """
    boards = pallet(Carrier(kind))
    assert boards is not None
    corner, size = (mm_to_m(np.array(part, np.float64)) for part in zip(*boards.boards, strict=True))
    extent = np.array(PALLETS[kind]) / MM_PER_M
    sides = np.sort(2 * half_size[:2])[::-1] if extent[0] >= extent[1] else np.sort(2 * half_size[:2])
    scale = np.append(sides, 2 * half_size[2]) / extent
    middle = (corner + size / 2 - extent / 2) * scale
    return Body.of_boards(middle, size / 2 * scale, np.array(boards.masses_kg), np.zeros((len(size), 3)))
