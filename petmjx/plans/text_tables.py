"""Reads tables from text (``tables_of_text``): encodings, separators, printed tables with frames or white space.

Text may be UTF-8, UTF-16, UTF-32, or in an encoding of ``_ENCODINGS``. A table may have any usual separator. Excel's
line ``sep=;`` may stand above it.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.plans.cell_numbers import is_number
from petmjx.plans.embedded_tables import rows_of_sql, text_of_latex
from petmjx.plans.file_formats import NoBoxes, wide_encoding
from petmjx.plans.header_and_total_rows import LEAST_KNOWN, SEARCHED_ROWS, count_known_names, is_unit_cell
from petmjx.plans.raw_tables import MOST_ROWS, RawTable
from petmjx.plans.table_sections import tables_of_rows

_DELIMITERS: Final = (",", ";", "\t", "|")
_SPACES: Final = " "
"""A separator that stands for any white space between fields, as in printed tables."""


_ENCODINGS: Final = {
    "Windows-1252": "cp1252", "Windows-1250": "cp1250", "Windows-1254": "cp1254", "Windows-1251": "cp1251",
    "GB18030": "gb18030", "Shift JIS": "cp932", "EUC-KR": "cp949", "Big5": "big5",
}  # fmt: skip
"""Encodings that have no mark at the beginning of a text → their names in Python."""


def decoded_text(data: bytes | bytearray) -> tuple[str, str]:
    """Decode bytes to text. The function also returns a note about the encoding ("" for UTF-8).

    UTF-8, UTF-16 and UTF-32 are recognised with certainty. All other bytes are read as Windows-1252, or in another
    encoding of ``_ENCODINGS`` if that gives more known words in headers.
    """
    raw = bytes(data)
    if raw.startswith(b"\xef\xbb\xbf"):
        return raw[3:].decode("utf-8", "replace"), ""
    if (encoding := wide_encoding(raw)) is not None:
        return raw.decode(encoding, "replace"), encoding[:6].upper()
    head = raw[:2000].rstrip(b"\0")  # the end of a damaged text may consist of NUL bytes
    if head.count(b"\0") > len(head) // 4:
        order = "utf-16-le" if head[1:2] == b"\0" else "utf-16-be"
        return raw.decode(order, "replace"), "UTF-16"
    try:
        return raw.decode("utf-8"), ""
    except UnicodeDecodeError:
        pass
    # if several have equally many known words, max returns the first: Windows-1252
    best = max(_ENCODINGS, key=lambda name: _known_in_lines(raw[:20_000].decode(_ENCODINGS[name], "replace")))
    return raw.decode(_ENCODINGS[best], "replace"), best


def _known_in_lines(text: str) -> int:
    """Largest number of known column names in one of the first lines of a text."""
    lines = text.splitlines()[:SEARCHED_ROWS]
    return max((count_known_names(re.split(r"[,;\t|]", line)) for line in lines), default=0)


def tables_of_text(data: bytes | bytearray) -> list[RawTable]:
    """The tables in a text with separators: CSV of any locale, or columns separated by white space.

    A table begins with its header. A title between tables becomes the name of the plan or layer below it.

    Raises:
        InputError: the text contains no table. The error does not name the file.
    """
    text, encoding = decoded_text(data)
    notes = [encoding] if encoding else []
    first, _, rest = text.partition("\n")
    mark = re.fullmatch(r'\s*"?sep=(.|\\t)"?[\s;,]*', first, re.IGNORECASE)
    begin = 1
    delimiter: str | None = None
    if mark is not None:
        delimiter, text, begin = "\t" if mark[1] == "\\t" else mark[1], rest, 2
    if not text.strip():
        raise NoBoxes("the file is empty")
    if text.count("\0"):
        raise NoBoxes("is no text")
    if by_table := rows_of_sql(text):
        return [
            replace(table, title=name, notes=(*notes, "rows of SQL", *table.notes))
            for name, rows in by_table.items()
            for table in tables_of_rows(rows, begin)
        ]
    if latex := text_of_latex(text):
        text, delimiter = latex, "&"
    if "│" in text or "┃" in text or "║" in text:
        text = text.translate(_BOX_DRAWING)
    lost: list[tuple[str, str]] = []
    if text.count('"') % 2:
        text = _without_unclosed(text, lost, begin)
    text = _without_page_heads(text)
    if delimiter is None:
        delimiter = _delimiter_of(text)
    if delimiter not in (",", "\t"):
        notes.append("fields between white space" if delimiter == _SPACES else f'fields between "{delimiter}"')
    rows = list(_fields(text, delimiter))
    if len(rows) > MOST_ROWS:
        raise InputError(f"has more than {MOST_ROWS:,} rows")
    if len(rows) > 1 and not text.endswith("\n") and len(rows[-1]) < len(rows[-2]):
        words, words_above = (" ".join(row).split() for row in rows[:-3:-1])
        if _may_begin(words, words_above):
            lost.append((f"row {len(rows) - 1 + begin}", f"is no box: {printable_name(' '.join(words))}; truncated?"))
            del rows[-1]
    tables = tables_of_rows(rows, begin, lost=lost)
    if any(table.decimal == "," for table in tables):
        notes.append("decimal commas")
    return [replace(table, notes=(*notes, *table.notes)) for table in tables]


def _may_begin(words: Sequence[str], words_above: Sequence[str]) -> bool:
    """Whether the words of a line may be the beginning of a row like the row above. This is so if the line is a single
    word, or if its numbers stand where the row above has numbers, and its other words where that row has words."""
    are_numbers = [*map(is_number, words)]
    return len(words) == 1 or (any(are_numbers) and are_numbers == [*map(is_number, words_above)][: len(words)])


_PAGE: Final = re.compile(
    r"\b(?:page|pag|pagina|página|pág|seite|blatt|strona|str)\b[.:]?[^\S\n]*\d+(?:\s*(?:of|/|von|de|di|z|sur)\s*\d+)?",
    re.IGNORECASE,
)
"""The number of a page in a printed report: "Page 2 of 3"."""


def _without_page_heads(text: str) -> str:
    """The text of a printed report in which the heads of all pages but the first are replaced by empty lines. The head
    of a page has the number of the page, and the same lines as the head of the first page, which may lack the
    number."""
    if _PAGE.search(text[:_LONGEST_HEAD]) is None:
        return text
    lines = text.split("\n")
    plain = [_PAGE.sub("", line).strip() for line in lines]
    counts = Counter(plain)
    first = plain.index(next(name for name, line in zip(plain, lines, strict=True) if _PAGE.search(line)))
    end = next((index for index in range(first, len(lines)) if counts[plain[index]] < 2), len(lines))
    head = {*plain[:end], ""}
    if end == len(lines):
        return text
    begin = None
    for index in range(end, len(lines) + 1):
        if index < len(lines) and plain[index] in head:
            begin = index if begin is None else begin
            continue
        if begin is not None and any(map(_PAGE.search, lines[begin:index])):
            lines[begin:index] = [""] * (index - begin)
        begin = None
    return "\n".join(lines)


_LONGEST_HEAD: Final = 5_000
"""Number of characters at the beginning of a text in which the head of the first page must be."""
_BOX_DRAWING: Final = str.maketrans(
    {
        **dict.fromkeys("│┃║┆", "|"),
        **dict.fromkeys("─━═", "-"),
        **dict.fromkeys((chr(code) for code in range(0x250C, 0x2570) if chr(code) not in "═║"), "+"),
    }
)
"""Characters for frames of printed tables → the characters of ASCII that replace them."""


def _without_unclosed(text: str, lost: list[tuple[str, str]], begin: int) -> str:
    """The text in which lines with an unclosed quotation mark are replaced by empty lines. The replaced lines are added
    to ``lost``."""
    lines = text.split("\n")
    for index, line in enumerate(lines):
        if line.count('"') % 2:
            lost.append((f"row {index + begin}", "has an unclosed quotation mark"))
            lines[index] = ""
    return "\n".join(lines)


_BRACKETS: Final = re.compile(r"[(\[{][^()\[\]{}\n\"]{0,50}[, ][^()\[\]{}\n\"]{0,50}[)\]}]")
"""Text in brackets within a line, such as the three numbers of a place: "(0, 300, 0)"."""
_MASKED: Final = str.maketrans(", ", "\ue000\ue001")
_UNMASKED: Final = str.maketrans("\ue000\ue001", ", ")


def _fields(text: str, delimiter: str) -> Iterator[list[str]]:
    """The fields of each line. Commas and spaces in brackets do not separate fields, if most lines have such
    brackets."""
    lines = text[:20_000].splitlines() if delimiter in (",", _SPACES) else []
    if sum(_BRACKETS.search(line) is not None for line in lines) * 2 > sum(map(bool, map(str.strip, lines))):
        masked = _BRACKETS.sub(lambda match: match[0].translate(_MASKED), text)
        for fields in _plain_fields(masked, delimiter):
            yield [field.translate(_UNMASKED) for field in fields]
        return
    yield from _plain_fields(text, delimiter)


def _plain_fields(text: str, delimiter: str) -> Iterator[list[str]]:
    if delimiter == _SPACES:
        yield from _spaced_fields(text.splitlines())
        return
    if delimiter == "|":  # lines of dashes, as below the header in Markdown or around a table, are removed
        text = "\n".join("" if _FRAME.match(line) else line for line in text.split("\n"))
    try:
        yield from csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    except csv.Error as error:
        raise NoBoxes(f"is no table: {error}") from error


_RULE: Final = re.compile(r"^(?=.*[-=_]{2})[\s|+:]*[-=_]+(?:[\s|+:]+[-=_]+)+[\s|+:]*$")
"""A line of dashes below a header, as in printed tables. Below a narrow column, there is only one dash."""

_FRAME: Final = re.compile(r"^(?=.*[-=_]{2})[-=_\s|+:]+$")
"""A line of dashes anywhere in a table whose fields are separated by "|". A row of single dashes, which may stand for
missing values, is no such line."""


def _spaced_fields(lines: Sequence[str]) -> Iterator[list[str]]:
    """Fields separated by white space. If there is a line of dashes, the dashes show where columns are. Without a line
    of dashes, fields are separated by two or more spaces, or by one or more, whichever gives more rows with equally
    many fields."""
    if (rule := next((index for index, line in enumerate(lines) if _RULE.match(line)), None)) is not None:
        yield from _ruled_fields(lines, rule)
        return
    ways = [[re.split(r"\s{2,}|\t", line.strip()) for line in lines], [line.split() for line in lines]]

    def alike(rows: list[list[str]]) -> int:
        counts = Counter(len(row) for row in rows if len(row) > 1)
        return max(counts.values(), default=0)

    rows = max(ways, key=alike)  # if both ways give equally many rows of equal length, the first way is taken
    first_box = next(
        (index for index, row in enumerate(rows) if sum(map(is_number, row)) >= _NUMBERS_OF_A_BOX), len(rows)
    )
    for index in range(first_box + 1, len(rows)):
        if len(rows[index]) != len(rows[first_box]) and _is_unlike(rows[index], rows[first_box]):
            rows[index] = [" ".join(lines[index].split())]
    first = next((index for index, line in enumerate(lines) if line.strip()), 0)
    if (
        lines
        and lines[first][:1].isspace()
        and all(len(row) == len(rows[first]) + 1 for row in rows[first + 1 :] if any(row))
    ):
        rows[first] = ["", *rows[first]]  # in a printed data frame, the index has no name, so it gets an empty one
    for index in range(1, len(rows)):
        if len(rows[index]) < len(rows[index - 1]) and all(map(is_unit_cell, rows[index])):
            rows[index] = _below_names(rows[index], lines[index], rows[index - 1], lines[index - 1])
    yield from rows


def _ruled_fields(lines: Sequence[str], rule: int) -> Iterator[list[str]]:
    """Fields in the columns that the line of dashes with the number ``rule`` shows. A cell may be empty. A line whose
    numbers lie across the columns is divided at its white space."""
    spans = [match.span() for match in re.finditer(r"[-=_]+", lines[rule])]
    above = next((count for count in range(rule) if not lines[rule - 1 - count].strip()), rule)
    head = rule - (above if above <= _MOST_HEADER_LINES else 1)
    begins = [begin for begin, _ in spans[1:]]
    for index, line in enumerate(lines):
        if _RULE.match(line):
            yield []
        elif index < head:
            yield line.split()
        elif index > rule and line not in lines[head:rule] and _is_sentence(line, spans):
            yield [" ".join(line.split())]
        else:
            cells = [line[begin:end].strip() for begin, end in zip([0, *begins], [*begins, None], strict=True)]
            is_across = any(re.search(r"\d\s+\d", cell) for cell in cells) or any(
                re.match(r"[\d.,]{2}", line[begin - 1 : begin + 1]) for begin in begins
            )
            yield line.split() if is_across else cells if line.strip() else []


def _is_sentence(line: str, spans: Sequence[tuple[int, int]]) -> bool:
    """Whether a line of a printed table is no row, but a sentence, such as a title or "End of report. 0 cases could not
    be loaded.": it has fewer numbers than a box, and its words lie across the gaps between columns; or it has no
    numbers at all, and only single spaces.

    Args:
        spans: where the columns begin and end.
    """
    if len(_DIGITS.findall(line)) >= _NUMBERS_OF_A_BOX or any(map(is_number, line.split()[:1])):
        return False
    is_across = any(line[begin - 1 : begin + 1].strip()[1:] for begin, _ in spans[1:])
    has_single_spaces = " " in line.strip() and "  " not in line.strip()
    return is_across or (has_single_spaces and not _DIGITS.search(line))


def _is_unlike(words: Sequence[str], words_of_box: Sequence[str]) -> bool:
    """Whether words are those of a sentence, and not those of a header or the first words of a row with a box. Words
    count as those of a sentence if at most one of them is a number, and if the numbers do not have the same positions
    as in the row of a box. If both rows begin with a number, the words are not those of a sentence."""
    if all(map(is_unit_cell, words)) or count_known_names(words) >= LEAST_KNOWN:
        return False
    are_numbers = [*map(is_number, words)]
    of_box = [*map(is_number, words_of_box)][: len(words)]
    return len(words) > 1 and sum(are_numbers) < 2 and are_numbers != of_box and not (are_numbers[0] and of_box[0])


_DIGITS: Final = re.compile(r"\d+(?:[.,]\d+)?")
_NUMBERS_OF_A_BOX: Final = 6
"""The row of a box has at least six numbers: three sizes and three coordinates."""


def _below_names(units: list[str], line: str, names: Sequence[str], line_above: str) -> list[str]:
    """One field for each name of a header: the unit that stands below the name in the file, or "". If two units stand
    below the same name, the units are returned unchanged."""
    spans = _spans(names, line_above)
    fields = [""] * len(names)
    for unit, (begin, end) in zip(units, _spans(units, line), strict=True):
        distances = [max(first - end, begin - last, 0) + abs(first + last - begin - end) / 100 for first, last in spans]
        fields[distances.index(min(distances))] = unit
    return fields if sum(map(bool, fields)) == sum(map(bool, units)) else units


def _spans(fields: Sequence[str], line: str) -> list[tuple[int, int]]:
    """Where each field begins and ends in its line."""
    spans, end = [], 0
    for field in fields:
        begin = max(line.find(field, end), end)
        end = begin + len(field)
        spans.append((begin, end))
    return spans


_MOST_HEADER_LINES: Final = 2
"""Largest number of lines of a header above its line of dashes: names, and units below them. If there are more lines
without a blank line between them, only the last line is the header."""
_LEAST_TABS: Final = 2
"""Fields are separated by tabs if all lines have the same number of tabs, and this number is at least
``_LEAST_TABS``."""


def _delimiter_of(text: str) -> str:
    """The separator of a text: the one that gives the most known names in a header, and the most rows with equally many
    fields."""
    sample = text[:200_000]
    if len(text) > len(sample):
        sample = sample[: sample.rfind("\n") + 1] or sample

    def merit(delimiter: str) -> tuple[int, float]:
        try:
            rows = [row for row in _fields(sample, delimiter) if any(cell.strip() for cell in row)]
        except InputError:
            return 0, 0.0
        counts = Counter(len(row) for row in rows)
        if delimiter == _SPACES and counts[1] * 2 > len(rows):
            return 0, 0.0  # most rows have a single field, so spaces are parts of names, not separators
        width, most = max(counts.items(), key=lambda entry: (entry[1], entry[0]), default=(0, 0))
        even = most / max(len(rows), 1) if width > 1 else 0.0
        n_known = max((count_known_names(row) for row in rows[:SEARCHED_ROWS]), default=0)
        return (n_known if n_known >= LEAST_KNOWN else 0), even

    lines = [line for line in sample.splitlines()[:SEARCHED_ROWS] if line.strip()]
    n_tabs = {line.count("\t") for line in lines}
    if len(n_tabs) == 1 and n_tabs.pop() >= _LEAST_TABS:
        return "\t"  # no field has a tab, but fields may have commas: "(0, 300, 0)"
    marked = any(sum(mark in line for line in lines) * 2 > len(lines) for mark in (";", "\t", "|"))
    return max(_DELIMITERS if marked else (*_DELIMITERS, _SPACES), key=merit)
