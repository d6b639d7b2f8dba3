"""The bytes of a JSON or CSV file: within bounds, unpacked if gzipped, and what is wrong with the file as a whole."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Final

from petmjx.basics.bounded import FREE_BYTES, MOST_BYTES, MOST_RATIO, read_regular, size
from petmjx.plans.foreign import foreign_kind

_GZIP_MAGIC: Final = b"\x1f\x8b\x08"
_GZIP_CHUNK: Final = 1 << 14
_WBITS_GZIP: Final = 31
_UTF16_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")
_UTF8_MARK: Final = b"\xef\xbb\xbf"


def read_text_bytes(path: Path) -> tuple[bytearray, str | None]:
    """A file's text as bytes, and what is wrong with the file as a whole (None: nothing).

    Gzip is recognised by content, not by name. Memory: the packed and the plain bytes, once each.

    Raises:
        OSError: it cannot be read, is no regular file, or is too large.
        ValueError: a name that no file can have.
    """
    data, fault = read_regular(path, MOST_BYTES), None
    if data.startswith(_GZIP_MAGIC) and data[3:4] < b"\x20":  # no reserved flag is set (RFC 1952)
        data, fault = _gunzip(data)
    if data.startswith(_UTF16_MARKS) and b"\0" in data[2:4]:
        return bytearray(), "is UTF-16 text; plans must be UTF-8"
    if (kind := foreign_kind(data)) is not None:
        return bytearray(), kind
    if data.startswith(_UTF8_MARK):
        del data[: len(_UTF8_MARK)]
    return data, fault


def _gunzip(packed: bytearray) -> tuple[bytearray, str | None]:
    """Unpack the sound part of a gzip stream (of one or more members), and say what is wrong if that is not all."""
    most = min(MOST_BYTES, max(FREE_BYTES, MOST_RATIO * len(packed)))
    view = memoryview(packed)
    plain = bytearray()
    position = 0
    while position < len(view):
        inflate = zlib.decompressobj(wbits=_WBITS_GZIP)
        while not inflate.eof:
            chunk = view[position : position + _GZIP_CHUNK]
            if not chunk:
                return plain, "the gzip data is cut off; plans up to there are read"
            before = inflate.copy()
            try:
                plain += inflate.decompress(chunk)
            except zlib.error as error:
                _inflate_bytewise(before, chunk, plain)
                return plain, f"the gzip data is damaged ({error}); plans up to there are read"
            if len(plain) > most:
                return bytearray(), f"the gzip data unpacks to more than {size(most)}, too much for a plan file"
            position += len(chunk) - len(inflate.unused_data)
        if not any(view[position : position + _GZIP_CHUNK]):
            break  # gzip members may be followed by padding
    return plain, None


def _inflate_bytewise(inflate: zlib._Decompress, chunk: memoryview, plain: bytearray) -> None:
    """Add the sound beginning of a chunk with an error in it: a failing call returns none of its output."""
    for position in range(len(chunk)):
        try:
            plain += inflate.decompress(chunk[position : position + 1])
        except zlib.error:
            return
