"""Shift, tilt, drop and speed of boxes, in NumPy. petmjx/engines/mjx/box_motion.py computes the same in JAX."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.thresholds import Thresholds


def shift(pos: FloatArray, target: FloatArray, floor_m: float, sinks_m: FloatArray | None = None) -> FloatArray:
    """(…, n, 3) displacements of the boxes' centres from the planned centres, m. Components whose magnitude is below
    ``floor_m`` become 0.

    Args:
        sinks_m: (n,) expected descent of each box, m, which does not count as displacement. If ``sinks_m`` is None, no
            box is expected to descend.
    """
    delta = pos - target
    if sinks_m is not None:
        down = delta[..., 2]
        delta[..., 2] = np.where(down < 0, np.minimum(down + sinks_m, 0.0), down)
    return np.where(np.abs(delta) < floor_m, 0.0, delta)


def tilt_deg(quat: FloatArray) -> FloatArray:
    """(n,) angle between each box's z axis and the world's z axis, degrees."""
    x, y = quat[:, 1], quat[:, 2]
    # The sine of half the angle is accurate for small angles; the cosine of the full angle is not.
    half_sine = np.sqrt(np.minimum((x * x + y * y) / np.einsum("ij,ij->i", quat, quat), 1.0))
    return np.asarray(np.degrees(2.0 * np.arcsin(half_sine)))


def lowest_z(pos: FloatArray, quat: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n,) z coordinate of the lowest point of each rotated box, m."""
    w, x, y, z = quat.T
    norm2 = w * w + x * x + y * y + z * z
    row = np.abs(np.stack((2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z))) / norm2
    return np.asarray(pos[:, 2] - row[0] * half_size[:, 0] - row[1] * half_size[:, 1] - row[2] * half_size[:, 2])


def has_dropped(pos: FloatArray, quat: FloatArray, half_size: FloatArray, thresholds: Thresholds) -> NDArray[np.bool_]:
    """(n,) whether each box's centre is below the carrier's top, or its lowest point is below ``drop_hull_z_m``."""
    return np.asarray((pos[:, 2] < 0.0) | (lowest_z(pos, quat, half_size) < thresholds.drop_hull_z_m))


def farthest(shift_m: FloatArray) -> FloatArray:
    """(…, n) largest magnitude of the three components of each displacement (…, n, 3), m. For many boxes,
    ``max(axis=-1)`` would take twenty times as long."""
    x, y, z = (np.abs(shift_m[..., axis]) for axis in range(3))
    return np.asarray(np.maximum(np.maximum(x, y), z))


def speed(vel: FloatArray, radius_m: FloatArray) -> FloatArray:
    """(n,) upper bound of the speed of each box's fastest point, m/s: speed of the centre + half diagonal × angular
    speed.

    Args:
        vel: (n, 6) velocities of the centres, m/s, followed by angular velocities, rad/s.
        radius_m: (n,) half diagonals of the boxes, m.
    """
    return np.asarray(np.linalg.norm(vel[:, :3], axis=1) + radius_m * np.linalg.norm(vel[:, 3:], axis=1))


def moved(before: FloatArray, after: FloatArray, radius_m: FloatArray) -> FloatArray:
    """(n,) upper bound of the distance by which any point of each box has moved, m: move of the centre + half diagonal
    × 2 × distance of the quaternions, for small rotations.

    Args:
        before, after: (n, 7) centres (m) and unit quaternions of the boxes at two times.
        radius_m: (n,) half diagonals of the boxes, m.
    """
    change = after - before
    return np.asarray(np.linalg.norm(change[:, :3], axis=1) + 2 * radius_m * np.linalg.norm(change[:, 3:], axis=1))


def corner_acceleration(angular: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n,) root mean square of the accelerations that the rotation of each box gives to its eight corners, m/s².

    For a box that begins to move from rest under gravity alone, it is at most √3/2 × g, whatever the box stands on: the
    accelerations that rigid supports allow are such that the supports' forces do no work, so m a² + I α² ≤ m g a. Here,
    a is the acceleration of the centre, and I α² is the sum over the axes of moment of inertia × (angular
    acceleration)². The largest I α² is therefore m g² / 4, at a = g / 2. The mean square of the corners' accelerations
    is 3 I α² / m. For a box that stands on one of its edges, the root is at most 3/4 × g.

    Args:
        angular: (n, 3) angular accelerations in the axes of the boxes, rad/s².
        half_size: (n, 3) half extents of the boxes, m.
    """
    squares = half_size**2
    return np.asarray(np.sqrt((angular**2 * (squares.sum(axis=1, keepdims=True) - squares)).sum(axis=1)))
