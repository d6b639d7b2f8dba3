"""Edges of the boxes' supports in the plan, computed as in ``petmjx.engines.outcome_checks``."""

from __future__ import annotations

from collections.abc import Sequence

from petmjx.world.edge_distances import Edges, edges_of
from petmjx.world.scene import Scene
from petmjx.world.supports import bearings_of


def plan_edges(scenes: Sequence[Scene], placed: Sequence[int]) -> list[Edges]:
    """The distances of loads from edges in each scene, with the first ``placed`` boxes at their planned places."""
    return edges_of(bearings_of(scenes), placed)
