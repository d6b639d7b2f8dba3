"""Machine code that updates the maps of heights and of loads of many pallets. This module is a twin of the NumPy code
in ``petmjx.gym.observation_maps``.

Warp compiles the code (petmjx/gym/map_kernel.py) once per machine, for the CPU. The results are the same as NumPy's,
bit for bit. The code writes only the cells that boxes cover, in threads that do not need Python's global lock.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import warp as wp
from numpy.typing import NDArray

from petmjx.gym import map_kernel
from petmjx.loop.compiled_places import launch, table

KERNELS: Final = (map_kernel.raise_heights, map_kernel.put_loads)
"""The kernels that ``petmjx.common.warp_setup.machine_code`` compiles when it loads this module."""


def raise_heights(
    pallet: NDArray[np.int64], span: NDArray[np.int32], top_mm: NDArray[np.float32], heights: NDArray[np.float32]
) -> None:
    """Raise maps of heights to the tops of new boxes. The maps change in place.

    Args:
        pallet: (m,) pallet of each new box, each pallet once; ``span``: (m, 2, 2) the cells that the box covers
            (``petmjx.loop.height_maps.spans``); ``top_mm``: (m,) height of the box's top.
        heights: (n, x, y) the maps of all pallets, mm.
    """
    of_rows = table(pallet, wp.int64), table(span.reshape(-1, 4), wp.vec4i), table(top_mm, wp.float32)
    launch(map_kernel.raise_heights, len(pallet), [*of_rows], [table(heights, wp.float32)])


def put_loads(
    pallet: NDArray[np.int64], force_n: NDArray[np.float32], span: NDArray[np.int32], loads: NDArray[np.float32]
) -> None:
    """Make the maps of loads of some pallets anew. The maps change in place.

    Args:
        pallet: (m,) the pallets, each pallet once; ``force_n``: (m, k) force on the top of each box on these pallets,
            N; 0 or less after the last box of a pallet.
        span: (n, c, 2, 2) the cells that each box on each pallet covers, as in ``raise_heights``; c ≥ k.
        loads: (n, x, y) the maps of all pallets, N.
    """
    of_rows = table(pallet, wp.int64), table(force_n, wp.float32)
    of_pallets = table(span.reshape(*span.shape[:2], 4), wp.vec4i), table(loads, wp.float32)
    launch(map_kernel.put_loads, len(pallet), [*of_rows], [*of_pallets])
