"""Raw tables (``RawTable``): rows of text files and sheets with their column names, before anything is interpreted.

Text may be UTF-8, UTF-16, Windows-1252 or Windows-1250. A table may have any usual separator and decimal sign, Excel's
``sep=;``, titles above the header, a line of units below it, and totals at the end.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.plans.column_names import OWN_COLUMNS, column_meanings, is_unit, plain_text, split_unit
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.raw_cells import cell_number, cell_text, decimal_of

MOST_ROWS: Final = 1_000_000
"""Largest number of rows of a table, the same as in a sheet. As Python values, a table of a million boxes takes a
gigabyte."""
MOST_COLUMNS: Final = 1_000
_SEARCHED_ROWS: Final = 60
"""Number of rows at the beginning of a table in which the header is searched for."""
_LEAST_KNOWN: Final = 2
"""A row counts as a header only if at least this number of its cells are known names."""
_DELIMITERS: Final = (",", ";", "\t", "|")
_SPACES: Final = " "
"""A separator that stands for any white space between fields, as in printed tables."""


@dataclass(frozen=True, eq=False)
class RawTable:
    """A table with the content that it has in a file.

    Attributes:
        header: names of the columns. A table without a header has "column 1", "column 2" …
        rows: rows of cells, each as long as the header. A cell is text, a number, or None if it is empty.
        places: for each row, its place in the file, for messages: "row 5", "boxes[4]".
        decimal: decimal sign of numbers stored as text; "": unknown.
        title: name of the sheet, or the path of the list in JSON.
        above: lines above the header.
        lost: (place, fault) of each row that cannot be read, and so is missing in ``rows``.
        notes: how the table was read, if that is not obvious ("Windows-1252", "the header is row 4").
        has_header: whether the names of the columns are in the file.
        part: name of the plan, if each table in a file is one plan; "": the table may contain several plans.
    """

    header: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    places: list[str]
    decimal: str = "."
    title: str = ""
    above: tuple[str, ...] = ()
    lost: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    has_header: bool = True
    part: str = ""

    def column(self, name: str) -> list[Any]:
        """The cells of a column.

        Raises:
            KeyError: the table has no such column.
        """
        if name not in self.header:
            raise KeyError(name)
        index = self.header.index(name)
        return [row[index] for row in self.rows]


# Text.


def decoded_text(data: bytes | bytearray) -> tuple[str, str]:
    """Decode bytes to text. Also returns a note about the encoding ("" for UTF-8).

    UTF-8 and UTF-16 are recognised with certainty. All other bytes are read as Windows-1252, or as Windows-1250 if that
    gives more known words in headers.
    """
    raw = bytes(data)
    if raw.startswith(b"\xef\xbb\xbf"):
        return raw[3:].decode("utf-8", "replace"), ""
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return raw.decode("utf-16", "replace"), "UTF-16"
    head = raw[:2000]
    if head.count(b"\0") > len(head) // 4:
        order = "utf-16-le" if head[1:2] == b"\0" else "utf-16-be"
        return raw.decode(order, "replace"), "UTF-16"
    try:
        return raw.decode("utf-8"), ""
    except UnicodeDecodeError:
        pass
    texts = {
        name: raw.decode(code, "replace") for name, code in (("Windows-1252", "cp1252"), ("Windows-1250", "cp1250"))
    }
    best = max(texts, key=lambda name: _known_in_lines(texts[name]))  # if several are equal, max returns the first
    return texts[best], best


def _known_in_lines(text: str) -> int:
    """Known names are counted in each of the first lines; the result is the largest count."""
    lines = text[:20_000].splitlines()[:_SEARCHED_ROWS]
    return max((_n_known(re.split(r"[,;\t|]", line)) for line in lines), default=0)


def tables_of_text(data: bytes | bytearray) -> list[RawTable]:
    """The tables in a text with separators: CSV of any locale, or columns separated by white space.

    A table begins with its header. Titles between tables become names of the tables' parts.

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
    if "│" in text or "┃" in text or "║" in text:
        text = text.translate(_BOX_DRAWING)
    lost: list[tuple[str, str]] = []
    if text.count('"') % 2:
        text = _without_unclosed(text, lost, begin)
    if delimiter is None:
        delimiter = _delimiter_of(text)
    if delimiter not in (",", "\t"):
        notes.append("fields between white space" if delimiter == _SPACES else f"fields between {delimiter}")
    rows = list(_fields(text, delimiter))
    if len(rows) > MOST_ROWS:
        raise InputError(f"has more than {MOST_ROWS:,} rows")
    tables = tables_of_rows(rows, begin, lost=lost)
    comma = any(table.decimal == "," for table in tables)
    if comma:
        notes.append("decimal commas")
    return [replace(table, notes=(*notes, *table.notes)) for table in tables]


