"""The force on top of each box, from MuJoCo's contacts, in NumPy. petmjx/engines/mjx/top_forces.py does the same in
JAX.

The forces of many steps are computed together, from copies of the data of each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray

VERTICAL_COSINE = math.cos(math.radians(45.0))
"""A contact counts as vertical if the angle between its normal and the z axis is at most 45°."""


def contact_normal_and_tangents(data: mujoco.MjData, pyramidal: bool) -> tuple[NDArray[np.intp], FloatArray]:
    """The forces at the contacts that have constraint rows.

    The four rows of a pyramidal friction cone are forces along the edges of the cone. The normal force is the sum of
    the four forces. Each of the two tangential forces is the difference of two of the four forces, times the friction.
    The three rows of an elliptic cone are the components of the force. All contacts have condim 3. The source of these
    formulas is named in ``petmjx.engines.mjx.top_forces.contact_force_z``.

    Returns:
        (k,) numbers of these contacts, and (k, 3) forces of geom 1 on geom 2 in the contact frame (normal and two
        tangents), N.
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
    """(k,) z component, in world axes, of the force of each contact on its second geom, N.

    Args:
        force: (k, 3) forces along the normal and the tangents, N.
        frame_z: (k, 3) z components of the normal and the tangents.
    """
    return np.asarray(np.einsum("kr,kr->k", force, frame_z))


def pressed_box(
    body: NDArray[np.integer], normal_z: FloatArray
) -> tuple[NDArray[np.integer], FloatArray, NDArray[np.bool_]]:
    """The box on which each contact presses: of the two bodies, the body from which the normal points upwards. (The
    normal decides, not the heights of the centres: the centre of a box that leans may be lower than the centre of the
    box on which it lies.)

    Args:
        body: (k, 2) the two bodies of each contact: the number of a box, or a negative number for carrier and floor.
        normal_z: (k,) z components of the unit normals, which point from the first body to the second.

    Returns:
        (k,) number of the lower body (negative for carrier and floor); (k,) sign that turns the force on the second
        geom into a downward force on the lower geom; (k,) whether the contact is vertical and the lower body is a box.
    """
    first_is_lower = normal_z > 0
    box = np.where(first_is_lower, body[:, 0], body[:, 1])
    sign = np.where(first_is_lower, 1.0, -1.0)
    return box, sign, (np.abs(normal_z) >= VERTICAL_COSINE) & (box >= 0)


def top_forces(data: mujoco.MjData, bodies: NDArray[np.integer], n_boxes: int, pyramidal: bool) -> FloatArray:
    """(n_boxes,) force on top of each box, N (docs/metrics.md, "The force on a box's top").

    The force on a box is the sum of the z components at those contacts whose normal is within 45° of z and points
    upwards from the box.

    Args:
        bodies: (ngeom,) the body to which each geom belongs (``petmjx.world.mujoco_model.geom_bodies``).
    """
    total = np.zeros(n_boxes)
    if data.ncon == 0:
        return total
    index, force = contact_normal_and_tangents(data, pyramidal)
    geom = np.asarray(data.contact.geom)[index]
    frame = np.asarray(data.contact.frame)[index].reshape(-1, 3, 3)
    box, sign, counts = pressed_box(bodies[geom], frame[:, 0, 2])
    counts &= box < n_boxes
    np.add.at(total, box[counts], (sign * contact_force_z(force, frame[:, :, 2]))[counts])
    return total


class TopForceInputs(NamedTuple):
    """The data of one step from which forces on tops are computed, copied from MuJoCo's data.

    Attributes:
        address: (ncon,) number of the first constraint row of each contact. The number is negative if the contact has
            no row.
        geom: (ncon, 2) the two geoms of each contact.
        frame: (ncon, 9) normal and tangents of each contact.
        force: (nefc,) forces of all constraint rows, N.
        bodies: (ngeom,) the body to which each geom belongs (``petmjx.world.mujoco_model.geom_bodies``).
        n_boxes: number of boxes, in packing order, whose forces are computed.
    """

    address: NDArray[np.integer]
    geom: NDArray[np.integer]
    frame: FloatArray
    force: FloatArray
    bodies: NDArray[np.integer]
    n_boxes: int


def top_force_inputs(data: mujoco.MjData, bodies: NDArray[np.integer], n_boxes: int) -> TopForceInputs:
    """Copy the data of the last step. Copying takes a fifth of the time of ``top_forces``, which can later compute many
    steps together."""
    contact = data.contact
    address, geom, frame = contact.efc_address.copy(), contact.geom.copy(), contact.frame.copy()
    return TopForceInputs(address, geom, frame, data.efc_force.copy(), bodies, n_boxes)


def largest_top_forces(steps: Sequence[TopForceInputs], n_boxes: int) -> FloatArray:
    """(n_boxes,) the largest force on top of each box in these steps, N. Friction cones must be elliptic, and all steps
    must have the same ``bodies``. Computing many steps together is several times as fast as calling ``top_forces`` for
    each step."""
    address, geoms, frame, force = (np.concatenate(parts) for parts in list(zip(*steps, strict=True))[:4])
    contacts = [len(step.address) for step in steps]
    number = np.repeat(np.arange(len(steps)), contacts)
    first_row = np.cumsum([0, *(len(step.force) for step in steps[:-1])])
    normal_z = frame[:, 2]
    # most contacts do not press on tops: they have no constraint rows, or their normals are nearly horizontal
    pressing = np.flatnonzero((address >= 0) & (np.abs(normal_z) >= VERTICAL_COSINE))
    number, geom, frame_z = number.take(pressing), geoms.take(pressing, axis=0), frame.take(pressing, axis=0)[:, 2::3]
    row = address.take(pressing) + first_row.take(number)
    box, sign, counts = pressed_box(steps[0].bodies.take(geom), frame_z[:, 0])
    counts &= box < np.array([step.n_boxes for step in steps]).take(number)
    pressure = sign * contact_force_z(force.take(row[:, None] + np.arange(3)), frame_z)
    total = np.bincount((number * n_boxes + box)[counts], pressure[counts], minlength=len(steps) * n_boxes)
    return np.asarray(total.reshape(len(steps), n_boxes).max(axis=0))
