"""Writes plans (``save_plans``): BED-BPP's JSON, or tables with one row per placement.

Reading a written plan gives exactly the same plan.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.atomic_write import atomic_write, gzip_stream
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.bedbpp_writer import Placement, write_plans
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import COM_FIELDS, COM_FIELDS_JSON, SPARSE

_PLANS_AT_A_TIME: Final = 1_000
"""Number of plans whose rows are in memory at the same time: about 43,000 rows."""
_JSON: Final = (".json", ".json.gz")
_CSV: Final = (".csv", ".csv.gz")
_PARQUET: Final = (".parquet",)

_SIZES: Final = ("length_mm", "width_mm", "height_mm")
_CORNER: Final = ("x_mm", "y_mm", "z_mm")
_COLUMNS: Final = (
    "plan_id", "sequence", "article", "item_id", "product_group", *_SIZES, "weight_kg", "orientation", *_CORNER,
    "order_sequence", "material", *COM_FIELDS, "kind", *SPARSE,
)  # fmt: skip
"""All columns of a table of placements, in their order."""
_UNITS: Final = {
    **dict.fromkeys((*_SIZES, *_CORNER, *COM_FIELDS), "mm"),
    "weight_kg": "kg",
    **dict.fromkeys(("sequence", "orientation", "order_sequence"), "1"),
    **{name: field.unit for name, field in SPARSE.items()},
}


def save_plans(plans: Plan | Iterable[Plan], path: str | os.PathLike[str]) -> None:
    """Write plans to one file. The file's suffix determines the format: ``.json``, ``.csv`` (both also ``.gz``) or
    ``.parquet``.

    The file never appears half-written. Reading the file gives exactly the same numbers.

    Raises:
        InputError: the suffix is unknown, there is no plan, two plans have the same id, or the file cannot be written.
    """
    file = path_of(path, "path")
    chosen = [plans] if isinstance(plans, Plan) else list_of(plans, "plans", Plan, "Plan objects")
    write = _writer_for(file)
    if not chosen:
        raise InputError(f"{printable(str(file))}: there is no plan to write")
    ids: set[str] = set()
    for plan in chosen:
        if plan.plan_id in ids:
            raise InputError(f"{printable(str(file))}: plan {printable_name(plan.plan_id)} occurs twice")
        ids.add(plan.plan_id)
    write(chosen, file)


def check_plan_file(file: Path) -> None:
    """Check the name of a file. Raises InputError if plans cannot be written into a file of this name."""
    _writer_for(file)


def _writer_for(file: Path) -> Callable[[Sequence[Plan], Path], None]:
    name = file.name.lower()
    for endings, write in ((_JSON, _write_json), (_CSV, _write_csv), (_PARQUET, _write_parquet)):
        if name.endswith(endings):
            return write
    # the name of a pipe or device does not tell a file format, so JSON is written
    if str(file.absolute()).startswith("/dev/") or file.is_fifo():
        return _write_json
    endings_known = ", ".join((*_JSON, *_CSV, *_PARQUET))
    raise InputError(f"{printable(str(file))}: the name must end in one of {endings_known}")


def plans_table(plans: Sequence[Plan]) -> pa.Table:
    """Plans as a table with one row per placement, which docs/plan-format.md describes."""
    return _table(plans, _schema(plans))


def as_placements(plan: Plan) -> list[Placement]:
    """A plan in BED-BPP's format. Whole numbers are written without decimals."""
    size, corner, mass = plan.item_size_mm.tolist(), plan.corner_mm.tolist(), plan.mass_kg.tolist()
    groups = plan.product_groups
    com = None if plan.mass_center_mm is None else plan.item_com_mm.tolist()
    sparse = {name: _sparse(plan, name) for name in SPARSE}
    approach = sparse.pop("approach_deg")
    return [
        {
            "item": {
                "article": plan.articles[box],
                "id": plan.item_ids[box],
                **({"product_group": groups[box]} if groups else {}),
                "length/mm": _exact(size[box][0]),
                "width/mm": _exact(size[box][1]),
                "height/mm": _exact(size[box][2]),
                "weight/kg": _exact(mass[box]),
                "sequence": int(plan.sequence[box]),
                **({"material": plan.materials[box]} if plan.materials and plan.materials[box] else {}),
                **({} if com is None else dict(zip(COM_FIELDS_JSON, map(_exact, com[box]), strict=True))),
                **{name: _exact(float(values[box])) for name, values in sparse.items() if not np.isnan(values[box])},
                **({"kind": plan.kinds[box]} if plan.kinds and plan.kinds[box] else {}),
            },
            "orientation": int(plan.turned[box]),
            "flb_coordinates": [_exact(value) for value in corner[box]],
            **({} if np.isnan(approach[box]) else {"approach_deg": _exact(float(approach[box]))}),
        }
        for box in range(plan.n_boxes)
    ]