_BOX_DRAWING: Final = str.maketrans(
    {
        **dict.fromkeys("│┃║┆", "|"),
        **dict.fromkeys("─━═", "-"),
        **dict.fromkeys((chr(code) for code in range(0x250C, 0x2570) if chr(code) not in "═║"), "+"),
    }
)
"""Frames of printed tables, as their forms in ASCII."""


def _without_unclosed(text: str, lost: list[tuple[str, str]], begin: int) -> str:
    """The text in which lines with an unclosed quotation mark are replaced by empty lines. These lines are added to
    ``lost``."""
    lines = text.split("\n")
    for index, line in enumerate(lines):
        if line.count('"') % 2:
            lost.append((f"row {index + begin}", "has an unclosed quotation mark"))
            lines[index] = ""
    return "\n".join(lines)


def _fields(text: str, delimiter: str) -> Iterator[list[str]]:
    if delimiter == _SPACES:
        yield from _spaced_fields(text.splitlines())
        return
    if delimiter == "|":  # Markdown has a line of dashes below a header
        text = "\n".join("" if _RULE.match(line) else line for line in text.split("\n"))
    try:
        yield from csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    except csv.Error as error:
        raise NoBoxes(f"is no table: {error}") from error


_RULE: Final = re.compile(r"^[\s|+:]*[-=]{2,}(?:[\s|+:]+[-=]{2,})+[\s|+:]*$")
"""A line of dashes below a header, as in printed tables."""


def _spaced_fields(lines: Sequence[str]) -> Iterator[list[str]]:
    """Fields separated by white space. If there is a line of dashes, the dashes show where columns are, so a cell may
    be empty. Otherwise fields are separated by two or more spaces, or by one or more, whichever gives more rows with
    equally many fields.
    """
    rule = next((index for index, line in enumerate(lines) if _RULE.match(line)), None)
    if rule is not None:
        spans = [match.span() for match in re.finditer(r"[-=]{2,}", lines[rule])]
        for index, line in enumerate(lines):
            if _RULE.match(line):
                yield []
            elif index < rule - 1:
                yield line.split()
            else:
                ends = [*(begin for begin, _ in spans[1:]), None]
                starts = [0, *(begin for begin, _ in spans[1:])]
                cells = [line[start:end].strip() for start, end in zip(starts, ends, strict=True)]
                moved = any(re.search(r"\d\s+\d", cell) for cell in cells)
                yield line.split() if moved else cells if line.strip() else []
        return
    ways = [[re.split(r"\s{2,}|\t", line.strip()) for line in lines], [line.split() for line in lines]]

    def alike(rows: list[list[str]]) -> int:
        counts = Counter(len(row) for row in rows if len(row) > 1)
        return max(counts.values(), default=0)

    rows = max(ways, key=alike)  # if several are equal, max returns the first
    first = next((index for index, line in enumerate(lines) if line.strip()), 0)
    if (
        lines
        and lines[first][:1].isspace()
        and all(len(row) == len(rows[first]) + 1 for row in rows[first + 1 :] if any(row))
    ):
        rows[first] = ["", *rows[first]]  # a printed data frame: its index has no name
    yield from rows


