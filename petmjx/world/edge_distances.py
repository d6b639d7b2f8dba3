"""Distances of loads from the edges of the boxes' supports, by the plan: when it is complete, and while it is built.

The load of a box is its own weight plus the weight that rests on it. If supports share loads as springs do, a load may
be beyond an edge although other shares would keep all loads inside. So petmjx searches for such shares
(petmjx.world.balance_programme). A load is beyond an edge only if vertical forces cannot balance the boxes.

While the plan is built, a counterweight that comes too late holds nothing. So a plan may fall while it is built,
although all its loads are inside once it is complete. Therefore, the load of every box is checked after each placement
that changes it.

The part of an upper box's weight that a box bears does not depend on other boxes, as long as no support pulls. So the
weight of each box is passed down once, on its own. The load of a box after a placement is the sum of the parts of the
boxes that are placed. Only boxes with a support that pulls, and the boxes below them, are computed placement by
placement.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.balance_programme import BEYOND_M, balanced_loads
from petmjx.world.history import CARRIER
from petmjx.world.load_sharing import IntArray, pulls
from petmjx.world.scene import Scene
from petmjx.world.supports import Bearing, add_rows, bearing_of, ranges

ROUNDING_M: Final = 1e-9
"""A load beyond an edge by less than this, m, counts as on the edge, since sums of millimetres have rounding errors."""


class Edges(NamedTuple):
    """Distances of n boxes' loads from the nearest edge of their supports, m: positive inside, negative beyond.

    NaN: the box has no support, or is not placed.

    Attributes:
        by_weight: (n,) distances of the boxes' own weights alone.
        by_load: (n,) distances of the boxes' loads, which include their own weights.
    """

    by_weight: FloatArray
    by_load: FloatArray

    @property
    def least(self) -> FloatArray:
        """(n,) the smaller one of ``by_weight`` and ``by_load`` of each box. Exception: if a box would tip over by its
        own weight, but its load holds it down, the distance of the load counts. Whether such a box could be placed at
        all is checked elsewhere (``building_edges``)."""
        held = (self.by_weight < 0) & (self.by_load >= 0)
        nearer: FloatArray = np.where(held, self.by_load, np.fmin(self.by_weight, self.by_load))
        return nearer


def edges_of(bearing: Bearing, placed: Sequence[int]) -> list[Edges]:
    """For each scene, the distances of its boxes' loads, once its first ``placed`` boxes are placed.

    Args:
        placed: number of placed boxes of each scene.
    """
    _, by_weight, by_load = loads_and_edges(bearing, placed)
    return [Edges(by_weight[i:k], by_load[i:k]) for i, k in pairwise(bearing.boxes.first.tolist())]


def loads_and_edges(bearing: Bearing, placed: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, 4) loads of all boxes (see ``Bearing.loads``), (n,) distances of their own weights from edges, and (n,)
    distances of their loads.

    Args:
        placed: number of placed boxes of each scene.
    """
    among, load = bearing.boxes.among(placed), bearing.loads(placed)
    by_weight, by_load = (
        np.where(among, _exact(bearing.edges_m(moments)), np.nan) for moments in (bearing.weights, load)
    )
    open_ = below_several(bearing, among) if (by_load < 0).any() else among
    for number in np.setdiff1d(
        _scenes(bearing, (by_load < 0) & open_), _scenes(bearing, (by_load < 0) & ~open_)
    ).tolist():
        boxes = slice(*bearing.boxes.first[number : number + 2].tolist())
        one = bearing.of_scene(number)
        load[boxes, :3], by_load[boxes] = rebalanced_loads(one, load[boxes], by_load[boxes], among[boxes])
    return load, by_weight, by_load


