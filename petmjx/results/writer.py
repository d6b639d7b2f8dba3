"""Writes a run's folder, part by part, while worlds finish. The files in it: petmjx.results.files."""

from __future__ import annotations

import json
import platform
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import pandas as pd
import pyarrow as pa

from petmjx.errors import InputError, PetmjxError
from petmjx.plans.plan import Plan, Skipped
from petmjx.results.files import RUN_FILE, make_room, part_name, write_table, write_text
from petmjx.results.parts import Part, Row
from petmjx.results.plain import plain
from petmjx.results.schema import SCHEMA_VERSION, Param, schemas, summary_schema
from petmjx.text import one_line
from petmjx.verdict import Attempt, Outcome, Reason, Verdict

WORLDS_PER_PART: Final = 1_000
"""A part then has about 43,000 boxes, 3 MB: there are few files, and a crash loses little."""

SECONDS_PER_PART: Final = 60.0
"""A part is written at the latest after this time, even if worlds finish slowly."""


@dataclass
class _Pending:
    """The part that is being collected, and what was written before it."""

    part: Part
    verdicts: Counter[tuple[Verdict, Reason]] = field(default_factory=Counter)
    retried: int = 0
    since_s: float = 0.0
    """When its first world came (monotonic clock). Time before that, such as for compiling, does not count."""

    def following(self) -> _Pending:
        """The next part, once this one is written."""
        rows = self.part.rows
        verdicts = self.verdicts + Counter((row.cells["verdict"], row.cells["reason"]) for row in rows)
        return _Pending(Part(self.part.number + 1), verdicts, self.retried + sum(bool(row.attempts) for row in rows))

    def counts(self) -> dict[str, Any]:
        """Counts of what was written, for run.json: worlds by verdict, and those that are not stable by reason."""
        by_reason: dict[str, dict[str, int]] = {Verdict.UNSTABLE.value: {}, Verdict.INVALID.value: {}}
        by_verdict = {verdict.value: 0 for verdict in Verdict}
        for (verdict, reason), count in sorted(self.verdicts.items()):
            by_verdict[verdict.value] += count
            if verdict is not Verdict.STABLE:
                by_reason[verdict.value][reason.value] = count
        return {"worlds": self.verdicts.total(), **by_verdict, "by_reason": by_reason, "retried": self.retried}


