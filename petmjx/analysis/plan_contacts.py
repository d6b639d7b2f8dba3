"""Finds the contacts of boxes in a plan: the rectangles on which boxes lie (``find_contacts``), and the rectangles at
which boxes touch side by side (``find_sides``).

``Hulls`` holds the convex hulls of the areas on which boxes lie, and computes how far points are inside the hulls.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, meets, shared_length
from petmjx.world.bearings import LEANS_M
from petmjx.world.body_shapes import Room
from petmjx.world.history import CARRIER

ON_EDGE_MM: Final = 1e-6
"""A point outside a polygon counts as lying on its edge if its distance from the edge is at most this length, mm. The
distance covers the rounding errors of float64 sums of millimetres."""


@dataclass(frozen=True, eq=False)
class Hulls:
    """One convex polygon for each of n boxes. The vertices of a polygon are in counter-clockwise order. In the array,
    all polygons have e vertices; if a polygon has fewer than e vertices, its last vertex is repeated.

    Attributes:
        vertex: (n, e, 2) x and y of the vertices, mm; NaN if a box has no polygon.
    """

    vertex: FloatArray

    def distance(self, hull: IntArray, point: FloatArray) -> FloatArray:
        """(p,) distance of each of p points from the edge of the polygon of a box, mm: positive inside the polygon,
        negative outside, NaN if the box has no polygon.

        Args:
            hull: (p,) for each point, the index of the box whose polygon is used.
            point: (p, 2) x and y of the points, mm.
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
        """(p,) position of each of p points on the ray from ``middle``, a point inside the box's polygon, through the
        point: 0 at ``middle``, 1 on the polygon's edge, more than 1 outside.

        Args:
            hull: (p,) for each point, the index of the box whose polygon is used.
            middle: (p, 2) x and y of the points inside the polygons, mm.
            point: (p, 2) x and y of the points, mm.
        """
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
    """For each box, the convex hull of the areas on which the box lies. If a box lies on a single rectangle, the hull
    is this rectangle."""
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
    """Make ``Hulls`` from an array (n,) of convex shapely polygons. A box with an empty polygon has no hull."""
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
    """The vertices of each shapely polygon, in counter-clockwise order and without repetition."""
    import shapely

    coordinates, owner = shapely.get_coordinates(polygons, return_index=True)
    # shapely closes rings by repeating the first vertex, and its hulls run clockwise
    rings = np.split(coordinates, np.flatnonzero(np.diff(owner)) + 1)
    return [ring[:-1] if _area(ring) > 0 else ring[:0:-1] for ring in rings] if len(polygons) else []


def _area(ring: FloatArray) -> float:
    """Twice the area of a closed ring; positive if the ring's vertices are in counter-clockwise order."""
    x, y = (ring - ring[0]).T
    return float(np.dot(x[:-1], y[1:]) - np.dot(x[1:], y[:-1]))


IntArray = NDArray[np.int64]

N_CORNERS: Final = 4
"""Number of corners of a box's base."""