def _scenes(bearing: Bearing, boxes: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Numbers of the scenes that contain at least one of these boxes."""
    return np.unique(np.searchsorted(bearing.boxes.first, np.flatnonzero(boxes), side="right") - 1)


def _exact(edge_m: FloatArray) -> FloatArray:
    """The distances, with 0 for a load that is beyond the edge only by rounding."""
    return np.where((edge_m < 0) & (edge_m > -ROUNDING_M), 0.0, edge_m)


def rebalanced_loads(
    bearing: Bearing, load: FloatArray, edge_m: FloatArray, placed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) loads of one scene, balanced so that they are as far inside as possible, and (n,) their distances from
    edges, m.

    Called if loads seem to be beyond edges.
    """
    result = balanced_loads(bearing, load, edge_m, placed)
    if result is None:
        return load[:, :3], edge_m
    balancing, beyond = result
    # if nothing balances the boxes, a load that is inside keeps its distance
    is_unchanged = (edge_m >= 0) if (beyond > BEYOND_M).any() else (balancing == load[:, :3]).all(axis=1)
    balanced_m = bearing.edges_m(balancing)
    edges = np.where(~placed | is_unchanged, edge_m, np.maximum(balanced_m, 0.0))
    edges = np.where(beyond > BEYOND_M, np.minimum(balanced_m, -beyond), edges)
    return balancing, edges


def below_several(bearing: Bearing, among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) whether a box bears part of a box with several supports. If so, its load depends on the shares of these
    supports.

    Args:
        among: (n,) mask: of the boxes with several supports, only these are considered.
    """
    return bearing.all_below(among & (bearing.n_supports > 1))


MOST_PROGRAMMES: Final = 2
"""Largest number of placements of a plan for which a linear programme is solved. One programme takes a few
milliseconds, and more for a hundred boxes on several supports. After further placements, loads that seem to be beyond
edges are left out, since only a programme could prove that they are."""


class BuildingLoads(NamedTuple):
    """Loads after placements, as p sorted pairs: a box, and a box whose placement changes the load of the first box.

    Attributes:
        box: (p,) the box that has the load.
        step: (p,) number of the box after whose placement this load acts.
        load: (p, 3) as in ``Bearing.loads``, without the height.
        edge_m: (p,) distance of the load from the nearest edge, positive inside; NaN if nothing bears the box.
    """

    box: IntArray
    step: IntArray
    load: FloatArray
    edge_m: FloatArray


class LeastBuildingEdge(NamedTuple):
    """The load that is furthest beyond an edge while a plan is built; if none is beyond, the load that is nearest to an
    edge.

    Attributes:
        edge_m: distance from the edge, positive inside; NaN: there is no load.
        box: the box that has the load; -1: there is no load.
        step: number of the box after whose placement this load acts; -1: there is no load.
        nearest_m: distance of the load that is nearest to an edge, on either side.
        nearest_box: the box with the load nearest to an edge.
        nearest_step: number of the box after whose placement this load acts.
    """

    edge_m: float
    box: int
    step: int
    nearest_m: float
    nearest_box: int
    nearest_step: int


_NO_EDGE: Final = LeastBuildingEdge(np.nan, -1, -1, np.nan, -1, -1)


def building_edges(bearing: Bearing, placed: Sequence[int]) -> list[LeastBuildingEdge]:
    """For each scene, the smallest distance from an edge over the placements of its first ``placed`` boxes.

    Args:
        placed: number of placed boxes of each scene.
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
    """The first placement after which the load of a box is beyond an edge while a plan is built, and the first later
    one after which the load is inside again. A placement is given by the number of the placed box; -1: there is
    none."""
    built = building_loads_of(bearing_in_order(bearing_of(scene)), [scene.n_boxes])
    steps, edge = built.step[built.box == box], built.edge_m[built.box == box]
    beyond = np.flatnonzero(edge < 0)
    if not len(beyond):
        return -1, -1
    inside = np.flatnonzero((edge >= 0) & (steps > steps[beyond[0]]))
    return int(steps[beyond[0]]), int(steps[inside[0]]) if len(inside) else -1


def bearing_in_order(bearing: Bearing) -> Bearing:
    """A bearing without supports that are placed after the box that they bear: when they are placed, this box has
    already fallen.
    """
    before = bearing.lower < bearing.upper
    if before.all():
        return bearing
    return Bearing(
        bearing.boxes, bearing.upper[before], bearing.lower[before], bearing.low[before], bearing.high[before]
    )


def building_loads_of(bearing: Bearing, placed: Sequence[int]) -> BuildingLoads:
    """The loads of boxes after all placements that change them.

    Args:
        bearing: several scenes joined. No box may lie on a box that is placed later.
        placed: number of placed boxes of each scene.
    """
    box, step, part = _parts(bearing, bearing.boxes.among(placed))
    begins = np.searchsorted(box, np.arange(len(bearing.boxes.mass) + 1))
    load = _running_sums(part, begins)
    several = bearing.n_supports > 1
    if several.any():
        _without_pulls(bearing, begins, step, load)
    point = load[:, 1:] / load[:, :1]
    edge = bearing.inside_m(box, point)
    edge[(edge < 0) & (edge > -ROUNDING_M)] = 0.0
    return BuildingLoads(box, step, load, edge)


def _parts(bearing: Bearing, among: NDArray[np.bool_]) -> tuple[IntArray, IntArray, FloatArray]:
    """Three arrays for p sorted pairs of boxes: (p,) the bearing box; (p,) a box whose weight it bears at least in
    part; and (p, 3) this part. A box also bears its own weight."""
    n, boxes = len(among), np.flatnonzero(among)
    alone = bearing.n_supports == 1
    below = np.full(n, CARRIER)
    below[alone] = bearing.lower[bearing.ends[:-1][alone]]
    # A weight is passed down undivided, as far as the carrier or the first box with several supports.
    pairs, box, step = [(boxes[:0], boxes[:0])], boxes, boxes
    while len(box):
        pairs.append((box, step))
        under = below[box]
        goes_on = np.flatnonzero(under != CARRIER)
        box, step = under[goes_on], step[goes_on]
    box, step = (np.concatenate(numbers) for numbers in zip(*pairs, strict=True))
    weights = (bearing.weights + 0.0)[:, :3].copy()  # + 0.0 turns -0.0 into 0.0, as in sums
    several = bearing.n_supports[box] > 1
    keys, parts = _shared_parts(bearing, box[several] * n + step[several], weights.take(step[several], axis=0))
    box, step = np.concatenate([box[~several], keys // n]), np.concatenate([step[~several], keys % n])
    order = np.argsort(box * n + step)
    box, step, whole = box[order], step[order], order < len(order) - len(keys)
    part = weights.take(step, axis=0)
    part[~whole] = parts.take(order[~whole] - (len(order) - len(keys)), axis=0)
    return box, step, part


def _shared_parts(bearing: Bearing, keys: IntArray, parts: FloatArray) -> tuple[IntArray, FloatArray]:
    """The parts of weights that reach boxes with several supports, and the parts that reach all boxes below these: (k,)
    keys, and (k, 3) parts. A key is the number of the bearing box · n + the number of the box whose weight it is.

    Args:
        keys, parts: keys and parts of the weights that are still undivided when they reach boxes with several supports.
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
    """(k, 3) the parts of loads that reach (k,) contacts. A box on one support passes on its whole load.

    Args:
        load: (k, 3) load of the upper box of each contact.
    """
    passed = load + 0.0  # + 0.0 turns -0.0 into 0.0, as in sums
    several = np.flatnonzero(bearing.n_supports.take(bearing.upper.take(contact)) > 1)
    passed[several] = bearing.shared(contact[several], load.take(several, axis=0))
    return passed


def _running_sums(part: FloatArray, begins: IntArray) -> FloatArray:
    """(p, 3) running sums of the parts, over the pairs of each box."""
    sums, count = part.copy(), np.diff(begins)
    longest = np.argsort(-count, kind="stable")
    place = begins[:-1][longest]
    still = np.searchsorted(-count[longest], -np.arange(int(count.max(initial=0)))).tolist()
    for boxes in still[1:]:  # the loop adds one pair of each box at a time, so that sums do not depend on other boxes
        before = place[:boxes]
        place = before + 1
        sums[place] = sums.take(place, axis=0) + sums.take(before, axis=0)
    return sums


def _without_pulls(bearing: Bearing, begins: IntArray, step: IntArray, load: FloatArray) -> None:
    """Correct the loads of boxes on which a support would pull, and of all boxes below them."""
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
    key = np.repeat(np.arange(n), count) * n + step  # keys increase
    # forces at the contacts of corrected boxes: at each contact, one force for each load of the upper box
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
    """(k, 3) the forces with which loads press at contacts.

    Args:
        owner: (p,) the box that has each load.
        load: (p, 3) the loads.
        rows: (k,) number of the load that presses at each contact.
        contact: (k,) numbers of contacts, load by load: for each load, all contacts on which its box rests.
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
    """The smallest distance of one scene from an edge, if every load that seems to be beyond an edge depends on how
    supports share loads.

    A linear programme decides whether the loads furthest beyond an edge are really beyond it.
    """
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
    """The pairs of one scene that hold the load of each box after the placement ``step``, and (n,) the distances of
    these loads from edges, balanced so that they are as far inside as possible."""
    n = len(bearing.boxes.mass)
    now = np.flatnonzero(built.step <= step)
    last = now[np.flatnonzero(np.diff(built.box[now], append=n))]
    load, edge = np.zeros((n, 3)), np.full(n, np.nan)
    load[built.box[last]], edge[built.box[last]] = built.load[last], built.edge_m[last]
    _, edges = rebalanced_loads(bearing, load, edge, np.arange(n) <= step)
    return last, edges


def _least(built: BuildingLoads) -> LeastBuildingEdge:
    """The smallest distance of a load from an edge in one scene."""
    return _least_of_scenes(built, np.zeros(len(built.box), np.intp), np.array([0, 0]))[0]


def _least_of_scenes(built: BuildingLoads, scene: IntArray, first: IntArray) -> list[LeastBuildingEdge]:
    """The smallest distance of each scene from an edge.

    Args:
        scene: (p,) the scene of each pair, in order.
        first: (s + 1,) first box of each scene.
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
    """(g,) the groups with a value that is not NaN, and (g,) the index of the smallest value of each group; if several
    are equal, the first.

    Args:
        group: (p,) the group of each value, in order.
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
    """(p,) whether a load depends on how a box with several supports shares its load."""
    shares = (bearing.n_supports[built.step] > 1) & (built.step != built.box)
    first = np.full(len(bearing.boxes.mass), len(bearing.boxes.mass))
    np.minimum.at(first, built.box[shares], built.step[shares])
    depends: NDArray[np.bool_] = first[built.box] <= built.step
    return depends
