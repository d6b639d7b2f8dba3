"""Boxes in NumPy arrays: one row per box, or one array per field."""

from __future__ import annotations

import ast
import io
import math
import re
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.plans.column_names import known_meanings
from petmjx.plans.known_forms import ARRAY, MOST_BYTES, POSES, BoxSource, with_known_form
from petmjx.plans.raw_tables import BoxList, RawTable, united, with_titles
from petmjx.plans.workbooks import check_archive

_MOST_HEADER: Final = 10_000
"""Largest length of an array's header in bytes, as in NumPy."""


def loaded_array(data: bytes | bytearray, name: str = "") -> Any:
    """Load an array from .npy bytes. Before memory is reserved, the size in the array's header is compared with the
    number of bytes.

    Args:
        name: name of the array in its archive, for error messages; "" if the file is not an archive but a single array.
    """
    prefix = f"{printable_name(name)} " if name else ""
    try:
        dtype, shape, begin = _array_header(data)
    except (ValueError, TypeError, SyntaxError, KeyError, IndexError, struct.error, MemoryError, RecursionError):
        raise InputError(f"{prefix}is no whole NumPy array: its header cannot be read") from None
    if dtype.hasobject:
        raise InputError(f"{prefix}is an array of Python objects, which may hold code, and is not read")
    n_bytes = len(data) - begin
    expected = math.prod(shape) * dtype.itemsize
    if expected != n_bytes:
        raise InputError(
            f"{prefix}is no whole NumPy array: its header (shape {shape}, type {dtype.str}) announces "
            f"{expected:,} bytes, but {count_text(n_bytes, 'byte follows', 'bytes follow')}"
        )
    if math.prod(max(extent, 1) for extent in shape) > MOST_BYTES:
        raise InputError(f"{prefix}is an array {shape} without values")
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError, tokenize.TokenError) as error:
        raise InputError(f"{prefix}is not a whole NumPy array: {error}") from error
    for path, values in _arrays_in(array):
        is_text = values.dtype.kind == "U" and values.size
        if is_text and (bad := np.argwhere(_code_points(values) > _LAST_CODE_POINT)).size:
            raise InputError(f"{prefix}row {bad[0, 0]}: {printable_name(path) or 'its text'} is damaged")
    return array


_LAST_CODE_POINT: Final = 0x10FFFF
"""Largest code point of Unicode. A text in an array is damaged if it has a larger code point; Python cannot show it."""


