"""Edges of boxes by the plan, as ``petmjx.engines.outcome_checks`` finds them."""

from __future__ import annotations

from collections.abc import Sequence

from petmjx.world.edge_distances import Edges, edges_of
from petmjx.world.scene import Scene
from petmjx.world.supports import bearings_of


def plan_edges(scenes: Sequence[Scene], placed: Sequence[int]) -> list[Edges]:
    """The edges of each scene's boxes by the plan, once so many are ``placed``."""
    return edges_of(bearings_of(scenes), placed)
