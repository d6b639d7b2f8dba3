"""Chooses block pools: the thread blocks for the worlds of a table."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import FEW_BOXES
from petmjx.engines.warp.contact_buffers import ContactBuffers
from petmjx.engines.warp.small_world_blocks import small_world_pool
from petmjx.engines.warp.tail_blocks import stiff_pool, tail_pool
from petmjx.engines.warp.world_table import TableRun, WorldTable
from petmjx.world.contact_laws import is_stiff


class BlockPools:
    """Makes the block pools for an engine's tables.

    Args:
        lanes: largest number of worlds of one size that are simulated at the same time. If ``lanes`` is None, the limit
            is the number for which the device has room.
        blocks: function that returns the number of blocks of a launch.

    Attributes:
        buffers: the sizes of the worlds' buffers.
    """

    def __init__(self, lanes: int | None, blocks: Callable[[Launch], int]) -> None:
        self._lanes, self._blocks = lanes, blocks
        self.buffers = ContactBuffers()

    def of(self, table: WorldTable) -> tuple[BlockPool, ...]:
        """The block pools of a table. The block pools for the last worlds and for small worlds, if there are any, come
        first. Then comes one block pool for each pair (stiffness of contacts, size of blocks) of
        ``KernelFeatures.queues``. Each block pool takes its worlds from a queue of its own; ``Programs._advance`` makes
        these queues, in the same order."""
        run = table.run
        of_size = {size: self._of_size(run, size, table.boards) for size in run.needs.sizes}
        pools = tuple(
            of_size[size] if stiff is None else stiff_pool(of_size[size], stiff, self._lanes)
            for stiff, size in run.needs.queues
        )
        usual = self.buffers.growth(run, run.needs.sizes[-1]) == 1
        # There is no block pool for small worlds if buffers are enlarged: each of the many lanes of such a pool would
        # need an enlarged buffer. There is no block pool for small worlds with stiff contacts either. With stiff
        # contacts, a step takes five times as many iterations. In some worlds, a step takes even more iterations, and
        # the other worlds of the block would have to wait.
        if usual and not is_stiff(run.sim.physics):
            worlds = int((np.asarray(table.table.placed)[: len(table.jobs)] <= FEW_BOXES.most_boxes).sum())
            few = small_world_pool(pools[-1], worlds, self._lanes)
            pools = (few, *pools) if few else pools
        last = tail_pool(pools[-1], self._lanes)
        return (last, *pools) if last else pools

    def _of_size(self, run: TableRun, size: int, boards: int) -> BlockPool:
        """The block pool for worlds of a size, with the largest number of blocks. ``boards``: number of shapes of the
        carriers.
        """
        needs = run.needs
        n_boxes = needs.widths[size]
        launch = Launch.here(n_boxes, needs.features._replace(lands=run.sim.physics.has_landings))
        return BlockPool.of(launch, self._blocks(launch), n_boxes, boards, self.buffers.room(run, size))
