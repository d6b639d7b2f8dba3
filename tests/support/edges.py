"""Edges of boxes by the plan, as ``petmjx.engines.looked_at`` finds them."""

from __future__ import annotations

from collections.abc import Sequence

from petmjx.world.bearing import bearings_of
from petmjx.world.edges import Edges, edges_of
from petmjx.world.scene import Scene


def plan_edges(scenes: Sequence[Scene], placed: Sequence[int]) -> list[Edges]:
    """The edges of each scene's boxes by the plan, once so many are ``placed``."""
    return edges_of(bearings_of(scenes), placed)