def _sparse(plan: Plan, name: str) -> FloatArray:
    """(n,) values of a field of ``SPARSE`` (a number that placements may lack); NaN for a placement that lacks it."""
    values: FloatArray | None = getattr(plan, name)
    return np.full(plan.n_boxes, np.nan) if values is None else values


def _exact(value: float) -> int | float:
    return int(value) if value.is_integer() and str(value) != "-0.0" else value


def _write_json(plans: Sequence[Plan], file: Path) -> None:
    write_plans(file, ((plan.plan_id, as_placements(plan)) for plan in plans))


def _write_csv(plans: Sequence[Plan], file: Path) -> None:
    schema = _schema(plans)
    with atomic_write(file) as temporary, ExitStack() as stack:
        stream: Any = stack.enter_context(temporary.open("wb"))
        if file.suffix.lower() == ".gz":
            stream = stack.enter_context(gzip_stream(stream))
        with pa_csv.CSVWriter(stream, schema) as writer:
            for table in _tables(plans, schema):
                writer.write_table(table)


def _write_parquet(plans: Sequence[Plan], file: Path) -> None:
    schema = _schema(plans)
    with (
        atomic_write(file) as temporary,
        temporary.open("wb") as stream,
        pq.ParquetWriter(stream, schema, compression="zstd") as writer,
    ):
        for table in _tables(plans, schema):
            writer.write_table(table)


_KINDS: Final = {
    **dict.fromkeys(("plan_id", "article", "item_id", "product_group", "material", "kind"), pa.string()),
    **dict.fromkeys(("sequence", "orientation", "order_sequence"), pa.int64()),
}
"""Column of a table of plans → Arrow type of its values. All other columns have floating-point numbers."""


def _schema(plans: Sequence[Plan]) -> pa.Schema:
    """The columns of the plans' table. An optional column is left out if all its values are missing or have the
    default."""
    needed = {
        "item_id": any(any(plan.item_ids) for plan in plans),
        "product_group": any(plan.product_groups for plan in plans),
        "orientation": any(plan.orientation is not None for plan in plans),
        "order_sequence": any((plan.sequence != np.arange(1, plan.n_boxes + 1)).any() for plan in plans),
        "material": any(plan.materials for plan in plans),
        **dict.fromkeys(COM_FIELDS, any(plan.mass_center_mm is not None for plan in plans)),
        "kind": any(plan.kinds for plan in plans),
        **{name: any(getattr(plan, name) is not None for plan in plans) for name in SPARSE},
    }
    return pa.schema(
        [
            pa.field(name, _KINDS.get(name, pa.float64()), metadata={"unit": _UNITS.get(name, "")})
            for name in _COLUMNS
            if needed.get(name, True)
        ]
    )


def _tables(plans: Sequence[Plan], schema: pa.Schema) -> Iterator[pa.Table]:
    """The plans as tables, some plans at a time."""
    for begin in range(0, len(plans), _PLANS_AT_A_TIME):
        yield _table(plans[begin : begin + _PLANS_AT_A_TIME], schema)


def _table(plans: Sequence[Plan], schema: pa.Schema) -> pa.Table:
    size = np.concatenate([plan.item_size_mm for plan in plans])
    corner = np.concatenate([plan.corner_mm for plan in plans])
    values = {
        "plan_id": [plan.plan_id for plan in plans for _ in range(plan.n_boxes)],
        "sequence": np.concatenate([np.arange(1, plan.n_boxes + 1) for plan in plans]),
        "article": [name for plan in plans for name in plan.articles],
        "item_id": [name for plan in plans for name in plan.item_ids],
        "product_group": [name for plan in plans for name in plan.product_groups or ("",) * plan.n_boxes],
        **dict(zip(_SIZES, size.T, strict=True)),
        "weight_kg": np.concatenate([plan.mass_kg for plan in plans]),
        "orientation": np.concatenate([plan.turned for plan in plans]).astype(np.int64),
        **dict(zip(_CORNER, corner.T, strict=True)),
        "order_sequence": np.concatenate([plan.sequence for plan in plans]),
        "material": [name for plan in plans for name in plan.materials or ("",) * plan.n_boxes],
        **dict(zip(COM_FIELDS, np.concatenate([plan.item_com_mm for plan in plans]).T, strict=True)),
        "kind": [name for plan in plans for name in plan.kinds or ("",) * plan.n_boxes],
        **{name: np.concatenate([_sparse(plan, name) for plan in plans]) for name in SPARSE},
    }
    columns = [pa.array(values[field.name], field.type, from_pandas=True) for field in schema]
    return pa.table(columns, schema=schema)
