"""A file of plans, decoded one plan at a time, so that damage loses only the plans in which it is.

The bytes are walked as ``{ "id": value, "id": value, … }``. Each value is decoded on its own: only one plan's
JSON tree exists at a time, repeated ids are seen (a decoder of the whole file would silently keep the last),
and where the text is damaged, reading goes on at the next ``"id": [ {``.

Time and memory are bounded by the size of the file, also of a malicious one: every search is linear, no value is longer
than `LONGEST_VALUE`, and all that is decoded more than once stays within a budget.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from petmjx.bounded import size
from petmjx.text import shown

# JSON's white space is less than \s. Possessive quantifiers keep every match linear, also in malicious text.
_WS: Final = rb"[ \t\n\r]*+"
_STRING: Final = rb'"([^"\\]*+(?:\\.[^"\\]*+)*+)"'
_KEY: Final = re.compile(rb"%b%b%b:%b" % (_WS, _STRING, _WS, _WS), re.DOTALL)
_PLAN_VALUE: Final = re.compile(rb'"%b:%b\[%b\{' % (_WS, _WS, _WS))
"""From the quote that closes a plan's id to the bracket of its first placement."""
_AFTER_VALUE: Final = re.compile(rb"%b([,}])" % _WS)
_SPACE: Final = re.compile(_WS)
_OPENING: Final = re.compile(rb"%b\{%b(\})?" % (_WS, _WS))
_QUOTE: Final = ord('"')
_BACKSLASH: Final = ord("\\")

_SHOWN_ID: Final = 1000
"""Bytes of the id of a damaged plan that are told."""
LONGEST_VALUE: Final = 4 << 20
"""Bytes of one plan's text. A plan of BED-BPP takes 10,000 to 25,000; decoded it takes up to 30 times its text."""
_SMALLEST_WINDOW: Final = 1 << 10
_LONGEST_TOKEN: Final = 12
"""Characters of a token other than a string or a number (``-Infinity``, an escape) that a window's end may cut."""
_BUDGET_PER_BYTE: Final = 8
_BUDGET: Final = 32 << 20
"""Bytes of windows in all, per byte of the file and besides. A sound file takes at most 7.4 per byte: a value's first
window is twice as long as the value before, and each further one four times as long as the last."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One plan id and what JSON holds under it, not yet validated."""

    plan_id: str
    value: object


@dataclass(frozen=True, slots=True)
class Damage:
    """A spot that is not JSON. ``plan_id`` is the plan it lies in, where that is known."""

    plan_id: str | None
    message: str


def _parse_any_integer(digits: str) -> int | float:
    """Integers of any length; those beyond float64 become infinite and are refused as not finite."""
    return int(digits) if len(digits) < 400 else float(digits)


_DECODER: Final = json.JSONDecoder()
_PATIENT_DECODER: Final = json.JSONDecoder(parse_int=_parse_any_integer)


def scan_plans(data: bytes | bytearray, of: str = "plan id → placements") -> Iterator[Entry | Damage]:
    """Yield every plan of a file's bytes in order, and every damaged spot.

    Args:
        of: what the file should be an object of, for messages.
    """
    return _Scan(data, of).run()


class _Broken(Exception):
    """Text that is no JSON value: what the decoder says, where, and whether the text just ends there."""

    def __init__(self, what: str, position: int, cut_off: bool = False) -> None:
        super().__init__(what)
        self.what = what
        self.position = position
        self.cut_off = cut_off


class _Exhausted(Exception):
    """More was decoded again and again than damage by accident explains."""


