"""Estimates of time against real times: scores, scores with errors, static checks, drives, searches.

A line has the slowness of the machine during the run (petmjx/engines/machine_speed.py), and the estimate for it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks.record import environment, timed
from petmjx.engines.cost_model import MEASURED, Work
from petmjx.engines.machine_speed import REFERENCE_S, block_s
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.order_generator import draw_order
from petmjx.plans.plan import Plan
from petmjx.plans.plan_validation import parse_plan
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.simulate import simulate
from petmjx.runs.study import Nominal, Study
from petmjx.runs.sweep_file import find_sweep, load_sweep
from petmjx.runs.sweep_study import SweepStudy

SEED: Final = 21

Ask = Callable[[Sequence[Plan], RunOptions], Study]
"""A function that makes a study of plans and options."""


def cases() -> Iterator[tuple[str, str, Simulation, Ask]]:
    """Kind of run, plans, simulation, and the function that makes the study."""
    usual, static = Simulation(), Simulation(check="static")
    for name in ("stack", "tiny", "small", "middle", "large", "given"):
        yield "score", name, usual, partial(Nominal, usual)
    for kind, chosen in (("confidence 4", {}), ("confidence 4 exact", {"placing": "exact"})):
        sure = confidence_sweep(4, None, chosen)
        for name in ("tiny", "small", "few", "first given"):
            yield kind, name, sure.simulation, partial(SweepStudy, sure, confidence=4)
    yield "score", "falling", usual, partial(Nominal, usual)
    for name in ("middle", "falling", "given"):
        yield "static", name, static, partial(Nominal, static)
    for kind, chosen in (("score epal-1", {"carrier": "epal-1"}), ("score hand", {"placing": "hand"})):
        sim = Simulation(**chosen)
        yield kind, "small", sim, partial(Nominal, sim)
    for sweep_name, name in SWEEPS:
        sweep = load_sweep(find_sweep(sweep_name), plans_given=True)
        yield sweep_name, name, sweep.simulation, partial(SweepStudy, sweep)


SWEEPS: Final = (
    ("eumos", "stack"),
    ("eumos", "few"),
    ("eumos-search", "few"),
    ("wrap-search", "stack"),
    ("tilt", "few"),
    ("placement-error", "stack"),
    ("placement-error", "one"),
)
"""Ready-made sweeps, and the plans that each takes."""


def sizes(given: Sequence[Plan] = ()) -> dict[str, list[Plan]]:
    """Generated plans by size, and the ones ``given``."""
    drawn = [plan_of(index) for index in range(200)]
    by_size = sorted(drawn, key=lambda plan: plan.n_boxes)
    return {
        "stack": [cut(by_size[-1], 5)],
        "tiny": [cut(plan, 8) for plan in drawn[:40]],
        "small": by_size[:12],
        "middle": drawn[:8],
        "large": by_size[-4:],
        "falling": [shelf_plan(number) for number in range(20, 30)],
        "few": drawn[12:14],
        "one": by_size[1:2],
        **({"given": list(given), "first given": list(given[:1])} if given else {}),
    }


def plan_of(index: int) -> Plan:
    """A plan of the packer ``balanced``."""
    plan_id, placements = generate_one(index, SEED, packer="balanced")
    return parse_plan(plan_id, "estimates", placements, len(placements), {})


def shelf_plan(number: int) -> Plan:
    """Boxes in rows, by falling height, each layer on top of the tallest box below: most of them stand on little."""
    x = y = z = row = layer = 0.0
    size_mm, corner_mm, mass_kg = [], [], []
    for item in sorted(draw_order(3, number).items, key=lambda item: -item.height_mm)[:24]:
        length, width, height = item.length_mm, item.width_mm, item.height_mm
        if x + length > 1200:
            x, y, row = 0.0, y + row, 0.0
        if y + width > 800:
            x, y, z, layer, row = 0.0, 0.0, z + layer, 0.0, 0.0
        size_mm.append((length, width, height))
        corner_mm.append((x, y, z))
        mass_kg.append(item.weight_kg)
        x, row, layer = x + length, max(row, width), max(layer, height)
    return Plan.from_boxes(f"shelf-{number}", size_mm=size_mm, corner_mm=corner_mm, mass_kg=mass_kg)


def cut(plan: Plan, n: int) -> Plan:
    """The first boxes of a plan."""
    return Plan.from_boxes(
        plan.plan_id, size_mm=plan.size_mm[:n], corner_mm=plan.corner_mm[:n], mass_kg=plan.mass_kg[:n]
    )


def compared(
    engine: str, threads: int, given: Sequence[Plan] = (), only: Collection[str] = ()
) -> Iterator[dict[str, Any]]:
    """A line of results for each case: estimate and real time, without compilation.

    Args:
        given: further plans, which are scored.
        only: name of a kind of run; "": all.
    """
    plans = sizes(given)
    for kind, name, sim, ask in cases():
        if not (some := plans.get(name)) or (only and kind not in only):
            continue
        options = RunOptions(engine=engine, threads=threads)
        study: Study = ask(some, options)
        slow = block_s()
        with timed() as clock:
            results = simulate(ask, sim, some, options)
        slow = (slow + block_s()) / 2 / REFERENCE_S
        compile_s = float(results.info["timings"].get("compile_s", 0.0))
        yield {
            "case": "estimates",
            "group": "estimates",
            "what": kind,
            "plans": name,
            "engine": engine,
            "threads": threads,
            "slowness": round(slow, 2),
            "estimate_s": round(slow * (MEASURED.seconds(study.work, threads)[engine] - start_s(engine)), 2),
            "seconds": round(clock.wall_s - compile_s, 2),
            "cpu_s": round(clock.cpu_s - compile_s, 2),
            "compile_s": round(compile_s, 2),
            "steps_estimate": int(study.work.steps.sum()),
            "steps": int(results.worlds["n_steps"].sum()),
            "work": described(study.work),
            **environment(),
        }


def described(work: Work) -> dict[str, Any]:
    """Work as plain values, from which a test makes it again."""
    return {
        "check": work.sim.check.value,
        "schedule": work.sim.schedule.value,
        "boxes": list(work.boxes),
        "placements": work.placements,
        "displaced": work.displaced,
        "carried": work.carried,
        "drives": work.drives,
        "drive_steps": work.drive_steps,
        "carrier": str(work.sim.carrier),
        "filmed": work.filmed,
        "placed_share": np.round(np.asarray(work.placed_share, dtype=float), 3).tolist(),
    }


def start_s(engine: str) -> float:
    """The start time of an engine in the cost model: it is listed separately."""
    return MEASURED.seconds(Work(Simulation(), []), 1)[engine]
