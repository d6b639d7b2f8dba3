"""Runs cases and measures them."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import petmjx
from benchmarks.agreement import agreement, joint_run
from benchmarks.cases import MUJOCO, PLAIN_LOOP, SEED, STACK_PLAN, Case, Way, oracle_case
from benchmarks.plain_python_loop import fixed_steps, plain_loop
from benchmarks.result_fields import Clock, Result, environment, peak_device_bytes, timed
from petmjx.common.errors import InputError
from petmjx.common.machine import device_name
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.verdict import Verdict
from petmjx.options.simulation import SOFT_START_STEPS, Schedule
from petmjx.packers.sample_plans import generate_one, write_samples
from petmjx.plans.bedbpp_writer import write_plans
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.results.run_reader import load_run
from petmjx.runs.simulate import RunStart
from petmjx.runs.study import FinishedWorld
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

STACK_LANES = 2048
"""Default number of copies that fill an MJX engine."""

MJX_WARP = "mjx-warp"

LARGE_STACK_LANES = 528
"""The same for stacks that fill a multiprocessor each on mjx-warp: four for each multiprocessor of an H200."""

LOOP_SECONDS = 60.0
"""Default time after which a plain loop begins no further plan, s."""

BLOCK_PLANS = 8
"""Number of plans per block of a sweep with limited time. Eight plans have 512 worlds of EUMOS, which keep 16 threads
busy nearly to the end."""


class _TimeIsUp(KeyboardInterrupt):
    """An exception that ends a run in the way of Ctrl-C: finished worlds are written."""


class _Watch:
    """Keeps a run's progress, and ends the run after some time.

    Args:
        max_seconds: time after which the run ends, from now on; None if it never ends early.
        between_blocks: whether the run ends only between blocks. An interrupted sweep does not report the time of its
            placements and drives.
    """

    def __init__(self, max_seconds: float | None, between_blocks: bool = False) -> None:
        self._deadline = math.inf if max_seconds is None else time.perf_counter() + max_seconds
        self._between_blocks = between_blocks
        self.progress: list[Progress] = []

    @property
    def time_is_up(self) -> bool:
        return time.perf_counter() > self._deadline

    def begin(self, start: RunStart) -> None:
        self.progress.append(start.progress)

    def world_done(self, world: FinishedWorld) -> None:
        if self.time_is_up and not self._between_blocks:
            raise _TimeIsUp


@dataclass
class Bench:
    """Measures cases in order. Engines and their compiled programs are reused for later cases."""

    work: Path  # Folder for the files of timed runs.
    plans: Path | None = None  # File of plans that replaces the files of the cases.
    limit: int | None = None  # Largest number of plans.
    skip: int = 0  # Number of plans to leave out at the beginning.
    lanes: int | None = None  # As for ``make_engine``; None: the engine's own choice.
    threads: int | None = None  # As for ``make_engine``; None: the engine's own choice.
    max_seconds: float | None = None  # Wall-clock time after which a run ends; the result says so.
    repeat: int = 1  # Number of runs of each case. Cases take turns; further runs are compared with the first run.
    oracles: Sequence[Schedule] = ()  # Schedules of ``mujoco`` with which runs are compared.
    against: Mapping[str, Sequence[Path]] = field(default_factory=dict)  # Label → folders of earlier runs.
    say: Callable[[str], None] = lambda text: None  # Called with a line when something begins.
    make: Callable[..., Engine] = make_engine  # Builds engines.
    _environment: Result = field(default_factory=environment, init=False)
    _engines: dict[tuple[str, int | None], Engine] = field(default_factory=dict, init=False)
    _folders: dict[tuple[str, str], list[Path]] = field(default_factory=dict, init=False)

    def run(self, cases: Sequence[Case], engines: Sequence[str]) -> Iterator[Result]:
        """Yield the results of cases on engines, as soon as they are known. The result of an oracle comes before the
        first result that is compared with it."""
        pairs = ((case, case.only or engine) for engine in engines for case in cases)
        turns = {(case.name, engine): (case, engine) for case, engine in pairs}
        ways = {Way.FILES: self._compared, Way.ENGINE: self._engine_alone}
        for repetition in range(1, self.repeat + 1):
            for case, engine in turns.values():
                for result in ways.get(case.way, self._plain_loop)(case, engine):
                    yield {**result, "repetition": repetition}

    def _compared(self, case: Case, engine: str) -> Iterator[Result]:
        """Measure a run from the file of plans to Parquet files. The oracles with which it is compared run before
        it."""
        references = dict(self.against)
        for schedule in self.oracles:
            oracle = oracle_case(case, schedule)
            if (oracle.name, engine) == (case.name, MUJOCO):
                continue
            if (oracle.name, MUJOCO) not in self._folders:
                yield self._files(oracle, MUJOCO, self.against)
            references[f"{MUJOCO}-{schedule.value}"] = self._folders[oracle.name, MUJOCO]
        if (case.name, engine) in self._folders:
            references["first run"] = self._folders[case.name, engine]
        yield self._files(case, engine, references)

    # ------------------------------------------------------------------ the ways

    def _files(self, case: Case, engine_name: str, references: Mapping[str, Sequence[Path]]) -> Result:
        """Measure a run from the file of plans to Parquet files, through ``petmjx.score`` or ``petmjx.sweep``."""
        engine, start_s = self._engine(case, engine_name)
        path, count = self._plans_file(case)
        base = self._new_folder(f"{case.name.replace('/', '-')}-{engine_name}-{self.skip}+{count}")
        self.say(f"{case.name} on {engine_name}: up to {count} plans from {self.skip}")
        watch = _Watch(self.max_seconds, between_blocks=bool(case.sweep))
        folders: list[Path] = []
        with timed() as clock:
            plan_set = load_plans(path, limit=self.skip + count)
            plans = plan_set.plans[self.skip :]
            for block in self._blocks(case, plans):
                if folders and watch.time_is_up:
                    break
                folders.append(base / f"{len(folders):04d}" if len(block) < len(plans) else base)
                options = {"engine": engine, "threads": _threads(engine), "lanes": self.lanes, **case.simulation}
                simulate = partial(petmjx.sweep, case.sweep) if case.sweep else petmjx.score
                with contextlib.suppress(_TimeIsUp):
                    simulate(replace(plan_set, plans=block), out=folders[-1], watcher=watch, **options)
        if not folders:
            raise InputError(f"{path}: no plans left after the first {self.skip}")
        self._folders.setdefault((case.name, engine_name), folders)
        run = joint_run(folders)
        sim = run.info["config"]["simulation"]  # the file of a sweep may set other simulation options
        n_boxes = run.worlds.drop_duplicates("plan_id")["n_boxes"]
        timings = pd.DataFrame([load_run(folder).info["timings"] for folder in folders]).sum().to_dict()
        steps = timings["placement_steps"] + timings["drive_steps"] if case.sweep else run.worlds["n_steps"].sum()
        notes = [f"{len(n_boxes)} of {case.count} plans"] if len(n_boxes) < case.count else []
        notes += [f"after the first {self.skip}"] if self.skip else []
        notes += [f"cut off after {self.max_seconds:g} s"] if len(n_boxes) < len(plans) else []
        return self._result(
            case,
            engine,
            clock,
            start_s=start_s,
            compile_s=sum(progress.compile_s for progress in watch.progress),
            sizes=n_boxes,
            steps=steps,
            verdicts=zip(run.worlds["verdict"], run.worlds["reason"], strict=True),
            schedule=sim["schedule"],
            physics=sim["physics"]["name"],
            check=sim["check"],
            agreement={label: agreement(reference, folders) for label, reference in references.items()},
            stages={name: value for progress in watch.progress for name, value in progress.extra.items()},
            timings=timings,
            plans_file=str(self.plans or case.source or f"samples, seed {SEED}"),
            skip=self.skip,
            results_dir=str(base),
            note="; ".join(notes),
        )

    def _engine_alone(self, case: Case, engine_name: str) -> Iterator[Result]:
        """Measure an engine from scenes to outcomes. MJX engines are run once before, so that nothing is compiled in
        the measured time."""
        engine, start_s = self._engine(case, engine_name)
        threads, sim = _threads(engine), case.sim
        if case.boxes:
            copies = case.count or (4 * threads if threads else self.lanes or _filling(engine.name, case.boxes))
            jobs = [Job(build_scene(self._stack(case.boxes), sim))] * copies
        else:
            jobs = [Job(build_scene(plan, sim)) for plan in self._plans(case)]
        self.say(f"{case.name} on {engine_name}: {len(jobs)} worlds")
        warming, progress = Progress(), Progress()
        if not threads:
            list(engine.run(jobs, sim, warming))
        with timed() as clock:
            outcomes = list(engine.run(jobs, sim, progress))
        clock.wall_s += warming.compile_s
        yield self._result(
            case,
            engine,
            clock,
            start_s=start_s,
            compile_s=warming.compile_s,
            sizes=[job.scene.n_boxes for job in jobs],
            steps=sum(2 * SOFT_START_STEPS + outcome.n_steps for outcome in outcomes),
            verdicts=[(outcome.verdict.value, outcome.reason.value) for outcome in outcomes],
            stages=dict(progress.extra),
            note=f"soft start ({2 * SOFT_START_STEPS} steps) included",
        )

    def _plain_loop(self, case: Case, engine_name: str) -> Iterator[Result]:
        """Measure the plain loop on one plan after the other until the time is over. The plans are evenly spread over
        the sizes of all plans."""
        plans, physics = self._plans(case), case.sim.physics
        max_seconds = self.max_seconds or LOOP_SECONDS
        sizes: list[int] = []
        self.say(f"{case.name}: up to {max_seconds:g} s")
        watch = _Watch(max_seconds)
        with timed() as clock:
            for plan in spread_over_sizes(plans):
                if sizes and watch.time_is_up:
                    break
                plain_loop(build_scene(plan, case.sim), physics, on_floor=case.way is Way.LOOP_FLOOR)
                sizes.append(plan.n_boxes)
        note = f"{len(sizes)} of {case.count} plans, evenly spread over the sizes" if len(sizes) < case.count else ""
        steps = sum(fixed_steps(n, physics.timestep_s) for n in sizes)
        yield self._result(case, None, clock, sizes=sizes, steps=steps, note=note)

    # ------------------------------------------------------------------ what they share

    def _result(
        self,
        case: Case,
        engine: Engine | None,
        clock: Clock,
        *,
        sizes: Sequence[int],
        steps: int,
        start_s: float = 0.0,
        compile_s: float = 0.0,
        verdicts: Iterable[tuple[str, str]] = (),
        **more: Any,
    ) -> Result:
        """A line of results. ``sizes``: boxes of each plan; ``engine``: None for plain loops."""
        run_s = clock.wall_s - compile_s
        threads = _threads(engine) if engine else 1
        verdicts = Counter(verdicts)
        return {
            "case": case.name,
            "group": case.group,
            "way": case.way.value,
            **self._environment,
            "engine": engine.name if engine else PLAIN_LOOP,
            "device": device_name(engine.name if engine else MUJOCO, threads),
            "threads": threads,
            "lanes": None if threads else self.lanes,
            "schedule": case.sim.schedule.value,
            "physics": case.sim.physics.name,
            "check": case.sim.check.value,
            "sweep": case.sweep and Path(case.sweep).stem,
            "plans": len(sizes),
            "boxes": int(sum(sizes)),
            "plans_per_s": len(sizes) / run_s,
            "world_steps": int(steps),
            "world_steps_per_s": steps / run_s,
            "start_s": start_s,
            "compile_s": compile_s,
            "run_s": run_s,
            "wall_s": clock.wall_s,
            "cpu_s": clock.cpu_s,
            "counts": {
                "worlds": verdicts.total(),
                **{
                    verdict.value: sum(n for (answer, _), n in verdicts.items() if answer == verdict)
                    for verdict in Verdict
                },
                "by_reason": {reason: n for (_, reason), n in sorted(verdicts.items()) if reason},
            },
            "agreement": {},
            "stages": {},
            "peak_rss_bytes": clock.peak_rss_bytes,
            "peak_device_bytes": peak_device_bytes(),
            "note": "",
            **more,
        }

    def _engine(self, case: Case, name: str) -> tuple[Engine, float]:
        """The engine, and the time of its import and construction, s."""
        begin, threads = time.perf_counter(), case.threads or self.threads
        if (name, threads) not in self._engines:
            limits = {"threads": threads} if name == MUJOCO else {"lanes": self.lanes}
            self._engines[name, threads] = self.make(name, **limits)
        return self._engines[name, threads], time.perf_counter() - begin

    def _plans_file(self, case: Case) -> tuple[Path, int]:
        """A file with the plans of a case, and the number of plans that are used after the skipped plans."""
        count = min(case.count, self.limit or case.count)
        if self.plans or case.source:
            return self.plans or Path(case.source), count
        path = self.work / f"samples-{self.skip + count}.json"
        if not path.exists():
            self.say(f"generating {self.skip + count} sample plans")
            part = path.with_suffix(".part")
            self.work.mkdir(parents=True, exist_ok=True)
            write_samples(part, self.skip + count, SEED)
            part.replace(path)
        return path, count

    def _stack(self, n_boxes: int) -> Plan:
        """A stack of ``n_boxes`` boxes: the first boxes of the plan ``STACK_PLAN``, or bricks if this plan has fewer
        boxes."""
        plan_id, placements = generate_one(STACK_PLAN, SEED, loose_share=0.0)
        if len(placements) < n_boxes:
            return bricks(n_boxes)
        path = self.work / f"stack-{n_boxes}.json"
        self.work.mkdir(parents=True, exist_ok=True)
        write_plans(path, [(plan_id, placements[:n_boxes])])
        return load_plans(path).plans[0]

    def _plans(self, case: Case) -> list[Plan]:
        path, count = self._plans_file(case)
        return load_plans(path, limit=self.skip + count).plans[self.skip :]

    def _blocks(self, case: Case, plans: list[Plan]) -> list[list[Plan]]:
        """The plans in blocks. A sweep with limited time has small blocks that are evenly spread over the sizes; any
        other case has one block."""
        if case.sweep and self.max_seconds is not None:
            order = spread_over_sizes(plans)
            return [order[first : first + BLOCK_PLANS] for first in range(0, len(order), BLOCK_PLANS)]
        if case.longest_first:
            plans = sorted(plans, key=lambda plan: plan.n_boxes, reverse=True)
        return [plans] if plans else []

    def _new_folder(self, name: str) -> Path:
        """A new folder for one run's results."""
        folders = (self.work / f"{name}-{number}" for number in itertools.count(1))
        return next(folder for folder in folders if not folder.exists())


