"""Waits for other threads and processes."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest


def wait_for(reached: Callable[[], object], seconds: float = 120.0) -> None:
    """Wait until a condition holds. If it does not hold in time, the test fails. Only failing tests wait for the whole
    time, so it may be longer than the busiest machine needs."""
    until = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > until:
            pytest.fail(f"not reached in {seconds:g} s")
        time.sleep(0.01)
