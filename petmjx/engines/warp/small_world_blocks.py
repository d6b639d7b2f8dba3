"""Worlds with few boxes so far: when they have thread blocks of their own, and which they are.

A block for them has several worlds, a warp each (``launch.FEW_BOXES``). Such a world takes the same steps to the last
bit as in a block of its own, where it goes on when it has more boxes, or when too few such worlds are left: so which
blocks have it is a matter of speed alone.
"""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from petmjx.engines.warp.block_launch import FEW_BOXES, Launch, size_for
from petmjx.engines.warp.kernel_launcher import BlockPool

ENOUGH_SHARE, LEAST_SHARE = 0.75, 0.25
"""Worlds with which these blocks begin, and with fewer of which they end, as shares of their lanes: with few worlds
blocks of one world are faster."""


def small_world_pool(fleet: BlockPool, worlds: int, lanes: int | None = None) -> BlockPool | None:
    """Blocks for worlds with few boxes; None: not on this device, or not for so few worlds.

    Args:
        fleet: those that have them else.
        worlds: which begin with few boxes, and may have other blocks.
        lanes: most worlds in blocks of a kind; None: as many as the device has room for.
    """
    one = fleet.launch
    launch = replace(Launch.of(FEW_BOXES, one.hands, one.gives, one.wraps), lands=one.lands)
    blocks = min((lanes or launch.lanes) // launch.worlds, launch.blocks)
    of_all = blocks * launch.worlds
    if launch.worlds == 1 or one.threads != size_for(1).threads or not 0 < ENOUGH_SHARE * of_all <= worlds:
        return None
    least = int(LEAST_SHARE * of_all)
    return replace(fleet, launch=launch, blocks=blocks, n_boxes=min(FEW_BOXES.most_boxes, fleet.n_boxes), least=least)


def small_world_queues(
    few: BlockPool, order: Int[Array, "queue world"], placed: Int[Array, " world"], running: Bool[Array, " world"]
) -> Int[Array, "queue+1 world"]:
    """Queues with one more, the first: of the worlds of the last queue that have few boxes now, while they are enough.

    All keep their order. For jitted programs.

    Args:
        placed: boxes of each world.
        running: worlds that go on.
    """
    last = order[-1]
    chosen = (last >= 0) & (running & (placed <= few.n_boxes))[last]
    chosen &= chosen.sum() >= few.least
    return jnp.concatenate([compacted_queue(last, chosen)[None], order[:-1], compacted_queue(last, ~chosen)[None]])


def compacted_queue(queue: Int[Array, " world"], chosen: Bool[Array, " world"]) -> Int[Array, " world"]:
    """The chosen ones of a queue, one behind the other, and negative numbers behind them."""
    place = jnp.where(chosen, jnp.cumsum(chosen) - 1, len(queue))
    return jnp.full_like(queue, -1).at[place].set(queue, mode="drop")
