"""Raw tables (``RawTable``): rows of text files and sheets with their column names, before anything is interpreted.
Lists of boxes (``BoxList``): raw tables with information from the objects around them in the file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text
from petmjx.plans.cell_numbers import NO_WORDS, YES_WORDS, cell_text
from petmjx.plans.column_names import PLACE_KINDS, SIZE_KINDS, ColumnMeaning, column_meanings, known_meanings

MOST_ROWS: Final = 1_000_000
"""Largest number of rows of a table, the same as in a sheet. As Python values, a table of a million boxes takes a
gigabyte."""
MOST_COLUMNS: Final = 1_000


@dataclass(frozen=True, eq=False)
class RawTable:
    """A table with its cells as they are in a file, before anything is interpreted.

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

    def cells(self, index: int) -> list[Any]:
        """The cells of the column with an index."""
        return [row[index] for row in self.rows]

    def column(self, name: str) -> list[Any]:
        """The cells of the column with a name."""
        return self.cells(self.header.index(name))


def united(tables: Sequence[RawTable]) -> RawTable:
    """One table with the rows of several tables. A column that one of the tables lacks is empty in the rows of that
    table."""
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
    decimals = {table.decimal for table in tables} - {"."}
    return replace(
        first,
        header=header,
        rows=rows,
        places=[place for table in tables for place in table.places],
        lost=tuple(entry for table in tables for entry in table.lost),
        notes=tuple(dict.fromkeys(note for table in tables for note in table.notes)),
        decimal="," if "," in decimals else next(iter(decimals), "."),
    )


def with_names_of(table: RawTable, first: RawTable) -> RawTable:
    """The table, after columns have got the names that another table uses ("Pos. X [mm]" → "X [mm]"). A column is
    renamed if its name has a known meaning, and if exactly one column of each table has this meaning.

    Args:
        first: the other table.
    """
    meanings, others = (
        [meaning and replace(meaning, letter=False) for meaning in column_meanings(header)]
        for header in (table.header, first.header)
    )
    names = {
        meaning: first.header[others.index(meaning)]
        for meaning in meanings
        if meaning is not None and meanings.count(meaning) == others.count(meaning) == 1
    }
    header = tuple(
        name if meaning is None else names.get(meaning, name)
        for name, meaning in zip(table.header, meanings, strict=True)
    )
    return replace(table, header=header) if len(set(header)) == len(header) else table


def with_titles(tables: Sequence[RawTable]) -> Sequence[RawTable]:
    """Tables whose places begin with the title of the table: "row 5" → "Sheet 1, row 5". If all tables have the same
    title, the places are not changed."""
    if len({table.title for table in tables}) == 1:
        return tables
    return [replace(table, places=[f"{table.title}, {place}" for place in table.places]) for table in tables]


def row_number(place: str, otherwise: int) -> int:
    """The last number in the place of a row: "row 5" → 5. The result is ``otherwise`` if the place has no number, or a
    number of more than nine digits."""
    match = re.search(r"(\d+)\D*$", place)
    return int(match[1]) if match is not None and len(match[1]) < 10 else otherwise


def names_with_lost_rows(table: RawTable, names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Name of each plan (or order) that lacks a row → (place, fault) of the first missing row.

    An unreadable row may belong to the plan before or after it, so both plans count as plans that lack a row.

    Args:
        names: for each row of the table, the name of its plan.
    """
    numbers = [row_number(place, row) for row, place in enumerate(table.places)]
    names_with_lost: dict[str, tuple[str, str]] = {}
    for place, fault in table.lost:
        number = row_number(place, 0)
        before = max((row for row in range(len(numbers)) if numbers[row] < number), default=0)
        after = min((row for row in range(len(numbers)) if numbers[row] > number), default=len(names) - 1)
        for row in (before, after):
            names_with_lost.setdefault(names[row], (place, fault))
    return names_with_lost


def rows_by_name(names: Sequence[str]) -> dict[str, NDArray[np.int64]]:
    """Name → numbers of the rows that have this name."""
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
    return {name: np.array(some, np.int64) for name, some in rows.items()}


@dataclass(frozen=True, eq=False)
class BoxList:
    """A list of boxes as a raw table, with information from the objects around it.

    Attributes:
        table: the boxes.
        path: path of the list in the file, with [] after each list on the path: "containers[].stack.placements[]".
        parts: (n,) for each row, the name of its plan; "" if the plan has no name. If ``parts`` is left out, no plan
            has a name.
        containers: name of a plan → axis (as in ``ColumnMeaning``) → size of the plan's container, in the file's unit.
        left_out: lines about boxes that are not placed.
        around: fields of the objects that contain the first box of the list.
    """

    table: RawTable
    path: str = ""
    parts: tuple[str, ...] = ()
    containers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    around: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Give each row a plan without a name if ``parts`` is left out."""
        if not self.parts:
            object.__setattr__(self, "parts", ("",) * len(self.table.rows))

    @property
    def meanings(self) -> list[ColumnMeaning | None]:
        return column_meanings(self.table.header)

    @property
    def kinds(self) -> set[str]:
        return {meaning.kind for meaning in known_meanings(self.table.header).values() if not meaning.of_container}

    @property
    def has_places(self) -> bool:
        """Whether the boxes have coordinates."""
        return bool(self.kinds & PLACE_KINDS)

    @property
    def has_sizes(self) -> bool:
        """Whether the boxes have sizes."""
        return bool(self.kinds & SIZE_KINDS)


_PLACED_FLAGS: Final = frozenset(("packed", "placed", "fitted", "fit", "is_packed", "is_placed", "loaded", "success"))
"""Names of fields and columns, in lower case, that tell whether a box is placed."""


def flags_unplaced(fields: Iterable[tuple[str, Any]]) -> bool:
    """Whether a flag among the fields of a box, such as "placed: no", tells that the box is not placed.

    Args:
        fields: names and values of the fields.
    """
    return any(name.lower() in _PLACED_FLAGS and cell_text(value).lower() in NO_WORDS for name, value in fields)


def rows_with_boxes(table: RawTable) -> list[int]:
    """Numbers of the rows whose boxes are placed, according to columns such as "packed" (``_PLACED_FLAGS``). A column
    counts only if all its texts mean yes or no."""
    flags = [
        (name, table.column(name))
        for name in table.header
        if name.lower() in _PLACED_FLAGS
        and {cell_text(cell).lower() for cell in table.column(name)} <= YES_WORDS | NO_WORDS | {""}
    ]
    return [row for row in range(len(table.rows)) if not flags_unplaced((name, cells[row]) for name, cells in flags)]


def not_placed(count: int) -> tuple[str, ...]:
    """A line about boxes that a file lists, but that its plans do not place; empty if there are none."""
    return (f"{count_text(count, 'box is', 'boxes are')} not placed, and left out",) if count else ()
