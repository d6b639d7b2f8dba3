"""Runs one score or sweep from start to end: plans become worlds (simulations), the engine simulates them, and the
outcomes become results.

A *study* makes the worlds from the plans, and the summary from the results (petmjx.runs.study).
"""

from __future__ import annotations

import threading
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from petmjx.common.machine import package_versions
from petmjx.common.text import count_text, printable_name
from petmjx.common.units import FloatArray
from petmjx.engines.engine_choice import Choice
from petmjx.engines.engine_of_run import engine_for
from petmjx.engines.engine_warmup import engine_warmup
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.verdict import Reason
from petmjx.options.physics import Physics
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.order_checks import OrderCheck, check_orders
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import PlanSource, are_files
from petmjx.results.plan_digests import PlanRecord
from petmjx.results.plan_lookup import plans_in_place
from petmjx.results.recording import Recording, recording_of
from petmjx.results.resume import engine_of_earlier_run
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults
from petmjx.results.run_writer import RunWriter
from petmjx.results.stored_plans import placements_table
from petmjx.results.to_json import to_json
from petmjx.runs.reading_processes import read_input
from petmjx.runs.study import FinishedWorld, Study
from petmjx.world.option_lint import notes_about
from petmjx.world.scene import Scene

if TYPE_CHECKING:
    from petmjx.plans.articles import Articles

Intervals = Callable[[Scene, Physics, BoxMetrics], FloatArray | None]
"""Function that computes force intervals (n, 2): the smallest and the largest possible force on the top of each of n
boxes at rest, N. For a world in which these forces are unknown, the function returns None."""


@dataclass(frozen=True)
class RunStart:
    """Facts that are known at the start of a run.

    Attributes:
        what: the noun for a world in messages: "plan", or "world" if plans have several worlds.
        total: number of worlds; None if it is unknown, as in searches.
        size: one line with the number of worlds and steps, and the estimated time.
        choice: the engine, and the reason for its choice.
        progress: the progress of the run, which the engine updates.
        recorded: number of worlds that were completed before the run was resumed. ``total`` includes them.
    """

    what: str
    total: int | None
    size: str
    choice: Choice
    progress: Progress
    recorded: int = 0


class Watcher(Protocol):
    """An object whose methods are called as a run proceeds, such as the progress bar of the command line."""

    def begin(self, start: RunStart) -> None:
        """Called when the run starts."""

    def world_done(self, world: FinishedWorld) -> None:
        """Called when one more world has its final outcome."""


def simulate(
    ask: Callable[[Sequence[Plan], RunOptions], Study],
    sim: Simulation,
    plans: PlanSource | None,
    options: RunOptions,
    watcher: Watcher | None = None,
    intervals: Intervals | None = None,
) -> RunResults:
    """Run a study from its plans to its results.

    Args:
        ask: function that makes the study from the loaded plans.
        sim: options of the simulation.
        plans: as for ``petmjx.score``.
        intervals: function that computes intervals of forces, for the option ``force_intervals``.

    Raises:
        InputError: plans or options are unusable.
        EngineUnavailable: the requested engine cannot run here.
    """
    plans = plans_in_place(plans, options.strict)
    with engine_warmup(options, plans, sim) as startup:
        plan_set, records, edge_risks = read_input(plans, sim, options)
        study = ask(plan_set.plans, options)
        study.edge_risks = edge_risks
        orders = None
        if options.orders is not None:
            all_plans, strict = options.limit is None, options.strict
            orders = check_orders(
                options.orders,
                study.everything,
                takes=options.takes,
                all_plans=all_plans,
                strict=strict,
                articles=_articles(options),
            )
        later_inputs = (
            replace(skipped_plan, number=plan_set.numbers.get(skipped_plan.plan_id or ""))
            for skipped_plan in study.skipped
        )
        about = notes_about(sim, study.everything, axes=study.axes, errors=study.has_errors, driven=study.dynamic)
        notes = [*plan_set.notes, *about]
        plan_set = replace(plan_set, skipped=[*plan_set.skipped, *later_inputs], notes=notes)
        records = {plan.plan_id: records[plan.plan_id] for plan in study.everything}
    earlier = engine_of_earlier_run(options.out) if options.resume and options.out is not None else None
    hands_over = not options.record_details  # only C MuJoCo records details, so C MuJoCo must simulate all worlds
    with engine_for(options, study.work, startup, hands_over=hands_over, earlier=earlier) as (engine, choice):
        recording = recording_of(options, choice.name, study.everything)
        run = _Run(study, options, plan_set, records, orders, engine, choice, recording, intervals)
        return run.results(watcher, {} if are_files(plans) else {plan.plan_id: plan for plan in study.everything})


