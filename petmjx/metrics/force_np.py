"""The force on top of each box, from C MuJoCo's contacts (NumPy). Twin of ``force_jax``."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray

VERTICAL_COSINE = math.cos(math.radians(45.0))
"""A contact is vertical if its normal is within 45° of z."""


def contact_normal_and_tangents(data: mujoco.MjData, pyramidal: bool) -> tuple[NDArray[np.intp], FloatArray]:
    """Forces of the contacts that have constraint rows.

    Pyramidal rows are forces along the four edges of the cone: the normal part is their sum, each tangent is the
    difference of its two edges × friction. Elliptic rows are the force itself. All contacts have condim 3. Source: as
    in ``force_jax.contact_force_z``.

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


def contact_force_z(force: FloatArray, frame_z: FloatArray) -> FloatArray:
    """(k,) world-z component of contact forces on their second geoms, N.

    Args:
        force: (k, 3) along normal and tangents, N.
        frame_z: (k, 3) z components of normal and tangents.
    """
    return np.asarray(np.einsum("kr,kr->k", force, frame_z))


def pressed_box(
    body: NDArray[np.integer], geom_z: FloatArray, normal_z: FloatArray
) -> tuple[NDArray[np.integer], FloatArray, NDArray[np.bool_]]:
    """Which box a contact presses on: the partner whose centre is lower.

    Args:
        body: (k, 2) partners: boxes, or negative numbers.
        geom_z: (k, 2) z of the centres of the shapes that touch, m.
        normal_z: (k,) z component of the unit normal.

    Returns:
        (k,) box index (negative for carrier and floor), (k,) sign by which the force on the second geom becomes a force
        that presses down on the lower one, (k,) whether the contact is vertical and its lower partner is a box.
    """
    first_is_lower = geom_z[:, 0] < geom_z[:, 1]
    box = np.where(first_is_lower, body[:, 0], body[:, 1])
    sign = np.where(first_is_lower, 1.0, -1.0)
    return box, sign, (np.abs(normal_z) >= VERTICAL_COSINE) & (box >= 0)


def top_forces(data: mujoco.MjData, bodies: NDArray[np.integer], n_boxes: int, pyramidal: bool) -> FloatArray:
    """(n_boxes,) force on top of each box, N (docs/metrics.md, "The force on a box's top").

    Sums the world-z part of contact forces whose normal is within 45° of z, for the partner whose centre is lower. The
    floor is lower than everything; floor and carrier are no boxes.

    Args:
        bodies: (ngeom,) of the geoms, as ``petmjx.world.model.geom_bodies`` gives them.
    """
    total = np.zeros(n_boxes)
    if data.ncon == 0:
        return total
    index, force = contact_normal_and_tangents(data, pyramidal)
    geom = np.asarray(data.contact.geom)[index]
    frame = np.asarray(data.contact.frame)[index].reshape(-1, 3, 3)
    centre_z = data.geom_xpos[:, 2].copy()
    centre_z[0] = -np.inf
    box, sign, counts = pressed_box(bodies[geom], centre_z[geom], frame[:, 0, 2])
    counts &= box < n_boxes
    np.add.at(total, box[counts], (sign * contact_force_z(force, frame[:, :, 2]))[counts])
    return total
