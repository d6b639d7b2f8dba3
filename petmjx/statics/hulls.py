"""Convex hulls of the areas on which boxes lie, and how far points are inside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.statics.contacts import IntArray, PlanContacts

ON_EDGE_MM: Final = 1e-6
"""A point this far outside lies on the edge: rounding errors of float64 sums of millimetres."""


@dataclass(frozen=True, eq=False)
class Hulls:
    """One convex polygon for each of n boxes, counter-clockwise, padded to e vertices by repeating the last one.

    Attributes:
        vertex: (n, e, 2) mm; NaN where a box has no polygon.
    """

    vertex: FloatArray

    def distance(self, hull: IntArray, point: FloatArray) -> FloatArray:
        """How far points are inside the hulls' edges: (p,) mm, negative outside, NaN where there is no hull.

        Args:
            hull: (p,) of which box each point is asked.
            point: (p, 2) mm.
        """
        start = self.vertex[hull]
        along = np.roll(start, -1, axis=1) - start
        to_point = point[:, None, :] - start
        left = along[..., 0] * to_point[..., 1] - along[..., 1] * to_point[..., 0]
        length2 = (along**2).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            share = (along * to_point).sum(axis=-1) / np.where(length2 > 0, length2, 1.0)
        nearest = to_point - np.clip(share, 0.0, 1.0)[..., None] * along
        distance = np.sqrt((nearest**2).sum(axis=-1).min(axis=1))
        inside: FloatArray = np.where((left >= 0).all(axis=1), distance, -distance)
        return inside

    def reach(self, hull: IntArray, middle: FloatArray, point: FloatArray) -> FloatArray:
        """(p,) how far points are on the way from a hull's inner point ``middle`` (p, 2) through them to its edge: 0 at
        the middle, 1 on the edge, more outside."""
        start = self.vertex[hull]
        along = np.roll(start, -1, axis=1) - start
        outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        to_edge = ((start - middle[:, None, :]) * outward).sum(axis=-1)
        to_point = ((point - middle)[:, None, :] * outward).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            share = np.where(to_edge > 0, to_point / np.where(to_edge > 0, to_edge, 1.0), -np.inf)
        reach: FloatArray = np.where(np.isnan(to_edge[:, 0]), np.nan, share.max(axis=1))
        return reach


def contact_hulls(contacts: PlanContacts) -> Hulls:
    """The hulls of the areas on which each box lies. The hull of a single rectangle is that rectangle."""
    single = contacts.n_supports == 1
    several = np.flatnonzero(contacts.n_supports > 1)
    hulls: list[FloatArray] = []
    if len(several):
        import shapely

        chosen = contacts.n_supports[contacts.upper] > 1
        points = contacts.corners_mm[chosen].reshape(-1, 2)
        owner = np.searchsorted(several, np.repeat(contacts.upper[chosen], 4))
        hulls = polygon_vertices(shapely.convex_hull(shapely.multipoints(points, indices=owner)))
    vertex = np.full((contacts.n_boxes, max(4, *(len(hull) for hull in hulls), 4), 2), np.nan)
    alone = single[contacts.upper]
    vertex[contacts.upper[alone], :4] = contacts.corners_mm[alone]
    vertex[contacts.upper[alone], 4:] = contacts.corners_mm[alone, -1:]
    _put(vertex, several, hulls)
    return Hulls(vertex)


def hulls_of(polygons: NDArray[np.object_]) -> Hulls:
    """From (n,) convex polygons of shapely; empty ones are no hulls."""
    import shapely

    with_area = np.flatnonzero(shapely.area(polygons) > 0)
    hulls = polygon_vertices(polygons[with_area])
    vertex = np.full((len(polygons), max((len(hull) for hull in hulls), default=1), 2), np.nan)
    _put(vertex, with_area, hulls)
    return Hulls(vertex)


def _put(vertex: FloatArray, boxes: IntArray, hulls: list[FloatArray]) -> None:
    for box, hull in zip(boxes, hulls, strict=True):
        vertex[box, : len(hull)] = hull
        vertex[box, len(hull) :] = hull[-1]


def polygon_vertices(polygons: NDArray[np.object_]) -> list[FloatArray]:
    """The vertices of each of shapely's polygons, counter-clockwise, each once."""
    import shapely

    coordinates, owner = shapely.get_coordinates(polygons, return_index=True)
    # shapely closes rings by repeating the first vertex; its hulls run clockwise
    rings = np.split(coordinates, np.flatnonzero(np.diff(owner)) + 1)
    return [ring[:-1] if _area(ring) > 0 else ring[:0:-1] for ring in rings] if len(polygons) else []


def _area(ring: FloatArray) -> float:
    """Twice the area of a closed ring; positive where it runs counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float(np.dot(x[:-1], y[1:]) - np.dot(x[1:], y[:-1]))
