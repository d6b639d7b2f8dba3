"""Reads the tables of workbooks (.xlsx, .ods), web pages and text files (``read_raw_tables``): bytes become raw tables.
The module also turns XML into nested values like those of JSON."""

from __future__ import annotations

import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any, Final
from xml.etree import ElementTree

from petmjx.common.errors import InputError
from petmjx.common.safe_read import allowed_bytes
from petmjx.common.text import printable_name
from petmjx.common.unreadable_files import ARCHIVE_BYTES, DAMAGED_ZIP, ZIP_MAGIC
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.raw_tables import MOST_COLUMNS, MOST_ROWS, RawTable
from petmjx.plans.table_sections import tables_of_rows
from petmjx.plans.text_tables import tables_of_text


def tables_of_xlsx(data: bytes | bytearray) -> list[RawTable]:
    """The tables of a workbook (.xlsx), at least one per sheet with content.

    Raises:
        InputError: the file is damaged or too large, or contains no table. The error does not name the file.
    """
    sheets, hidden = sheets_of_xlsx(data)
    first, *others = _tables_of_sheets(sheets)
    notes = [f"sheet {printable_name(title)} not read: it is hidden" for title in hidden]
    return [replace(first, notes=(*first.notes, *notes)), *others]


def sheets_of_xlsx(data: bytes | bytearray) -> tuple[dict[str, list[list[Any]]], list[str]]:
    """Name → rows of each visible sheet of a workbook (.xlsx); and the names of the hidden sheets. In place of a
    formula, its result is returned, as the file stores it.

    Raises:
        InputError: the file is damaged or too large. The error does not name the file.
    """
    from openpyxl import load_workbook  # loading openpyxl takes a third of a second

    check_archive(data)
    try:
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        sheets = {sheet.title: list(_cells(sheet)) for sheet in book.worksheets if sheet.sheet_state == "visible"}
        hidden = [sheet.title for sheet in book.worksheets if sheet.title not in sheets]
        book.close()
    except InputError:
        raise
    except Exception as error:  # openpyxl may raise any exception for a damaged workbook
        raise InputError("is not a whole workbook (.xlsx)") from error
    return sheets, hidden


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
    except (*DAMAGED_ZIP, KeyError, ElementTree.ParseError) as error:
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
    except (zipfile.BadZipFile, NotImplementedError) as error:  # NotImplementedError: an unknown version of ZIP
        raise InputError("is not a whole workbook or archive") from error
    if total > allowed_bytes(len(data)):
        raise InputError("unpacks to more bytes than a file of plans may have")


def _span(text: str | None, most: int) -> int:
    """The number of rows or columns over which a cell extends, at most ``most``."""
    return max(1, min(int(text), most)) if text is not None and text.isdecimal() and len(text) < 10 else 1


class _PageRows(HTMLParser):
    """The rows of cells of each table in a web page."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[list[list[Any]]] = []
        self.cell: tuple[list[Any], int] = ([], 0)
        self.in_cell = False
        self.spans: dict[int, tuple[list[Any], int]] = {}
        """Column → the row whose cell extends downwards, and the number of further rows over which it extends."""
        self.n_copies = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
            self.spans = {}
        elif tag == "tr" and self.tables:
            self.tables[-1].append([])
        elif tag in ("td", "th") and self.tables and self.tables[-1]:
            row, spans = self.tables[-1][-1], dict(attrs)
            self._copy_from_above(row)
            self.cell, self.in_cell = (row, len(row)), True
            n_more = _span(spans.get("rowspan"), MOST_ROWS) - 1
            row += ["", *[None] * (_span(spans.get("colspan"), MOST_COLUMNS - len(row)) - 1)]
            if n_more:
                self.spans |= dict.fromkeys(range(self.cell[1], len(row)), (row, n_more))

    def _copy_from_above(self, row: list[Any]) -> None:
        """Add the cells of rows above that extend over the next columns of a row. Numbers are left out: a weight beside
        several boxes may be the weight of all these boxes."""
        while (span := self.spans.pop(len(row), None)) is not None and self.n_copies < MOST_ROWS:
            above, n_more = span
            if n_more > 1:
                self.spans[len(row)] = (above, n_more - 1)
            cell = above[len(row)]
            row.append(None if cell is None or cell_number(cell) is not None else cell)
            self.n_copies += 1

    def handle_endtag(self, tag: str) -> None:
        self.in_cell &= tag not in ("td", "th", "tr", "table")
        if tag == "tr" and self.tables and self.tables[-1]:
            self._copy_from_above(self.tables[-1][-1])

    def handle_data(self, data: str) -> None:
        if self.in_cell:
            row, index = self.cell
            row[index] += data


def tables_of_page(text: str) -> list[RawTable]:
    """The tables of a web page. Many programs save such a page under the name of a workbook (.xls).

    Raises:
        InputError: no table of the page has boxes. The error does not name the file.
    """
    page = _PageRows()
    page.feed(text)
    page.close()
    if sum(map(len, page.tables)) > MOST_ROWS:
        raise InputError(f"has more than {MOST_ROWS:,} rows")
    return _tables_of_sheets({f"table {number}": rows for number, rows in enumerate(page.tables, start=1)})


_DECLARED_ENCODING: Final = re.compile(r"""\A(\s*<\?xml\b[^>]*?)\s+encoding\s*=\s*(?:"[^"]*"|'[^']*')""")
"""The encoding in the declaration of XML. A decoded text no longer has this encoding."""


