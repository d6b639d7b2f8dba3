"""Single worlds in a run's tables, without reading the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from petmjx.metrics.spec import BoxMetrics, box_metrics, world_metrics
from petmjx.results.reader import RunResults
from petmjx.results.schema import data_frame, schemas
from petmjx.verdict import Flag, Outcome, Reason, Verdict

_NAMES_WORLDS: Final = {"histories": "frames", "frames": "frames", "contacts": "frames"}
"""Table → the table whose parts of the same numbers say which worlds it has; ``worlds`` for all others."""


def world_row(run: RunResults, plan_id: str, variant: int) -> dict[str, Any] | None:
    """A world's row of ``worlds``, column → value, null as None; None where there is no such world."""
    rows = rows_of(run, "worlds", plan_id, variant)
    return None if rows is None else dict(rows.to_pylist()[0])


def read_outcome(run: RunResults, plan_id: str, variant: int) -> Outcome | None:
    """A world's outcome, as far as the tables have it; None where there is no such world.

    Values of boxes that were never placed are NaN, and measured ones have the precision of the table ``boxes``.
    """
    row = world_row(run, plan_id, variant)
    boxes = rows_of(run, "boxes", plan_id, variant)
    if row is None or boxes is None:
        return None
    table = boxes.sort_by("box")
    values: dict[str, Any] = {}
    for metric in box_metrics():
        column_names = [name for name in metric.columns if name in table.column_names]
        columns = [table[name].to_numpy().astype(np.float64) for name in column_names] or [np.full(len(table), np.nan)]
        values[metric.attribute] = np.stack(columns, axis=1) if len(columns) > 1 else columns[0]
    values["dropped"] = values["dropped"] > 0
    cells: dict[str, Any] = {name: row[name] for name in ("n_boxes", "n_placed", "solver", "attempt")}
    for of_world in world_metrics():
        value = row.get(of_world.name)  # a run of an earlier version may not have it
        nothing = -1 if of_world.numbers else math.nan
        cells[of_world.name] = nothing if value is None else value
    return Outcome(
        job=0,
        verdict=Verdict(row["verdict"]),
        reason=Reason(row["reason"]),
        culprit=-1 if row["culprit"] is None else row["culprit"],
        flags=Flag(row["flags"]),
        boxes=BoxMetrics(**values),
        **cells,
    )


def rows_of(run: RunResults, table: str, plan_id: str, variant: int) -> pa.Table | None:
    """A world's rows of a table of a run; None where it has none.

    Raises:
        InputError: a damaged or missing part.
    """
    of_table = {file.name: file for file in run.parts.files(table)}
    for file in run.parts.files(_NAMES_WORLDS.get(table, "worlds")):
        if len(_only(run.parts.read(file, ("plan_id", "variant")), plan_id, variant)):
            table_file = of_table.get(file.name)  # parts with the same number belong together
            rows = None if table_file is None else _only(run.parts.read(table_file), plan_id, variant)
            return rows if rows is not None and len(rows) else None
    return None


def rows_of_worlds(run: RunResults, table: str, worlds: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """The rows of some worlds in a table of a run, part by part: the rest is never in memory.

    Args:
        worlds: ``plan_id`` and ``variant`` of each.
        columns: of the table.

    Raises:
        InputError: a damaged or missing part.
    """
    plan_ids = pa.array(worlds["plan_id"].unique(), pa.string())

    def keys(plan_id: pa.Array, variant: pa.Array) -> NDArray[np.int64]:
        place = np.asarray(pc.fill_null(pc.index_in(plan_id, value_set=plan_ids), -1), dtype=np.int64)
        return np.where(place < 0, -1, (place << 32) + np.asarray(variant, dtype=np.int64))

    world_keys = keys(pa.array(worlds["plan_id"], pa.string()), pa.array(worlds["variant"], pa.int32()))
    part_rows = []
    for file in run.parts.files(table):
        part = run.parts.read(file, ("plan_id", "variant"))
        rows = np.flatnonzero(np.isin(keys(part["plan_id"], part["variant"]), world_keys))
        if len(rows):
            part_rows.append(run.parts.read(file, columns).take(rows))
    none = schemas()[table].empty_table().select([name for name in columns if name in schemas()[table].names])
    return data_frame(pa.concat_tables(part_rows or [none], promote_options="default"))


def _only(part: pa.Table, plan_id: str, variant: int) -> pa.Table:
    """The rows of one world."""
    return part.filter(pc.and_(pc.equal(part["plan_id"], plan_id), pc.equal(part["variant"], variant)))
