"""The smallest and the largest force on the top of a box at rest that balance and friction allow.

Statics does not determine how three supports share a load, and a simulation's answer depends on the stiffness of its
contacts. Here the forces at all points at which boxes touch (petmjx.analysis.plan_contacts) are unknowns. Contact
forces press, friction is at most μ times the pressure, and the force and the moment on every box are zero. Two linear
programmes per box give the smallest and the largest force on its top. No programme is needed for a box on which statics
determines the force.

Friction is limited by the pyramid around the cone, |f₁|, |f₂| ≤ μ f, so that the interval contains all forces that the
cone allows. (The criteria, which determine whether balancing forces exist, use the pyramid inside the cone.)
"""

from __future__ import annotations

from typing import Final

import numpy as np

from petmjx.analysis.force_balance import WRENCH, least_and_most, wrenches
from petmjx.analysis.plan_contacts import IntArray, TouchPoints, find_touch_points
from petmjx.common.errors import InputError, PetmjxError
from petmjx.common.units import FloatArray
from petmjx.engines.metrics import BoxMetrics
from petmjx.options.physics import Physics
from petmjx.world.history import CARRIER
from petmjx.world.scene import Scene

_EDGES: Final = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
"""Signs of the two tangents along the four edges of the pyramid around a friction cone."""


def need_scipy() -> None:
    """Check that force intervals can be computed, before a run starts that needs them.

    Raises:
        InputError: SciPy is missing.
    """
    try:
        import scipy  # noqa: F401  # only to see whether it is installed
    except ImportError:
        raise InputError("force_intervals needs SciPy: pip install 'petmjx[packers]'") from None


def intervals_at_rest(scene: Scene, physics: Physics, boxes: BoxMetrics) -> FloatArray | None:
    """The :func:`force_intervals` of a world in its final poses. None if the world has no forces at rest."""
    at_rest = np.column_stack([boxes.rest_top_force_n, boxes.pos, boxes.quat])
    return force_intervals(scene, physics, boxes.pos, boxes.quat) if np.isfinite(at_rest).all() else None


def force_intervals(scene: Scene, physics: Physics, pos: FloatArray, quat: FloatArray) -> FloatArray:
    """(n, 2) smallest and largest force on the top of each box, N. NaN if no forces balance the boxes connected to it,
    or if the solver finds no answer.

    Args:
        scene: sizes, masses and friction, and the carrier, which is at its planned place.
        pos, quat: (n, 3) centres, m, and (n, 4) orientations (w, x, y, z) at rest.
    """
    touching = find_touch_points(scene, physics, pos, quat)
    weight = scene.mass / scene.mass.mean()
    intervals = _without_programme(touching, weight)
    parts = _hanging_together(touching, scene.n_boxes)
    for part in np.unique(parts[np.isnan(intervals[:, 0])]):
        boxes = np.flatnonzero(parts == part)
        intervals[boxes] = _of_part(touching, boxes, intervals[boxes], weight, pos)
    scale: float = scene.mass.mean() * physics.gravity_m_s2
    return intervals * scale


def _without_programme(touching: TouchPoints, weight: FloatArray) -> FloatArray:
    """(n, 2) intervals that need no linear programme. For a free top, both bounds are 0. If a box alone bears all boxes
    above it, both bounds are their weight. For all other boxes, the interval is NaN."""
    n_boxes = len(weight)
    intervals = np.full((n_boxes, 2), np.nan)
    ends = np.stack([touching.first, touching.second])
    ends[ends == CARRIER] = n_boxes
    for box in range(n_boxes):
        box_contacts = (ends == box).any(axis=0)
        on_top = touching.pressed[box_contacts] == box
        # groups of boxes that are connected without this box
        group = _groups(ends[:, ~box_contacts], n_boxes + 1)
        other = group[ends[:, box_contacts].sum(axis=0) - box]
        above = np.unique(other[on_top])
        if group[n_boxes] not in above and not np.isin(other[~on_top], above).any():
            intervals[box] = weight[np.isin(group[:n_boxes], above)].sum()
    return intervals


def _hanging_together(touching: TouchPoints, n_boxes: int) -> IntArray:
    """(n,) for each box the number of its group. Boxes that are connected by contacts have the same number."""
    ends = np.stack([touching.first, touching.second])
    return _groups(ends[:, (ends != CARRIER).all(axis=0)], n_boxes)


def _groups(pairs: IntArray, n: int) -> IntArray:
    """(n,) for each node the number of its connected component, in a graph with edges (2, e)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(pairs.shape[1], dtype=np.int8), (pairs[0], pairs[1])), shape=(n, n))
    labels: IntArray = connected_components(graph, directed=False)[1]
    return labels


def _of_part(
    touching: TouchPoints, boxes: IntArray, known: FloatArray, weight: FloatArray, centre_m: FloatArray
) -> FloatArray:
    """(b, 2) the intervals of boxes that are connected by contacts, in mean weights.

    Args:
        known: (b, 2) the intervals that need no linear programme; NaN for the other boxes.
    """
    place = np.full(len(weight) + 1, CARRIER)  # index CARRIER is the last entry
    place[boxes] = np.arange(len(boxes))
    contacts = touching.some(np.maximum(place[touching.first], place[touching.second]) != CARRIER)
    # (p, 4, 3) forces along the edges of the pyramids
    direction = contacts.frame[:, :1] + np.einsum("ks,ps,psx->pkx", _EDGES, contacts.friction, contacts.frame[:, 1:])
    forces = wrenches(place[contacts.first], place[contacts.second], contacts.position_m, direction, centre_m[boxes])
    loads = np.zeros((len(boxes), WRENCH))
    loads[:, 2] = weight[boxes]
    unknown = np.isnan(known[:, 0])
    pressing = (contacts.sign[:, None] * direction[:, :, 2])[None] * (contacts.pressed == boxes[unknown, None])[
        :, :, None
    ]
    try:
        bounds = least_and_most(pressing.reshape(int(unknown.sum()), -1), forces, loads.ravel())
    except PetmjxError:  # better a missing interval than a run that stops
        bounds = None
    intervals = known.copy()
    if bounds is not None:
        intervals[unknown] = np.sort(bounds, axis=1)  # rounding of the solver may swap equal bounds
    return intervals
