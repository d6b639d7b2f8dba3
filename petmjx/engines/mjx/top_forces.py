"""The force on top of each box, from contacts (JAX). Twin of petmjx/engines/mujoco/top_forces.py."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

VERTICAL_COSINE = math.cos(math.radians(45.0))
"""A contact counts as vertical if its normal is within 45° of z."""


def contact_force_z(
    rows: Float[Array, "*batch 4"],
    frame_z: Float[Array, "*batch 3"],
    friction: Float[Array, "*batch 2"],
    *,
    pyramidal: bool,
) -> Float[Array, "*batch"]:
    """The z component, in world axes, of the contact force on the second geom, N.

    ``rows`` are the constraint forces of one contact. Elliptic cones: (normal, tangent 1, tangent 2, unused). Pyramidal
    cones: the forces along the four edges; the normal force is the sum of these, and the tangential forces are their
    differences × sliding friction. The formulas are from MuJoCo's documentation, "Computation", section "Contact".
    ``frame_z``: z components of normal and tangents.
    """
    if pyramidal:
        normal = rows.sum(-1)
        tangent_1 = (rows[..., 0] - rows[..., 1]) * friction[..., 0]
        tangent_2 = (rows[..., 2] - rows[..., 3]) * friction[..., 1]
    else:
        normal, tangent_1, tangent_2 = (rows[..., i] for i in range(3))
    return normal * frame_z[..., 0] + tangent_1 * frame_z[..., 1] + tangent_2 * frame_z[..., 2]


def pressed_box(
    body: Int[Array, "*batch 2"],
    normal_z: Float[Array, "*batch"],
) -> tuple[Int[Array, "*batch"], Float[Array, "*batch"], Bool[Array, "*batch"]]:
    """The box on which a contact presses: the partner from which the normal points upwards. ``body``: the two
    partners of each contact, as numbers of boxes, or as negative numbers for carrier and floor. ``normal_z``: z
    components of the unit normals, which point from the first partner to the second.

    Returns:
        Three values: the number of the box (negative for carrier and floor); the sign that turns the force on the
        second geom into a downward force on the lower geom; and whether the contact is vertical and its lower partner
        is a box.
    """
    first_is_lower = normal_z > 0
    box = jnp.where(first_is_lower, body[..., 0], body[..., 1])
    sign = jnp.where(first_is_lower, 1.0, -1.0)
    counts = (jnp.abs(normal_z) >= VERTICAL_COSINE) & (box >= 0)
    return box, sign, counts
