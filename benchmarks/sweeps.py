"""Sweeps by engine: worlds a second from settled states, and whether engines agree on how often plans stand.

    python benchmarks/sweeps.py forks --plans plans.json --limit 100 --engine mjx-warp --repeat 2
    python benchmarks/sweeps.py forks --plans plans.json --limit 100 --engine mujoco --threads 16 --max-seconds 300
    python benchmarks/sweeps.py statistics --engine mujoco,mjx-warp
    python benchmarks/sweeps.py verdicts --plans plans.json --limit 16 --engine mujoco,mjx-warp --threads 16

``forks`` places each plan once and forks its settled state into the 64 worlds of ``sweeps/eumos.toml`` (4 directions ×
16 levels). Placements and forks are timed apart. With ``--max-seconds`` plans are taken in blocks, in an order drawn
with ``--seed``, and no block is begun after that time: the line says how many plans were done and their mean size. A
second run on the same engine (``--repeat 2``) finds its programs compiled.

``statistics`` places each plan with 32 seeds of placement errors and compares the shares that stand: engines agree on a
plan where each one's share lies in the other's Wilson 95 % interval.

``verdicts`` shakes each plan in the 64 worlds of ``sweeps/eumos.toml`` on both engines and compares world by world. By
level of the drive, since most worlds of a level are plain and those where the plan just holds are not.

JSON lines on stdout, and appended to ``--out``. Plans are the bundled ones unless ``--plans`` names others.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import petmjx
from benchmarks.record import device_of, environment
from petmjx.config import RunOptions, Simulation
from petmjx.engines.base import Engine, Progress
from petmjx.engines.choose import make_engine
from petmjx.plans.gather import gather_plans
from petmjx.plans.plan import Plan
from petmjx.results.compare import KEY, compare_runs
from petmjx.sweeps.file import load_sweep
from petmjx.sweeps.grid import SweepPlan
from petmjx.sweeps.ready import find_sweep
from petmjx.sweeps.run import SweepRun
from petmjx.sweeps.shares import wilson_interval

BLOCK_PLANS = 8
"""Plans a block, where time is limited: 512 forks keep 16 threads busy nearly to the end."""

PLACEMENT_SEEDS = """
name = "placement-seeds"
seed = 1
replicates = 32

[axes]
placement_error_mm = 5
yaw_error_deg = 1
"""


def engine_of(name: str, options: argparse.Namespace) -> Engine:
    if name == "mujoco":
        return make_engine(name, threads=options.threads)
    return make_engine(name, lanes=options.lanes)


def forks(plans: Sequence[Plan], name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """A line a repetition."""
    sweep = load_sweep(find_sweep("eumos"), plans_given=True)
    engine = engine_of(name, options)
    order = list(plans)
    blocks = [order]
    if options.max_seconds is not None:
        random.Random(options.seed).shuffle(order)
        blocks = [order[first : first + BLOCK_PLANS] for first in range(0, len(order), BLOCK_PLANS)]
    return [_forks_once(sweep, blocks, engine, options.max_seconds) for _ in range(options.repeat)]


def _forks_once(
    sweep: Any, blocks: Sequence[Sequence[Plan]], engine: Engine, max_seconds: float | None
) -> dict[str, Any]:
    done: list[Plan] = []
    total: Counter[str] = Counter()
    verdicts: Counter[str] = Counter()
    progress = Progress()
    begin = time.perf_counter()
    for block in blocks:
        if max_seconds is not None and done and time.perf_counter() - begin > max_seconds:
            break
        run = SweepRun(SweepPlan(sweep, block), engine, progress=progress)
        for world in run.worlds():
            verdicts[world.outcome.verdict.value] += 1
            total["collapsed"] += not world.driven
        total.update(vars(run.tally))
        done.extend(block)
    n_plans = sum(len(block) for block in blocks)
    return {
        "plans": len(done),
        "plans_asked": n_plans,
        "boxes_mean": float(np.mean([plan.n_boxes for plan in done])),
        "boxes_mean_asked": float(np.mean([plan.n_boxes for block in blocks for plan in block])),
        "worlds": verdicts.total(),
        "worlds_driven": total["drives"],
        "worlds_of_collapsed_placements": total["collapsed"],
        "placement_s": total["placement_s"],
        "drive_s": total["drive_s"],
        "compile_s": progress.compile_s,
        "driven_worlds_per_s": total["drives"] / total["drive_s"],
        "drive_steps_per_s": total["drive_steps"] / total["drive_s"],
        "placement_steps": total["placement_steps"],
        "drive_steps": total["drive_steps"],
        "wall_s": time.perf_counter() - begin,
        "verdicts": dict(verdicts),
    }


def statistics(plans: Sequence[Plan], names: Sequence[str], options: argparse.Namespace) -> list[dict[str, Any]]:
    """A line for each engine after the first, compared with the first."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "placement-seeds.toml"
        file.write_text(PLACEMENT_SEEDS, encoding="utf-8")
        runs = []
        for name in names:
            results = petmjx.sweep(file, plans, engine=engine_of(name, options))
            valid = results.worlds[results.worlds["verdict"] != "invalid"]
            stands = (valid["verdict"] == "stable").groupby(valid["plan_id"])
            runs.append((name, stands.agg(["sum", "size"]), float(results.info["timings"]["wall_s"])))
    (first, base, base_s), *others = runs
    lines = []
    for name, shares, wall_s in others:
        both = base.join(shares, lsuffix="_a", rsuffix="_b", how="outer").fillna(0)
        share_a, share_b = both["sum_a"] / both["size_a"], both["sum_b"] / both["size_b"]
        low_a, high_a = wilson_interval(both["sum_a"], both["size_a"])
        low_b, high_b = wilson_interval(both["sum_b"], both["size_b"])
        agree = (low_a <= share_b) & (share_b <= high_a) & (low_b <= share_a) & (share_a <= high_b)
        lines.append(
            {
                "engines": [first, name],
                "plans": len(both),
                "seeds": 32,
                "agree": int(agree.sum()),
                "intervals_overlap": int(((low_a <= high_b) & (low_b <= high_a)).sum()),
                "differ": [
                    {"plan_id": str(plan), first: float(share_a[plan]), name: float(share_b[plan])}
                    for plan in both.index[~agree]
                ],
                "shares": {str(plan): [float(share_a[plan]), float(share_b[plan])] for plan in both.index},
                "wall_s": {first: base_s, name: wall_s},
            }
        )
    if not others:
        counts = {str(plan): [int(row["sum"]), int(row["size"])] for plan, row in base.iterrows()}
        lines.append({"engines": [first], "plans": len(base), "seeds": 32, "standing": counts, "wall_s": base_s})
    return lines


