"""A run's last worlds: each has a multiprocessor of the GPU to itself, and more threads than others.

A run ends with its longest worlds. Where two blocks share a multiprocessor each is slower than alone, so the last world
has lost the time that it spent beside another block. Worlds that are expected to be among the last ones have blocks
that fill a multiprocessor (``launch.LAST``). When there are no more worlds than multiprocessors, all have whose blocks
would share one. Such a world takes the same steps to the last bit as in other blocks: it is a matter of speed alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from petmjx.engines.warp.block_launch import LAST, Launch
from petmjx.engines.warp.kernel_launcher import BlockPool
from petmjx.engines.warp.small_world_blocks import compacted_queue

MOST_EXPECTED: Final = 16
"""Most worlds that are expected to be the last ones while others wait: those that have taken the most steps. Each takes
the room of two."""

LONG: Final = 2.0
"""A world is long that has taken so many times as many steps as those that have ended, in the mean."""

GOES_ON: Final = 8.0
"""A long world is expected to go on for so many times as many steps as it has taken, at most."""


def tail_pool(fleet: BlockPool, lanes: int | None = None) -> BlockPool | None:
    """Blocks for the last worlds; None where they would be like the others, as on a CPU.

    Args:
        fleet: those that have them else.
        lanes: most worlds in blocks of a kind; None: as many as the device has room for.
    """
    one = fleet.launch
    if one.per_sm == 1:
        return None
    launch = replace(Launch.of(LAST, one.hands, one.gives, one.wraps), lands=one.lands)
    return replace(fleet, launch=launch, blocks=min(lanes or launch.blocks, launch.blocks), last=True)


def tail_queues(
    last: BlockPool,
    order: Int[Array, "queue world"],
    steps: Int[Array, " world"],
    running: Bool[Array, " world"],
    lanes: int,
) -> Int[Array, "queue+1 world"]:
    """Queues with one more, the first: of the last worlds, as far as they are in the last queue. All keep their order.
    For jitted programs.

    Args:
        order: the queues; behind their worlds negative numbers.
        steps, running, lanes: as for ``expected_tail``.
    """
    few = ((order >= 0) & running[order]).sum() <= last.lanes  # rows that no queue has may be in any state
    chosen = (running & few) | expected_tail(order, steps, running, lanes)
    queue = order[-1]
    mine = (queue >= 0) & chosen[queue]
    mine &= mine.sum() <= last.lanes
    return jnp.concatenate([compacted_queue(queue, mine)[None], order[:-1], compacted_queue(queue, ~mine)[None]])


def expected_tail(
    order: Int[Array, "queue world"], steps: Int[Array, " world"], running: Bool[Array, " world"], lanes: int
) -> Bool[Array, " world"]:
    """Which worlds are expected to be the last ones, while others may wait. For jitted programs.

    Args:
        order: the queues; behind their worlds negative numbers.
        steps: of each world, so far; 0 before it is taken from a queue.
        running: worlds that go on.
        lanes: worlds at the same time.
    """
    begun = steps > 0
    ended = begun & ~running
    # thousands of worlds may have taken more steps than an int32 holds
    mean = jnp.where(ended, steps, 0).sum(dtype=jnp.float32) / jnp.maximum(ended.sum(), 1)
    rest = ((order >= 0).sum() - begun.sum()) * mean / lanes  # steps of a lane, until none waits
    long = running & ended.any() & (steps > LONG * mean) & (GOES_ON * steps > rest)
    most, rows = jax.lax.top_k(jnp.where(long, steps, 0), min(MOST_EXPECTED, len(steps)))
    return jnp.zeros_like(long).at[rows].set(most > 0)
