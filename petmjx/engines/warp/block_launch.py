"""Launches of mjx-warp's thread blocks: the kernels of the block sizes, and kernels that run at the same time.

On a GPU, the hardware's scheduler runs the blocks. On a CPU, each block runs in its own thread.

All kernels add numbers in the same order. So a world may move to another kernel after any step, with bit-identical
results.
"""

from __future__ import annotations

import functools
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.engines.kernel_notes import CPU_KERNEL, note_kernels
from petmjx.engines.warp.block_sizes import MAX_BOXES, Size, size_for
from petmjx.engines.warp.kernels.pause import pause
from petmjx.engines.warp.kernels.world_loop import run_worlds
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import (
    PANEL,
    Counts,
    FrameBuffer,
    Model,
    State,
    Workspace,
    Worlds,
    most_panels,
)


def launch_device() -> wp.Device:
    """Warp's name for the device on which JAX places new arrays. All launches use this device.

    If several GPUs are visible, Warp's own default is the GPU whose context the calling thread has used last. This may
    be any of the GPUs, since JAX uses the contexts of all GPUs when it starts. But a kernel cannot read arrays of
    another GPU.
    """
    import jax  # imported here, since processes that only compile kernels do not need JAX

    (device,) = jax.device_put(np.zeros((), np.float32)).devices()
    return wp.device_from_jax(device)


@dataclass(frozen=True)
class Call:
    """A kernel, and the thread blocks with which it is launched.

    Attributes:
        threads: number of threads of a block.
        before, after: the arguments of the kernel before and after the number of the first block.
    """

    kernel: Any
    blocks: int
    threads: int
    before: Sequence[Any]
    after: Sequence[Any]

    def launch(self, first: int, blocks: int, **options: Any) -> None:
        """Launch ``blocks`` blocks, beginning with the block number ``first``."""
        dim, inputs = (blocks, self.threads), [*self.before, first, *self.after]
        wp.launch(self.kernel, dim=dim, inputs=inputs, block_dim=self.threads, **options)


@contextmanager
def others_may_call() -> Iterator[None]:
    """While the body runs, JAX may also call Python functions in other threads. Use this context inside a Python
    function that JAX has called.

    Warp (1.18) holds a lock during a call from JAX. So engines in several CPU threads would run one after another, one
    time slice at a time. Warp has read the data that the lock protects before it calls petmjx's function, so the lock
    can be released here. Other versions of Warp may not have this lock.
    """
    lock = getattr(sys.modules[wp.jax_callable.__module__], "_FFI_CALLBACK_LOCK", None)
    if lock is None or not lock.locked():
        yield
        return
    lock.release()
    try:
        yield
    finally:
        lock.acquire()


def launch_all(calls: Sequence[Call], clock: Any, slice_ns: int) -> None:
    """Launch all blocks of these calls on Warp's current device, which is the device of the call from JAX.

    Args:
        clock: (1,) a number that tells blocks on a CPU that the time slice has ended.
        slice_ns: length of the time slice, ns.
    """
    device = wp.get_device()
    if device.is_cuda:
        with side_by_side(len(calls)) as streams:
            for call, stream in zip(calls, streams, strict=True):
                call.launch(0, call.blocks, stream=stream)
        return

    def run(block: int) -> None:
        for call in calls:
            if block < call.blocks:
                call.launch(block, 1, device=device)

    running: list[Future[None]] = []
    with others_may_call():
        try:
            for block in range(max(call.blocks for call in calls)):
                running.append(_threads().submit(run, block))
            wait(running, timeout=min(slice_ns / 1e9, threading.TIMEOUT_MAX))
        finally:  # The blocks must also end after an error, since their memory is then freed.
            clock.numpy()[0] = 1  # Stops the blocks, which read this number.
            wait(running)
        for future in running:
            future.result()


MOST_BLOCK_THREADS: Final = 1024


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Threads for the thread blocks of all engines on the CPU. A further thread is started only if all threads are
    busy. Threads are kept, since every time slice needs them."""
    return ThreadPoolExecutor(MOST_BLOCK_THREADS, thread_name_prefix="petmjx-mjx-warp-cpu")


def load_kernels(launches: Sequence[Launch]) -> None:
    """Compile the kernels of these launches in parallel, or load them from Warp's cache."""
    kernels = [kernel(launch) for launch in launches] + own_kernels(len(launches))
    modules = list(dict.fromkeys(kernel.module for kernel in kernels))
    device = launch_device()
    wp.force_load(device, modules, max_workers=len(modules))
    if not device.is_cuda:
        note_kernels(CPU_KERNEL)


