"""The force that presses on top of each box, from C MuJoCo's contacts (NumPy)."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.units import FloatArray

_COS_45 = float(np.sqrt(0.5))

FIRST_BOX_GEOM = 2
"""Geoms 0 and 1 are floor and carrier in every model of :mod:`petmjx.world.model`."""


def contact_normal_and_tangents(data: mujoco.MjData, pyramidal: bool) -> tuple[NDArray[np.intp], FloatArray]:
    """Forces of the contacts that have constraint rows.

    Pyramidal rows are forces along the four edges of the cone: the normal part is their sum, each tangent the
    difference of its pair of edges × friction. Elliptic rows are the force itself. All contacts have condim 3.

    Returns:
        (k,) indices of those contacts and (k, 3) forces in the contact frame (normal, tangents), N, as
        geom 1 exerts them on geom 2.
    """
    address = np.asarray(data.contact.efc_address)
    index = np.flatnonzero(address >= 0)
    first_row = address[index]
    if pyramidal:
        edges = data.efc_force[first_row[:, None] + np.arange(4)]
        friction = np.asarray(data.contact.friction)[index, :2]
        tangents = (edges[:, 0::2] - edges[:, 1::2]) * friction
        force = np.column_stack((edges.sum(axis=1), tangents))
    else:
        force = data.efc_force[first_row[:, None] + np.arange(3)]
    return index, force


def top_forces(data: mujoco.MjData, n_boxes: int, pyramidal: bool) -> FloatArray:
    """(n_boxes,) sum of what presses on each box from above, N.

    Counts the world-z part of every contact force whose normal lies within 45° of z, for the partner whose
    centre is lower; the floor is lower than everything, and floor and carrier are no boxes.
    """
    total = np.zeros(n_boxes)
    if data.ncon == 0:
        return total
    index, force = contact_normal_and_tangents(data, pyramidal)
    geoms = np.asarray(data.contact.geom)[index]
    frame = np.asarray(data.contact.frame)[index].reshape(-1, 3, 3)
    z_on_second = np.einsum("kr,kr->k", force, frame[:, :, 2])
    centre_z = data.geom_xpos[:, 2].copy()
    centre_z[0] = -np.inf
    first_is_lower = centre_z[geoms[:, 0]] < centre_z[geoms[:, 1]]
    lower = np.where(first_is_lower, geoms[:, 0], geoms[:, 1]) - FIRST_BOX_GEOM
    pressing = np.where(first_is_lower, z_on_second, -z_on_second)
    counted = (np.abs(frame[:, 0, 2]) >= _COS_45) & (lower >= 0) & (lower < n_boxes)
    np.add.at(total, lower[counted], pressing[counted])
    return total