class _Scan:
    """The walk through one file. `run` is to be used once; `position` is where the next entry begins."""

    def __init__(self, data: bytes | bytearray, of: str) -> None:
        self.data = data
        self.of = of
        self.position = 0
        self._budget = _BUDGET + _BUDGET_PER_BYTE * len(data)
        self._window = 1 << 15
        self._done = False
        self._line = 1
        self._line_start = 0
        self._known_position = 0

    def run(self) -> Iterator[Entry | Damage]:
        opening = _OPENING.match(self.data)
        if opening is None:
            yield self._without_opening()
        elif opening.group(1):
            if not self._only_space_from(opening.end()):
                yield self._damage(self._end_of_space(opening.end()), "more text after the closing }")
            else:
                self._done = True
        else:
            self.position = opening.end()
        try:
            while not self._done:
                yield from self._read_one()
        except _Exhausted:
            yield Damage(
                None, f"damaged in too many places; nothing is read from line {self._place(self.position)[0]} on"
            )

    def _without_opening(self) -> Damage:
        start = self._end_of_space(0)
        if start == len(self.data):
            self._done = True
            return Damage(None, "the file is empty")
        try:
            value, end = self._decode(start)
        except (_Broken, RecursionError):
            return self._damage(start, "expected {")
        if self._only_space_from(end):
            self._done = True
            kind = {list: "a list", str: "a string", bool: "a boolean", type(None): "null"}.get(type(value), "a number")
            return Damage(None, f"the top level must be an object of {self.of}, got {kind}")
        return self._damage(start, "expected {")

    def _read_one(self) -> Iterator[Entry | Damage]:
        """Read one entry and what follows it; afterwards the walk is at the next one, or done."""
        begin = self.position
        key = _KEY.match(self.data, begin)
        if key is None:
            at = self._end_of_space(begin)
            ends = at == len(self.data)
            yield self._damage(
                at, "the file ends before a plan id; truncated?" if ends else "expected a plan id", begin
            )
            return
        value_at = key.end()
        raw_id = _text(self.data[key.start(1) : min(key.end(1), key.start(1) + _SHOWN_ID)])
        try:
            plan_id = _decode_id(self.data, key)
            value, end = self._decode(value_at)
        except _Broken as broken:
            yield self._damage(broken.position, broken.what, value_at, plan_id=raw_id, cut_off=broken.cut_off)
            return
        except RecursionError:
            yield self._damage(value_at, "nested too deeply", value_at, plan_id=raw_id)
            return
        after = _AFTER_VALUE.match(self.data, end)
        if after is not None and after.group(1) == b",":
            self.position = after.end()
            yield Entry(plan_id, value)
        elif after is not None and self._only_space_from(after.end()):
            self._done = True
            yield Entry(plan_id, value)
        elif after is None and not (isinstance(value, list) and next(self._plan_ids(value_at, end), None) is None):
            # What was decoded as one value contains other plans, or is the rest of a broken one.
            yield self._damage(end, "expected , or }", value_at, plan_id=plan_id)
        else:
            yield Entry(plan_id, value)
            del value
            yield self._damage_after(end, after)

    def _damage_after(self, end: int, after: re.Match[bytes] | None) -> Damage:
        if after is not None:
            return self._damage(self._end_of_space(after.end()), "more text after the closing }")
        at = self._end_of_space(end)
        if at == len(self.data):
            return self._damage(at, "the file ends without a closing }; truncated?")
        return self._damage(at, "expected , or }")

    def _damage(
        self, at: int, what: str, resume_from: int | None = None, *, plan_id: str | None = None, cut_off: bool = False
    ) -> Damage:
        """Describe damage at ``at`` and move to the next plan start from ``resume_from`` on (default: ``at``)."""
        line, column = self._place(at)
        resume_at = self._next_plan_start(at if resume_from is None else resume_from)
        if resume_at is None:
            self._done = True
            if cut_off:
                what = "the file ends inside this plan; truncated?"
            goes_on = ""
        else:
            self.position = resume_at
            goes_on = f"; reading goes on at line {self._place(resume_at)[0]}"
        return Damage(plan_id, f"not JSON at line {line}, column {column} ({what}){goes_on}")

    def _next_plan_start(self, position: int) -> int | None:
        """Where the next ``"id": [ {`` begins.

        A quote that closes a string can look like one that opens a key where an opening quote is lost. A
        key therefore has to follow a comma or a bracket, or else look like a name.
        """
        data = self.data
        for first, close in self._plan_ids(position, len(data)):
            if data[first] == _QUOTE and _follows_a_plan(data, first):
                return first
            # the first quote, escaped or not, with nothing but a name behind it
            last = max(data.rfind(mark, first, close) for mark in b"{}[]:,\n")
            start = data.find(b'"', max(first, last + 1), close)
            if start >= 0:
                return start
        return None

    def _plan_ids(self, position: int, end: int) -> Iterator[tuple[int, int]]:
        """Where plan ids may stand between two places: (first, closing quote).

        ``first`` is the last quote before the closing one that is not escaped, or else ``position``. All quotes between
        the two are escaped. So the pieces do not overlap, and looking at each once is linear.
        """
        data = self.data
        for match in _PLAN_VALUE.finditer(data, position, end):
            close = match.start()
            if _is_escaped(data, close, position):
                continue
            first = data.rfind(b'"', position, close)
            while first >= 0 and _is_escaped(data, first, position):
                first = data.rfind(b'"', position, first)
            if first >= 0 or data.find(b'"', position, close) >= 0:
                yield max(first, position), close

    def _decode(self, position: int) -> tuple[Any, int]:
        """One JSON value and its end. Raises _Broken, or RecursionError where it is nested too deeply.

        Small windows are tried first: the decoder's errors count lines from the beginning of what they were given, and
        what is not ASCII takes up to four times its size while it is decoded.
        """
        n_bytes = self._window
        while True:
            piece = self.data[position : position + n_bytes]
            window = _text(piece)
            self._budget -= len(piece) - _SMALLEST_WINDOW
            if self._budget < 0:
                raise _Exhausted
            whole = position + n_bytes >= len(self.data)
            try:
                value, end = _decode_start(window)
            except json.JSONDecodeError as error:
                margin = 0 if whole else _LONGEST_TOKEN
                cut_off = error.pos >= len(window) - margin or error.msg.startswith("Unterminated string")
                if whole or not cut_off:
                    length = self._seen(_n_bytes(window, error.pos))
                    raise _Broken(error.msg, position + length, cut_off) from error
            else:
                if whole or end < len(window):
                    return value, position + self._seen(_n_bytes(window, end))
            if n_bytes == LONGEST_VALUE:
                raise _Broken(f"longer than {size(LONGEST_VALUE)}", position)
            n_bytes = min(4 * n_bytes, LONGEST_VALUE)

    def _seen(self, length: int) -> int:
        """Choose the next value's first window by the length of this one."""
        self._window = min(max(2 * length, _SMALLEST_WINDOW), LONGEST_VALUE)
        return length

    def _place(self, position: int) -> tuple[int, int]:
        """Line, and column in bytes, of a position, both from 1. Counts on from the last place asked for."""
        data, known = self.data, self._known_position
        if position >= known:
            self._line += data.count(b"\n", known, position)
            # A file may be one line of 100 MB: never search it from its beginning again.
            self._line_start = max(data.rfind(b"\n", known, position) + 1, self._line_start)
        else:
            self._line -= data.count(b"\n", position, known)
            if position < self._line_start:
                self._line_start = data.rfind(b"\n", 0, position) + 1
        self._known_position = position
        return self._line, position - self._line_start + 1

    def _end_of_space(self, position: int) -> int:
        match = _SPACE.match(self.data, position)
        return position if match is None else match.end()

    def _only_space_from(self, position: int) -> bool:
        return self._end_of_space(position) == len(self.data)