def value_of_xml(text: str) -> Any:
    """The elements of XML as nested dictionaries: attributes and children by name, a list for children with the same
    name, and the text of an element that has only text. If an element has text and also attributes or children, the
    text gets the name "value".

    Raises:
        InputError: the text is not XML, or declares entities. The error does not name the file.
    """
    if "<!ENTITY" in text:
        raise InputError("is XML with declarations that petmjx does not read")
    try:
        root = ElementTree.fromstring(_DECLARED_ENCODING.sub(r"\1", text))
    except ElementTree.ParseError as error:
        line, column = error.position
        raise InputError(f"not XML at line {line}, column {column + 1}") from error
    return {_name_of(root): _value_of(root, 0, _repeated_names(root))}


def _repeated_names(root: ElementTree.Element) -> set[tuple[str, str]]:
    """Pairs (name of an element, name of a child): at least one element with the first name has several children with
    the second name. In every such element, the children with the second name become a list, even if there is only
    one."""
    repeated: set[tuple[str, str]] = set()
    for element in root.iter():
        counts = Counter(map(_name_of, element))
        repeated |= {(_name_of(element), name) for name, count in counts.items() if count > 1}
    return repeated


_DEEPEST: Final = 50
"""Elements that are nested more deeply than this are not read."""


def _value_of(element: ElementTree.Element, depth: int, repeated: set[tuple[str, str]]) -> Any:
    fields: dict[str, Any] = {_local_name(name): value for name, value in element.attrib.items()}
    children: dict[str, list[Any]] = {}
    for child in element if depth < _DEEPEST else ():
        children.setdefault(_name_of(child), []).append(_value_of(child, depth + 1, repeated))
    lists = {name for name in children if (_name_of(element), name) in repeated}
    fields |= {name: values if name in lists else values[0] for name, values in children.items()}
    text = (element.text or "").strip()
    if not fields:
        return text or None
    return {"value": text, **fields} if text else fields


def _name_of(element: ElementTree.Element) -> str:
    return _local_name(element.tag) if isinstance(element.tag, str) else "comment"


def _local_name(name: str) -> str:
    """A name without its namespace: "{http://…}box" → "box"."""
    return name.rpartition("}")[2]


def _tables_of_sheets(sheets: dict[str, list[list[Any]]]) -> list[RawTable]:
    tables: list[RawTable] = []
    faults: dict[str, InputError] = {}
    for title, rows in sheets.items():
        if not any(any(cell is not None for cell in row) for row in rows):
            continue
        try:
            tables += tables_of_rows(rows, title=title)
        except InputError as error:
            faults[title] = error
    if not tables:
        raise next(reversed(faults.values()), InputError("is a workbook without a table of boxes"))
    notes = tuple(
        f"sheet {printable_name(title)} not read: {fault}"
        for title, fault in faults.items()
        if not isinstance(fault, NoBoxes)  # no note, since workbooks often have sheets that contain only text
    )
    return [replace(tables[0], notes=(*tables[0].notes, *notes)), *tables[1:]]


def read_raw_tables(data: bytes | bytearray) -> tuple[list[RawTable], str]:
    """Read the tables in a file's bytes. Workbooks are recognised by their content; all other files are read as text.

    Returns:
        The tables, and the kind of the file in words: "a table as text", "a workbook (.xlsx)".

    Raises:
        InputError: the file contains no table. The error does not name the file.
    """
    if data.startswith(ZIP_MAGIC):
        if b"opendocument.spreadsheet" in bytes(data[:ARCHIVE_BYTES]):
            return tables_of_ods(data), "a workbook (.ods)"
        return tables_of_xlsx(data), "a workbook (.xlsx)"
    return tables_of_text(data), "a table as text"
