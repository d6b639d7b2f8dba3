"""Compares estimates of time with real times, for scores, scores with errors, static checks, drives, searches and
chains. A line of results has the slowness of the machine during the run (petmjx/engines/machine_speed.py), and the
estimate for this slowness.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks.result_fields import environment, timed
from petmjx.common.toml_files import read_toml
from petmjx.engines.cost_model import MEASURED
from petmjx.engines.expected_work import Work
from petmjx.engines.machine_speed import REFERENCE_S, block_s
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.order_generator import draw_order
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.ready_sweeps import find_sweep
from petmjx.runs.simulate import simulate
from petmjx.runs.study import Nominal, Study
from petmjx.runs.sweep_file import sweep_of_tables
from petmjx.runs.sweep_study import SweepStudy

SEED: Final = 21

Ask = Callable[[Sequence[Plan], RunOptions], Study]
"""A function that makes a study of plans and options."""


SCORES: Final[tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...]] = (
    ("score", {}, ("stack", "tiny", "small", "middle", "large", "mixed", "loose", "falling", "columns", "given")),
    ("score fixed", {"schedule": "fixed"}, ("tiny",)),
    ("score reference", {"physics": "reference"}, ("small",)),
    ("score epal-1", {"carrier": "epal-1"}, ("small", "mixed")),
    ("score gitterbox", {"carrier": "gitterbox"}, ("small",)),
    ("score trailer", {"carrier": "trailer"}, ("small",)),
    ("score hand", {"placing": "hand"}, ("tiny", "middle", "falling")),
    ("score tines", {"placing": "tines"}, ("tiny",)),
    ("score drop", {"placing": "drop"}, ("small",)),
    ("score giving", {}, ("giving",)),
    ("static", {"check": "static"}, ("middle", "mixed", "falling", "columns", "given")),
)
"""Kind of run, its options, and its plans (``sizes``)."""

SWEEPS: Final[tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...]] = (
    ("eumos", {}, ("stack", "giving")),
    ("eumos-search", {}, ("few",)),
    ("wrap-search", {}, ("stack",)),
    ("tilt", {}, ("few",)),
    ("friction", {}, ("few",)),
    ("placement-error", {}, ("stack",)),
    ("en-12195-1", {}, ("tiny",)),
    ("radial-force", {}, ("tiny",)),
    ("placement-and-transport", {"sample": 20}, ("few",)),
    ("chain-to-wrapper", {"replicates": 4}, ("few",)),
    ("chain-film-truck", {"replicates": 2}, ("stack",)),
    ("chain-film-road", {"replicates": 1}, ("stack",)),
)
"""Ready-made sweep, its tables that are replaced, and the plans that it takes."""


def cases() -> Iterator[tuple[str, str, Simulation, Ask]]:
    """Yield, for each case, the kind of the run, the name of the plans, the simulation options, and the function that
    makes the study."""
    for kind, options, names in SCORES:
        sim = Simulation(**options)
        for name in names:
            yield kind, name, sim, partial(Nominal, sim)
    for kind, chosen in (("confidence 4", {}), ("confidence 4 exact", {"placing": "exact"})):
        sure = confidence_sweep(4, None, chosen)
        for name in ("few", "falling", "first given"):
            yield kind, name, sure.simulation, partial(SweepStudy, sure, confidence=4)
    for kind, replaced, names in SWEEPS:
        path = find_sweep(kind)
        sweep = sweep_of_tables({**read_toml(path), **replaced}, path, plans_given=True)
        for name in names:
            yield kind, name, sweep.simulation, partial(SweepStudy, sweep)


def sizes(given: Sequence[Plan] = ()) -> dict[str, list[Plan]]:
    """Name of a size or kind → generated plans; also the plans ``given``."""
    drawn = [plan_of(index) for index in range(60)]
    by_size = sorted(drawn, key=lambda plan: plan.n_boxes)
    columns = grid((3, 2, 6), (400.0, 400.0, 200.0))
    return {
        "stack": [cut(by_size[-1], 5)],
        "tiny": [cut(plan, 8) for plan in drawn[:10]],
        "small": by_size[:12],
        "middle": drawn[:8],
        "large": by_size[-4:],
        "mixed": [plan_of(index, loose_share=0.5) for index in range(20)],
        "loose": [plan_of(index, loose_share=1.0) for index in range(20, 32)],
        "falling": [shelf_plan(number) for number in range(20, 30)],
        "columns": [columns, grid((8, 5, 3), (60.0, 60.0, 40.0))],
        "giving": [cut(columns, 18, stiffness_n_mm=[50.0] * 18)],
        "few": [cut(plan, 12) for plan in drawn[12:14]],
        **({"given": list(given), "first given": list(given[:1])} if given else {}),
    }


def grid(counts: tuple[int, int, int], size_mm: tuple[float, float, float]) -> Plan:
    """Columns of equal boxes, placed layer by layer."""
    along_x, along_y, layers = counts
    places = [(x, y, z) for z in range(layers) for y in range(along_y) for x in range(along_x)]
    mass_kg = [2e-7 * float(np.prod(size_mm))] * len(places)
    corner_mm = np.asarray(places) * size_mm
    return Plan.from_boxes(f"grid-{counts}", size_mm=[size_mm] * len(places), corner_mm=corner_mm, mass_kg=mass_kg)


def plan_of(index: int, loose_share: float | None = None) -> Plan:
    """A generated plan of the packer ``balanced``. With ``loose_share``, the plan is from a mixed set."""
    how: dict[str, Any] = {"packer": "balanced"} if loose_share is None else {"loose_share": loose_share}
    plan_id, placements = generate_one(index, SEED, **how)
    return parse_plan(plan_id, placements, DecoderOptions("estimates"))


def shelf_plan(number: int) -> Plan:
    """A plan whose boxes stand in rows, from the highest box to the lowest. Each layer begins at the height of the
    tallest box below, so most boxes have little support."""
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


def cut(plan: Plan, n: int, **columns: Any) -> Plan:
    """The first boxes of a plan. ``columns``: further fields of the boxes."""
    return Plan.from_boxes(
        plan.plan_id, size_mm=plan.size_mm[:n], corner_mm=plan.corner_mm[:n], mass_kg=plan.mass_kg[:n], **columns
    )


def compared(
    engine: str, threads: int, given: Sequence[Plan] = (), only: Collection[str] = ()
) -> Iterator[dict[str, Any]]:
    """A line of results for each case: estimate and real time, without compilation. On all engines but ``mujoco``,
    cases run twice, and the second run counts.

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
        if engine != "mujoco":
            simulate(ask, sim, some, options)  # compiles
        slow = block_s()
        with timed() as clock:
            results = simulate(ask, sim, some, options)
        slow = (slow + block_s()) / 2 / REFERENCE_S
        yield {
            "case": "estimates",
            "group": "estimates",
            "what": kind,
            "plans": name,
            "engine": engine,
            "threads": threads,
            "slowness": round(slow, 2),
            "estimate_s": round(slow * (MEASURED.seconds(study.work, threads)[engine] - start_s(engine)), 2),
            "seconds": round(clock.wall_s, 2),
            "cpu_s": round(clock.cpu_s, 3),
            "steps_estimate": int(study.work.steps.sum()),
            # the steps of worlds do not include the steps of placements that worlds share
            "steps": int(results.worlds["n_steps"].sum() + results.info["timings"].get("placement_steps", 0)),
            "work": described(study.work),
            **environment(),
        }


OF_PLANS: Final = ("placed_share", "ties", "giving", "sway_mm", "driven_share")
"""Attributes of ``Work`` with a value for each plan."""


def described(work: Work) -> dict[str, Any]:
    """The work of a run as plain values, from which a test can make the work again."""
    return {
        "sim": work.sim.model_dump(mode="json", exclude_defaults=True),
        "boxes": list(work.boxes),
        "placements": work.placements,
        "displaced": work.displaced,
        "carried": work.carried,
        "drives": work.drives,
        "drive_steps": work.drive_steps,
        "rounds": work.rounds,
        "filmed": np.round(work.filmed, 3).tolist(),
        "gentle": np.round(work.gentle, 3).tolist(),
        **{name: np.round(getattr(work, name), 3).tolist() for name in OF_PLANS},
    }


def start_s(engine: str) -> float:
    """The start time of an engine in the cost model, s. Results list it separately."""
    return MEASURED.seconds(Work(Simulation(), []), 1)[engine]