HEAD_START_NS = 50_000
"""Delay between the starts of two kernels, ns. A GPU assigns thread blocks to its multiprocessors in the order in which
they are launched, and runs them to their end. Because of the delay, the blocks of the first kernel get their places on
the multiprocessors before the blocks of the second kernel."""


@functools.cache
def _more_streams(device: str, count: int) -> list[wp.Stream]:
    return [wp.Stream(device) for _ in range(count)]


def own_kernels(count: int) -> list[wp.Kernel]:
    """The kernels that ``side_by_side`` itself launches."""
    return [pause] if count > 1 and launch_device().is_cuda else []


@contextmanager
def side_by_side(count: int) -> Iterator[list[wp.Stream]]:
    """CUDA streams for kernels that run at the same time. The kernels start after earlier work on the current stream,
    and later work on the current stream waits for the kernels.

    Launch the first kernel on the first stream, the second on the second, and so on: each stream begins a short time
    (``HEAD_START_NS``) after the stream before it.
    """
    device = wp.get_device()
    current = wp.get_stream(device)
    more = _more_streams(device.alias, count - 1)
    for number, stream in enumerate(more, start=1):
        stream.wait_stream(current)
        wp.launch(pause, dim=1, inputs=[number * HEAD_START_NS], block_dim=1, stream=stream)
    try:
        yield [current, *more]
    finally:
        for stream in more:
            current.wait_stream(stream)


TILE_BYTES = 4
"""Shared memory that Warp uses for each thread of a block with tiles (arrays in shared memory), bytes."""


class DeviceLimits(Protocol):
    """The properties of a device on which launches depend. Warp's device objects have these properties.

    Attributes:
        is_cuda: whether the device is a GPU.
        sm_count: number of multiprocessors.
        max_shared_memory_per_block: largest shared memory of a block, bytes.
    """

    @property
    def is_cuda(self) -> bool: ...
    @property
    def sm_count(self) -> int: ...
    @property
    def max_shared_memory_per_block(self) -> int: ...


class Features(NamedTuple):
    """What a kernel can simulate. A kernel with fewer features spills fewer registers to memory.

    Attributes:
        hands: whether hands may carry boxes.
        gives: whether boxes may be compliant.
        wraps: whether stretch film may hold boxes.
        lands: whether the law of landing boxes is in use.
    """

    hands: bool = False
    gives: bool = False
    wraps: bool = False
    lands: bool = False

    @classmethod
    def joined(cls, sets: Iterable[Features]) -> Features:
        """The features that are in any of these sets."""
        return cls(*map(any, zip(cls(), *sets, strict=True)))


NO_FEATURES: Final = Features()


