"""Prefetch: a thread runs a generator ahead of its consumer."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
import weakref
from collections.abc import Generator
from contextlib import suppress

import pytest

from petmjx.common.prefetch import prefetch


class Numbers:
    """A generator of 0, 1, …, with the number of values that it has made so far."""

    def __init__(self, count: int, error: Exception | None = None) -> None:
        self.count, self.error = count, error
        self.made, self.closed_in = 0, ""
        self.ahead = threading.Semaphore(0)

    def all(self) -> Generator[int]:
        try:
            for number in range(self.count):
                self.made += 1
                self.ahead.release()
                yield number
            if self.error is not None:
                raise self.error
        finally:
            self.closed_in = threading.current_thread().name


def test_items_come_in_order_from_a_thread_that_is_ahead() -> None:
    numbers = Numbers(20)
    ahead = prefetch(numbers.all(), most=3)
    assert numbers.made == 0
    head = [next(ahead)]
    for _ in range(5):  # one value was taken, three may wait, and one more is made
        assert numbers.ahead.acquire(timeout=60)
    assert not numbers.ahead.acquire(timeout=0.05)
    assert [*head, *ahead] == [*range(20)]
    assert numbers.closed_in == "petmjx-ahead"


def test_an_error_comes_after_what_came_before_it() -> None:
    numbers: list[int] = []
    with pytest.raises(MemoryError, match="none left"):
        numbers.extend(prefetch(Numbers(5, MemoryError("none left")).all(), most=10))
    ahead = prefetch(Numbers(5, MemoryError("none left")).all(), most=10)
    assert [next(ahead) for _ in range(5)] == [*range(5)]
    with pytest.raises(MemoryError, match="none left"):
        next(ahead)


def test_an_error_holds_nothing_of_the_generator() -> None:
    """After an error, nothing keeps the generator's objects alive: if memory was short, it must be free before the next
    attempt."""

    class Large:
        pass

    held: list[weakref.ref[Large]] = []

    def fails() -> Generator[int]:
        large = Large()
        held.append(weakref.ref(large))
        yield 0
        raise MemoryError

    gc.disable()
    try:
        with suppress(MemoryError):
            list(prefetch(fails(), most=1))
        assert [reference() for reference in held] == [None]
    finally:
        gc.enable()


def test_an_interrupt_does_not_end_the_wait_for_the_thread() -> None:
    """If the wait ended at an interrupt, another run could use objects that the threads still use. The second thread
    takes longer than the first."""
    closing, interrupted = threading.Event(), threading.Event()
    done: list[float] = []

    def slow(seconds: float) -> Generator[int]:
        try:
            while True:
                yield 0
        finally:
            closing.set()
            interrupted.wait(60)
            time.sleep(seconds)
            done.append(seconds)

    def interrupt() -> None:
        closing.wait()
        for _ in range(2):
            time.sleep(0.1)
            os.kill(os.getpid(), signal.SIGINT)
        interrupted.set()

    ahead = prefetch(slow(0.1), slow(0.3), most=1)
    next(ahead)
    threading.Thread(target=interrupt).start()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            ahead.close()
        assert done == [0.1, 0.3]
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("most", [1, 100])
def test_to_close_it_closes_the_generator_and_ends_its_thread(most: int) -> None:
    """To close the generator ends its thread whether the thread waits for room or not."""
    numbers = Numbers(10**9)
    ahead = prefetch(numbers.all(), most=most)
    assert next(ahead) == 0
    ahead.close()
    assert numbers.closed_in == "petmjx-ahead"
    assert numbers.made < 10**9
    assert "petmjx-ahead" not in [thread.name for thread in threading.enumerate()]
    never = Numbers(3)
    prefetch(never.all(), most=most).close()
    assert never.made == 0


def test_items_of_several_generators_come_as_they_are_made() -> None:
    first, second = Numbers(30), Numbers(20)
    items = list(prefetch(((0, item) for item in first.all()), ((1, item) for item in second.all()), most=2))
    assert [item for source, item in items if source == 0] == [*range(30)]
    assert [item for source, item in items if source == 1] == [*range(20)]
    failing = prefetch(Numbers(10**9).all(), Numbers(0, MemoryError("none left")).all(), most=2)
    with pytest.raises(MemoryError, match="none left"):
        list(failing)
