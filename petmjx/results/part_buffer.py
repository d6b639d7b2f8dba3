"""Gathers finished worlds row by row and turns them into the tables of a part.

A thread may write one part while the next one is gathered.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from petmjx.common.processes import defer_signals
from petmjx.common.units import FloatArray
from petmjx.engines.metrics import FORCE_INTERVAL, Column, box_columns, box_metrics, reduce_boxes, world_metrics
from petmjx.engines.verdict import Attempt, Outcome
from petmjx.plans.plan import Plan
from petmjx.results import history_tables
from petmjx.results.run_table_files import Tables
from petmjx.results.world_counts import COUNTED, WorldCounts

WORLDS_PER_PART: Final = 1_000
"""A part has about 43,000 boxes, 3 MB. So a run has few files, and a crash loses at most two parts."""

SECONDS_PER_PART: Final = 60.0
"""Longest time that a world waits for its part to be written. It holds even if worlds finish slowly."""

LANDING_S: Final = 1.0
"""Time between two looks at whether the thread has written its part, s."""

HISTORY_BYTES_PER_PART: Final = 64 << 20
"""Memory of the histories of a part: about 60 worlds of 43 boxes, or 20 worlds with details."""

_OF_OUTCOME: Final = ("engine", "solver", "attempt", "n_boxes", "n_placed", "verdict", "reason", "flags")
"""Columns of ``worlds`` that are fields of an outcome, in addition to its metrics."""


def _block_columns() -> list[Column]:
    """The metrics kept for each box. The schema of ``boxes`` says which of them are written."""
    return [*box_columns(), *FORCE_INTERVAL]


@dataclass(frozen=True, eq=False)
class Row:
    """One finished world that waits to be written. The row has copies, so the engine may reuse its arrays.

    Attributes:
        cells: columns of ``worlds`` that are not reductions over boxes.
        block: (boxes, columns) metrics of boxes, in the order of ``_block_columns``.
        attempts: all attempts; empty if the world needed only one.
        recorded: the recorded world with its history; None if it has none.
    """

    plan: Plan
    cells: dict[str, Any]
    block: FloatArray
    attempts: tuple[Attempt, ...]
    recorded: history_tables.RecordedWorld | None = None

    @classmethod
    def of(
        cls,
        plan: Plan,
        variant: int,
        schedule: str,
        outcome: Outcome,
        attempts: Sequence[Attempt],
        params: Mapping[str, Any],
        interval_n: FloatArray | None = None,
    ) -> Row:
        """Copy what is written from an outcome. Its ``state`` is not kept.

        Raises:
            ValueError: the outcome does not belong to the plan (another number of boxes).
        """
        n = outcome.n_boxes
        if not n == plan.n_boxes == len(outcome.boxes.max_tilt_deg) or n == 0:
            raise ValueError(f"plan {plan.plan_id} has {plan.n_boxes} boxes, its outcome {n}")
        culprit = outcome.culprit if outcome.culprit >= 0 else None
        cells = {"plan_id": plan.plan_id, "variant": variant, "schedule": schedule}
        cells |= {name: getattr(outcome, name) for name in (*_OF_OUTCOME, *(metric.name for metric in world_metrics()))}
        cells |= {
            metric.name: None for metric in world_metrics() if metric.numbers and getattr(outcome, metric.name) < 0
        }
        cells |= {"culprit": culprit, **params}
        values = [np.asarray(getattr(outcome.boxes, metric.attribute)).reshape(n, -1) for metric in box_metrics()]
        values.append(np.full((n, len(FORCE_INTERVAL)), np.nan) if interval_n is None else interval_n)
        block = np.concatenate(values, axis=1, dtype=np.float64)
        block[outcome.n_placed :] = np.nan  # never placed; boolean columns read NaN as "no"
        history = outcome.history
        recorded = None if history is None else history_tables.RecordedWorld(plan.plan_id, variant, history)
        return cls(plan, cells, block, tuple(attempts) if len(attempts) > 1 else (), recorded)


@dataclass
class Part:
    """The rows of one part, and the number of the part.

    Attributes:
        history_bytes: memory of the rows' histories.
    """

    number: int
    rows: list[Row] = field(default_factory=list)
    history_bytes: int = 0

    def add(self, row: Row) -> None:
        """Add one more world."""
        self.rows.append(row)
        self.history_bytes += row.recorded.size if row.recorded is not None else 0

    def tables(self, schemas: Mapping[str, pa.Schema]) -> Iterator[tuple[str, pa.Table]]:
        """(name, table) of every table of the part; ``worlds`` comes last. ``boxes`` is left out if it has no
        schema."""
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

    def counted(self, before: WorldCounts) -> WorldCounts:
        """The counts ``before`` plus those of the part's rows."""
        counts = replace(before, verdicts=Counter(before.verdicts))
        cells = [row.cells for row in self.rows]
        counts.add(*([cell[name] for cell in cells] for name in COUNTED))
        return counts

    def worlds(self, schema: pa.Schema) -> pa.Table:
        """The ``worlds`` table, with reductions over boxes, for the whole part at once."""
        blocks, counts = self._blocks()
        starts = np.cumsum(counts) - counts
        columns: dict[str, Any] = {}
        first = 0
        for metric in box_metrics():
            values = blocks[:, first : first + len(metric.columns)]
            first += len(metric.columns)
            if metric.of_world is not None:
                columns[metric.of_world.name] = reduce_boxes(metric.of_world.reduction, values, starts)
        rest = [name for name in schema.names if name not in columns]
        return _typed_table(columns | {name: [row.cells[name] for row in self.rows] for name in rest}, schema)

    def boxes(self, schema: pa.Schema) -> pa.Table:
        """The ``boxes`` table: world after world, boxes in packing order."""
        blocks, counts = self._blocks()
        world = np.repeat(np.arange(len(self.rows)), counts)
        columns: dict[str, Any] = {
            column.name: values > 0 if column.dtype is np.bool_ else values
            for column, values in zip(_block_columns(), blocks.T, strict=True)
        }
        columns["plan_id"] = pa.array([row.plan.plan_id for row in self.rows], pa.string()).take(pa.array(world))
        columns["variant"] = np.array([row.cells["variant"] for row in self.rows], dtype=np.int32)[world]
        columns["box"] = np.concatenate([np.arange(0), *(np.arange(count) for count in counts)])
        columns["item_id"] = [item for row in self.rows for item in row.plan.item_ids]
        columns["article"] = [article for row in self.rows for article in row.plan.articles]
        columns["sequence"] = np.concatenate([np.arange(0), *(row.plan.sequence for row in self.rows)])
        return _typed_table(columns, schema)

    def attempts(self, schema: pa.Schema) -> pa.Table:
        """The ``attempts`` table: no rows if every world needed only one attempt."""
        rows = [(row, attempt) for row in self.rows for attempt in row.attempts]
        cells = [{**row.cells, **vars(attempt)} for row, attempt in rows]
        return _typed_table({name: [cell[name] for cell in cells] for name in schema.names}, schema)

    def _blocks(self) -> tuple[FloatArray, NDArray[np.int64]]:
        """All box metrics of the part, and the number of boxes of each world."""
        blocks = np.concatenate([np.empty((0, len(_block_columns()))), *(row.block for row in self.rows)])
        return blocks, np.array([len(row.block) for row in self.rows], dtype=np.int64)