def _arrays_in(array: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, array) for an array, or for all fields of a structured array."""
    if not array.dtype.names:
        yield path, array
    for name in array.dtype.names or ():
        yield from _arrays_in(array[name], f"{path}.{name}" if path else name)


def _code_points(texts: Any) -> Any:
    """The codes of all characters in an array of texts; the first axis is the axis of the texts."""
    flat = np.ascontiguousarray(texts).reshape(len(texts) if texts.ndim else 1, -1)
    return flat.view(np.dtype(np.uint32).newbyteorder(flat.dtype.byteorder))


def _array_header(data: bytes | bytearray) -> tuple[np.dtype[Any], tuple[int, ...], int]:
    """The type, the shape and the position of the first value in .npy bytes (NumPy's format, versions 1 to 3).

    Raises:
        ValueError, TypeError, SyntaxError, KeyError, IndexError, struct.error: the header is damaged.
    """
    width = "<H" if data[6] == 1 else "<I"
    first = 8 + struct.calcsize(width)
    (length,) = struct.unpack_from(width, data, 8)
    if length > _MOST_HEADER or first + length > len(data) or not data.startswith(b"\x93NUMPY"):
        raise ValueError("header")
    fields = ast.literal_eval(bytes(data[first : first + length]).decode("utf-8" if data[6] > 2 else "latin1"))
    shape = fields["shape"]
    if not isinstance(shape, tuple) or any(type(extent) is not int or extent < 0 for extent in shape):
        raise ValueError("shape")
    return np.lib.format.descr_to_dtype(fields["descr"]), shape, first + length


def loaded_arrays(data: bytes | bytearray) -> dict[str, Any]:
    check_archive(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist() if name.endswith(".npy")}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        raise InputError(f"is not a whole archive of NumPy arrays: {error}") from error
    return {name.removesuffix(".npy"): loaded_array(member, name) for name, member in members.items()}


def sources_of_arrays(arrays: Mapping[str, Any]) -> list[BoxSource]:
    """Turn arrays into lists of boxes. There may be one array with a row per box, or several arrays that each have a
    row per box.

    Raises:
        InputError: no array has rows that are boxes.
    """
    row_arrays = {name: array for name, array in arrays.items() if getattr(array, "ndim", 0) >= 1}
    for name, array in row_arrays.items():
        if array.dtype.names:
            return [with_known_form(BoxList(_table(_cells_of({"": array.ravel()}), name), name), "a NumPy array")]
    containers = _containers_in(arrays)
    columns = {
        name: array
        for name, array in row_arrays.items()
        if (array.ndim <= 2 or array.shape[1:] in ((4, 4), (3, 4))) and not _is_container(name, array)
    }
    lengths = Counter(len(array) for array in columns.values())
    if len(columns) > 1 and lengths and column_names_known(columns):
        n_rows = lengths.most_common(1)[0][0]
        cells = _cells_of({name: array for name, array in columns.items() if len(array) == n_rows})
        return [with_known_form(BoxList(_table(cells), containers=containers), "NumPy arrays")]
    sources = []
    for name, array in row_arrays.items():
        if _is_container(name, array) or array.dtype.kind not in "fiu":
            continue
        if array.ndim == 3 and array.shape[1:] in ((4, 4), (3, 4)):
            boxes = BoxList(_table({"matrix": array.tolist()}, name), name, containers=containers)
            sources.append(BoxSource(boxes, POSES))
            continue
        if array.shape[1:] == (2, 3):  # sizes and places, or two corners, of each box
            array = array.reshape(len(array), 6)
        plans = array if array.ndim == 3 else array[None] if array.ndim == 2 else None
        if plans is None or not 6 <= plans.shape[2] <= 64:
            continue
        rows, places, parts = [], [], []
        for number, plan in enumerate(plans.tolist()):
            used = [index for index, row in enumerate(plan) if any(row)]
            # rows of zeros at the end are no boxes: they fill up an array of fixed length
            for index in range(used[-1] + 1 if used else 0):
                rows.append(tuple(plan[index]))
                places.append(f"row {index}" if array.ndim == 2 else f"plan {number}, row {index}")
                parts.append("" if array.ndim == 2 else str(number))
        if len(row_arrays) > 1:
            parts = ["/".join(filter(None, (name, part))) for part in parts]
        header = tuple(f"column {index}" for index in range(plans.shape[2]))
        table = RawTable(header, rows, places, title=name, has_header=False)
        sources.append(BoxSource(BoxList(table, name, tuple(parts), containers), ARRAY))
    if not sources:
        shapes = ", ".join(f"{name or 'array'} {getattr(array, 'shape', ())}" for name, array in arrays.items())
        raise InputError(
            f"holds no array of boxes, whose shape must be (n, 6 to 64); the file has {printable_name(shapes)}"
        )
    return _as_plans(sources)


def _table(cells: Mapping[str, list[Any]], title: str = "") -> RawTable:
    """A table from the names and cells of its columns."""
    rows = list(zip(*cells.values(), strict=True))
    return RawTable(tuple(cells), rows, [f"row {index}" for index in range(len(rows))], title=title)


def _as_plans(sources: Sequence[BoxSource]) -> list[BoxSource]:
    """Lists of boxes, longest first. Lists with the same columns are joined into one list of several plans."""
    groups: dict[tuple[str, ...], list[BoxSource]] = {}
    for source in sources:
        groups.setdefault(source.boxes.table.header, []).append(source)
    joined = []
    for group in groups.values():
        table = united(with_titles([source.boxes.table for source in group]))
        parts = tuple(part for source in group for part in source.boxes.parts)
        joined.append(replace(group[0], boxes=replace(group[0].boxes, table=table, parts=parts)))
    return sorted(joined, key=lambda source: len(source.boxes.table.rows), reverse=True)


def column_names_known(columns: Mapping[str, Any]) -> bool:
    """Whether the names of some arrays are known names of sizes, and the names of other arrays are known names of
    places. An array of matrices has places whatever its name is."""
    names = [name if array.ndim == 1 else f"{name}[0]" for name, array in columns.items()]
    kinds = {meaning.kind for meaning in known_meanings(names).values()}
    posed = any(array.ndim == 3 for array in columns.values())
    return (posed or bool(kinds & {"position", "low"})) and bool(kinds & {"size", "high"})


def _cells_of(arrays: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Name → cells, for arrays with a row per box. Arrays that have fields or several numbers per row become several
    columns, except matrices."""
    fields: dict[str, list[Any]] = {}
    for path, values in arrays.items():
        if values.dtype.names and values.ndim == 1:
            fields |= _cells_of({f"{path}.{name}".lstrip("."): values[name] for name in values.dtype.names})
        elif values.ndim == 1 or values.shape[1:] in ((3, 3), (3, 4), (4, 4)):
            cells = values.tolist()
            fields[path] = [cell.decode("utf-8", "replace") if isinstance(cell, bytes) else cell for cell in cells]
        else:
            flat = values.reshape(len(values), -1)
            fields |= {f"{path}[{index}]": flat[:, index].tolist() for index in range(flat.shape[1])}
    return fields


def _is_container(name: str, array: Any) -> bool:
    """Whether an array has the sizes of containers. An array with one number per box does not have sizes: it gives the
    pallet on which each box stands."""
    named = re.search(r"bin|container|pallet", name, re.IGNORECASE) and not re.search(r"id", name, re.IGNORECASE)
    return bool(named) and (array.ndim > 1 or array.size <= 3)


def _containers_in(arrays: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    for name, array in arrays.items():
        if getattr(array, "size", 0) == 3 and _is_container(name, array):
            return {"": {str(axis): float(value) for axis, value in enumerate(np.ravel(array))}}
    return {}