_LEAST_TABS: Final = 2
"""If all lines have the same number of tabs, and at least this number, fields are separated by tabs."""


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
            return 0, 0.0  # only the names of columns have spaces
        width, most = max(counts.items(), key=lambda entry: (entry[1], entry[0]), default=(0, 0))
        even = most / max(len(rows), 1) if width > 1 else 0.0
        n_known = max((_n_known(row) for row in rows[:_SEARCHED_ROWS]), default=0)
        return (n_known if n_known >= _LEAST_KNOWN else 0), even

    lines = [line for line in sample.splitlines()[:_SEARCHED_ROWS] if line.strip()]
    n_tabs = {line.count("\t") for line in lines}
    if len(n_tabs) == 1 and n_tabs.pop() >= _LEAST_TABS:
        return "\t"  # no field has a tab, but fields may have commas: "(0, 300, 0)"
    marked = any(sum(mark in line for line in lines) * 2 > len(lines) for mark in (";", "\t", "|"))
    return max(_DELIMITERS if marked else (*_DELIMITERS, _SPACES), key=merit)


_NUMERIC: Final = re.compile(r"\s*[+-]?[.,]?\d")


def _n_known(cells: Sequence[Any]) -> int:
    """The number of cells in a row that are known column names."""
    names = [cell if isinstance(cell, str) and len(cell) < 100 and not _NUMERIC.match(cell) else "" for cell in cells]
    if sum(map(bool, names)) < _LEAST_KNOWN or len(names) > MOST_COLUMNS:
        return 0
    return _n_distinct(names)


# Rows from any source.


def tables_of_rows(
    rows: Sequence[Sequence[Any]], begin: int = 1, title: str = "", lost: Sequence[tuple[str, str]] = ()
) -> list[RawTable]:
    """The tables in rows of cells. The header of each table is searched for. Rows that are only numbers have no header.

    Args:
        begin: number of the first row, for messages.
        title: name of the sheet.
        lost: rows that an earlier step could not read.

    Raises:
        InputError: there is no table.
    """
    cleaned = [tuple(_cleaned(cell) for cell in row) for row in rows]
    if _names_in_rows(cleaned):
        return [
            replace(
                table,
                places=[place.replace("row", "column") for place in table.places],
                lost=(*lost, *table.lost),
                notes=(*table.notes, "names are in the first column"),
            )
            for table in tables_of_rows(list(zip_longest(*cleaned)), 1, title)
        ]
    heads = _header_rows(cleaned)
    if not heads:
        return [_without_header(cleaned, begin, title, tuple(lost))]
    tables: list[RawTable] = []
    above: list[str] = []
    for number, head in enumerate(heads):
        end = heads[number + 1] if number + 1 < len(heads) else len(cleaned)
        start = 0 if number == 0 else heads[number - 1] + 1
        if number == 0:
            above = [text for row in cleaned[start:head] if (text := _line(row))]
        below, trailing = _table_below(cleaned, head, end, begin, title, tuple(above), number < len(heads) - 1)
        tables += below
        above = trailing
    tables[0] = replace(tables[0], lost=(*lost, *tables[0].lost))
    if len(heads) > 1:
        tables = [
            replace(table, part=table.part or (table.above[-1] if table.above else f"{number}"))
            for number, table in enumerate(tables, start=1)
        ]
    return [table for table in tables if table.rows or table.lost] or tables[:1]


_LEAST_IN_ROWS: Final = 6
"""A table has its names in the first column if at least this number of them is known, and more than in any row."""


def _names_in_rows(rows: Sequence[tuple[Any, ...]]) -> bool:
    """Whether the names are in the first column, so that each further column is a box."""
    n_known = _n_known([row[0] if row else None for row in rows[:MOST_COLUMNS]])
    return n_known >= _LEAST_IN_ROWS and n_known > max(map(_n_known, rows[:_SEARCHED_ROWS]))


