"""Reads orders from text files of numbers (``order_source``): test problems of packing research, and lists of box
sizes.

There are three forms. The first form is that of Bischoff and Ratcliff's files ``thpack`` and ``wtpack`` in the
OR-Library (people.brunel.ac.uk/~mastjjb/jeb, pages ``thpackinfo`` and ``conloadinfo``). The second form has the number
of boxes, the bin and a line per box; it comes from the generator of Martello, Pisinger and Vigo (2000, "The
three-dimensional bin packing problem", Operations Research 48(2), 256–267). The third form has three lengths per line,
as in RoboBPP's ``opai.txt``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.known_forms import BoxSource, KnownForm
from petmjx.plans.raw_tables import MOST_ROWS, BoxList, RawTable
from petmjx.plans.text_tables import decoded_text

SET_ITEMS: Final = 50
"""Number of boxes per order if a file is one long list of boxes that are not divided into orders."""
THPACK: Final = KnownForm("a container loading problem (thpack)")
MPV: Final = KnownForm("a bin packing problem of Martello, Pisinger and Vigo's form")
LENGTHS: Final = KnownForm("a list of lengths")
_LINES_BEFORE: Final = 5
"""Largest number of lines that a thpack file may have before its first line with a box type."""


@dataclass
class _Rows:
    """The boxes that have been read so far."""

    header: tuple[str, ...]
    rows: list[tuple[Any, ...]] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    parts: list[str] = field(default_factory=list)
    containers: dict[str, dict[str, float]] = field(default_factory=dict)
    lost: list[tuple[str, str]] = field(default_factory=list)

    def add(self, cells: Sequence[Any], line: _Line, part: str) -> None:
        if len(self.rows) >= MOST_ROWS:
            raise InputError(f"has more than {MOST_ROWS:,} boxes")
        self.rows.append(tuple(cells))
        self.places.append(line.place)
        self.parts.append(part)

    def source(self, form: KnownForm, notes: Sequence[str] = ()) -> BoxSource:
        table = RawTable(self.header, self.rows, self.places, lost=tuple(self.lost))
        return BoxSource(BoxList(table, "", tuple(self.parts), self.containers), form, tuple(notes))


@dataclass(frozen=True)
class _Line:
    """A line of text.

    Attributes:
        number: number of the line, from 1.
        words: the words in the line.
    """

    number: int
    words: tuple[str, ...]

    @property
    def place(self) -> str:
        return f"line {self.number}"

    def __len__(self) -> int:
        return len(self.words)

    @property
    def values(self) -> list[float | None]:
        """The numbers in the line; None for each word that is not a number."""
        numbers = [cell_number(word) for word in self.words]
        return [None if number is None else number.value for number in numbers]

    @property
    def is_numeric(self) -> bool:
        return all(value is not None for value in self.values)

    def count(self, what: str) -> int:
        """The whole number at the beginning of the line. ``what``: what the number counts, in words for the message.

        Raises:
            InputError: the first word is not a whole number from 1 to ``MOST_ROWS``.
        """
        value = self.values[0]
        if value is None or not value.is_integer() or not 1 <= value <= MOST_ROWS:
            word = printable_name(self.words[0])
            raise InputError(f"{self.place}: {what} must be a whole number from 1, got {word}")
        return int(value)


def order_source(data: bytes | bytearray) -> BoxSource | None:
    """Read the boxes of a text of numbers; None if the form is unknown.

    Raises:
        InputError: a text of a known form is damaged. The error names the line, but not the file.
    """
    if data[:2] == b"PK" or b"\0" in data[:2000]:
        return None
    text, _ = decoded_text(data)
    if text.lstrip("\ufeff \t\r\n")[:1] in ("{", "[", "<"):
        return None
    marks = r"[\s;]+" if ";" in text else r"[\s,]+"
    lines = [
        _Line(number, tuple(words))
        for number, line in enumerate(text.splitlines(), start=1)
        if (words := re.split(marks, line.strip())) != [""] and not line.lstrip().startswith("#")
    ]
    if not lines or not any(line.is_numeric for line in lines[:3]):
        return None
    if _is_thpack(lines):
        return _thpack(lines)
    numeric = sum(line.is_numeric for line in lines)
    if numeric < 0.8 * len(lines) or any(re.search(r"[^\W\d_]{3,}", word) for word in lines[0].words):
        return None
    return _bin_packing(lines) or _lengths(lines)


# Bischoff and Ratcliff's files.


def _flags_at(line: _Line) -> int | None:
    """Position of the word with the length in the line of a box type. The length is recognised by the marks (0 or 1)
    after each of the three sizes. The result is None if the line has no such marks."""
    for begin in (1, 0):  # the line may begin with the number of the type
        marks = line.words[begin + 1 : begin + 6 : 2]
        if len(line) >= begin + 7 and len(marks) == 3 and sum(mark in ("0", "1") for mark in marks) >= 2:
            return begin
    return None


def _is_thpack(lines: Sequence[_Line]) -> bool:
    """Whether lines have the form of container loading problems: a container, the number of box types, and a line per
    type."""
    first = next(
        (number for number, line in enumerate(lines[: _LINES_BEFORE + 1]) if _flags_at(line) is not None), None
    )
    if first is None or first < 2 or len(lines[first - 1]) > 2 or len(lines[first - 2]) not in (3, 4):
        return False
    flagged = sum(_flags_at(line) is not None for line in lines)
    long = sum(len(line) >= 7 for line in lines)
    return flagged * 2 > long


def _thpack(lines: Sequence[_Line]) -> BoxSource:
    """The problems of ``thpack`` and ``wtpack`` files.

    The line of a box type has the number of the type, length, mark, width, mark, height, mark and quantity. The mark
    after a size is 1 if this size may be vertical, otherwise 0. In ``wtpack``, types have no numbers, and the quantity
    is followed by the weight in kg and by load-bearing strengths. petmjx turns boxes only about the vertical axis, so
    it must choose which size is vertical. It chooses the first of height, width and length that has the mark 1. If no
    size has the mark 1, it chooses the height.
    """
    weighted = any(len(line) - (_flags_at(line) or 0) >= 8 and _flags_at(line) == 0 for line in lines)
    rows = _Rows(("type", "length", "width", "height", "quantity", *(("weight per box",) if weighted else ())))
    position, problem, laid, free = 0, 0, 0, 0
    if len(lines[0]) == 1 and len(lines) > 1 and len(lines[1]) <= 3:
        position = 1
    while position < len(lines):
        problem += 1
        name = str(problem)
        if len(lines[position]) <= 2:
            name = lines[position].words[0]
            position += 1
        container, n_types, position = _problem_head(lines, position)
        begin = position
        part = name if name not in rows.containers else f"{name} ({problem})"
        rows.containers[part] = container
        for line in lines[position : position + n_types]:
            at = _flags_at(line)
            if at is None and len(line) < 7:
                break
            position += 1
            at = (1 if len(line) in (8, 9) else 0) if at is None else at
            marks = line.words[at + 1 : at + 6 : 2]
            if not set(marks) <= {"0", "1"}:
                bad_mark = next(mark for mark in marks if mark not in ("0", "1"))
                fault = f"after a size, 1 or 0 must say whether it may be vertical, got {printable_name(bad_mark)}"
                rows.lost.append((line.place, fault))
                continue
            sizes = list(line.words[at : at + 6 : 2])
            upright = next((axis for axis in (2, 1, 0) if marks[axis] == "1"), 2)
            laid += upright != 2
            free += sum(mark == "1" for mark in marks) > 1
            sizes = [size for axis, size in enumerate(sizes) if axis != upright] + [sizes[upright]]
            quantity = line.words[at + 6]
            extra_words = (line.words[at + 7] if len(line) > at + 7 else None,) if weighted else ()
            rows.add(
                (f"{part}/{line.words[0] if at else position - begin}", *sizes, quantity, *extra_words), line, part
            )
        if position - begin < n_types:
            where = lines[position].place if position < len(lines) else "the end"
            raise InputError(
                f"{lines[begin - 1].place}: announces {count_text(n_types, 'box type')}, but only "
                f"{position - begin:,} before {where}"
            )
        if position < len(lines) and _flags_at(lines[position]) is not None and len(lines[position]) >= 7:
            raise InputError(
                f"{lines[position].place}: is one box type more than the {n_types:,} that {lines[begin - 1].place} "
                "announces"
            )
    if len(lines[0]) == 1 and len(lines[1]) < 3 and (n_problems := lines[0].count("the number of problems")) != problem:
        raise InputError(
            f"{lines[0].place}: announces {count_text(n_problems, 'problem')}, but the file contains {problem:,} "
            "(truncated?)"
        )
    notes = []
    if laid:
        lying = count_text(laid, "box type lies", "box types lie")
        notes.append(f"{lying} on a permitted side, since the height must not be vertical")
    if free:
        notes.append(
            f"{count_text(free, 'box type')} may also stand on other sides, but petmjx turns boxes only about the "
            "vertical"
        )
    return rows.source(THPACK, notes)


def _problem_head(lines: Sequence[_Line], position: int) -> tuple[dict[str, float], int, int]:
    """The sizes of the container by axis, the number of box types, and the position of the first type's line, from the
    first two lines of a problem."""
    if position + 1 >= len(lines):
        raise InputError(f"{lines[-1].place}: ends within a problem")
    line, count = lines[position], lines[position + 1]
    sizes = line.values[:3]
    if len(line) not in (3, 4) or not all(size is not None and size > 0 for size in sizes):
        shown = printable_name(" ".join(line.words))
        raise InputError(f"{line.place}: must be length, width and height of the container, got {shown}")
    n_types = count.count("the number of box types")
    container = {
        axis: size for axis, size in zip(("length", "width", "height"), sizes, strict=True) if size is not None
    }
    return container, n_types, position + 2


# Martello, Pisinger and Vigo's form.


def _bin_packing(lines: Sequence[_Line]) -> BoxSource | None:
    """The problems of a text in the form of Martello, Pisinger and Vigo: the number of boxes, the bin, and a line per
    box with its width, height and depth. The result is None if the first lines have another form.

    Each problem begins with one line "n W H D", or with two lines, "n" and "W H D"; either of these two may come first.
    n is the number of boxes; W, H and D are the width, height and depth of the bin. The height is vertical.
    """
    head = _bin_head(lines, 0)
    if head is None:
        return None
    rows = _Rows(("width", "height", "depth"))
    position, problem = 0, 0
    while position < len(lines):
        head = _bin_head(lines, position)
        if head is None:
            raise InputError(
                f"{lines[position].place}: must be the number of boxes and the sizes of the bin, or the end of the file"
            )
        n_boxes, sizes, begin = head
        problem += 1
        body = lines[begin : begin + n_boxes]
        if len(body) < n_boxes:
            raise InputError(
                f"{lines[position].place}: announces {count_text(n_boxes, 'box', 'boxes')}, but the file ends "
                f"after {len(body):,}"
            )
        part = str(problem)
        rows.containers[part] = dict(zip(("width", "height", "depth"), sizes, strict=True))
        for line in body:
            if len(line) not in (3, 4):
                rows.lost.append((line.place, f"has {count_text(len(line), 'number')} instead of 3"))
                continue
            rows.add(line.words[-3:], line, part)
        position = begin + n_boxes
    if problem == 1:
        rows.containers = {"": rows.containers["1"]}
        rows.parts = [""] * len(rows.parts)
    return rows.source(MPV)


def _bin_head(lines: Sequence[_Line], position: int) -> tuple[int, list[float], int] | None:
    """The number of boxes, the bin's width, height and depth, and the position of the first box's line, from the first
    lines of a problem (see ``_bin_packing``). The result is None if the lines from ``position`` on do not begin a
    problem."""
    head_line = lines[position]
    after = lines[position + 1] if position + 1 < len(lines) else _Line(0, ())
    if len(head_line) == 4 and head_line.is_numeric:
        later_lines = lines[position + 1 :]
        count, *sizes = head_line.values
        if count is None or not (count.is_integer() and 0 < count <= MOST_ROWS):
            return None
        n_boxes = int(count)
        widths = {len(line) for line in later_lines[:n_boxes]}
        fits = len(later_lines) >= n_boxes and widths == {4} and _counts_up(later_lines[:n_boxes])
        if fits or 3 in widths:
            return n_boxes, [size for size in sizes if size is not None], position + 1
        return None
    for number, size in ((head_line, after), (after, head_line)):
        if len(number) == 1 and len(size) == 3 and number.is_numeric and size.is_numeric:
            n_boxes = number.count("the number of boxes")
            return n_boxes, [value for value in size.values if value is not None], position + 2
    return None


def _counts_up(lines: Sequence[_Line]) -> bool:
    """Whether the first numbers of the lines are 0, 1, 2, … or 1, 2, 3, …"""
    first = [line.values[0] for line in lines]
    return any(first == list(map(float, range(begin, begin + len(first)))) for begin in (0, 1))


# Lists of lengths.


def _lengths(lines: Sequence[_Line]) -> BoxSource | None:
    """The boxes of a file with three lengths per line, grouped into orders of ``SET_ITEMS`` boxes. The result is None
    if most lines do not have three words.

    Raises:
        InputError: all lines are numbers, but most lines have fewer than three.
    """
    widths = [len(line) for line in lines]
    width = max(set(widths), key=widths.count)
    if width < 3:
        if all(line.is_numeric for line in lines):
            raise InputError(f"{lines[0].place}: must have three lengths in each line, got {len(lines[0])}")
        return None
    if width > 3:
        return None
    rows = _Rows(("length", "width", "height"))
    several = len(lines) > SET_ITEMS
    for number, line in enumerate(lines):
        if len(line) != width:
            rows.lost.append((line.place, f"must have three lengths, got {len(line)}"))
            continue
        rows.add(line.words, line, str(number // SET_ITEMS + 1) if several else "")
    return rows.source(LENGTHS, (f"the list is divided into orders of {SET_ITEMS} boxes",) if several else ())
