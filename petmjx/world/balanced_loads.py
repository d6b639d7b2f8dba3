"""A linear programme that distributes loads among supports so that vertical forces balance a stack of boxes.

The load of a box is its own weight plus the weight that rests on it. The box is in balance if its load acts inside the
edges of its supports, that is, within the convex hull of the supports. Statics does not determine how several supports
share a load. So a load may be beyond an edge if supports share loads in one way, and inside if they share loads in
another way. Rigid boxes stand if their supports can share the loads so that all loads act inside the edges.

The unknowns of the programme are forces at the corners of all contact areas of boxes with several supports. The forces
must push, and must balance every box. The programme chooses the forces with which the load nearest to an edge is as far
inside the edges as possible. If no forces keep all loads inside, the programme minimises the distances of loads beyond
edges. (Livesley 1978, "Limit analysis of structures formed from rigid blocks", International Journal for Numerical
Methods in Engineering 12(12), uses forces of this kind.)

A box with one support passes its whole load to this support. For a box with one support, the programme contains the
support's edges, but the support's force is not an unknown.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import PetmjxError
from petmjx.common.linear_programmes import Entries, minimised
from petmjx.common.units import FloatArray
from petmjx.world.bearings import Bearing
from petmjx.world.pushing_forces import IntArray

ROUNDING_M: Final = 1e-9
"""Distance beyond an edge, m, up to which a load counts as on the edge, since sums of millimetres have rounding
errors."""

FAR_M: Final = 0.1
"""The linear programme moves no load further inside the edges than this distance, m."""

BEYOND_M: Final = 1e-6
"""Distance beyond an edge, m, that a load must exceed in the programme's result to count as beyond the edge. The
solver's tolerance is a tenth of this distance."""

_OUTSIDE: Final = 10.0
"""Cost, in the programme's objective, of each metre by which a load is beyond an edge. An unbalanced moment, divided by
the load, is a length, and costs ``_OUTSIDE``² per metre. Each metre by which the load nearest to an edge is inside the
edges reduces the cost by 1."""

_ALONG: Final = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Inward normals of a rectangle's edges: of the two edges at the lowest corner, then of the two at the highest."""


def balanced_loads(
    bearing: Bearing, load: FloatArray, edge_m: FloatArray, placed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray] | None:
    """(n, 3) loads that balance the boxes of one scene as well as possible, and (n,) the distances by which these loads
    are still beyond edges, m. The result is None if every load beyond an edge stays the same however supports share
    loads.

    Args:
        bearing: the contacts between boxes and their supports in one scene.
        load: (n, 3 or 4) loads as in ``Bearing.loads`` if supports share loads like springs. The load of a box that is
            not placed is 0.
        edge_m: (n,) distances of these loads from edges, m: positive inside, negative beyond.
        placed: (n,) whether each box is placed.
    """
    outside = placed & (edge_m < 0)
    passed, fixed = _fixed_forces(bearing, placed)
    several = np.flatnonzero(placed & (bearing.n_supports > 1))
    together = np.flatnonzero((placed & (bearing.n_supports > 1))[bearing.upper])
    # For each box with several supports: the boxes whose loads depend on how these supports share the box's load. These
    # are the boxes below, and the box itself, since the equations also contain the load of the box itself.
    of_box = np.zeros((len(several), len(placed)), bool)
    np.logical_or.at(of_box, np.searchsorted(several, bearing.upper[together]), passed[together])
    of_box[np.arange(len(several)), several] = True
    touched = outside
    while True:
        chosen = (of_box & touched).any(axis=1)
        further = touched | of_box[chosen].any(axis=0)
        if np.array_equal(further, touched):
            break
        touched = further
    open_ = np.zeros(len(placed), bool)
    open_[several[chosen]] = True
    contacts = together[open_[bearing.upper[together]]]
    changed = np.flatnonzero((passed[contacts].any(axis=0) | open_) & (bearing.n_supports > 0))
    if not (outside & passed[contacts].any(axis=0)).any():
        return None
    return _solved_loads(bearing, contacts, changed, passed, load[:, :3], fixed)


def _fixed_forces(bearing: Bearing, placed: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], FloatArray]:
    """(c, n) whether the force at each contact is part of the load of each box, and (n, 3) the part of each load that
    does not depend on these forces.

    A force at a contact is part of the load of the box below. If the box below has a single support, the force is also
    part of that support's load, and so on. A box's own weight is passed on in the same way.
    """
    n = len(placed)
    one = placed & (bearing.n_supports == 1)
    below = np.full(n, -1)
    below[bearing.upper] = bearing.lower
    below[~one] = -1
    reach = np.zeros((n + 1, n), bool)  # the last row stands for the carrier
    order = np.argsort(-bearing.level, kind="stable")
    for box in order[placed[order]].tolist():
        reach[box] = reach[below[box]]
        reach[box, box] = True
    weights = bearing.weights[:, :3] * placed[:, None]
    reached: FloatArray = reach[:n].T.astype(float) @ weights
    return reach[bearing.lower], reached