def _cleaned(cell: Any) -> Any:
    if isinstance(cell, str):
        cell = cell.strip().strip("\ufeff")
        return cell or None
    if isinstance(cell, float) and np.isnan(cell):
        return None
    return cell


def _line(row: Sequence[Any]) -> str:
    return " ".join(cell_text(cell) for cell in row if cell is not None)


def _header_rows(rows: Sequence[tuple[Any, ...]]) -> list[int]:
    """Indices of the rows that are headers: the first row that has the most known names, and its repetitions."""
    counts = [_n_known(row) for row in rows[:_SEARCHED_ROWS]]
    most = max(counts, default=0)
    if most < _LEAST_KNOWN:
        first = next((index for index, row in enumerate(rows) if any(cell is not None for cell in row)), None)
        return [] if first is None or not _heads_numbers(rows, first) else [first]
    head = counts.index(most)
    header = rows[head]
    return [index for index in range(head, len(rows)) if index == head or rows[index] == header]


def _heads_numbers(rows: Sequence[tuple[Any, ...]], head: int) -> bool:
    """Whether a row is a header with unknown names: it is only text, and the rows below have enough numbers for
    boxes."""
    names = rows[head]
    texts = [cell for cell in names if isinstance(cell, str) and not _NUMERIC.match(cell)]
    below = [row for row in rows[head + 1 : head + 20] if any(cell is not None for cell in row)]
    alike = all(len(row) == len(names) for row in below)
    return len(set(texts)) == len(names) >= 6 and bool(below) and alike and are_numbers(below, 6)


def are_numbers(rows: Sequence[Sequence[Any]], least: int) -> bool:
    """Whether most of the first rows have at least this number of numbers."""
    first = rows[:20]
    counts = [sum(cell_number(cell) is not None or cell_number(cell, ",") is not None for cell in row) for row in first]
    return sum(count >= least for count in counts) * 2 > len(first)


def _table_below(
    rows: Sequence[tuple[Any, ...]], head: int, end: int, begin: int, title: str, above: tuple[str, ...], more: bool
) -> tuple[list[RawTable], list[str]]:
    """The tables below a header, one for each named section. Also returns the remaining lines, from the next header
    on."""
    names = [cell_text(cell) for cell in rows[head]]
    while names and not names[-1]:
        names.pop()
    notes = [f"the header is row {head + begin}"] if head else []
    group = rows[head - 1] if head else ()
    filled = sum(cell is not None for cell in group)
    if filled == 1 and group[0] is not None and not _geometric([cell_text(group[0])]):
        filled = 0  # a title or a comment above the table, not a heading of its columns
    if (filled >= 1 and _n_known(rows[head]) < len(names)) or (filled > 1 and not _has_places(names)):
        names = _with_groups(names, group)
    first = head + 1
    if first < end and any(rows[first]) and all(cell is None or _is_unit_cell(cell) for cell in rows[first]):
        names = [
            f"{name} [{cell_text(cell).strip('[]() ')}]" if cell is not None and not _names_unit(name) else name
            for name, cell in zip(names, (*rows[first], *([None] * len(names))), strict=False)
        ]
        first += 1
    header = tuple(distinct_names(names))
    sections, lost, trailing = _sections(rows, first, end, begin, header, notes)
    if trailing and not more:
        notes.append(f"left out at the end: {printable_name(trailing[0])}")
    names_of = dict.fromkeys(name for name, _ in sections)
    tables = []
    for number, part in enumerate(names_of, start=1):
        body = [row for name, section in sections if name == part for row, _ in section]
        places = [place for name, section in sections if name == part for _, place in section]
        label = (part or (above[-1] if above else "1")) if len(names_of) > 1 else ""
        tables.append(
            RawTable(
                header,
                body,
                places,
                decimal_of(body),
                title,
                above,
                lost if number == 1 else (),
                tuple(notes),
                part=label,
            )
        )
    return tables or [RawTable(header, [], [], ".", title, above, lost, tuple(notes))], trailing if more else []


