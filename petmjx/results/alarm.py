"""A call after a while, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any


class Alarm:
    """Calls once when its time has come, with the lock held. Its thread lasts until it is closed, whatever a call
    raises: after an error it calls again.

    Whoever sets it or calls it off holds the lock, too. So a call that was put off or called off does not come, also
    if its time came while it waited for the lock.

    Args:
        lock: of all that ``call`` changes.
        call: what to do then; it may set the alarm again.
    """

    def __init__(self, lock: AbstractContextManager[Any], call: Callable[[], None]) -> None:
        self._lock, self._call = lock, call
        self._due_s: float | None = None
        self._seconds = 0.0
        self._changed = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="petmjx-alarm", daemon=True)
        self._thread.start()

    @property
    def is_set(self) -> bool:
        return self._due_s is not None

    def set(self, seconds: float) -> None:
        """Call so many seconds from now, and not when it was to be until now."""
        self._due_s, self._seconds = time.monotonic() + seconds, seconds
        self._changed.set()

    def off(self) -> None:
        """Do not call."""
        self._due_s = None

    def close(self) -> None:
        """Call no more, and let the thread end."""
        self.off()
        self._closed = True
        self._changed.set()

    def _run(self) -> None:
        while not self._closed:
            due_s = self._due_s
            self._changed.wait(None if due_s is None else max(due_s - time.monotonic(), 0.0))
            self._changed.clear()
            with self._lock:
                if self._due_s is not None and time.monotonic() >= self._due_s:
                    self._ring()

    def _ring(self) -> None:
        self._due_s = None
        try:
            self._call()
        except Exception:  # it is tried again: what the call could not do is told by who can raise it
            if self._due_s is None:
                self.set(self._seconds)