def _solved_loads(
    bearing: Bearing,
    contacts: IntArray,
    changed: IntArray,
    passed: NDArray[np.bool_],
    load: FloatArray,
    weights: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """(n, 3) loads of one scene, and (n,) distances by which these loads are beyond edges, m. The result is None if the
    linear programme has no solution.

    The programme determines the loads of the boxes ``changed``. The loads of all other boxes are as in ``load``. The
    unknowns of the programme are

    - the forces at the four corners of each contact in ``contacts``,
    - the distance by which each load is beyond an edge,
    - for each box with several supports, moments that no support balances,
    - the distance by which the load nearest to an edge is inside all edges.
    """
    middle = load[changed, 1:].sum(axis=0) / load[changed, 0].sum()
    mean = load[changed, 0].mean()
    low, high = bearing.low[contacts] - middle, bearing.high[contacts] - middle
    x = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1).ravel()
    y = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1).ravel()
    corner = np.stack([np.ones(len(x)), x, y])
    fixed = weights[changed] / mean
    fixed[:, 1:] -= middle * fixed[:, :1]
    weight = load[changed, 0] / mean
    j, f, open_ = len(changed), len(x), np.flatnonzero(bearing.n_supports[changed] > 1)
    outside, moments, least = f, f + j, f + j + 4 * len(open_)
    reach = np.repeat(passed[contacts].T[changed], 4, axis=1)
    place, normal, offset = _edges_of(bearing, changed)
    offset = offset - normal @ middle
    # the rows for edges are divided by the loads (``weight``), so that these rows, and the solver's tolerance, are in m
    edges = np.zeros((len(place), least + 1))
    edges[:, :f] = reach[place] * (normal @ corner[1:] - offset[:, None]) / weight[place, None]
    edges[np.arange(len(place)), outside + place], edges[:, least] = 1.0, -1.0
    inside = (offset * fixed[place, 0] - (normal * fixed[place, 1:]).sum(axis=1)) / weight[place]
    balance = np.zeros((len(open_), 3, least + 1))
    lifts = np.repeat(bearing.upper[contacts], 4) == changed[open_, None]
    balance[..., :f] = (lifts.astype(float) - reach[open_])[:, None] * corner
    number = np.arange(len(open_))
    for axis, sign in enumerate((1.0, -1.0, 1.0, -1.0)):
        balance[number, 1 + axis // 2, moments + 4 * number + axis] = sign * weight[open_]
    rows = np.concatenate([edges, balance.reshape(-1, least + 1)])
    open_loads = fixed[open_].ravel()
    cost, most = np.zeros(least + 1), np.full(least + 1, np.inf)
    cost[least], most[least] = -1.0, FAR_M
    cost[outside:moments] = _OUTSIDE
    cost[moments:least] = _OUTSIDE**2
    limits = np.concatenate([inside, open_loads]), np.concatenate([np.full(len(place), np.inf), open_loads])
    try:
        force = minimised(cost, Entries.of(rows), limits, (np.zeros(least + 1), most))
    except PetmjxError:
        return None
    if force is None:
        return None
    balancing, beyond = load.copy(), np.zeros(len(load))
    loads = fixed + reach @ (corner * force[:f]).T
    loads[:, 1:] += middle * loads[:, :1]
    balancing[changed] = mean * loads
    beyond[changed] = force[outside:moments]
    unborne = np.abs(force[moments:least]).reshape(-1, 4).max(axis=1, initial=0.0)
    beyond[changed[open_]] = np.maximum(beyond[changed[open_]], unborne)
    return balancing, beyond


def _edges_of(bearing: Bearing, boxes: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """The edges of the supports of ``boxes``: (e,) index of the box in ``boxes``, (e, 2) inward normal, and (e,) scalar
    product of the normal with any point of the edge."""
    one, several = (np.flatnonzero(which) for which in (bearing.n_supports[boxes] == 1, bearing.n_supports[boxes] > 1))
    contact, number = bearing.ends[boxes[one]], bearing.number_of_hull[boxes[several]]
    hull, edge = np.nonzero(np.isfinite(bearing.hulls.offset[number]))
    place = np.concatenate([np.repeat(one, 4), several[hull]])
    normal = np.concatenate([np.tile(_ALONG, (len(one), 1)), bearing.hulls.normal[number[hull], edge]])
    along = np.concatenate([bearing.low[contact], -bearing.high[contact]], axis=1).ravel()
    return place, normal, np.concatenate([along, bearing.hulls.offset[number[hull], edge]])


def rebalanced_loads(
    bearing: Bearing, load: FloatArray, edge_m: FloatArray, placed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Two arrays: (n, 3) loads of one scene, if supports share loads so that the loads are as far inside the edges as
    possible; and (n,) the distances of these loads from edges, m.

    Args:
        bearing: the contacts between boxes and their supports.
        load: (n, 3 or 4) loads if supports share loads like springs. Some of these loads are beyond edges.
        edge_m: (n,) distances of these loads from edges, m.
        placed: (n,) whether each box is already placed.
    """
    result = balanced_loads(bearing, load, edge_m, placed)
    if result is None:
        return load[:, :3], edge_m
    balancing, beyond = result
    # If no forces balance all boxes, loads inside the edges keep their distances in ``edge_m``. If forces balance all
    # boxes, only loads that the programme has not changed keep their distances in ``edge_m``.
    is_unchanged = (edge_m >= 0) if (beyond > BEYOND_M).any() else (balancing == load[:, :3]).all(axis=1)
    balanced_m = bearing.edges_m(balancing)
    edges = np.where(~placed | is_unchanged, edge_m, np.maximum(balanced_m, 0.0))
    edges = np.where(beyond > BEYOND_M, np.minimum(balanced_m, -beyond), edges)
    return balancing, edges
