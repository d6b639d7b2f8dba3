"""Processes that do a share of the work, and that end with the process that started them."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process


def process_pool(processes: int) -> ProcessPoolExecutor:
    """So many fresh processes: a forked one would hang where a thread of this one held a lock.

    If this process is killed, they end, too. Those of the standard library would wait for tasks for ever.
    """
    return ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=_end_with_parent)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="petmjx-parent", daemon=True).start()
