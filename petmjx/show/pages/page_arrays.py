"""Compact arrays in a page: deflated bytes in base64, which ``petmjx/show/pages/static/page_data.js`` reads.

A *block* is a text that contains several arrays. The bytes of a block are the length of the header (4 bytes), the
header (JSON, padded with spaces), and the arrays. Each array begins at a multiple of 8 bytes. All numbers are
little-endian. The bytes are deflated (zlib) and encoded in base64.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_TYPES: Final = {"int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"}
_MISSING: Final = -32768
"""The int16 number that represents NaN."""
_LARGEST: Final = 32767
_ALIGNED: Final = 8


@dataclass(frozen=True, eq=False)
class PackedArray:
    """An array as stored in a block.

    The original numbers are ``values`` × ``scale`` + ``offset``. If ``steps`` is True, each row along axis 0 is the
    difference from the row before, modulo the range of the type. If values change slowly along axis 0, their
    differences deflate better than the values themselves.
    """

    values: NDArray[Any]
    scale: float | None = None
    offset: float = 0.0
    steps: bool = False


def quantised_column(values: NDArray[np.floating[Any]], steps: bool = False) -> PackedArray:
    """Store floats as int16. The range of the floats is divided into 65,534 equal parts, so errors are at most half a
    part. NaN stays NaN.

    Args:
        values: floats of any shape. Infinities become NaN.
        steps: whether to store differences along axis 0. Differences suit values that change slowly along axis 0.
    """
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
    offset = (low + high) / 2
    scale = (high - low) / (2 * _LARGEST) or 1.0
    parts = np.full(values.shape, _MISSING, dtype=np.int16)
    parts[finite] = np.clip(np.rint((values[finite] - offset) / scale), -_LARGEST, _LARGEST).astype(np.int16)
    return PackedArray(_differences(parts) if steps else parts, scale, offset, steps)


def integer_column(values: NDArray[np.integer[Any]], steps: bool = False) -> PackedArray:
    """Store whole numbers in the smallest type that can hold them.

    Raises:
        ValueError: a number needs more than 32 bits.
    """
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    for name in ("uint8", "int8", "uint16", "int16", "uint32", "int32"):
        if np.iinfo(name).min <= low and high <= np.iinfo(name).max:
            narrow = values.astype(name)
            return PackedArray(_differences(narrow) if steps else narrow, steps=steps)
    raise ValueError(f"whole numbers from {low} to {high} do not fit into 32 bits")


def _differences(values: NDArray[Any]) -> NDArray[Any]:
    """Differences along axis 0, modulo the range of the type. The first row is unchanged."""
    out = values.copy()
    out[1:] -= values[:-1]
    return out


def block(columns: Mapping[str, NDArray[Any] | PackedArray]) -> str:
    """The text of a block with the given arrays (name → array). Arrays that are not a ``PackedArray`` are stored
    unchanged.

    Raises:
        ValueError: an array has a type other than floats and integers of up to 32 bits.
    """
    header: list[dict[str, Any]] = []
    body = bytearray()
    for name, column in columns.items():
        packed = column if isinstance(column, PackedArray) else PackedArray(column)
        values = np.ascontiguousarray(packed.values)
        if values.dtype.name not in _TYPES:
            raise ValueError(f"{name}: a page cannot hold arrays of {values.dtype}")
        entry: dict[str, Any] = {"name": name, "type": values.dtype.name, "shape": values.shape, "at": len(body)}
        if packed.scale is not None:
            entry |= {"scale": packed.scale, "offset": packed.offset}
        header.append(entry | ({"steps": True} if packed.steps else {}))
        body += values.astype(values.dtype.newbyteorder("<")).tobytes()
        body += bytes(-len(body) % _ALIGNED)
    head = json.dumps(header, allow_nan=False).encode()
    head += b" " * (-(len(head) + 4) % _ALIGNED)
    raw = len(head).to_bytes(4, "little") + head + bytes(body)
    return base64.b64encode(zlib.compress(raw)).decode("ascii")
