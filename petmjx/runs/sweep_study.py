"""The study of runs in which a plan has several variants: it defines the worlds (simulations) of sweeps, of scores with
confidence and of chains, and how they are summarised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from petmjx.engines.protocol import Engine, Progress
from petmjx.options.run_options import RunOptions
from petmjx.plans.plan import Plan
from petmjx.results.recording import Recording
from petmjx.results.resume import CompletedWorlds
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import summary_table
from petmjx.runs.chain_summary import ChainColumns, write_chain
from petmjx.runs.confidence import write_confidence
from petmjx.runs.forked_worlds import Batching
from petmjx.runs.hopeless_profiles import hopeless_profiles
from petmjx.runs.study import FinishedWorld, Study
from petmjx.runs.sweep_cost import work_of
from petmjx.runs.sweep_design import sweep_identity
from petmjx.runs.sweep_file import Sweep
from petmjx.runs.sweep_run import SweepRun, Tally
from petmjx.runs.sweep_summary import (
    ShareColumns,
    SweepColumns,
    search_frame,
    search_row,
    summarise_shares,
    summary_units,
)
from petmjx.runs.sweep_worlds import SweepPlan


class SweepStudy(Study):
    """The study whose worlds are all variants of each plan.

    Args:
        confidence: number of worlds with errors per plan, for a score with confidence. For a sweep, ``confidence`` is
            None.

    Raises:
        InputError: see ``SweepPlan``.
    """

    def __init__(
        self,
        sweep: Sweep,
        plans: Sequence[Plan],
        options: RunOptions,
        *,
        confidence: int | None = None,
        batching: Batching | None = None,
    ) -> None:
        plan = SweepPlan(sweep, plans, options.allow_large, options.strict)
        everything = tuple(plan.plans)
        plan.plans = [input_plan for input_plan in everything if options.takes(input_plan.plan_id)]
        self._plan, self._columns = plan, SweepColumns(plan)
        self._confidence, self._batching = confidence, batching or Batching()
        shares = confidence is None and sweep.search is None and not sweep.legs
        self._shares = ShareColumns.of(plan) if shares else None
        self._chain = ChainColumns.of(plan) if sweep.legs else None
        first = int(not sweep.nominal)  # number of the first variant
        self._answers: list[dict[str, Any]] = []
        self._tally = Tally()
        super().__init__(
            sim=sweep.simulation,
            everything=everything,
            plans=plan.plans,
            work=work_of(plan),
            n_worlds=plan.n_worlds,
            variants=None if sweep.search is not None else range(first, first + plan.n_variants),
            amount=plan.amount,
            command="sweep" if confidence is None else "score",
            what="world",
            skipped=plan.skipped,
            # If friction depends on materials, the run has no warnings about hopeless profiles: the friction of some
            # materials may hold loads that the general friction does not hold.
            notes=() if any(input_plan.materials for input_plan in everything) else hopeless_profiles(sweep),
            params=self._columns.params,
            dynamic=self._columns.has_drives,
            legs=self._chain is not None and len(self._chain.legs) > 1,
            axes=(*sweep.axes, *(["wrap_turns"] if any(leg.wrap_turns for leg in sweep.legs) else [])),
            has_errors=plan.has_errors,
            identity={"sweep": sweep_identity(sweep)},
            config={
                **({"confidence": confidence} if confidence is not None else {}),
                "sweep": sweep.resolved(),
                **({"shares": asdict(self._shares)} if self._shares else {}),
                **({"chain": asdict(self._chain)} if self._chain else {}),
            },
        )

    def worlds(
        self, engine: Engine, recorded: CompletedWorlds, recording: Recording, progress: Progress
    ) -> Iterator[FinishedWorld]:
        yield from SweepRun(
            self._plan,
            engine,
            on_answer=lambda search: self._answers.append(search_row(search, self._plan, self._columns)),
            values_of=self._columns.of,
            recorded=recorded,
            recording=recording,
            progress=progress,
            batching=self._batching,
            tally=self._tally,
        ).worlds()

    def values(self, world: FinishedWorld) -> Mapping[str, Any]:
        return self._columns.of(world)

    def timings(self) -> Mapping[str, float]:
        return vars(self._tally)

    def summarise(self, writer: RunWriter) -> None:
        if self._chain is not None:
            write_chain(writer, self._chain)
            return
        if self._confidence is not None:
            write_confidence(writer, self._plan.sweep.axes)
            return
        frame = summarise_shares(writer.parts, self._shares) if self._shares else search_frame(self._answers)
        writer.write_summary(summary_table(frame, *summary_units(frame, self._plan)))
