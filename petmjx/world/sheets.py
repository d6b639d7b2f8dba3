"""Interlayer sheets: thin items that carry nothing over gaps.

A sheet of cardboard or paper between two layers is an item of the plan, like a box. A rigid plate would carry a box
over a hole in the layer below, but a real sheet does not. So a sheet carries load only above the bodies that lie under
it in the plan. The sheet's body has one shape for each area that lies on a box or a board, or up to a centimetre above
one. The body has no shape over gaps. All shapes of a body move together: like a real sheet, the body ties the boxes of
a layer together by friction. Unlike a real sheet, the body does not sag or tear. A sheet under which nothing lies has a
single shape.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM
from petmjx.world.body_shapes import Body, Pieces

_TOUCH_M = DEFAULT_TOLERANCE_MM / MM_PER_M

FOLLOWED_M: Final = 0.01
"""Largest height of a sheet above a box's top at which the sheet still counts as lying on the box, m. Layers of cartons
are not level to a millimetre."""

_LEAST_OVERLAP_M = 1e-6


def pieces_of(
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