@dataclass(frozen=True)
class Launch:
    """The configuration of a launch, and the sizes and features for which its kernel is compiled.

    Attributes:
        blocks: number of blocks that run at the same time.
        threads, per_sm, worlds, pause_after: as in ``Size``.
        shared_words: shared memory for the Hessian of a world, and for rows of its factor, in units of four bytes.
        panels: number of panels (groups of 16 rows) of the largest system of equations.
    """

    blocks: int
    threads: int
    per_sm: int
    shared_words: int
    panels: int
    features: Features = NO_FEATURES
    worlds: int = 1
    pause_after: int = 0

    @property
    def lanes(self) -> int:
        """Number of worlds that run at the same time."""
        return self.blocks * self.worlds

    @property
    def feature_arguments(self) -> tuple[int, ...]:
        """The features as arguments of the kernel. On a CPU, where a block has one thread and no shared memory, one
        kernel serves all features. Other kernels have no such arguments, since they are compiled for their features."""
        on_cpu = self.threads == 1 and self.tile_words == 0
        return tuple(int(feature) for feature in self.features) if on_cpu else ()

    @property
    def tile_words(self) -> int:
        """Size of the tile (an array in shared memory) of a block, in units of four bytes; 0 if there is no tile."""
        newton_words = newton.own_bytes(self.panels, self.worlds) // 4 if self.worlds > 1 else 0
        return self.worlds * (self.shared_words + newton_words)

    @classmethod
    def here(cls, n_boxes: int, features: Features = NO_FEATURES) -> Launch:
        """The launch for worlds of up to ``n_boxes`` boxes on ``launch_device()``. On a CPU, a block is one thread, and
        one kernel serves all sizes and features."""
        return cls.of(size_for(n_boxes), features)

    @classmethod
    def of(cls, size: Size, features: Features = NO_FEATURES, device: DeviceLimits | None = None) -> Launch:
        """The launch for blocks of this size. If a GPU has too little shared memory, blocks have fewer worlds.

        Args:
            device: the device for which the kernel is compiled. If ``device`` is None, the kernel is compiled for
                ``launch_device()``.
        """
        device = device or launch_device()
        if not device.is_cuda:
            return cls(1, 1, 1, 0, most_panels(MAX_BOXES), features)
        panels = most_panels(size.most_boxes)
        newton_bytes = newton.own_bytes(panels, size.worlds)
        most = device.max_shared_memory_per_block // size.per_sm - newton.DRIVER_BYTES
        if size.worlds > 1:
            room = most - TILE_BYTES * size.threads - size.worlds * newton_bytes
            if room < 0:
                half = replace(size, threads=size.threads // 2, worlds=size.worlds // 2)
                return cls.of(half, features, device)
            words = min(size.shared_bytes, room) // size.worlds // (4 * PANEL**2) * PANEL**2
        else:
            words = min(size.shared_bytes, most - newton_bytes) // 4
        blocks = size.per_sm * device.sm_count
        return cls(blocks, size.threads, size.per_sm, words, panels, features, size.worlds, size.pause_after)


def kernel(launch: Launch) -> Any:
    """The kernel of a launch. The kernel's threads call ``kernels.world_loop.run_worlds``."""
    if launch.feature_arguments:
        return _cpu_kernel(launch.panels, launch.pause_after)
    return _kernel_of_features(launch)


@functools.cache
def _cpu_kernel(panels: int, pause_after: int) -> Any:
    """The kernel for CPUs. This kernel serves all sets of features, since features are its arguments
    (``Launch.feature_arguments``). A kernel for each set of features would take seconds to compile, and would have
    machine code of the same size."""

    def launcher(
        # Model:
        model: Model,
        worlds: Worlds,
        # In:
        n_blocks: int,
        slice_ns: wp.int64,
        first_block: int,
        hands: int,
        gives: int,
        wraps: int,
        lands: int,
        # Data out:
        state: State,
        work: Workspace,
        frames: FrameBuffer,
        counts: Counts,
    ) -> None:
        block, thread = wp.tid()  # type: ignore[misc]  # two numbers in a kernel of two dimensions
        run_worlds(
            model, worlds,
            block + first_block, thread, 1, n_blocks, slice_ns, hands, gives, wraps, lands, work.strip, 0,
            state, work, frames, counts,
        )  # fmt: skip

    text = newton.text_for(panels, worlds=1, threads=1, pause_after=pause_after)
    return with_cpp(launcher, text, optimized_for_cpu=True)


@functools.cache
def _kernel_of_features(launch: Launch) -> Any:
    """The kernel of blocks with shared memory, which is compiled for the features of the launch."""
    shared_words, of_block = launch.shared_words, launch.worlds
    tile_words, threads = launch.tile_words, launch.threads // launch.worlds
    hands, gives, wraps, lands = (int(feature) for feature in launch.features)

    def launcher(
        # Model:
        model: Model,
        worlds: Worlds,
        # In:
        n_blocks: int,
        slice_ns: wp.int64,
        first_block: int,
        # Data out:
        state: State,
        work: Workspace,
        frames: FrameBuffer,
        counts: Counts,
    ) -> None:
        block, thread = wp.tid()  # type: ignore[misc]  # two numbers in a kernel of two dimensions
        block += first_block
        if wp.static(tile_words > 0):
            shared = wp.tile_zeros(shape=tile_words, dtype=float, storage="shared")
        else:
            shared = work.strip  # type: ignore[assignment]  # never used: there is no shared memory
        if wp.static(of_block > 1):
            run_worlds(
                model, worlds,
                of_block * block + thread // threads, thread % threads, threads, n_blocks, slice_ns,
                hands, gives, wraps, lands, shared, shared_words,
                state, work, frames, counts,
            )  # fmt: skip
        else:
            run_worlds(
                model, worlds,
                block, thread, threads, n_blocks, slice_ns, hands, gives, wraps, lands, shared, shared_words,
                state, work, frames, counts,
            )  # fmt: skip

    bounds = launch.threads, launch.per_sm
    text = newton.text_for(launch.panels, of_block, threads, launch.pause_after)
    return with_cpp(launcher, text, threads=launch.threads, launch_bounds=bounds)
