"""Convex hulls of rectangles whose sides are parallel to x and y."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray

IntArray = NDArray[np.intp]

LEAST_EDGE_M: Final = 1e-9
"""Shortest edge, m. Edges that are shorter than ``LEAST_EDGE_M`` are left out, since rounding determines their
direction."""

_STRAIGHT_M: Final = 1e-12
"""Distance of a corner from a line, m, below which the corner counts as on the line: such a distance is rounding."""


class HullTable(NamedTuple):
    """The edges of s convex hulls. Hulls with fewer than e edges are filled up with edges that are infinitely far away.

    Attributes:
        normal: (s, e, 2) inward normals of the edges.
        offset: (s, e) scalar product of each normal with any point of its edge.
    """

    normal: FloatArray
    offset: FloatArray

    def inside_m(self, hull: IntArray, point: FloatArray) -> FloatArray:
        """(p,) distance of (p, 2) points from the nearest edge of their hulls, m: positive inside, negative outside.

        Args:
            hull: (p,) number of the hull with which each point is compared.
        """
        nearest: FloatArray = self.distances_m(hull, point).min(axis=1, initial=np.inf)
        return nearest

    def distances_m(self, hull: IntArray, point: FloatArray) -> FloatArray:
        """(p, e) distance of (p, 2) points from the line through each edge of their hulls, m: positive on the inner
        side of the line."""
        normal = self.normal.take(hull, axis=0)
        inside: FloatArray = normal[..., 0] * point[:, :1] + normal[..., 1] * point[:, 1:]
        inside -= self.offset.take(hull, axis=0)
        return inside


def hull_table(low: FloatArray, high: FloatArray, count: IntArray) -> HullTable:
    """The hulls of s sets of rectangles, computed together.

    Each edge of a hull is parallel to an axis, or joins the same corner (such as the lower left) of two rectangles. All
    other rectangles are on the inner side of the edge.

    Args:
        low, high: (c, 2) lowest and highest corners of the rectangles of all sets, set after set.
        count: (s,) number of rectangles in each set.
    """
    begins, size = np.cumsum(count) - count, len(count)
    parts: list[tuple[IntArray, FloatArray, FloatArray]] = []
    for k in np.unique(count).tolist():
        sets = np.flatnonzero(count == k)
        rows = begins[sets][:, None] + np.arange(k)
        parts.append((sets, *_stacked_hulls(low[rows], high[rows])))
    most = max((offset.shape[1] for _, _, offset in parts), default=0)
    normal, offset = np.zeros((size, most, 2)), np.full((size, most), -np.inf)
    for sets, some_normal, some_offset in parts:
        edges = some_offset.shape[1]
        normal[sets, :edges], offset[sets, :edges] = some_normal, some_offset
    return HullTable(normal, offset)


def _stacked_hulls(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(s, e, 2) normals and (s, e) offsets, as in ``HullTable``, of the hulls of s sets of k rectangles."""
    along = np.stack([low[..., 0].min(1), -high[..., 0].max(1), low[..., 1].min(1), -high[..., 1].max(1)], axis=1)
    axes = np.broadcast_to(np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), (len(low), 4, 2))
    one, other = np.triu_indices(low.shape[1], 1)
    # The point of a rectangle nearest to an edge of the hull is a corner. Along x and along y, this corner is at the
    # rectangle's low end if the edge's normal is positive there, and at the high end if the normal is negative.
    x = np.stack([low[..., 0], low[..., 0], high[..., 0], high[..., 0]], axis=1)
    y = np.stack([low[..., 1], high[..., 1], low[..., 1], high[..., 1]], axis=1)
    sign_x, sign_y = np.array([1, 1, -1, -1])[:, None], np.array([1, -1, 1, -1])[:, None]
    step_x, step_y = x[..., other] - x[..., one], y[..., other] - y[..., one]
    length = np.hypot(step_x, step_y)
    # edges run anticlockwise, with the hull on the left
    slanted = (step_x * step_y * sign_x * sign_y < 0) & (length > LEAST_EDGE_M)
    turn = np.where(step_x * sign_y > 0, 1.0, -1.0)
    length = np.where(slanted, length, 1.0) * turn
    normal_x, normal_y = -step_y / length, step_x / length
    begin_x, begin_y = np.where(turn > 0, x[..., one], x[..., other]), np.where(turn > 0, y[..., one], y[..., other])
    offset = normal_x * begin_x + normal_y * begin_y
    least = normal_x[..., None] * x[:, :, None] + normal_y[..., None] * y[:, :, None]
    slanted &= least.min(axis=-1, initial=np.inf) >= offset - _STRAIGHT_M
    normal = np.where(slanted[..., None], np.stack([normal_x, normal_y], axis=-1), 0.0)
    normal = np.concatenate([axes, normal.reshape(len(low), -1, 2)], axis=1)
    offset = np.concatenate([along, np.where(slanted, offset, -np.inf).reshape(len(low), -1)], axis=1)
    order = np.argsort(np.isinf(offset), axis=1, kind="stable")[:, : int(np.isfinite(offset).sum(axis=1).max())]
    return np.take_along_axis(normal, order[..., None], axis=1), np.take_along_axis(offset, order, axis=1)