_Section = tuple[str, list[tuple[tuple[Any, ...], str]]]
"""A section: its name, from the line before it ("" if it has none), and its rows with their places."""


def _sections(
    rows: Sequence[tuple[Any, ...]], first: int, end: int, begin: int, header: Sequence[str], notes: list[str]
) -> tuple[list[_Section], tuple[tuple[str, str], ...], list[str]]:
    """The rows of a table by section, the rows that are lost, and the lines after the last row."""
    width, geometric = len(header), _geometric(header)
    sections: list[_Section] = [("", [])]
    lost: list[tuple[str, str]] = []
    trailing: list[str] = []
    for index in range(first, end):
        row, place = rows[index], f"row {index + begin}"
        filled = [cell for cell in row if cell is not None]
        if not filled:
            continue
        if _is_total(row, geometric):
            notes.append(f"{place} is a total, and left out")
            continue
        if len(filled) == 1 and width > 2 and isinstance(filled[0], str) and not _mostly_numbers(row):
            trailing.append(filled[0])
            continue
        used = len(row)
        while used > width and row[used - 1] is None:
            used -= 1
        if used != width and len(row) != width:
            lost.append((place, f"has {count_text(len(row), 'field')} instead of {width}"))
            continue
        if trailing:
            sections.append((trailing[-1], []))
            trailing = []
        sections[-1][1].append((tuple(row[:width]), place))
    return [section for section in sections if section[1]], tuple(lost), trailing


def geometric_names(header: Sequence[str]) -> tuple[str, ...]:
    """The names of the columns that have sizes or places, sorted. All names if there are none."""
    return tuple(sorted(header[index] for index in _geometric(header))) or tuple(header)


def united(tables: Sequence[RawTable]) -> RawTable:
    """One table with the rows of several tables. A column that a table lacks is empty in its rows."""
    first = tables[0]
    header = tuple(dict.fromkeys(name for table in tables for name in table.header))
    rows: list[tuple[Any, ...]] = []
    for table in tables:
        if table.header == header:
            rows += table.rows
            continue
        columns = {name: index for index, name in enumerate(table.header)}
        order = [columns.get(name) for name in header]
        rows += [tuple(None if index is None else row[index] for index in order) for row in table.rows]
    decimals = {table.decimal for table in tables if table.decimal != "."}
    return replace(
        first,
        header=header,
        rows=rows,
        places=[place for table in tables for place in table.places],
        lost=tuple(entry for table in tables for entry in table.lost),
        notes=tuple(dict.fromkeys(note for table in tables for note in table.notes)),
        decimal=decimals.pop() if len(decimals) == 1 else ".",
    )


def _geometric(header: Sequence[str]) -> list[int]:
    """Indices of the columns that have sizes or places."""
    return [
        index
        for index, meaning in enumerate(column_meanings(header))
        if meaning is not None and meaning.kind in ("size", "sizes", "position", "positions", "low", "high")
    ]


def _is_total(row: Sequence[Any], geometric: Sequence[int]) -> bool:
    """Whether a row is a total or a mean. Its first text must be a word for a total or a mean. If the text only begins
    with such a word, the row must also lack a size or a place, since a box may be called "Total fruit"."""
    text = next(
        (
            cell
            for cell in row
            if isinstance(cell, str) and cell_number(cell) is None and cell_number(cell, ",") is None
        ),
        "",
    )
    plain = plain_text(text).strip()
    if not _TOTAL.match(plain):
        return False
    if _ONLY_TOTAL.match(plain):
        return True
    return not geometric or any(index >= len(row) or row[index] is None for index in geometric)


