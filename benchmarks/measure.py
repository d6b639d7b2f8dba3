"""Runs cases and measures them. Everything that is timed goes through the code that ``petmjx score`` goes through."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import petmjx.api as api
from benchmarks.agreement import agreement
from benchmarks.cases import SEED, STACK_PLAN, Case, PlainLoopCase, StackCase, WorkloadCase, oracle_case
from benchmarks.plain import fixed_steps, plain_loop
from benchmarks.record import (
    device_of,
    environment,
    peak_device_bytes,
    peak_memory_bytes,
    reset_peak_memory,
)
from petmjx.config import PHYSICS, SOFT_START_STEPS, Schedule, Simulation
from petmjx.engines.base import Engine, Progress
from petmjx.engines.choose import make_engine
from petmjx.errors import InputError
from petmjx.plans.plan import Plan, PlanSet
from petmjx.plans.read import load_plans
from petmjx.plans.samples import generate_one, write_plans, write_samples
from petmjx.results.reader import RunResults, load_run
from petmjx.sweeps.run import SweptWorld
from petmjx.units import seconds_to_steps
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scene

DEFAULT_STACK_LANES = 2048
ORACLE_ENGINE = "mujoco"

Result = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """What the caller decides about a benchmark run.

    Attributes:
        plans: file with the workload's plans; None: the samples of ``SEED``, generated into ``work`` when needed.
        work: folder that keeps what the timed runs write.
        limit: at most so many plans of a workload; ``skip``: without the first so many.
        lanes, threads: as for ``make_engine``; None: the engine's own choice.
        max_seconds: a workload is cut off after this (wall time), and the result says so.
        repeat: times a workload is run on an engine; each further run is compared with the first.
        oracles: schedules of engine ``mujoco`` that workloads are compared with; run first, on at most
            ``oracle_limit`` plans.
        against: label → folders of earlier runs to compare workloads with.
    """

    work: Path
    plans: Path | None = None
    limit: int | None = None
    skip: int = 0
    lanes: int | None = None
    threads: int | None = None
    max_seconds: float | None = None
    repeat: int = 1
    oracles: tuple[Schedule, ...] = ()
    oracle_limit: int | None = None
    against: dict[str, tuple[Path, ...]] = field(default_factory=dict)
    date: str | None = None


class _TimeIsUp(KeyboardInterrupt):
    """Ends a workload as Ctrl-C would: what is finished is written."""


@dataclass
class _Watch:
    """Takes hold of a run's progress, and cuts the run off."""

    deadline: float | None
    progress: Progress = field(default_factory=Progress)

    def begin(self, start: api.RunStart) -> None:
        self.progress = start.progress

    def world_done(self, world: SweptWorld) -> None:
        if self.deadline is not None and time.perf_counter() > self.deadline:
            raise _TimeIsUp


@dataclass(frozen=True)
class _Timed:
    """One run of a workload and its measurement."""

    result: Result
    folder: Path


