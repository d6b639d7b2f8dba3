"""Machine code that lowers boxes at the extreme points of many pallets. Twin of the NumPy code in
``petmjx.loop.candidate_places``.

Warp compiles the code (petmjx/loop/place_kernel.py) once per machine, for the CPU. The results are the same as NumPy's,
bit for bit. Machine code does not need Python's global lock, for which NumPy's threads wait most of their time.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import warp as wp
from numpy.typing import NDArray

from petmjx.common.processes import on_threads
from petmjx.common.units import FloatArray
from petmjx.common.warp_setup import set_up_warp
from petmjx.loop.place_kernel import lower_boxes

_THREADS: Final = 4
"""Number of threads that lower boxes. Machine code does not need Python's lock, so the threads do not wait for it."""

_AT_ONCE: Final = 1024
"""Largest number of new boxes in one launch, which bounds the memory of the results."""


def load() -> None:
    """Compile and load the code, or load it as it was compiled before. Must be called before ``lowered_boxes``."""
    set_up_warp()
    wp.load_module(lower_boxes.module, device="cpu")  # several threads launch the kernel, but one must load it


def lowered_boxes(
    pallet: NDArray[np.int64],
    size_mm: FloatArray,
    points: NDArray[np.complex128],
    n_points: NDArray[np.int64],
    box_corner_mm: FloatArray,
    box_size_mm: FloatArray,
    n_boxes: NDArray[np.int64],
    extent_mm: tuple[float, float],
    max_height_mm: float,
    least_support: float,
    gap_mm: float,
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """At points of n pallets, lower m boxes until they rest on something.

    Args:
        pallet: (m,) pallet of each of m ≥ 1 new boxes; ``size_mm``: (m, 3) sizes of the new boxes.
        points: (n, p) points of the pallets as x + iy, mm; ``n_points``: (n,) number of points of each pallet.
        box_corner_mm, box_size_mm: (n, k, 3) corners and sizes of the boxes on the pallets; ``n_boxes``: (n,) their
            numbers.
        extent_mm: largest x and y of the new boxes, including the free space behind them.
        max_height_mm: largest height of a top; ``least_support``: smallest supported share of a base; ``gap_mm``: free
            space between boxes along x and y.

    Returns:
        (c,) the new box of each of c places, (c, 3) corners, mm, and (c,) supported shares of bases. The places of a
        box follow one another, sorted by height, then by x, then by y.
    """
    xy = np.ascontiguousarray(points).view(np.float64).reshape(*points.shape, 2)

    def table(values: NDArray[Any], kind: Any) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=kind, device="cpu", copy=False)

    free_mm = np.array([gap_mm, gap_mm, 0.0])
    sizes, highs = size_mm + free_mm, box_corner_mm + box_size_mm + free_mm
    piles = table(xy, wp.vec2d), table(n_points, wp.int64), table(box_corner_mm, wp.vec3d), table(highs, wp.vec3d)
    limits = wp.vec2d(*extent_mm), max_height_mm, least_support, gap_mm

    def lower(rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        most = int(n_points[pallet[rows]].max())
        count, corner, support = (
            np.zeros(len(rows), np.int64),
            np.empty((len(rows), most, 3)),
            np.empty((len(rows), most)),
        )
        new = table(pallet[rows], wp.int64), table(sizes[rows], wp.vec3d)
        outputs = [table(count, wp.int64), table(corner, wp.vec3d), table(support, wp.float64)]
        inputs = [*new, *piles, table(n_boxes, wp.int64), *limits]
        wp.launch(lower_boxes, dim=len(rows), inputs=inputs, outputs=outputs, device="cpu")
        is_place = np.arange(most) < count[:, None]
        return np.repeat(rows, count), corner[is_place], support[is_place]

    m = len(pallet)
    n_pieces = max(min(_THREADS, m), -(-m // _AT_ONCE))
    parts = on_threads(lower, np.array_split(np.arange(m), n_pieces), _THREADS)
    row, corner, support = (np.concatenate(values) for values in zip(*parts, strict=True))
    return row, corner, support
