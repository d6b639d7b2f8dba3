"""Keeps signals from cutting short what must be done whole."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Final

STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals by which a run is asked to end."""


@contextlib.contextmanager
def shielded(afterwards: bool) -> Iterator[None]:
    """Hold back signals that Python code handles until the body is through. Without effect outside the main thread,
    which is the one that handlers interrupt.

    Args:
        afterwards: deliver one that came then; else it is forgotten, for a run that is about to end anyway.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    handlers = {number: signal.getsignal(number) for number in STOPPING}
    held = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in held:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    if signals and afterwards:
        signal.raise_signal(signals[0])
