"""Load-bearable convex polygons: the area in which the top of each box can be loaded without making this box or a box
below it fall. docs/criteria.md explains the criterion.

A box on the carrier can be loaded anywhere on its top. Any other box lies on contact areas, parts of which are inside
the polygons of the boxes below. The convex hull of these parts is the polygon of the box. Later boxes may press on a
box only inside its polygon, where they cannot make any box tip. So the criterion need not compute any loads. Source:
Gao, Wang, Kong, Chong (2025), "Online 3D Bin Packing with Fast Stability Validation and Stable Rearrangement Planning",
arXiv 2507.09123. The paper also allows for an uncertain centre of mass; petmjx takes the centre of mass as exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petmjx.analysis.plan_contacts import IntArray, PlanContacts, hulls_of
from petmjx.common.units import FloatArray
from petmjx.world.history import CARRIER


def load_polygon_slack(contacts: PlanContacts) -> FloatArray:
    """(n,) distance of each box's centre of mass from the edge of the box's polygon, mm: positive inside the polygon,
    negative outside, NaN if the box has no polygon."""
    polygons = load_polygons(contacts)
    return hulls_of(polygons).distance(np.arange(contacts.n_boxes), contacts.centre_mm[:, :2])


def load_polygons(contacts: PlanContacts) -> NDArray[np.object_]:
    """(n,) the polygon of each box, as a shapely polygon. A box has an empty polygon if none of its supports has a
    polygon.

    Boxes are processed level by level, from the carrier upwards, because the polygon of a box depends on the polygons
    of its supports.
    """
    import shapely

    areas = shapely.box(*contacts.low_mm.T, *contacts.high_mm.T)
    polygons = np.full(contacts.n_boxes, shapely.Polygon(), dtype=object)
    level = _levels(contacts)[contacts.upper]
    for number in range(int(level.max(initial=-1)) + 1):
        chosen = np.flatnonzero(level == number)
        borne = _within_polygons(areas[chosen], contacts.lower[chosen], polygons)
        owner, points_of = shapely.get_coordinates(borne), shapely.get_num_coordinates(borne)
        boxes, indices = np.unique(np.repeat(contacts.upper[chosen], points_of), return_inverse=True)
        polygons[boxes] = shapely.convex_hull(shapely.multipoints(owner, indices=indices))
    return polygons


def _levels(contacts: PlanContacts) -> IntArray:
    """(n,) level of each box. A box that lies only on the carrier has level 0. For any other box, the level is 1 + the
    highest level of the boxes on which it lies."""
    level = np.zeros(contacts.n_boxes, dtype=np.int64)
    for upper, lower in zip(contacts.upper.tolist(), contacts.lower.tolist(), strict=True):
        if lower != CARRIER:
            level[upper] = max(level[upper], level[lower] + 1)
    return level


def _within_polygons(areas: NDArray[np.object_], lower: IntArray, polygons: NDArray[np.object_]) -> NDArray[np.object_]:
    """The part of each contact area that lies in the polygon of the body below."""
    import shapely

    borne = areas.copy()
    on_boxes = np.flatnonzero(lower != CARRIER)
    cut = on_boxes[~shapely.covers(polygons[lower[on_boxes]], areas[on_boxes])]
    borne[cut] = shapely.intersection(areas[cut], polygons[lower[cut]])
    return borne
