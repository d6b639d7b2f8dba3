"""Worlds that are expected to be the last ones: they have a multiprocessor of the GPU to themselves, if possible.

A run ends with its longest worlds. Where two blocks share a multiprocessor each of them is slower than alone, so
the last world has lost time that it spent beside another block. Which blocks a world has is a matter of speed alone.

It is not certain: a world shares its multiprocessor where the block that came there later has a long world, too, or has
looked before the first one had found its own behind worlds in the queue that have ended.
"""

from __future__ import annotations

from typing import Final

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

MOST_ALONE: Final = 16
"""Most worlds that have a multiprocessor to themselves, of which half is idle then. If more are long, none has one."""

LONG: Final = 3.0
"""A world is long that has taken so many times as many steps as those that have ended, in the mean."""

GOES_ON: Final = 4.0
"""A long world is expected to go on for so many times as many steps as it has taken, at most."""


def expected_last(
    order: Int[Array, "queue world"], steps: Int[Array, " world"], running: Bool[Array, " world"], lanes: int
) -> Bool[Array, " world"]:
    """Which worlds are expected to be the last ones. For jitted programs.

    Args:
        order: the queues; behind their worlds negative numbers.
        steps: of each world, so far; 0 before it is taken from a queue.
        running: worlds that go on.
        lanes: worlds at the same time.
    """
    taken = steps > 0
    ended = taken & ~running
    # thousands of worlds may have taken more steps than an int32 holds
    mean = jnp.where(ended, steps, 0).sum(dtype=jnp.float32) / jnp.maximum(ended.sum(), 1)
    rest = ((order >= 0).sum() - taken.sum()) * mean / lanes  # steps of a lane, until none waits
    last = running & ended.any() & (steps > LONG * mean) & (GOES_ON * steps > rest)
    return last & (last.sum() <= MOST_ALONE)
