"""A kernel that only waits. The kernel delays later kernels of its CUDA stream (``block_launch.side_by_side``)."""

from __future__ import annotations

import warp as wp


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    long long begin, now;
    asm volatile("mov.u64 %0, %globaltimer;" : "=l"(begin));
    do asm volatile("mov.u64 %0, %globaltimer;" : "=l"(now)); while (now - begin < time_ns);
#endif
""")
def let_pass(time_ns: wp.int64) -> None: ...


@wp.kernel(enable_backward=False, module="unique", module_options={"block_dim": 1})
def pause(time_ns: wp.int64) -> None:
    """Wait for ``time_ns`` on a GPU. On a CPU, return at once."""
    let_pass(time_ns)
