"""Columns of the result tables: name, type, unit and meaning. petmjx.engines.metrics defines the metrics.

The types, with reasons:

- Texts are plain strings. On disk, Parquet encodes them with a dictionary. In memory, all readers get plain strings,
  too: pandas cannot even compare two categoricals whose categories differ.
- Numbers in the table ``worlds`` are float64, because times are float64 sums of the timestep and are compared exactly.
  The table ``boxes`` has about forty times as many rows, so its measured values are float32 and only its times are
  float64.
- A value that does not exist is null, for example because no box failed, because a box was never placed, or because a
  world never came to rest. However, the ``reason`` of a stable world is the empty string, since pandas drops null keys
  when grouping.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pyarrow as pa

from petmjx.common.errors import InputError
from petmjx.common.text import alternatives
from petmjx.engines import metrics
from petmjx.engines.metrics import DIMENSIONLESS, TEXT
from petmjx.engines.verdict import Flag, Verdict
from petmjx.options.simulation import Schedule
from petmjx.plans.plan_fields import SPARSE

if TYPE_CHECKING:
    import pandas as pd

SCHEMA_VERSION: Final = 2
"""Version of the tables' columns. The version is increased when a column is renamed, removed or redefined, but not for
new columns."""

_FLAG_BITS = ", ".join(
    f"{flag.value} {(flag.name or '').lower().replace('_', '-')}"
    for flag in Flag
    if flag is not Flag.RERUN_AFTER_OVERFLOW
)


def _column(name: str, kind: pa.DataType, unit: str, text: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit, "description": text})


@dataclass(frozen=True)
class Param:
    """A quantity that a sweep varies, such as friction, and whose values become a column of ``worlds``. ``type`` is
    float, int, bool or str."""

    name: str
    unit: str = DIMENSIONLESS
    description: str = ""
    type: type[float] | type[int] | type[bool] | type[str] = float

    def column(self) -> pa.Field:
        """The parameter as a column of ``worlds``."""
        kind = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}[self.type]
        return _column(self.name, kind, self.unit, self.description or "parameter of the variant")


def _texts(**columns: str) -> list[pa.Field]:
    return [_column(name, pa.string(), TEXT, text) for name, text in columns.items()]


def _counts(**columns: str) -> list[pa.Field]:
    return [_column(name, pa.int32(), DIMENSIONLESS, text) for name, text in columns.items()]


def _metrics(columns: Iterable[metrics.Column]) -> list[pa.Field]:
    return [_column(c.name, pa.from_numpy_dtype(c.dtype), c.unit, c.meaning) for c in columns]


RANK: Final = "rank"
"""A column of all tables that have rows about worlds: the position of the world in the order of the run
(petmjx.results.world_ranks)."""

RANK_COLUMN: Final = _column(
    RANK,
    pa.int64(),
    DIMENSIONLESS,
    "position of the world in the run: worlds have the order in which their plans were given; worlds of one plan have "
    "the order of their variants",
)

_KEY = (
    *_texts(plan_id="id of the packing plan"),
    *_counts(variant="number of the variant (set of changes to the nominal world); 0: the nominal world"),
    RANK_COLUMN,
)
_FLAGS = _counts(flags=f"bit mask of events and properties of the world: {_FLAG_BITS}")

_WORLD_COLUMNS = (
    *_KEY,
    *_texts(
        engine="engine of the attempt that gave the verdict",
        solver="constraint solver of the attempt that gave the verdict",
    ),
    *_counts(attempt="number of the attempt that gave the verdict, from 1"),
    *_texts(schedule=f"when the next box was placed: {alternatives(Schedule)}"),
    *_counts(n_boxes="number of boxes of the plan", n_placed="number of boxes placed before the world ended"),
    *_texts(verdict=alternatives(Verdict), reason="reason why the world is not stable; empty if it is stable"),
    *_counts(
        culprit="number of the box that first crossed a threshold (in packing order, from 0); null if no box crossed "
        "one"
    ),
)
"""The first columns of the table ``worlds``. The columns with metrics and the column ``flags`` follow."""

_BOX_COLUMNS = (
    *_KEY,
    *_counts(box="index of the box in packing order, from 0"),
    *_texts(item_id="id of the item in the plan", article="article of the item"),
    _column("sequence", pa.int64(), DIMENSIONLESS, "sequence number of the item in the plan"),
)
"""The first columns of the table ``boxes``. The columns with metrics follow."""


_ATTEMPT_COLUMNS = (
    *_KEY,
    *_counts(attempt="number of the attempt at the world, from 1; the last attempt gave the verdict"),
    *_texts(engine="engine that simulated the world", solver="constraint solver"),
    _column("timestep_s", pa.float64(), "s", "timestep of the simulation"),
    *_texts(
        verdict="verdict of this attempt",
        reason="reason why the world was not stable in this attempt; empty if it was stable",
    ),
    *_FLAGS,
    *_metrics(column for column in metrics.world_columns() if column.name == "n_steps"),
)


_FRAME_KEY = (
    *_KEY,
    *_counts(frame="number of the frame in its world, from 0"),
    _column("time_s", pa.float64(), "s", "simulated time of the frame, counted from the end of the soft start"),
)


def _vector(name: str, unit: str, text: str, parts: str = "xyz", end: str = "") -> list[pa.Field]:
    """A column for each component of a vector. The name of a column consists of ``name``, the component and ``end``, as
    in ``pos_x_m``."""
    return [_column(f"{name}_{part}{end}", pa.float64(), unit, f"{text}, {part}") for part in parts]


_HISTORY_COLUMNS = (
    *_FRAME_KEY,
    *_counts(box="index of the box in packing order, from 0; boxes that are not placed yet have no row"),
    *_vector("pos", "m", "centre of the box (z = 0 is the carrier's top before the soft start)", end="_m"),
    *_vector("quat", DIMENSIONLESS, "orientation, unit quaternion", "wxyz"),
    _column("top_force_n", pa.float64(), "N", "force on the box's top during the step before the frame"),
    *_vector(
        "lin_acc",
        "m/s^2",
        "linear acceleration of the box in the step before the frame (null without recorded details)",
    ),
    *_vector(
        "ang_acc",
        "rad/s^2",
        "angular acceleration of the box in the step before the frame, in world axes (null without recorded details)",
    ),
    _column(
        "penetration_m",
        pa.float64(),
        "m",
        "largest depth of the box's contacts at the beginning of the step before the frame; 0 without contacts",
    ),
)

_FRAME_COLUMNS = (
    *_FRAME_KEY,
    *_counts(n_placed="number of placed boxes"),
    *_vector("carrier_pos", "m", "centre of the carrier", end="_m"),
    *_vector("carrier_quat", DIMENSIONLESS, "orientation of the carrier, unit quaternion", "wxyz"),
    *_vector(
        "drive_force",
        "N",
        "force on the carrier in the step before the frame (null without a profile of forces)",
        end="_n",
    ),
    *_vector(
        "drive_acc",
        "m/s^2",
        "acceleration of the carrier in the step before the frame (null without a profile of accelerations)",
    ),
)

_CONTACT_COLUMNS = (
    *_FRAME_KEY,
    *_counts(
        body_1="first body of the contact: index of a box, -1: carrier, -2: floor",
        body_2="second body of the contact: index of a box, -1: carrier, -2: floor",
    ),
    *_vector("point", "m", "point at which the two bodies touch, in world axes", end="_m"),
    *_vector("normal", DIMENSIONLESS, "unit vector of the contact's normal, from the first body to the second body"),
    *_vector("force", "N", "force of the first body on the second body, in world axes", end="_n"),
    _column("distance_m", pa.float64(), "m", "distance between the two bodies; negative if they penetrate"),
)


_NUMBER = _counts(number="number of the plan among all given plans, from 0; skipped plans are counted, too")
"""The column of the table ``plans`` by which the table is sorted."""

_EXTENT_COLUMNS = (
    _column("volume_m3", pa.float64(), "m^3", "sum of the volumes of the plan's boxes"),
    _column("extent_x_m", pa.float64(), "m", "extent of the plan's bounding box along x"),
    _column("extent_y_m", pa.float64(), "m", "extent of the plan's bounding box along y"),
    _column("height_m", pa.float64(), "m", "height of the highest top of a box above the carrier"),
)
"""Columns of the table ``plans`` with the volume and the extents of a plan's boxes."""

