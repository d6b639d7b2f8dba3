"""How often Python collects garbage: rarely in petmjx's own processes, and never while very many objects are made."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Iterator
from typing import Final

from petmjx.common.processes import is_command

COLLECTION_THRESHOLDS: Final = (100_000, 20, 100)
"""Thresholds of Python's garbage collector: the number of new objects after which it collects the youngest generation,
and the numbers of collections after which it collects the two older generations. With Python's default of 700, 10 and
10, the collector would scan all objects of JAX and Warp again and again while these packages start."""


def collect_rarely() -> None:
    """Make garbage collections rare. Call this function only in processes that petmjx started, not in a user's
    process."""
    gc.set_threshold(*COLLECTION_THRESHOLDS)


@contextlib.contextmanager
def no_collection(*, lasting: bool = False) -> Iterator[None]:
    """Collect no garbage while the body runs. This context is useful for code that makes very many objects without
    cycles: otherwise, the collector would scan these objects again and again.

    Args:
        lasting: whether most of the objects that the body makes last until the process ends, like the objects of
            imported libraries. If so, and if the process runs nothing but the command ``petmjx``, later collections do
            not scan the objects that exist at the end of the body.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if lasting and is_command():
            gc.freeze()
        if enabled:
            gc.enable()
