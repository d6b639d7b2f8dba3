"""A call after a while, in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Final

AGAIN_S: Final = 10.0
"""After an error: a disk that is full gets no more than a part to pack in this time, and what waits little older."""


class FlushTimer:
    """Calls once when its time has come, with the lock held. Its thread lasts until it is closed, whatever a call
    raises: after an error it calls again.

    Whoever sets it or calls it off holds the lock, too. So a call that was put off or called off does not come, also
    if its time came while it waited for the lock.

    Args:
        lock: of all that ``call`` changes.
        call: what to do then; it may set the alarm again.
        again_s: how long after an error it calls again, s.
    """

    def __init__(self, lock: AbstractContextManager[Any], call: Callable[[], None], again_s: float = AGAIN_S) -> None:
        self._lock, self._call, self._again_s = lock, call, again_s
        self._due_s: float | None = None
        self._changed = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="petmjx-alarm", daemon=True)
        self._thread.start()

    @property
    def is_set(self) -> bool:
        return self._due_s is not None

    def set(self, seconds: float) -> None:
        """Call so many seconds from now, and not when it was to be until now."""
        before, self._due_s = self._due_s, time.monotonic() + seconds
        if before is None or self._due_s < before:  # else the thread wakes at the time of before, and waits on
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
            self.set(self._again_s)
