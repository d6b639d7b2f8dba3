"""Divides rows of cells into raw tables (``tables_of_rows``): headers, the rows below them, sections with titles, and
totals, which are left out."""

from __future__ import annotations

import operator
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress, zip_longest
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.plans.cell_numbers import cell_text, decimal_of, is_number
from petmjx.plans.column_names import TITLE_WORDS, names_unplaced, plain_text, word_set, words_of
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.header_and_total_rows import (
    count_known_names,
    distinct_names,
    geometric_columns,
    has_places,
    header_rows,
    is_total,
    is_unit_cell,
    names_in_rows,
    names_unit,
    with_groups,
)
from petmjx.plans.nested_containers import LAYERS, STACKS
from petmjx.plans.raw_tables import RawTable, not_placed


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
    if names_in_rows(cleaned):
        return [
            replace(
                table,
                places=[place.replace("row", "column") for place in table.places],
                lost=(*lost, *table.lost),
                notes=(*table.notes, "the first column has the names, so each further column is read as a row"),
            )
            for table in tables_of_rows(list(zip_longest(*cleaned)), 1, title)
        ]
    heads = header_rows(cleaned)
    if not heads:
        return [_without_header(cleaned, begin, title, tuple(lost))]
    tables: list[RawTable] = []
    above = [text for row in cleaned[: heads[0]] if (text := _line(row))]
    for number, head in enumerate(heads):
        end = heads[number + 1] if number + 1 < len(heads) else len(cleaned)
        below, above = _table_below(cleaned, head, end, begin, title, tuple(above), number < len(heads) - 1)
        tables += below
    tables[0] = replace(tables[0], lost=(*lost, *tables[0].lost))
    if len(heads) > 1:
        parts: list[str] = []
        of_report = tables[0].above[:-1]  # each page may begin with these lines, so they are not titles of tables
        for number, table in enumerate(tables, start=1):
            titles = [line for line in table.above if line not in of_report]
            continued = parts[-1] if parts and tables[0].above else f"{number}"
            parts.append(table.part or (_without_continued(titles[-1]) if titles else continued))
        tables = [replace(table, part=part) for table, part in zip(tables, parts, strict=True)]
    return [table for table in tables if table.rows or table.lost] or tables[:1]


_CONTINUED: Final = re.compile(
    r"\s*(?:[(\[]\s*{0}\s*[)\]]|[-–—,:]\s*{0})\s*$".format(
        r"(?:continued|continuation|cont(?:['’]?d)?\.?|fortsetzung|forts\.|suite|continuaci[oó]n|segue|seguito|vervolg)"
    ),
    re.IGNORECASE,
)
"""The end of a title on a further page: "Pallet 2 (continued)"."""


def _without_continued(title: str) -> str:
    return _CONTINUED.sub("", title) or title


def _cleaned(cell: Any) -> Any:
    if isinstance(cell, str):
        cell = cell.strip().strip("\ufeff")
        return cell or None
    if isinstance(cell, float) and np.isnan(cell):
        return None
    return cell


def _line(row: Sequence[Any]) -> str:
    return " ".join(cell_text(cell) for cell in row if cell is not None)


def _table_below(
    rows: Sequence[tuple[Any, ...]], head: int, end: int, begin: int, title: str, above: tuple[str, ...], more: bool
) -> tuple[list[RawTable], list[str]]:
    """The tables below a header, one for each named section. The function also returns the remaining lines, from the
    next header on."""
    names = [cell_text(cell) for cell in rows[head]]
    while names and not names[-1]:
        names.pop()
    notes = [f"the header is row {head + begin}"] if head else []
    group = rows[head - 1] if head else ()
    filled = sum(cell is not None for cell in group)
    first_cell = cell_text(group[0]) if filled and group[0] is not None else ""
    if _COMMENT.match(first_cell) or (filled == 1 and first_cell and not geometric_columns([first_cell])):
        filled = 0  # a title or a comment above the table, not a heading of its columns
    if (filled >= 1 and count_known_names(rows[head]) < len(names)) or (filled > 1 and not has_places(names)):
        names = with_groups([*names, *_unnamed_below(rows, head, len(names))], group)
    first = head + 1
    below = next((index for index in range(first, end) if any(rows[index])), end)
    if below < end and all(cell is None or is_unit_cell(cell) for cell in rows[below]):
        names = [
            f"{name} [{cell_text(cell).strip('[]() ')}]" if cell is not None and not names_unit(name) else name
            for name, cell in zip(names, (*rows[below], *([None] * len(names))), strict=False)
        ]
        first = below + 1
    header = tuple(distinct_names(names))
    sections, lost, trailing = _sections(rows, first, end, begin, header, above, notes)
    if trailing and not more:
        notes.append(f"rows below the table are left out, beginning with {printable_name(trailing[0])}")
    names_of = dict.fromkeys(name for name, _ in sections)
    tables = []
    decimal = decimal_of([row for _, section in sections for row, _ in section])
    for number, part in enumerate(names_of, start=1):
        body = [row for name, section in sections if name == part for row, _ in section]
        places = [place for name, section in sections if name == part for _, place in section]
        label = (part or (above[-1] if above else "1")) if len(names_of) > 1 else ""
        own_lost = lost if number == 1 else ()
        tables.append(RawTable(header, body, places, decimal, title, above, own_lost, tuple(notes), part=label))
    return tables or [RawTable(header, [], [], ".", title, above, lost, tuple(notes))], trailing if more else []


