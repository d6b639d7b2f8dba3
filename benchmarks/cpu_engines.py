"""The engines for people without a GPU on the same worlds: C MuJoCo, and the kernels of mjx-warp on CPU threads."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Final

from benchmarks.result_fields import environment
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

ENGINES: Final = ("mujoco", "mjx-warp-cpu")
TURNS: Final = 2


def compared(plans: Sequence[Plan], threads: int, group: str) -> dict[str, Any]:
    """A line of results: first attempts at all plans on both engines. The engines run in turns, so that other work on
    the machine slows down both. A run before compiles everything; ``compile_s`` is the time of this run for kernels and
    programs.

    Args:
        group: kind of the plans, for the line.
    """
    sim = Simulation()
    jobs = [Job(build_scene(plan, sim)) for plan in plans]
    engines = {name: make_engine(name, threads=threads) for name in ENGINES}
    cpu_s, wall_s, steps = (dict.fromkeys(ENGINES, 0.0) for _ in range(3))
    outcomes: dict[str, dict[int, Outcome]] = {name: {} for name in ENGINES}
    progress = Progress()
    for part in range(TURNS):
        rows = range(part, len(jobs), TURNS)
        some = [jobs[row] for row in rows]
        for _ in engines["mjx-warp-cpu"].run(some, sim, progress):
            pass
        for name, engine in engines.items():
            wall, cpu = time.perf_counter(), time.process_time()
            for outcome in engine.run(some, sim):
                outcomes[name][rows[outcome.job]] = outcome
                steps[name] += outcome.n_steps
            cpu_s[name] += time.process_time() - cpu
            wall_s[name] += time.perf_counter() - wall
    oracle, here = (outcomes[name] for name in ENGINES)
    boxes = [plan.n_boxes for plan in plans]
    return {
        "case": "cpu-engines",
        "group": group,
        "plans": len(plans),
        "boxes": [min(boxes), max(boxes)],
        "threads": threads,
        "compile_s": round(progress.compile_s, 2),
        "cpu_s": {name: round(seconds, 2) for name, seconds in cpu_s.items()},
        "wall_s": {name: round(seconds, 2) for name, seconds in wall_s.items()},
        "steps": {name: int(number) for name, number in steps.items()},
        "same_verdict": sum(oracle[row].verdict == here[row].verdict for row in oracle),
        **environment(),
    }
