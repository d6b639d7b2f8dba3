"""Boxes in NumPy arrays: one row per box, or one array per field."""

from __future__ import annotations

import io
import math
import re
import tokenize
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.common.unreadable_files import DAMAGED_ZIP
from petmjx.plans.column_names import known_meanings
from petmjx.plans.known_forms import ARRAY, MOST_BYTES, POSES, BoxSource, with_known_form
from petmjx.plans.raw_tables import BoxList, RawTable, united, with_titles
from petmjx.plans.workbooks import check_archive


def loaded_array(data: bytes | bytearray, name: str = "") -> Any:
    """Load an array from .npy bytes. Before memory is reserved, the size in the array's header is compared with the
    number of bytes.

    Args:
        name: name of the array in its archive, for error messages; "" if the file is not an archive but a single array.
    """
    prefix = f"{printable_name(name)} " if name else ""
    stream = io.BytesIO(data)
    try:
        # versions 2 and 3 differ only in the encoding of the names of fields
        is_first = npy.read_magic(stream) == (1, 0)
        shape, _, dtype = (npy.read_array_header_1_0 if is_first else npy.read_array_header_2_0)(stream)
        if min(shape, default=0) < 0:
            raise ValueError("shape")
    except _DAMAGED:
        raise InputError(f"{prefix}is no whole NumPy array: its header cannot be read") from None
    if dtype.hasobject:
        raise InputError(f"{prefix}is an array of Python objects, which may hold code, and is not read")
    n_bytes = len(data) - stream.tell()
    expected = math.prod(shape) * dtype.itemsize
    if expected != n_bytes:
        raise InputError(
            f"{prefix}is no whole NumPy array: its header (shape {shape}, type {dtype.str}) announces "
            f"{expected:,} bytes, but {count_text(n_bytes, 'byte follows', 'bytes follow')}"
        )
    if math.prod(max(extent, 1) for extent in shape) > MOST_BYTES:
        raise InputError(f"{prefix}is an array {shape} without values")
    stream.seek(0)
    try:
        array = np.load(stream, allow_pickle=False)
    except _DAMAGED as error:
        raise InputError(f"{prefix}is not a whole NumPy array: {error}") from error
    for path, values in _arrays_in(array):
        is_text = values.dtype.kind == "U" and values.size
        if is_text and (bad := np.argwhere(_code_points(values) > _LAST_CODE_POINT)).size:
            raise InputError(f"{prefix}row {bad[0, 0]}: {printable_name(path) or 'its text'} is damaged")
    return array


_DAMAGED: Final = (
    *(ValueError, TypeError, KeyError, IndexError, SyntaxError, tokenize.TokenError),
    *(MemoryError, RecursionError, OSError, EOFError),
)
"""Exceptions that NumPy raises for a damaged array."""
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


def loaded_arrays(data: bytes | bytearray) -> dict[str, Any]:
    check_archive(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist() if name.endswith(".npy")}
    except DAMAGED_ZIP as error:
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
