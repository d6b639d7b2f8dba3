"""Sweeps of a million small worlds: host time per world, memory, and sizes of tables.

A run in a process of its own is killed halfway and continued in another process. Further processes read the results.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.all_memory import looked_at
from benchmarks.instant_engine import IN_WORKERS, Instant, answering_in_workers
from benchmarks.result_fields import Result, timed
from petmjx.common.errors import InputError
from petmjx.common.processes import process_pool
from petmjx.engines.engine_registry import check_options, options_of
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.runs.simulate import RunStart, simulate
from petmjx.runs.study import FinishedWorld
from petmjx.runs.sweep_file import Sweep, load_sweep
from petmjx.runs.sweep_study import SweepStudy

SWEEP: Final = Path(__file__).parent / "sweeps" / "placement-seeds.toml"
FEWEST, MOST = 10, 14
"""Smallest and largest number of boxes of a plan."""

SEED: Final = 5
POLL_S: Final = 0.05
TOLD_EVERY_S: Final = 5.0
"""Time between two lines about the progress of a run, s. From these lines, the speed of an interrupted measurement is
known."""


@dataclass(frozen=True)
class Million:
    """The settings of the run.

    Attributes:
        variants: number of worlds of each plan.
        engine: name of the engine. The engine ``instant`` yields outcomes at once, in workers if the options request
            workers.
        kill_at: share of worlds after which the run is killed; 0: never.
        placing: how boxes are placed. By default, a hand sets down boxes with errors, which takes more steps.
        options: further options of the run.
    """

    folder: Path
    plans: int = 1000
    variants: int = 1000
    engine: str = "instant"
    kill_at: float = 0.5
    placing: str = "exact"
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def out(self) -> Path:
        return self.folder / "run"


def measured(case: Million) -> Iterator[Result]:
    """Run, kill and continue the sweep, and read its results. Yields a line of results after each step."""
    check(case)
    about = {"engine": case.engine, "plans": case.plans, "variants": case.variants, "boxes": [FEWEST, MOST]}
    about |= {"placing": case.placing, "options": dict(case.options)}
    if case.kill_at:
        yield {"case": "million", "group": "million", "step": "killed", **about, **_killed(case)}
    for step, name in ((run, "run"), (run, "nothing missing"), (load, "load"), (report_of, "report")):
        yield {"case": "million", "group": "million", "step": name, **about, **_in_process(step, case)}
    yield {"case": "million", "group": "million", "step": "tables", **about, "tables": tables(case.out)}


def _in_process(step: Callable[[Million], Result], case: Million) -> Result:
    """Run a step in a separate process. Returns its result with its largest memory. If the process dies, an error is
    raised; a ``multiprocessing.Pool`` would wait for ever."""
    with process_pool(1) as pool:
        return pool.submit(_measured_step, step, case).result()


def _measured_step(step: Callable[[Million], Result], case: Million) -> Result:
    with timed() as clock, looked_at() as memory:
        figures = step(case)
    costs = {"wall_s": clock.wall_s, "cpu_s": clock.cpu_s, "peak_rss_bytes": clock.peak_rss_bytes}
    return {**figures, **costs, "peak_all_bytes": memory.peak_bytes}


def _killed(case: Million) -> Result:
    """Start the run, and kill it when the share ``kill_at`` of the worlds is on disk."""
    process = multiprocessing.get_context("spawn").Process(target=run, args=(case,), daemon=True)
    begin = time.perf_counter()
    process.start()
    assert process.pid is not None
    most = case.kill_at * case.plans * case.variants
    while process.is_alive() and written(case.out) < most:
        time.sleep(POLL_S)
    seconds = time.perf_counter() - begin
    if process.is_alive():
        os.kill(process.pid, signal.SIGKILL)
    process.join()
    return {"worlds": written(case.out), "wall_s": seconds}


def written(folder: Path) -> int:
    """Number of worlds that a run has on disk."""
    try:
        return int(json.loads((folder / "run.json").read_text())["counts"]["worlds"])
    except (OSError, ValueError, KeyError):
        return 0


class Watch:
    """Records the times at which a run knew its missing worlds and had its first world."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self.known_s = self.first_s = self.last_s = 0.0
        self.recorded = self.new = 0
        self._told_s = 0.0

    def begin(self, start: RunStart) -> None:
        self.known_s, self.recorded = time.perf_counter() - self._begin, start.recorded

    def world_done(self, world: FinishedWorld) -> None:
        self.last_s = time.perf_counter() - self._begin
        self.first_s = self.first_s or self.last_s
        self.new += 1
        if self.last_s - self._told_s >= TOLD_EVERY_S:
            self._told_s = self.last_s
            rate = self.new / max(self.last_s - self.known_s, 1e-9)
            print(f"{self.new:,} worlds in {self.last_s:.1f} s, {rate:,.0f} worlds/s", file=sys.stderr, flush=True)