@dataclass(frozen=True, eq=False)
class PlanContacts:
    """The contacts of one plan: c rectangles on which boxes lie, sorted by the upper box.

    A box lies on the carrier if its bottom is not above the carrier's top. The carrier is assumed to extend under all
    boxes, so even a box that extends beyond the carrier lies on it with its whole base. If the carrier is made of
    boards, the box lies on the deck boards that it overlaps along x and y, and each board is a separate contact.

    A box lies on another box if that box was placed earlier, its top is at the height of the upper box's bottom, and
    the two boxes overlap along x and y. If the lower of two boxes is placed after the upper box, it bears nothing: the
    upper box would already have fallen.

    Attributes:
        size_mm, corner_mm: (n, 3) sizes and corners of the boxes, as in the plan.
        mass_kg: (n,) masses of the boxes.
        upper: (c,) index of the upper box.
        lower: (c,) index of the lower box, or ``CARRIER``.
        low_mm, high_mm: (c, 2) lowest and highest x and y of the contact rectangle.
        under_low_mm, under_high_mm: (c, 2) lowest and highest x and y of the whole surface under the upper box: the top
            of the lower box, or a deck board. If the upper box lies on a carrier without boards, the surface is the
            base of the upper box.
        tolerance_mm: largest gap or overlap between two bodies that touch, mm.
        mass_center_mm: (n, 3) offsets of the centres of mass from the boxes' middles, as in ``Plan``. If
            ``mass_center_mm`` is None, the centres of mass are in the middles.
        room: the room between the carrier's walls. If ``room`` is None, the carrier has no walls.
    """

    size_mm: FloatArray
    corner_mm: FloatArray
    mass_kg: FloatArray
    upper: IntArray
    lower: IntArray
    low_mm: FloatArray
    high_mm: FloatArray
    under_low_mm: FloatArray
    under_high_mm: FloatArray
    tolerance_mm: float
    mass_center_mm: FloatArray | None = None
    room: Room | None = None

    @property
    def n_boxes(self) -> int:
        return len(self.mass_kg)

    @cached_property
    def centre_mm(self) -> FloatArray:
        """(n, 3) centres of mass of the boxes: their middles, unless the plan states other centres."""
        centre: FloatArray = self.corner_mm + self.size_mm / 2
        return centre if self.mass_center_mm is None else centre + self.mass_center_mm

    @cached_property
    def corners_mm(self) -> FloatArray:
        """(c, 4, 2) corners of the contact rectangles, in counter-clockwise order."""
        return rectangle_corners(self.low_mm, self.high_mm)

    @cached_property
    def n_supports(self) -> IntArray:
        """(n,) number of areas on which each box lies: one for each box below it, and one for the carrier (or one for
        each deck board below it)."""
        return np.bincount(self.upper, minlength=self.n_boxes)

    @cached_property
    def grounded(self) -> NDArray[np.bool_]:
        """(n,) whether all four bottom corners of each box lie on the carrier. A box with four corners on the carrier
        cannot tip."""
        n_corners: IntArray = self.borne_corners(self.lower == CARRIER).sum(axis=1)
        on_carrier: NDArray[np.bool_] = np.equal(n_corners, N_CORNERS)
        return on_carrier

    def borne_corners(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n, 4) whether each bottom corner of each box lies on a support, within the tolerance. A corner on the edge
        of a surface counts as lying on the surface.

        Args:
            chosen: (c,) whether each contact is considered.
        """
        base = self.corner_mm[:, :2]
        corners = rectangle_corners(base, base + self.size_mm[:, :2])[self.upper[chosen]]
        low_mm = self.under_low_mm[chosen] - self.tolerance_mm
        high_mm = self.under_high_mm[chosen] + self.tolerance_mm
        inside = ((corners >= low_mm[:, None]) & (corners <= high_mm[:, None])).all(axis=-1)
        borne = np.zeros((self.n_boxes, N_CORNERS), dtype=bool)
        np.logical_or.at(borne, self.upper[chosen], inside)
        return borne


@dataclass(frozen=True, eq=False)
class Sides:
    """The places at which boxes touch side by side or can lean on a wall: s upright rectangles.

    Attributes:
        first, second: (s,) indices of the two boxes that touch, or ``CARRIER`` for a wall. The second box has the
            larger coordinate along the axis.
        axis: (s,) the horizontal axis that is perpendicular to the rectangle, 0 for x and 1 for y.
        low_mm, high_mm: (s, 3) lowest and highest corner of the rectangle. The rectangle's extent along ``axis`` is 0.
    """

    first: IntArray
    second: IntArray
    axis: IntArray
    low_mm: FloatArray
    high_mm: FloatArray


def rectangle_corners(low: FloatArray, high: FloatArray) -> FloatArray:
    """(…, 4, 2) the four corners of rectangles, in counter-clockwise order. ``low`` and ``high`` (…, 2) are the corners
    with the smallest and the largest x and y."""
    x0, y0, x1, y1 = low[..., 0], low[..., 1], high[..., 0], high[..., 1]
    corners: FloatArray = np.stack(
        [np.stack([x0, y0], -1), np.stack([x1, y0], -1), np.stack([x1, y1], -1), np.stack([x0, y1], -1)], axis=-2
    )
    return corners


def find_contacts(
    plan: Plan,
    tolerance_mm: float = DEFAULT_TOLERANCE_MM,
    deck_mm: FloatArray | None = None,
    room: Room | None = None,
) -> PlanContacts:
    """Find the contacts of a plan: the rectangles on which its boxes lie, and the body below each rectangle.

    Args:
        tolerance_mm: largest vertical gap or overlap of two boxes that touch, mm. A contact that is not wider than
            ``tolerance_mm`` is ignored. The default, half a millimetre, is the rounding error of whole millimetres.
            Warnings about plans use the same value.
        deck_mm: (b, 2, 2) lowest and highest x and y of each board of the carrier's deck. If ``deck_mm`` is None, the
            carrier extends under all boxes.
        room: the room between the carrier's walls. If ``room`` is None, the carrier has no walls.
    """
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    below, above = np.nonzero(_rests(low, high, tolerance_mm))
    on_carrier = np.flatnonzero(low[:, 2] <= tolerance_mm)
    carrier_low, carrier_high = low[on_carrier, :2], high[on_carrier, :2]
    if deck_mm is not None:
        lying, board = np.nonzero(_overlap(carrier_low, carrier_high, deck_mm, tolerance_mm))
        on_carrier, carrier_low, carrier_high = on_carrier[lying], deck_mm[board, 0], deck_mm[board, 1]
    upper = np.concatenate([on_carrier, above])
    lower = np.concatenate([np.full(len(on_carrier), CARRIER), below])
    under_low = np.concatenate([carrier_low, low[below, :2]])
    under_high = np.concatenate([carrier_high, high[below, :2]])
    order = np.lexsort((lower, upper))
    upper, lower, under_low, under_high = upper[order], lower[order], under_low[order], under_high[order]
    return PlanContacts(
        size_mm=plan.size_mm,
        corner_mm=plan.corner_mm,
        mass_kg=plan.mass_kg,
        upper=upper,
        lower=lower,
        low_mm=np.maximum(low[upper, :2], under_low),
        high_mm=np.minimum(high[upper, :2], under_high),
        under_low_mm=under_low,
        under_high_mm=under_high,
        tolerance_mm=tolerance_mm,
        mass_center_mm=plan.mass_center_mm,
        room=room,
    )


def _overlap(low: FloatArray, high: FloatArray, deck_mm: FloatArray, tolerance_mm: float) -> NDArray[np.bool_]:
    """(k, b) whether each of k rectangles overlaps each of b boards by more than the tolerance along x and y."""
    shares = np.minimum(high[:, None], deck_mm[:, 1]) - np.maximum(low[:, None], deck_mm[:, 0]) > tolerance_mm
    return shares[..., 0] & shares[..., 1]


def _rests(low: FloatArray, high: FloatArray, tolerance_mm: float) -> NDArray[np.bool_]:
    """(n, n) whether the box of the column lies on the box of the row."""
    touching = meets(low[:, 2], high[:, 2], tolerance_mm)
    for axis in range(2):
        touching &= shared_length(low[:, axis], high[:, axis]) > tolerance_mm
    return np.triu(touching, k=1)


def find_sides(contacts: PlanContacts) -> Sides:
    """Find the places at which boxes of a plan touch side by side, and the places at which boxes can lean on a wall. A
    box can lean on a wall that is at most ``LEANS_M`` away."""
    low, high = contacts.corner_mm, contacts.corner_mm + contacts.size_mm
    tolerance_mm = contacts.tolerance_mm
    pairs_by_axis = []
    for axis in range(2):
        touching = meets(low[:, axis], high[:, axis], tolerance_mm)
        for across in (1 - axis, 2):
            touching &= shared_length(low[:, across], high[:, across]) > tolerance_mm
        first, second = np.nonzero(touching)
        pairs_by_axis.append((first, second, np.full(len(first), axis)))
    first, second, axes = (np.concatenate(parts) for parts in zip(*pairs_by_axis, strict=True))
    low_ends, high_ends = np.maximum(low[first], low[second]), np.minimum(high[first], high[second])
    rows = np.arange(len(axes))
    low_ends[rows, axes] = high_ends[rows, axes] = (low_ends[rows, axes] + high_ends[rows, axes]) / 2
    sides = Sides(first, second, axes, low_ends, high_ends)
    return sides if contacts.room is None else _with_walls(sides, contacts, contacts.room)


def _with_walls(sides: Sides, contacts: PlanContacts, room: Room) -> Sides:
    """Add the places at which boxes can lean on walls. Each place is a whole side of a box, or the part of the side
    below the wall's upper edge."""
    low, high = contacts.corner_mm, contacts.corner_mm + contacts.size_mm
    middle_m, half_m = (low + high) / 2 / MM_PER_M, contacts.size_mm / 2 / MM_PER_M
    gap_mm = MM_PER_M * room.gaps(middle_m, half_m, contacts.tolerance_mm / MM_PER_M)
    box, end, axis = np.nonzero(gap_mm <= MM_PER_M * LEANS_M)
    low_mm, high_mm, rows = low[box].copy(), high[box].copy(), np.arange(len(box))
    low_mm[rows, axis] = high_mm[rows, axis] = np.where(end == 0, low[box, axis], high[box, axis])
    high_mm[:, 2] = np.minimum(high_mm[:, 2], MM_PER_M * room.top[end, axis])
    wall = np.full(len(box), CARRIER)
    ends = (np.where(end == 0, wall, box), np.where(end == 0, box, wall), axis, low_mm, high_mm)
    field_pairs = zip((sides.first, sides.second, sides.axis, sides.low_mm, sides.high_mm), ends, strict=True)
    return Sides(*(np.concatenate(parts) for parts in field_pairs))
