"""Forces at points where bodies touch, as force and moment on each body."""

from __future__ import annotations

from typing import Final

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.statics.contacts import IntArray
from petmjx.statics.largest import Entries

WRENCH: Final = 6
"""Rows of a body: its force and its moment about its centre."""


def wrenches(
    first: IntArray, second: IntArray, position_m: FloatArray, direction: FloatArray, centre_m: FloatArray
) -> Entries:
    """(6 b, p k): force and moment about its centre of every body by k forces at each of p points.

    Args:
        first, second: (p,) the bodies that touch, from 0 to b - 1; negative: one that does not move.
        position_m: (p, 3).
        direction: (p, k, 3) the forces on ``second``; those on ``first`` are their opposites.
        centre_m: (b, 3) centres of the bodies.
    """
    n_points, n_forces, _ = direction.shape
    column_of = np.arange(n_points * n_forces).reshape(n_points, n_forces)
    values, rows, columns = [], [], []
    for body, sign in ((second, 1.0), (first, -1.0)):
        at = np.flatnonzero(body >= 0)
        force = sign * direction[at]
        arm = (position_m[at] - centre_m[body[at]])[:, None, :]
        wrench = np.concatenate([force, np.cross(arm, force)], axis=-1)
        row = np.broadcast_to(WRENCH * body[at][:, None, None] + np.arange(WRENCH), wrench.shape)
        values.append(wrench.ravel())
        rows.append(row.ravel())
        columns.append(np.repeat(column_of[at].ravel(), WRENCH))
    return Entries(np.concatenate(values), np.concatenate(rows), np.concatenate(columns))
