"""Text as messages show it."""

from __future__ import annotations

import json
from typing import Final

_SHOWN_CHARACTERS: Final = 60


def printable(text: str) -> str:
    """Text as it can stand in one line of a message: control characters and broken UTF-8 are escaped."""
    return text if text.isprintable() else json.dumps(text)[1:-1]


def shown(text: str) -> str:
    """A name from a file as it stands in a message: printable, and of bounded length."""
    return shortened(printable(text))


def shortened(text: str) -> str:
    """The beginning of a text that is too long for a message."""
    return text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + "…"


def is_text(text: str) -> bool:
    """Whether a string can be written as UTF-8 again; bytes that were no UTF-8 and lone surrogates cannot."""
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def one_line(error: BaseException) -> str:
    """An error's kind and text, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """ "1 plan", "2,000 plans"; a plural that does more than end in s is given."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def rounded(count: float) -> str:
    """A large number in three digits: "136 thousand"."""
    for unit, size in (("billion", 1e9), ("million", 1e6), ("thousand", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.0f}"


def duration(seconds: float) -> str:
    """A time to wait, in whole seconds, minutes or tenths of an hour."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
