"""A file of plans, decoded one plan at a time, so that damage in the file costs only the plans that it hits.

The text is read as ``{ "id": value, "id": value, … }``, and each value is decoded on its own. So only one plan's JSON
tree is in memory, and repeated ids are noticed (a decoder of the whole file would silently keep the last one). After
damage, reading goes on at the next ``"id": [ {``.
"""

from __future__ import annotations

import json
import re
import sys
from array import array
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any, Final

from petmjx.text import shown

# JSON has less white space than \s. Possessive quantifiers keep the time of a match linear, also in malicious text.
_WS: Final = r"[ \t\n\r]*+"
_STRING: Final = r'"([^"\\]*+(?:\\.[^"\\]*+)*+)"'
_KEY: Final = re.compile(rf"{_WS}{_STRING}{_WS}:{_WS}", re.DOTALL)
_PLAN_START: Final = re.compile(rf"{_STRING}{_WS}:{_WS}\[{_WS}\{{", re.DOTALL)
_AFTER_VALUE: Final = re.compile(rf"{_WS}([,}}])")
_SPACE: Final = re.compile(_WS)
_OPENING: Final = re.compile(rf"{_WS}\{{{_WS}(\}})?")


@dataclass(frozen=True, slots=True)
class Entry:
    """One plan id and what JSON holds under it, not yet validated."""

    plan_id: str
    value: object


@dataclass(frozen=True, slots=True)
class Damage:
    """A place in the text that is not JSON. ``plan_id``: the plan around it, if known."""

    plan_id: str | None
    message: str


def _parse_any_integer(digits: str) -> int | float:
    """An integer of any length. One that float64 cannot hold becomes infinite, and is refused later as not finite."""
    return int(digits) if len(digits) < 400 else float(digits)


_WINDOWS: Final = (1 << 15, 1 << 19, sys.maxsize)
"""Characters; a plan of BED-BPP takes 10,000 to 25,000."""
_LONGEST_TOKEN: Final = 12
"""Length of the longest token that is no string or number (``-Infinity``): the end of a window may cut one."""

_DECODER: Final = json.JSONDecoder()
_PATIENT_DECODER: Final = json.JSONDecoder(parse_int=_parse_any_integer)


def scan_plans(text: str) -> Iterator[Entry | Damage]:
    """Yield every plan of a file's text in order, and every damaged spot."""
    return _Scan(text).run()


class _Broken(Exception):
    """The text is no JSON value: what the decoder says, where, and whether the text simply ends there."""

    def __init__(self, what: str, position: int, cut_off: bool) -> None:
        super().__init__(what)
        self.what = what
        self.position = position
        self.cut_off = cut_off


