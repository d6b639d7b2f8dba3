"""Distances of boxes' loads from the edges of their supports, while plans are built. docs/metrics.md, section "Edges",
explains the distances.

A box that would hold down another box may be placed too late, when the other box has already fallen. So a plan may fall
while it is built, although all loads of the complete plan are inside the edges. Therefore, the load of every box is
checked after each placement that changes this load.

As long as no support would have to pull, the part of one box's weight that another box carries does not depend on any
third box. So the weight of each box is distributed to the boxes below only once. The load of a box after a placement is
the sum of the parts of all placed boxes. Only for boxes with a support that would pull, and for the boxes below them,
loads are computed anew after each placement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.balanced_loads import ROUNDING_M, rebalanced_loads
from petmjx.world.bearings import Bearing, add_rows, ranges
from petmjx.world.history import CARRIER
from petmjx.world.pushing_forces import IntArray, pulls
from petmjx.world.scene import Scene
from petmjx.world.supports import bearing_of

MOST_PROGRAMMES: Final = 2
"""For at most this number of a plan's placements, a linear programme is solved. One programme takes a few milliseconds,
and more if a hundred boxes have several supports. After all other placements, loads that seem to be beyond edges are
ignored. Such a load might be inside if supports shared loads in another way, and only a programme could rule this
out."""


class BuildingLoads(NamedTuple):
    """The loads of boxes after the placements of other boxes.

    There is one entry for each of p pairs of boxes. The placement of the second box of a pair changes the load of the
    first box. Pairs are sorted by the first box, then by the second box.

    Attributes:
        box: (p,) number of the first box, which has the load.
        step: (p,) number of the second box, after whose placement the load acts.
        load: (p, 3) the load: mass, kg, and its first moments along x and y, kg·m.
        edge_m: (p,) distance of the load from the nearest edge of the first box's supports, m: positive inside,
            negative beyond; NaN if the box has no support.
    """

    box: IntArray
    step: IntArray
    load: FloatArray
    edge_m: FloatArray


class LeastBuildingEdge(NamedTuple):
    """The two most critical loads that act while a plan is built. One is the load furthest beyond an edge or, if none
    is beyond, the load that is least far inside. The other is the load nearest to an edge, whether inside or beyond it.

    Distances are positive inside an edge and negative beyond it. So the smallest distance belongs to the load furthest
    beyond an edge. The load nearest to an edge may be on either side of the edge. If a plan has no loads, distances are
    NaN and numbers are -1.

    Attributes:
        edge_m: smallest distance of a load from an edge, m.
        box: number of the box that has this load.
        step: number of the box after whose placement this load acts.
        nearest_m: distance of the load nearest to an edge, m.
        nearest_box: number of the box that has this load.
        nearest_step: number of the box after whose placement this load acts.
    """

    edge_m: float
    box: int
    step: int
    nearest_m: float
    nearest_box: int
    nearest_step: int


def building_edges(bearing: Bearing, placed: Sequence[int]) -> list[LeastBuildingEdge]:
    """For each scene, the smallest distance of any load from an edge of the loaded box's supports, while boxes are
    placed one by one.

    Args:
        bearing: the contacts between boxes and their supports, of one or several scenes.
        placed: number of boxes of each scene that are placed; later boxes are ignored.
    """
    n_scenes = len(bearing.boxes.first) - 1
    if not any(placed):
        return [_NO_EDGE] * n_scenes
    bearing = bearing_in_order(bearing)
    built = building_loads_of(bearing, placed)
    beyond, depends = built.edge_m < 0, depends_on_sharing(bearing, built)
    scene = np.searchsorted(bearing.boxes.first, built.box, side="right") - 1
    surely, perhaps = (np.bincount(scene[beyond & which], minlength=n_scenes) > 0 for which in (~depends, depends))
    edge = np.where(beyond & depends & surely[scene], np.nan, built.edge_m)
    begins = np.searchsorted(scene, np.arange(n_scenes + 1)).tolist()
    least = _least_of_scenes(built._replace(edge_m=edge), scene, bearing.boxes.first)
    for number in np.flatnonzero(perhaps & ~surely).tolist():
        pairs, first = slice(begins[number], begins[number + 1]), int(bearing.boxes.first[number])
        of_one = BuildingLoads(built.box[pairs] - first, built.step[pairs] - first, built.load[pairs], edge[pairs])
        least[number] = _exact_least_edge(bearing.of_scene(number), of_one)
    return least


def steps_beyond(scene: Scene, box: int) -> tuple[int, int]:
    """The first placement after which the load of ``box`` is beyond an edge, and the next placement after which this
    load is inside all edges again. A placement is given by the number of the placed box; -1 means that there is no such
    placement."""
    built = building_loads_of(bearing_in_order(bearing_of(scene)), [scene.n_boxes])
    steps, edge = built.step[built.box == box], built.edge_m[built.box == box]
    beyond = np.flatnonzero(edge < 0)
    if not len(beyond):
        return -1, -1
    inside = np.flatnonzero((edge >= 0) & (steps > steps[beyond[0]]))
    return int(steps[beyond[0]]), int(steps[inside[0]]) if len(inside) else -1


def bearing_in_order(bearing: Bearing) -> Bearing:
    """The contacts of ``bearing`` in which the support is placed before the box above it. If a support is placed after
    the box above, this box has already fallen."""
    before = bearing.lower < bearing.upper
    if before.all():
        return bearing
    return Bearing(
        bearing.boxes, bearing.upper[before], bearing.lower[before], bearing.low[before], bearing.high[before]
    )


def building_loads_of(bearing: Bearing, placed: Sequence[int], before: Sequence[int] | None = None) -> BuildingLoads:
    """The load of each box after every placement that changes this load.

    Args:
        bearing: the contacts between boxes and their supports, of one or several scenes. No box may lie on a box that
            is placed later.
        placed: number of boxes of each scene that are placed; later boxes are ignored.
        before: in each scene, the placements of this number of first boxes are left out: the result has only the loads
            after later placements. None: no placement is left out.
    """
    n, first = len(bearing.boxes.mass), bearing.boxes.first
    begin = np.repeat(first[:-1] + (0 if before is None else before), np.diff(first))
    box, step, part = _parts(bearing, bearing.boxes.among(placed), begin - 1)
    begins = np.searchsorted(box, np.arange(n + 1))
    load = _running_sums(part, begins)
    several = bearing.n_supports > 1
    if several.any():
        _without_pulls(bearing, begins, step, load)
    if before is not None:
        later = np.flatnonzero(step >= begin[step])
        box, step, load = box[later], step[later], load.take(later, axis=0)
    point = load[:, 1:] / load[:, :1]
    edge = bearing.inside_m(box, point)
    edge[(edge < 0) & (edge > -ROUNDING_M)] = 0.0
    return BuildingLoads(box, step, load, edge)


def _parts(bearing: Bearing, among: NDArray[np.bool_], earliest: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """(p,) numbers of lower boxes, (p,) numbers of upper boxes, and (p, 3) the part of the upper box's weight that the
    lower box carries, for p sorted pairs of boxes. Every box also forms a pair with itself.

    Args:
        among: (n,) the boxes that are placed.
        earliest: (n,) for each box, the first box of its scene that may be an upper box. All boxes before this first
            box count as parts of it, so that a pair with this box has the sum of their weights.
    """
    n, boxes = len(among), np.flatnonzero(among)
    alone = bearing.n_supports == 1
    below = np.full(n, CARRIER)
    below[alone] = bearing.lower[bearing.ends[:-1][alone]]
    # A weight is passed down undivided until it reaches the carrier or a box with several supports.
    pairs, box, upper = [(boxes[:0], boxes[:0])], boxes, boxes
    while len(box):
        pairs.append((box, upper))
        under = below[box]
        goes_on = np.flatnonzero(under != CARRIER)
        box, upper = under[goes_on], upper[goes_on]
    box, upper = (np.concatenate(numbers) for numbers in zip(*pairs, strict=True))
    key = box * n + np.maximum(upper, earliest[upper])
    weights = (bearing.weights + 0.0)[:, :3].copy()  # + 0.0 turns -0.0 into 0.0
    part: FloatArray = weights.take(upper, axis=0)
    several = bearing.n_supports[box] > 1
    shared_keys, shared_parts = _shared_parts(bearing, key[several], part[several])
    key, part = np.concatenate([key[~several], shared_keys]), np.concatenate([part[~several], shared_parts])
    order = np.argsort(key)
    key, part = key[order], part.take(order, axis=0)
    is_new = np.diff(key, prepend=-1) > 0
    if not is_new.all():
        begins = np.flatnonzero(is_new)
        key, part = key[begins], np.add.reduceat(part, begins)
    return key // n, key % n, part


def _shared_parts(bearing: Bearing, keys: IntArray, parts: FloatArray) -> tuple[IntArray, FloatArray]:
    """Divide weights among supports, down to the carrier. Returns (k,) keys and (k, 3) parts of weights: the parts that
    boxes with several supports carry, and the parts that the boxes below them carry.

    A key is a number that names a part of a weight, for n boxes: (number of the box that carries the part) · n +
    (number of the box to whose weight the part belongs).

    Args:
        bearing: the contacts between boxes and their supports.
        keys, parts: the parts from which the division starts, and their keys. For each box with several supports, these
            are its own weight, and the weights that boxes with a single support pass down to it undivided.
    """
    n = len(bearing.boxes.mass)
    between = np.flatnonzero(bearing.lower != CARRIER)
    count = np.bincount(bearing.upper[between], minlength=n)
    first = np.cumsum(count) - count
    most = int(bearing.level.max(initial=0)) + 1
    waiting: list[list[tuple[IntArray, FloatArray]]] = [[] for _ in range(most)]

    def wait(key: IntArray, part: FloatArray) -> None:
        level = bearing.level[key // n]
        for number in np.unique(level).tolist():
            in_level = level == number
            waiting[number].append((key[in_level], part[in_level]))

    wait(keys, parts)
    finished_parts: list[tuple[IntArray, FloatArray]] = [(keys[:0], parts[:0])]
    for level in waiting:
        if not level:
            continue
        all_keys, all_parts = (np.concatenate(arrays) for arrays in zip(*level, strict=True))
        key, place = np.unique(all_keys, return_inverse=True)
        part: FloatArray = np.stack([np.bincount(place, column, len(key)) for column in all_parts.T], axis=1)
        finished_parts.append((key, part))
        upper = key // n
        times = count[upper]
        rows = np.repeat(np.arange(len(key)), times)
        contact = between[first[upper[rows]] + np.arange(len(rows)) - np.repeat(np.cumsum(times) - times, times)]
        if len(rows):
            wait(bearing.lower[contact] * n + key[rows] % n, _passed(bearing, contact, part.take(rows, axis=0)))
    finished_keys, sums = zip(*finished_parts, strict=True)
    return np.concatenate(finished_keys), np.concatenate(sums)


def _passed(bearing: Bearing, contact: IntArray, load: FloatArray) -> FloatArray:
    """(k, 3) for each contact, the part of the upper box's load that the contact carries. If the upper box has only one
    support, its contact carries the whole load.

    Args:
        bearing: the contacts between boxes and their supports.
        contact: (k,) numbers of the contacts.
        load: (k, 3) load of the upper box of each contact.
    """
    passed = load + 0.0  # + 0.0 turns -0.0 into 0.0
    several = np.flatnonzero(bearing.n_supports.take(bearing.upper.take(contact)) > 1)
    passed[several] = bearing.shared(contact[several], load.take(several, axis=0))
    return passed


def _running_sums(part: FloatArray, begins: IntArray) -> FloatArray:
    """(p, 3) sums of the parts that the lower boxes carry: each row is the sum of ``part`` from the last row in
    ``begins`` up to this row."""
    sums, count = part.copy(), np.diff(begins)
    longest = np.argsort(-count, kind="stable")
    place = begins[:-1][longest]
    still = np.searchsorted(-count[longest], -np.arange(int(count.max(initial=0)))).tolist()
    for boxes in still[1:]:  # one pair of each box at a time, so that a box's sums do not depend on other boxes
        before = place[:boxes]
        place = before + 1
        sums[place] = sums.take(place, axis=0) + sums.take(before, axis=0)
    return sums


def _without_pulls(bearing: Bearing, begins: IntArray, step: IntArray, load: FloatArray) -> None:
    """If a support would pull on a box, correct the loads of the boxes below this box, in place.

    Args:
        bearing: the contacts between boxes and their supports.
        begins: (n + 1,) index of the first pair of each box; the last entry is the number of pairs.
        step: (p,) number of the box after whose placement each load acts.
        load: (p, 3) loads as in ``BuildingLoads``, if supports share loads like springs.
    """
    count, contacts = np.diff(begins), bearing.together
    upper = bearing.upper[contacts]
    pair, contact = ranges(begins[upper], count[upper]), np.repeat(contacts, count[upper])
    under = load.take(pair, axis=0)
    force = bearing.shared(contact, under)
    low, high = bearing.low.take(contact, axis=0), bearing.high.take(contact, axis=0)
    pulled = np.zeros(len(bearing.boxes.mass), bool)
    pulled[bearing.upper[contact[pulls(force, low, high, under[:, 0])]]] = True
    if not pulled.any():
        return
    pulled |= bearing.all_below(pulled)
    n = len(pulled)
    above = np.argsort(bearing.lower, kind="stable")
    n_above = np.bincount(bearing.lower[bearing.lower != CARRIER], minlength=n)
    above = above[np.count_nonzero(bearing.lower == CARRIER) :]
    first_above = np.cumsum(n_above) - n_above
    key = np.repeat(np.arange(n), count) * n + step  # The keys increase from pair to pair.
    # The array ``forces`` has the forces at the contacts of corrected boxes: for each contact, one force for each load
    # of the upper box
    size = np.where(pulled[bearing.upper], count[bearing.upper], 0)
    first, forces = np.cumsum(size) - size, np.zeros((size.sum(), 3))
    weights, boxes = bearing.weights[:, :3].copy(), np.flatnonzero(pulled)
    level = bearing.level[boxes]
    for number in np.unique(level).tolist():
        some = boxes[level == number]
        pairs, owner = ranges(begins[some], count[some]), np.repeat(some, count[some])
        times = n_above[owner]
        rows, contact = np.repeat(np.arange(len(pairs)), times), above[ranges(first_above[owner], times)]
        upper = bearing.upper[contact]
        last = np.searchsorted(key, upper * n + step[pairs[rows]], side="right") - 1
        placed = last >= begins[upper]
        rows, contact, upper, last = rows[placed], contact[placed], upper[placed], last[placed]
        through = pulled[upper]
        passed = np.zeros((len(rows), 3))
        passed[through] = forces.take((first[contact] + last - begins[upper])[through], axis=0)
        passed[~through] = _passed(bearing, contact[~through], load.take(last[~through], axis=0))
        load[pairs] = np.where((step[pairs] >= owner)[:, None], weights.take(owner, axis=0), 0.0)
        add_rows(load, pairs[rows], passed)
        supports = bearing.n_supports[owner]
        rows, contact = np.repeat(np.arange(len(pairs)), supports), ranges(bearing.ends[owner], supports)
        place = first[contact] + (pairs - begins[owner])[rows]
        forces[place] = _contact_pushes(bearing, owner, load.take(pairs, axis=0), rows, contact)


def _contact_pushes(
    bearing: Bearing, owner: IntArray, load: FloatArray, rows: IntArray, contact: IntArray
) -> FloatArray:
    """For p loads, (k, 3) the parts that contacts carry: row i is the part of the load ``rows[i]`` that the contact
    ``contact[i]`` carries.

    Args:
        bearing: the contacts between boxes and their supports.
        owner: (p,) number of the box that has each load.
        load: (p, 3) the loads.
        rows: (k,) number of the load that each contact helps to carry.
        contact: (k,) numbers of contacts, load by load: for each load, all contacts on which the load's box rests.
    """
    force = load.take(rows, axis=0)
    several = np.flatnonzero((bearing.n_supports[owner] > 1)[rows])
    rows, contact, under = rows[several], contact[several], force.take(several, axis=0)
    shared = bearing.shared(contact, under)
    low, high = bearing.low.take(contact, axis=0), bearing.high.take(contact, axis=0)
    pulled = np.zeros(len(owner), bool)
    pulled[rows[pulls(shared, low, high, under[:, 0])]] = True
    if pulled.any():
        of_pulled = np.flatnonzero(pulled[rows])
        number = (np.cumsum(pulled) - 1)[rows[of_pulled]]
        low, high = low.take(of_pulled, axis=0), high.take(of_pulled, axis=0)
        shared[of_pulled] = bearing.pushed(load[pulled], owner[pulled], number, low, high)
    force[several] = shared
    return force


def _exact_least_edge(bearing: Bearing, built: BuildingLoads) -> LeastBuildingEdge:
    """The smallest distance of a load from an edge in one scene, found by linear programmes. The programmes decide
    whether the loads that seem to be furthest beyond an edge are really beyond that edge. The function is meant for
    scenes in which every load that seems to be beyond an edge depends on how supports share loads."""
    edge = built.edge_m.copy()
    for _ in range(MOST_PROGRAMMES):
        if not (edge < 0).any():
            break
        step = int(built.step[np.nanargmin(edge)])
        last, seen = balanced_after(bearing, built, step)
        if (seen < 0).any():
            box = int(np.nanargmin(seen))
            return LeastBuildingEdge(float(seen[box]), box, step, *_least(built._replace(edge_m=edge))[3:])
        edge[last] = np.where(edge[last] < 0, seen[built.box[last]], edge[last])
    edge[edge < 0] = np.nan
    return _least(built._replace(edge_m=edge))


def balanced_after(bearing: Bearing, built: BuildingLoads, step: int) -> tuple[IntArray, FloatArray]:
    """The loads of one scene after the placement ``step``: their indices in ``built``, and (n,) the distance of each
    box's load from the edge of its supports, m (NaN for boxes without a load). Supports share loads in the best
    possible way."""
    n = len(bearing.boxes.mass)
    now = np.flatnonzero(built.step <= step)
    last = now[np.flatnonzero(np.diff(built.box[now], append=n))]
    load, edge = np.zeros((n, 3)), np.full(n, np.nan)
    load[built.box[last]], edge[built.box[last]] = built.load[last], built.edge_m[last]
    _, edges = rebalanced_loads(bearing, load, edge, np.arange(n) <= step)
    return last, edges


def _least(built: BuildingLoads) -> LeastBuildingEdge:
    """The smallest distance of any load of one scene from an edge of the loaded box's supports."""
    return _least_of_scenes(built, np.zeros(len(built.box), np.intp), np.array([0, 0]))[0]


