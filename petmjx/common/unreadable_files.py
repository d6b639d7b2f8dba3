"""Recognises, by the first bytes of a file, formats that are neither JSON nor CSV, and provides an error text for each.

As plans and orders, petmjx nevertheless reads some of these formats, such as workbooks and NumPy arrays
(``petmjx.plans.foreign_formats``).
"""

from __future__ import annotations

import re
import zipfile
import zlib
from typing import Final

ZIP_MAGIC: Final = b"PK\x03\x04"
"""The first bytes of ZIP files: workbooks, and archives of NumPy arrays."""
NUMPY_MAGIC: Final = b"\x93NUMPY"
ARCHIVE_BYTES: Final = 1 << 16
"""Number of bytes at the beginning of a ZIP archive from which its content is recognised."""
DAMAGED_ZIP: Final = (
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError),
    *(ValueError, OSError, EOFError),
)
"""Exceptions that ``zipfile`` raises for a file that is damaged, encrypted or not a ZIP file, or uses an unknown
compression."""

_SAVE: Final = "save the sheet as CSV"

_MAGIC: Final = (
    (NUMPY_MAGIC, "is a NumPy array (.npy), which has no named columns: save the plans as a table in CSV or Parquet"),
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
"""First bytes of a file that is not text → the error text."""

_MARKUP: Final = re.compile(rb"\s*<(\?xml|!doctype \w+|!--|[a-z][\w:.-]*)[\s/>]", re.IGNORECASE)
_PICKLE: Final = re.compile(rb"\x80[\x02-\x05]")
_SNIFFED_BYTES: Final = 1 << 12
"""Number of bytes at the beginning of a file from which its format is recognised."""


def foreign_kind(data: bytes | bytearray) -> str | None:
    """An error text that names the format of a file, if the file's first bytes show that it is neither JSON nor CSV.
    The result is None if the file may be JSON or CSV.
    """
    begin = bytes(data[:_SNIFFED_BYTES])
    if begin.startswith(ZIP_MAGIC):
        return _zip_kind(bytes(data[:ARCHIVE_BYTES]))
    kind = next((text for magic, text in _MAGIC if begin.startswith(magic)), None)
    if kind is not None:
        return kind
    if _PICKLE.match(begin):
        return "is a Python pickle, which is never read: save plans with petmjx.save_plans"
    if (markup := _MARKUP.match(begin)) is not None:
        html = markup[1].lower() in (b"!doctype html", b"html")
        return "is a web page (HTML)" if html else "is XML: plans are JSON, or tables in CSV or Parquet"
    return None


_OWN_FORMS: Final = "plans are JSON, or tables of boxes with sizes and places"

_PROGRAMS: Final = (
    (r"#usda\b", "is a scene in USD: save it as glTF"),
    (r"(?:%%%.*\n)?\s*(?:&ACCESS|DEFDAT|MODULE)\s", f"is a program of a robot: {_OWN_FORMS}"),
    (r"(?:#.*\n|\s)*def \w+\(\):\s[^=]*?\b(?:movej|movel|movep|set_tcp)\(", f"is a program of a robot: {_OWN_FORMS}"),
    (r"/PROG\s", f"is a program of a robot: {_OWN_FORMS}"),
    (r"(?:UNA|UNB\+|ISA\*)", f"is an EDI message: {_OWN_FORMS}"),
    (r"#VRML\b", "is a scene in VRML: save it as glTF or X3D"),
    (r"(?://.*\n|\s)*(?:translate|cube|color|union|module \w+)\s*\(", f"is a model in OpenSCAD: {_OWN_FORMS}"),
    (r"(?:#.*\n|(?:mtllib|o|g|s) .*\n|\s)*v\s+-?[\d.]+\s+-?[\d.]+\s", "is a mesh (OBJ): save it as glTF"),
    (r"solid\b.*\n\s*facet normal\s", "is a mesh (STL): save it as glTF, with one mesh for each box"),
    (r"ply\s*\nformat\s", "is a mesh or a cloud of points (PLY): save boxes as glTF"),
    (r"ISO-10303-21;", "is a CAD model (STEP or IFC): save it as glTF"),
    (r"\s*0\s*\n\s*SECTION\s", "is a drawing (DXF): save it as glTF"),
    (r"clingo version |# (?:Solution for model|Objective value)", f"has the variables of a solver: {_OWN_FORMS}"),
    (r"(?:%.*\n|\s)*[a-z]\w*\([^()\n]*\)\.\s", f"has facts (Prolog): {_OWN_FORMS}"),
)
"""Beginning of a text, as a pattern → the error text."""


def program_kind(text: str) -> str | None:
    """An error text if the text of a file is a program, a scene or a message, which has no table or list of boxes. The
    result is None for other texts."""
    begin = text[:_SNIFFED_BYTES]
    return next((error for pattern, error in _PROGRAMS if re.match(pattern, begin)), None)


def _zip_kind(begin: bytes) -> str:
    if b"xl/" in begin or b"[Content_Types].xml" in begin:
        return f"is an Excel workbook (.xlsx): {_SAVE}"
    if b"opendocument.spreadsheet" in begin:
        return f"is a workbook (.ods): {_SAVE}"
    if b".npy" in begin:
        return "holds NumPy arrays (.npz) instead of a table with named columns: save the plans as CSV or Parquet"
    return "is a ZIP archive: unpack it"
