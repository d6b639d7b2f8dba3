"""One part of a run's results: worlds gathered row by row, turned into columns, written whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from petmjx.plans.plan import Plan
from petmjx.verdict import Attempt, BoxMetrics, Outcome, Reason, Verdict

_BLOCK: Final = (
    "shift_x_m",
    "shift_y_m",
    "shift_z_m",
    "max_tilt_deg",
    "dropped",
    "drop_s",
    "max_lin_acc",
    "max_ang_acc",
    "max_top_force_n",
    "rest_top_force_n",
    "pos_x_m",
    "pos_y_m",
    "pos_z_m",
    "quat_w",
    "quat_x",
    "quat_y",
    "quat_z",
    "max_sway_m",
)
"""Columns of the float64 block in which a world's box metrics wait to be written."""
_COLUMN: Final = {name: index for index, name in enumerate(_BLOCK)}


def _block(metrics: BoxMetrics, n_boxes: int, n_placed: int) -> NDArray[np.float64]:
    """(n_boxes, len(_BLOCK)) copy of the metrics; rows of boxes that were never placed are NaN, and not dropped."""
    block: NDArray[np.float64] = np.empty((n_boxes, len(_BLOCK)))
    block[:, 0:3] = metrics.shift_m
    block[:, 3] = metrics.max_tilt_deg
    block[:, 4] = metrics.dropped
    block[:, 5] = metrics.drop_s
    block[:, 6] = metrics.max_lin_acc
    block[:, 7] = metrics.max_ang_acc
    block[:, 8] = metrics.max_top_force_n
    block[:, 9] = metrics.rest_top_force_n
    block[:, 10:13] = metrics.pos
    block[:, 13:17] = metrics.quat
    block[:, 17] = metrics.max_sway_m
    if n_placed < n_boxes:
        block[n_placed:] = np.nan
        block[n_placed:, 4] = 0.0
    return block


@dataclass(frozen=True, eq=False)
class Row:
    """One finished world as it waits for its part. Holds copies, so an engine may reuse its arrays."""

    plan: Plan
    variant: int
    engine: str
    schedule: str
    verdict: Verdict
    reason: Reason
    values: tuple[Any, ...]
    block: NDArray[np.float64]
    attempts: tuple[Attempt, ...]
    params: tuple[Any, ...]

    @classmethod
    def of(
        cls,
        plan: Plan,
        variant: int,
        engine: str,
        schedule: str,
        outcome: Outcome,
        attempts: Sequence[Attempt],
        params: tuple[Any, ...],
    ) -> Row:
        """Take what is written of an outcome; its ``state`` is let go.

        Raises:
            ValueError: the outcome does not belong to the plan (another number of boxes).
        """
        n = outcome.n_boxes
        if not n == plan.n_boxes == len(outcome.boxes.max_tilt_deg) or n == 0:
            raise ValueError(f"plan {plan.plan_id} has {plan.n_boxes} boxes, its outcome {n}")
        values = (
            str(outcome.solver),
            outcome.attempt,
            n,
            outcome.n_placed,
            outcome.culprit if outcome.culprit >= 0 else None,
            outcome.first_sign_s,
            outcome.sim_time_s,
            outcome.n_steps,
            int(outcome.flags),
        )
        kept = tuple(attempts) if len(attempts) > 1 else ()
        block = _block(outcome.boxes, n, outcome.n_placed)
        verdict, reason = outcome.verdict, outcome.reason
        return cls(plan, variant, engine, schedule, verdict, reason, values, block, kept, params)


_VALUES: Final = (
    "solver",
    "attempt",
    "n_boxes",
    "n_placed",
    "culprit",
    "first_sign_s",
    "sim_time_s",
    "n_steps",
    "flags",
)
"""Columns of ``worlds`` that ``Row.values`` holds, in its order."""


