"""Scoring and sweeping from Python: ``petmjx.score`` and ``petmjx.sweep``.

A score is a sweep with one variant: both go through ``_simulate``.
"""

from __future__ import annotations

import inspect
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

from petmjx.checked import Checked
from petmjx.config import Simulation
from petmjx.engines.base import Progress
from petmjx.engines.choose import Choice, engine_for
from petmjx.machine import device_name, package_versions
from petmjx.plans.gather import PathArgument, PlanSource, usable_plans
from petmjx.plans.ordered import check_orders
from petmjx.plans.plan import PlanSet
from petmjx.results.manifest import Manifest
from petmjx.results.reader import RunResults, load_run
from petmjx.results.writer import RunWriter, write_summary
from petmjx.run_options import Confidence, RunOptions, sorted_options
from petmjx.sweeps.confidence import confidence_sweep, write_confidence
from petmjx.sweeps.file import Sweep, load_sweep, nominal_sweep
from petmjx.sweeps.grid import SweepPlan
from petmjx.sweeps.identity import sweep_identity
from petmjx.sweeps.ready import find_sweep
from petmjx.sweeps.run import Batching, SweepRun, SweptWorld
from petmjx.sweeps.sliding import hopeless_profiles
from petmjx.sweeps.summary import (
    ShareColumns,
    SweepColumns,
    search_frame,
    search_row,
    summarise_shares,
    summary_units,
)
from petmjx.text import shown

Function = TypeVar("Function", bound=Callable[..., Any])


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


def _takes_options(*records: type[Checked]) -> Callable[[Function], Function]:
    """Give a function with ``**options`` a signature and documentation that list the records' fields."""

    def decorate(function: Function) -> Function:
        own = inspect.signature(function)
        named = [p for p in own.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        fields = {name: info for record in records for name, info in record.model_fields.items()}
        named += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=info.default, annotation=info.annotation)
            for name, info in fields.items()
        ]
        lines = [f"    {name}: {info.description}." for name, info in fields.items()]
        function.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\nOptions:\n" + "\n".join(lines) + "\n"
        function.__signature__ = own.replace(parameters=named)  # type: ignore[attr-defined]  # what inspect reads
        return function

    return decorate


@_takes_options(Simulation, Confidence, RunOptions)
def score(plans: PlanSource | None = None, *, watcher: Watcher | None = None, **options: Any) -> RunResults:
    """Simulate each plan and say whether it stands, and with ``confidence`` how sure that is.

    ``petmjx.score("plans.json", schedule="fixed", thresholds={"shift_m": 0.03}, out="results")``

    Args:
        plans: a file, a folder, several of them, a plan, a list of plans or a ``PlanSet``; None: the bundled samples.
        watcher: follows the run.
        options: ``confidence`` and ``errors``, fields of ``petmjx.Simulation`` and ``petmjx.RunOptions``, listed below.

    Returns:
        The results, with ``.worlds``, ``.boxes`` and ``.attempts`` as data frames and ``.info``. With ``confidence``
        also ``.summary``, and ``.worlds`` has more than one row a plan: variant 0 is the one without errors.

    Raises:
        InputError: unusable plans or options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    of_simulation, of_run, of_confidence = sorted_options(options, Confidence)
    run, sure = RunOptions(**of_run), Confidence(**of_confidence)
    if sure.confidence is None:
        return _simulate("score", nominal_sweep(Simulation(**of_simulation)), plans, run, watcher, Batching())
    asked = confidence_sweep(sure.confidence, sure.errors, of_simulation)
    return _simulate("score", asked, plans, run, watcher, Batching(), sure.confidence)


@_takes_options(Simulation, RunOptions)
def sweep(
    file: PathArgument,
    plans: PlanSource | None = None,
    *,
    watcher: Watcher | None = None,
    batching: Batching | None = None,
    **options: Any,
) -> RunResults:
    """Simulate each plan in all variants that a sweep file asks for.

    Args:
        file: a sweep file, or the name of a ready-made sweep such as ``eumos``.
        plans: as for :func:`score`; they replace those that the file names. None: the file's.
        watcher: follows the run.
        batching: how many states and worlds are held in memory; changes no result.
        options: fields of ``petmjx.Simulation``, which replace those of the file, and of ``petmjx.RunOptions``.

    Returns:
        The results, with ``.worlds``, ``.boxes``, ``.attempts`` and ``.summary`` as data frames and ``.info``.

    Raises:
        InputError: an unusable sweep file, plans or options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    of_simulation, of_run = sorted_options(options)
    asked = load_sweep(find_sweep(Path(file)), plans_given=plans is not None, simulation=of_simulation)
    if plans is None and isinstance(asked.plans, tuple):
        plans = list(asked.plans)
    return _simulate("sweep", asked, plans, RunOptions(**of_run), watcher, batching or Batching())