def _decode_id(data: bytes | bytearray, key: re.Match[bytes]) -> Any:
    begin, end = key.start(1) - 1, key.end(1) + 1
    if end - begin > LONGEST_VALUE:
        raise _Broken(f"a plan id longer than {size(LONGEST_VALUE)}", begin)
    try:
        return _DECODER.raw_decode(_text(data[begin:end]))[0]
    except json.JSONDecodeError as error:
        raise _Broken(error.msg, begin + error.pos) from error


def _is_escaped(data: bytes | bytearray, quote: int, begin: int) -> bool:
    """Whether an odd number of backslashes stands before a quote."""
    before = quote
    while before > begin and data[before - 1] == _BACKSLASH:
        before -= 1
    return (quote - before) % 2 == 1


def _follows_a_plan(data: bytes | bytearray, start: int) -> bool:
    """Whether what stands before a place is the beginning of the file, a comma or a bracket."""
    before = start - 1
    while before >= 0 and data[before] in b" \t\n\r\v\f":
        before -= 1
    return before < 0 or data[before] in b",{]"


def _text(data: bytes | bytearray) -> str:
    """Bytes that are no UTF-8 become lone surrogates: JSON around them is still read, and a plan whose names hold
    them is refused by name."""
    return data.decode("utf-8", "surrogateescape")


def _n_bytes(text: str, n_characters: int) -> int:
    """How many bytes the first characters of a text took."""
    return n_characters if text.isascii() else len(text[:n_characters].encode("utf-8", "surrogateescape"))


def _decode_start(text: str) -> tuple[Any, int]:
    try:
        return _DECODER.raw_decode(text)
    except json.JSONDecodeError:
        raise
    except ValueError:
        # Python refuses integers of more than 4,300 digits. Such a plan must be named and skipped, not end the run.
        return _PATIENT_DECODER.raw_decode(text)


def describe(source: str, damage: Damage, noun: str = "plan") -> str:
    """The whole line for a damaged spot: file, plan where known, line and column."""
    plan = "" if damage.plan_id is None else f" {noun} {shown(damage.plan_id)}:"
    return f"{source}:{plan} {damage.message}"
