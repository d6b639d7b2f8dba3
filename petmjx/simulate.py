"""One run, whole: plans → worlds → engine → results. Every score and every sweep goes this way."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from petmjx.engines.base import Engine, Progress
from petmjx.engines.choose import Choice
from petmjx.engines.resolve import engine_for
from petmjx.machine import package_versions
from petmjx.plans.gather import PlanSource, are_files, usable_plans
from petmjx.plans.ordered import OrderCheck, check_orders
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.results.manifest import Manifest
from petmjx.results.reader import RunResults
from petmjx.results.schema import summary_table
from petmjx.results.writer import RunWriter
from petmjx.run_options import RunOptions
from petmjx.sweeps.confidence import write_confidence
from petmjx.sweeps.file import Sweep
from petmjx.sweeps.grid import SweepPlan
from petmjx.sweeps.identity import sweep_identity
from petmjx.sweeps.recording import Recording, recording_of
from petmjx.sweeps.run import Batching, SweepRun
from petmjx.sweeps.sliding import hopeless_profiles
from petmjx.sweeps.summary import (
    ShareColumns,
    SweepColumns,
    search_frame,
    search_row,
    summarise_shares,
    summary_units,
)
from petmjx.sweeps.swept import Answer, SweptWorld
from petmjx.text import counted, shown
from petmjx.units import FloatArray
from petmjx.world.carriers import carrier_notes
from petmjx.world.surfaces import check_surfaces


@dataclass(frozen=True)
class RunStart:
    """What is known when a run begins.

    Attributes:
        what: the user's word for a world: "plan", or "world" where plans have several.
        total: number of worlds; None if it is not known (searches).
        size: one line with the number of worlds and steps, and the estimated time.
        choice: which engine, and why.
        progress: kept up to date by the engine.
        recorded: worlds that a resumed run has already; they are part of the total.
    """

    what: str
    total: int | None
    size: str
    choice: Choice
    progress: Progress
    recorded: int = 0


class Watcher(Protocol):
    """Follows a run. The progress bar of the command line is one."""

    def begin(self, start: RunStart) -> None:
        """The run starts."""

    def world_done(self, world: SweptWorld) -> None:
        """One more world has its final outcome."""


def simulate(
    command: str,
    asked: Sweep,
    plans: PlanSource | None,
    options: RunOptions,
    watcher: Watcher | None = None,
    *,
    batching: Batching | None = None,
    confidence: int | None = None,
) -> RunResults:
    """Run something to its end.

    Args:
        command: "score" or "sweep", as the results name it.
        plans: as for ``petmjx.score``.
        confidence: worlds with errors for each plan, if their share is asked for.

    Raises:
        InputError: unusable plans or options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    if options.force_intervals:
        from petmjx.statics.intervals import need_scipy  # beside the way of most runs

        need_scipy()
    found = usable_plans(plans, asked.simulation, options)
    plan = SweepPlan(asked, found.plans, options.allow_large, options.strict)
    everything = tuple(plan.plans)
    plan.plans = [each for each in everything if options.takes(each.plan_id)]
    orders = None
    if options.orders is not None:
        whole, strict = options.limit is None, options.strict
        orders = check_orders(options.orders, everything, takes=options.takes, all_plans=whole, strict=strict)
    late = (replace(each, number=found.numbers.get(each.plan_id or "")) for each in plan.skipped)
    notes = [*found.notes, *check_surfaces(everything, asked.simulation)]
    found = replace(found, skipped=[*found.skipped, *late], notes=notes)
    with engine_for(options, plan.work()) as (engine, choice):
        recording = recording_of(options, choice.name, everything)
        held = {} if are_files(plans) else {each.plan_id: each for each in everything}
        run = _Run(command, options, plan, everything, found, orders, confidence, engine, choice, recording, held)
        return run.results(watcher, batching or Batching())


