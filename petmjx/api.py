"""Scoring and sweeping from Python: ``petmjx.score``, ``petmjx.sweep``, and what the command line shares with them."""

from __future__ import annotations

import math
import tempfile
import weakref
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

from pydantic import ValidationError

from petmjx.config import CARRIER_EXTENT_M, PHYSICS, Carrier, Check, Physics, Schedule, SimConfig, Thresholds
from petmjx.engines.base import Engine, Progress
from petmjx.engines.choose import AUTO, Choice, resolve_engine
from petmjx.engines.retry import WorldResult, nominal_worlds, score_worlds
from petmjx.errors import InputError
from petmjx.machine import cpu_name, cpu_threads, cuda_devices, package_versions
from petmjx.plans.plan import Plan, PlanSet, Skipped
from petmjx.plans.read import load_plans
from petmjx.plans.samples import bundled_path
from petmjx.results.reader import RunResults, load_run
from petmjx.results.writer import RunWriter, write_summary
from petmjx.sweeps.cost import sweep_engine, sweep_seconds
from petmjx.sweeps.file import load_sweep
from petmjx.sweeps.grid import SweepPlan
from petmjx.sweeps.ready import find_sweep
from petmjx.sweeps.run import Batching, SweepRun, SweptWorld
from petmjx.sweeps.summary import (
    SweepColumns,
    search_frame,
    search_row,
    search_strength,
    summarise_shares,
    summary_units,
)
from petmjx.units import MM_PER_M
from petmjx.world.scene import DEFAULT_SIZE_REDUCTION_MM

PathArgument = str | PathLike[str]
PlanSource = PathArgument | Sequence[PathArgument] | Sequence[Plan] | PlanSet


class Watcher(Protocol):
    """Is told how a run goes. The command line's progress bar is one."""

    def begin(self, total: int, choice: Choice, progress: Progress) -> None:
        """The run starts: so many worlds, on this engine. The engine keeps ``progress`` up to date."""

    def world_done(self, result: WorldResult) -> None:
        """One more world has its final outcome."""


def configure(
    *,
    check: Check | str = Check.ONE_BY_ONE,
    schedule: Schedule | str = Schedule.ADAPTIVE,
    physics: Physics | str = "pallet",
    interval_s: float = 0.7,
    duration_s: float = 10.0,
    sample_interval_s: float = 0.2,
    early_stop: bool = True,
    thresholds: Thresholds | None = None,
) -> SimConfig:
    """The validated configuration of a run. Arguments are those of :func:`score`.

    Raises:
        InputError: a value that makes no sense; the line names it.
    """
    if isinstance(physics, str):
        if physics not in PHYSICS:
            raise InputError(f"unknown physics {physics!r}; there are {', '.join(PHYSICS)}")
        physics = PHYSICS[physics]
    times = {"interval_s": interval_s, "duration_s": duration_s, "sample_interval_s": sample_interval_s}
    for name, value in times.items():
        if not (math.isfinite(value) and value >= physics.timestep_s):
            raise InputError(f"{name} must be at least the timestep of {physics.timestep_s:g} s, got {value:g}")
    values: dict[str, Any] = {"check": check, "schedule": schedule, "early_stop": early_stop, **times}
    try:
        return SimConfig(physics=physics, thresholds=thresholds or Thresholds(), **values)
    except ValidationError as error:
        problem = error.errors()[0]
        name = ".".join(str(part) for part in problem["loc"])
        raise InputError(f"{name}: {problem['msg']}, got {problem['input']!r}") from None


