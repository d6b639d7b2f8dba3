"""Where the time of a run on a GPU goes: slice by slice, how many worlds still run, and whether the device waited.

``python -m benchmarks.gpu_slices plans.json --limit 10003``. If the host does not wait for a slice, the slice had ended
before the host looked, and the device may have had nothing to do.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from petmjx.engines.engine_registry import make_engine
from petmjx.engines.mjx.world_state import Status
from petmjx.engines.protocol import Progress
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.warp.time_slices import Rollout
from petmjx.engines.warp.world_table import WorldTable
from petmjx.engines.world_results import World
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.plan_sources import usable_plans
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


def main() -> None:
    """Score plans without writing files, and print one line per slice."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plans")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--engine", default="mjx-warp")
    arguments = parser.parse_args()
    sim, begin = Simulation(), time.perf_counter()

    def said(message: str) -> None:
        print(f"{time.perf_counter() - begin:7.2f} s  {message}", flush=True)

    plans = usable_plans(arguments.plans, sim, RunOptions(limit=arguments.limit)).plans
    said(f"{len(plans)} plans are read")
    engine = make_engine(arguments.engine)
    said("the engine is ready")
    wait, looked = Rollout.wait, [0.0]

    def timed(self: Rollout, table: WorldTable) -> Any:
        begin_s = time.perf_counter()
        status, ended = wait(self, table)
        waited = time.perf_counter() - begin_s
        running, host = int((table.live & (status == Status.RUNNING)).sum()), begin_s - looked[0]
        said(f"{running:6} run; the host worked for {host:.3f} s, then waited for {waited:.3f} s")
        looked[0] = time.perf_counter()
        return status, ended

    Rollout.wait = timed  # type: ignore[method-assign]  # times the method of the product, in this program only
    progress, looked[0] = Progress(), time.perf_counter()
    worlds = (World(plan, 0, Job(build_scene(plan, sim))) for plan in plans)
    again = 0
    for result in score_worlds(worlds, sim, engine, progress=progress):
        if len(result.attempts) > 1:
            again += 1
            said(f"{result.world.plan.plan_id}: {[(attempt.attempt, attempt.engine) for attempt in result.attempts]}")
    said(f"all have ended, {again} were simulated again; {progress.world_steps} steps, {progress.extra}")


if __name__ == "__main__":
    main()
