"""Prefetch: a generator runs in its own thread, ahead of the code that uses its items."""

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
    """Yield the items of a generator in order, while a thread makes further items in advance.

    The thread starts when the first item is requested. It makes items until ``most`` of them wait in the queue, and
    then one more. An error of ``items`` is raised after all items before it have been taken. Closing the result closes
    ``items`` in the thread, and returns when the thread has ended.

    Args:
        most: number of items that may wait before the thread pauses.
    """
    queue: SimpleQueue[Any] = SimpleQueue()
    room, closed, end_event = threading.Semaphore(most), threading.Event(), threading.Event()

    def run() -> None:
        try:
            with closing(items):
                for item in items:
                    queue.put(item)
                    room.acquire()
                    if closed.is_set():
                        break
        except BaseException as error:  # no other local keeps the error: its traceback holds this frame and the items
            queue.put(_End(error))
        else:
            queue.put(_End(None))
        finally:
            end_event.set()

    thread = threading.Thread(target=run, name="petmjx-ahead", daemon=True)

    def end() -> None:
        closed.set()
        room.release()
        if thread.ident is not None:
            _wait_for(end_event)
            thread.join()

    atexit.register(end)  # a thread inside JAX aborts the process when Python ends
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
    """Wait until the thread has ended, however often the wait is interrupted.

    Until the thread has ended, no other code may use its objects. ``Thread.join`` does not ensure this: after an
    interruption, it regards the thread as ended.
    """
    try:
        ended.wait()
    except BaseException:
        _wait_for(ended)
        raise
