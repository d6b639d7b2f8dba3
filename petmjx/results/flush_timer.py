"""A timer that calls a function once after some seconds, in its own thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Final

AGAIN_S: Final = 10.0
"""Time between an error and the next attempt, s. On a full disk at most one part is packed in this time, and waiting
rows get only little older."""


class FlushTimer:
    """Calls a function once when its time has come, with the lock held.

    The thread runs until :meth:`close`. If the call raises an exception, the timer calls again after ``again_s``.

    Callers of :meth:`set` and :meth:`off` must hold the lock. Then a postponed or cancelled call never happens, even if
    its time came while the thread waited for the lock.

    Args:
        lock: protects everything that ``call`` changes.
        call: the function to call; it may set the timer again.
        again_s: time between an error and the next call, s.
    """

    def __init__(self, lock: AbstractContextManager[Any], call: Callable[[], None], again_s: float = AGAIN_S) -> None:
        self._lock, self._call, self._again_s = lock, call, again_s
        self._due_s: float | None = None
        self._changed = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="petmjx-flush", daemon=True)
        self._thread.start()

    @property
    def is_set(self) -> bool:
        return self._due_s is not None

    def set(self, seconds: float) -> None:
        """Call after ``seconds``. This replaces an earlier due time."""
        before, self._due_s = self._due_s, time.monotonic() + seconds
        if before is None or self._due_s < before:  # else the thread wakes at the old time and waits again
            self._changed.set()

    def off(self) -> None:
        """Cancel the call."""
        self._due_s = None

    def close(self) -> None:
        """Cancel the call and end the thread."""
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
        except Exception:  # tried again; the error is reported by a caller that can raise it
            self.set(self._again_s)
