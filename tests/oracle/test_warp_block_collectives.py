"""The threads of a world on mjx-warp add numbers up in the same sequence, however many threads there are."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp.solver import newton

set_up_warp()

COUNTS = (1, 31, 32, 33, 96, 127, 128, 129, 255, 256, 257, 700)
BLOCKS = ((32, 16), (64, 1), (128, 1), (256, 1))
"""(threads of a world, worlds of a block)."""


def _sums(numbers: wp.array[wp.float64], count: int, sums: wp.array2d[wp.float64]) -> None:
    block, thread = wp.tid()  # type: ignore[misc]  # two numbers in a kernel of two dimensions
    _sum(numbers, count, block, thread, sums)


@wp.func_native("petmjx::sum_numbers(numbers.data, count, block, thread, sums.data, sums.shape[1]);")
def _sum(numbers: wp.array[wp.float64], count: int, block: int, thread: int, sums: wp.array2d[wp.float64]) -> None: ...


_SUM = """
namespace petmjx {
inline CUDA_CALLABLE void sum_numbers(
    const double* numbers, int count, int block, int thread, double* sums, int threads
) {
    PETMJX_SHARED double partial[PETMJX_WORLDS][2 * MOST_WARPS];
    const int lane = block * PETMJX_WORLDS + thread / threads;
    // twice, and the second time with others: what the first time has left is not in the way
    for (int time = 0; time < 2; ++time) {
        double sum[2], *its = partial[place_in_block(lane)];
        sum_over_all(count, thread % threads, its, sum, [&](int i, double (&sum)[2]) {
            if (i < count) sum[0] += numbers[i + time], sum[1] -= numbers[i];
        });
        sums[(2 * lane + time) * threads + thread % threads] = sum[0] + 2.0 * sum[1];
    }
}
}
"""


@pytest.mark.gpu
@pytest.mark.parametrize("count", COUNTS)
def test_however_many_threads_a_world_has_they_sum_in_the_same_order(count: int) -> None:
    """The order of a sum does not depend on the number of threads. If several worlds share a block, their sums do not
    mix."""
    numbers = wp.array(np.random.default_rng(0).normal(size=count + 1), dtype=wp.float64)
    totals = []
    for threads, worlds in BLOCKS:
        size = threads * worlds
        kernel = with_cpp(_sums, newton.text_for(6, worlds, threads) + _SUM, threads=size)
        sums = wp.zeros((2 * worlds, threads), dtype=wp.float64)
        wp.launch(kernel, dim=(1, size), inputs=[numbers, count, sums], block_dim=size)
        totals.append(
            np.unique(sums.numpy().reshape(worlds, 2, threads).swapaxes(0, 1).reshape(2, -1), axis=1).tolist()
        )
        assert np.shape(totals[-1]) == (2, 1), "all threads have the same"
    assert all(total == totals[0] for total in totals)