@dataclass
class _Pending:
    """The part that is being gathered, and the counts of all parts before it."""

    part: Part
    counts: WorldCounts = field(default_factory=WorldCounts)
    since_s: float = 0.0
    """Arrival of the first world (monotonic clock). Time before it, such as for compiling, does not count."""

    def following(self) -> _Pending:
        """The next part, once this one is written."""
        return _Pending(Part(self.part.number + 1), self.part.counted(self.counts))


class _PartInFlight(NamedTuple):
    """A part that a thread writes, with the counts of the parts before it and the future digests of its files."""

    pending: _Pending
    digests: Future[dict[Path, str]]


class PartBuffer:
    """Gathers worlds for one part after the other. Callers hold a lock.

    A thread may write a part while the next one is gathered. The part counts when it has landed. If it cannot be
    written, its worlds are gathered again.
    """

    def __init__(self) -> None:
        self._pending = _Pending(Part(0))
        self._beside: _PartInFlight | None = None
        self._thread = ThreadPoolExecutor(1, "petmjx-part")

    @property
    def counts(self) -> WorldCounts:
        """Counts of the worlds in parts that count."""
        beside = self._beside
        return (self._pending if beside is None else beside.pending).counts

    @property
    def part(self) -> Part:
        """The part that is being gathered."""
        return self._pending.part

    def begin(self, number: int, counts: WorldCounts | None = None) -> None:
        """Begin an empty part with this number. No part may be in flight.

        Args:
            counts: counts of the parts that count; None: those known so far.
        """
        self._pending = _Pending(Part(number), counts or self._pending.counts)

    def add(self, row: Row) -> None:
        """Add one world to the part."""
        if not self.part.rows:
            self._pending.since_s = time.monotonic()
        self.part.add(row)

    def is_old(self, seconds: float) -> bool:
        """Whether the first world of the part came at least ``seconds`` ago."""
        return bool(self.part.rows) and time.monotonic() - self._pending.since_s >= seconds

    def due_s(self, seconds: float) -> float | None:
        """Time until something must be done even if no world comes, s; None: nothing waits.

        Args:
            seconds: how long the first world of a part may wait.
        """
        due = [LANDING_S] if self._beside is not None else []
        if self.part.rows:
            due.append(max(self._pending.since_s + seconds - time.monotonic(), 0.0))
        return min(due, default=None)

    def is_full(self, worlds: int) -> bool:
        """Whether the part has ``worlds`` worlds, or its histories have reached their limit of memory."""
        return len(self.part.rows) >= worlds or self.part.history_bytes >= HISTORY_BYTES_PER_PART

    def written(self) -> None:
        """Note that the part is written, and begin the next one."""
        # one assignment: an interrupt before it writes the same part again
        self._pending = self._pending.following()

    def write_beside(self, tables: Tables, schemas: Mapping[str, pa.Schema]) -> None:
        """Let the thread write the part. No other part may be in flight."""
        with defer_signals(afterwards=True):
            digests = self._thread.submit(tables.files_of, self.part.number, self.part.tables(schemas))
            self._beside, self._pending = _PartInFlight(self._pending, digests), self._pending.following()

    def land(self, tables: Tables, *, wait: bool) -> bool:
        """Let the part that the thread has written count, and the run's plans. Returns whether anything landed.

        Args:
            wait: whether to wait until the thread has ended.

        Raises:
            OSError: the part could not be written. Its worlds are gathered again, before the worlds that came since.
        """
        plans = tables.land_placements(wait=wait)
        if self._beside is None or not (wait or self._beside.digests.done()):
            return plans
        pending, digests = self._beside
        error = digests.exception()  # an interrupt while this waits changes nothing
        with defer_signals(afterwards=True):
            self._beside = None
            if error is None:
                tables.parts.add(digests.result())
            else:
                for row in self.part.rows:
                    pending.part.add(row)
                self._pending = pending
        if error is not None:
            raise error
        return True

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown()


def _typed_table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """The columns in the schema's order and types; NaN becomes null."""
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
