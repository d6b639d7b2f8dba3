"""Launches of thread blocks: on a GPU by its scheduler, on a CPU each in a thread of its own."""

from __future__ import annotations

import functools
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import warp as wp

from petmjx.engines.warp.streams import side_by_side


@dataclass(frozen=True)
class Call:
    """A kernel, and the blocks that it is launched with.

    Attributes:
        threads: of a block.
        arguments: those of the kernel, by the number of the first block.
    """

    kernel: Any
    blocks: int
    threads: int
    arguments: Callable[[int], Sequence[Any]]

    def launch(self, first: int, blocks: int, **options: Any) -> None:
        """Some of its blocks, from this one on."""
        dim, inputs = (blocks, self.threads), list(self.arguments(first))
        wp.launch(self.kernel, dim=dim, inputs=inputs, block_dim=self.threads, **options)


@contextmanager
def others_may_call() -> Iterator[None]:
    """Inside a call of Python by JAX: let JAX call Python in other threads at the same time.

    Warp (1.18) holds a lock during such a call, so engines in several threads on a CPU would take turns, a slice each.
    What the lock guards is read before Warp calls our function. Other versions may have no such lock.
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
    """Launch all blocks of some calls, on Warp's current device. JAX calls Python for this.

    Args:
        clock: (1,) the number that tells blocks on a CPU that the time slice is over.
        slice_ns: the time slice, ns.
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
        finally:  # also after an error: then the memory of all blocks is freed
            clock.numpy()[0] = 1  # the kernels' own memory
            wait(running)
        for future in running:
            future.result()


MOST_THREADS: Final = 1024


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Threads for the blocks of all engines, as many as are needed at once. They are kept: each slice needs them."""
    return ThreadPoolExecutor(MOST_THREADS, thread_name_prefix="mjx-warp")
