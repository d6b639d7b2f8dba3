"""Processes that do a share of the work, and that end with the process that started them."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process


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
