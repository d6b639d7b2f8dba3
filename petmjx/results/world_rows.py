"""Finished worlds as rows, and the tables of one part (file) that are made from these rows."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import FORCE_INTERVAL, Column, box_columns, box_metrics, reduce_boxes, world_metrics
from petmjx.engines.verdict import Attempt, Outcome
from petmjx.plans.plan import Plan
from petmjx.results import history_tables
from petmjx.results.schema import RANK

ROW_BYTES: Final = 2_000
"""Memory of a row without its boxes and its history, bytes: 1,200 as measured by tracemalloc, plus the numbers and
texts of the world itself."""

_OF_OUTCOME: Final = ("engine", "solver", "attempt", "n_boxes", "n_placed", "verdict", "reason", "flags")
"""Columns of the table ``worlds`` that are fields of ``Outcome``, without the metrics."""


def _block_columns() -> list[Column]:
    """The columns of all metrics that have a value for each box. The schema of the table ``boxes`` determines which of
    these columns are written."""
    return [*box_columns(), *FORCE_INTERVAL]


class _Layout:
    """Determines which values of an outcome are copied into a row. The layout is prepared once for all worlds, because
    a loop over the metrics takes longer than copying the values of a world.

    Attributes:
        of_boxes: the metrics of boxes.
        cells: names of the columns of ``worlds`` that are fields of an outcome.
        cells_of: function that takes an outcome and returns the values of ``cells``.
        numbers: names of the columns among ``cells`` that hold the number of a box or of a step.
        block_of: function that takes the metrics of an outcome's boxes and returns the arrays of ``of_boxes``.
        block_rows: for each metric in ``of_boxes``, its row in a block (a metric may have several rows: one per
            component).
        n_rows: number of rows of a block.
    """

    def __init__(self) -> None:
        self.of_boxes = box_metrics()
        self.cells = ("culprit", *_OF_OUTCOME, *(metric.name for metric in world_metrics()))
        self.cells_of = attrgetter(*self.cells)
        self.numbers = ("culprit", *(metric.name for metric in world_metrics() if metric.numbers))
        self.block_of = attrgetter(*(metric.attribute for metric in self.of_boxes))
        ends = [0, *itertools.accumulate(len(metric.columns) for metric in self.of_boxes)]
        self.block_rows = [slice(begin, end) if end > begin + 1 else begin for begin, end in itertools.pairwise(ends)]
        self.n_rows = len(_block_columns())


_layouts: Final[list[_Layout]] = []


def _layout() -> _Layout:
    """The layout for all metrics that are defined at the moment of the call; further metrics may be defined later."""
    if not _layouts or _layouts[0].of_boxes is not box_metrics():
        _layouts[:] = [_Layout()]
    return _layouts[0]


@dataclass(frozen=True, eq=False)
class Row:
    """One finished world that waits to be written. The row has copies of the outcome's values, so the engine may reuse
    its arrays.

    Attributes:
        cells: column → value, for the columns of ``worlds`` that are not computed from all boxes.
        block: (columns, boxes) metrics of the boxes, in the order of ``_block_columns``.
        attempts: records of all attempts (simulations); empty if the world needed only one.
        recorded: the world with its history; None if the world was not recorded.
        ended_s: time at which the world ended, s (monotonic clock).
    """

    plan: Plan
    cells: dict[str, Any]
    block: FloatArray
    attempts: tuple[Attempt, ...]
    recorded: history_tables.RecordedWorld | None = None
    ended_s: float = field(default_factory=time.monotonic)

    @property
    def rank(self) -> int:
        """The position of the world in the order of the run."""
        rank: int = self.cells[RANK]
        return rank

    @property
    def nbytes(self) -> int:
        """Memory of the row without its plan, bytes."""
        return ROW_BYTES + self.block.nbytes + (self.recorded.size if self.recorded is not None else 0)

    @classmethod
    def of(
        cls,
        plan: Plan,
        variant: int,
        rank: int,
        schedule: str,
        outcome: Outcome,
        attempts: Sequence[Attempt],
        params: Mapping[str, Any],
        interval_n: FloatArray | None = None,
    ) -> Row:
        """Make a row with copies of those values of an outcome that are written to tables. The ``state`` of the outcome
        is not copied.

        Raises:
            ValueError: the outcome does not belong to the plan, since the numbers of boxes differ.
        """
        n = outcome.n_boxes
        if not n == plan.n_boxes == len(outcome.boxes.max_tilt_deg) or n == 0:
            raise ValueError(f"plan {plan.plan_id} has {plan.n_boxes} boxes, but its outcome has {n}")
        cells: dict[str, Any] = {"plan_id": plan.plan_id, "variant": variant, RANK: rank, "schedule": schedule}
        layout = _layout()
        cells |= zip(layout.cells, layout.cells_of(outcome), strict=True)
        for name in layout.numbers:
            if cells[name] < 0:
                cells[name] = None
        cells |= params
        block = np.full((layout.n_rows, n), np.nan)
        # the values of boxes that were not placed stay NaN, which becomes "no" in boolean columns
        placed = slice(outcome.n_placed)
        for rows, values in zip(layout.block_rows, layout.block_of(outcome.boxes), strict=True):
            block[rows, placed] = np.asarray(values)[placed].T
        if interval_n is not None:
            block[-len(FORCE_INTERVAL) :, placed] = interval_n[placed].T
        history = outcome.history
        recorded = None if history is None else history_tables.RecordedWorld(plan.plan_id, variant, history, rank)
        return cls(plan, cells, block, tuple(attempts) if len(attempts) > 1 else (), recorded)


@dataclass(frozen=True)
class Part:
    """The finished worlds of one part (one file of each table), in the order in which they are written."""

    rows: Sequence[Row]

    def tables(self, schemas: Mapping[str, pa.Schema]) -> Iterator[tuple[str, pa.Table]]:
        """Yield the name and the content of each table that has rows of these worlds; ``worlds`` comes last. ``boxes``
        is left out if it has no schema."""
        recorded = [row.recorded for row in self.rows if row.recorded is not None]
        for name, columns_of in history_tables.TABLES.items() if recorded else ():
            columns = columns_of(recorded)
            if len(columns["plan_id"]):
                yield name, _typed_table(columns, schemas[name])
        if "boxes" in schemas:
            yield "boxes", self.boxes(schemas["boxes"])
        if len(attempts := self.attempts(schemas["attempts"])):
            yield "attempts", attempts
        yield "worlds", self.worlds(schemas["worlds"])

    def worlds(self, schema: pa.Schema) -> pa.Table:
        """Make the table ``worlds`` for all worlds of the part at once. Some columns are computed from the values of
        all boxes of a world."""
        blocks, counts = self._blocks
        starts = np.cumsum(counts) - counts
        columns: dict[str, Any] = {}
        first = 0
        for metric in box_metrics():
            values = blocks[first : first + len(metric.columns)].T
            first += len(metric.columns)
            if metric.of_world is not None:
                columns[metric.of_world.name] = reduce_boxes(metric.of_world.reduction, values, starts)
        other_names = [name for name in schema.names if name not in columns]
        return _typed_table(columns | {name: [row.cells[name] for row in self.rows] for name in other_names}, schema)

    def boxes(self, schema: pa.Schema) -> pa.Table:
        """Make the table ``boxes``: world after world, with the boxes of each world in packing order."""
        blocks, counts = self._blocks
        world = np.repeat(np.arange(len(self.rows)), counts)
        columns: dict[str, Any] = {
            column.name: values > 0 if column.dtype is np.bool_ else values
            for column, values in zip(_block_columns(), blocks, strict=True)
        }
        columns["plan_id"] = pa.array([row.plan.plan_id for row in self.rows], pa.string()).take(pa.array(world))
        for name, kind in (("variant", np.int32), (RANK, np.int64)):
            columns[name] = np.array([row.cells[name] for row in self.rows], dtype=kind)[world]
        columns["box"] = np.concatenate([np.arange(0), *(np.arange(count) for count in counts)])
        columns["item_id"] = [item for row in self.rows for item in row.plan.item_ids]
        columns["article"] = [article for row in self.rows for article in row.plan.articles]
        columns["sequence"] = np.concatenate([np.arange(0), *(row.plan.sequence for row in self.rows)])
        return _typed_table(columns, schema)

    def attempts(self, schema: pa.Schema) -> pa.Table:
        """Make the table ``attempts``, which has no rows if every world needed only one attempt."""
        rows = [(row, attempt) for row in self.rows for attempt in row.attempts]
        cells = [{**row.cells, **vars(attempt)} for row, attempt in rows]
        return _typed_table({name: [cell[name] for cell in cells] for name in schema.names}, schema)

    @cached_property
    def _blocks(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """(columns, boxes) the metrics of all boxes of the part, and (worlds,) the number of boxes of each world."""
        blocks = np.concatenate([np.empty((len(_block_columns()), 0)), *(row.block for row in self.rows)], axis=1)
        return blocks, np.array([row.block.shape[1] for row in self.rows], dtype=np.int64)


def _typed_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """A table with the columns in the order and the types of the schema. NaN becomes null."""
    arrays = []
    for column in schema:
        values = columns[column.name]
        if isinstance(values, pa.Array):
            arrays.append(values)
        elif isinstance(values, np.ndarray):
            arrays.append(pa.array(np.ascontiguousarray(values), from_pandas=True).cast(column.type, safe=False))
        else:
            arrays.append(pa.array(values, column.type, from_pandas=True))
    return pa.Table.from_arrays(arrays, schema=schema)
