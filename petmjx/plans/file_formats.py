"""File formats: recognition of plan files, and error texts for files of other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

from petmjx.common.safe_read import open_regular
from petmjx.common.text import shortened_text

PARQUET_MAGIC: Final = b"PAR1"
PARQUET_SUFFIX: Final = ".parquet"
CSV_SUFFIXES: Final = (".csv", ".csv.gz", ".tsv", ".tsv.gz")


@runtime_checkable
class SupportsArrow(Protocol):
    """A table with Arrow's PyCapsule interface, such as those of pandas, Polars and PyArrow."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The columns of the table, as a stream for Arrow."""


def is_csv(path: Path) -> bool:
    """Whether a file is CSV by its name. Its content would not distinguish it from damaged JSON."""
    return path.name.lower().endswith(CSV_SUFFIXES)


def is_parquet_name(path: Path) -> bool:
    """Whether a file is Parquet by its name."""
    return path.suffix.lower() == PARQUET_SUFFIX


def is_parquet(path: Path) -> bool:
    """Whether a file is Parquet, by its name or its first bytes.

    Raises:
        OSError: the file cannot be read, or is no regular file.
        ValueError: no file can have this name.
    """
    with open_regular(path) as file:
        return is_parquet_name(path) or file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC


_SAVE: Final = "save the sheet as CSV"

_MAGIC: Final = (
    (b"\x93NUMPY", "is a NumPy array (.npy): plans have names and several columns, as a table in CSV or Parquet has"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", f"is an Excel workbook of the old kind (.xls): {_SAVE}"),
    (b"ARROW1", "is an Arrow file (Feather): save the table as Parquet"),
    (b"FEA1", "is a Feather file: save the table as Parquet"),
    (b"\x89HDF\r\n\x1a\n", "is an HDF5 file: save the table as Parquet or CSV"),
    (b"SQLite format 3\0", "is an SQLite database: save the table as Parquet or CSV"),
    (b"%PDF", "is a PDF document"),
    (b"\x89PNG\r\n\x1a\n", "is a picture (PNG)"),
    (b"\xff\xd8\xff", "is a picture (JPEG)"),
    (b"BZh", "is packed with bzip2: unpack it, or pack it with gzip"),
    (b"\xfd7zXZ\0", "is packed with xz: unpack it, or pack it with gzip"),
    (b"\x28\xb5\x2f\xfd", "is packed with Zstandard: unpack it, or pack it with gzip"),
    (b"7z\xbc\xaf\x27\x1c", "is a 7z archive: unpack it"),
)
"""First bytes of files that are no text, and the error text for each."""

_MARKUP: Final = re.compile(rb"\s*<(\?xml|!doctype \w+|!--|[a-z][\w:.-]*)[\s/>]", re.IGNORECASE)
_PICKLE: Final = re.compile(rb"\x80[\x02-\x05]")
_LOOKED_AT: Final = 1 << 12
"""Number of bytes at the beginning of a file by which its format is recognised."""

_SEPARATOR_MARK: Final = re.compile(rb"\s*\"?sep=.\"?[\s;,]*", re.IGNORECASE)

_LONGEST_NUMBER: Final = 40
_DECIMAL_COMMA: Final = re.compile(r"[+-]?\d*,\d+")
_GROUPED: Final = re.compile(
    r"[+-]?\d{1,3}(?P<mark>[.,'\u2019 \u00a0\u202f])\d{3}(?:(?P=mark)\d{3})*(?:(?P<decimal>[.,])\d+)?"
)
"""Numbers with a mark between groups of three digits, and maybe a decimal mark."""


def foreign_kind(data: bytes | bytearray) -> str | None:
    """The format of a file that cannot be JSON or CSV, by its first bytes, as an error text. None: it may be JSON or
    CSV.
    """
    begin = bytes(data[:_LOOKED_AT])
    if begin.startswith(b"PK\x03\x04"):
        return _zip_kind(bytes(data[: 1 << 16]))
    kind = next((text for magic, text in _MAGIC if begin.startswith(magic)), None)
    if kind is not None:
        return kind
    if _PICKLE.match(begin):
        return "is a Python pickle, which is never read: save plans with petmjx.save_plans"
    if (markup := _MARKUP.match(begin)) is not None:
        html = markup[1].lower() in (b"!doctype html", b"html")
        return "is a web page (HTML)" if html else "is XML: plans are JSON, or tables in CSV or Parquet"
    return None


def _zip_kind(begin: bytes) -> str:
    if b"xl/" in begin or b"[Content_Types].xml" in begin:
        return f"is an Excel workbook (.xlsx): {_SAVE}"
    if b"opendocument.spreadsheet" in begin:
        return f"is a workbook (.ods): {_SAVE}"
    if b".npy" in begin:
        return "holds NumPy arrays (.npz): plans have names and several columns, as a table in CSV or Parquet has"
    return "is a ZIP archive: unpack it"


def separator_mark(header: bytes | bytearray) -> str | None:
    """The error text for a first row that is Excel's mark of the separator, such as "sep=;". None: it is none."""
    if not _SEPARATOR_MARK.fullmatch(header):
        return None
    mark = header.decode("utf-8", "replace").strip().strip('"')[:5]
    return f'row 1: "{mark}" is Excel\'s mark of the separator, and no header: delete this row'


def other_encoding(text: str) -> str:
    """The end of a message about a text that is not UTF-8: its probable content. Its bytes are lone surrogates."""
    if not all(character.isascii() or is_surrogate(character) for character in text):
        return ""  # the rest is UTF-8: the text is damaged, not in another encoding
    try:
        read = text.encode("utf-8", "surrogateescape").decode("cp1252")
    except UnicodeEncodeError:  # a surrogate that JSON wrote as an escape stands for no byte
        return ""
    except UnicodeDecodeError:
        return ": save the file as UTF-8"
    guess = f' ("{shortened_text(read)}" in Windows-1252)' if read.isprintable() else ""
    return f"{guess}: save the file as UTF-8"


def is_surrogate(character: str) -> bool:
    """Whether a character is a surrogate: half of a character, or a byte that is no UTF-8."""
    return 0xD800 <= ord(character) <= 0xDFFF


def number_hint(text: str) -> str:
    """A hint how to write a number that has a decimal comma or marks between its thousands; "" for all other texts."""
    plain = text.strip()
    grouped = _GROUPED.fullmatch(plain) if len(plain) <= _LONGEST_NUMBER else None
    mark, decimal = (None, None) if grouped is None else (grouped["mark"], grouped["decimal"])
    if mark is not None and mark != decimal and (decimal or mark not in ".,"):
        return f": it has marks between its thousands; write {plain.replace(mark, '').replace(',', '.')}"
    if mark == "," and not decimal:
        return f": write {plain.replace(',', '')} or {plain.replace(',', '.', 1)}, whichever it is"
    if _DECIMAL_COMMA.fullmatch(plain):
        return f": it has a decimal comma; write {plain.replace(',', '.')}, or semicolons between the table's columns"
    return ""
