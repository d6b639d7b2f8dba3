"""Processes and threads that do a share of the work; signals that wait; how often Python collects garbage."""

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


def process_pool(processes: int, *, gpu: bool = True, nice: int = 0) -> ProcessPoolExecutor:
    """So many fresh processes: a forked one would hang where a thread of this one held a lock.

    If this process is killed, they end, too. Those of the standard library would wait for tasks for ever.

    Args:
        gpu: whether they see GPUs. Each process that does takes some of their memory, even if it does not use them.
        nice: by how much their niceness is higher, so that this process goes first; nothing where systems have none.
    """
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_begin, initargs=(gpu, nice))


def stop(pool: ProcessPoolExecutor) -> None:
    """End a pool's processes at once: ``shutdown`` would wait for the tasks that they have begun. Nobody may wait for
    these any more."""
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
"""More wait for Python's lock: on the host of an H200, places for 2,048 pallets took 155 ms with one thread, 118 ms
with two, 141 ms with eight and 158 ms with sixteen."""

_FEW: Final = 2
"""So many pieces take no longer in this thread than others to begin."""

Piece = TypeVar("Piece")
Made = TypeVar("Made")


def on_threads(function: Callable[[Piece], Made], pieces: Sequence[Piece], most: int = MOST_THREADS) -> list[Made]:
    """What a function makes of each piece, in their order; the longest should come first.

    Args:
        most: threads.
    """
    if len(pieces) <= _FEW or most == 1:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(min(cpu_threads(), most)) as pool:
        return list(pool.map(function, pieces))


STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals by which a run is asked to end."""


@contextlib.contextmanager
def defer_signals(afterwards: bool) -> Iterator[None]:
    """Hold back signals that Python code handles until the body is through. Without effect outside the main thread,
    which is the one that handlers interrupt.

    Args:
        afterwards: deliver one that came then; else it is forgotten, for a run that is about to end anyway.
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
"""Objects more than before after which Python looks among the youngest, and looks after which it does so among older
ones. With its own 700, 10 and 10 it looks through all that JAX and Warp consist of again and again while they start."""


def collect_rarely() -> None:
    """In a process of petmjx's own, not in a user's."""
    gc.set_threshold(*EVERY)