@dataclass
class Part:
    """The rows of one part, and its number."""

    number: int
    rows: list[Row] = field(default_factory=list)

    @property
    def file_name(self) -> str:
        return part_name(self.number)

    def worlds(self, schema: pa.Schema) -> pa.Table:
        """The ``worlds`` table; reductions over boxes are made here, for the whole part at once."""
        blocks, starts = self._blocks()
        columns: dict[str, Any] = {
            "plan_id": [row.plan.plan_id for row in self.rows],
            "variant": [row.variant for row in self.rows],
            "engine": [row.engine for row in self.rows],
            "schedule": [row.schedule for row in self.rows],
            "verdict": [row.verdict.value for row in self.rows],
            "reason": [row.reason.value for row in self.rows],
        }
        columns.update({name: [row.values[index] for row in self.rows] for index, name in enumerate(_VALUES)})

        def largest(*names: str) -> NDArray[np.float64]:
            values = np.fmax.reduce([np.abs(blocks[:, _COLUMN[name]]) for name in names])
            return _reduce(np.fmax, values, starts)

        columns["max_shift_m"] = largest("shift_x_m", "shift_y_m", "shift_z_m")
        for name in ("max_tilt_deg", "max_lin_acc", "max_ang_acc", "max_top_force_n", "rest_top_force_n"):
            columns[name] = largest(name)
        columns["n_dropped"] = _reduce(np.add, blocks[:, _COLUMN["dropped"]], starts).astype(np.int32)
        columns["first_drop_s"] = _reduce(np.fmin, blocks[:, _COLUMN["drop_s"]], starts)
        first_param = len(schema) - len(self.rows[0].params) if self.rows else len(schema)
        for offset, name in enumerate(schema.names[first_param:]):
            columns[name] = [row.params[offset] for row in self.rows]
        return _table(columns, schema)

    def boxes(self, schema: pa.Schema) -> pa.Table:
        """The ``boxes`` table: the worlds' boxes one world after the other, in packing order."""
        blocks, _ = self._blocks()
        counts = np.array([row.plan.n_boxes for row in self.rows], dtype=np.int64)
        world = np.repeat(np.arange(len(self.rows)), counts)
        columns: dict[str, Any] = {name: blocks[:, _COLUMN[name]] for name in schema.names if name in _COLUMN}
        columns["dropped"] = blocks[:, _COLUMN["dropped"]] > 0
        columns["plan_id"] = pa.array([row.plan.plan_id for row in self.rows], pa.string()).take(pa.array(world))
        columns["variant"] = np.array([row.variant for row in self.rows], dtype=np.int32)[world]
        columns["box"] = np.concatenate([np.arange(0), *(np.arange(count) for count in counts)])
        columns["item_id"] = [item for row in self.rows for item in row.plan.item_ids]
        columns["article"] = [article for row in self.rows for article in row.plan.articles]
        columns["sequence"] = np.concatenate([np.arange(0), *(row.plan.sequence for row in self.rows)])
        return _table(columns, schema)

    def attempts(self, schema: pa.Schema) -> pa.Table:
        """The ``attempts`` table: no rows where every world needed one attempt only."""
        rows = [(row, attempt) for row in self.rows for attempt in row.attempts]
        columns: dict[str, Any] = {
            name: [getattr(attempt, name) for _, attempt in rows] for name in schema.names if name in _ATTEMPT_FIELDS
        }
        columns["plan_id"] = [row.plan.plan_id for row, _ in rows]
        columns["variant"] = [row.variant for row, _ in rows]
        return _table(columns, schema)

    def _blocks(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """All box metrics of the part, and the row at which each world starts."""
        blocks = np.concatenate([np.empty((0, len(_BLOCK))), *(row.block for row in self.rows)])
        counts = np.array([len(row.block) for row in self.rows], dtype=np.int64)
        return blocks, np.cumsum(counts) - counts


_ATTEMPT_FIELDS: Final = frozenset(Attempt.__dataclass_fields__)


def part_name(number: int) -> str:
    """File name of a part: the same in ``worlds``, ``boxes`` and ``attempts``."""
    return f"part-{number:05d}.parquet"


def _reduce(ufunc: np.ufunc, values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    reduced: NDArray[np.float64] = ufunc.reduceat(values, starts) if len(starts) else np.empty(0)
    return reduced


def _table(columns: dict[str, Any], schema: pa.Schema) -> pa.Table:
    """The columns in the schema's order and types; NaN becomes null."""
    arrays = []
    for column in schema:
        values = columns.get(column.name, [])
        if isinstance(values, pa.Array):
            arrays.append(values)
        elif isinstance(values, np.ndarray):
            arrays.append(pa.array(np.ascontiguousarray(values), from_pandas=True).cast(column.type, safe=False))
        else:
            arrays.append(pa.array(values, column.type, from_pandas=True))
    return pa.Table.from_arrays(arrays, schema=schema)


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """A hidden file beside ``path`` that takes its place, fully on disk, once the body is through."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    descriptor = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_table(table: pa.Table, path: Path) -> None:
    """Write one Parquet file so that it appears whole or not at all."""
    with _replacing(path) as file:
        pq.write_table(table, file, compression="zstd", compression_level=1)


def write_text(text: str, path: Path) -> None:
    """Write one UTF-8 text file so that it appears whole or not at all."""
    with _replacing(path) as file:
        file.write(text.encode())


def write_part(part: Part, directory: Path, schemas: dict[str, pa.Schema]) -> None:
    """Write a part's tables: ``worlds`` last, since a part counts only once its worlds are there."""
    tables: Iterable[tuple[str, pa.Table]] = (
        ("boxes", part.boxes(schemas["boxes"])),
        ("attempts", part.attempts(schemas["attempts"])),
        ("worlds", part.worlds(schemas["worlds"])),
    )
    for name, table in tables:
        if len(table) or name != "attempts":
            write_table(table, directory / name / part.file_name)
