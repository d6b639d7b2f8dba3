"""Items of a plan whose bodies consist of several pieces: interlayer sheets, and pallets among the boxes.

**Sheets** (docs/boxes-that-give.md). A rigid plate would carry a box over a hole in the layer below, but a real sheet
does not. So a sheet's body has one shape for each area that lies on a box or a board, or up to a centimetre above a box
or a board, and no shape over gaps. A sheet under which nothing lies has a single shape.

**Pallets** (docs/carriers.md). The item's kind is the name of a pallet type, as for a carrier. The item's body has one
shape per board, so that it slides, tips and carries load as the real pallet does. The mass that the plan gives for the
item is divided among the boards by volume.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.options.carriers import Carrier
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import PALLET_KINDS, PALLET_SIZE_MM
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM
from petmjx.world.body_shapes import Body
from petmjx.world.carrier_boards import pallet

_TOUCH_M: Final = DEFAULT_TOLERANCE_MM / MM_PER_M

FOLLOWED_M: Final = 0.01
"""Largest height of a sheet above a box's top at which the sheet still counts as lying on the box, m. Layers of cartons
are not level to a millimetre."""

_LEAST_OVERLAP_M: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Pieces:
    """The shapes of an item that consists of several solid cuboids.

    Attributes:
        box: number of the item among the boxes of the scene.
        half_size: (s, 3) half extents of the shapes, m.
        pos: (s, 3) middles of the shapes, relative to the middle of the item, m.
    """

    box: int
    half_size: FloatArray
    pos: FloatArray


def pieces_of_sheets(
    sheets: NDArray[np.bool_], target: FloatArray, half_size: FloatArray, carrier: Body
) -> tuple[Pieces, ...]:
    """The pieces into which sheets are divided.

    Args:
        sheets: (n,) whether each box is a sheet.
        target, half_size: (n, 3) planned middles and half extents of all boxes, m.
        carrier: the carrier. Sheets can also lie on those boards of the carrier whose tops are at z = 0.
    """
    pieces = []
    board, half = (carrier.pos + carrier.shape_pos)[: carrier.n_boards], carrier.half_size[: carrier.n_boards]
    low, high = np.vstack([target - half_size, board - half]), np.vstack([target + half_size, board + half])
    for box in np.flatnonzero(sheets).tolist():
        bottom = low[box, 2]
        gap = bottom - high[:, 2]
        below = (gap >= -_TOUCH_M) & (gap <= FOLLOWED_M)
        below[len(target) :] &= bottom <= _TOUCH_M
        below[box] = False
        area_low, area_high = np.maximum(low[below, :2], low[box, :2]), np.minimum(high[below, :2], high[box, :2])
        borne = ((area_high - area_low) > _LEAST_OVERLAP_M).all(axis=1)
        if borne.any():
            area_low, area_high = area_low[borne], area_high[borne]
            height = np.full((len(area_low), 1), half_size[box, 2])
            place = (area_low + area_high) / 2 - target[box, :2]
            pieces.append(Pieces(box, np.hstack([(area_high - area_low) / 2, height]), np.hstack([place, 0 * height])))
    return tuple(pieces)


def with_pallets(
    plan: Plan, half_size: FloatArray, mass_center: FloatArray | None
) -> tuple[tuple[Pieces, ...], FloatArray | None, FloatArray | None]:
    """Three fields of ``Scene`` for a plan: ``pieces``, the boards of the pallets among the boxes; ``mass_center``,
    (n, 3) centres of mass of all boxes, m; and ``inertia_box``, (n, 3) half extents of solid boxes with the same
    inertia, m.

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
        boards = _boards(kind, half_size[box])
        if abs(plan.size_mm[box, 0] - PALLET_KINDS[kind].size_mm[0]) > PALLET_SIZE_MM:  # the pallet is turned
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
    extent = np.array(PALLET_KINDS[kind].size_mm) / MM_PER_M
    sides = np.sort(2 * half_size[:2])[::-1] if extent[0] >= extent[1] else np.sort(2 * half_size[:2])
    scale = np.append(sides, 2 * half_size[2]) / extent
    middle = (corner + size / 2 - extent / 2) * scale
    return Body.of_boards(middle, size / 2 * scale, np.array(boards.masses_kg), np.zeros((len(size), 3)))
