"""Warp kernels that update the maps of pallets. The kernels are twins of the NumPy code in
``petmjx.gym.observation_maps``."""

from __future__ import annotations

import warp as wp


@wp.func
def _raise(cells: wp.array3d(dtype=wp.float32), on: wp.int64, span: wp.vec4i, value: wp.float32) -> None:
    """Set those cells of the pallet ``on`` that a box covers to ``value``. Cells with larger values are not changed."""
    for x in range(wp.max(span[0], 0), wp.min(span[2], cells.shape[1])):
        for y in range(wp.max(span[1], 0), wp.min(span[3], cells.shape[2])):
            cells[on, x, y] = wp.max(cells[on, x, y], value)


@wp.kernel(enable_backward=False, module="unique", module_options={"block_dim": 1})
def raise_heights(
    pallet: wp.array(dtype=wp.int64),
    span: wp.array(dtype=wp.vec4i),
    top: wp.array(dtype=wp.float32),
    first_row: int,
    heights: wp.array3d(dtype=wp.float32),
) -> None:
    """One thread for each new box. The arguments are those of ``petmjx.gym.compiled_maps.raise_heights``. The thread of
    index 0 has the row ``first_row``."""
    row = first_row + wp.tid()
    _raise(heights, pallet[row], span[row], top[row])


@wp.kernel(enable_backward=False, module="unique", module_options={"block_dim": 1})
def put_loads(
    pallet: wp.array(dtype=wp.int64),
    force: wp.array2d(dtype=wp.float32),
    first_row: int,
    span: wp.array2d(dtype=wp.vec4i),
    loads: wp.array3d(dtype=wp.float32),
) -> None:
    """Each thread makes the map of loads of one pallet. The arguments are those of ``compiled_maps.put_loads``. The
    thread of index 0 has the row ``first_row``."""
    row = first_row + wp.tid()
    on = pallet[row]
    for x in range(loads.shape[1]):
        for y in range(loads.shape[2]):
            loads[on, x, y] = wp.float32(0.0)
    for box in range(force.shape[1]):
        if force[row, box] > wp.float32(0.0):
            _raise(loads, on, span[on, box], force[row, box])