class RunWriter:
    """Writes one run's results as its worlds finish. A context manager.

    At the end of the body, also after Ctrl-C or an error, the collected worlds are written as a last part, and
    ``run.json`` says how the run ended: ``finished``, ``interrupted`` or ``failed``. Only one part is in memory at a
    time.

    Args:
        out_dir: the run's folder; made if it is not there.
        config: all options with their values, as plain JSON values (``Simulation.model_dump(mode="json")`` and others).
        params: parameters of a sweep's variants; each is a column of ``worlds``.
        dynamic: whether worlds have profiles: ``boxes`` then has ``max_sway_m``.
        versions: package → version; Python's own is added.
        device: name of the device on which the worlds ran.
        expected_worlds: number of worlds of the run, if known.
        overwrite: replace a run that is in the folder.
        worlds_per_part, seconds_per_part: a part is written when one of them is reached.

    Raises:
        InputError: the folder has a run already, or cannot be written.
    """

    def __init__(
        self,
        out_dir: str | Path,
        config: Mapping[str, Any],
        *,
        params: Sequence[Param] = (),
        dynamic: bool = False,
        versions: Mapping[str, str] | None = None,
        device: str = "",
        expected_worlds: int | None = None,
        overwrite: bool = False,
        worlds_per_part: int = WORLDS_PER_PART,
        seconds_per_part: float = SECONDS_PER_PART,
    ) -> None:
        self.out_dir = Path(out_dir)
        self.params = tuple(params)
        self.schemas = schemas(self.params, dynamic)
        self.skipped: list[Skipped] = []
        self.warnings: list[str] = []
        """About the whole run."""
        self.odd_plans: list[str] = []
        """A line for each plan with overlapping, floating or outside boxes."""
        self.timings: dict[str, float] = {}
        self._overwrite = overwrite
        self._worlds_per_part, self._seconds_per_part = worlds_per_part, seconds_per_part
        self._pending = _Pending(Part(0))
        self._status = "running"
        self._error: str | None = None
        self._started = time.monotonic()
        self._head = {
            "started": _now(),
            "config": dict(config),
            "versions": {"python": platform.python_version(), **(versions or {})},
            "device": device,
            "expected_worlds": expected_worlds,
            "params": [{"name": p.name, "unit": p.unit, "description": p.description} for p in self.params],
        }

    def __enter__(self) -> Self:
        try:
            make_room(self.out_dir, self._overwrite)
            self._write_info()
        except OSError as error:
            raise InputError(f"{self.out_dir}: cannot write results there: {error.strerror or error}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self._status = "finished"
        elif isinstance(error, KeyboardInterrupt | SystemExit):
            self._status = "interrupted"
        else:
            self._status, self._error = "failed", one_line(error)
        if error is not None:
            self._write_info()  # if a second Ctrl-C stops the last part, run.json at least says so
        try:
            self._flush(last=True)
        except Exception as trouble:
            if error is None:
                self._status, self._error = "failed", one_line(trouble)
                self._write_info()
                raise
            # the error that ended the body is reported; this one becomes a warning
            self.warn(f"the last part could not be written: {one_line(trouble)}")
        self._write_info()

    @property
    def info(self) -> dict[str, Any]:
        """The present content of ``run.json``. Counts are of worlds on disk."""
        wall_s = time.monotonic() - self._started
        return {
            "schema_version": SCHEMA_VERSION,
            "status": self._status,
            **({"error": self._error} if self._error else {}),
            **self._head,
            "updated": _now(),
            "counts": {**self._pending.counts(), "skipped_plans": len(self.skipped), "odd_plans": len(self.odd_plans)},
            "timings": {**self.timings, "wall_s": round(wall_s, 3)},
            "skipped": [{"plan_id": s.plan_id or "", "source": s.source, "error": s.message} for s in self.skipped],
            "warnings": [*self.warnings, *self.odd_plans],
        }

    def add(
        self,
        plan: Plan,
        variant: int,
        engine: str,
        schedule: str,
        outcome: Outcome,
        attempts: Sequence[Attempt] = (),
        params: Mapping[str, Any] | None = None,
    ) -> None:
        """Add one finished world, and write a part if there are enough.

        Args:
            plan: the world's plan; ``outcome`` has the same boxes in the same order.
            variant: 0 is nominal.
            engine, schedule: names, as in the results.
            outcome: copied; its arrays may be reused, and its ``state`` is not kept.
            attempts: all attempts in order, if the world needed more than one.
            params: parameter → value; missing ones become null.

        Raises:
            ValueError: an outcome of another plan, or a parameter that the run does not have.
            PetmjxError: the part cannot be written (a full disk).
        """
        values = {param.name: None for param in self.params} | dict(params or {})
        if len(values) > len(self.params):
            raise ValueError(f"the run has no parameter {list(values)[len(self.params)]!r}")
        row = Row.of(plan, variant, engine, str(schedule), outcome, attempts, values)
        pending, rows = self._pending, self._pending.part.rows
        if not rows:
            pending.since_s = time.monotonic()
        rows.append(row)
        enough = len(rows) >= self._worlds_per_part
        if enough or time.monotonic() - pending.since_s >= self._seconds_per_part:
            self._flush()
            self._write_info()

    def skip(self, skipped: Skipped) -> None:
        """Record a plan or a file that is not simulated, and why."""
        self.skipped.append(skipped)

    def warn(self, message: str) -> None:
        """Record a warning about the whole run for ``run.json``."""
        self.warnings.append(message)

    def _flush(self, last: bool = False) -> None:
        part = self._pending.part
        # a run without worlds still gets one empty part, so that readers find the columns
        if not part.rows and not (last and part.number == 0):
            return
        try:
            part.write(self.out_dir, self.schemas)
        except OSError as error:
            raise PetmjxError(f"{self.out_dir}: cannot write results: {error.strerror or error}") from error
        # one assignment: after an interrupt before it the same part is written again, after it the next part begins
        self._pending = self._pending.following()

    def _write_info(self) -> None:
        text = json.dumps(plain(self.info), indent=2, ensure_ascii=False, allow_nan=False)
        write_text(text + "\n", self.out_dir / RUN_FILE)


def write_summary(
    out_dir: str | Path,
    frame: pd.DataFrame,
    units: Mapping[str, str],
    descriptions: Mapping[str, str] | None = None,
) -> Path:
    """Write a sweep's ``summary`` table beside its worlds, whole or not at all. An old one is replaced.

    Args:
        out_dir: the run's folder.
        frame: the table; its index is not written.
        units: column → unit, for every column of numbers (``"1"`` for counts and shares).
        descriptions: column → one line.

    Raises:
        ValueError: a numeric column without a unit.
        PetmjxError: the file cannot be written.
    """
    table = pa.Table.from_pandas(frame, preserve_index=False)
    schema = summary_schema(table.schema, units, descriptions or {})
    path = Path(out_dir) / "summary" / part_name(0)
    try:
        write_table(pa.Table.from_arrays(table.columns, schema=schema), path)
    except OSError as error:
        raise PetmjxError(f"{path}: cannot write the summary: {error.strerror or error}") from error
    return path


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
