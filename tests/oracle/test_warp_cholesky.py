"""The linear solver of mjx-warp compared with NumPy, on random matrices.

Each matrix has a random envelope: the first non-zero entry of each column.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.units import FloatArray
from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp.block_sizes import MAX_BOXES, SIZES
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import PANEL, most_panels

set_up_warp()

ERROR = 50 * 2.0**-24
"""Tolerance of an entry of H·x, as a share of the largest sum that its terms may have: √Hᵢᵢ·Σⱼ √Hⱼⱼ·|xⱼ|. On a CPU a
tenth of this error is seen. On a GPU products of tiles have 22 of the 24 bits of single precision."""

BOTH = [
    pytest.param("thread", id="thread"),
    pytest.param("cpu", id="cpu"),
    pytest.param("cuda", id="cuda", marks=pytest.mark.gpu),
]
"""The code for CPUs ("thread"), the code for GPUs on a CPU ("cpu"), and the code for GPUs on a GPU ("cuda")."""


@cache
def solver(panels: int, as_block: bool) -> Any:
    """Return a kernel with which one thread block solves one system.

    Args:
        as_block: If True, the kernel has the code for GPUs, also on a CPU.
    """

    @wp.func_native("""
        PETMJX_SHARED petmjx::Factoring<PETMJX_MOST_PANELS> shared;
        const petmjx::System system{A.data, strip.data, (int)top.shape[0], top.data, base.data, rhs.data};
        shared.know(system.top, system.panels, thread, threads);
        petmjx::wait_for_all();
        petmjx::factor_and_solve(system, shared, thread, threads);
    """)
    def factor_and_solve(
        A: wp.array[float],
        strip: wp.array[float],
        top: wp.array[int],
        base: wp.array[int],
        rhs: wp.array[float],
        thread: int,
        threads: int,
    ) -> None: ...

    def solve(
        A: wp.array[float],
        strip: wp.array[float],
        top: wp.array[int],
        base: wp.array[int],
        rhs: wp.array[float],
        threads: int,
    ) -> None:
        factor_and_solve(A, strip, top, base, rhs, wp.tid(), threads)

    macro = "#define PETMJX_BLOCKS_ON_CPU\n" if as_block else ""
    return with_cpp(solve, macro + newton.text_for(panels))


def solved(H: FloatArray, top: list[int], g: FloatArray, device: str, size: int) -> FloatArray:
    """Return the solution x of H·x = g, from the kernel.

    Args:
        top: Envelope of H: for each panel of 16 columns, the number of the first panel of rows with entries other than
            0.
        size: Index into ``SIZES``, which has the number of threads for worlds of each size.
    """
    panels = len(top)
    columns = [H[PANEL * first : PANEL * (J + 1), PANEL * J : PANEL * (J + 1)] for J, first in enumerate(top)]
    # The kernel reads only the upper triangle of a diagonal tile, as the Hessian is given.
    packed = np.concatenate([np.vstack([column[:-PANEL], np.triu(column[-PANEL:])]).ravel() for column in columns])
    base = np.cumsum([0] + [column.size for column in columns])
    threads = SIZES[size].threads if device == "cuda" else 1
    as_block = device != "thread"
    with wp.ScopedDevice(device if as_block else "cpu"):
        rhs = wp.array(g, dtype=float)
        strip = wp.zeros(2 * panels * PANEL**2, dtype=float)
        arrays = [wp.array(packed, dtype=float), strip, wp.array(top, dtype=int), wp.array(base, dtype=int), rhs]
        kernel = solver(most_panels(SIZES[size].most_boxes if as_block else MAX_BOXES), as_block)
        wp.launch(kernel, dim=threads, inputs=[*arrays, threads], block_dim=threads)
        solution: FloatArray = rhs.numpy()
    return solution


def single(values: FloatArray) -> FloatArray:
    """Round to single precision."""
    return values.astype(np.float32).astype(np.float64)


def random_system(top: list[int], rng: np.random.Generator) -> FloatArray:
    """Return a positive definite matrix with an envelope, in single precision.

    The scales of its rows differ by up to a hundred times, as for boxes of 1 kg and of 100 kg.
    """
    n = PANEL * len(top)
    reached = np.repeat(np.array(top) * PANEL, PANEL)
    inside = (np.arange(n)[:, None] >= reached[None]) & (np.arange(n)[:, None] <= np.arange(n)[None])
    U = np.where(inside, rng.normal(size=(n, n)), 0.0) / np.sqrt(n)
    np.fill_diagonal(U, rng.uniform(1, 2, n))
    U *= 10 ** rng.uniform(0, 1, n)[None]
    return single(U.T @ U)


ENVELOPES = {
    "one panel": [0],
    "two that do not touch": [0, 1],
    "two": [0, 0],
    "all full": [0] * 9,
    "a band": [max(0, J - 3) for J in range(20)],
    "arrow": [*range(11), 0],
    "pairs that do not touch, whose next panels reach both": [0, 1, 0, 3, 2, 5, 3],
    "steps": [0, 0, 1, 3, 3, 2, 6, 5, 8, 8, 4, 11, 10],
    "wide": [max(0, J - 30) for J in range(37)],
    "wider than a warp": [0] * 37,
    "a long arrow": [*range(36), 0],
}


def assert_solves(H: FloatArray, top: list[int], g: FloatArray, device: str, size: int) -> FloatArray:
    """Assert that each equation holds. Return the solution."""
    x = solved(H, top, g, device, size)
    scales = np.sqrt(np.diag(H))
    assert np.abs((H @ x - g) / scales).max() < ERROR * (scales @ np.abs(x))
    return x


@pytest.mark.parametrize("device", BOTH)
@pytest.mark.parametrize("size", range(len(SIZES)))
@pytest.mark.parametrize("name", ENVELOPES)
def test_solves_as_numpy(name: str, size: int, device: str) -> None:
    top, rng = ENVELOPES[name], np.random.default_rng(1)
    H = random_system(top, rng)
    g = single(rng.normal(size=len(H)))
    x = np.linalg.solve(H, g)
    solution = assert_solves(H, top, g, device, size)
    np.testing.assert_allclose(solution, x, rtol=0, atol=1e-5 * np.abs(x).max())


@pytest.mark.parametrize("device", BOTH)
@pytest.mark.parametrize("size", range(len(SIZES)))
@pytest.mark.parametrize("left", [1e-2, 1e-4, 1e-6])
def test_rows_that_are_stiff_together_cost_no_digits(left: float, size: int, device: str) -> None:
    """Rows that are stiff together belong to a box that stands on few contacts: a pivot is small once the pivot before
    it is eliminated.

    If the solver divided by two such pivots together, all other unknowns would lose digits there.
    """
    rng = np.random.default_rng(2)
    J = rng.normal(size=(3 * PANEL, 3 * PANEL))
    J[:, 1::2] = rng.uniform(0.5, 2, J.shape[1] // 2) * J[:, ::2] + np.sqrt(left) * J[:, 1::2]
    J *= 10 ** rng.uniform(0, 2, len(J))[:, None]
    H = single(J.T @ J + np.diag(10 ** rng.uniform(-2, 2, len(J))))
    g = single(np.sqrt(np.diag(H)) * rng.normal(size=len(H)))
    assert_solves(H, [0, 0, 0], g, device, size)


@pytest.mark.parametrize("device", BOTH)
@pytest.mark.parametrize("size", range(len(SIZES)))
@pytest.mark.parametrize("row", [0, 1, PANEL - 1, PANEL, PANEL + 3, 3 * PANEL - 1])
def test_a_matrix_that_is_not_positive_definite_gives_no_number(row: int, size: int, device: str) -> None:
    """The solution has NaN or infinity, with which every comparison is False. So the solver stops at a direction with
    such a solution."""
    H = np.eye(3 * PANEL)
    H[row, row] = -1.0
    assert not np.isfinite(solved(H, [0, 0, 1], np.ones(len(H)), device, size)).all()
