"""A block pool: the thread blocks for worlds of one size, and the number of pairs and contacts for which each world has
memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

from petmjx.engines.mjx.world_constants import NEVER
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.contact_buffers import pairs_and_contacts

MIN_BLOCKS = 16
"""If memory is short, the number of thread blocks is halved, but not below this number, since still fewer blocks would
save hardly any memory."""


@dataclass(frozen=True)
class BlockPool:
    """The thread blocks for worlds of one size.

    Attributes:
        launch: configuration with which the device runs the blocks.
        blocks: number of blocks.
        n_boxes: largest number of placed boxes of a world.
        boards: largest number of shapes of a carrier.
        npairmax: largest number of pairs of near geoms of a world.
        nconmax: largest number of contacts of a world.
        least: smallest number of worlds with which the pool is used (small_world_blocks.py). If 0, the pool is always
            used.
        last: whether the pool is for the last worlds of a run (tail_blocks.py).
        stiff: stiffness of the contacts of the pool's worlds (``Job.stiff``).
    """

    launch: Launch
    blocks: int
    n_boxes: int
    boards: int
    npairmax: int
    nconmax: int
    least: int = 0
    last: bool = False
    stiff: float | None = None

    @classmethod
    def of(cls, launch: Launch, blocks: int, n_boxes: int, boards: int, room: int) -> BlockPool:
        """A block pool whose buffers have room for the contacts and pairs of ``room`` boxes in each world."""
        return cls(launch, blocks, n_boxes, boards, *pairs_and_contacts(room + boards - 1))

    def halved(self) -> BlockPool:
        """The same block pool with half the number of blocks, but not fewer than ``MIN_BLOCKS``. A block pool with
        ``MIN_BLOCKS`` blocks or fewer does not change."""
        return replace(self, blocks=min(self.blocks, max(self.blocks // 2, MIN_BLOCKS)))

    @property
    def is_extra(self) -> bool:
        """Whether another block pool also has room for the worlds of this block pool."""
        return self.last or self.least > 0

    @property
    def most_idle(self) -> int:
        """Largest number of lanes (places for a world) that may be empty while the block pool is used."""
        return self.lanes - self.least if self.least else NEVER

    @property
    def lanes(self) -> int:
        """Number of worlds that run at the same time."""
        return self.blocks * self.launch.worlds

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the axes of the block pool's workspace."""
        return world_arrays.axes(self.lanes, self.n_boxes, self.boards, self.npairmax, self.nconmax)
