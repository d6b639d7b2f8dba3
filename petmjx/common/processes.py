"""Worker processes and threads (``process_pool``, ``on_threads``), and whether this process runs the command
``petmjx``."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
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
    """End the worker processes of a pool immediately, without waiting for running tasks as ``shutdown`` does. Call this
    function only if no thread waits for results, because the results of running tasks never arrive."""
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


def claim_process() -> None:
    """State that this process runs nothing but the command ``petmjx``."""
    global _is_command
    _is_command = True


def is_command() -> bool:
    """Whether this process runs nothing but the command ``petmjx``. In such a process, petmjx may change modules and
    settings that the whole process shares."""
    return _is_command