_COMMENT: Final = re.compile(r"(?:#|//)\s*\w+\s+\w")
"""The beginning of a comment of at least two words, as in programs."""


def _unnamed_below(rows: Sequence[tuple[Any, ...]], head: int, width: int) -> list[str]:
    """An empty name for each column that has a name only in the upper line of a two-line header. ``head`` is the number
    of the lower line, which has ``width`` names. Only those columns count that follow the last name of the lower line,
    and that have values in the row below the lower line."""
    group, below = rows[head - 1], rows[head + 1] if head + 1 < len(rows) else ()
    count = 0
    while width + count < min(len(group), len(below)) and group[width + count] and below[width + count] is not None:
        count += 1
    return [""] * count


_Section = tuple[str, list[tuple[tuple[Any, ...], str]]]
"""A section: its name, from the line before it ("" if it has none), and its rows, each with its place, such as "row
7"."""


def _sections(
    rows: Sequence[tuple[Any, ...]],
    first: int,
    end: int,
    begin: int,
    header: Sequence[str],
    above: Sequence[str],
    notes: list[str],
) -> tuple[list[_Section], tuple[tuple[str, str], ...], list[str]]:
    """The rows of a table by section; the rows that cannot be read, each as (place, reason); and the lines after the
    last row."""
    width, geometric = len(header), geometric_columns(header)
    names_pallets = [index for index, name in enumerate(header) if TITLE_WORDS.intersection(words_of(name))]
    sections: list[_Section] = [("", [])]
    lost: list[tuple[str, str]] = []
    trailing: list[tuple[str, str]] = []
    short_titles: dict[str, str] = {}
    remarks: list[tuple[str, str]] = []
    has_long_names = False
    is_unplaced, n_unplaced = False, 0
    for index in range(first, end):
        row, place = rows[index], f"row {index + begin}"
        filled = [cell for cell in row if cell is not None]
        if not filled:
            continue
        if is_total(row, geometric):
            notes.append(f"{place} is a total, and left out")
            continue
        line, is_alone = _line(row), len(filled) == 1
        if is_alone and row[0] is not None and _are_none_unplaced(line):
            notes += _remark_notes([(line, place)])
            continue
        if is_alone and _has_other_separator(filled[0], width):
            lost.append((place, f"has 1 field instead of {width}: another separator?"))
            continue
        is_remark = _is_remark(line, row, geometric)
        is_text = is_alone and width > 2 and isinstance(filled[0], str) and not (is_number(filled[0]) or is_remark)
        if is_text or _is_title(line, row, geometric, names_pallets):
            if not is_text:
                short_titles[line] = _short_title(filled)
            trailing.append((line, place))
            is_unplaced = row[0] is not None and are_unplaced(line)
            continue
        if trailing and is_unplaced:
            n_unplaced += 1
            continue
        if is_remark:
            remarks.append((line, place))
            continue
        is_between = not trailing and any(body for _, body in sections)
        if is_between:  # a line with a name and a value may be a damaged box
            lost += _lost_lines(remarks)
        else:
            notes += _remark_notes(remarks)
        remarks = []
        used = len(row)
        while used > width and row[used - 1] is None:
            used -= 1
        if used != width and len(row) != width:
            lost.append((place, f"has {count_text(len(row), 'field')} instead of {width}"))
            continue
        if trailing:
            title, where = _without_continued(trailing[-1][0]), trailing[-1][1]
            first_title = next((name for name, body in sections if body), None)
            if first_title is None or title in short_titles or begins_section(title, first_title, above):
                sections.append((title, []))
                if first_title == "" or (first_title and not names_part(title)):
                    notes.append(f"{where} is a title: {printable_name(title)}")
                if first_title is not None:
                    notes += _remark_notes([entry for entry in trailing[:-1] if not names_part(entry[0])])
            else:  # a line of one word may be the name of a box whose other cells are lost
                are_remarks = [not has_long_names and len(line.split()) > 1 for line, _ in trailing]
                notes += _remark_notes([*compress(trailing, are_remarks)])
                lost += _lost_lines([*compress(trailing, map(operator.not_, are_remarks))])
            trailing = []
        has_long_names |= len(cell_text(row[0]).split()) > 1
        sections[-1][1].append((tuple(row[:width]), place))
    notes += [*_remark_notes(remarks), *not_placed(n_unplaced)]
    if len(set(short_titles.values())) == len(short_titles):
        sections = [(short_titles.get(name, name), body) for name, body in sections]
    return [section for section in sections if section[1]], tuple(lost), [line for line, _ in trailing]


