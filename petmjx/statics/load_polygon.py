"""Load-bearable convex polygons: where the top of a box can be loaded without anything below giving way.

Source: Gao, Wang, Kong, Chong (2025), "Online 3D Bin Packing with Fast Stability Validation and Stable Rearrangement
    Planning", arXiv 2507.09123. A box on the carrier can be loaded anywhere on its top. Any other box bears within the
    hull of its contact areas, as far as these lie in the polygons of the boxes below; that hull is its own polygon, and
    the box stands if its centre is in it. Then no later box can tip it, so loads need not be known. The paper also lets
    the centre of mass be uncertain; here boxes are of uniform density.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.history import CARRIER
from petmjx.statics.contacts import IntArray, PlanContacts
from petmjx.statics.hulls import hulls_of


def load_polygon_slack(contacts: PlanContacts) -> FloatArray:
    """(n,) how far each box's centre is inside its polygon's edge, mm; negative outside, NaN without a polygon."""
    polygons = load_polygons(contacts)
    return hulls_of(polygons).distance(np.arange(contacts.n_boxes), contacts.centre_mm[:, :2])


def load_polygons(contacts: PlanContacts) -> NDArray[np.object_]:
    """(n,) the polygons as shapely's; empty for a box that lies on nothing that bears.

    Boxes are worked through level by level: all those at once whose supports have their polygons.
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
    """(n,) 0 for boxes on the carrier alone, else one more than the highest level of their supports."""
    level = np.zeros(contacts.n_boxes, dtype=np.int64)
    for upper, lower in zip(contacts.upper.tolist(), contacts.lower.tolist(), strict=True):
        if lower != CARRIER:
            level[upper] = max(level[upper], level[lower] + 1)
    return level


def _within_polygons(areas: NDArray[np.object_], lower: IntArray, polygons: NDArray[np.object_]) -> NDArray[np.object_]:
    """Contact areas as far as they lie in the polygons of the bodies below."""
    import shapely

    borne = areas.copy()
    on_boxes = np.flatnonzero(lower != CARRIER)
    cut = on_boxes[~shapely.covers(polygons[lower[on_boxes]], areas[on_boxes])]
    borne[cut] = shapely.intersection(areas[cut], polygons[lower[cut]])
    return borne
