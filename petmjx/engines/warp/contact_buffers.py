"""The buffers for the contacts of a world on mjx-warp's device: how many contacts and pairs of near geoms have memory,
and how far this memory grows if it is too small."""

from __future__ import annotations

from petmjx.engines.warp.world_table import TableRun
from petmjx.options.physics import Cone

PAIRS_PER_BOX = 10
"""Number of pairs of near geoms for which memory is reserved, per box and per board of a carrier."""

CONTACTS_PER_BOX = 8
"""Number of contacts for which memory is reserved, per box. Full real pallets have 4.5 contacts per box. The largest
number in 2,000 sample plans was 6.4 per box, in a collapse."""

MORE_BOXES = 2
"""Number of additional boxes for which buffers have room: one for the carrier, and one that small plans need."""

MAX_GROWTH = 8
"""Limit for the growth of a world's buffers: at most ``MAX_GROWTH`` times the default size of the buffers of the
largest world of the same block size. Buffers are doubled at each overflow. If buffers of the largest size
(``most_room``) are still too small for a world, the world becomes invalid."""


def pairs_and_contacts(shapes: int) -> tuple[int, int]:
    """The numbers of pairs and of contacts for which a world of ``shapes`` shapes (boxes and boards) gets memory."""
    return PAIRS_PER_BOX * shapes, CONTACTS_PER_BOX * shapes


def most_room(size: int) -> int:
    """The buffers of a world of the block size ``size`` grow at most until they have room for the contacts and pairs of
    this number of boxes.

    The limit is the same in all runs, so the largest plan of a run has no influence on whether a world is given up."""
    return MAX_GROWTH * (size + MORE_BOXES)


class ContactBuffers:
    """The sizes of the buffers of an engine's worlds. Enlarged buffers stay large."""

    def __init__(self) -> None:
        self._growth: dict[tuple[Cone, int], int] = {}
        """(Friction cone, block size of worlds) → factor by which buffers are larger than the default."""

    def grow(self, run: TableRun, size: int) -> int | None:
        """Double the buffers for worlds of a size. Returns the factor by which the buffers are now larger than the
        default, or None if they already have their largest size."""
        if self.room(run, size) == most_room(size):
            return None
        growth = 2 * self.growth(run, size)
        self._growth[run.sim.physics.cone, size] = growth
        return growth

    def growth(self, run: TableRun, size: int) -> int:
        """Factor by which the buffers for worlds of a size are larger than the default."""
        return self._growth.get((run.sim.physics.cone, size), 1)

    def room(self, run: TableRun, size: int) -> int:
        """Largest number of boxes whose contacts and pairs fit into the current buffers for a world of this size."""
        return min(self.growth(run, size) * (run.needs.widths[size] + MORE_BOXES), most_room(size))
