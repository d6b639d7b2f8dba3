"""Loads that a stack can balance, by a linear programme with vertical forces.

Statics does not determine how a box shares its load among several supports. With some shares, a load may be beyond the
edge of its supports, while with other shares all loads are inside. If such shares exist, rigid boxes stand. The
unknowns are forces at the corners of all contact areas of boxes with several supports. The forces must push and balance
every box. The programme picks feasible forces so that the load nearest to an edge is as far inside as possible. If no
forces keep all loads inside, the programme minimises how far loads go beyond edges. (Forces of this kind: Livesley
1978, "Limit analysis of structures formed from rigid blocks", International Journal for Numerical Methods in
Engineering 12(12).)

A box on one support passes its whole load to this support. Such a box adds edges to the programme, but no unknown
forces.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.load_sharing import IntArray
from petmjx.world.supports import Bearing

FAR_M: Final = 0.1
"""If all loads are at least this far inside their edges, m, the programme does not move them further inside."""

BEYOND_M: Final = 1e-6
"""A load counts as beyond an edge only if the programme leaves it farther outside than this, m. The solver's own
tolerance is a tenth of this."""

_OUTSIDE: Final = 10.0
"""In the programme, a metre by which a load is outside an edge costs this many times as much as a metre inside. A
moment that no support bears costs this many times as much as a metre outside.
"""

_ALONG: Final = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Normals of a rectangle's edges: two at the lowest corner, then two at the highest."""


def balanced_loads(
    bearing: Bearing, load: FloatArray, edge_m: FloatArray, placed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray] | None:
    """(n, 3) loads that balance the boxes of one scene as well as possible, and (n,) the distances by which they are
    still beyond edges, m; None if none of the loads outside an edge can change.

    Args:
        bearing: the bearing of one scene.
        load: (n, 3) or more columns: loads with any feasible shares of the supports; 0 for boxes that are not placed.
        edge_m: (n,) distances of these loads from the edges, positive inside.
        placed: (n,) which boxes are placed.
    """
    outside = placed & (edge_m < 0)
    passed, fixed = _fixed_forces(bearing, placed)
    several = np.flatnonzero(placed & (bearing.n_supports > 1))
    together = np.flatnonzero((placed & (bearing.n_supports > 1))[bearing.upper])
    # the loads that change if a box with several supports shares its load differently: the loads of the boxes below it.
    # Its own load counts as one of them, since the equations contain it.
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
    """(c, n) whether the load of each box contains the whole force at a contact, and (n, 3) the part of each load that
    does not depend on these forces.

    A force at a contact is in the load of the box below and, as long as boxes have one support, in the loads of the
    boxes further below. The boxes' own weights are passed on by the same rule.
    """
    n = len(placed)
    one = placed & (bearing.n_supports == 1)
    below = np.full(n, -1)
    below[bearing.upper] = bearing.lower
    below[~one] = -1
    reach = np.zeros((n + 1, n), bool)  # the last row belongs to the carrier
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
    """(n, 3) loads, with those of the boxes ``changed`` taken from the programme, and (n,) their distances beyond
    edges; None: no solution.

    The unknowns are the forces at the four corners of each contact; the distance of each load outside its edges;
    moments that no support bears, for boxes with several supports whose load is beyond their hull; and the smallest
    distance of any load inside its edges.
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
    # rows of edges are divided by the previous loads, so that these rows, and the solver's tolerance, are in metres
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
    force = _least(cost, rows, *limits, most)
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
    """The edges of the boxes' supports: (e,) number of the box within ``boxes``, (e, 2) normals and (e,) offsets."""
    one, several = (np.flatnonzero(which) for which in (bearing.n_supports[boxes] == 1, bearing.n_supports[boxes] > 1))
    contact, number = bearing.ends[boxes[one]], bearing.number_of_hull[boxes[several]]
    hull, edge = np.nonzero(np.isfinite(bearing.hulls.offset[number]))
    place = np.concatenate([np.repeat(one, 4), several[hull]])
    normal = np.concatenate([np.tile(_ALONG, (len(one), 1)), bearing.hulls.normal[number[hull], edge]])
    along = np.concatenate([bearing.low[contact], -bearing.high[contact]], axis=1).ravel()
    return place, normal, np.concatenate([along, bearing.hulls.offset[number[hull], edge]])


def _least(
    cost: FloatArray, rows: FloatArray, least: FloatArray, most: FloatArray, bound: FloatArray
) -> FloatArray | None:
    """The x that minimises ``cost @ x`` subject to least ≤ rows @ x ≤ most and 0 ≤ x ≤ bound, by HiGHS; None if HiGHS
    gives up."""
    # SciPy takes a second to load, and few plans need it.
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csc_array

    row, column = np.nonzero(rows)
    order = np.argsort(column, kind="stable")
    begins = np.searchsorted(column[order], np.arange(rows.shape[1] + 1)).astype(np.int32)
    table = csc_array((rows[row, column][order], row[order].astype(np.int32), begins), shape=rows.shape)
    result = milp(cost, constraints=LinearConstraint(table, least, most), bounds=Bounds(0.0, bound))
    answer: FloatArray | None = result.x
    return answer
