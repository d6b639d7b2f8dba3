"""A call after a while comes once, with the lock held, and not if it was put off while it waited for the lock; an error
of a call is not the last thing that the alarm does."""

from __future__ import annotations

import threading

import pytest
from support.waiting import wait_for

from petmjx.results.flush_timer import FlushTimer


class Lock:
    """A lock that says when another thread than the test's asks for it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.locked = self._lock.locked
        self.asked = threading.Event()

    def __enter__(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            self.asked.set()
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class Calls:
    """Counts calls, all of which hold the lock. The first ones end with errors, where there are some."""

    def __init__(self, *errors: Exception) -> None:
        self.lock = Lock()
        self.errors = list(errors)
        self.count = 0
        self.alarm = FlushTimer(self.lock, self.call, again_s=0.01)

    def call(self) -> None:
        assert self.lock.locked()
        self.count += 1
        if self.errors:
            raise self.errors.pop(0)


def test_it_calls_once() -> None:
    calls = Calls()
    with calls.lock:
        calls.alarm.set(0.01)
        assert calls.alarm.is_set
    wait_for(lambda: calls.count)
    with calls.lock:
        assert not calls.alarm.is_set
        calls.alarm.close()
    calls.alarm._thread.join(20)
    assert not calls.alarm._thread.is_alive()
    assert calls.count == 1


@pytest.mark.parametrize("again", [False, True])
def test_what_is_put_off_while_it_waits_for_the_lock_does_not_come(again: bool) -> None:
    calls = Calls()
    with calls.lock:
        calls.alarm.set(0.0)
        assert calls.lock.asked.wait(20)
        calls.alarm.set(60.0) if again else calls.alarm.off()
    with calls.lock:  # the thread has had the lock, or still waits for it
        assert calls.alarm.is_set == again
        calls.alarm.close()
    calls.alarm._thread.join(20)
    assert calls.count == 0


def test_it_may_be_set_by_its_own_call() -> None:
    calls = Calls()
    call = calls.alarm._call

    def twice() -> None:
        call()
        if calls.count == 1:
            calls.alarm.set(0.01)

    calls.alarm._call = twice
    with calls.lock:
        calls.alarm.set(0.01)
    wait_for(lambda: calls.count == 2)


def test_after_an_error_of_any_kind_it_calls_again() -> None:
    calls = Calls(ValueError("odd"), MemoryError(), RuntimeError("can't start new thread"))
    with calls.lock:
        calls.alarm.set(0.01)
    wait_for(lambda: calls.count == 4)
    with calls.lock:
        assert not calls.alarm.is_set
        calls.alarm.close()