def _last_permille_s(ends_s: Sequence[float]) -> float:
    """How long the run waited for its last worlds, s: the time from the end of 99.9 % of the worlds to the end of all
    worlds. With fewer than 1,000 worlds, the result is the time between the ends of the last two worlds."""
    last = -(-len(ends_s) // 1000)
    return round(ends_s[-1] - ends_s[-1 - last], 3) if len(ends_s) > last else 0.0


def _articles(options: RunOptions) -> Articles | None:
    """The table of articles that the options name."""
    if options.articles is None:
        return None
    from petmjx.plans.articles import read_articles  # imported here, since it loads Arrow

    return read_articles(options.articles)


@dataclass(eq=False)
class _Run:
    """A run whose input has been checked and whose engine has been chosen.

    Attributes:
        plan_set: the loaded plans, the skipped entries of the input, and warnings about the input.
        records: plan id → record of the plan.
        intervals_s: time spent on computing intervals of forces, s.
    """

    study: Study
    options: RunOptions
    plan_set: PlanSet
    records: Mapping[str, PlanRecord]
    orders: OrderCheck | None
    engine: Engine
    choice: Choice
    recording: Recording
    intervals: Intervals | None
    progress: Progress = field(default_factory=Progress)
    intervals_s: float = 0.0

    def identity(self) -> dict[str, Any]:
        """The settings that may not differ when a run is resumed."""
        return {
            "command": self.study.command,
            "simulation": self.study.sim.model_dump(mode="json"),
            **self.study.identity,
            "engine": self.choice.name,
            "shard": self.options.shard,
            **({"force_intervals": True} if self.options.force_intervals else {}),
            **({} if self.options.keeps_boxes else {"keep": self.options.keep}),
        }

    def config(self) -> dict[str, Any]:
        """The entry ``config`` of ``run.json``: all options of the run."""
        return {
            "command": self.study.command,
            **self.study.config,
            "simulation": self.study.sim.model_dump(mode="json"),
            **self.options.model_dump(mode="json", exclude={"engine", "orders", "out", "overwrite", "resume"}),
            **({"orders": self.orders.file} if self.orders else {}),
            "engine": self.choice.name,
            "engine_reason": self.choice.reason,
        }

    def results(self, watcher: Watcher | None, plans_in_memory: Mapping[str, Plan]) -> RunResults:
        """Simulate all worlds that are not recorded in the output folder yet, and write everything to this folder.

        Args:
            plans_in_memory: plan id → plan, for plans that are in no file.
        """
        study, options = self.study, self.options
        with RunWriter(
            options.out,
            self.config(),
            manifest=Manifest(to_json(self.identity()), self.records, lambda: placements_table(study.plans)),
            orders=self.orders,
            params=study.params,
            variants=study.variants,
            dynamic=study.dynamic,
            force_intervals=options.force_intervals,
            legs=study.legs,
            boxes=options.keeps_boxes,
            versions=package_versions(),
            device=self.engine.device,
            expected_worlds=study.total,
            overwrite=options.overwrite,
            resume=options.resume,
        ) as writer:
            self._note_input(writer)
            self.progress.notes = writer.warnings  # notes of the engine become warnings of the run
            if watcher is not None:
                watcher.begin(self._start(len(writer.recorded)))
            ends_s = array("d")
            for world in study.worlds(self.engine, writer.recorded, self.recording, self.progress):
                if not ends_s:  # load pandas while the engine works: the results need it later
                    threading.Thread(target=import_module, args=("pandas",), name="petmjx-pandas").start()
                self._write(writer, world)
                ends_s.append(time.monotonic())
                if watcher is not None:
                    watcher.world_done(world)
            # The engine is told to end before the last rows are written, because its workers take one or two seconds to
            # end.
            self.engine.retire()
            writer.timings.update(
                study.timings(), compile_s=self.progress.compile_s, last_permille_s=_last_permille_s(ends_s)
            )
            if options.force_intervals:
                writer.timings["intervals_s"] = round(self.intervals_s, 3)
            writer.flush()
            if warning := writer.counts.iteration_limit_warning(study.sim.iteration_limit):
                writer.warn(warning)
            if study.plans:  # a shard may have no plans
                study.summarise(writer)
        return writer.results(plans_in_memory)

    def _note_input(self, writer: RunWriter) -> None:
        """Write skipped plans and warnings to ``run.json``."""
        for skipped in self.plan_set.skipped:
            writer.skip(skipped)
        writer.odd_plans += (str(odd) for odd in self.plan_set.warnings if self.options.takes(odd.plan_id))
        for note in (*self.plan_set.conventions, *self.plan_set.notes, *self.study.notes):
            writer.warn(note)
        if len(writer.recorded) and (missing := self.recording.missing(writer.parts)):
            writer.warn(
                f"{count_text(missing, 'world of an earlier run has', 'worlds of an earlier run have')} no history, "
                "and will not be simulated again; to record histories, name another folder"
            )

    def _start(self, recorded: int) -> RunStart:
        size = self.study.size(self.choice.seconds, recorded)
        return RunStart(self.study.what, self.study.total, size, self.choice, self.progress, recorded)

    def _write(self, writer: RunWriter, world: FinishedWorld) -> None:
        study, plan, index = self.study, world.plan, world.variant.index
        if self.recording.of(plan) and world.outcome.history is None and not world.outcome.message:
            writer.warn(f"the engine {self.choice.name} records no histories")
        outcome = self.recording.kept(world.outcome)
        values, interval_n = study.values(world), self._interval_n(world)
        writer.add(plan, index, study.sim.schedule.value, outcome, world.attempts, values, interval_n)
        if world.outcome.message:
            variant = f", variant {index}" if study.params else ""
            failed = "failed: " if world.outcome.reason is Reason.FAILED else ""
            writer.warn(f"plan {printable_name(plan.plan_id)}{variant}: {failed}{world.outcome.message}")

    def _interval_n(self, world: FinishedWorld) -> FloatArray | None:
        """(n, 2) the smallest and the largest possible force on the top of each box, N; None if intervals are not
        requested. After a drive (motion of the carrier), the result is also None, since the position of the carrier is
        then unknown."""
        if self.intervals is None or world.driven:
            return None
        start = time.perf_counter()
        interval_n = self.intervals(world.scene, self.study.sim.physics, world.outcome.boxes)
        self.intervals_s += time.perf_counter() - start
        return interval_n