def _least_of_scenes(built: BuildingLoads, scene: IntArray, first: IntArray) -> list[LeastBuildingEdge]:
    """For each scene, the smallest distance of any of its loads from an edge of the loaded box's supports.

    Args:
        built: the loads of all scenes.
        scene: (p,) number of the scene of each load, rising.
        first: (s + 1,) number of each scene's first box.
    """
    least, columns = [_NO_EDGE] * (len(first) - 1), list[list[Any]]()
    numbers: IntArray = scene[:0]
    # first the load furthest beyond an edge, then the load nearest to an edge
    for distance in (built.edge_m, np.abs(built.edge_m)):
        numbers, place = first_least(distance, scene)
        columns.append(built.edge_m[place].tolist())
        columns += [(values[place] - first[numbers]).tolist() for values in (built.box, built.step)]
    for number, *values in zip(numbers.tolist(), *columns, strict=True):
        least[number] = LeastBuildingEdge(*values)
    return least


def first_least(values: FloatArray, group: IntArray) -> tuple[IntArray, IntArray]:
    """(g,) numbers of the groups with a value that is not NaN, and (g,) the index of the smallest value in each of
    these groups. Of several equally small values, the first is taken.

    Args:
        values: (p,) the values.
        group: (p,) number of the group of each value, rising.
    """
    known = np.flatnonzero(~np.isnan(values))
    if not len(known):
        return known, known
    values, group = values[known], group[known]
    begins = np.flatnonzero(np.diff(group, prepend=-1))
    least = np.repeat(np.minimum.reduceat(values, begins), np.diff(begins, append=len(group)))
    at = np.flatnonzero(values == least)
    return group[begins], known[at[np.flatnonzero(np.diff(group[at], prepend=-1))]]


def depends_on_sharing(bearing: Bearing, built: BuildingLoads) -> NDArray[np.bool_]:
    """(p,) whether each load depends on how some box above divides its own load among its supports."""
    shares = (bearing.n_supports[built.step] > 1) & (built.step != built.box)
    first = np.full(len(bearing.boxes.mass), len(bearing.boxes.mass))
    np.minimum.at(first, built.box[shares], built.step[shares])
    depends: NDArray[np.bool_] = first[built.box] <= built.step
    return depends


_NO_EDGE: Final = LeastBuildingEdge(np.nan, -1, -1, np.nan, -1, -1)
