"""The table ``placements`` of a run: all fields of its plans, with one row per box.

This table makes the folder of a run complete: the run can be shown and reported even if the files of its plans were
deleted or the folder was moved. If a plan lacks a field, its rows have null in the column of this field. Some fields
can have the value NaN, so NaN is stored as NaN and not as null.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from petmjx.common.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import SPARSE
from petmjx.results.plan_digests import PlanRecord, plan_digest
from petmjx.results.schema import placements_schema
from petmjx.results.table_parts import Parts

PLACEMENTS: Final = "placements"

_TEXTS: Final = {"item_id": "item_ids", "article": "articles", "product_group": "product_groups",
                 "material": "materials", "kind": "kinds"}  # fmt: skip
"""Name of a column → name of the field of ``Plan``."""
_VECTORS: Final = {"size": "size_mm", "corner": "corner_mm", "mass_center": "mass_center_mm"}
_NUMBERS: Final = ("mass_kg", "sequence", "orientation", *SPARSE)


def placements_table(plans: Iterable[Plan]) -> pa.Table | None:
    """Make the table ``placements``. The result is None if a text of the plans cannot be written as UTF-8."""
    plans, schema = list(plans), placements_schema()
    counts = [plan.n_boxes for plan in plans]
    columns: dict[str, Sequence[Any]] = {}
    for name, field in _TEXTS.items():
        columns[name] = [getattr(plan, field) or None for plan in plans]
    for name, field in _VECTORS.items():
        values = [getattr(plan, field) for plan in plans]
        for axis, letter in enumerate("xyz"):
            columns[f"{name}_{letter}_mm"] = [v if v is None else v[:, axis] for v in values]
    for name in _NUMBERS:
        columns[name] = [getattr(plan, name) for plan in plans]
    try:
        plan_ids = pa.array([plan.plan_id for plan in plans], pa.string())
        of_box = plan_ids.take(pa.array(np.repeat(np.arange(len(plans)), np.array(counts, np.intp))))
        arrays = [_array(columns[field.name], counts, field.type) for field in schema if field.name != "plan_id"]
    except (pa.ArrowException, UnicodeError):
        return None
    return pa.Table.from_arrays([of_box, *arrays], schema=schema)


def _array(values: Sequence[Any], counts: Sequence[int], kind: pa.DataType) -> pa.Array:
    """One column of the table: the values of a field for the boxes of all plans. ``values`` has an entry for each plan;
    if a plan lacks the field, the entry is None, and the plan's boxes get null."""
    if all(of_plan is None for of_plan in values):
        return pa.nulls(sum(counts), kind)
    if kind == pa.string():
        texts = (of_plan or (None,) * count for of_plan, count in zip(values, counts, strict=True))
        return pa.array(list(itertools.chain.from_iterable(texts)), kind)
    filled = [np.zeros(count) if array is None else array for array, count in zip(values, counts, strict=True)]
    lacks = np.repeat([array is None for array in values], counts)
    return pa.array(np.concatenate(filled), mask=lacks, from_pandas=False).cast(kind)


def kept_plans(parts: Parts, records: Mapping[str, PlanRecord], wanted: Collection[str]) -> dict[str, Plan]:
    """Plan id → plan, for the plans in the table of a run, in the order of the table. A plan is left out if its rows
    were changed after the run.

    Args:
        records: plan id → the run's record of the plan.
        wanted: ids of the plans to find.

    Raises:
        InputError: the table is damaged.
    """
    if not parts.files(PLACEMENTS):
        return {}
    wanted_ids = pa.array([plan_id for plan_id in wanted if plan_id in records], pa.string())
    table = pa.concat_tables(parts.table(PLACEMENTS, placements_schema().names)).combine_chunks()
    table = table.filter(pc.is_in(table["plan_id"], wanted_ids))
    plans = {}
    for plan_id, rows in _by_plan(table):
        try:
            plan = _plan(plan_id, records[plan_id].source, rows)
        except InputError:  # the plan's rows were edited after the run
            continue
        if plan_digest(plan) == records[plan_id].digest:
            plans[plan_id] = plan
    return plans


def _by_plan(table: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Yield the id and the rows of each plan. The rows of a plan are adjacent."""
    codes = table["plan_id"].combine_chunks().dictionary_encode() if table.num_rows else None
    if codes is None:
        return
    of = np.asarray(codes.indices)
    begins = [0, *(np.flatnonzero(np.diff(of)) + 1).tolist(), len(of)]
    for begin, end in itertools.pairwise(begins):
        yield codes.dictionary[int(of[begin])].as_py(), table.slice(begin, end - begin)


def _plan(plan_id: str, source: str, rows: pa.Table) -> Plan:
    """A plan made from its rows. Raises InputError if the rows do not form a valid plan."""
    fields: dict[str, Any] = {}
    for name, field in _TEXTS.items():
        fields[field] = () if rows[name].null_count else tuple(rows[name].to_pylist())
    for name, field in _VECTORS.items():
        axes = [_of(rows, f"{name}_{letter}_mm") for letter in "xyz"]
        fields[field] = None if any(axis is None for axis in axes) else np.stack(axes, axis=1)
    for name in _NUMBERS:
        fields[name] = _of(rows, name)
    return Plan(plan_id=plan_id, source=source, **fields)


def _of(rows: pa.Table, name: str) -> Any:
    column = rows[name].combine_chunks()
    if column.null_count:
        return None
    kind = np.int64 if pa.types.is_integer(column.type) else np.float64
    return np.asarray(column).astype(kind)
