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
import platform
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from petmjx.config import PHYSICS, SOFT_START_STEPS, Cone, Physics, Schedule, SimConfig
from petmjx.engines.mujoco_world import WorldRun
from petmjx.engines.oracle_metrics import OracleMetrics, Sample, top_forces
from petmjx.model import build_spec
from petmjx.outcome import Job
from petmjx.plans import load_plans
from petmjx.scene import Scene, build_scene

SAMPLE_STEPS = 100
INTERVAL_S = 0.7


def plain_loop(scene: Scene, physics: Physics, parked_on_floor: bool) -> np.ndarray:
    """Final shifts (n, 3) in m of the fixed schedule, by a loop without any of petmjx's engine."""
    model = build_spec(scene, physics).compile()
    data = mujoco.MjData(model)
    n = scene.n_boxes
    pose = data.qpos[7:].reshape(n, 7)
    velocity, qacc = data.qvel[6:].reshape(n, 6), data.qacc[6:].reshape(n, 6)
    lifted = data.xfrc_applied[2:]
    weight = scene.mass * physics.gravity_m_s2
    pose[:, 0] = 3.0 + 1.5 * np.arange(n)
    pose[:, 1] = 5.0
    pose[:, 2] = scene.floor_z + scene.half_size[:, 2] if parked_on_floor else 5.0
    down = np.array([0.0, 0.0, -physics.gravity_m_s2])
    for step in range(2 * SOFT_START_STEPS):
        fraction = max(0, step - SOFT_START_STEPS) / SOFT_START_STEPS
        model.opt.gravity[:] = down * fraction
        if not parked_on_floor:
            lifted[:, 2] = weight * fraction
        mujoco.mj_step(model, data)
    model.opt.gravity[:] = down
    if not parked_on_floor:
        lifted[:, 2] = weight
    data.time = 0.0
    metrics = OracleMetrics(scene, SimConfig().thresholds)
    placed, last_s = 0, 0.0
    for step in range(1, int((n + 1) * INTERVAL_S / physics.timestep_s) + 1):
        mujoco.mj_step(model, data)
        if step % SAMPLE_STEPS == 0:
            force = top_forces(data, n, physics.cone is Cone.PYRAMIDAL)[:placed]
            pos, quat, acc = data.xpos[2 : 2 + placed], data.xquat[2 : 2 + placed], qacc[:placed]
            metrics.add_sample(Sample(data.time, pos, quat, acc[:, :3], acc[:, 3:], force))
        if data.time - last_s >= INTERVAL_S and placed < n:
            pose[placed, :3], pose[placed, 3:] = scene.start_pos[placed], scene.start_quat[placed]
            velocity[placed] = 0.0
            lifted[placed, 2] = 0.0
            placed, last_s = placed + 1, data.time
    return np.asarray(pose[:, :3] - scene.target)


def cases(scene: Scene, physics: Physics) -> dict[str, Callable[[], object]]:
    """Everything that is timed for one physics preset, by name."""

    def engine(schedule: Schedule) -> Callable[[], object]:
        sim = SimConfig(physics=physics, schedule=schedule, interval_s=INTERVAL_S)
        # The world is run in this thread, so that its CPU time can be read.
        return lambda: WorldRun(0, Job(scene), sim, lambda: False).run()

    return {
        "plain, parked in the air": lambda: plain_loop(scene, physics, parked_on_floor=False),
        "plain, parked on the floor": lambda: plain_loop(scene, physics, parked_on_floor=True),
        "mujoco fixed": engine(Schedule.FIXED),
        "mujoco adaptive": engine(Schedule.ADAPTIVE),
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
        timed = cases(build_scene(plan, physics), physics)
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
                "mujoco": mujoco.__version__,
                "numpy": np.__version__,
                "python": platform.python_version(),
            }
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