def check(case: Million) -> None:
    """Check the options before a run is begun.

    Raises:
        InputError: one of them is unusable.
    """
    _, options = _asked(case)
    if case.engine not in ("instant", AUTO):
        check_options(case.engine, **options_of(case.engine, options))
    try:
        case.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{case.folder}: cannot be written ({error.strerror})") from error


def _asked(case: Million) -> tuple[Sweep, RunOptions]:
    sweep = load_sweep(SWEEP, plans_given=True, simulation={"placing": case.placing})
    more = dict(case.options)
    engine: Any = case.engine
    if engine == "instant":
        engine = IN_WORKERS if "workers" in more else Instant()
    options = RunOptions(engine=engine, out=case.out, resume=True, **more)
    return sweep.model_copy(update={"replicates": case.variants}), options


def run(case: Million) -> Result:
    """Simulate the missing worlds."""
    plans = made(case.plans)
    sweep, options = _asked(case)

    def ask(some: Any, options: RunOptions) -> SweepStudy:
        return SweepStudy(sweep, some, options)

    watch = Watch()
    begin = time.perf_counter()
    with answering_in_workers() if case.engine == "instant" else nullcontext():
        results = simulate(ask, sweep.simulation, plans, options, watch)
    seconds = time.perf_counter() - begin
    worlds = max(watch.last_s - watch.known_s, 1e-9)
    return {
        "recorded": watch.recorded,
        "worlds": watch.new,
        "begins_s": watch.known_s,
        "first_world_s": watch.first_s,
        "worlds_per_s": watch.new / worlds,
        "steps": sum(int(np.sum(part["n_steps"])) for part in results.parts.table("worlds", ("n_steps",))),
        "ms_per_world": 1e3 * worlds / max(watch.new, 1),
        "ends_s": seconds - max(watch.last_s, watch.known_s),
        "compile_s": float(results.info["timings"].get("compile_s", 0.0)),
    }


def load(case: Million) -> Result:
    """Open the run, and read its worlds and its summary, as users do in notebooks."""
    import petmjx

    begin = time.perf_counter()
    results = petmjx.load_run(case.out)
    opened = time.perf_counter() - begin
    rows = len(results.worlds)
    read = time.perf_counter() - begin
    summary = results.summary
    return {"open_s": opened, "worlds_s": read, "rows": rows, "summary_rows": 0 if summary is None else len(summary)}


def report_of(case: Million) -> Result:
    """Write the report."""
    import petmjx

    page = petmjx.report(case.out, case.folder / "report.html", overwrite=True)
    return {"bytes": page.stat().st_size}


def made(n: int) -> list[Plan]:
    """Generated plans, each cut to 10 to 14 boxes."""
    plans: list[Plan] = []
    index = 0
    while len(plans) < n:
        plan_id, placements = generate_one(index, SEED)
        most = FEWEST + index % (MOST - FEWEST + 1)
        index += 1
        if len(placements) >= most:
            plans.append(parse_plan(plan_id, placements[:most], DecoderOptions("million")))
    return plans


def tables(folder: Path) -> dict[str, dict[str, int]]:
    """Table → number of its parts and of its bytes."""
    totals = {}
    for table in sorted(path for path in folder.iterdir() if path.is_dir()):
        sizes = [file.stat().st_size for file in table.glob("*.parquet")]
        totals[table.name] = {"parts": len(sizes), "bytes": sum(sizes)}
    totals["run.json"] = {"parts": 1, "bytes": (folder / "run.json").stat().st_size}
    return totals