def _simulate(
    command: str,
    asked: Sweep,
    plans: PlanSource | None,
    options: RunOptions,
    watcher: Watcher | None,
    batching: Batching,
    confidence: int | None = None,
) -> RunResults:
    """Plans → worlds → engine → results; every run of petmjx goes this way.

    Args:
        confidence: worlds with errors for each plan, if their share is asked for.
    """
    sim = asked.simulation
    varied = command == "sweep" or confidence is not None
    found = usable_plans(plans, sim, options)
    plan = SweepPlan(asked, found.plans, options.allow_large, options.strict)
    everything = plan.plans
    plan.plans = [each for each in everything if options.takes(each.plan_id)]
    orders = None
    if options.orders is not None:
        whole, strict = options.limit is None, options.strict
        orders = check_orders(options.orders, everything, takes=options.takes, all_plans=whole, strict=strict)
    with engine_for(options, plan.work()) as (engine, choice):
        columns = SweepColumns(plan) if varied else None
        shares = ShareColumns.of(plan) if command == "sweep" and asked.search is None else None
        total = plan.n_worlds if asked.search is None else None
        progress = Progress()
        simulation = sim.model_dump(mode="json")
        settings = {
            "command": command,
            "simulation": simulation,
            **({"sweep": sweep_identity(asked)} if varied else {}),
            "engine": choice.name,
            "shard": options.shard,
        }
        config = {
            "command": command,
            **({"confidence": confidence} if confidence is not None else {}),
            **({"sweep": asked.resolved()} if varied else {}),
            "simulation": simulation,
            **options.model_dump(mode="json", exclude={"engine", "orders", "out", "overwrite", "resume"}),
            **({"orders": orders.file} if orders else {}),
            **({"shares": asdict(shares)} if shares else {}),
            "engine": choice.name,
            "engine_reason": choice.reason,
        }

        def run(folder: Path) -> RunResults:
            rows: list[dict[str, Any]] = []
            with RunWriter(
                folder,
                config,
                manifest=Manifest.of(settings, everything),
                orders=orders,
                params=columns.params if columns else (),
                dynamic=bool(columns and columns.has_drives),
                versions=package_versions(),
                device=getattr(engine, "device", "") or device_name(choice.name, options.threads),
                expected_worlds=total,
                overwrite=options.overwrite,
                resume=options.resume,
            ) as writer:
                _note_input(writer, replace(found, skipped=[*found.skipped, *plan.skipped]))
                for note in hopeless_profiles(asked):
                    writer.warn(note)
                swept = SweepRun(
                    plan,
                    engine,
                    on_answer=lambda answer: rows.append(search_row(answer, columns)) if columns else None,
                    values_of=columns.of if columns else lambda world: {},
                    recorded=writer.recorded,
                    progress=progress,
                    batching=batching,
                )
                if watcher is not None:
                    what = "world" if varied else "plan"
                    left = 1 - len(writer.recorded) / max(plan.n_worlds, 1)
                    size = plan.size(None if choice.seconds is None else choice.seconds * left)
                    watcher.begin(RunStart(what, total, size, choice, progress, len(writer.recorded)))
                for world in swept.worlds():
                    values = columns.of(world) if columns else None
                    writer.add(
                        world.plan,
                        world.variant.index,
                        choice.name,
                        sim.schedule.value,
                        world.outcome,
                        world.attempts,
                        values,
                    )
                    if world.outcome.message:
                        variant = f", variant {world.variant.index}" if columns else ""
                        writer.warn(f"plan {shown(world.plan.plan_id)}{variant}: failed: {world.outcome.message}")
                    if watcher is not None:
                        watcher.world_done(world)
                writer.timings.update(vars(swept.tally) if columns else {}, compile_s=progress.compile_s)
                if columns and plan.plans:  # a shard may have none
                    writer.flush()  # shares are taken of what is on disk
                    if confidence is not None:
                        write_confidence(folder)
                    else:
                        frame = summarise_shares(folder, shares) if shares else search_frame(rows)
                        write_summary(folder, frame, *summary_units(frame, plan))
            return load_run(folder)

        return run(options.out) if options.out is not None else _in_temporary_folder(run)


def _note_input(writer: RunWriter, found: PlanSet) -> None:
    """Write skipped plans and warnings into ``run.json``."""
    for skipped in found.skipped:
        writer.skip(skipped)
    writer.odd_plans += map(str, found.warnings)


def _in_temporary_folder(run: Callable[[Path], RunResults]) -> RunResults:
    """Run into a folder that is deleted together with the returned results, or when the run fails."""
    temporary = tempfile.TemporaryDirectory(prefix="petmjx-")
    try:
        results = run(Path(temporary.name))
    except BaseException:
        temporary.cleanup()
        raise
    weakref.finalize(results, temporary.cleanup)
    return results
