"""Block sizes of mjx-warp: threads and shared memory of a thread block, by the number of boxes of its worlds.

In a step of a world with forty boxes, threads mostly wait for one another's results (latency), so a multiprocessor
should simulate a second world meanwhile. A step of a world with two hundred boxes is work for many threads. So there
are blocks of two sizes. Two further block sizes are for worlds of few boxes (small_world_blocks.py), and for the last
worlds of a run (tail_blocks.py). Each size has its own kernel (block_launch.py).

This module does not import Warp, since it is also used before Warp has started.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

MAX_BOXES = 512
"""Largest number of boxes of a world. The right-hand side of the solver must fit in shared memory, which sets this
limit."""


@dataclass(frozen=True)
class Size:
    """The size of the thread blocks for worlds of at most ``most_boxes`` boxes.

    Attributes:
        most_boxes: largest number of boxes of a world.
        threads: number of threads of a block, from 64 to 512. The number of threads of a world is a power of two, from
            32 to 256 (ORDER in block.cuh).
        per_sm: number of blocks that a multiprocessor of a GPU runs at the same time. The number of blocks limits the
            number of registers of a thread.
        shared_bytes: shared memory of a block for rows of the factor of the Hessian, and for the Hessian if it fits,
            bytes. A multiprocessor has 256 kB for all its blocks. The part of these 256 kB that no block uses serves as
            cache.
        worlds: number of worlds of a block: one for all its threads, or one for each warp (32 threads).
        pause_after: number of iterations after which the solver of a world pauses, so that the other worlds of the
            block need not wait for this world. If 0, the solver never pauses.
    """

    most_boxes: int
    threads: int
    per_sm: int
    shared_bytes: int
    worlds: int = 1
    pause_after: int = 0


SIZES = (Size(96, 128, 2, 80 << 10), Size(MAX_BOXES, 256, 1, 64 << 10))
"""All sizes, ascending. ``most_boxes`` is a multiple of ``petmjx.engines.mjx.padded_sizes.GRANULE``, as is the number
of box columns of tables. Measurements: benchmarks/notebook/performance.md."""

FEW_BOXES = Size(15, 512, 1, 96 << 10, worlds=16, pause_after=4)
"""Blocks for worlds in which at most 15 boxes are placed so far. With a moving carrier, the Hessian of such a world has
at most 96 rows, which are six panels of 16 rows."""

LAST = Size(SIZES[0].most_boxes, 256, 1, 144 << 10)
"""Blocks for the last worlds of a run, if these worlds have at most ``SIZES[0].most_boxes`` boxes. Each of these blocks
fills a multiprocessor."""


USUAL_SIZES: Final = (SIZES[0], FEW_BOXES, LAST)
"""The block sizes that most runs need, since most runs have no large plans. The kernel that takes longest to compile
comes first."""


def size_for(n_boxes: int) -> Size:
    """The block size for a world with this number of boxes."""
    return next(size for size in SIZES if n_boxes <= size.most_boxes)
