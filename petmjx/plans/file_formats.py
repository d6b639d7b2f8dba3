"""File formats: recognises files of plans, and describes in error texts the files of other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

from petmjx.common.errors import InputError
from petmjx.common.safe_read import open_regular
from petmjx.common.text import count_text, number_in, shortened_text
from petmjx.common.unreadable_files import ARCHIVE_BYTES, NUMPY_MAGIC, ZIP_MAGIC, foreign_kind

PARQUET_MAGIC: Final = b"PAR1"
PARQUET_SUFFIX: Final = ".parquet"
CSV_SUFFIXES: Final = (".csv", ".csv.gz", ".tsv", ".tsv.gz")
BINARY_MAGIC: Final = (ZIP_MAGIC, NUMPY_MAGIC)
"""The first bytes of the binary formats that ``petmjx.plans.foreign_formats.sources_of_bytes`` reads. A file of any
other binary format is refused, or taken for text."""
PLAN_SUFFIXES: Final = (".json", ".json.gz", *CSV_SUFFIXES, PARQUET_SUFFIX, ".jsonl", ".xlsx", ".ods", ".npy", ".npz")
"""The ends of the names of those files in a folder that are read as files of plans."""


@runtime_checkable
class SupportsArrow(Protocol):
    """A table with Arrow's PyCapsule interface, such as a table of pandas, Polars or PyArrow."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The columns of the table, as a stream for Arrow."""


class NoGeometry(InputError):
    """Raised if a file has no columns with the sizes and places of boxes."""


class NoBoxes(NoGeometry):
    """Raised if a file has no boxes at all, so it is perhaps not a file of plans or orders."""


def is_csv(path: Path) -> bool:
    """Whether a file is CSV according to its name. The name is needed, because the content of a CSV file could also be
    damaged JSON."""
    return path.name.lower().endswith(CSV_SUFFIXES)


def is_parquet_name(path: Path) -> bool:
    """Whether a file is Parquet according to its name."""
    return path.suffix.lower() == PARQUET_SUFFIX


def is_parquet(path: Path) -> bool:
    """Whether a file is Parquet according to its name or its first bytes.

    Raises:
        OSError: the file cannot be read, or is not a regular file.
        ValueError: the name is impossible for a file, such as a name with a null character.
    """
    with open_regular(path) as file:
        return is_parquet_name(path) or file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC


COMMA_NUMBER: Final = r"^\s*[+-]?(\d*,\d+|\d+,|\d{1,3}(\.\d{3})+,\d+)([eE][+-]?\d+)?\s*$"
"""A number with a decimal comma, possibly with points between its thousands."""

_N_NEEDED: Final = 5
_COLUMN: Final = re.compile(rb"(plan_id|sequence|article|(length|width|height|weight)[\w/ ()]*|[xyz]_mm)")
"""Names of columns in tables of placements. If the name of a file does not show that the file is a table, text with
more than ``_N_NEEDED`` of these column names is recognised as a table."""

_JSON: Final = re.compile(rb"\s*+(\{\s*+[\"}]|\[\s*+[\"\[{\]])")
"""The beginning of JSON. No header of a table begins with these characters."""

_SEPARATOR_MARK: Final = re.compile(rb"\s*\"?sep=.\"?[\s;,]*", re.IGNORECASE)

_LONGEST_NUMBER: Final = 40
_DECIMAL_COMMA: Final = re.compile(r"[+-]?\d*,\d+")
_POINTS: Final = re.compile(r"[+-]?\d{1,3}(\.\d{3})+")
_GROUPED: Final = re.compile(
    r"[+-]?\d{1,3}(?P<mark>[.,'\u2019 \u00a0\u202f])\d{3}(?:(?P=mark)\d{3})*(?:(?P<decimal>[.,])\d+)?"
)
"""A number with a mark between groups of three digits, and possibly a decimal mark."""


def foreign_kind_of(path: Path) -> str | None:
    """The error text of :func:`foreign_kind` about the format of a file; None if the file may be JSON or CSV.

    Raises:
        OSError: the file cannot be read, or is not a regular file.
        ValueError: the name is impossible for a file, such as a name with a null character.
    """
    with open_regular(path) as file:
        return foreign_kind(file.read(ARCHIVE_BYTES))


def looks_like_table(data: bytes | bytearray) -> bool:
    """Whether a text begins with the header of a table of placements, or with Excel's separator mark."""
    first = data[: 1 << 16].split(b"\n", 1)[0].strip().lower()
    cells = [cell.strip(b'" ') for cell in re.split(rb"[,;\t]", first)]
    return separator_mark(first) is not None or sum(_COLUMN.fullmatch(cell) is not None for cell in cells) > _N_NEEDED


_LOOKED_AT_TEXT: Final = 1 << 16
_OWN_JSON: Final = re.compile(rb'"(item_sequence|length/mm)"')
_OTHER_UNITS: Final = re.compile(rb'"length/(cm|dm|m|in|inch|ft)"')
_MARKUP: Final = re.compile(rb"(?:\xef\xbb\xbf)?\s*<")
"""The beginning of XML, of a MuJoCo scene, and of a web page."""


def looks_like_own_json(data: bytes | bytearray) -> bool:
    """Whether a text has fields of BED-BPP's plans or orders. The first 64 KiB are searched for "item_sequence" and
    "length/mm". If they have neither of these names, and no length in another unit, the whole text is searched for
    "flb_coordinates" and "item_sequence"."""
    if _OWN_JSON.search(data, 0, _LOOKED_AT_TEXT) is not None:
        return True
    if _OTHER_UNITS.search(data, 0, _LOOKED_AT_TEXT) is not None:
        return False
    return any(data.find(name) >= 0 for name in (b'"flb_coordinates"', b'"item_sequence"'))