class _Scan:
    """Reads one text. Use `run` once; `position` is where the next entry begins."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.position = 0
        self._done = False

    def run(self) -> Iterator[Entry | Damage]:
        text = self.text
        opening = _OPENING.match(text)
        if opening is None:
            yield self._without_opening()
        elif opening.group(1):
            if not self._only_space_from(opening.end()):
                yield self._damage(self._end_of_space(opening.end()), "more text after the closing }")
            else:
                self._done = True
        else:
            self.position = opening.end()
        while not self._done:
            yield from self._read_one()

    def _without_opening(self) -> Damage:
        start = self._end_of_space(0)
        if start == len(self.text):
            self._done = True
            return Damage(None, "the file is empty")
        try:
            value, end = _decode(self.text, start)
        except (_Broken, RecursionError):
            return self._damage(start, "expected {")
        if self._only_space_from(end):
            self._done = True
            kind = {list: "a list", str: "a string", bool: "a boolean", type(None): "null"}.get(type(value), "a number")
            return Damage(None, f"the top level must be an object of plan id → placements, got {kind}")
        return self._damage(start, "expected {")

    def _read_one(self) -> Iterator[Entry | Damage]:
        """Read one entry and what follows it. Afterwards the position is at the next entry, or the text is done."""
        text, begin = self.text, self.position
        key = _KEY.match(text, begin)
        if key is None:
            at = self._end_of_space(begin)
            ends = at == len(text)
            yield self._damage(
                at, "the file ends before a plan id; truncated?" if ends else "expected a plan id", begin
            )
            return
        value_at = key.end()
        try:
            plan_id = _decode(text, key.start(1) - 1)[0]
            value, end = _decode(text, value_at)
        except _Broken as broken:
            yield self._damage(broken.position, broken.what, value_at, plan_id=key.group(1), cut_off=broken.cut_off)
            return
        except RecursionError:
            yield self._damage(value_at, "nested too deeply", value_at, plan_id=key.group(1))
            return
        after = _AFTER_VALUE.match(text, end)
        if after is not None and after.group(1) == ",":
            self.position = after.end()
            yield Entry(plan_id, value)
        elif after is not None and self._only_space_from(after.end()):
            self._done = True
            yield Entry(plan_id, value)
        elif after is None and not (isinstance(value, list) and _PLAN_START.search(text, value_at, end) is None):
            # What was decoded as one value contains other plans, or is the rest of a broken one.
            yield self._damage(end, "expected , or }", value_at, plan_id=plan_id)
        else:
            yield Entry(plan_id, value)
            del value
            yield self._damage_after(end, after)

    def _damage_after(self, end: int, after: re.Match[str] | None) -> Damage:
        if after is not None:
            return self._damage(self._end_of_space(after.end()), "more text after the closing }")
        at = self._end_of_space(end)
        if at == len(self.text):
            return self._damage(at, "the file ends without a closing }; truncated?")
        return self._damage(at, "expected , or }")

    def _damage(
        self, at: int, what: str, resume_from: int | None = None, *, plan_id: str | None = None, cut_off: bool = False
    ) -> Damage:
        """Describe damage at ``at``, and move to the first start of a plan after ``resume_from`` (default: ``at``)."""
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

        Where an opening quote is lost, a quote that closes a string looks like one that opens a key. So a key must
        follow a comma or a bracket, or contain none of the characters of JSON's structure.
        """
        while (match := _PLAN_START.search(self.text, position)) is not None:
            start = match.start()
            before = start - 1
            while before >= 0 and self.text[before].isspace():
                before -= 1
            if before < 0 or self.text[before] in ",{]" or not set(match.group(1)) & set("{}[]:,\n"):
                return start
            position = start + 1
        return None

    @cached_property
    def _line_starts(self) -> array[int]:
        """Where lines begin. They are searched only in damaged files, and only once per file."""
        return array("Q", chain([0], (match.end() for match in re.finditer("\n", self.text))))

    def _place(self, position: int) -> tuple[int, int]:
        """Line and column of a position, both from 1."""
        line = bisect_right(self._line_starts, position)
        return line, position - self._line_starts[line - 1] + 1

    def _end_of_space(self, position: int) -> int:
        match = _SPACE.match(self.text, position)
        return position if match is None else match.end()

    def _only_space_from(self, position: int) -> bool:
        return self._end_of_space(position) == len(self.text)


def _decode(text: str, position: int) -> tuple[Any, int]:
    """One JSON value and its end. Raises _Broken, or RecursionError if it is nested too deeply.

    A window of the text is tried first. The decoder's errors count lines from the beginning of their text; in a long
    file with damage in many places this would take minutes.
    """
    for characters in _WINDOWS:
        window = text[position : position + characters]
        whole = position + len(window) == len(text)
        try:
            value, end = _decode_start(window)
        except json.JSONDecodeError as error:
            margin = 0 if whole else _LONGEST_TOKEN
            cut_off = error.pos >= len(window) - margin or error.msg.startswith("Unterminated string")
            if whole or not cut_off:
                raise _Broken(error.msg, position + error.pos, cut_off) from error
        else:
            if whole or end < len(window):
                return value, position + end
    raise AssertionError("the last window is the whole text")


def _decode_start(text: str) -> tuple[Any, int]:
    try:
        return _DECODER.raw_decode(text)
    except json.JSONDecodeError:
        raise
    except ValueError:
        # Python refuses integers of more than 4,300 digits. Such a plan must be named and skipped, not end the run.
        return _PATIENT_DECODER.raw_decode(text)


def describe(source: str, damage: Damage) -> str:
    """The whole line for a damaged spot: file, plan where known, line and column."""
    plan = "" if damage.plan_id is None else f" plan {shown(damage.plan_id)}:"
    return f"{source}:{plan} {damage.message}"
