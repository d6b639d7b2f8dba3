"""Machine code that finds the extreme points of many pallets, and lowers boxes at these points. This module is a twin
of the NumPy code in ``petmjx.loop.extreme_points`` and ``petmjx.loop.candidate_places``.

Warp compiles the code (petmjx/loop/place_kernel.py) once per machine, for the CPU. The results are the same as NumPy's,
bit for bit. Machine code does not need Python's global lock, for which NumPy's threads wait most of their time.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import numpy as np
import warp as wp
from numpy.typing import NDArray

from petmjx.common.processes import on_threads
from petmjx.common.units import FloatArray
from petmjx.loop import place_kernel

KERNELS: Final = (place_kernel.add_points, place_kernel.lower_boxes)
"""The kernels that ``petmjx.common.warp_setup.machine_code`` compiles when it loads this module."""

_THREADS: Final = 4
"""Number of threads that lower boxes onto their supports. Machine code does not need Python's lock, so the threads do
not wait for it."""

_WORTH_A_THREAD: Final = 32
"""If several threads are started, each gets at least this number of boxes or pallets."""

_AT_ONCE: Final = 4096
"""Largest number of new boxes that are lowered at a time. With more boxes at a time, the results would take more
memory."""


def add_points(
    pallet: NDArray[np.int64],
    n_known: NDArray[np.int64],
    box_corner_mm: FloatArray,
    box_size_mm: FloatArray,
    n_boxes: NDArray[np.int64],
    gap_mm: float,
    points: NDArray[np.complex128],
    n_points: NDArray[np.int64],
) -> None:
    """Add the extreme points of boxes to the tables of n pallets, which change in place.

    Args:
        pallet: (m,) pallets whose points are added, each pallet once.
        n_known: (n,) for each pallet, the number of boxes whose points are in the tables.
        box_corner_mm, box_size_mm: (n, k, 3) corners and sizes of the boxes on the pallets; ``n_boxes``: (n,) number
            of boxes on each pallet.
        gap_mm: free space behind each box along x and y.
        points: (n, p) points as x + iy, mm; ``n_points``: (n, c) number of points after the first 0, 1, … boxes. The
            tables ``points`` and ``n_points`` need room for the new points.
    """
    boxes = table(box_corner_mm, wp.vec3d), table(box_size_mm, wp.vec3d), table(n_boxes, wp.int64)
    tables = _points_table(points), table(n_points, wp.int64)
    rows, known = table(pallet, wp.int64), table(n_known, wp.int64)
    launch(place_kernel.add_points, len(pallet), [rows], [known, *boxes, _free_space(gap_mm), *tables])


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
        box_corner_mm, box_size_mm: (n, k, 3) corners and sizes of the boxes on the pallets; ``n_boxes``: (n,) number
            of boxes on each pallet.
        extent_mm: extent of the carrier along x and y, plus ``gap_mm``. A new box, together with the free space behind
            it, must not reach farther.
        max_height_mm: largest height of a top; ``least_support``: smallest supported share of a base; ``gap_mm``: free
            space between boxes along x and y.

    Returns:
        (c,) the new box of each of c places, (c, 3) corners, mm, and (c,) supported shares of bases. The places of a
        box follow one another, sorted by height, then by x, then by y.
    """
    boxes = table(box_corner_mm, wp.vec3d), table(box_size_mm, wp.vec3d), table(n_boxes, wp.int64)
    tables = _points_table(points), table(n_points, wp.int64), *boxes
    limits = _free_space(gap_mm), wp.vec2d(*extent_mm), max_height_mm, least_support

    def lower(first: int) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
        rows = slice(first, first + _AT_ONCE)
        some, m = pallet[rows], len(pallet[rows])
        most = int(n_points[some].max())
        count, corner, support = np.zeros(m, np.int64), np.empty((most, m, 3)), np.empty((most, m))
        new = table(some, wp.int64), table(size_mm[rows], wp.vec3d)
        results = table(count, wp.int64), table(corner, wp.vec3d), table(support, wp.float64)
        launch(place_kernel.lower_boxes, m, [*new], [*tables, *limits, *results])
        row = np.repeat(np.arange(m), count)
        number = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        return first + row, corner[number, row], support[number, row]

    parts = [lower(first) for first in range(0, len(pallet), _AT_ONCE)]
    row, corner, support = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
    return row, corner, support


def launch(kernel: Any, m: int, of_rows: list[Any], others: list[Any]) -> None:
    """Launch a kernel for m rows, on several threads. The kernel's arguments are ``of_rows``, then the number of the
    launch's first row, then ``others``."""

    def launch_rows(rows: range) -> None:
        wp.launch(kernel, dim=len(rows), inputs=[*of_rows, rows.start, *others], device="cpu")

    n_pieces = min(max(m // _WORTH_A_THREAD, 1), _THREADS)
    ends = [m * piece // n_pieces for piece in range(n_pieces + 1)]
    on_threads(launch_rows, [range(*of_piece) for of_piece in pairwise(ends)], _THREADS)


def table(values: NDArray[Any], kind: Any) -> Any:
    """An array of Warp that shares the memory of a NumPy array. If the NumPy array is not contiguous, it is copied."""
    return wp.array(np.ascontiguousarray(values), dtype=kind, device="cpu", copy=False)


def _points_table(points: NDArray[np.complex128]) -> Any:
    """Points x + iy as an array of Warp that shares their memory."""
    return wp.array(points.view(np.float64).reshape(*points.shape, 2), dtype=wp.vec2d, device="cpu", copy=False)


def _free_space(gap_mm: float) -> Any:
    return wp.vec3d(gap_mm, gap_mm, 0.0)