_PLACEMENT_COLUMNS = (
    *_texts(plan_id="id of the packing plan", item_id="id of the item", article="article of the item"),
    *_texts(product_group="product group of the item; null if no item of the plan has one"),
    *_texts(material="material of the box; null if the plan gives no material"),
    *_texts(kind="kind of the item: box, sheet, or the name of a pallet; null if all items are boxes"),
    *_vector("size", "mm", "extent of the box as it stands", end="_mm"),
    *_vector("corner", "mm", "front-left-bottom corner", end="_mm"),
    *_vector(
        "mass_center",
        "mm",
        "centre of mass, measured from the middle of the box (null if the plan gives none)",
        end="_mm",
    ),
    _column("mass_kg", pa.float64(), "kg", "mass"),
    _column("sequence", pa.int64(), DIMENSIONLESS, "number of the item in the order"),
    _column(
        "orientation", pa.int8(), DIMENSIONLESS, "1: the item's own length lies along y; 0: along x; null if not given"
    ),
    *(
        _column(
            name,
            pa.float64(),
            field.unit,
            f"value of {name} in the plan; NaN: not given for this box; null: not given for any box",
        )
        for name, field in SPARSE.items()
    ),
)
"""Columns of ``placements``: the fields of ``Plan``, one row per box in packing order."""

_ORDER_COLUMNS = _counts(
    ordered_boxes="number of boxes of the plan's order; null if the plan has no order",
    left_out="number of boxes that were ordered, but are not in the plan",
    not_ordered="number of boxes in the plan that were not ordered",
    resized="number of boxes in the plan that were ordered with another size, mass, centre of mass, stiffness or kind",
)
"""Columns of the table ``plans`` with the comparison of a plan and its order."""


