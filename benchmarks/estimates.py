"""Estimates of time against what runs took: scores, scores with errors, static checks, drives, searches."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any, Final

from benchmarks.record import environment, timed
from petmjx.engines.cost import MEASURED, Work
from petmjx.options.config import Simulation
from petmjx.options.run_options import RunOptions
from petmjx.plans.plan import Plan
from petmjx.plans.samples import generate_one
from petmjx.plans.validate import parse_plan
from petmjx.simulate import simulate
from petmjx.study import Nominal, Study
from petmjx.sweeps.confidence import confidence_sweep
from petmjx.sweeps.file import load_sweep
from petmjx.sweeps.ready import find_sweep
from petmjx.sweeps.study import SweepStudy

SEED: Final = 21

Ask = Callable[[Sequence[Plan], RunOptions], Study]
"""What makes a study of plans and options."""


def cases() -> Iterator[tuple[str, str, Simulation, Ask]]:
    """What is asked, of which plans, with which simulation, and what makes the study."""
    usual, static = Simulation(), Simulation(check="static")
    for name in ("stack", "tiny", "small", "middle", "large", "given"):
        yield "score", name, usual, partial(Nominal, usual)
    for what, chosen in (("confidence 4", {}), ("confidence 4 exact", {"placing": "exact"})):
        sure = confidence_sweep(4, None, chosen)
        for name in ("tiny", "small", "few", "first given"):
            yield what, name, sure.simulation, partial(SweepStudy, sure, confidence=4)
    for name in ("middle", "given"):
        yield "static", name, static, partial(Nominal, static)
    for sweep_name, name in SWEEPS:
        sweep = load_sweep(find_sweep(sweep_name), plans_given=True)
        yield sweep_name, name, sweep.simulation, partial(SweepStudy, sweep)


SWEEPS: Final = (
    ("eumos", "stack"),
    ("eumos", "few"),
    ("eumos-search", "few"),
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
        "few": drawn[12:14],
        "one": by_size[1:2],
        **({"given": list(given), "first given": list(given[:1])} if given else {}),
    }


def plan_of(index: int) -> Plan:
    """A plan of the packer ``balanced``."""
    plan_id, placements = generate_one(index, SEED, packer="balanced")
    return parse_plan(plan_id, "estimates", placements, len(placements), {})


def cut(plan: Plan, n: int) -> Plan:
    """The first boxes of a plan."""
    return Plan.from_boxes(
        plan.plan_id, size_mm=plan.size_mm[:n], corner_mm=plan.corner_mm[:n], mass_kg=plan.mass_kg[:n]
    )


def compared(
    engine: str, threads: int, given: Sequence[Plan] = (), only: Collection[str] = ()
) -> Iterator[dict[str, Any]]:
    """A line of results for each case: what was estimated, and what it took, compilation apart.

    Args:
        given: further plans, which are scored.
        only: what is asked; everything if it is empty.
    """
    plans = sizes(given)
    for what, name, sim, ask in cases():
        if not (some := plans.get(name)) or (only and what not in only):
            continue
        options = RunOptions(engine=engine, threads=threads)
        study: Study = ask(some, options)
        with timed() as clock:
            results = simulate(ask, sim, some, options)
        compile_s = float(results.info["timings"].get("compile_s", 0.0))
        yield {
            "case": "estimates",
            "group": "estimates",
            "what": what,
            "plans": name,
            "engine": engine,
            "threads": threads,
            "estimate_s": round(MEASURED.seconds(study.work, threads)[engine] - start_s(engine), 2),
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
    }


def start_s(engine: str) -> float:
    """What an engine needs to begin, as the cost model has it: it is told apart from the rest."""
    return MEASURED.seconds(Work(Simulation(), []), 1)[engine]
