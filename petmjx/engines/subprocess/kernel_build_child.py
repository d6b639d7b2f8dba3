"""The code of a process that compiles kernels of mjx-warp. The process needs no GPU, and ends when no
kernel is left to compile."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import NamedTuple

from petmjx.common.text import one_line
from petmjx.engines.kernel_notes import CPU_KERNEL, note_kernels
from petmjx.engines.subprocess.task_pipe import serve
from petmjx.engines.warp.block_sizes import Size


@dataclass(frozen=True)
class GpuLimits:
    """Properties of a GPU. Kernels are compiled for these properties, except ``sm_count``.

    Attributes:
        arch: compute capability times ten; an H100 has 90.
        max_shared_memory_per_block: largest shared memory of a thread block, bytes.
        sm_count: number of multiprocessors. Kernels do not depend on ``sm_count``.
    """

    arch: int
    max_shared_memory_per_block: int
    sm_count: int = 1
    is_cuda = True


class KernelBuild(NamedTuple):
    """A kernel to compile.

    Attributes:
        gpu: the GPU; None: the CPU of this machine.
        size: the block size. On a CPU, one kernel serves all sizes.
        hands, lands: features of a kernel for GPUs, as in ``petmjx.engines.warp.block_launch.Features``.
    """

    gpu: GpuLimits | None
    size: Size
    hands: bool
    lands: bool


class BuildAnswer(NamedTuple):
    """The answer of the process for one kernel, which was compiled or could not be compiled.

    Attributes:
        seconds: time that compiling took, s; nearly 0 for a kernel that was in the cache.
        fault: why the kernel could not be compiled; "" if it was compiled.
    """

    build: KernelBuild
    seconds: float
    fault: str = ""


def compile_kernel(build: KernelBuild) -> None:
    """Compile a kernel into Warp's cache, where runs find it.

    Raises:
        Exception: an error of Warp or of its compiler.
    """
    import warp as wp

    from petmjx.common.warp_setup import set_up_warp

    set_up_warp()
    from petmjx.engines.warp.block_launch import Features, Launch, kernel
    from petmjx.engines.warp.kernels.pause import pause

    features = Features(hands=build.hands, lands=build.lands)
    if build.gpu is None:
        launch = Launch.of(build.size, features, wp.get_device("cpu"))
        wp.compile_aot_module(kernel(launch).module, device="cpu")
        note_kernels(CPU_KERNEL)
        return
    launch = Launch.of(build.size, features, build.gpu)
    for module in (kernel(launch).module, pause.module):
        wp.compile_aot_module(module, arch=build.gpu.arch)


def main() -> None:
    """The work of the process: compile kernels one after another."""
    serve(_built, nice=0)  # a run waits for its kernels, so they are as urgent as the run itself


def _built(build: KernelBuild) -> BuildAnswer:
    begin, fault = time.perf_counter(), ""
    try:
        compile_kernel(build)
    except Exception as error:
        fault = one_line(error)
    return BuildAnswer(build, time.perf_counter() - begin, fault)
