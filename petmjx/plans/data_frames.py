"""Boxes in data frames, and in Parquet files, with the column names of other tools."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from petmjx.plans.cell_numbers import decimal_of
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.header_and_total_rows import distinct_names
from petmjx.plans.known_forms import BoxSource, with_known_form
from petmjx.plans.raw_tables import BoxList, RawTable


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
