"""Columns of the result tables: name, type, unit and meaning. Metrics come from petmjx.metrics.spec.

Types, and why:

- Texts are plain strings. Parquet encodes them with a dictionary on disk anyway. In memory they have the same type for
  all readers; two pandas categoricals with different categories could not even be compared.
- ``worlds`` is float64: times are float64 sums of the timestep, and are compared to the step. ``boxes`` is forty times
  as long: measured values are float32, only times are float64.
- A value that does not exist (no culprit, a box that was never placed, a world that never came to rest) is null. The
  ``reason`` of a stable world is the empty string, since pandas drops null keys when grouping.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import pyarrow as pa

from petmjx.config import Schedule
from petmjx.metrics import spec
from petmjx.metrics.spec import DIMENSIONLESS, TEXT
from petmjx.verdict import Flag, Verdict

SCHEMA_VERSION: Final = 1
"""Increase it when a column is renamed or removed, or when its meaning changes. New columns do not need it."""

_FLAG_BITS = ", ".join(f"{flag.value} {(flag.name or '').lower().replace('_', '-')}" for flag in Flag)


@dataclass(frozen=True)
class Column:
    """One column: its Arrow type, its unit (``"1"`` for counts and indices, ``""`` for text) and its meaning."""

    name: str
    type: pa.DataType
    unit: str
    description: str

    def field(self) -> pa.Field:
        """The Arrow field, with unit and description as its metadata."""
        return pa.field(self.name, self.type, metadata={"unit": self.unit, "description": self.description})


@dataclass(frozen=True)
class Param:
    """A parameter of a sweep's variants: one more column of ``worlds``. ``type`` is float, int, bool or str."""

    name: str
    unit: str = DIMENSIONLESS
    description: str = ""
    type: type[float] | type[int] | type[bool] | type[str] = float

    def column(self) -> Column:
        """The parameter as a column of ``worlds``."""
        arrow_type = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}[self.type]
        return Column(self.name, arrow_type, self.unit, self.description or "parameter of the variant")


def _texts(**columns: str) -> list[Column]:
    return [Column(name, pa.string(), TEXT, text) for name, text in columns.items()]


def _counts(**columns: str) -> list[Column]:
    return [Column(name, pa.int32(), DIMENSIONLESS, text) for name, text in columns.items()]


def _one_of(names: Iterable[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} or {last}"


def _metrics(columns: Iterable[spec.Column]) -> dict[str, Column]:
    return {c.name: Column(c.name, pa.from_numpy_dtype(c.dtype), c.unit, c.meaning) for c in columns}


_KEY = [
    *_texts(plan_id="id of the packing plan"),
    *_counts(variant="which set of changes to the plan's nominal world; 0 is nominal"),
]

_FLAGS = _counts(flags=f"bit mask of what happened: {_FLAG_BITS}")

_WORLD_COLUMNS = (
    *_KEY,
    *_texts(engine="what stepped the world", solver="constraint solver of the attempt that gave the verdict"),
    *_counts(attempt="which attempt gave the verdict, from 1"),
    *_texts(schedule=f"when the next box was placed: {_one_of(Schedule)}"),
    *_counts(n_boxes="boxes of the plan", n_placed="boxes placed before the world ended"),
    *_texts(verdict=_one_of(Verdict), reason="why it is not stable; empty where it is"),
    *_counts(culprit="box that first crossed a threshold (packing order from 0); null where none did"),
)
"""Columns before the metrics. The flags come after the metrics."""

_BOX_COLUMNS = (
    *_KEY,
    *_counts(box="index of the box in packing order, from 0"),
    *_texts(item_id="id of the item in the plan", article="article of the item"),
    Column("sequence", pa.int64(), DIMENSIONLESS, "sequence number of the item in the plan"),
)
"""Columns before the metrics."""


def _schema(table: str, columns: Iterable[Column]) -> pa.Schema:
    metadata = {"schema_version": str(SCHEMA_VERSION), "table": table}
    return pa.schema([column.field() for column in columns], metadata=metadata)


def worlds_schema(params: Iterable[Param] = ()) -> pa.Schema:
    """Schema of ``worlds``; a sweep's parameters come last.

    Raises:
        ValueError: two columns with the same name.
    """
    metrics = _metrics(spec.world_columns()).values()
    columns = (*_WORLD_COLUMNS, *metrics, *_FLAGS, *(param.column() for param in params))
    names = [column.name for column in columns]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"a variant's parameter cannot be called {repeated[0]!r}: worlds has such a column")
    return _schema("worlds", columns)


def boxes_schema(dynamic: bool = False) -> pa.Schema:
    """Schema of ``boxes``; ``dynamic``: with the metrics that only runs with profiles have."""
    return _schema("boxes", (*_BOX_COLUMNS, *_metrics(spec.box_columns(driven=dynamic)).values()))


def attempts_schema() -> pa.Schema:
    """Schema of ``attempts``: one row per attempt, for worlds that needed more than one."""
    columns = (
        *_KEY,
        *_counts(attempt="number of the attempt, from 1; the last one gave the verdict"),
        *_texts(solver="constraint solver"),
        Column("timestep_s", pa.float64(), "s", "timestep of the simulation"),
        *_texts(verdict="what this attempt came to", reason="why it was not stable; empty where it was"),
        *_FLAGS,
        _metrics(spec.world_columns())["n_steps"],
    )
    return _schema("attempts", columns)


def summary_schema(inferred: pa.Schema, units: Mapping[str, str], descriptions: Mapping[str, str]) -> pa.Schema:
    """Schema of ``summary`` from the columns of a data frame, with a unit for every number.

    Raises:
        ValueError: a numeric column without a unit.
    """
    columns = []
    for field in inferred:
        numeric = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
        if numeric and field.name not in units:
            raise ValueError(f"summary column {field.name!r} needs a unit")
        columns.append(Column(field.name, field.type, units.get(field.name, TEXT), descriptions.get(field.name, "")))
    return _schema("summary", columns)


def schema_version_of(metadata: Mapping[bytes, bytes] | None) -> int:
    """The schema version in a file's metadata; 0 if there is none."""
    text: Any = (metadata or {}).get(b"schema_version", b"0")
    try:
        return int(text)
    except ValueError:
        return 0