def _has_other_separator(cell: Any, width: int) -> bool:
    """Whether a cell has all fields of a row, divided by another separator than the table's."""
    rows = [cell.split(mark) for mark in ",;\t|"] if isinstance(cell, str) and width > 2 else []
    return any(len(fields) >= width and 2 * sum(map(is_number, fields)) > width for fields in rows)


_PART_WORDS: Final = TITLE_WORDS | LAYERS | STACKS


def names_part(title: str) -> bool:
    """Whether a title has a word for pallets, orders, layers or stacks."""
    return bool(_PART_WORDS.intersection(words_of(title)))


def part_role(title: str) -> str:
    """What a title with a word for pallets, orders, layers or stacks names: "plan", or "layer" for layers and
    stacks."""
    return "plan" if TITLE_WORDS.intersection(words_of(title)) - STACKS else "layer"


def begins_section(title: str, first: str, above: Sequence[str] = ()) -> bool:
    """Whether a line between boxes is the title of the boxes below it, and no remark. A title must be like the title of
    the first boxes below the header. If these boxes have no title, the line must have a number or letter, and a word
    for pallets, orders, layers or stacks.

    Args:
        first: the title of the first boxes; "": they have none.
        above: the lines above the header. The last of these lines is the title of the first boxes if it shares a word
            with the line between boxes.
    """
    words = {word for word in words_of(title) if not word.isdecimal()}
    if not first and above and words.intersection(words_of(above[-1])):
        first = above[-1]
    if not first or (names_part(first) and not names_part(title)):
        return not first and names_part(title) and _is_numbered(title)
    return _is_numbered(title) or not _is_numbered(first)


def _is_numbered(title: str) -> bool:
    """Whether a title has a number or a letter, as "Pallet 2" and "Order B". "50 %" does not count as a number."""
    return re.search(r"\d(?![\d.,]*\s*%)|\b[A-Z]\b", title) is not None


_KEY_AND_VALUE: Final = re.compile(r"^[^\d:;]{3,60}:\s*[\d.,]+\s*\S{0,12}$")
"""A line such as "Cube utilization: 81.2 %" below a table."""


def _is_remark(line: str, row: Sequence[Any], geometric: Sequence[int]) -> bool:
    """Whether a row (as text: ``line``) consists of a name and a value, such as "Utilization: 81.2 %", and is no
    title."""
    is_pair = _KEY_AND_VALUE.match(line) is not None and not TITLE_WORDS.intersection(words_of(line))
    return is_pair and _n_numbers(row, geometric) * 2 < len(geometric)


def _remark_notes(remarks: Sequence[tuple[str, str]]) -> list[str]:
    return [f"{place} is a remark, and left out: {printable_name(line)}" for line, place in remarks]


