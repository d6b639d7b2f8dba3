"""Columns of the result tables: names, types, units, and what each one means.

Types, and why:

- Texts are plain strings. Parquet dictionary-encodes them on disk anyway, and in memory they stay one type
  for every reader: comparing two pandas categoricals whose categories differ is an error.
- ``worlds`` is float64: times are float64 sums of the timestep and are compared to the step. ``boxes``, forty
  times as long, holds measured values as float32 (a micrometre at 8 m; what the MJX engines compute in) and
  only its times as float64.
- A value that does not exist (no culprit, a box that was never placed, a world that never came to rest) is
  null. ``reason`` of a stable world is the empty string instead, since pandas drops null keys when grouping.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import pyarrow as pa

from petmjx.verdict import Flag

SCHEMA_VERSION: Final = 1
"""Raised when a column is renamed, removed or changes its meaning; new columns alone do not raise it."""

DIMENSIONLESS: Final = "1"
"""Unit of counts, indices and factors."""

TEXT: Final = ""
"""Unit of columns that hold no quantity: texts, yes or no."""

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


def _measures(arrow_type: pa.DataType, **columns: tuple[str, str]) -> list[Column]:
    return [Column(name, arrow_type, unit, text) for name, (unit, text) in columns.items()]


_KEY = [
    *_texts(plan_id="id of the packing plan"),
    *_counts(variant="which set of changes to the plan's nominal world; 0 is nominal"),
]

_WORLD_COLUMNS = (
    *_KEY,
    *_texts(engine="what stepped the world", solver="constraint solver of the attempt that gave the verdict"),
    *_counts(attempt="which attempt gave the verdict, from 1"),
    *_texts(schedule="when the next box was placed: fixed or adaptive"),
    *_counts(n_boxes="boxes of the plan", n_placed="boxes placed before the world ended"),
    *_texts(verdict="stable, unstable or invalid", reason="why it is not stable; empty where it is"),
    *_counts(culprit="box that first crossed a threshold (packing order from 0); null where none did"),
    *_measures(
        pa.float64(),
        first_sign_s=("s", "when the culprit crossed a threshold; null where none did"),
        max_shift_m=("m", "largest |x|, |y| or |z| component of any box's shift"),
        max_tilt_deg=("deg", "largest angle of any box's z axis to the world's, over samples"),
    ),
    *_counts(n_dropped="boxes that dropped"),
    *_measures(
        pa.float64(),
        first_drop_s=("s", "when the first box dropped; null where none did"),
        max_lin_acc=("m/s^2", "largest sampled linear acceleration of any box"),
        max_ang_acc=("rad/s^2", "largest sampled angular acceleration of any box"),
        max_top_force_n=("N", "largest sampled force on top of any box"),
        rest_top_force_n=("N", "largest force on top of any box at rest; null where the world never came to rest"),
        sim_time_s=("s", "simulated time after the soft start"),
    ),
    Column("n_steps", pa.int64(), DIMENSIONLESS, "simulated steps after the soft start"),
    *_counts(flags=f"bit mask of what happened: {_FLAG_BITS}"),
)

_BOX_COLUMNS = (
    *_KEY,
    *_counts(box="index of the box in packing order, from 0"),
    *_texts(item_id="id of the item in the plan", article="article of the item"),
    Column("sequence", pa.int64(), DIMENSIONLESS, "sequence number of the item in the plan"),
    *_measures(
        pa.float32(),
        shift_x_m=("m", "final centre - planned centre, x; components below the floor are 0; null if never placed"),
        shift_y_m=("m", "final centre - planned centre, y"),
        shift_z_m=("m", "final centre - planned centre, z"),
        max_tilt_deg=("deg", "largest angle of the box's z axis to the world's, over samples"),
    ),
    Column("dropped", pa.bool_(), TEXT, "the box fell off the carrier"),
    *_measures(pa.float64(), drop_s=("s", "when it dropped; null where it did not")),
    *_measures(
        pa.float32(),
        max_lin_acc=("m/s^2", "largest sampled linear acceleration"),
        max_ang_acc=("rad/s^2", "largest sampled angular acceleration"),
        max_top_force_n=("N", "largest sampled force on its top"),
        rest_top_force_n=("N", "force on its top at rest; null where the world never came to rest"),
        pos_x_m=("m", "final centre, x"),
        pos_y_m=("m", "final centre, y"),
        pos_z_m=("m", "final centre, z; 0 is the carrier's top"),
        quat_w=(DIMENSIONLESS, "final orientation, unit quaternion, w"),
        quat_x=(DIMENSIONLESS, "final orientation, unit quaternion, x"),
        quat_y=(DIMENSIONLESS, "final orientation, unit quaternion, y"),
        quat_z=(DIMENSIONLESS, "final orientation, unit quaternion, z"),
    ),
)

_SWAY_COLUMN = Column(
    "max_sway_m", pa.float32(), "m", "largest horizontal distance from where the box was when the forces began"
)

_ATTEMPT_COLUMNS = (
    *_KEY,
    *_counts(attempt="number of the attempt, from 1; the last one gave the verdict"),
    *_texts(solver="constraint solver"),
    *_measures(pa.float64(), timestep_s=("s", "timestep of the simulation")),
    *_texts(verdict="what this attempt came to", reason="why it was not stable; empty where it was"),
    *_counts(flags=f"bit mask of what happened: {_FLAG_BITS}"),
    Column("n_steps", pa.int64(), DIMENSIONLESS, "simulated steps after the soft start"),
)


def _schema(table: str, columns: Iterable[Column]) -> pa.Schema:
    metadata = {"schema_version": str(SCHEMA_VERSION), "table": table}
    return pa.schema([column.field() for column in columns], metadata=metadata)


def worlds_schema(params: Iterable[Param] = ()) -> pa.Schema:
    """Schema of ``worlds``; a sweep's parameters come last, a column each.

    Raises:
        ValueError: two columns of one name.
    """
    columns = (*_WORLD_COLUMNS, *(param.column() for param in params))
    names = [column.name for column in columns]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"a variant's parameter cannot be called {repeated[0]!r}: worlds has such a column")
    return _schema("worlds", columns)


def boxes_schema(dynamic: bool = False) -> pa.Schema:
    """Schema of ``boxes``; runs with a force profile (``dynamic``) have ``max_sway_m`` in addition."""
    return _schema("boxes", (*_BOX_COLUMNS, _SWAY_COLUMN) if dynamic else _BOX_COLUMNS)


def attempts_schema() -> pa.Schema:
    """Schema of ``attempts``: a row for each attempt at worlds that needed more than one."""
    return _schema("attempts", _ATTEMPT_COLUMNS)


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
    """The version a file's schema metadata names; 0 where it names none."""
    text: Any = (metadata or {}).get(b"schema_version", b"0")
    try:
        return int(text)
    except ValueError:
        return 0
