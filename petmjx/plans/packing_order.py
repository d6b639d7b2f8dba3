"""The packing order of a plan's boxes: from a column, from the order of rows, or from the ground up."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, gaps_mm


def packing_order(
    columns: BoxColumns, rows: NDArray[np.int64], low: FloatArray, size: FloatArray, notes: list[str]
) -> tuple[NDArray[np.int64], str, str]:
    """(n,) packing order of a plan's rows, from 1; the source of this order ("sequence", "rows" or "height"); and the
    name of the column of running numbers that is used as packing order ("": none). Adds notes to ``notes``."""
    if columns.sequence is not None:
        return columns.sequence[rows].astype(np.int64), "sequence", ""
    order = np.arange(1, len(rows) + 1)
    possible = _can_be_placed(order, low, size)
    for name, values in columns.counters.items():
        counted = values[rows]
        if np.isnan(counted).any() or not _counts_all(counted) or not (np.diff(counted) != 1).any():
            continue  # some boxes have no number, or the numbers only repeat the order of the rows
        if not _can_be_placed(counted, low, size):
            continue
        if not possible:
            notes.append(f"packing order by {printable_name(name)}: rows are not in packing order")
            return counted.astype(np.int64), "sequence", name
        notes.append(
            f"{printable_name(name)} may be the packing order, too (--columns sequence={printable_name(name)})"
        )
    if not possible:
        order[np.argsort(low[:, 2], kind="stable")] = np.arange(1, len(rows) + 1)
        return order, "height", ""
    return order, "rows", ""


def repeated_number(columns: BoxColumns, rows: NDArray[np.int64]) -> str | None:
    """The fault of a plan's packing order: a number that is repeated or is not whole. None if there is no fault."""
    sequence, places = columns.sequence, columns.source.boxes.table.places
    if sequence is None:
        return None
    name, first_rows = columns.columns["sequence"], dict[float, int]()
    for row in rows.tolist():
        value = float(sequence[row])
        if not value.is_integer():
            return f"{places[row]}: {name} must be a whole number, got {value:g}"
        if value in first_rows:
            plans = "" if columns.plan else "; several plans? then name their column: --columns plan=NAME"
            return f"{places[first_rows[value]]} and {places[row]}: {name} {value:g} occurs twice{plans}"
        first_rows[value] = row
    return None


def _counts_all(values: FloatArray) -> bool:
    """Whether the n numbers are 0, 1, … n − 1 or 1, 2, … n, each once and in any order."""
    return bool((np.sort(values) - np.arange(len(values)) == min(max(float(values.min()), 0.0), 1.0)).all())


def _can_be_placed(order: NDArray[Any], low: FloatArray, size: FloatArray) -> bool:
    """Whether, in this packing order, each box that lies on other boxes is placed after at least one of the boxes below
    it."""
    by_order = np.argsort(order, kind="stable")
    low, size = low[by_order], size[by_order]
    in_order = gaps_mm(low, size) > DEFAULT_TOLERANCE_MM
    at_all = gaps_mm(low, size, in_order=False) > DEFAULT_TOLERANCE_MM
    return not (in_order & ~at_all).any()