def _lost_lines(lines: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    return [(place, f"is no box: {printable_name(line)}") for line, place in lines]


def _is_title(line: str, row: Sequence[Any], geometric: Sequence[int], pallet_columns: Sequence[int]) -> bool:
    """Whether a row of several cells (as text: ``line``) is the title of a section. There are two kinds of such rows. A
    row of the first kind has no number, and its words say only that boxes are not placed. A row of the second kind
    begins with a text that has a word for pallets or orders, and most sizes and places are missing.

    Args:
        pallet_columns: columns whose cells name pallets in every row, so that their cells are never titles.
    """
    if row[0] is not None and not any(map(is_number, row)) and are_unplaced(line):
        return True
    begin = next((index for index, cell in enumerate(row) if cell is not None), None)
    if begin is None or begin in pallet_columns or not isinstance(row[begin], str):
        return False
    return bool(TITLE_WORDS.intersection(words_of(row[begin]))) and _n_numbers(row, geometric) * 2 < len(geometric)


def are_unplaced(title: str) -> bool:
    """Whether the boxes below a title are not part of a plan. The title of such boxes says only that the boxes are not
    placed, as in "Unplaced items (3)". A title with further words, such as "Layer 2 (remaining)", is the title of boxes
    of the plan, and a pallet of leftovers is a plan."""
    words = [word for word in words_of(title) if not word.isdecimal()]
    others = [word for word in words if word not in _BOXES_OF_TITLES and not names_unplaced(word)]
    return names_unplaced(title) and not others


def _are_none_unplaced(title: str) -> bool:
    """Whether a text says that all boxes are placed, as in "Unplaced: none" and "0 boxes not placed"."""
    words = re.findall(r"\w+", title.lower()) or [""]
    is_none = words[-1] in _NONE or words[0] == "0"
    return is_none and are_unplaced(" ".join(word for word in words if word not in _NONE))


_NONE: Final = frozenset(("none", "0", "keine"))
_BOXES_OF_TITLES: Final = word_set(
    "box boxes item items article articles artikel carton cartons karton kartons kiste kisten packstuck packstucke "
    "packstuecke parcel parcels package packages piece pieces case cases product products colis caisse caisses caja "
    "cajas articulo articulos scatola scatole articolo articoli pudelko pudelka artykul artykuly list of the not "
    "placed packed"
)
"""Words for boxes, and further words that may stand in the title of a section of boxes that are not placed. Other words
of the title say that the boxes are not placed."""


def _n_numbers(row: Sequence[Any], geometric: Sequence[int]) -> int:
    """The number of sizes and places in a row that are numbers."""
    return sum(is_number(row[index]) for index in geometric if index < len(row))


def _short_title(cells: Sequence[Any]) -> str:
    """The name of a section: the first cell of its title. If this cell has only a word for pallets or orders, the
    second cell is added."""
    name = cell_text(cells[0]).rstrip(": ")
    return name if set(re.findall(r"\w+", plain_text(name).lower())) - TITLE_WORDS else f"{name} {cell_text(cells[1])}"


def _mostly_numbers(row: Sequence[Any]) -> bool:
    cells = [cell for cell in row if cell is not None]
    return sum(map(is_number, cells)) * 2 > len(cells)


def _without_header(
    rows: Sequence[tuple[Any, ...]], begin: int, title: str, lost: tuple[tuple[str, str], ...]
) -> RawTable:
    """Make a table from rows of numbers that have no column names. Other rows are refused."""
    used = [(index, row) for index, row in enumerate(rows) if any(cell is not None for cell in row)]
    widths = Counter(len(row) for _, row in used)
    width = widths.most_common(1)[0][0] if widths else 0
    good_rows = [(index, row) for index, row in used if len(row) == width]
    numeric = sum(_mostly_numbers(row) for _, row in good_rows)
    if [len(row) for _, row in used[:4]] == [1, 2, 3, 1]:
        raise InputError(
            "looks like Bischoff and Ratcliff's orders (thpack), which have types of boxes with quantities, but no "
            "places; pack them first with 'petmjx samples --orders'"
        )
    if width < 6 or numeric < 0.8 * max(len(good_rows), 1):
        raise NoBoxes("has no header with known names of columns")
    above = [(index, row) for index, row in used if index < good_rows[0][0] and _is_above_numbers(row)]
    bad_rows = [
        (f"row {index + begin}", f"has {count_text(len(row), 'field')} instead of {width}")
        for index, row in used
        if len(row) != width and (index, row) not in above
    ]
    body = [row for _, row in good_rows]
    return RawTable(
        tuple(f"column {number}" for number in range(1, width + 1)),
        body,
        [f"row {index + begin}" for index, _ in good_rows],
        decimal_of(body),
        title,
        tuple(_line(row) for _, row in above),
        lost=(*lost, *bad_rows),
        notes=("there is no header", *(f"row {index + begin} is no box: {_line(row)}" for index, row in above)),
        has_header=False,
    )


def _is_above_numbers(row: Sequence[Any]) -> bool:
    """Whether a row above rows of numbers is no box: it has only words, or three numbers, the sizes of the
    container."""
    cells = [cell for cell in row if cell is not None]
    return not any(map(is_number, cells)) or (len(cells) == 3 and all(map(is_number, cells)))