def verdicts(plans: Sequence[Plan], names: Sequence[str], options: argparse.Namespace) -> list[dict[str, Any]]:
    """A line for each engine after the first, compared with the first."""
    runs, wall_s = [], {}
    for name in names:
        results = petmjx.sweep(find_sweep("eumos"), plans, engine=engine_of(name, options))
        runs.append(results)
        wall_s[name] = float(results.info["timings"]["wall_s"])
    lines = []
    for name, other in zip(names[1:], runs[1:], strict=True):
        found = compare_runs(runs[0], other)
        flips = found.flips.merge(runs[0].worlds[[*KEY, "level_g"]], on=KEY)
        by_level = flips["level_g"].round(6).value_counts(sort=False).sort_index()
        lines.append(
            {
                "engines": [names[0], name],
                "plans": len(plans),
                "worlds": found.n_common,
                "same": found.n_agree,
                "same_reason": int(found.confusion.loc["stable", "stable"]) + found.same_reason,
                "differ_by_level_g": {str(level): int(count) for level, count in by_level.items()},
                "plans_all_the_same": len(plans) - flips["plan_id"].nunique(),
                "wall_s": wall_s,
            }
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=["forks", "statistics", "verdicts"])
    parser.add_argument("--plans", type=Path, help="file of plans (default: the bundled ones)")
    parser.add_argument("--limit", type=int, help="take only so many plans")
    parser.add_argument("--engine", default="mujoco", help="a name; otherwise than with forks two with a comma")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--lanes", type=int)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--max-seconds", type=float, help="forks: begin no block of plans after this time")
    parser.add_argument("--seed", type=int, default=0, help="of the order of plans under --max-seconds")
    parser.add_argument("--out", type=Path, help="file the lines are appended to")
    options = parser.parse_args()
    plans = gather_plans(options.plans, Simulation(), RunOptions(limit=options.limit)).plans
    names = options.engine.split(",")
    fixed = {"benchmark": f"sweeps/{options.case}", **environment()}
    if options.case == "forks":
        lines = [
            {
                "engine": name,
                "device": device_of(name),
                "threads": options.threads,
                "lanes": options.lanes,
                "run": run,
                **line,
            }
            for name in names
            for run, line in enumerate(forks(plans, name, options), start=1)
        ]
    else:
        compared = {"statistics": statistics, "verdicts": verdicts}[options.case]
        lines = [{"device": device_of(names[-1]), **line} for line in compared(plans, names, options)]
    text = "".join(json.dumps({**fixed, **line}) + "\n" for line in lines)
    sys.stdout.write(text)
    if options.out is not None:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        with options.out.open("a", encoding="utf-8") as stream:
            stream.write(text)


if __name__ == "__main__":
    main()
