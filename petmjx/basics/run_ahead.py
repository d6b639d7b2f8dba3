"""A generator that a thread of its own runs ahead of whoever takes what it yields."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class _End:
    error: BaseException | None


def run_ahead(items: Generator[Item], most: int) -> Generator[Item]:
    """What a generator yields, in its order. It is run at most so many items ahead, from the first one on that is asked
    for. Its error is raised when all that came before has been taken. Closing the result closes it, in its thread."""
    came: SimpleQueue[Item | _End] = SimpleQueue()
    room, closed = threading.Semaphore(most), threading.Event()

    def run() -> None:
        error = None
        try:
            with closing(items):
                for item in items:
                    came.put(item)
                    room.acquire()
                    if closed.is_set():
                        break
        except BaseException as caught:
            error = caught
        came.put(_End(error))

    thread = threading.Thread(target=run, name="petmjx-ahead", daemon=True)
    thread.start()
    try:
        while not isinstance(item := came.get(), _End):
            room.release()
            yield item
        if item.error is not None:
            raise item.error
    finally:
        closed.set()
        room.release()
        thread.join()
