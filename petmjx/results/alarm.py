"""A call after a while, in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any


class Alarm:
    """Calls once when its time has come, with the lock held.

    Whoever sets it or calls it off holds the lock, too. So a call that was put off or called off does not come, also
    if its time came while it waited for the lock.

    Args:
        lock: of all that ``call`` changes.
        call: what to do then; it may set the alarm again.
    """

    def __init__(self, lock: AbstractContextManager[Any], call: Callable[[], None]) -> None:
        self._lock, self._call = lock, call
        self._timer: threading.Timer | None = None

    @property
    def is_set(self) -> bool:
        return self._timer is not None

    def set(self, seconds: float) -> None:
        """Call so many seconds from now, and not when it was to be until now."""
        self.off()
        timer = threading.Timer(seconds, self._ring)
        timer.daemon = True
        timer.start()  # the lock is held: it does not ring before the next line
        self._timer = timer

    def off(self) -> None:
        """Call no more."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _ring(self) -> None:
        with self._lock:
            if threading.current_thread() is self._timer:
                self._timer = None
                self._call()