class Bench:
    """Measures cases one after the other. Engines are kept, so that what one case compiled serves the next."""

    def __init__(self, settings: Settings, on_message: Callable[[str], None] = lambda text: None) -> None:
        self.settings = settings
        self._say = on_message
        self._environment = environment(settings.date)
        self._engines: dict[str, Engine] = {}
        self._oracles: dict[str, _Timed] = {}
        self._files: dict[int, Path] = {}

    def run(self, case: Case, engine: str) -> Iterator[Result]:
        """Results of one case on one engine, as they come: those of its oracles first."""
        if isinstance(case, StackCase):
            yield self._stack(case, engine)
        elif isinstance(case, PlainLoopCase):
            yield self._plain_loop(case)
        else:
            yield from self._workload(case, engine)

    # ------------------------------------------------------------------ workloads

    def _workload(self, case: WorkloadCase, engine: str) -> Iterator[Result]:
        yardsticks = {label: list(folders) for label, folders in self.settings.against.items()}
        for schedule in self.settings.oracles:
            oracle = oracle_case(case, schedule)
            label = f"{ORACLE_ENGINE}-{schedule.value}"
            if (oracle, engine) == (case, ORACLE_ENGINE):
                continue
            known = oracle.name in self._oracles
            if not known:
                self._oracles[oracle.name] = self._time_workload(oracle, ORACLE_ENGINE, self.settings.oracle_limit)
                self._compare(self._oracles[oracle.name], yardsticks)
                yield self._oracles[oracle.name].result
            yardsticks[label] = [self._oracles[oracle.name].folder]
        first: _Timed | None = None
        for number in range(1, self.settings.repeat + 1):
            timed = self._time_workload(case, engine, None)
            timed.result["repetition"] = number
            self._compare(timed, yardsticks)
            if first is None:
                first = timed
            else:
                self._compare(timed, {"first run": [first.folder]})
            yield timed.result

    def _compare(self, timed: _Timed, yardsticks: dict[str, list[Path]]) -> None:
        for label, folders in yardsticks.items():
            timed.result["agreement"][label] = agreement(folders, [timed.folder])

    def _time_workload(self, case: WorkloadCase, engine_name: str, further_limit: int | None) -> _Timed:
        settings = self.settings
        count = min(limit for limit in (case.plans, settings.limit, further_limit) if limit is not None)
        path = self._plans_file(settings.skip + count)
        engine, start_s = self._engine(engine_name)
        folder = self._folder(f"{case.name}-{engine_name}-{settings.skip}+{count}")
        self._say(f"{case.name} on {engine_name}: {count} plans from {settings.skip}")
        reset_peak_memory()
        begin = time.perf_counter()
        watch = _Watch(None if settings.max_seconds is None else begin + settings.max_seconds)
        results, cut = self._score(path, count, case, engine, folder, watch)
        wall_s = time.perf_counter() - begin
        peak_bytes = peak_memory_bytes()
        return _Timed(self._result(case, engine, watch.progress, results, cut, start_s, wall_s, peak_bytes), folder)

    def _score(
        self, path: Path, count: int, case: WorkloadCase, engine: Engine, folder: Path, watch: _Watch
    ) -> tuple[RunResults, bool]:
        """From file to Parquet. Returns the results, and whether time was up before the end."""
        skip = self.settings.skip
        found = load_plans(path, limit=skip + count)
        plans = PlanSet(found.plans[skip:], found.skipped, found.warnings)
        if not plans.plans:
            raise InputError(f"{path}: no plans left after the first {skip}")
        try:
            results = api.score(
                plans,
                engine=engine,
                schedule=case.schedule,
                physics=case.physics,
                threads=getattr(engine, "threads", None),
                lanes=self.settings.lanes,
                out=folder,
                watcher=watch,
            )
        except _TimeIsUp:
            return load_run(folder), True
        return results, False

    def _result(
        self,
        case: WorkloadCase,
        engine: Engine,
        progress: Progress,
        results: RunResults,
        cut: bool,
        start_s: float,
        wall_s: float,
        peak_bytes: int,
    ) -> Result:
        worlds = results.worlds
        n, run_s = len(worlds), wall_s - progress.compile_s
        steps = int(worlds["n_steps"].sum())
        notes = []
        if n < case.plans:
            notes.append(
                f"{n} of {case.plans} plans" + (f", after the first {self.settings.skip}" * bool(self.settings.skip))
            )
        if cut:
            notes.append(f"cut off after {self.settings.max_seconds:g} s")
        return {
            **self._head(case, engine),
            "schedule": case.schedule.value,
            "physics": case.physics,
            "check": case.sim.check.value,
            "plans_file": str(self.settings.plans) if self.settings.plans else f"samples, seed {SEED}",
            "skip": self.settings.skip,
            "plans": n,
            "boxes": int(worlds["n_boxes"].sum()),
            "plans_per_s": n / run_s,
            "world_steps": steps,
            "world_steps_per_s": steps / run_s,
            "start_s": start_s,
            "compile_s": progress.compile_s,
            "run_s": run_s,
            "wall_s": wall_s,
            "counts": results.info["counts"],
            "agreement": {},
            "stages": dict(progress.extra),
            "peak_rss_bytes": peak_bytes,
            "peak_device_bytes": peak_device_bytes(),
            "note": "; ".join(notes),
            "results_dir": str(results.path),
        }

    # ------------------------------------------------------------------ stacks and plain loops

    def _stack(self, case: StackCase, engine_name: str) -> Result:
        """Copies of one stack. MJX engines run it once before, so that nothing compiles in what is timed."""
        engine, start_s = self._engine(engine_name)
        threads = getattr(engine, "threads", None)
        worlds = 4 * threads if threads else self.settings.lanes or DEFAULT_STACK_LANES
        scene = build_scene(self._stack_plan(case.boxes), case.sim)
        jobs = [Job(scene) for _ in range(worlds)]
        self._say(f"{case.name} on {engine_name}: {worlds} worlds")
        reset_peak_memory()
        compile_s = 0.0
        if not threads:
            warming = Progress()
            list(engine.run(jobs, case.sim, warming))
            compile_s = warming.compile_s
        progress = Progress()
        begin = time.perf_counter()
        outcomes = list(engine.run(jobs, case.sim, progress))
        run_s = time.perf_counter() - begin
        verdicts = [str(outcome.verdict) for outcome in outcomes]
        steps = worlds * (2 * SOFT_START_STEPS + seconds_to_steps(case.duration_s, case.sim.physics.timestep_s))
        return {
            **self._head(case, engine),
            "schedule": case.sim.schedule.value,
            "physics": case.sim.physics.name,
            "check": case.sim.check.value,
            "plans": worlds,
            "boxes": worlds * case.boxes,
            "plans_per_s": worlds / run_s,
            "world_steps": steps,
            "world_steps_per_s": steps / run_s,
            "start_s": start_s,
            "compile_s": compile_s,
            "run_s": run_s,
            "wall_s": run_s + compile_s,
            "counts": {verdict: verdicts.count(verdict) for verdict in sorted(set(verdicts))},
            "agreement": {},
            "stages": dict(progress.extra),
            "peak_rss_bytes": peak_memory_bytes(),
            "peak_device_bytes": peak_device_bytes(),
            "note": f"soft start ({2 * SOFT_START_STEPS} steps) included",
        }

    def _stack_plan(self, boxes: int) -> Plan:
        """The first boxes of the sample plan that stacks are cut from."""
        plan_id, placements = generate_one(STACK_PLAN, SEED, loose_share=0.0)
        with tempfile.TemporaryDirectory(prefix="petmjx-") as folder:
            path = Path(folder) / "stack.json"
            write_plans(path, [(plan_id, placements[:boxes])])
            return load_plans(path).plans[0]

    def _plain_loop(self, case: PlainLoopCase) -> Result:
        settings, physics = self.settings, PHYSICS[case.physics]
        count = min(case.plans, settings.limit or case.plans)
        max_seconds = settings.max_seconds or case.max_seconds
        plans = load_plans(self._plans_file(count), limit=count).plans
        self._say(f"{case.name}: up to {max_seconds:g} s")
        reset_peak_memory()
        run_s, steps, sizes = 0.0, 0, []
        for plan in spread_over_sizes(plans):
            if run_s >= max_seconds:
                break
            scene: Scene = build_scene(plan, Simulation(physics=physics))
            begin = time.perf_counter()
            plain_loop(scene, physics, parked_on_floor=case.parked_on_floor)
            run_s += time.perf_counter() - begin
            steps += fixed_steps(plan.n_boxes, physics.timestep_s)
            sizes.append(plan.n_boxes)
        return {
            "case": case.name,
            **self._environment,
            "engine": "plain-loop",
            "device": device_of(ORACLE_ENGINE),
            "threads": 1,
            "lanes": None,
            "schedule": Schedule.FIXED.value,
            "physics": case.physics,
            "check": "one-by-one",
            "plans": len(sizes),
            "boxes": sum(sizes),
            "plans_per_s": len(sizes) / run_s,
            "world_steps": steps,
            "world_steps_per_s": steps / run_s,
            "start_s": 0.0,
            "compile_s": 0.0,
            "run_s": run_s,
            "wall_s": run_s,
            "counts": {},
            "agreement": {},
            "stages": {},
            "peak_rss_bytes": peak_memory_bytes(),
            "peak_device_bytes": None,
            "note": f"{len(sizes)} of {len(plans)} plans, evenly spread over the sizes",
        }

    # ------------------------------------------------------------------ what they share

    def _head(self, case: Case, engine: Engine) -> Result:
        threads = getattr(engine, "threads", None)
        return {
            "case": case.name,
            **self._environment,
            "engine": engine.name,
            "device": device_of(engine.name),
            "threads": threads,
            "lanes": None if threads else self.settings.lanes,
        }

    def _engine(self, name: str) -> tuple[Engine, float]:
        """The engine, and the seconds it took to import and build it (0 where it was there)."""
        if name in self._engines:
            return self._engines[name], 0.0
        begin = time.perf_counter()
        if name == ORACLE_ENGINE:
            self._engines[name] = make_engine(name, threads=self.settings.threads)
        else:
            self._engines[name] = make_engine(name, lanes=self.settings.lanes)
        return self._engines[name], time.perf_counter() - begin

    def _plans_file(self, count: int) -> Path:
        """A file with at least ``count`` plans of the workload."""
        if self.settings.plans is not None:
            return self.settings.plans
        large_enough = [path for n, path in self._files.items() if n >= count]
        if large_enough:
            return large_enough[0]
        path = self.settings.work / f"samples-seed{SEED}-{count}.json"
        if not path.exists():
            self._say(f"generating {count} sample plans")
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part.json")
            write_samples(part, count, SEED)
            part.replace(path)
        self._files[count] = path
        return path

    def _folder(self, name: str) -> Path:
        """A folder for one run's results that is not there yet."""
        number = 1
        while (self.settings.work / f"{name}-{number}").exists():
            number += 1
        return self.settings.work / f"{name}-{number}"


def spread_over_sizes(plans: list[Plan]) -> list[Plan]:
    """The plans in an order of which every beginning is evenly spread over their sizes (van der Corput sequence)."""
    if not plans:
        return []
    by_size = sorted(plans, key=lambda plan: plan.n_boxes)
    bits = max(len(plans) - 1, 1).bit_length()
    numbers = np.arange(1 << bits)
    reverse = sum(((numbers >> bit) & 1) << (bits - 1 - bit) for bit in range(bits))
    # the middle first: the sequence proper starts at 0, with the smallest plan
    shifted = (np.asarray(reverse) + (1 << (bits - 1))) % (1 << bits)
    return [by_size[index] for index in shifted if index < len(by_size)]