@dataclass(eq=False)
class _Run:
    """A run whose input has proved good and whose engine is there.

    Attributes:
        everything: the plans of all shards; those of ``plan`` are this run's.
        found: how plans were read: what was skipped, and warnings.
        intervals_s: time that went into intervals of forces.
        held: plans that are in no file, by id.
    """

    command: str
    options: RunOptions
    plan: SweepPlan
    everything: tuple[Plan, ...]
    found: PlanSet
    orders: OrderCheck | None
    confidence: int | None
    engine: Engine
    choice: Choice
    recording: Recording
    held: Mapping[str, Plan]
    progress: Progress = field(default_factory=Progress)
    answers: list[dict[str, Any]] = field(default_factory=list)
    intervals_s: float = 0.0

    @property
    def asked(self) -> Sweep:
        return self.plan.sweep

    @cached_property
    def columns(self) -> SweepColumns | None:
        """The columns that tell a plan's worlds apart; None where it has one world."""
        varied = self.command == "sweep" or self.confidence is not None
        return SweepColumns(self.plan) if varied else None

    @cached_property
    def shares(self) -> ShareColumns | None:
        """What the summary of a grid or a sample is about."""
        return ShareColumns.of(self.plan) if self.command == "sweep" and self.asked.search is None else None

    @property
    def total(self) -> int | None:
        """Number of worlds; None if it is not known."""
        return self.plan.n_worlds if self.asked.search is None else None

    def identity(self) -> dict[str, Any]:
        """What must be the same for a run that goes on."""
        return {
            "command": self.command,
            "simulation": self.asked.simulation.model_dump(mode="json"),
            **({"sweep": sweep_identity(self.asked)} if self.columns else {}),
            "engine": self.choice.name,
            "shard": self.options.shard,
            **({"force_intervals": True} if self.options.force_intervals else {}),
        }

    def config(self) -> dict[str, Any]:
        """What ``run.json`` says of how the run was asked for."""
        return {
            "command": self.command,
            **({"confidence": self.confidence} if self.confidence is not None else {}),
            **({"sweep": self.asked.resolved()} if self.columns else {}),
            "simulation": self.asked.simulation.model_dump(mode="json"),
            **self.options.model_dump(mode="json", exclude={"engine", "orders", "out", "overwrite", "resume"}),
            **({"orders": self.orders.file} if self.orders else {}),
            **({"shares": asdict(self.shares)} if self.shares else {}),
            "engine": self.choice.name,
            "engine_reason": self.choice.reason,
        }

    def results(self, watcher: Watcher | None, batching: Batching) -> RunResults:
        """Simulate what is missing, and write everything where the options say."""
        columns, options = self.columns, self.options
        with RunWriter(
            options.out,
            self.config(),
            manifest=Manifest.of(self.identity(), self.everything, self.found.numbers),
            orders=self.orders,
            params=columns.params if columns else (),
            dynamic=bool(columns and columns.has_drives),
            force_intervals=options.force_intervals,
            versions=package_versions(),
            device=self.engine.device,
            expected_worlds=self.total,
            overwrite=options.overwrite,
            resume=options.resume,
        ) as writer:
            self._note_input(writer)
            self.progress.notes = writer.warnings  # one place for both
            swept = SweepRun(
                self.plan,
                self.engine,
                on_answer=self._take_answer,
                values_of=columns.of if columns else lambda world: {},
                recorded=writer.recorded,
                recording=self.recording,
                progress=self.progress,
                batching=batching,
            )
            if watcher is not None:
                watcher.begin(self._start(len(writer.recorded)))
            for world in swept.worlds():
                self._write(writer, world)
                if watcher is not None:
                    watcher.world_done(world)
            writer.timings.update(vars(swept.tally) if columns else {}, compile_s=self.progress.compile_s)
            if options.force_intervals:
                writer.timings["intervals_s"] = round(self.intervals_s, 3)
            writer.put_in_order()
            if self.plan.plans:  # a shard may have none
                self._summarise(writer)
        return writer.results(self.held)

    def _note_input(self, writer: RunWriter) -> None:
        """Write skipped plans and warnings into ``run.json``."""
        for skipped in self.found.skipped:
            writer.skip(skipped)
        writer.odd_plans += (str(odd) for odd in self.found.warnings if self.options.takes(odd.plan_id))
        sim = self.asked.simulation
        # friction by materials may hold what that of boxes and carrier does not
        hopeless = () if any(plan.materials for plan in self.everything) else hopeless_profiles(self.asked)
        for note in (*self.found.conventions, *self.found.notes, *carrier_notes(sim), *hopeless):
            writer.warn(note)
        if len(writer.recorded) and (missing := self.recording.missing(writer.parts)):
            of = counted(missing, "world")
            writer.warn(f"no history of {of} of before, not simulated again: name another folder to record them")

    def _take_answer(self, answer: Answer) -> None:
        if self.columns:
            self.answers.append(search_row(answer, self.columns))

    def _start(self, recorded: int) -> RunStart:
        left = 1 - recorded / max(self.plan.n_worlds, 1)
        seconds = self.choice.seconds
        size = self.plan.size(None if seconds is None else seconds * left)
        what = "world" if self.columns else "plan"
        return RunStart(what, self.total, size, self.choice, self.progress, recorded)

    def _write(self, writer: RunWriter, world: SweptWorld) -> None:
        values = self.columns.of(world) if self.columns else None
        schedule = self.asked.simulation.schedule.value
        index = world.variant.index
        outcome = self.recording.kept(world.outcome)
        if self.recording.of(world.plan) and world.outcome.history is None and not world.outcome.message:
            writer.warn(f"the engine {self.choice.name} records no histories")
        interval_n = self._intervals_n(world) if self.options.force_intervals else None
        writer.add(world.plan, index, schedule, outcome, world.attempts, values, interval_n)
        if world.outcome.message:
            variant = f", variant {index}" if self.columns else ""
            writer.warn(f"plan {shown(world.plan.plan_id)}{variant}: failed: {world.outcome.message}")

    def _intervals_n(self, world: SweptWorld) -> FloatArray | None:
        """(n, 2) least and most force on top of each box, N; None where a world has no force at rest, and after a
        drive, since nothing tells where the carrier stands then."""
        boxes = world.outcome.boxes
        at_rest = np.column_stack([boxes.rest_top_force_n, boxes.pos, boxes.quat])
        if world.driven or not np.isfinite(at_rest).all():
            return None
        from petmjx.statics.intervals import force_intervals

        start = time.perf_counter()
        found = force_intervals(world.scene, self.asked.simulation.physics, boxes.pos, boxes.quat)
        self.intervals_s += time.perf_counter() - start
        return found

    def _summarise(self, writer: RunWriter) -> None:
        """Write the table ``summary``, which is made of what is on disk."""
        if self.columns is None:
            return
        writer.flush()
        if self.confidence is not None:
            write_confidence(writer)
            return
        frame = summarise_shares(writer.parts, self.shares) if self.shares else search_frame(self.answers)
        writer.write_summary(summary_table(frame, *summary_units(frame, self.plan)))
