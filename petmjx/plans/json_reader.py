"""Reads JSON files of plans and orders. The module unpacks gzip up to a limit of size, and decodes one entry (a plan or
an order) at a time."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from petmjx.common.errors import InputError
from petmjx.common.safe_read import FREE_BYTES, MOST_BYTES, allowed_bytes, read_regular, size
from petmjx.common.text import count_text, printable_id
from petmjx.common.unreadable_files import foreign_kind
from petmjx.plans.file_formats import wide_encoding

Value = TypeVar("Value")

_GZIP_MAGIC: Final = b"\x1f\x8b\x08"
_GZIP_CHUNK: Final = 1 << 14
_WBITS_GZIP: Final = 31
_UTF8_MARK: Final = b"\xef\xbb\xbf"


def read_text_bytes(path: Path) -> tuple[bytearray, str | None]:
    """The text of a file as bytes, and an error about the whole file (None if there is none).

    Gzip is recognised by content, not by name. Memory holds one copy of the packed bytes and one copy of the unpacked
    bytes.

    Raises:
        OSError: the file cannot be read, is not a regular file, or is too large.
        ValueError: the name is impossible for a file, such as a name with a null character.
    """
    data, fault = unpacked_bytes(path)
    if (encoding := wide_encoding(data)) is not None:
        try:
            data = bytearray(data.decode(encoding).encode())
        except UnicodeError as error:
            return bytearray(), f"is damaged {encoding[:6].upper()} text ({error.args[-1]})"
    if (kind := foreign_kind(data)) is not None:
        return bytearray(), kind
    if data.startswith(_UTF8_MARK):
        del data[: len(_UTF8_MARK)]
    return data, fault


def unpacked_bytes(path: Path) -> tuple[bytearray, str | None]:
    """The bytes of a file, unpacked if they are gzip. The function also returns the text of the error that ended the
    unpacking; None if there was no error.

    Raises:
        OSError, ValueError: as for :func:`read_text_bytes`.
    """
    data = read_regular(path, MOST_BYTES)
    # If a reserved flag is set (in the fourth byte, RFC 1952), the file is not gzip.
    if data.startswith(_GZIP_MAGIC) and data[3:4] < b"\x20":
        return _gunzip(data)
    return data, None


def _gunzip(packed: bytearray) -> tuple[bytearray, str | None]:
    """Unpack a gzip stream, which may have several members, up to its first error. The function also returns the error,
    or None if there is none."""
    most = allowed_bytes(len(packed), FREE_BYTES)
    view = memoryview(packed)
    plain = bytearray()
    position = 0
    while position < len(view):
        inflate = zlib.decompressobj(wbits=_WBITS_GZIP)
        while not inflate.eof:
            chunk = view[position : position + _GZIP_CHUNK]
            if not chunk:
                return plain, "the gzip data is cut off; the plans before the cut are read"
            before = inflate.copy()
            try:
                plain += inflate.decompress(chunk)
            except zlib.error as error:
                _inflate_bytewise(before, chunk, plain)
                return plain, f"the gzip data is damaged ({error}); the plans before the damage are read"
            if len(plain) > most:
                return bytearray(), f"the gzip data unpacks to more than {size(most)}, too much for a plan file"
            position += len(chunk) - len(inflate.unused_data)
        if not any(view[position : position + _GZIP_CHUNK]):
            break  # the last gzip member may be followed by zeros as padding
    return plain, None


def _inflate_bytewise(inflate: zlib._Decompress, chunk: memoryview, plain: bytearray) -> None:
    """Unpack the part of a chunk before its error, byte by byte, because a call that fails returns no output."""
    for position in range(len(chunk)):
        try:
            plain += inflate.decompress(chunk[position : position + 1])
        except zlib.error:
            return


# White space is listed, since JSON has fewer kinds of white space than the class "\s".
# With possessive quantifiers, the time for matching is linear in the length of the text, even if the text is malicious.
_SPACE: Final = re.compile(rb"[ \t\n\r]*+")
_NUL_BYTES: Final = re.compile(rb"\0++")
_KEY: Final = re.compile(rb'("[^"\\]*+(?:\\.[^"\\]*+)*+")[ \t\n\r]*+:[ \t\n\r]*+', re.DOTALL)
_CUT_KEY: Final = re.compile(rb'("[^"\\]*+(?:\\.[^"\\]*+)*+(\\|"[ \t\n\r]*+)?)?\Z', re.DOTALL)
_OTHER_VALUES: Final = {
    rb"\[": "a list",
    rb'"': "a string",
    rb"(true|false)\b": "a boolean",
    rb"null\b": "null",
    rb"-?\d": "a number",
}

_SHOWN_ID: Final = 1000
"""Number of bytes of a damaged plan's id that messages show."""
LONGEST_VALUE: Final = 4 << 20
"""Largest text of one plan, bytes. A plan of BED-BPP takes 10,000 to 25,000 bytes. A decoded plan takes up to 30 times
as much memory as its text."""
_FIRST_WINDOW: Final = 1 << 15
_SMALLEST_WINDOW: Final = 1 << 10
_LONGEST_TOKEN: Final = 12
"""Text is decoded in parts (windows). The end of a window may cut a token, such as ``-Infinity`` or an escape. This is
the length of the longest such token, in characters. Strings and numbers are treated separately."""