BRICK_MM, BRICKS_ACROSS = np.array([240.0, 160.0, 120.0]), 5
"""A layer of 5 × 5 bricks covers a pallet of 1,200 × 800 mm."""


def bricks(n_boxes: int) -> Plan:
    """A stack of bricks of 4 kg, layer by layer. Every other layer is shifted by a quarter of a brick, so that most
    bricks rest on four bricks."""
    number = np.arange(n_boxes)
    layer, place = np.divmod(number, BRICKS_ACROSS**2)
    across = np.stack([place % BRICKS_ACROSS, place // BRICKS_ACROSS, layer], axis=-1)
    aside = np.where(layer % 2, 0.25, 0.0)[:, None] * [1.0, 1.0, 0.0]
    return Plan(
        plan_id=f"bricks-{n_boxes}",
        source="bricks",
        size_mm=np.tile(BRICK_MM, (n_boxes, 1)),
        corner_mm=(across + aside) * BRICK_MM,
        mass_kg=np.full(n_boxes, 4.0),
        item_ids=tuple(f"brick-{k}" for k in number),
        articles=("brick",) * n_boxes,
        sequence=number,
    )


def _filling(engine: str, boxes: int) -> int:
    """Copies of a stack that fill an MJX engine."""
    if engine == MJX_WARP:
        from petmjx.engines.warp.block_sizes import size_for

        if size_for(boxes).per_sm == 1:
            return LARGE_STACK_LANES
    return STACK_LANES


def _threads(engine: Engine) -> int | None:
    """CPU threads of an engine; None without threads."""
    threads: int | None = getattr(engine, "threads", None)
    return threads


def spread_over_sizes(plans: Sequence[Plan]) -> list[Plan]:
    """The plans in an order (van der Corput's) whose first n plans are evenly spread over the sizes of all plans, for
    any n."""
    by_size = sorted(plans, key=lambda plan: plan.n_boxes)
    bits = max(len(plans) - 1, 1).bit_length()
    numbers = np.arange(1 << bits)
    reverse = sum(((numbers >> bit) & 1) << (bits - 1 - bit) for bit in range(bits))
    # begin in the middle: the original sequence starts at 0, with the smallest plan
    shifted = (np.asarray(reverse) + (1 << (bits - 1))) % (1 << bits)
    return [by_size[index] for index in shifted if index < len(by_size)]
