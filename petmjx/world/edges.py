"""How far loads are from the edges of what bears boxes: by the plan, at rest, and while the plan is built.

The load of a box is its own weight and all that rests on it. Where the way in which boxes share loads by springs has a
load beyond an edge, and another way may have it inside, that is looked for (petmjx.world.balanced): a load is beyond an
edge only if vertical forces cannot balance the boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.world.balanced import BEYOND_M, balanced
from petmjx.world.bearing import Bearing, together

ROUNDING_M: Final = 1e-9
"""A load that is less beyond an edge lies on it: rounding errors of sums of millimetres."""


class Edges(NamedTuple):
    """How far inside the nearest edge of what bears them loads of n boxes act, m; negative: beyond it. NaN: nothing
    bears the box, or it is not placed.

    Attributes:
        by_weight: (n,) of their own weights alone.
        by_load: (n,) of their loads.
    """

    by_weight: FloatArray
    by_load: FloatArray

    @property
    def least(self) -> FloatArray:
        """(n,) the nearer one. A box whose own weight would tip it over, but is held down by what rests on it, has that
        of its load: how it came to stand is a matter of building."""
        held = (self.by_weight < 0) & (self.by_load >= 0)
        nearer: FloatArray = np.where(held, self.by_load, np.fmin(self.by_weight, self.by_load))
        return nearer


def edges_of(bearings: Sequence[Bearing], placed: Sequence[int], joined: Bearing | None = None) -> list[Edges]:
    """The edges of the boxes of each scene, once so many are placed.

    Args:
        joined: the bearings together, where they are at hand.
    """
    if not bearings:
        return []
    bearing = joined or together(bearings)
    _, by_weight, by_load = loads_and_edges(bearings, bearing, placed)
    return [Edges(by_weight[i:k], by_load[i:k]) for i, k in pairwise(bearing.boxes.first.tolist())]


def loads_and_edges(
    bearings: Sequence[Bearing], bearing: Bearing, placed: Sequence[int]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, 4) loads of all boxes, as ``Bearing.loads`` has them, and (n,) edges of their own weights and of their loads.

    Args:
        bearing: the others together.
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
        one = bearings[number]
        bearing.share_hulls(number, one)
        load[boxes, :3], by_load[boxes] = rebalanced(one, load[boxes], by_load[boxes], among[boxes])
    return load, by_weight, by_load


def _scenes(bearing: Bearing, boxes: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Which scenes have one of these boxes."""
    return np.unique(np.searchsorted(bearing.boxes.first, np.flatnonzero(boxes), side="right") - 1)


def _exact(edge_m: FloatArray) -> FloatArray:
    """The distances, with 0 for those on the edge but for rounding."""
    return np.where((edge_m < 0) & (edge_m > -ROUNDING_M), 0.0, edge_m)


def rebalanced(
    bearing: Bearing, load: FloatArray, edge_m: FloatArray, placed: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) loads of one scene, and (n,) their edges, where loads seem to be beyond edges: as well inside as forces
    that balance allow."""
    result = balanced(bearing, load, edge_m, placed)
    if result is None:
        return load[:, :3], edge_m
    balancing, beyond = result
    # what is not beyond an edge either way keeps its distance where there is no balance
    kept = (edge_m >= 0) if (beyond > BEYOND_M).any() else (balancing == load[:, :3]).all(axis=1)
    edges = np.where(~placed | kept, edge_m, np.maximum(bearing.edges_m(balancing), 0.0))
    edges = np.where(beyond > BEYOND_M, np.minimum(bearing.edges_m(balancing), -beyond), edges)
    return balancing, edges


def below_several(bearing: Bearing, among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) which boxes bear part of a box with several supports, so that their loads depend on how it shares its own,
    ``among`` these."""
    several = among & (bearing.n_supports > 1)
    below = np.zeros(len(among), bool)
    for between in bearing.levels:
        upper, lower = bearing.upper[between], bearing.lower[between]
        np.logical_or.at(below, lower, below[upper] | several[upper])
    return below
