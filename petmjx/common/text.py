"""Texts, counts and times in the form in which petmjx shows them to people."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Final

_SHOWN_CHARACTERS: Final = 60

_ESCAPES: Final = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}


def printable(text: str) -> str:
    """Make text fit into one line: characters that are not visible are escaped ("\\u001b").

    The function escapes control characters (including ESC and C1 of terminals), line breaks, marks that change the
    direction of writing, and broken UTF-8. All text from files passes through this function before it is printed.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else _ESCAPES.get(char, _escape_sequence(ord(char))) for char in text)


def _escape_sequence(code: int) -> str:
    """The escape sequence of a character, such as "\\u001b". For a lone surrogate, with which Python represents a byte
    that is not UTF-8, the sequence has the form "\\xe4".
    """
    return f"\\x{code - 0xDC00:02x}" if 0xDC80 <= code <= 0xDCFF else f"\\u{code:04x}"


def printable_name(text: str) -> str:
    """A name from a file, in the form that messages show: printable and not too long."""
    return shortened_text(printable(text))


def printable_id(text: str) -> str:
    """The id of a plan or an order, in the form that messages show. An id without visible characters is in quotation
    marks."""
    return printable_name(text) if text.strip() else f'"{printable_name(text)}"'


def shortened_text(text: str) -> str:
    """A text, shortened to its beginning if it is too long for a message."""
    return text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + "…"


def first_names(names: Sequence[str], most: int = 5) -> str:
    """A text that lists the first ``most`` of these names, and states how many more there are, such as "a, b and 3
    more". Names from files become printable and are shortened, as messages show them."""
    more_text = f" and {len(names) - most:,} more" if len(names) > most else ""
    return ", ".join(map(printable_name, names[:most])) + more_text


def is_text(text: str) -> bool:
    """Whether a string can be written as UTF-8. Strings with lone surrogates, which represent bytes that were not
    UTF-8, cannot be written."""
    if text.isascii():
        return True
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


UNNAMED: Final = "no article"
"""Name in legends for boxes that have no article."""


def box_in_words(box: int, article: str) -> str:
    """The name of a box in messages, such as "box 22 (candy-00100723)", or "box 22" if the box has no article. The
    number is the box's index in packing order, from 0.
    """
    return f"box {box} ({printable_name(article)})" if article else f"box {box}"


def box_label(box: int, article: str) -> str:
    """A short label of a box, such as "22 candy-00100723", or "22" if the box has no article."""
    return f"{box} {article}" if article else str(box)


def blanked(text: str) -> str:
    """The text with a space in place of each character, except line ends. If a part of a file's text is replaced by its
    blanked form, messages about the rest still name the right line and column."""
    return re.sub(r"[^\n]", " ", text)


def number_in(text: str) -> float | None:
    """The number in a text from a file; None if the text is not a number. This function is stricter than ``float``,
    which also accepts "1_000" and digits that are not ASCII.
    """
    if not text.isascii() or "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def one_line(error: BaseException) -> str:
    """An error's class and text, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def count_text(number: int, noun: str, plural: str | None = None) -> str:
    """A count with its noun, such as "1 plan" or "2,000 plans". ``plural`` is needed if the plural is not the noun with
    an added s."""
    return f"{number:,} {noun if number == 1 else plural or noun + 's'}"


def alternatives(texts: Iterable[str]) -> str:
    """Several texts as alternatives: "a, b or c"."""
    *most, last = texts
    return f"{', '.join(most)} or {last}"


def rounded_text(count: float) -> str:
    """A large number, rounded to three digits: "136 thousand"."""
    for unit, size in (("billion", 1e9), ("million", 1e6), ("thousand", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.0f}"


def next_round_number(value: float, steps: Sequence[float] = (1.0, 2.0, 5.0, 10.0)) -> float:
    """The smallest number of the form step × 10ⁿ that is not below ``value``, where step is one of ``steps``. ``value``
    must be positive."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in steps if step * power >= value * (1 - 1e-9))


def duration(seconds: float) -> str:
    """A duration as text, in whole seconds, whole minutes or tenths of an hour."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def time_left(seconds: float) -> str:
    """A remaining time as text, such as "45 s", "1 min 45 s" or "2 h 5 min"."""
    rounded_s = round(seconds)
    if rounded_s < 60:
        return f"{rounded_s} s"
    if rounded_s < 3600:
        return f"{rounded_s // 60} min {rounded_s % 60} s"
    return f"{rounded_s // 3600:,} h {rounded_s % 3600 // 60} min"


def three_digits(value: float, sign: bool = False) -> str:
    """A number of any size as text with at least three digits, such as "0.00123", "12.3", "1,234" or "1.23e+06".

    Args:
        sign: whether positive numbers also get a sign.
    """
    grouped = 99.95 <= abs(value) < 999_999.5
    return format(value, ("+" if sign else "") + (",.0f" if grouped else ".3g"))