def is_of_other_tools(data: bytes | bytearray) -> bool:
    """Whether bytes may be a sheet, an array, a scene, XML or a web page of another tool. Before the call, the caller
    checks whether the bytes are UTF-8 text in one of petmjx's own forms; this function is only for other bytes."""
    begin = bytes(data[: 1 << 10])
    if (encoding := wide_encoding(data)) is not None:
        begin = begin.decode(encoding, "ignore").encode()
    return begin.startswith(BINARY_MAGIC) or _MARKUP.match(begin) is not None


def looks_like_json(data: bytes | bytearray) -> bool:
    """Whether a text begins like JSON and not like a table."""
    return _JSON.match(data) is not None


def separator_mark(header: bytes | bytearray) -> str | None:
    """The error text for a first row that is Excel's separator mark, such as "sep=;". The result is None for any other
    first row."""
    if not _SEPARATOR_MARK.fullmatch(header):
        return None
    mark = header.decode("utf-8", "replace").strip().strip('"')[:5]
    return f'row 1: "{mark}" is Excel\'s mark of the separator, and no header: delete this row'


_WIDE_MARKS: Final = ((b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32"))
_MARKS: Final = (*_WIDE_MARKS, (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
"""Byte order marks of encodings with characters of several bytes. The marks of UTF-32 are tried first, since one of
them begins with a mark of UTF-16."""
_ZEROS: Final[dict[tuple[bool, ...], str]] = {
    (True, False, False, False): "utf-32-le",
    (False, False, False, True): "utf-32-be",
    (True, False, True, False): "utf-16-le",
    (False, True, False, True): "utf-16-be",
}
"""Which of the first four bytes are not zero → encoding of a text that begins with two characters of ASCII, as in
section 3 of RFC 4627."""


def wide_encoding(data: bytes | bytearray) -> str | None:
    """The encoding of a text in UTF-16 or UTF-32, by its byte order mark or by the zero bytes at its beginning; None
    for all other bytes."""
    head = bytes(data[:4])
    marked = next((name for mark, name in _MARKS if head.startswith(mark)), None)
    if marked == "utf-16":  # zero bytes must follow, since the two bytes of this mark are letters in Windows-1252
        return marked if b"\0" in data[2 : 1 << 12] or len(data) == 2 else None
    if marked is not None:
        return marked
    name = _ZEROS.get(tuple(map(bool, head)))
    is_ascii = all(character in b"\t\n\r" or 32 <= character < 127 for character in head if character)
    return name if is_ascii else None


def nul_fault(text: str) -> str | None:
    """The error text for a text that ends in NUL characters and has none before its end; else None. A file ends in NUL
    characters if the program or the computer that wrote it was stopped."""
    n_nul = len(text) - len(text.rstrip("\0"))
    if not n_nul or text.count("\0") > n_nul:
        return None
    return f"ends in {count_text(n_nul, 'NUL byte')}; was the file written whole?"


def is_utf8(data: bytes | bytearray) -> bool:
    """Whether bytes are text in UTF-8."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return False
    return True


def other_encoding(text: str) -> str:
    """The end of a message about a text that is not UTF-8: the probable encoding of the text, and advice; "" if the
    text is probably damaged UTF-8.

    Args:
        text: the text; bytes that are not UTF-8 have become lone surrogates.
    """
    if not all(character.isascii() or 0xD800 <= ord(character) <= 0xDFFF for character in text):
        return ""  # the text has letters beyond ASCII that are valid UTF-8: it is damaged, not in another encoding
    try:
        read = text.encode("utf-8", "surrogateescape").decode("cp1252")
    except UnicodeEncodeError:  # a surrogate of a JSON escape, "\\ud800", stands for no byte: the encoding is unknown
        return ""
    except UnicodeDecodeError:
        return ": save the file as UTF-8"
    guess = f' ("{shortened_text(read)}" in Windows-1252)' if read.isprintable() else ""
    return f"{guess}: save the file as UTF-8"


def number_hint(text: str) -> str:
    """A hint on how to write a number that has a decimal comma or marks between its thousands; "" for any other
    text."""
    plain = text.strip()
    grouped = _GROUPED.fullmatch(plain) if len(plain) <= _LONGEST_NUMBER else None
    mark, decimal = (None, None) if grouped is None else (grouped["mark"], grouped["decimal"])
    if mark is not None and mark != decimal and (decimal or mark not in ".,"):
        return f": it has marks between its thousands; write {plain.replace(mark, '').replace(',', '.')}"
    if mark == "," and not decimal:
        return f": write {plain.replace(',', '')} or {plain.replace(',', '.', 1)}, whichever is meant"
    if _DECIMAL_COMMA.fullmatch(plain):
        return (
            f": it has a decimal comma; write {plain.replace(',', '.')}, or separate the table's columns with "
            "semicolons"
        )
    return ""


def point_fault(field: str, value: object) -> str | None:
    """The error text for a number with a decimal point, or with points between its thousands, in a table whose numbers
    have decimal commas. The result is None if the value has no point.
    """
    if not isinstance(value, str) or "." not in value or len(value) > _LONGEST_NUMBER or number_hint(value):
        return None
    plain = value.strip()
    fault = f'{field} must be a number, got "{plain}"'
    with_comma, joined_digits = plain.replace(".", ","), plain.replace(".", "")
    has_groups = _POINTS.fullmatch(plain) is not None
    if has_groups and plain.count(".") > 1:
        return f"{fault}: it has marks between its thousands; write {joined_digits}"
    if not has_groups and number_in(plain) is None:
        return None
    ways = f"{joined_digits} or {with_comma}, whichever is meant" if has_groups else with_comma
    return f"{fault}: other numbers of this file have decimal commas; write {ways}"