def score(
    plans: PlanSource | None = None,
    *,
    check: Check | str = Check.ONE_BY_ONE,
    schedule: Schedule | str = Schedule.ADAPTIVE,
    engine: str | Engine = AUTO,
    physics: Physics | str = "pallet",
    interval_s: float = 0.7,
    duration_s: float = 10.0,
    sample_interval_s: float = 0.2,
    size_reduction_mm: float = DEFAULT_SIZE_REDUCTION_MM,
    carrier: Carrier | str = Carrier.FOOTPRINT,
    early_stop: bool = True,
    thresholds: Thresholds | None = None,
    limit: int | None = None,
    strict: bool = False,
    threads: int | None = None,
    lanes: int | None = None,
    out: PathArgument | None = None,
    overwrite: bool = False,
    watcher: Watcher | None = None,
) -> RunResults:
    """Simulate each plan and say whether it stands.

    Args:
        plans: a file, a folder, several of them, a ``PlanSet`` or a list of ``Plan``; None: the bundled samples.
        check: ``one-by-one`` places a box after the other, ``static`` has all of them stand from the start.
        schedule: ``adaptive`` places the next box as soon as the pallet is quiet and nothing creeps; ``brisk`` as soon
            as it is quiet (about twice as fast on a GPU; 1.5 % of verdicts differ from ``fixed``); ``fixed`` every
            ``interval_s``.
        engine: ``auto``, ``mujoco``, ``mjx-jax``, ``mjx-warp``, or an engine of your own.
        physics: ``pallet``, ``reference``, or a :class:`~petmjx.config.Physics` of your own.
        interval_s: time between two placements, s; the longest where they wait for quiet.
        duration_s: length of the static check, s.
        sample_interval_s: time between two samples of the metrics, s.
        size_reduction_mm: each box dimension is reduced by this, mm.
        carrier: ``footprint``, ``euro-pallet`` or ``rollcontainer``.
        early_stop: end a world as soon as a box has dropped.
        thresholds: where a plan stops being stable.
        limit: take only this many plans.
        strict: raise at the first unusable plan instead of skipping it.
        threads: CPU threads of the engine ``mujoco``; None: all.
        lanes: worlds at once of the MJX engines; None: chosen from the device's memory.
        out: folder for the results; None: a temporary one that goes away with the returned object.
        overwrite: replace the results that ``out`` holds.
        watcher: is told how the run goes.

    Returns:
        The results, with ``.worlds``, ``.boxes`` and ``.attempts`` as data frames and ``.info``.

    Raises:
        InputError: unusable plans or options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    sim = configure(
        check=check,
        schedule=schedule,
        physics=physics,
        interval_s=interval_s,
        duration_s=duration_s,
        sample_interval_s=sample_interval_s,
        early_stop=early_stop,
        thresholds=thresholds,
    )
    carrier = _carrier(carrier)
    found = _usable_plans(plans, limit, strict, carrier, size_reduction_mm)
    sizes = [plan.n_boxes for plan in found.plans]
    if isinstance(engine, str):
        engine, choice = resolve_engine(engine, sizes, sim, threads=threads, lanes=lanes)
    else:
        choice = Choice(engine.name, "given")

    config = {
        "command": "score",
        "sim": sim.model_dump(mode="json"),
        "carrier": carrier.value,
        "size_reduction_mm": size_reduction_mm,
        "engine": choice.name,
        "engine_reason": choice.reason,
        "limit": limit,
        "strict": strict,
        "threads": threads,
        "lanes": lanes,
    }

    def run(folder: Path) -> RunResults:
        progress = Progress()
        with RunWriter(
            folder,
            config,
            versions=package_versions(),
            device=_device(choice.name, threads),
            expected_worlds=len(found.plans),
            overwrite=overwrite,
        ) as writer:
            note_input(writer, found)
            if watcher is not None:
                watcher.begin(len(found.plans), choice, progress)
            worlds = nominal_worlds(found.plans, sim.physics, carrier, size_reduction_mm)
            for result in score_worlds(worlds, sim, engine, progress=progress):
                plan, variant = result.world.plan, result.world.variant
                writer.add(plan, variant, choice.name, sim.schedule.value, result.outcome, result.attempts)
                if watcher is not None:
                    watcher.world_done(result)
            writer.timings["compile_s"] = progress.compile_s
        return load_run(folder)

    return run(Path(out)) if out is not None else in_temporary_folder(run)


def _usable_plans(
    plans: PlanSource | None, limit: int | None, strict: bool, carrier: Carrier, size_reduction_mm: float
) -> PlanSet:
    """The plans that can be simulated.

    Raises:
        InputError: there is none.
    """
    found = gather_plans(plans, limit=limit, strict=strict, carrier=carrier)
    found = without_vanishing_boxes(found, size_reduction_mm, strict)
    if not found.plans:
        first = f"; the first: {found.skipped[0].message}" if found.skipped else ""
        raise InputError(f"no usable plan ({len(found.skipped)} skipped){first}")
    return found


class SweepWatcher(Protocol):
    """Is told how a sweep goes."""

    def planned(self, estimate: str) -> None:
        """One line on how many worlds and placements there will be, and how long that may take."""

    def begin(self, total: int | None, choice: Choice, progress: Progress) -> None:
        """The sweep starts: so many worlds (a search does not know), on this engine, which keeps ``progress``."""

    def world_done(self, world: SweptWorld) -> None:
        """One more world has its final outcome."""


def sweep(
    file: PathArgument,
    plans: PlanSource | None = None,
    *,
    engine: str | Engine = AUTO,
    limit: int | None = None,
    strict: bool = False,
    allow_large: bool = False,
    threads: int | None = None,
    lanes: int | None = None,
    out: PathArgument | None = None,
    overwrite: bool = False,
    watcher: SweepWatcher | None = None,
    batching: Batching | None = None,
) -> RunResults:
    """Simulate each plan in all variants that a sweep file asks for.

    Args:
        file: a sweep file, or the name of a ready-made sweep such as ``eumos``.
        plans: as for :func:`score`, instead of those the file names; None: the file's.
        engine, limit, strict, threads, lanes, out, overwrite: as for :func:`score`.
        allow_large: accept more than a million worlds.
        watcher: is told how the sweep goes.
        batching: how much is held and simulated at a time; changes no result.

    Returns:
        The results, with ``.worlds``, ``.boxes``, ``.attempts`` and ``.summary`` as data frames and ``.info``.

    Raises:
        InputError: an unusable sweep file, plans or options.
        EngineUnavailable: the engine asked for cannot run here.
    """
    asked = load_sweep(find_sweep(Path(file)), plans_given=plans is not None)
    settings = asked.simulation
    sim = settings.sim_config()
    if plans is None and isinstance(asked.plans, tuple):
        plans = list(asked.plans)
    found = _usable_plans(plans, limit, strict, settings.carrier, settings.size_reduction_mm)
    plan = SweepPlan(asked, found.plans, allow_large)
    if isinstance(engine, str):
        engine, choice = sweep_engine(engine, plan, threads=threads, lanes=lanes)
    else:
        choice = Choice(engine.name, "given")
    searches = plan.search is not None
    columns = SweepColumns(plan)
    config = {
        "command": "sweep",
        "sweep": asked.resolved(),
        "sim": sim.model_dump(mode="json"),
        "carrier": settings.carrier.value,
        "size_reduction_mm": settings.size_reduction_mm,
        "engine": choice.name,
        "engine_reason": choice.reason,
        "limit": limit,
        "strict": strict,
        "threads": threads,
        "lanes": lanes,
    }

    def run(folder: Path) -> RunResults:
        progress = Progress()
        rows: list[dict[str, Any]] = []
        swept = SweepRun(
            plan,
            engine,
            on_answer=lambda answer: rows.append(search_row(answer, columns, search_strength(plan))),
            progress=progress,
            batching=batching or Batching(),
        )
        with RunWriter(
            folder,
            config,
            params=columns.params,
            dynamic=columns.has_drives,
            versions=package_versions(),
            device=_device(choice.name, threads),
            expected_worlds=None if searches else plan.n_worlds,
            overwrite=overwrite,
        ) as writer:
            note_input(writer, found)
            if watcher is not None:
                seconds = sweep_seconds(plan, threads or cpu_threads())
                watcher.planned(plan.estimate(seconds.get(choice.name, seconds["mujoco"])))
                watcher.begin(None if searches else plan.n_worlds, choice, progress)
            for world in swept.worlds():
                index, values = world.variant.index, columns.of(world)
                name, schedule = choice.name, sim.schedule.value
                writer.add(world.plan, index, name, schedule, world.outcome, world.attempts, values)
                if watcher is not None:
                    watcher.world_done(world)
            writer.timings.update(vars(swept.tally), compile_s=progress.compile_s)
        frame = search_frame(rows) if searches else summarise_shares(folder, plan)
        write_summary(folder, frame, *summary_units(frame, plan))
        return load_run(folder)

    return run(Path(out)) if out is not None else in_temporary_folder(run)


def in_temporary_folder(run: Callable[[Path], RunResults]) -> RunResults:
    """Run into a folder that goes away when the returned results do (or when the run fails)."""
    temporary = tempfile.TemporaryDirectory(prefix="petmjx-")
    try:
        results = run(Path(temporary.name))
    except BaseException:
        temporary.cleanup()
        raise
    weakref.finalize(results, temporary.cleanup)
    return results


def gather_plans(
    plans: PlanSource | None, *, limit: int | None = None, strict: bool = False, carrier: Carrier = Carrier.FOOTPRINT
) -> PlanSet:
    """Plans from whatever :func:`score` takes: files are read and checked, plans are taken as they are."""
    if plans is None:
        plans = bundled_path()
    if isinstance(plans, PlanSet):
        return PlanSet(plans.plans[:limit], plans.skipped, plans.warnings)
    given = [plans] if isinstance(plans, str | PathLike) else list(plans)
    ready = [plan for plan in given if isinstance(plan, Plan)]
    if ready:
        if len(ready) != len(given):
            raise InputError("give either paths or plans, not both")
        return PlanSet(ready[:limit])
    extent_m = CARRIER_EXTENT_M[carrier]
    return load_plans(
        [path for path in given if not isinstance(path, Plan)],
        limit=limit,
        strict=strict,
        carrier_extent_mm=None if extent_m is None else (extent_m[0] * MM_PER_M, extent_m[1] * MM_PER_M),
    )


def without_vanishing_boxes(found: PlanSet, size_reduction_mm: float, strict: bool = False) -> PlanSet:
    """Skip plans with a box that the size reduction (mm) would leave without extent.

    Raises:
        InputError: a reduction that is not ≥ 0; with ``strict``, a plan that would be skipped.
    """
    if not (math.isfinite(size_reduction_mm) and size_reduction_mm >= 0):
        raise InputError(f"size_reduction_mm must be ≥ 0, got {size_reduction_mm:g}")
    kept, skipped = [], list(found.skipped)
    for plan in found.plans:
        thin = (plan.size_mm <= size_reduction_mm).any(axis=1)
        if not thin.any():
            kept.append(plan)
            continue
        box = int(thin.argmax())
        message = (
            f"{plan.source}: plan {plan.plan_id}, placement {box}: a side of {plan.size_mm[box].min():g} mm "
            f"vanishes under the size reduction of {size_reduction_mm:g} mm"
        )
        if strict:
            raise InputError(message)
        skipped.append(Skipped(plan.source, plan.plan_id, message))
    return PlanSet(kept, skipped, found.warnings)


def note_input(writer: RunWriter, found: PlanSet) -> None:
    """Write what was skipped and what is odd about the plans into the run's record."""
    for skipped in found.skipped:
        writer.skip(skipped.plan_id or "", skipped.source, skipped.message)
    for warning in found.warnings:
        writer.warn(str(warning))


def _carrier(carrier: Carrier | str) -> Carrier:
    try:
        return Carrier(carrier)
    except ValueError:
        raise InputError(f"unknown carrier {carrier!r}; there are {', '.join(Carrier)}") from None


def _device(engine: str, threads: int | None) -> str:
    if engine == "mjx-warp" and cuda_devices():
        return cuda_devices()[0]
    if engine == "mjx-jax":
        import jax

        device = jax.devices()[0]
        return device.device_kind if device.platform != "cpu" else f"{cpu_name()} (jax on {device.platform})"
    return f"{cpu_name()}, {threads or cpu_threads()} threads"
