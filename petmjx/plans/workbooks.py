"""Reads workbooks (.xlsx, .ods) and tables of any other file (``read_raw_tables``): bytes become raw tables."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final
from xml.etree import ElementTree

from petmjx.common.errors import InputError
from petmjx.common.safe_read import allowed_bytes
from petmjx.plans.raw_cells import cell_number
from petmjx.plans.raw_tables import MOST_COLUMNS, MOST_ROWS, RawTable, tables_of_rows, tables_of_text


def tables_of_xlsx(data: bytes | bytearray) -> list[RawTable]:
    """The tables of a workbook (.xlsx), at least one per sheet with content. Formulas have the values stored in the
    file.

    Raises:
        InputError: the file is damaged or too large, or contains no table. The error does not name the file.
    """
    from openpyxl import load_workbook  # loading it takes a third of a second

    check_archive(data)
    try:
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = {sheet.title: list(_cells(sheet)) for sheet in book.worksheets if sheet.sheet_state == "visible"}
        book.close()
    except InputError:
        raise
    except Exception as error:  # openpyxl may raise anything for a damaged workbook
        raise InputError(f"is not a whole workbook (.xlsx): {type(error).__name__}") from error
    return _tables_of_sheets(sheets)


def _cells(sheet: Any) -> Iterator[list[Any]]:
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > MOST_ROWS:
            raise InputError(f"has more than {MOST_ROWS:,} rows")
        yield list(row[:MOST_COLUMNS])


_TABLE: Final = "{urn:oasis:names:tc:opendocument:xmlns:table:1.0}"
_OFFICE: Final = "{urn:oasis:names:tc:opendocument:xmlns:office:1.0}"
_TEXT: Final = "{urn:oasis:names:tc:opendocument:xmlns:text:1.0}"


def tables_of_ods(data: bytes | bytearray) -> list[RawTable]:
    """The tables of a LibreOffice workbook (.ods), at least one per sheet with content.

    Raises:
        InputError: as for :func:`tables_of_xlsx`.
    """
    check_archive(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            content = archive.read("content.xml")
        if b"<!DOCTYPE" in content[:2000] or b"<!ENTITY" in content:
            raise InputError("is a workbook (.ods) with declarations that petmjx does not read")
        root = ElementTree.fromstring(content)
    except (zipfile.BadZipFile, KeyError, ElementTree.ParseError, EOFError, NotImplementedError, RuntimeError) as error:
        raise InputError("is not a whole workbook (.ods)") from error
    return _tables_of_sheets(
        {str(table.get(f"{_TABLE}name")): _ods_rows(table) for table in root.iter(f"{_TABLE}table")}
    )


def _ods_rows(table: ElementTree.Element) -> list[list[Any]]:
    rows: list[list[Any]] = []
    for element in table.iter(f"{_TABLE}table-row"):
        cells: list[Any] = []
        for cell in element:
            if cell.tag not in (f"{_TABLE}table-cell", f"{_TABLE}covered-table-cell"):
                continue
            value = _ods_value(cell)
            repeated = int(cell.get(f"{_TABLE}number-columns-repeated", "1"))
            if value is None and len(cells) + repeated > MOST_COLUMNS:
                break
            cells += [value] * min(repeated, MOST_COLUMNS)
        while cells and cells[-1] is None:
            cells.pop()
        repeated = int(element.get(f"{_TABLE}number-rows-repeated", "1"))
        if len(rows) + (repeated if cells else 0) > MOST_ROWS:
            raise InputError(f"has more than {MOST_ROWS:,} rows")
        rows += [cells] * (repeated if cells else min(repeated, 1_000))
    while rows and not rows[-1]:
        rows.pop()
    width = max(map(len, rows), default=0)
    return [row + [None] * (width - len(row)) for row in rows]


def _ods_value(cell: ElementTree.Element) -> Any:
    kind = cell.get(f"{_OFFICE}value-type")
    if kind in ("float", "percentage", "currency"):
        number = cell_number(cell.get(f"{_OFFICE}value", ""))
        return None if number is None else number.value
    paragraphs = ["".join(part.itertext()) for part in cell.iter(f"{_TEXT}p")]
    return "\n".join(paragraphs) or None


def check_archive(data: bytes | bytearray) -> None:
    """Refuse a ZIP archive whose unpacked size is too large.

    Raises:
        InputError: the archive is damaged or too large.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            total = sum(member.file_size for member in archive.infolist())
    except zipfile.BadZipFile as error:
        raise InputError("is not a whole workbook or archive") from error
    if total > allowed_bytes(len(data)):
        raise InputError("unpacks to too much for a file of plans")


def _tables_of_sheets(sheets: dict[str, list[list[Any]]]) -> list[RawTable]:
    tables, fault = [], InputError("is a workbook without a table of boxes")
    for title, rows in sheets.items():
        if not any(any(cell is not None for cell in row) for row in rows):
            continue
        try:
            tables += tables_of_rows(rows, title=title)
        except InputError as error:
            fault = error
    if not tables:
        raise fault
    return tables


@dataclass(frozen=True, eq=False)
class RawFile:
    """The raw tables of one file.

    Attributes:
        tables: the tables; tables with headers come first.
        kind: kind of the file, in words: "a table as text", "a workbook (.xlsx)".
    """

    tables: list[RawTable] = field(default_factory=list)
    kind: str = ""


def read_raw_tables(data: bytes | bytearray) -> RawFile:
    """Read the tables in a file's bytes. Workbooks are recognised by their content; all other files are read as text.

    Raises:
        InputError: the file contains no table. The error does not name the file.
    """
    if bytes(data[:4]) == b"PK\x03\x04":
        begin = bytes(data[: 1 << 16])
        if b"opendocument.spreadsheet" in begin:
            return RawFile(tables_of_ods(data), "a workbook (.ods)")
        return RawFile(tables_of_xlsx(data), "a workbook (.xlsx)")
    return RawFile(tables_of_text(data), "a table as text")
