"""Tables that fit into the terminal, and how their values are formatted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final, Literal

import pandas as pd
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from petmjx.common.text import printable, three_digits
from petmjx.engines.verdict import Verdict

Row = Mapping[Any, Any]
"""A row of a data frame: name of a column → value."""

Cell = Callable[[Any], str | Text]
"""A function that makes a cell of a table from a row."""

VERDICT_STYLES: Final = {Verdict.STABLE: "green", Verdict.UNSTABLE: "red", Verdict.INVALID: "yellow"}

SHOWN_SKIPPED: Final = 10
"""Largest number of skipped plans that are shown. The files of a run or of criteria list all skipped plans."""

FEW_ROWS: Final = 40
"""Largest number of rows of a table in which each row is about one world, search, plan or box. If there are more
worlds, searches or plans, the table is not shown. Tables of loads show their first rows instead."""


@dataclass(frozen=True)
class TableColumn:
    """A column of a :class:`FittedTable`.

    Attributes:
        header: heading, which may have several lines.
        cell: function that makes the column's cell in a row. Characters of strings that cannot be printed are replaced.
            A ``Text`` keeps its style.
        justify: alignment of the column's cells.
        least: number of characters to which texts may be shortened. If ``least`` is None, texts are never shortened.
        middle: whether texts are shortened in the middle, which suits names that differ at their ends. If ``middle`` is
            False, texts are shortened at the end.
        spare: rank for leaving out the column if the table is too wide: the column with the largest number is left out
            first. A column whose ``spare`` is 0 is never left out.
    """

    header: str
    cell: Cell
    justify: Literal["left", "right"] = "right"
    least: int | None = None
    middle: bool = False
    spare: int = 0


def name_column(header: str, column: str, least: int) -> TableColumn:
    """A table column that shows the names in the rows' column ``column``. Names that are too long are shortened in the
    middle, to not fewer than ``least`` characters."""
    return TableColumn(header, text_of(column), "left", least, middle=True)


class FittedTable:
    """A table without lines between its cells that is never wider than the terminal.

    If the terminal is too narrow, texts are shortened first. If the table is then still too wide, columns are left out
    (see ``TableColumn.spare``), and a line below the table names them. Numbers are shortened only if even the remaining
    columns do not fit.

    Args:
        rows: the rows, which ``TableColumn.cell`` accepts.
        title: line above the table.
        caption: line below the table.
    """

    def __init__(self, rows: Iterable[Any], *columns: TableColumn, title: str = "", caption: str = "") -> None:
        self.columns = columns
        self.title = title
        self.caption = caption
        self._rows = [[_printable_cell(column.cell(row)) for column in columns] for row in rows]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = _column_widths(
            self.columns, [self._natural(number) for number in range(len(self.columns))], options.max_width
        )
        table = Table(box=None, padding=(0, 1), pad_edge=False, collapse_padding=True)
        for number, width in widths.items():
            column = self.columns[number]
            table.add_column(column.header, justify=column.justify, width=width, no_wrap=True)
        for row in self._rows:
            table.add_row(
                *(_shortened_cell(row[number], width, self.columns[number]) for number, width in widths.items())
            )
        if self.title:
            yield line(self.title, style="italic")
        yield table
        missing = [c.header.replace("\n", " ") for number, c in enumerate(self.columns) if number not in widths]
        if missing:
            yield line(f"left out at this width: {', '.join(missing)}", style="dim")
        if self.caption:
            yield line(self.caption, style="dim")

    def _natural(self, number: int) -> int:
        """The width that a column needs to show all its cells in full."""
        texts = [*self.columns[number].header.split("\n"), *(str(row[number]) for row in self._rows)]
        return max(cell_len(text) for text in texts)


def _printable_cell(cell: str | Text) -> str | Text:
    return cell if isinstance(cell, Text) else printable(cell)


def _column_widths(columns: Sequence[TableColumn], natural: Sequence[int], width: int) -> dict[int, int]:
    """Index of each column that is not left out → its width. Remaining space goes to the narrowest columns whose texts
    are shortened."""
    least = [min(n, n if column.least is None else column.least) for column, n in zip(columns, natural, strict=True)]
    shown_columns = list(range(len(columns)))

    def room() -> int:
        return width - sum(least[number] for number in shown_columns) - (len(shown_columns) - 1)

    for number in sorted(shown_columns, key=lambda n: -columns[n].spare):
        if room() < 0 and columns[number].spare:
            shown_columns.remove(number)
    widths = {number: least[number] for number in shown_columns}
    for _ in range(room()):
        short = [number for number in shown_columns if widths[number] < natural[number]]
        if not short:
            break
        widths[min(short, key=lambda number: widths[number])] += 1
    return widths


def _shortened_cell(cell: str | Text, width: int, column: TableColumn) -> Text:
    text = cell if isinstance(cell, Text) else Text(cell)
    if column.least is None or cell_len(text.plain) <= width:
        return text
    tail = Text("")
    if column.middle:
        tail = text[len(text) - _fits(reversed(text.plain), (width - 1) // 2) :]
    head = text[: _fits(text.plain, width - 1 - cell_len(tail.plain))]
    return Text.assemble(head, "…", tail)


def _fits(text: Iterable[str], width: int) -> int:
    """Number of characters at the beginning of a text that fit into a width. Chinese characters, for example, take two
    columns of the terminal."""
    return sum(used <= width for used in accumulate(map(cell_len, text)))


def line(text: str, style: str = "") -> Text:
    """A line of text, or a text for a cell. A text that is wider than the terminal or the cell is wrapped."""
    return Text(printable(text), style=style, overflow="fold")


def note_lines(notes: Iterable[object], kind: str = "note") -> Iterator[Text]:
    """A line for each note, such as "note: no plan is compared"."""
    for note in notes:
        yield line(f"{kind}: {note}", style="yellow")


def skipped_lines(reasons: Sequence[object], count: int, where: str = "", kind: str = "skipped") -> Iterator[Text]:
    """A line for each of the first ``SHOWN_SKIPPED`` reasons, and a line with the number of all others. ``count`` is
    the number of all reasons, of which ``reasons`` may have only the first."""
    yield from note_lines(reasons[:SHOWN_SKIPPED], kind)
    if count > SHOWN_SKIPPED:
        yield line(f"{kind}: {count - SHOWN_SKIPPED:,} more{where}", style="yellow")


def number(value: Any, form: str | None = None, unit: str = "", factor: float = 1.0, sign: bool = False) -> str:
    """Text of a number multiplied by ``factor``, with its unit; "-" if there is no number.

    Args:
        value: the number, or None or NaN.
        form: format specification. If ``form`` is None, the number has three digits (``three_digits``).
        unit: text after the number.
        sign: whether positive numbers also get a sign; used only if ``form`` is None.
    """
    if pd.isna(value):
        return "-"
    scaled = factor * float(value)
    return (three_digits(scaled, sign) if form is None else format(scaled, form)) + unit


def percent(share: Any) -> str:
    """A share as text, such as "12.3 %"; "-" if there is no share."""
    return number(share, ".1f", " %", 100.0)


def interval(low: Any, high: Any) -> str:
    """An interval of shares as text, such as "25.6 % to 61.1 %"; "" if there is no interval."""
    return "" if pd.isna(low) else f"{percent(low)} to {percent(high)}"


def text_of(column: str) -> Cell:
    """A function that makes a cell from a row: the value in the given column, as text."""
    return lambda row: str(row[column])


def count_of(column: str) -> Cell:
    """A function that makes a cell from a row: the whole number in the given column; 0 for NaN (no worlds)."""
    return lambda row: "0" if pd.isna(row[column]) else f"{int(row[column]):,}"


def number_of(column: str, form: str | None = None, unit: str = "", factor: float = 1.0) -> Cell:
    """A function that makes a cell from a row: the number in the given column, as :func:`number` formats it."""
    return lambda row: number(row[column], form, unit, factor)


def percent_of(column: str) -> Cell:
    """A function that makes a cell from a row: the share in the given column, in per cent."""
    return lambda row: percent(row[column])


def interval_cell(row: Row) -> str:
    """A table cell with an interval of shares, whose bounds are in the columns ``low`` and ``high`` of ``row``."""
    return interval(row["low"], row["high"])
