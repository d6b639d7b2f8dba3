"""One thread: engine ``mujoco`` against a plain Python loop on packing_plan_a.

The plain loop is what one would write first: the exact model with all boxes, one ``mj_step`` a step from Python, NumPy
metrics every 100 steps, a box placed every 0.7 s. Boxes that wait are parked far apart, either in the air, held by a
force equal to their weight (cheapest), or on the floor, as in the reference implementation.

Times are CPU time of the thread that works, the smallest of several runs that take turns; JSON lines on stdout.

    python benchmarks/single_thread.py --plans ../shared/data/packing_plan_a.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.plain import INTERVAL_S, plain_loop
from benchmarks.record import device_of, environment
from petmjx.config import PHYSICS, Physics, Schedule, Simulation
from petmjx.engines.cpu.world import WorldRun
from petmjx.plans.read import load_plans
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scene


def cases(scene: Scene, physics: Physics) -> dict[str, Callable[[], object]]:
    """Everything that is timed for one physics preset, by name."""

    def engine(schedule: Schedule) -> Callable[[], object]:
        sim = Simulation(physics=physics, schedule=schedule, interval_s=INTERVAL_S)
        # The world is run in this thread, so that its CPU time can be read.
        return lambda: WorldRun(0, Job(scene), sim, lambda: False).run()

    return {
        "plain, parked in the air": lambda: plain_loop(scene, physics, parked_on_floor=False),
        "plain, parked on the floor": lambda: plain_loop(scene, physics, parked_on_floor=True),
        "mujoco fixed": engine(Schedule.FIXED),
        "mujoco adaptive": engine(Schedule.ADAPTIVE),
        "mujoco brisk": engine(Schedule.BRISK),
    }


def cpu_seconds(run: Callable[[], object]) -> float:
    start_s = time.thread_time()
    run()
    return time.thread_time() - start_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=Path, required=True, help="file with packing_plan_a")
    parser.add_argument("--plan-id", default="packing_plan_a")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each case, taking turns (default 3)")
    options = parser.parse_args()
    plan = next(plan for plan in load_plans([options.plans]) if plan.plan_id == options.plan_id)
    for name, physics in PHYSICS.items():
        timed = cases(build_scene(plan, Simulation(physics=physics)), physics)
        seconds: dict[str, list[float]] = {case: [] for case in timed}
        for _ in range(options.repeat):
            for case, run in timed.items():
                seconds[case].append(cpu_seconds(run))
        for case, values in seconds.items():
            record = {
                "benchmark": "single_thread",
                "plan": plan.plan_id,
                "physics": name,
                "case": case,
                "cpu_s": round(min(values), 3),
                "cpu_s_all": [round(value, 3) for value in values],
                "times_plain_air": round(min(seconds["plain, parked in the air"]) / min(values), 2),
                "times_plain_floor": round(min(seconds["plain, parked on the floor"]) / min(values), 2),
                "device": device_of("mujoco"),
                **environment(),
            }
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
