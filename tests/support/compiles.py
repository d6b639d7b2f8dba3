"""Observes which programs XLA compiles."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

_COMPILED = "/jax/core/compile/backend_compile_duration"


@contextmanager
def compiled_programs() -> Iterator[list[str]]:
    """A list with one event for each program that is compiled within the ``with`` block, or loaded from the disk
    cache."""
    compiled: list[str] = []

    def note(event: str, duration_secs: float, **_: Any) -> None:
        compiled.extend([event] * (event == _COMPILED))

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        yield compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
