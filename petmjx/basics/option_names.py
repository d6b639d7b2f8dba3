"""What options are called in messages: as they are typed on the command line, as arguments in Python."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

_typed = False
"""Whether the command line runs. One process has one command line, whose threads share it."""


@contextmanager
def typed_options() -> Iterator[None]:
    """In the body, messages have options as they are typed: the command line runs."""
    global _typed
    before, _typed = _typed, True
    try:
        yield
    finally:
        _typed = before


def option(flag: str, value: str = "", *, python: str = "") -> str:
    """An option for a message: "--overwrite" on the command line, "overwrite=True" in Python.

    Args:
        flag: as it is typed, such as ``--out``.
        value: what stands behind it in Python, such as ``True``; it is not typed.
        python: name of the argument, where it is not that of the flag.
    """
    if _typed:
        return flag
    name = python or flag.removeprefix("--").replace("-", "_")
    return f"{name}={value}" if value else name
