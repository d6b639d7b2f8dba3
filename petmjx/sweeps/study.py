"""The study of a run with variants: of sweeps, and of scores that say how sure they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from petmjx.engines.base import Engine, Progress
from petmjx.engines.cost import Work
from petmjx.plans.plan import Plan
from petmjx.results.recorded import Recorded
from petmjx.results.recording import Recording
from petmjx.results.schema import summary_table
from petmjx.results.writer import RunWriter
from petmjx.run_options import RunOptions
from petmjx.study import FinishedWorld, Study
from petmjx.sweeps.confidence import write_confidence
from petmjx.sweeps.file import Sweep
from petmjx.sweeps.grid import SweepPlan
from petmjx.sweeps.identity import sweep_identity
from petmjx.sweeps.run import Batching, SweepRun, Tally
from petmjx.sweeps.sliding import hopeless_profiles
from petmjx.sweeps.summary import (
    ShareColumns,
    SweepColumns,
    search_frame,
    search_row,
    summarise_shares,
    summary_units,
)
from petmjx.sweeps.swept import Answer


class SweepStudy(Study):
    """All variants of each plan.

    Args:
        confidence: worlds with errors for each plan, if their share is asked for: then it is a score.

    Raises:
        InputError: as ``SweepPlan``.
    """

    what = "world"

    def __init__(
        self,
        asked: Sweep,
        plans: Sequence[Plan],
        options: RunOptions,
        *,
        confidence: int | None = None,
        batching: Batching | None = None,
    ) -> None:
        self.command = "sweep" if confidence is None else "score"
        self.sim = asked.simulation
        self._asked, self._confidence, self._batching = asked, confidence, batching or Batching()
        self._plan = SweepPlan(asked, plans, options.allow_large, options.strict)
        self.everything, self.skipped = tuple(self._plan.plans), self._plan.skipped
        self.plans = self._plan.plans = [plan for plan in self.everything if options.takes(plan.plan_id)]
        self._columns = SweepColumns(self._plan)
        self.params, self.dynamic = self._columns.params, self._columns.has_drives
        shared = confidence is None and asked.search is None
        self._shares = ShareColumns.of(self._plan) if shared else None
        self._answers: list[dict[str, Any]] = []
        self._tally = Tally()

    @property
    def n_worlds(self) -> int:
        return self._plan.n_worlds

    @property
    def total(self) -> int | None:
        return self.n_worlds if self._asked.search is None else None

    @property
    def amount(self) -> str:
        return self._plan.amount

    def work(self) -> Work:
        return self._plan.work()

    def worlds(
        self, engine: Engine, recorded: Recorded, recording: Recording, progress: Progress
    ) -> Iterator[FinishedWorld]:
        yield from SweepRun(
            self._plan,
            engine,
            on_answer=self._take_answer,
            values_of=self._columns.of,
            recorded=recorded,
            recording=recording,
            progress=progress,
            batching=self._batching,
            tally=self._tally,
        ).worlds()

    def _take_answer(self, answer: Answer) -> None:
        self._answers.append(search_row(answer, self._columns))

    def values(self, world: FinishedWorld) -> Mapping[str, Any]:
        return self._columns.of(world)

    def identity(self) -> dict[str, Any]:
        return {"sweep": sweep_identity(self._asked)}

    def config(self) -> dict[str, Any]:
        return {
            **({"confidence": self._confidence} if self._confidence is not None else {}),
            "sweep": self._asked.resolved(),
            **({"shares": asdict(self._shares)} if self._shares else {}),
        }

    def notes(self) -> Iterable[str]:
        return hopeless_profiles(self._asked)

    def timings(self) -> Mapping[str, float]:
        return vars(self._tally)

    def summarise(self, writer: RunWriter) -> None:
        writer.flush()  # it is made of what is on disk
        if self._confidence is not None:
            write_confidence(writer)
            return
        frame = summarise_shares(writer.parts, self._shares) if self._shares else search_frame(self._answers)
        writer.write_summary(summary_table(frame, *summary_units(frame, self._plan)))
