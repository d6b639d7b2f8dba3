"""Deferred signals (``defer_signals``): Ctrl-C and similar signals wait while a run executes code that must not be
interrupted."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Final

STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request the end of a run."""


@contextlib.contextmanager
def defer_signals(afterwards: bool) -> Iterator[None]:
    """While the body runs, hold back those signals of ``STOPPING`` whose handler is a Python function.

    In other threads than the main thread, this context does nothing, because signal handlers interrupt only the main
    thread.

    Args:
        afterwards: whether a signal that arrived while the body ran is delivered after the body. If ``afterwards`` is
            False, the signal is dropped, for a run that is about to end anyway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    handlers = {number: signal.getsignal(number) for number in STOPPING}
    deferred = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in deferred:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in deferred.items():
            signal.signal(number, handler)
    if signals and afterwards:
        signal.raise_signal(signals[0])