def computed_row(table: RawTable, rows: Sequence[int]) -> str:
    """How the last row relates to the rows above it: "the total", "the sums" or "the means"; "" if the row is a box.

    Args:
        rows: indices of the rows of one plan.

    The sizes, places and weights of the last row must all be sums, or all be means. At least two of these numbers must
    clearly be sums or means. A single sum or mean is not enough: a box on two smaller boxes may have the sum of their
    lengths, and a box in the middle of a layer of equal boxes has their mean place. In a table with petmjx's own column
    names and no places, a last row is never taken as means: it is more likely a medium-sized box. Nor is it taken
    as means if it has an article of its own, as all rows above it have.
    """
    if len(rows) > 1 and _is_total(table.rows[rows[-1]], _geometric(table.header)):
        return "the total"
    if len(rows) < 3:
        return ""
    meanings = column_meanings(table.header)
    columns = [
        (meaning.kind, index)
        for index, meaning in enumerate(meanings)
        if meaning is not None and meaning.kind in _COMPUTED and not meaning.of_container
    ]
    last = table.rows[rows[-1]]
    has_article = any(
        meaning is not None and meaning.kind == "article" and _names_box(table.rows[row][index] for row in rows)
        for index, meaning in enumerate(meanings)
    )
    has_places = any(kind in _PLACES for kind, _ in columns)
    sums, means = True, not has_article and (has_places or not {*OWN_COLUMNS} <= {*table.header})
    n_sums = n_means = n_goods = 0
    for kind, index in columns:
        number = cell_number(last[index], table.decimal)
        if number is None:
            if last[index] is not None:
                return ""
            continue
        above = [cell_number(table.rows[row][index], table.decimal) for row in rows[:-1]]
        values = np.array([cell.value for cell in above if cell is not None])
        if len(values) < len(rows) - 1 or not np.isfinite(values).all():
            return ""
        total, mean = float(values.sum()), float(values.mean())
        # Sequence and number columns are not tested: a row of sums may have any value in them.
        if kind not in ("sequence", "number"):
            sums &= _as_written(number.value, total)
            n_sums += total != 0.0
        means &= _as_written(number.value, mean)
        varies = bool(np.ptp(values) > 0.0)
        n_means += varies
        n_goods += varies and kind not in _PLACES
        if not sums and not means:
            return ""
    return "the sums" if sums and n_sums > 1 else "the means" if means and n_means > 1 and n_goods else ""


def _names_box(articles: Iterable[Any]) -> bool:
    """Whether all these cells of a column have text, and the last text is no sign for a mean."""
    texts = [plain_text(cell).strip() if isinstance(cell, str) else "" for cell in articles]
    return all(texts) and texts[-1].lower() not in ("ø", "o", "x")


_PLACES: Final = ("position", "low", "high")
_COMPUTED: Final = ("size", "weight", "volume", "sequence", "number", *_PLACES)
"""Kinds of columns whose sums and means show that a row is not a box."""


def _as_written(value: float, exact: float) -> bool:
    """Whether the number in a cell equals an exact number that is rounded to the cell's decimals."""
    decimals = next((count for count in range(7) if round(value, count) == value), 6)
    return abs(value - exact) <= 0.5000001 * 10.0**-decimals + 1e-9 * abs(exact)


def _has_places(names: Sequence[str]) -> bool:
    kinds = {meaning.kind for meaning in column_meanings(names) if meaning is not None}
    return bool(kinds & {"position", "positions", "low"})


def _with_groups(names: list[str], group: Sequence[Any]) -> list[str]:
    """Names that include merged headings in the line above: "Position" above X, Y, Z gives "Position X"."""
    heading, joined = "", []
    for index, name in enumerate(names):
        cell = group[index] if index < len(group) else None
        heading = cell_text(cell) if cell is not None else heading
        joined.append(f"{heading} {name}".strip() if heading and name else name)
    with_units = []  # names that mean something alone get only the unit of their heading
    for long, name, meaning in zip(joined, names, column_meanings(names), strict=True):
        unit = split_unit(long.removesuffix(name).strip())[1]
        with_unit = f"{name} [{unit}]" if unit and not _names_unit(name) else name
        with_units.append(long if meaning is None else with_unit)
    return max(joined, with_units, names, key=_n_distinct)  # if several are equal, max returns the first


