"""Recognises headers and rows of totals in raw tables. The module also adds units and merged headings to the names in a
header: units from the line below the header, merged headings from the line above. Repeated names are made distinct."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.plans.cell_numbers import cell_number, cell_text, is_number
from petmjx.plans.column_names import (
    OWN_COLUMNS,
    PLACE_KINDS,
    SIZE_KINDS,
    column_meanings,
    is_unit,
    known_meanings,
    plain_text,
    split_unit,
)
from petmjx.plans.raw_tables import MOST_COLUMNS, RawTable

SEARCHED_ROWS: Final = 60
"""Number of rows at the beginning of a table in which the header is searched for."""
LEAST_KNOWN: Final = 2
"""A row counts as a header only if at least this number of its cells are known names."""


_NUMERIC: Final = re.compile(r"\s*[+-]?[.,]?\d|.*=\s*[+-]?[.,]?\d")
"""A cell that is no name of a column: a number, or a name with its value, "X=1200"."""


def count_known_names(cells: Sequence[Any]) -> int:
    """The number of cells in a row that are known column names."""
    names = [cell if isinstance(cell, str) and len(cell) < 100 and not _NUMERIC.match(cell) else "" for cell in cells]
    if sum(map(bool, names)) < LEAST_KNOWN or len(names) > MOST_COLUMNS:
        return 0
    return _n_distinct(names)


_LEAST_IN_ROWS: Final = 6
"""In a transposed table, each row is a field and each further column is a box. A table counts as transposed under two
conditions. First, at least this number of cells in its first column are known column names. Second, every row has fewer
known column names than the first column."""


def names_in_rows(rows: Sequence[tuple[Any, ...]]) -> bool:
    """Whether a table is transposed: the names of fields are in the first column, and each other column is a box."""
    n_known = count_known_names([row[0] if row else None for row in rows[:MOST_COLUMNS]])
    return n_known >= _LEAST_IN_ROWS and n_known > max(map(count_known_names, rows[:SEARCHED_ROWS]))


def header_rows(rows: Sequence[tuple[Any, ...]]) -> list[int]:
    """Indices of the rows that are headers: the first row that has the most known names, and its repetitions."""
    counts = [count_known_names(row) for row in rows[:SEARCHED_ROWS]]
    most = max(counts, default=0)
    if most < LEAST_KNOWN:
        first = next((index for index, row in enumerate(rows) if any(cell is not None for cell in row)), None)
        return [] if first is None or not _heads_numbers(rows, first) else [first]
    head = counts.index(most)
    if head + 1 < len(rows) and _completes(rows[head + 1]):
        head += 1
    header = rows[head]
    return [index for index in range(head, len(rows)) if index == head or rows[index] == header]


def _completes(row: Sequence[Any]) -> bool:
    """Whether the row below a header is its second line, such as L, W, H, X, Y, Z below "Dimensions" and "Position". A
    second line has no number, and at least three names of sizes or places."""
    names = [cell if isinstance(cell, str) else "" for cell in row]
    return len(geometric_columns(names)) >= _LEAST_BELOW and not any(map(is_number, row))


_LEAST_BELOW: Final = 3
"""The row below a header is its second line only if it has at least this number of names of sizes or places."""


def _heads_numbers(rows: Sequence[tuple[Any, ...]], head: int) -> bool:
    """Whether a row is a header with unknown names: it is only text, and the rows below have enough numbers for
    boxes."""
    names = rows[head]
    texts = [cell for cell in names if isinstance(cell, str) and not _NUMERIC.match(cell)]
    below = [row for row in rows[head + 1 : head + 20] if any(cell is not None for cell in row)]
    alike = all(len(row) == len(names) for row in below)
    return len(set(texts)) == len(names) >= 6 and bool(below) and alike and are_numbers(below, 6)


def are_numbers(rows: Sequence[Sequence[Any]], least: int) -> bool:
    """Whether more than half of the first 20 rows have at least ``least`` cells that are numbers."""
    first = rows[:20]
    counts = [sum(map(is_number, row)) for row in first]
    return sum(count >= least for count in counts) * 2 > len(first)


def geometric_names(header: Sequence[str]) -> tuple[str, ...]:
    """The names of the columns that have sizes or places, sorted. If no column has sizes or places, the names of all
    columns are returned."""
    return tuple(sorted(header[index] for index in geometric_columns(header))) or tuple(header)


def geometric_columns(header: Sequence[str]) -> list[int]:
    """Indices of the columns that have sizes or places."""
    return [
        index
        for index, meaning in enumerate(column_meanings(header))
        if meaning is not None and meaning.kind in PLACE_KINDS | SIZE_KINDS
    ]


def has_places(names: Sequence[str]) -> bool:
    return any(meaning.kind in PLACE_KINDS for meaning in known_meanings(names).values())


def with_groups(names: list[str], group: Sequence[Any]) -> list[str]:
    """Names that include merged headings in the line above: "Position" above X, Y, Z gives "Position X"."""
    heading, joined = "", []
    cells = [
        cell_text(group[index]) if index < len(group) and group[index] is not None else ""
        for index in range(len(names))
    ]
    # If a merged cell spans both lines of the header, its name is in the upper line, and the lower cell is empty.
    names = [name or cell for name, cell in zip(names, cells, strict=True)]
    for name, cell in zip(names, cells, strict=True):
        heading = cell or heading
        joined.append(f"{heading} {name}".strip() if heading and name and name != cell else name)
    with_units = []  # as ``joined``, but a name with a known meaning gets only the unit of the heading above it
    for long, name, meaning in zip(joined, names, column_meanings(names), strict=True):
        unit = split_unit(long.removesuffix(name).strip())[1]
        with_unit = f"{name} [{unit}]" if unit and not names_unit(name) else name
        is_known = meaning is not None or column_meanings([long])[0] is None
        with_units.append(with_unit if is_known else long)
    # of lists with equally many different meanings, ``max`` returns the first
    return max(with_units, joined, names, key=_n_distinct)


def _n_distinct(names: Sequence[str]) -> int:
    return len({(meaning.kind, meaning.axis) for meaning in known_meanings(names).values()})


_NO_MEASURE: Final = ("", "-", "#", "–", "°", "deg", "grad", "st", "pcs", "stk", "szt", "ud", "qty")
"""Units of angles and of numbers, and signs for no unit."""


def is_unit_cell(cell: Any) -> bool:
    return isinstance(cell, str) and (is_unit(cell) or plain_text(cell).strip(" []().").lower() in _NO_MEASURE)


def names_unit(name: str) -> bool:
    return any(meaning.unit for meaning in known_meanings([name]).values())


def distinct_names(names: Sequence[str]) -> list[str]:
    """The names, made distinct: an unknown name that was used before becomes, for example, "Note again". An empty name
    becomes, for example, "column 3".

    Raises:
        InputError: a known name occurs twice.
    """
    name_counts: Counter[str] = Counter()
    distinct = []
    for number, name in enumerate(names, start=1):
        name = name or f"column {number}"
        name_counts[name] += 1
        if name_counts[name] == 2 and known_meanings([name]):
            raise InputError(f"column {printable_name(name)} occurs twice")
        distinct.append(name if name_counts[name] == 1 else f"{name} again")
    return distinct


# Totals, sums and means.


def is_total(row: Sequence[Any], geometric: Sequence[int]) -> bool:
    """Whether a row is a total or a mean. The first text of such a row must be a word for a total or a mean. If the
    text only begins with such a word, the row may also be a box called "Total fruit". Then the row counts as a total
    only if it lacks all sizes and places, since a single cell of a box may be lost."""
    text = next((cell for cell in row if isinstance(cell, str) and not is_number(cell)), "")
    plain = plain_text(text).strip()
    if not _TOTAL.match(plain):
        return False
    if _ONLY_TOTAL.match(plain):
        return True
    return all(index >= len(row) or row[index] is None for index in geometric)


def computed_row(table: RawTable, rows: Sequence[int]) -> str:
    """How the last row relates to the rows above it: "the total", "the sums" or "the means"; "" if the row is a box.

    Args:
        rows: indices of the rows of one plan.

    The sizes, places and weights of the last row must all be sums, or all be means. At least two numbers of the row
    must clearly be sums or means. A single sum or mean is not enough. A box on two smaller boxes may have the sum of
    their lengths, and a box in the middle of a layer of equal boxes has their mean place. But a single sum is enough if
    the last row has no sizes and no places. The last row is never taken for a row of means if the table has petmjx's
    own column names and no places, because it is more likely a medium-sized box. The same holds if all rows have
    articles.
    """
    if len(rows) > 1 and is_total(table.rows[rows[-1]], geometric_columns(table.header)):
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
            if last[index] is not None and kind not in ("sequence", "number"):
                return ""
            continue
        above = [cell_number(table.rows[row][index], table.decimal) for row in rows[:-1]]
        values = np.array([cell.value for cell in above if cell is not None])
        if len(values) < len(rows) - 1 or not np.isfinite(values).all():
            return ""
        total, mean = float(values.sum()), float(values.mean())
        # In a row of sums, the cells in columns of packing orders and running numbers may have any value. So these
        # columns are not tested.
        if kind not in ("sequence", "number"):
            sums &= _as_written(number.value, total)
            n_sums += total != 0.0
        means &= _as_written(number.value, mean)
        varies = bool(np.ptp(values) > 0.0)
        n_means += varies
        n_goods += varies and kind not in _PLACES
        if not sums and not means:
            return ""
    has_geometry = any(last[index] is not None for index in geometric_columns(table.header))
    return "the sums" if sums and n_sums > has_geometry else "the means" if means and n_means > 1 and n_goods else ""


def _names_box(articles: Iterable[Any]) -> bool:
    """Whether all cells of a column of articles have text, and the last cell is not a symbol for a mean (ø, or o or x
    in place of ø). The last cell belongs to the row that may be a row of means instead of a box."""
    texts = [plain_text(cell).strip() if isinstance(cell, str) else "" for cell in articles]
    return all(texts) and texts[-1].lower() not in ("ø", "o", "x")


_PLACES: Final = ("position", "low", "high")
_COMPUTED: Final = ("size", "weight", "volume", "sequence", "number", *_PLACES)
"""Kinds of columns whose sums and means show that a row is not a box."""


def _as_written(value: float, exact: float) -> bool:
    """Whether the number in a cell equals an exact number that is rounded to the cell's decimals."""
    decimals = next((count for count in range(7) if round(value, count) == value), 6)
    return abs(value - exact) <= 0.5000001 * 10.0**-decimals + 1e-9 * abs(exact)


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
"""A word for a total or a mean, with no other word after it: "Summe:", "Total (26)", "Total 12 kg"."""
