"""Reads tables of placements from CSV files, Parquet files and data frames, within limits."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from petmjx.common.checked_records import reason
from petmjx.common.parquet_files import OversizedFile, open_for_arrow, read_within
from petmjx.common.text import count_text, is_text, printable_name
from petmjx.plans.file_formats import COMMA_NUMBER, is_utf8, other_encoding, separator_mark
from petmjx.plans.placement_table import NAMES, LostRow, Table, TableError, as_column, sorted_columns

_FIRST_LINE: Final = re.compile(rb"[^\r\n]*+")
_LINE_ENDS: Final = (b"\n", b"\r")
_DELIMITERS: Final = ",;\t"
_BLOCK_BYTES: Final = 1 << 22
"""Size of the blocks in which CSV is parsed, bytes. No row may be longer than a block."""
_MOST_LOST: Final = 100_000
"""Largest number of unreadable rows that are listed one by one."""


def parse_csv(data: bytearray, cut_off: bool = False) -> Table:
    """Read the table in a CSV text with a header. The separator is whichever of comma, semicolon and tab is most
    frequent in the text.

    If the separator is the semicolon, numbers may have a decimal comma. If one number has a decimal comma, no number
    may have a point.

    Args:
        data: UTF-8 text.
        cut_off: whether the text is known to end too early.

    Raises:
        TableError: the text is empty, has no usable header, or lacks a column. The error does not name the file.
    """
    header = _FIRST_LINE.match(data)[0]  # type: ignore[index]  # matches any text
    if not header.strip():
        raise TableError("the file is empty" if not data.strip() else "has no header with the names of the columns")
    if (mark := separator_mark(header)) is not None:
        raise TableError(mark)
    delimiter = max(_DELIMITERS, key=lambda mark: header.count(mark.encode()))
    try:
        names = next(csv.reader([header.decode("utf-8", "surrogateescape")], delimiter=delimiter), [])
    except csv.Error as error:
        raise TableError(f"not CSV: {reason(error)}") from error
    try:
        where, unread = sorted_columns(names)
    except TableError as error:
        for number, name in enumerate(names, start=1):
            if not is_text(name):  # the column whose name is not UTF-8 may be the missing one
                raise TableError(f"row 1, column {number}: the name is not UTF-8 text{other_encoding(name)}") from error
        raise
    if not data[len(header) :].strip():
        raise TableError("holds no plan", len(where), is_own=True)
    n_nul = len(data) - len(data.rstrip(b"\0")) if data.endswith(b"\0") else 0
    if n_nul:
        data, cut_off = data[:-n_nul], True
    reader = _CsvReader(delimiter, names, where["plan_id"])
    rows, numbers = reader.read(data)
    decimal = "," if delimiter == ";" and b"," in data and _has_decimal_commas(rows, where) else "."
    columns = {name: as_column(rows.column(index), True, decimal) for name, index in where.items()}
    lost = reader.lost
    last = max(numbers[-1:].tolist(), default=1)
    if lost and lost[-1].number > last and not data.endswith(_LINE_ENDS):
        # the text ends within a row, so the row's plan id may be incomplete as well
        lost, cut_off = lost[:-1], True
    if not cut_off:
        end_fault = ""
    elif n_nul:
        end_fault = f"the file ends in {count_text(n_nul, 'NUL byte')}; was this plan written whole?"
    else:
        end_fault = "the file ends inside this plan; truncated?"
    return Table(columns, unread, numbers, lost, end_fault)


def _has_decimal_commas(rows: pa.Table, where: Mapping[str, int]) -> bool:
    """Whether a table has a number with a decimal comma."""
    columns = (rows.column(index) for name, index in where.items() if name not in NAMES)
    return any(pc.any(pc.match_substring_regex(column, COMMA_NUMBER)).as_py() for column in columns)


class _CsvReader:
    """Reads the rows of one CSV text.

    Attributes:
        lost: rows with too few or too many fields, lines that are not UTF-8, and lines with an unclosed quotation mark.
    """

    def __init__(self, delimiter: str, names: list[str], plan_column: int) -> None:
        self.lost: list[LostRow] = []
        self._lost_numbers: list[int] = []
        """The numbers (positions) of the rows that Arrow could not use. Rows are counted in the text that Arrow
        received, from which damaged lines had been removed."""
        self._plans_with_lost: set[str | None] = set()
        self._delimiter, self._names, self._plan_column = delimiter, names, plan_column

    def read(self, data: bytearray) -> tuple[pa.Table, np.ndarray[Any, np.dtype[np.int64]]]:
        """Read all columns as text. The function also returns the row numbers; the header is row 1.

        Raises:
            TableError: Arrow cannot read the text.
        """
        damaged = np.zeros(0, dtype=np.int64)
        if data.count(b'"') % 2 or not is_utf8(data):
            data, damaged = self._without_damaged_lines(data)
        before = len(self.lost)
        try:
            rows = self._parse(data)
        except pa.ArrowInvalid as error:
            raise TableError(f"not CSV: {reason(error)}") from error
        lost = np.array(self._lost_numbers, dtype=np.int64)
        numbers = np.setdiff1d(np.arange(2, rows.num_rows + len(lost) + 2), lost, assume_unique=True)
        if len(damaged):  # row numbers must also count the lines that were removed
            row_numbers = np.setdiff1d(np.arange(1, rows.num_rows + len(lost) + len(damaged) + 2), damaged)
            numbers = row_numbers[numbers - 1]
            self.lost[before:] = [row._replace(number=int(row_numbers[row.number - 1])) for row in self.lost[before:]]
        return rows, numbers

    def _parse(self, data: bytearray) -> pa.Table:
        kinds = {str(index): pa.string() for index in range(len(self._names))}
        # ``use_threads``: with threads, Arrow would not number the rows. ``newlines_in_values``: only a value in
        # quotation marks can have a line break.
        return pa_csv.read_csv(
            pa.BufferReader(pa.py_buffer(data)),
            read_options=pa_csv.ReadOptions(
                use_threads=False, block_size=_BLOCK_BYTES, skip_rows=1, column_names=list(kinds)
            ),
            parse_options=pa_csv.ParseOptions(
                delimiter=self._delimiter, newlines_in_values=b'"' in data, invalid_row_handler=self._lose
            ),
            convert_options=pa_csv.ConvertOptions(column_types=kinds, null_values=[], strings_can_be_null=False),
        )

    def _lose(self, row: Any) -> str:
        self._lost_numbers.append(row.number)
        fault = f"has {count_text(row.actual_columns, 'field')} instead of {row.expected_columns}"
        self._add_lost(row.number, row.text, fault)
        return "skip"

    def _add_lost(self, number: int, text: str, fault: str) -> None:
        """Add a row to ``lost``. Beyond ``_MOST_LOST`` rows, only one row of each plan is added."""
        plan_id = self._plan_of(text)
        if len(self.lost) < _MOST_LOST or plan_id not in self._plans_with_lost:
            self.lost.append(LostRow(number, plan_id, fault))
            self._plans_with_lost.add(plan_id)

    def _without_damaged_lines(self, data: bytearray) -> tuple[bytearray, np.ndarray[Any, np.dtype[np.int64]]]:
        """The text without its damaged lines, and the numbers of these lines.

        A line is damaged if it is not UTF-8, or if it has a quotation mark that is not closed in the same line. Damaged
        lines are added to ``lost``.
        """
        good_lines, damaged = [], []
        for number, line in enumerate(data.split(b"\n"), start=1):
            fault = None if number == 1 else self._line_fault(line)
            if fault is None:
                good_lines.append(line)
                continue
            damaged.append(number)
            self._add_lost(number, line.decode("utf-8", "surrogateescape"), fault)
        return bytearray(b"\n").join(good_lines), np.array(damaged, dtype=np.int64)

    def _line_fault(self, line: bytearray) -> str | None:
        """The reason why a line cannot be a complete row; None if the line can be a complete row."""
        if not is_utf8(line):
            text = line.decode("utf-8", "surrogateescape")
            try:
                fields = next(csv.reader([text], delimiter=self._delimiter), [])
            except csv.Error:
                fields = []
            for name, field in zip(self._names, fields, strict=False):
                if not is_text(field):
                    return f"{printable_name(name.strip())} is not UTF-8 text{other_encoding(field)}"
            return f"is not UTF-8 text{other_encoding(text)}"
        return "has an unclosed quotation mark" if line.count(b'"') % 2 else None

    def _plan_of(self, line: str) -> str | None:
        """The plan id in a row that otherwise cannot be read; None if the row has too few fields."""
        try:
            fields = next(csv.reader([line.partition("\n")[0]], delimiter=self._delimiter), [])
        except csv.Error:
            return None
        return fields[self._plan_column] if self._plan_column < len(fields) else None


def read_parquet(path: Path) -> Table:
    """Read the table in a Parquet file. Rows are numbered from 0, as in pandas.

    Raises:
        TableError: the file lacks a column, is damaged, or is too large. The error does not name the file.
        OSError: the file cannot be read.
    """

    def needed(names: list[str]) -> list[str]:
        where, _ = sorted_columns(names)
        return [names[index] for index in where.values()]

    names, rows = _parquet(path, needed)
    return _table(names, lambda index: rows.column(names[index]), rows.num_rows)


def parquet_frame(path: Path) -> pa.Table:
    """Read all columns of a Parquet file. Columns may contain tables.

    Raises:
        TableError: the file is damaged or too large. The error does not name the file.
        OSError: the file cannot be read.
    """
    return _parquet(path, lambda names: names, nested=True)[1]


def _parquet(
    path: Path, needed: Callable[[list[str]], list[str]], *, nested: bool = False
) -> tuple[list[str], pa.Table]:
    """The names of all columns of a Parquet file, and the columns that ``needed`` chooses by these names. ``nested``:
    whether columns may contain tables."""
    with open_for_arrow(path) as stream:
        try:
            with pq.ParquetFile(stream) as file:
                names: list[str] = file.schema_arrow.names
            return names, read_within(stream, needed(names), nested=nested)
        except OversizedFile as error:
            raise TableError(str(error)) from error
        except (pa.ArrowException, OSError) as error:
            raise TableError("is not a whole Parquet file") from error


def frame_table(frame: Any) -> Table:
    """The table in a pandas data frame, or in any object with Arrow's stream interface. Rows are numbered from 0.

    Raises:
        TableError: the frame is not a table, or lacks a column. The error does not name the frame.
    """
    if hasattr(frame, "iloc") and hasattr(frame, "columns"):
        # pandas: column by column, since a column may have values of several types
        return _table([str(name) for name in frame.columns], lambda index: frame.iloc[:, index], len(frame))
    try:
        rows = pa.table(frame)
    except (pa.ArrowException, TypeError, ValueError) as error:  # for example, the object is a column
        raise TableError(f"is no table: {reason(error)}") from error
    return _table(rows.column_names, rows.column, rows.num_rows)


def _table(names: Sequence[str], column: Callable[[int], Any], n_rows: int) -> Table:
    """The table of those columns whose names petmjx knows. ``names`` has the names of all columns, and ``column``
    returns the column at a position."""
    where, unread = sorted_columns(names)
    columns = {name: as_column(column(index)) for name, index in where.items()}
    return Table(columns, unread, np.arange(n_rows))