def _schema(table: str, columns: Iterable[pa.Field]) -> pa.Schema:
    return pa.schema(columns, metadata={"schema_version": str(SCHEMA_VERSION), "table": table})


def schemas(
    params: Iterable[Param] = (), dynamic: bool = False, force_intervals: bool = False, legs: bool = False
) -> dict[str, pa.Schema]:
    """Name of a table → schema. The tables are ``worlds``, ``boxes``, ``attempts`` (one row per attempt, for worlds
    that needed more than one), and the tables of recorded worlds: ``histories``, ``frames``, ``contacts``.

    Args:
        params: parameters of the variants of a sweep, which become the last columns of ``worlds``.
        dynamic: whether the run has profiles (motions of the carrier). With profiles, ``boxes`` has additional metrics.
        force_intervals: whether ``boxes`` has the smallest and largest possible forces at rest.
        legs: whether the run is a chain of several legs (parts of a journey). In the run of a chain, ``boxes`` has the
            largest force at rest after any leg.

    Raises:
        ValueError: two columns have the same name.
    """
    worlds = (*_WORLD_COLUMNS, *_metrics(metrics.world_columns()), *_FLAGS, *(param.column() for param in params))
    names = [column.name for column in worlds]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(
            f"a variant's parameter cannot be called {repeated[0]!r}: the table `worlds` already has a column of "
            "this name"
        )
    intervals = metrics.FORCE_INTERVAL if force_intervals else ()
    boxes = (*_BOX_COLUMNS, *_metrics((*metrics.box_columns(driven=dynamic, legs=legs), *intervals)))
    tables = {"worlds": worlds, "boxes": boxes, "attempts": _ATTEMPT_COLUMNS}
    tables |= {"histories": _HISTORY_COLUMNS, "frames": _FRAME_COLUMNS, "contacts": _CONTACT_COLUMNS}
    return {table: _schema(table, columns) for table, columns in tables.items()}


def plans_schema(ordered: bool = False) -> pa.Schema:
    """Schema of the table ``plans``. The digests in this table tell whether two runs have the same plans.

    Args:
        ordered: whether the run was compared with orders. If it was, the table also has the columns of
            ``petmjx.plans.order_checks.PlanOrderCounts``.
    """
    texts = _texts(
        plan_id="id of the packing plan",
        digest="digest of everything in the plan that affects results",
        source="file from which the plan was read",
    )
    return _schema("plans", [*texts, *_EXTENT_COLUMNS, *_NUMBER, *(_ORDER_COLUMNS if ordered else ())])


def placements_schema() -> pa.Schema:
    """Schema of ``placements``: all fields of the run's plans, so that the run can be read without the plan files."""
    return _schema("placements", _PLACEMENT_COLUMNS)


def summary_table(
    frame: pd.DataFrame, units: Mapping[str, str], descriptions: Mapping[str, str] | None = None
) -> pa.Table:
    """Make the table ``summary`` from a data frame. The index of the data frame is left out.

    Args:
        units: column → unit, for every numeric column (``"1"`` for counts and shares).
        descriptions: column → description in one line.

    Raises:
        ValueError: a numeric column has no unit.
    """
    table = pa.Table.from_pandas(frame, preserve_index=False)
    for field in table.schema:
        numeric = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
        if numeric and field.name not in units:
            raise ValueError(f"summary column {field.name!r} needs a unit")
    texts = descriptions or {}
    columns = [_column(c.name, c.type, units.get(c.name, TEXT), texts.get(c.name, "")) for c in table.schema]
    return pa.Table.from_arrays(table.columns, schema=_schema("summary", columns))


_NUMBERS: Final = tuple(metric.name for metric in metrics.world_metrics() if metric.numbers)
"""Columns of the table ``worlds`` whose values are numbers of boxes or of steps."""


def data_frame(table: pa.Table) -> pd.DataFrame:
    """A table as a data frame. The column of ranks is left out, since the rows are already in order. The columns
    ``_NUMBERS`` are always float64: pandas uses this type if values are missing, and the type must not depend on
    whether values are missing."""
    frame: pd.DataFrame = table.select([name for name in table.column_names if name != RANK]).to_pandas()
    return frame.astype({name: "float64" for name in _NUMBERS if name in frame})


def schema_version_of(metadata: Mapping[bytes, bytes] | None) -> int:
    """The schema version in the metadata of a file; 0 if the metadata have no version."""
    text: Any = (metadata or {}).get(b"schema_version", b"0")
    try:
        return int(text)
    except ValueError:
        return 0


def check_version(file: Path, version: int) -> None:
    """Check that this version of petmjx can read a run's results. Raises InputError if a newer petmjx wrote the
    results."""
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{file}: written by a newer petmjx (schema {version}; this one reads up to {SCHEMA_VERSION}): update it"
        )
