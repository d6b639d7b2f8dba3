"""Segments of a large JSON file of plans, which several processes read at the same time.

A file is cut where a list seems to end and a plan seems to begin. The text around such a place proves nothing, since
it could also be part of a plan. But if every segment, in braces, is a JSON object, then the file has exactly the
entries of its segments. If a segment is no JSON object, the whole file is read again.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, NamedTuple

from petmjx.common.safe_read import open_regular
from petmjx.common.text import printable
from petmjx.options.run_options import RunOptions
from petmjx.plans.convention_checks import find_conventions
from petmjx.plans.plan_fields import UnreadFields
from petmjx.plans.plan_reader import MOST_LINES, read_json_plans
from petmjx.plans.plan_set import PlanSet

_WINDOW: Final = 1 << 20
"""Length of the text in which a place for a cut is searched for, bytes. A plan of BED-BPP takes 10,000 to 25,000
bytes."""

_FIRST: Final = re.compile(rb"[ \t\n\r]*+\{")
_LAST: Final = re.compile(rb"\}[ \t\n\r]*+\Z")
"""The opening brace at the beginning of a file, and the closing brace at its end."""

_CUT: Final = re.compile(
    rb'\][ \t\n\r]*+(,)[ \t\n\r]*+"(?:[^"\\]|\\.)*+"[ \t\n\r]*+:[ \t\n\r]*+\[[ \t\n\r]*+\{', re.DOTALL
)
"""The end of a list, a comma, and an entry that begins like a plan."""


class Segment(NamedTuple):
    """A part of the text between the outermost braces of a JSON file: the bytes from ``begin`` to ``end``."""

    file: Path
    begin: int
    end: int

    def text(self) -> bytearray:
        """The text of the segment, enclosed in braces.

        Raises:
            OSError: the file cannot be read, or has become shorter.
            ValueError: the name is impossible for a file.
        """
        text = bytearray(self.end - self.begin + 2)
        text[0:1], text[-1:] = b"{", b"}"
        with open_regular(self.file) as file, memoryview(text)[1:-1] as inner:
            file.seek(self.begin)
            if file.readinto(inner) < len(inner):  # type: ignore[attr-defined]  # a buffered reader of a file
                raise OSError("the file has become shorter since its plans were listed")
        return text


def segments_of(file: Path, count: int) -> list[Segment]:
    """Cut a JSON file into up to ``count`` segments of similar sizes. The list is empty if the file is not a JSON
    object.

    Raises:
        OSError, ValueError: the file cannot be read.
    """
    with open_regular(file) as opened:
        first = _FIRST.match(opened.read(_WINDOW))
        size = opened.seek(0, 2)
        opened.seek(max(size - _WINDOW, 0))
        last = _LAST.search(opened.read())
        if first is None or last is None:
            return []
        begin, end = first.end(), max(size - _WINDOW, 0) + last.start()
        bounds = [begin]
        for number in range(1, count):
            at = begin + (end - begin) * number // count
            opened.seek(at)
            cut = _CUT.search(opened.read(_WINDOW))
            if cut is not None and bounds[-1] < at + cut.start(1):
                bounds.append(at + cut.end(1))
    bounds.append(end + 1)
    # the byte before each further segment is a comma, which belongs to no segment
    return [Segment(file, begin, next_begin - 1) for begin, next_begin in pairwise(bounds)]


class SegmentContent(NamedTuple):
    """The plans of a segment, numbered from 0.

    Attributes:
        unread: counts of the fields that petmjx ignores. ``plan_set.notes`` does not mention these fields.
    """

    plan_set: PlanSet
    unread: UnreadFields


def read_segment(segment: Segment, options: RunOptions, extent_mm: tuple[float, float] | None) -> SegmentContent:
    """Read the plans of a segment. If the segment has an error that is not about one plan, or is not in BED-BPP's form,
    the result has a skipped entry whose ``number`` is None.

    Args:
        extent_mm: extent of the carrier along x and y; None: the extent of the plan's boxes.

    Raises:
        InputError: a plan is unusable, and the option ``strict`` does not allow it to be skipped.
        OSError, ValueError: the file cannot be read.
    """
    return SegmentContent(*read_json_plans(printable(str(segment.file)), segment.text(), options, extent_mm))


def joined(contents: Sequence[SegmentContent], extent_mm: tuple[float, float] | None) -> PlanSet | None:
    """The plans of all segments of a file, as if the file had been read at once. The result is None if two segments
    have plans with the same id, or too many plans are skipped.

    Args:
        extent_mm: see :func:`read_segment`.
    """
    whole, unread, before = PlanSet(), UnreadFields(), 0
    for plan_set, unread_here in contents:
        whole.plans.extend(plan_set.plans)
        whole.skipped.extend(replace(skipped, number=before + (skipped.number or 0)) for skipped in plan_set.skipped)
        whole.warnings.extend(plan_set.warnings)
        whole.numbers.update((plan_id, before + number) for plan_id, number in plan_set.numbers.items())
        unread.update(unread_here)
        before += len(plan_set.plans) + len(plan_set.skipped)
    if len(whole.numbers) < len(whole.plans) or len(whole.skipped) > MOST_LINES:
        return None
    whole.notes.extend(unread.notes())
    # ``conventions`` has a line for each convention that plans appear to follow instead of petmjx's, such as metres.
    # Only plans that are odd, for example because boxes float or overlap or are too heavy, lead to such a line. So
    # the lines are made only if a segment has a warning about an odd plan, or a line about a convention.
    if any(chain.from_iterable((plan_set.warnings, plan_set.conventions) for plan_set, _ in contents)):
        whole.conventions.extend(find_conventions(whole.plans, whole.warnings, extent_mm))
    return whole
