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
