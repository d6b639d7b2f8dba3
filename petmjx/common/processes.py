"""Worker processes and threads, deferred signals, and the frequency of Python's garbage collection."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import FrameType
from typing import TYPE_CHECKING, Final, TypeVar

from petmjx.common.machine import cpu_threads

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

_is_command = False


def process_pool(processes: int, *, gpu: bool = True, nice: int = 0) -> ProcessPoolExecutor:
    """A pool of newly started worker processes. Forked processes would hang if a thread of this process held a lock.

    If this process is killed, the worker processes end (``_begin``) instead of waiting for tasks for ever.

    Args:
        gpu: whether the processes see GPUs. A process that sees a GPU takes some of the GPU's memory, even if the
            process computes nothing on the GPU.
        nice: niceness (lower priority) that is added to the processes, so that this process has priority over them. On
            systems without niceness, ``nice`` has no effect.
    """
    # imported here, since most commands start no processes
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin, initargs=(gpu, nice))


def stop(pool: ProcessPoolExecutor) -> None:
    """End the worker processes of a pool immediately, without waiting for running tasks as ``shutdown`` does. No thread
    may still wait for the results of these tasks, which never arrive."""
    for process in list((pool._processes or {}).values()):
        process.terminate()


def _begin(gpu: bool, nice: int) -> None:
    from multiprocessing import parent_process

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


DEFAULT_THREADS: Final = 2
"""Default number of threads. More threads would only wait for Python's global lock. On the CPU of a machine with an
H200 GPU, computing places for boxes on 2,048 pallets took 155 ms with one thread, 118 ms with two, 141 ms with eight
and 158 ms with sixteen."""

_FEW: Final = 2
"""Largest number of calls that ``on_threads`` makes on the calling thread alone. For one or two calls, other threads
would start too late to help."""

Piece = TypeVar("Piece")
Result = TypeVar("Result")


def on_threads(
    function: Callable[[Piece], Result], pieces: Sequence[Piece], most: int = DEFAULT_THREADS
) -> list[Result]:
    """Call ``function`` for each piece, on several threads. The results are in the order of the pieces.

    Args:
        pieces: arguments of the calls. Arguments that take the longest time should come first.
        most: largest number of threads.
    """
    if len(pieces) <= _FEW or most == 1:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(min(cpu_threads(), most), thread_name_prefix="petmjx-pieces") as pool:
        return list(pool.map(function, pieces))


STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request the end of a run."""


@contextlib.contextmanager
def defer_signals(afterwards: bool) -> Iterator[None]:
    """While the body runs, hold back the signals ``STOPPING`` for which a Python function is the handler.

    In other threads than the main thread, this context does nothing, because signal handlers interrupt only the main
    thread.

    Args:
        afterwards: whether a signal that arrived while the body ran is delivered after the body. If ``afterwards`` is
            False, the signal is dropped, for a run that is about to end anyway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    handlers = {number: signal.getsignal(number) for number in STOPPING}
    deferred = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in deferred:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in deferred.items():
            signal.signal(number, handler)
    if signals and afterwards:
        signal.raise_signal(signals[0])


COLLECTION_THRESHOLDS: Final = (100_000, 20, 100)
"""Thresholds of Python's garbage collector: the number of new objects after which it collects the youngest generation,
and the numbers of collections after which it collects the two older generations. With Python's default of 700, 10 and
10, the collector would scan all objects of JAX and Warp again and again while these packages start."""


def claim_process() -> None:
    """State that this process runs nothing but the command ``petmjx``."""
    global _is_command
    _is_command = True


def is_command() -> bool:
    """Whether this process runs nothing but the command ``petmjx``. In such a process, petmjx may change modules and
    settings that the whole process shares."""
    return _is_command


def collect_rarely() -> None:
    """Make garbage collections rare. Call this function only in processes that petmjx started, not in a user's
    process."""
    gc.set_threshold(*COLLECTION_THRESHOLDS)


@contextlib.contextmanager
def no_collection(*, lasting: bool = False) -> Iterator[None]:
    """Collect no garbage while the body runs. This context is useful for code that makes very many objects without
    cycles: otherwise, the collector would scan these objects again and again.

    Args:
        lasting: whether most of the objects that the body makes last until the process ends, like the objects of
            imported libraries. If so, and if the process runs nothing but the command ``petmjx``, later collections do
            not scan the objects that exist at the end of the body.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if lasting and is_command():
            gc.freeze()
        if enabled:
            gc.enable()
