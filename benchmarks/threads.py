"""Engine ``mujoco`` on two threads against one: 16 sample plans, worlds per second of wall time.

The two take turns, and each one's best time counts, because other work on the machine can only slow a run down.
JSON lines on stdout.

    python benchmarks/threads.py
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

from benchmarks.record import device_of, environment
from petmjx.config import PHYSICS, Simulation
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.plans.read import load_plans
from petmjx.plans.samples import generate, write_plans
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


def sample_jobs(count: int, seed: int, sim: Simulation) -> list[Job]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plans.json"
        write_plans(path, generate(count, seed).items())
        plans = list(load_plans([path]))
    # Longest first: otherwise the last plan may leave one of two threads without work.
    plans.sort(key=lambda plan: plan.n_boxes, reverse=True)
    return [Job(build_scene(plan, sim)) for plan in plans]


def seconds(jobs: list[Job], sim: Simulation, threads: int) -> tuple[float, float]:
    """Wall and CPU time of one run, s."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    for _ in MujocoEngine(threads).run(jobs, sim):
        pass
    return time.perf_counter() - wall_s, time.process_time() - cpu_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=16)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeat", type=int, default=4)
    options = parser.parse_args()
    sim = Simulation(physics=PHYSICS["pallet"])
    jobs = sample_jobs(options.plans, options.seed, sim)
    times: dict[int, list[tuple[float, float]]] = {threads: [] for threads in options.threads}
    for _ in range(options.repeat):
        for threads, measured in times.items():
            measured.append(seconds(jobs, sim, threads))
    first_s = min(times[options.threads[0]])[0]
    for threads, measured in times.items():
        wall_s, cpu_s = min(measured)
        record = {
            "benchmark": "threads",
            "plans": len(jobs),
            "boxes": sum(job.scene.n_boxes for job in jobs),
            "physics": sim.physics.name,
            "threads": threads,
            "cores": os.cpu_count(),
            "wall_s": round(wall_s, 3),
            "cpu_s": round(cpu_s, 3),
            "wall_s_all": [round(wall, 3) for wall, _ in measured],
            "times_first": round(first_s / wall_s, 2),
            "device": device_of("mujoco"),
            **environment(),
        }
        print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
