"""Edges of the boxes' supports in the plan, computed as in ``petmjx.engines.outcome_checks``."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from petmjx.world.bearings import Bearing
from petmjx.world.edge_distances import Edges, loads_and_edges
from petmjx.world.scene import Scene
from petmjx.world.supports import bearings_of


def plan_edges(scenes: Sequence[Scene], placed: Sequence[int]) -> list[Edges]:
    """The distances of loads from edges in each scene, with the first ``placed`` boxes at their planned places."""
    return edges_of(bearings_of(scenes), placed)


def edges_of(bearing: Bearing, placed: Sequence[int]) -> list[Edges]:
    """The distances of loads from edges in each scene of ``bearing``, with the first ``placed`` boxes in place."""
    _, by_weight, by_load = loads_and_edges(bearing, placed)
    return [Edges(by_weight[i:k], by_load[i:k]) for i, k in pairwise(bearing.boxes.first.tolist())]
