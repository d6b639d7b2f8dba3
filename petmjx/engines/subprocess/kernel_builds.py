"""Compiles kernels of mjx-warp before they are needed, in processes, several at the same time.

NVRTC compiles a kernel in some 15 s. In the process of a run, compiling would begin only when JAX and Warp have
started, and would share the interpreter's lock with the reading of plans. Separate processes begin to compile at once.
"""

from __future__ import annotations

import hashlib
import pickle
import queue
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

from petmjx.common.errors import InputError
from petmjx.common.machine import cpu_threads, cuda_limits
from petmjx.engines.kernel_notes import are_noted, note_kernels
from petmjx.engines.subprocess.kernel_build_child import BuildAnswer, GpuLimits, KernelBuild
from petmjx.engines.subprocess.task_pipe import ANSWER_WAIT_S, Child
from petmjx.engines.warp.block_sizes import SIZES, USUAL_SIZES
from petmjx.options.simulation import Simulation

SHARED_KB: Final = {75: 64, 80: 163, 86: 99, 87: 163, 89: 99, 90: 227, 100: 227, 103: 227, 110: 227, 120: 99, 121: 99}
"""Compute capability times ten → largest shared memory of a thread block, kB (CUDA C++ Programming Guide, "Technical
Specifications per Compute Capability")."""

MOST_PROCESSES: Final = 8
"""Largest number of kernels that are compiled at the same time. Each compilation takes up to 1 GB of memory."""


def gpu_here() -> GpuLimits | None:
    """The limits of this machine's first GPU; None if there is none."""
    limits = cuda_limits()
    return GpuLimits(*limits) if limits is not None else None


def gpu_of(arch: int) -> GpuLimits:
    """The limits of GPUs of a compute capability. ``arch``: the compute capability times ten, such as 90. This machine
    itself need not have such a GPU.

    Raises:
        InputError: the compute capability is unknown.
    """
    if arch not in SHARED_KB:
        known = ", ".join(map(str, SHARED_KB))
        raise InputError(f"arch must be a compute capability times ten, one of {known}; got {arch}")
    return GpuLimits(arch, SHARED_KB[arch] << 10)


def usual_builds(sim: Simulation, gpu: GpuLimits) -> list[KernelBuild]:
    """The kernels that most runs with these options need on a GPU."""
    hands, lands = not sim.placing.appears, sim.physics.has_landings
    return [KernelBuild(gpu, size, hands, lands) for size in USUAL_SIZES]


def all_builds(gpus: Sequence[GpuLimits]) -> list[KernelBuild]:
    """The kernels for boxes that appear at their places and for boxes that are carried by hand, in plans of all sizes,
    for these GPUs and for this CPU."""
    lands = Simulation().physics.has_landings
    on_gpus = [
        KernelBuild(gpu, size, hands, lands)
        for gpu in gpus
        for hands in (False, True)
        for size in (*USUAL_SIZES, SIZES[-1])
    ]
    return [KernelBuild(None, SIZES[-1], False, lands), *on_gpus]


class KernelBuilds:
    """Processes that compile kernels.

    Args:
        builds: the kernels. The number of kernels that are compiled at the same time is the number of CPU threads, but
            at least 3 and at most ``MOST_PROCESSES``.
    """

    def __init__(self, builds: Sequence[KernelBuild]) -> None:
        self._waiting = deque(builds)
        self._children: dict[Child, KernelBuild] = {}
        for _ in range(min(MOST_PROCESSES, max(cpu_threads(), len(USUAL_SIZES)), len(builds))):
            self._begin_next(None)

    def answers(self) -> Iterator[BuildAnswer]:
        """Yield each kernel when it is compiled, or has failed. The iterator ends early, without the missing kernels,
        if the program ends. Closing the iterator ends the processes."""
        try:
            while self._children and threading.main_thread().is_alive():
                first = next(iter(self._children))
                child = next((child for child in self._children if not child.answers.empty()), first)
                try:
                    answer = child.answers.get(timeout=ANSWER_WAIT_S)
                except queue.Empty:
                    continue
                build = self._children.pop(child)
                if answer is None:
                    child.end()
                self._begin_next(child if answer is not None else None)
                yield answer or BuildAnswer(build, 0.0, "the process that compiled the kernel died")
        finally:
            for child in self._children:
                child.end()
            self._children.clear()

    def _begin_next(self, idle: Child | None) -> None:
        """Begin the next kernel, in an idle process or in a new one. If no kernel is left, the idle process ends."""
        if self._waiting:
            child = idle or Child("petmjx.engines.subprocess.kernel_build_child")
            self._children[child] = self._waiting.popleft()
            child.tasks.put(pickle.dumps(self._children[child]))
        elif idle is not None:
            idle.end()


def builds_if_missing(sim: Simulation) -> KernelBuilds | None:
    """Begin to compile the kernels that most runs with these options need (``usual_builds``) for this machine's GPU.
    The result is None if there is no GPU, or if an earlier run left a note that these kernels are in the cache."""
    gpu = gpu_here()
    if gpu is None or are_noted(_name_of(sim, gpu)):
        return None
    return KernelBuilds(usual_builds(sim, gpu))


def are_kept(sim: Simulation) -> bool:
    """Whether this machine has a GPU, and a note says that the kernels of ``usual_builds`` for these options are in the
    cache."""
    gpu = gpu_here()
    return gpu is not None and are_noted(_name_of(sim, gpu))


def note_kept(sim: Simulation, gpu: GpuLimits | None = None) -> None:
    """Leave a note that the kernels of ``usual_builds`` for these options are in the cache."""
    gpu = gpu or gpu_here()
    if gpu is not None:
        note_kernels(_name_of(sim, gpu))


def _name_of(sim: Simulation, gpu: GpuLimits) -> str:
    """The name of the note that the kernels of ``usual_builds(sim, gpu)`` are in the cache."""
    return "usual-kernels-" + hashlib.sha256(repr(usual_builds(sim, gpu)).encode()).hexdigest()[:16]
