"""Boxes in Python objects: py3dbp's packers, arrays, nested dictionaries, and data frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.header_names import distinct_names
from petmjx.plans.known_forms import PY3DBP, BoxSource, with_known_form
from petmjx.plans.nested_json import box_lists
from petmjx.plans.numpy_arrays import sources_of_arrays
from petmjx.plans.printed_values import PY3DBP_COLUMNS
from petmjx.plans.raw_cells import cell_number, decimal_of
from petmjx.plans.raw_tables import BoxList, RawTable, not_placed


def sources_of_object(value: Any) -> list[BoxSource]:
    """The boxes in a Python object: py3dbp's packer, bin or list of bins; an array; nested dictionaries and lists.

    Raises:
        InputError: the object holds no boxes.
    """
    if isinstance(value, np.ndarray):
        return sources_of_arrays({"": value})
    bins = _bins_of(value)
    if bins:
        return [_of_bins(bins)]
    if isinstance(value, Mapping) and value and all(isinstance(inner, np.ndarray) for inner in value.values()):
        return sources_of_arrays(value)
    sources = [with_known_form(boxes, "Python values") for boxes in box_lists(value)]
    if not sources:
        raise InputError("holds no boxes: petmjx looks for objects with places and sizes")
    return sources


def sources_of_frame(frame: Any) -> list[BoxSource]:
    """The boxes of a data frame whose columns do not have petmjx's names. Rows are numbered from 0.

    Raises:
        NoBoxes: the frame is not a table.
        InputError: two columns have the same known name.
    """
    try:
        if hasattr(frame, "iloc") and hasattr(frame, "columns"):
            header = tuple(str(name) for name in frame.columns)
            rows = [tuple(_plain(cell) for cell in row) for row in frame.itertuples(index=False, name=None)]
        else:
            import pyarrow as pa

            table = pa.table(frame)
            while any(pa.types.is_struct(field.type) for field in table.schema):
                table = table.flatten()
            header = tuple(table.column_names)
            rows = list(zip(*(column.to_pylist() for column in table.columns), strict=True))
    except Exception as error:  # for an object that is no table, Arrow may raise any exception
        raise NoBoxes(f"is no table: {type(error).__name__}") from None
    places = [f"row {number}" for number in range(len(rows))]
    raw = RawTable(tuple(distinct_names(header)), rows, places, decimal_of(rows))
    return [with_known_form(BoxList(raw), "a data frame")]


def _plain(cell: Any) -> Any:
    """A cell of pandas as a Python value; None if it is missing."""
    cell = cell.item() if isinstance(cell, np.generic) else cell
    is_missing = type(cell).__name__ in _MISSING or (isinstance(cell, float) and np.isnan(cell))
    return None if is_missing else cell


_MISSING: Final = ("NoneType", "NAType", "NaTType")
"""Names of the types of missing cells. Comparing with pandas' types would need an import of pandas."""


def _bins_of(value: Any) -> list[Any]:
    """The bins among py3dbp's objects; empty for any other object."""
    if isinstance(value, Mapping | str | bytes | np.ndarray) or value is None:
        return []
    if isinstance(value, list | tuple):
        bins = [holder for inner in value for holder in _bins_of(inner)]
        return bins if value and all(_bins_of(inner) for inner in value[:3]) else []
    if isinstance(getattr(value, "bins", None), list):
        return [holder for holder in value.bins if getattr(holder, "items", None)]
    items = getattr(value, "items", None)
    if (
        isinstance(items, list)
        and items
        and all(hasattr(items[0], name) for name in ("position", "rotation_type", "width"))
    ):
        return [value]
    return []


def _of_bins(bins: Sequence[Any]) -> BoxSource:
    rows, places, parts = [], [], []
    containers: dict[str, Mapping[str, float]] = {}
    left = 0
    for number, holder in enumerate(bins, start=1):
        name = str(getattr(holder, "name", None) or getattr(holder, "partno", None) or number)
        part = name if len(bins) == 1 or name not in containers else f"{name} ({number})"
        containers[part] = {axis: float(getattr(holder, axis)) for axis in ("width", "height", "depth")}
        left += len(getattr(holder, "unfitted_items", None) or ())
        for index, item in enumerate(holder.items):
            position = list(item.position)
            label = getattr(item, "name", None) or getattr(item, "partno", None) or ""
            cells = (item.width, item.height, item.depth, getattr(item, "weight", None), *position, item.rotation_type)
            rows.append((str(label), *(cell_triple_value(cell) for cell in cells)))
            places.append(f"bin {name}, item {index}")
            parts.append(part)
    table = RawTable(PY3DBP_COLUMNS, rows, places)
    boxes = BoxList(table, "", tuple(parts), containers, not_placed(left))
    return BoxSource(boxes, replace(PY3DBP, name="py3dbp's objects"))


def cell_triple_value(value: Any) -> Any:
    """A number of a Python object as a float. Other values are returned unchanged."""
    number = cell_number(value)
    return value if number is None else number.value
