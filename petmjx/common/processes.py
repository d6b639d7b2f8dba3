"""Worker processes and threads, deferred signals, and the frequency of Python's garbage collection."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context, parent_process
from types import FrameType
from typing import Final, TypeVar

from petmjx.common.machine import cpu_threads

_is_command = False


def process_pool(processes: int, *, gpu: bool = True, nice: int = 0) -> ProcessPoolExecutor:
    """A pool of newly started processes. Forked processes would hang if a thread of this process held a lock.

    If this process is killed, the processes of the pool end as well, because of ``_begin``. Otherwise, the processes
    would wait for tasks for ever.

    Args:
        gpu: whether the processes see GPUs. A process that sees a GPU takes some of its memory even if it does not use
            the GPU.
        nice: niceness that is added to the processes, so that this process has priority. The value has no effect on
            systems without niceness.
    """
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin, initargs=(gpu, nice))


def stop(pool: ProcessPoolExecutor) -> None:
    """End a pool's processes immediately, whereas ``shutdown`` would wait for the running tasks. No caller may still be
    waiting for results of tasks."""
    for process in list((pool._processes or {}).values()):
        process.terminate()


def _begin(gpu: bool, nice: int) -> None:
    if nice and hasattr(os, "nice"):
        os.nice(nice)
    if not gpu:
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
    parent = parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="petmjx-parent", daemon=True).start()


MOST_THREADS: Final = 2
"""Default number of threads. Additional threads would only wait for Python's global lock. On the host of an H200,
places for 2,048 pallets took 155 ms with one thread, 118 ms with two, 141 ms with eight and 158 ms with sixteen."""

_FEW: Final = 2
"""Up to this number of pieces, the calling thread finishes before other threads could start."""

Piece = TypeVar("Piece")
Result = TypeVar("Result")


def on_threads(function: Callable[[Piece], Result], pieces: Sequence[Piece], most: int = MOST_THREADS) -> list[Result]:
    """Call ``function`` for each piece, on several threads. The results are in the order of the pieces.

    Args:
        pieces: arguments of the calls; the longest should come first.
        most: largest number of threads.
    """
    if len(pieces) <= _FEW or most == 1:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(min(cpu_threads(), most)) as pool:
        return list(pool.map(function, pieces))


STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request the end of a run."""


@contextlib.contextmanager
def defer_signals(afterwards: bool) -> Iterator[None]:
    """Defer the signals ``STOPPING`` until the body has ended, if Python functions handle them.

    This has no effect outside the main thread, since handlers interrupt only the main thread.

    Args:
        afterwards: whether to deliver a signal that arrived meanwhile. Otherwise the signal is dropped, because the run
            is about to end anyway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    handlers = {number: signal.getsignal(number) for number in STOPPING}
    held = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in held:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    if signals and afterwards:
        signal.raise_signal(signals[0])


EVERY: Final = (50_000, 20, 100)
"""Thresholds of Python's garbage collector: the number of new objects before it collects the youngest generation, and
the number of collections before it collects each older one. With the default of 700, 10 and 10 it would scan all
objects of JAX and Warp again and again while they start."""


def claim_process() -> None:
    """State that this process runs nothing but the command ``petmjx``."""
    global _is_command
    _is_command = True


def is_command() -> bool:
    """Whether this process runs nothing but the command ``petmjx``. Then no other code depends on modules and settings
    that the whole process shares."""
    return _is_command


def collect_rarely() -> None:
    """Make garbage collections rare. Only for processes that petmjx started, not for a user's process."""
    gc.set_threshold(*EVERY)


@contextlib.contextmanager
def no_collection() -> Iterator[None]:
    """Collect no garbage while the body runs. For code that makes very many objects without cycles, which the collector
    would scan again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
