"""Measures the memory of a process and all its descendants, such as workers. Works only on Linux."""

from __future__ import annotations

import os
import threading
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

LOOK_S = 1.0
"""Time between two measurements of the memory, s."""

_KIB = 1024


@dataclass
class Memory:
    """Largest memory so far, bytes; None if the system does not report it."""

    peak_bytes: int | None = None

    def look(self) -> None:
        """Measure the present use of memory."""
        now = memory_of_all(os.getpid())
        if now is not None:
            self.peak_bytes = max(now, self.peak_bytes or 0)


@contextmanager
def looked_at() -> Iterator[Memory]:
    """A context that measures the memory of this process and its descendants: from time to time, in a thread, and at
    the end. A peak between two measurements is missed."""
    memory, ended = Memory(), threading.Event()

    def watch() -> None:
        while not ended.wait(LOOK_S):
            memory.look()

    thread = threading.Thread(target=watch, name="petmjx-memory", daemon=True)
    thread.start()
    try:
        yield memory
    finally:
        ended.set()
        thread.join()
        memory.look()


def memory_of_all(root: int) -> int | None:
    """Bytes of physical memory that a process and its descendants use: shared pages count once. None if the system
    cannot measure memory."""
    children: dict[int, list[int]] = defaultdict(list)
    for folder in Path("/proc").glob("[0-9]*"):
        if (parent := _field(folder / "status", "PPid:")) is not None:
            children[parent].append(int(folder.name))
    sizes, waiting = [], [root]
    while waiting:
        process = waiting.pop()
        waiting += children[process]
        # Pss: if n processes share a page, each has one n-th of the page
        sizes.append(_field(Path(f"/proc/{process}/smaps_rollup"), "Pss:"))
    known = [size * _KIB for size in sizes if size is not None]
    return sum(known) if known else None


def _field(path: Path, name: str) -> int | None:
    """The number after a name in a file of /proc; None if there is no such number, for example because the process has
    ended."""
    try:
        lines = path.read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith(name)), None)
