"""Thread blocks for small worlds, which are worlds that have few boxes so far (docs/batching.md).

A block for small worlds simulates several worlds, each with one warp of 32 threads (``block_sizes.FEW_BOXES``). A
world moves to a block of its own when it has more boxes, or when too few small worlds are left. The choice of blocks
affects only the speed.
"""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from petmjx.engines.warp.block_launch import Launch
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.block_sizes import FEW_BOXES, size_for

ENOUGH_SHARE, LEAST_SHARE = 0.75, 0.25
"""Limits for the use of blocks for small worlds, as shares of the lanes (places for a world) of these blocks. The
blocks come into use when small worlds fill at least ``ENOUGH_SHARE`` of the lanes. The blocks go out of use when small
worlds fill less than ``LEAST_SHARE`` of the lanes, because blocks that simulate one world each are then faster."""


def small_world_pool(pool: BlockPool, worlds: int, lanes: int | None = None) -> BlockPool | None:
    """The block pool for small worlds; None if this device has no such blocks, or if there are too few small worlds.

    Args:
        pool: the block pool from which these worlds come.
        worlds: number of worlds that begin with few boxes.
        lanes: largest number of worlds that run at the same time in these blocks. If ``lanes`` is None, the limit is
            the number for which the device has room.
    """
    one = pool.launch
    launch = Launch.of(FEW_BOXES, one.features)
    blocks = min((lanes or launch.lanes) // launch.worlds, launch.blocks)
    of_all = blocks * launch.worlds
    if launch.worlds == 1 or one.threads != size_for(1).threads or not 0 < ENOUGH_SHARE * of_all <= worlds:
        return None
    least = int(LEAST_SHARE * of_all)
    return replace(pool, launch=launch, blocks=blocks, n_boxes=min(FEW_BOXES.most_boxes, pool.n_boxes), least=least)


def small_world_queues(
    few: BlockPool, order: Int[Array, "queue world"], placed: Int[Array, " world"], running: Bool[Array, " world"]
) -> Int[Array, "queue+1 world"]:
    """The queues, preceded by a new queue of small worlds. Worlds with few placed boxes are moved from the last queue
    to the new queue, if there are enough of these worlds.

    Worlds keep their order. This function can be called in jitted programs.

    Args:
        placed: number of placed boxes of each world.
        running: whether each world can continue.
    """
    last = order[-1]
    chosen = (last >= 0) & (running & (placed <= few.n_boxes))[last]
    chosen &= chosen.sum() >= few.least
    return with_first_queue(order, chosen)


def with_first_queue(order: Int[Array, "queue world"], chosen: Bool[Array, " world"]) -> Int[Array, "queue+1 world"]:
    """The queues, preceded by a new queue: the chosen worlds, which leave the last queue. Worlds keep their order."""

    def compacted(queue: Int[Array, " world"], stays: Bool[Array, " world"]) -> Int[Array, "1 world"]:
        place = jnp.where(stays, jnp.cumsum(stays) - 1, len(queue))
        return jnp.full_like(queue, -1).at[place].set(queue, mode="drop")[None]

    return jnp.concatenate([compacted(order[-1], chosen), order[:-1], compacted(order[-1], ~chosen)])
