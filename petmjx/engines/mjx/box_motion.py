"""Shift, tilt, drop and speed of boxes (JAX). This module does the same as petmjx/engines/mujoco/box_motion.py,
but shares no arithmetic with it."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from petmjx.options.thresholds import Thresholds


def shift(
    pos: Float[Array, "world box 3"],
    target: Float[Array, "world box 3"],
    floor_m: float,
    sinks_m: Float[Array, "world box"] | None = None,
) -> Float[Array, "world box 3"]:
    """Displacement from the planned centre, m. Components smaller than ``floor_m`` count as 0. The expected descent of
    a compliant stack (``sinks_m``) does not count as displacement."""
    delta = pos - target
    if sinks_m is not None:
        down = jnp.where(delta[..., 2] < 0, jnp.minimum(delta[..., 2] + sinks_m, 0.0), delta[..., 2])
        delta = delta.at[..., 2].set(down)
    return jnp.where(jnp.abs(delta) < floor_m, 0.0, delta)


def middles(pose: Float[Array, "world box 7"], middle: Float[Array, "world box 3"]) -> Float[Array, "world box 3"]:
    """Centres of boxes, m, from the poses of their frames. ``middle``: the box's centre in the box's frame, m."""
    w, axis = pose[..., 3:4], pose[..., 4:]
    twice = 2 * jnp.cross(axis, middle) / (pose[..., 3:] ** 2).sum(-1, keepdims=True)
    return pose[..., :3] + (middle + w * twice + jnp.cross(axis, twice))


def tilt_deg(quat: Float[Array, "world box 4"]) -> Float[Array, "world box"]:
    """Angle between a box's z axis and the world's, degrees.

    The angle is computed from its half: sin²(θ/2) = x² + y² of the unit quaternion. In float32, arccos of the rotated
    axis' z component could not resolve angles below 0.02°.
    """
    sine = jnp.sqrt(quat[..., 1] ** 2 + quat[..., 2] ** 2)
    cosine = jnp.sqrt(quat[..., 0] ** 2 + quat[..., 3] ** 2)
    return jnp.rad2deg(2 * jnp.arctan2(sine, cosine))


def lowest_z(
    pos: Float[Array, "world box 3"], quat: Float[Array, "world box 4"], half: Float[Array, "world box 3"]
) -> Float[Array, "world box"]:
    """z of the lowest point of each rotated box, m: centre − |R[2, :]| · half extents."""
    w, x, y, z = (quat[..., i] for i in range(4))
    row = jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    return pos[..., 2] - (jnp.abs(row) * half).sum(-1)


def has_dropped(
    pos: Float[Array, "world box 3"],
    quat: Float[Array, "world box 4"],
    half: Float[Array, "world box 3"],
    thresholds: Thresholds,
) -> Bool[Array, "world box"]:
    """Whether a box's centre is below the carrier's top, or its lowest point is below ``drop_hull_z_m``."""
    return (pos[..., 2] < 0) | (lowest_z(pos, quat, half) < thresholds.drop_hull_z_m)


def radius(half: Float[Array, "world box 3"]) -> Float[Array, "world box"]:
    """Half diagonal of a box, m."""
    return jnp.sqrt((half**2).sum(-1))


def corner_acceleration(
    angular: Float[Array, "world box 3"], half: Float[Array, "world box 3"]
) -> Float[Array, "world box"]:
    """Root mean square of the accelerations that the rotation of a box gives to its eight corners, m/s². Angular
    accelerations are in the axes of the box, rad/s²."""
    squares = half**2
    return jnp.sqrt((angular**2 * (squares.sum(-1, keepdims=True) - squares)).sum(-1))


def speed(vel: Float[Array, "world box 6"], half: Float[Array, "world box 3"]) -> Float[Array, "world box"]:
    """Upper bound of the speed of a box's fastest point, m/s: the centre's speed + radius × angular speed."""
    linear, angular = (jnp.sqrt((part**2).sum(-1)) for part in (vel[..., :3], vel[..., 3:]))
    return linear + radius(half) * angular


def moved(
    before: Float[Array, "world box 7"], after: Float[Array, "world box 7"], half: Float[Array, "world box 3"]
) -> Float[Array, "world box"]:
    """Upper bound of the distance by which any point of a box has moved, m. A small angle of rotation is twice the
    distance (chord) between the two quaternions."""
    change = (after - before) ** 2
    return jnp.sqrt(change[..., :3].sum(-1)) + 2 * radius(half) * jnp.sqrt(change[..., 3:].sum(-1))
