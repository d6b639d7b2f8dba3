"""Waits for what other threads and processes do."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest


def wait_for(reached: Callable[[], object], seconds: float = 120.0) -> None:
    """Wait until something is so; where it is not so in time, the test fails. The time is only that of a failure, so it
    may be longer than the busiest machine takes."""
    until = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > until:
            pytest.fail(f"not reached in {seconds:g} s")
        time.sleep(0.01)
