"""A generator that a thread of its own runs ahead of whoever takes what it yields."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class _End:
    error: BaseException | None


def prefetch(items: Generator[Item], most: int) -> Generator[Item]:
    """What a generator yields, in its order. From the first item on that is asked for, it is run until so many wait and
    one more is made. Its error is raised when all that came before has been taken. Closing the result closes it, in
    its thread, and returns when that has ended."""
    queue: SimpleQueue[Any] = SimpleQueue()
    room, closed, ended = threading.Semaphore(most), threading.Event(), threading.Event()

    def run() -> None:
        try:
            with closing(items):
                for item in items:
                    queue.put(item)
                    room.acquire()
                    if closed.is_set():
                        break
        except BaseException as error:  # under no other name: its traceback has this frame, and what the items hold
            queue.put(_End(error))
        else:
            queue.put(_End(None))
        finally:
            ended.set()

    thread = threading.Thread(target=run, name="petmjx-ahead", daemon=True)

    def end() -> None:
        closed.set()
        room.release()
        if thread.ident is not None:
            _wait_for(ended)
            thread.join()

    atexit.register(end)  # a thread in the midst of JAX aborts the process when Python ends
    try:
        thread.start()
        while not isinstance(item := queue.get(), _End):
            room.release()
            yield item
        error = item.error
        del item
        try:
            if error is not None:
                raise error
        finally:
            del error
    finally:
        end()
        atexit.unregister(end)


def _wait_for(ended: threading.Event) -> None:
    """However often it is interrupted: before, nobody else may have what the thread works with. (``Thread.join`` takes
    a thread for ended once it was interrupted.)"""
    try:
        ended.wait()
    except BaseException:
        _wait_for(ended)
        raise
