"""Distances of boxes' loads from the edges of their supports, for complete plans. docs/metrics.md, section "Edges",
explains the distances. petmjx.world.building_edges has the distances while plans are built.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.balanced_loads import ROUNDING_M, rebalanced_loads
from petmjx.world.bearings import Bearing
from petmjx.world.building_edges import bearing_in_order, building_loads_of
from petmjx.world.scene import Scene
from petmjx.world.supports import bearings_of

NEAR_EDGE_M: Final = 0.0005
"""Distance inside an edge, m, below which ``edge_risks`` counts a load as near the edge. Of 44 worlds that were
simulated again with stiffer contacts, 33 have a load near an edge; of all worlds, one in nine has such a load."""

MOST_EXAMINED_BOXES: Final = 96
"""Largest number of boxes of a scene that ``edge_risks`` examines. Examining a larger scene may take 50 ms."""

EXAMINED_AT_ONCE: Final = 64
"""Number of scenes that ``edge_risks`` examines together."""


class EdgeRisk(IntEnum):
    """The result of a quick static test of the loads of a scene, whose boxes are placed one by one.

    The greater the value, the longer the simulation may take. Boxes with a load beyond an edge fall. If a load is near
    an edge, the softness of contacts may decide whether the box falls, so the world is simulated again with stiffer
    contacts. Engines simulate the worlds with the greatest values first.
    """

    INSIDE = 0
    """Each load acts inside the edges, at least ``NEAR_EDGE_M`` from them."""

    BEYOND = 1
    """Some load acts beyond an edge, and no load is inside an edge by less than ``NEAR_EDGE_M``."""

    NEAR = 2
    """Some load acts inside an edge by less than ``NEAR_EDGE_M``, or the scene is too large to be examined."""


class Edges(NamedTuple):
    """Distances of the loads of n boxes from the nearest edge of their supports, m: positive inside the edges, negative
    beyond them.

    The distance is NaN if the box has no support or is not placed.

    Attributes:
        by_weight: (n,) distance from the nearest edge to the point at which each box's own weight alone acts.
        by_load: (n,) distance from the nearest edge to the point at which each box's load (including its own weight)
            acts.
    """

    by_weight: FloatArray
    by_load: FloatArray

    @property
    def least(self) -> FloatArray:
        """(n,) ``by_weight`` or ``by_load`` of each box, whichever is smaller.

        If a box would tip over by its own weight, but the boxes on it hold it down, the value is ``by_load``.
        ``building_edges`` checks whether such a box would fall before the boxes on it are placed.
        """
        held_down = (self.by_weight < 0) & (self.by_load >= 0)
        nearer: FloatArray = np.where(held_down, self.by_load, np.fmin(self.by_weight, self.by_load))
        return nearer


def loads_and_edges(bearing: Bearing, placed: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Three arrays: (n, 4) loads of all boxes (see ``Bearing.loads``); (n,) distances of the boxes' own weights from
    edges, m; and (n,) distances of the loads from edges, m.

    Args:
        bearing: the contacts between boxes and their supports, of one or several scenes.
        placed: number of boxes that are already placed in each scene.
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


def edge_risks(scenes: Sequence[Scene]) -> NDArray[np.int8]:
    """(m,) the ``EdgeRisk`` of each of m scenes. A generated plan of 43 boxes takes 0.15 to 0.3 ms.

    In this quick test, supports share loads like springs. ``building_edges`` takes several times as long as
    ``edge_risks``. ``building_edges`` also looks for another distribution of the loads among the supports, one that
    keeps all loads inside the edges.
    """
    n_boxes = np.array([scene.n_boxes for scene in scenes], int)
    risks = np.where(n_boxes > MOST_EXAMINED_BOXES, EdgeRisk.NEAR, EdgeRisk.INSIDE).astype(np.int8)
    examined = np.flatnonzero(n_boxes <= MOST_EXAMINED_BOXES)
    for begin in range(0, len(examined), EXAMINED_AT_ONCE):
        some = examined[begin : begin + EXAMINED_AT_ONCE]
        bearing = bearing_in_order(bearings_of([scenes[number] for number in some.tolist()]))
        built = building_loads_of(bearing, n_boxes[some].tolist())
        scene = np.searchsorted(bearing.boxes.first, built.box, side="right") - 1
        risks[some[scene[built.edge_m < 0]]] = EdgeRisk.BEYOND
        risks[some[scene[(built.edge_m >= 0) & (built.edge_m < NEAR_EDGE_M)]]] = EdgeRisk.NEAR
    return risks


def _scenes(bearing: Bearing, boxes: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Numbers of the scenes that contain at least one of the chosen boxes."""
    return np.unique(np.searchsorted(bearing.boxes.first, np.flatnonzero(boxes), side="right") - 1)


def _exact(edge_m: FloatArray) -> FloatArray:
    """The distances ``edge_m``, but with 0 for each load that is beyond an edge only because of rounding errors."""
    return np.where((edge_m < 0) & (edge_m > -ROUNDING_M), 0.0, edge_m)


def below_several(bearing: Bearing, among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) whether each box is below a box with several supports, so that its load depends on how these supports share
    the load of the upper box.

    Args:
        bearing: the contacts between boxes and their supports.
        among: (n,) True for the boxes with several supports that are considered; other boxes are ignored.
    """
    return bearing.all_below(among & (bearing.n_supports > 1))
