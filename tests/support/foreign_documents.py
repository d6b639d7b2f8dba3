"""Files that can be written intact or with one damaged value: tables, JSON, texts, NumPy arrays. Each file knows where
the size and the position of a box are in it."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq

KINDS = ("word", "negative", "empty", "truncated")
"""Kinds of damage: a letter in a number of a position, a negative size, a missing position, a file that ends in a
box."""


@dataclass(frozen=True)
class Place:
    """The damaged place in a file, as an error must name it.

    Attributes:
        row: for tables, number of the row in the file or sheet, from 1 and including the header; for texts, XML and
            JSON Lines, number of the line, from 1; for JSON and arrays, index of the box in its plan, from 0. None if
            the file cannot be opened at all.
        column: the header, the key, or the index of the column. Empty for the whole row or file.
    """

    row: int | None
    column: str


def garbled(value: Any) -> Any:
    """A number with a letter in it, like a typing error. In an array of numbers: NaN."""
    if isinstance(value, np.floating | np.integer):
        return np.nan
    if isinstance(value, dict):
        return {key: part if key == "unit" else garbled(part) for key, part in value.items()}
    text = str(value)
    return f"{text[:1]}q{text[1:]}"


def negative(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: part if key == "unit" else negative(part) for key, part in value.items()}
    return f"-{value}" if isinstance(value, str) else -value


DAMAGES = {"word": garbled, "negative": negative}


class Document:
    """A file. ``name``: name of the file; ``n``: number of boxes in it."""

    name: str
    n: int

    def content(self) -> bytes:
        raise NotImplementedError

    def damage(self, kind: str, box: int) -> tuple[Place, bytes]:
        """Damage the file at one box. Boxes are counted over all plans of the file."""
        raise NotImplementedError

    def write(self, folder: Path) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / self.name).write_bytes(self.content())
        return folder / self.name


@dataclass
class Json(Document):
    """A JSON file of any structure.

    Attributes:
        root: the value that is written.
        boxes: for each box, its index in its plan, and its dictionary or list, which is a part of ``root``.
        size, place: keys that lead from a box to a size and to a coordinate.
        lines: whether each line is a JSON value (JSON Lines).
        columns: whether ``root`` has a list for each column, and a box is an index of these lists.
    """

    name: str
    root: Any
    boxes: Sequence[tuple[int, Any]]
    size: tuple[str | int, ...]
    place: tuple[str | int, ...]
    encoding: str = "utf-8"
    indent: int | None = None
    lines: bool = False

    def __post_init__(self) -> None:
        self.n = len(self.boxes)

    def text(self) -> str:
        if self.lines:
            return "".join(json.dumps(part, ensure_ascii=False) + "\n" for part in self.root)
        return json.dumps(self.root, ensure_ascii=False, indent=self.indent)

    def content(self) -> bytes:
        return self.text().encode(self.encoding)

    def damage(self, kind: str, box: int) -> tuple[Place, bytes]:
        if kind == "truncated":
            content = self.content()
            return Place(None, ""), content[: len(content) * 3 // 5]
        index, holder = self.boxes[box]
        path = self.size if kind == "negative" else self.place
        for key in path[:-1]:
            holder = holder[key]
        holder[path[-1]] = None if kind == "empty" else DAMAGES[kind](holder[path[-1]])
        words = [str(key) for key in path if isinstance(key, str)]
        return Place(box + 1 if self.lines else index, words[-1] if words else str(path[-1])), self.content()


@dataclass
class Text(Document):
    """Lines of text, some of which describe a box. ``size`` and ``place`` are pairs: a regular expression that finds a
    number in such a line as its first group, and the name of its column."""

    name: str
    lines: list[str]
    boxes: Sequence[int]
    size: tuple[str, str]
    place: tuple[str, str]
    encoding: str = "utf-8"

    def __post_init__(self) -> None:
        self.n = len(self.boxes)

    def content(self) -> bytes:
        return "\n".join([*self.lines, ""]).encode(self.encoding)

    def damage(self, kind: str, box: int) -> tuple[Place, bytes]:
        line = self.boxes[box]
        pattern, column = self.size if kind == "negative" else self.place
        match = re.search(pattern, self.lines[line])
        assert match is not None, (self.name, pattern, self.lines[line])
        start, end = match.span(1)
        before, value, after = self.lines[line][:start], self.lines[line][start:end], self.lines[line][end:]
        if kind == "truncated":
            self.lines[line:] = [before]
            return Place(line + 1, ""), "\n".join(self.lines).encode(self.encoding)
        self.lines[line] = f"{before}{'' if kind == 'empty' else DAMAGES[kind](value)}{after}"
        return Place(line + 1, column), self.content()


@dataclass
class Arrays(Document):
    """A .npy file of one array, or an .npz file of several arrays. A box is a row of an array. ``size`` and ``place``
    are pairs: the name of an array ("": the box's own array), and a column."""

    name: str
    arrays: dict[str, np.ndarray]
    boxes: Sequence[tuple[str, int]]
    size: tuple[str, int]
    place: tuple[str, int]

    def __post_init__(self) -> None:
        self.n = len(self.boxes)

    def content(self) -> bytes:
        content = io.BytesIO()
        if self.name.endswith(".npz"):
            np.savez(content, **self.arrays)
        else:
            np.save(content, self.arrays[""])
        return content.getvalue()

    def damage(self, kind: str, box: int) -> tuple[Place, bytes]:
        if kind == "truncated":
            return Place(None, ""), self.content()[: len(self.content()) * 3 // 5]
        plan, row = self.boxes[box]
        name, column = self.size if kind == "negative" else self.place
        array = self.arrays[name or plan]
        values = array.reshape(len(array), -1)[row]
        if kind != "negative" and array.dtype.kind in "iu":
            self.arrays[name or plan] = array = array.astype(float)
            values = array.reshape(len(array), -1)[row]
        values[column] = -values[column] if kind == "negative" else np.nan if kind == "word" else np.inf
        return Place(row, str(column)), self.content()


@dataclass
class Csv:
    """How a table is written as text."""

    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    encoding: str = "utf-8"
    mark: bool = False
    """Whether Excel's line ``sep=;`` comes before the table."""
    quote: bool = False
    end: str = "\n"


@dataclass
class Table(Document):
    """A table as text, workbook or Parquet file. The ending of the name decides.

    Attributes:
        sheets: title → rows of cells, including title rows and the header. Only workbooks have several sheets.
        header: index of the header row. If None, there is no header, and columns are named by their numbers, from 1.
        boxes: for each box, its sheet and the index of its row.
        size, place: indices of the columns of a size and of a coordinate.
        text_numbers: whether a workbook has numbers as text, as after an import.
    """

    name: str
    sheets: dict[str, list[list[Any]]]
    boxes: Sequence[tuple[str, int]]
    size: int
    place: int
    header: int | None = 0
    csv: Csv = field(default_factory=Csv)
    text_numbers: bool = False
    decimals: int = 1

    def __post_init__(self) -> None:
        self.n = len(self.boxes)

    def shown(self, cell: Any) -> str:
        """A cell as text, with the decimal and thousands separators of the table."""
        if cell is None or isinstance(cell, str):
            return cell or ""
        if isinstance(cell, int | np.integer) and not self.csv.thousands:
            return str(cell)
        text = f"{cell:.4f}".rstrip("0").rstrip(".")
        if self.csv.thousands:
            whole, _, part = text.partition(".")
            text = f"{int(whole):,}.{part.ljust(self.decimals, '0')}"
        return text.translate({ord(","): self.csv.thousands, ord("."): self.csv.decimal})

    def lines(self) -> list[str]:
        lines = [f"sep={self.csv.delimiter}"] if self.csv.mark else []
        for row in next(iter(self.sheets.values())):
            cells = [self.shown(cell) for cell in row]
            special = (self.csv.delimiter, '"', "\n")
            lines.append(
                self.csv.delimiter.join(
                    '"' + cell.replace('"', '""') + '"'
                    if self.csv.quote or any(mark in cell for mark in special)
                    else cell
                    for cell in cells
                )
            )
        return lines

    def content(self) -> bytes:
        if self.name.endswith(".xlsx"):
            return self._xlsx()
        if self.name.endswith(".ods"):
            return self._ods()
        if self.name.endswith(".parquet"):
            (rows,) = self.sheets.values()
            columns = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
            content = io.BytesIO()
            pq.write_table(pa.table({name: list(values) for name, values in columns.items()}), content)
            return content.getvalue()
        return self.csv.end.join([*self.lines(), ""]).encode(self.csv.encoding)

    def damage(self, kind: str, box: int) -> tuple[Place, bytes]:
        sheet, index = self.boxes[box]
        rows = self.sheets[sheet]
        column = self.size if kind == "negative" else self.place
        place = Place(index + 1 + self.csv.mark, str(column + 1 if self.header is None else rows[self.header][column]))
        if kind == "truncated":
            if self.name.rpartition(".")[2] in ("xlsx", "ods", "parquet"):
                return Place(None, ""), self.content()[: len(self.content()) * 3 // 5]
            rows[index + 1 :] = []
            cut = min(column, len(rows[index]) - 2)  # a row that is cut within its last column would be a whole row
            rows[index][cut:] = [str(rows[index][cut])[:1]]
            return Place(place.row, ""), self.csv.end.join(self.lines()).encode(self.csv.encoding)
        value = rows[index][column]
        if kind == "word" and not self.name.endswith(".parquet"):
            value = garbled(self.shown(value))
        else:
            value = negative(value) if kind == "negative" else None
        rows[index][column] = value
        return place, self.content()

    def _cell(self, cell: Any) -> Any:
        """The value of a cell in a workbook."""
        if isinstance(cell, np.generic):
            cell = cell.item()
        return self.shown(cell) if self.text_numbers and isinstance(cell, int | float) else cell

    def _xlsx(self) -> bytes:
        book = openpyxl.Workbook()
        book.remove(book.active)
        for title, rows in self.sheets.items():
            sheet = book.create_sheet(title)
            for row in rows:
                sheet.append([self._cell(cell) for cell in row])
        content = io.BytesIO()
        book.save(content)
        return content.getvalue()

    def _ods(self) -> bytes:
        """A workbook as LibreOffice writes it: blank cells and rows are counted up to the end of the sheet."""
        body = []
        for title, rows in self.sheets.items():
            body.append(f'<table:table table:name="{escape(title)}">')
            for row in rows:
                cells = "".join(_ods_cell(self._cell(cell)) for cell in row)
                rest = '<table:table-cell table:number-columns-repeated="1012"/>'
                body.append(f"<table:table-row>{cells}{rest}</table:table-row>")
            blank = '<table:table-cell table:number-columns-repeated="1024"/>'
            body.append(
                f'<table:table-row table:number-rows-repeated="1048000">{blank}</table:table-row></table:table>'
            )
        spaces = " ".join(f'xmlns:{name}="urn:oasis:names:tc:opendocument:xmlns:{name}:1.0"' for name in ODF)
        written = (
            f'<?xml version="1.0" encoding="UTF-8"?><office:document-content {spaces} office:version="1.2">'
            f"<office:body><office:spreadsheet>{''.join(body)}</office:spreadsheet></office:body></office:document-content>"
        )
        manifest = (
            '<manifest:manifest xmlns:manifest="urn:oasis:names:tc:opendocument:xmlns:manifest:1.0">'
            f'<manifest:file-entry manifest:full-path="/" manifest:media-type="{ODS}"/>'
            '<manifest:file-entry manifest:full-path="content.xml" manifest:media-type="text/xml"/></manifest:manifest>'
        )
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("mimetype", ODS, zipfile.ZIP_STORED)
            archive.writestr("content.xml", written)
            archive.writestr("META-INF/manifest.xml", manifest)
        return content.getvalue()


ODF = ("office", "table", "text")
ODS = "application/vnd.oasis.opendocument.spreadsheet"


def _ods_cell(cell: Any) -> str:
    if cell is None:
        return "<table:table-cell/>"
    kind = "string" if isinstance(cell, str) else "float"
    value = "" if isinstance(cell, str) else f' office:value="{cell}"'
    return (
        f'<table:table-cell office:value-type="{kind}"{value}><text:p>{escape(str(cell))}</text:p></table:table-cell>'
    )