def _n_distinct(names: Sequence[str]) -> int:
    return len({(meaning.kind, meaning.axis) for meaning in column_meanings(names) if meaning is not None})


_NO_MEASURE: Final = ("", "-", "–", "°", "deg", "grad", "st", "pcs", "stk", "szt", "ud", "qty")
"""Units of angles and of numbers, and signs for no unit."""


def _is_unit_cell(cell: Any) -> bool:
    return isinstance(cell, str) and (is_unit(cell) or plain_text(cell).strip(" []().").lower() in _NO_MEASURE)


def _names_unit(name: str) -> bool:
    meaning = column_meanings([name])[0]
    return meaning is not None and bool(meaning.unit)


def distinct_names(names: Sequence[str]) -> list[str]:
    """Names without repetitions. An empty name becomes, for example, "column 3".

    Raises:
        InputError: a known name occurs twice.
    """
    name_counts: Counter[str] = Counter()
    distinct = []
    for number, name in enumerate(names, start=1):
        name = name or f"column {number}"
        name_counts[name] += 1
        if name_counts[name] == 2 and column_meanings([name])[0] is not None:
            raise InputError(f"column {printable_name(name)} occurs twice")
        distinct.append(name if name_counts[name] == 1 else f"{name} again")
    return distinct


def _mostly_numbers(row: Sequence[Any]) -> bool:
    cells = [cell for cell in row if cell is not None]
    return sum(cell_number(cell, ",") is not None or cell_number(cell) is not None for cell in cells) * 2 > len(cells)


_TOTAL: Final = re.compile(
    r"^(?:grand |sub|sub[- ]|sous[- ]|zwischen|end)?(?:total|totals|sums?|summe|gesamt(?:summe|gewicht)?|somme|suma|"
    r"totale|totales|totaux|razem|lacznie|ogolem|summen|insgesamt|celkem|totaal|average|avg|mean|median|mittelwert|mittel|"
    r"durchschnitt|moyenne|media|promedio|srednia|gemiddelde|prumer)\b",
    re.IGNORECASE,
)
"""Words for totals and means, without accents."""
_ONLY_TOTAL: Final = re.compile(
    _TOTAL.pattern + r"[\s:=.]*(?:\(.*\)|\[.*\]|[\d.,]+\s*\w{0,5})?[\s:=.]*$", re.IGNORECASE
)
"""The same words with no other word after them: "Summe:", "Total (26)", "Total 12 kg"."""


def _without_header(
    rows: Sequence[tuple[Any, ...]], begin: int, title: str, lost: tuple[tuple[str, str], ...]
) -> RawTable:
    """Make a table from rows of numbers that have no column names.

    Raises:
        InputError: the rows do not make such a table.
    """
    used = [(index, row) for index, row in enumerate(rows) if any(cell is not None for cell in row)]
    widths = Counter(len(row) for _, row in used)
    width = widths.most_common(1)[0][0] if widths else 0
    good_rows = [(index, row) for index, row in used if len(row) == width]
    numeric = sum(_mostly_numbers(row) for _, row in good_rows)
    if [len(row) for _, row in used[:4]] == [1, 2, 3, 1]:
        raise InputError(
            "looks like Bischoff and Ratcliff's orders (thpack): types of boxes with quantities, and no places: "
            "pack them first with petmjx samples --orders"
        )
    if width < 6 or numeric < 0.8 * max(len(good_rows), 1):
        raise NoBoxes("has no header with known names of columns")
    bad_rows = [
        (f"row {index + begin}", f"has {len(row)} fields instead of {width}")
        for index, row in used
        if len(row) != width
    ]
    body = [row for _, row in good_rows]
    return RawTable(
        tuple(f"column {number}" for number in range(1, width + 1)),
        body,
        [f"row {index + begin}" for index, _ in good_rows],
        decimal_of(body),
        title,
        lost=(*lost, *bad_rows),
        notes=("there is no header",),
        has_header=False,
    )