class DuplicateFieldObject(dict[str, Any]):
    """A JSON object in which a field is repeated. Of a repeated field, the last value is used.

    Attributes:
        field: the first field that is repeated.
    """

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        names = [name for name, _ in pairs]
        self.field = next(name for number, name in enumerate(names) if name in names[:number])


class MalformedPlans(InputError):
    """Raised if a text is not JSON, or not an object. The error names the plan, the line and the column. Lines and
    columns are counted from 1, columns in bytes."""


class Entry(NamedTuple):
    """The id and the JSON value of one plan or order, before validation."""

    plan_id: str
    value: object


def scan_plans(data: bytes | bytearray, of: str = "plan id → placements", noun: str = "plan") -> Iterator[Entry]:
    """Yield every entry in a file's bytes, in order.

    Args:
        of: what messages say that the file's object must contain.
        noun: what messages call an entry, such as "plan".

    Raises:
        MalformedPlans: a part of the text is not JSON, or the file is empty or has no object. Entries before the
            damaged part are yielded before the error is raised. The error does not name the file.
    """
    at = _after_space(data, 0)
    if at == len(data):
        raise MalformedPlans("the file is empty")
    for pattern, kind in _OTHER_VALUES.items():
        if re.compile(pattern).match(data, at):
            raise MalformedPlans(f"the top level must be an object of {of}, got {kind}")
    if data[at : at + 1] != b"{":
        raise _not_json(data, at, "expected {")
    at = _after_space(data, at + 1)
    a_noun = f"an {noun}" if noun.startswith("o") else f"a {noun}"
    window = _FIRST_WINDOW
    has_more = data[at : at + 1] != b"}"
    while has_more:
        key = _KEY.match(data, at)
        if key is None:
            cut_off = _CUT_KEY.match(data, at) is not None
            end_fault = f"the file ends before {a_noun}; truncated?"
            raise _not_json(data, at, end_fault if cut_off else "expected a name in quotation marks")
        where = f"{noun} {printable_id(_text(key[1][1:-1][:_SHOWN_ID]))}: "
        plan_id = _decoded_id(data, key, where)
        value, end = _decoded_value(data, key.end(), window, where, noun)
        window = min(max(2 * (end - key.end()), _SMALLEST_WINDOW), LONGEST_VALUE)
        yield Entry(plan_id, value)
        del value
        at = _after_space(data, end)
        has_more = data[at : at + 1] == b","
        if has_more:
            at = _after_space(data, at + 1)
        elif data[at : at + 1] != b"}":
            cut_off = at == len(data)
            raise _not_json(data, at, "the file ends without a closing }; truncated?" if cut_off else "expected , or }")
    at = _after_space(data, at + 1)
    if at < len(data):
        raise _not_json(data, at, "more text after the closing }")


def _decoded_id(data: bytes | bytearray, key: re.Match[bytes], where: str) -> Any:
    if len(key[1]) > LONGEST_VALUE:
        raise _not_json(data, key.start(1), f"an id longer than {size(LONGEST_VALUE)}", where)
    try:
        return _DECODER.decode(_text(key[1]))
    except json.JSONDecodeError as error:
        raise _not_json(data, key.start(1) + error.pos, json_fault(error), where) from error


