"""Rotated boxes: rotation matrices of quaternions, rotated vectors, and corners of boxes."""

from __future__ import annotations

import numpy as np

from petmjx.common.units import FloatArray


def rotations(quat: FloatArray) -> FloatArray:
    """(k, 3, 3) rotation matrices of (k, 4) quaternions (w, x, y, z). The quaternions' length need not be 1. The
    columns of a matrix are the axes of the rotated box."""
    w, x, y, z = quat.T / np.linalg.norm(quat, axis=1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotated_vectors(quat: FloatArray, vector: FloatArray) -> FloatArray:
    """(…, 3) vectors rotated by (…, 4) quaternions (w, x, y, z) of any non-zero length."""
    axis, w = quat[..., 1:], quat[..., :1]
    twice = 2 * np.cross(axis, vector) / (quat**2).sum(axis=-1, keepdims=True)
    turned_vector: FloatArray = vector + w * twice + np.cross(axis, twice)
    return turned_vector


def corners(pos: FloatArray, turns: FloatArray, half_size: FloatArray) -> FloatArray:
    """(k, 8, 3) corners of boxes, m, from (k, 3) centres, (k, 3, 3) rotation matrices and (k, 3) half sizes. The order
    of corners is (−, −, −), (−, −, +), (−, +, −), … (signs along x, y, z)."""
    signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij"), axis=-1).reshape(8, 3)
    return np.asarray(pos[:, None] + np.einsum("kij,kcj->kci", turns, signs * half_size[:, None]))
