"""Prefetch: runs generators in threads of their own, so that items are made before they are needed."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class _End:
    error: BaseException | None


def prefetch(*sources: Generator[Item], most: int) -> Generator[Item]:
    """Yield the items of generators, while threads make further items in advance. The items of one generator keep their
    order. The items of different generators are mixed, in the order in which they are made.

    The threads start when the first item is requested. The threads make items until ``most`` items wait in the queue,
    and then each thread makes one more item and pauses. An error of a generator is raised after all items that were
    made before the error. The caller may close the returned generator early. Each generator that makes items is then
    closed in its thread, after its current item, and ``close`` returns when all threads have ended.

    Args:
        most: number of items that may wait before the threads pause.
    """
    queue: SimpleQueue[Any] = SimpleQueue()
    room, closed = threading.Semaphore(most), threading.Event()
    end_events = [threading.Event() for _ in sources]

    def run(items: Generator[Item], end_event: threading.Event) -> None:
        try:
            with closing(items):
                for item in items:
                    queue.put(item)
                    room.acquire()
                    if closed.is_set():
                        break
        except BaseException as error:
            # The error must not be kept in another local variable, because its traceback would keep this frame and the
            # items alive.
            queue.put(_End(error))
        else:
            queue.put(_End(None))
        finally:
            end_event.set()

    threads = [
        threading.Thread(target=run, args=arguments, name="petmjx-ahead", daemon=True)
        for arguments in zip(sources, end_events, strict=True)
    ]

    def end() -> None:
        closed.set()
        room.release(len(threads))
        started = [thread for thread in threads if thread.ident is not None]
        _wait_for(end_events[: len(started)])
        for thread in started:
            thread.join()

    atexit.register(end)  # a thread that runs JAX when Python ends would abort the process
    n_running = len(threads)
    try:
        for thread in threads:
            thread.start()
        while n_running:
            item = queue.get()
            if not isinstance(item, _End):
                room.release()
                yield item
                continue
            n_running -= 1
            error = item.error
            del item
            try:
                if error is not None:
                    raise error
            finally:
                del error
    finally:
        try:
            end()
        finally:
            atexit.unregister(end)


def _wait_for(ended: Sequence[threading.Event]) -> None:
    """Wait until all threads have ended, even if Ctrl-C interrupts the wait several times.

    Each thread sets its event when it ends. ``Thread.join`` would not be enough: if Ctrl-C interrupts ``Thread.join``,
    Python regards the thread as ended, although the thread may still use objects that the caller then closes.
    """
    try:
        for event in ended:
            event.wait()
    except BaseException:
        _wait_for(ended)
        raise