def _decoded_value(data: bytes | bytearray, begin: int, window: int, where: str, noun: str) -> tuple[Any, int]:
    """Decode one JSON value. Returns the value and the position of its end.

    The decoder receives a window (a part) of the text, and a larger window if the value does not fit. Small windows
    save time, since the decoder counts all lines of the window for an error. Small windows also save memory, since text
    that is not ASCII takes up to four times its size while it is decoded.

    Args:
        begin: position of the value.
        window: length of the first window, bytes. Callers pass twice the length of the previous value, so that the
            total length of all windows is linear in the length of the text.
        where: name of the entry, for errors.
        noun: what messages call an entry, such as "plan".
    """
    while True:
        text = _text(data[begin : begin + window])
        reaches_end = begin + window >= len(data)
        try:
            value, end = json_value(json.JSONDecoder.raw_decode, text)
        except json.JSONDecodeError as error:
            cut_off = error.pos >= len(text) - (0 if reaches_end else _LONGEST_TOKEN) or error.msg.startswith(
                "Unterminated"
            )
            if reaches_end or not cut_off:
                fault = f"the file ends inside this {noun}; truncated?" if cut_off else json_fault(error)
                raise _not_json(data, begin + _n_bytes(text, error.pos), fault, where) from error
        except RecursionError as error:
            raise _not_json(data, begin, "nested too deeply", where) from error
        else:
            if reaches_end or end < len(text):
                return value, begin + _n_bytes(text, end)
        if window >= LONGEST_VALUE:
            raise MalformedPlans(f"{where}longer than {size(LONGEST_VALUE)}; nothing of this file is read")
        window = min(4 * window, LONGEST_VALUE)


def json_fault(error: json.JSONDecodeError) -> str:
    """The fault that Python's decoder reports, without the place of the fault, which petmjx's message gives itself."""
    return "more text after its end" if error.msg == "Extra data" else error.msg.removesuffix(" at")


def _not_json(data: bytes | bytearray, at: int, fault: str, where: str = "") -> MalformedPlans:
    line, column = data.count(b"\n", 0, at) + 1, at - data.rfind(b"\n", 0, at)
    if (zeros := _NUL_BYTES.match(data, at)) is not None:
        fault = count_text(len(zeros[0]), "NUL byte")
        fault += "; was the file written whole?" if zeros.end() == len(data) else ""
    return MalformedPlans(f"{where}not JSON at line {line}, column {column} ({fault}); nothing of this file is read")


def _after_space(data: bytes | bytearray, position: int) -> int:
    match = _SPACE.match(data, position)
    assert match is not None
    return match.end()


def _text(data: bytes | bytearray) -> str:
    """Decode bytes to text. Bytes that are not UTF-8 become lone surrogates.

    As a result, the JSON around such bytes can still be read, and a plan whose name has such bytes can be named in
    errors.
    """
    return data.decode("utf-8", "surrogateescape")


def _n_bytes(text: str, n_characters: int) -> int:
    """The number of bytes of the first characters of a text."""
    return n_characters if text.isascii() else len(text[:n_characters].encode("utf-8", "surrogateescape"))


def _any_integer(digits: str) -> int | float:
    """Convert an integer of any length. An integer too large for float64 becomes infinite, and a later check refuses it
    as not finite."""
    return int(digits) if len(digits) < 400 else float(digits)


def _json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object from its fields, in order. If a field is repeated, the result is a ``DuplicateFieldObject``."""
    members = dict(pairs)
    return members if len(members) == len(pairs) else DuplicateFieldObject(pairs)


_DECODER: Final = json.JSONDecoder(object_pairs_hook=_json_object)
_PATIENT_DECODER: Final = json.JSONDecoder(object_pairs_hook=_json_object, parse_int=_any_integer)


def json_value(decode: Callable[[json.JSONDecoder, str], Value], text: str) -> Value:
    """The value of a JSON text. Python refuses integers of more than 4,300 digits; here, a later check refuses them as
    not finite, so that a plan with such an integer is named.

    Args:
        decode: the method of Python's decoder that decodes the text.
    """
    try:
        return decode(_DECODER, text)
    except json.JSONDecodeError:
        raise
    except ValueError:
        return decode(_PATIENT_DECODER, text)
