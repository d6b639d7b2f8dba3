"""Thread blocks for the last worlds of a run (docs/batching.md). A block for last worlds fills a GPU multiprocessor
(``block_sizes.LAST``).

A run ends with its longest worlds. Two blocks that share a multiprocessor are slower than one block alone, so sharing
delays the end of the run. The choice of blocks affects only the speed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import LAST
from petmjx.engines.warp.small_world_blocks import with_first_queue

MOST_EXPECTED: Final = 16
"""While other worlds still wait, at most this number of worlds get the large thread blocks that are meant for the last
worlds. These worlds are expected to end last, because they have taken the most steps so far. A block for last worlds
fills a GPU multiprocessor, which otherwise has room for two usual blocks."""

LONG: Final = 2.0
"""A world is *long* if its number of steps is more than LONG times the mean number of steps of finished worlds."""

GOES_ON: Final = 8.0
"""A long world is expected to take at most GOES_ON times as many further steps as it has taken so far."""


def tail_pool(pool: BlockPool, lanes: int | None = None) -> BlockPool | None:
    """The block pool for the last worlds; None if it would be the same as ``pool``, as on a CPU.

    Args:
        pool: the block pool from which these worlds come.
        lanes: largest number of worlds that run at the same time in these blocks. If ``lanes`` is None, the limit is
            the number for which the device has room.
    """
    one = pool.launch
    if one.per_sm == 1:
        return None
    launch = Launch.of(LAST, one.features)
    return replace(pool, launch=launch, blocks=min(lanes or launch.blocks, launch.blocks), last=True)


def stiff_pool(pool: BlockPool, stiff: float, lanes: int | None = None) -> BlockPool:
    """The block pool (the thread blocks) for those worlds of a table that have stiffer contacts than the other worlds.
    A world with stiffer contacts takes more steps, with more iterations each, and further jobs may follow from its
    outcome. So the world gets a block like the blocks for last worlds.

    Args:
        pool: the block pool for other worlds of the same size.
        stiff: see ``Job.stiff``.
        lanes: see ``tail_pool``.
    """
    return replace(tail_pool(pool, lanes) or pool, last=False, stiff=stiff)


def tail_queues(
    last: BlockPool,
    order: Int[Array, "queue world"],
    steps: Int[Array, " world"],
    running: Bool[Array, " world"],
    lanes: int,
) -> Int[Array, "queue+1 world"]:
    """The queues, preceded by a new queue of the last worlds of the run. The last worlds are removed from the last of
    the old queues. Worlds keep their order. Jitted programs can call this function.

    Args:
        order: the queues. Each row lists the numbers of worlds, padded with negative numbers.
        steps, running, lanes: see ``expected_tail``.
    """
    # only worlds in queues are counted, since rows of the table that belong to no queue may have any state
    few = ((order >= 0) & running[order]).sum() <= last.lanes
    chosen = (running & few) | expected_tail(order, steps, running, lanes)
    queue = order[-1]
    mine = (queue >= 0) & chosen[queue]
    mine &= mine.sum() <= last.lanes
    return with_first_queue(order, mine)


def expected_tail(
    order: Int[Array, "queue world"], steps: Int[Array, " world"], running: Bool[Array, " world"], lanes: int
) -> Bool[Array, " world"]:
    """Whether each world is expected to be among the last worlds of the run, while other worlds may still wait. Jitted
    programs can call this function.

    Args:
        order: the queues. Each row lists the numbers of worlds, padded with negative numbers.
        steps: number of steps of each world so far. The number is 0 before a block takes the world from a queue.
        running: whether each world can continue.
        lanes: number of worlds that run at the same time.
    """
    begun = steps > 0
    ended = begun & ~running
    queued = jnp.zeros_like(running).at[jnp.where(order >= 0, order, len(running))].set(True, mode="drop")
    # the sum of the steps of thousands of worlds may exceed an int32
    mean = jnp.where(ended, steps, 0).sum(dtype=jnp.float32) / jnp.maximum(ended.sum(), 1)
    # ``rest``: expected number of steps that each lane still takes until no world waits for a lane
    rest = (queued & running & ~begun).sum() * mean / lanes
    long = running & ended.any() & (steps > LONG * mean) & (GOES_ON * steps > rest)
    most, rows = jax.lax.top_k(jnp.where(long, steps, 0), min(MOST_EXPECTED, len(steps)))
    return jnp.zeros_like(long).at[rows].set(most > 0)
