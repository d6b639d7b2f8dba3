"""Collective operations of a world's threads, and multiplications that all kernels round alike.

The Warp functions of this module call the C++ functions in petmjx/engines/warp/solver/block.cuh.
"""

from __future__ import annotations

import warp as wp

from petmjx.engines.warp.world_arrays import Thread


@wp.func_native("petmjx::wait_for_all();")
def wait_for_all() -> None: ...


@wp.func_native("return petmjx::any_of_all(mine);")
def any_of_all(mine: bool) -> bool: ...


@wp.func_native("petmjx::go_together();")
def go_together() -> None: ...


@wp.func_native("return petmjx::any_of_block(mine);")
def any_of_block(mine: bool) -> bool: ...


@wp.func_native("petmjx::prefix_sums(values.data + (size_t)row * values.shape[1], count, thread);")
def prefix_sums(values: wp.array2d[int], row: int, count: int, thread: int) -> None: ...


@wp.func_native("return petmjx::add_to(values.data + index, amount);")
def add_to(values: wp.array[int], index: int, amount: int) -> int: ...


@wp.func_native("petmjx::raise_to(values.data + index, value);")
def raise_to(values: wp.array[int], index: int, value: int) -> None: ...


@wp.func_native("return petmjx::elapsed(clock.data);")
def elapsed(clock: wp.array[int]) -> wp.int64: ...


@wp.func_native("return petmjx::times(a, b);")
def times(a: float, b: float) -> float: ...


@wp.func_native("return petmjx::fused(a, b, c);")
def fused(a: float, b: float, c: float) -> float: ...


@wp.func_native("return petmjx::times(a, b);")
def times_double(a: wp.float64, b: wp.float64) -> wp.float64: ...


@wp.func_native("return petmjx::fused(a, b, c);")
def fused_double(a: wp.float64, b: wp.float64, c: wp.float64) -> wp.float64: ...


@wp.func
def dot_double(a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """The product of two vectors, rounded alike in all kernels."""
    return fused_double(a[0], b[0], fused_double(a[1], b[1], times_double(a[2], b[2])))


@wp.func
def applied_double(matrix: wp.mat33d, v: wp.vec3d) -> wp.vec3d:
    """matrix·v, rounded alike in all kernels."""
    return wp.vec3d(dot_double(matrix[0], v), dot_double(matrix[1], v), dot_double(matrix[2], v))


@wp.func
def difference(a: float, x: wp.vec3, b: float, y: wp.vec3) -> wp.vec3:
    """a·x − b·y."""
    return wp.vec3(
        fused(a, x[0], -times(b, y[0])),
        fused(a, x[1], -times(b, y[1])),
        fused(a, x[2], -times(b, y[2])),
    )


@wp.func
def cross(a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """The cross product, rounded alike in all kernels."""
    return wp.vec3(
        fused(a[1], b[2], -times(a[2], b[1])),
        fused(a[2], b[0], -times(a[0], b[2])),
        fused(a[0], b[1], -times(a[1], b[0])),
    )


@wp.func
def warp_by_warp(at: Thread) -> int:
    """A thread's number in an order in which warps alternate: threads 0, 32, 64, … come first, then 1, 33, … If there
    is too little work for all threads, this order divides the work evenly among the warps. On a CPU, a world has one
    thread, and its number is 0.
    """
    return at.thread % 32 * (at.threads // 32) + at.thread // 32
