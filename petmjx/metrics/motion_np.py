"""Where boxes are: tilt and lowest point (NumPy)."""

from __future__ import annotations

import numpy as np

from petmjx.units import FloatArray


def tilt_deg(quat: FloatArray) -> FloatArray:
    """(n,) angle between each box's z axis and the world's, degrees."""
    x, y = quat[:, 1], quat[:, 2]
    # The sine of the half angle is accurate near 0, where the cosine of the full angle is not.
    half_sine = np.sqrt(np.minimum((x * x + y * y) / np.einsum("ij,ij->i", quat, quat), 1.0))
    return np.asarray(np.degrees(2.0 * np.arcsin(half_sine)))


def lowest_z(pos: FloatArray, quat: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n,) z of the lowest point of each turned box, m."""
    w, x, y, z = quat.T
    norm2 = w * w + x * x + y * y + z * z
    row = np.abs(np.stack((2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z))) / norm2
    return np.asarray(pos[:, 2] - row[0] * half_size[:, 0] - row[1] * half_size[:, 1] - row[2] * half_size[:, 2])
