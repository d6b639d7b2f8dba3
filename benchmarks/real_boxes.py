"""Compares an engine with C MuJoCo on plans like real ones: boxes of three materials, set down by tines on a carrier
made of boards. Measures the cost per plan."""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pandas as pd

import petmjx
from benchmarks.result_fields import environment
from petmjx.common.machine import device_name
from petmjx.plans.plan import Plan

MATERIALS: Final = ("cardboard", "film", "plastic")

ASSUMED_PAIRS: Final = (
    {"between": ("cardboard", "film"), "friction": 0.35},
    {"between": ("cardboard", "plastic"), "friction": 0.3},
    {"between": ("film", "plastic"), "friction": 0.25},
    {"between": ("plastic", "plastic"), "friction": 0.2},
)
"""Assumed friction of pairs of materials; no source gives the values. In this comparison, only the differences between
pairs matter."""

STIFFNESS_N_MM: Final = {"cardboard": 200.0, "film": 60.0, "plastic": np.nan}
"""Assumed stiffness of boxes, N/mm, by material. Boxes of plastic are rigid."""

SETTINGS: Final[dict[str, Any]] = {"carrier": "epal-1", "placing": "tines", "friction_pairs": ASSUMED_PAIRS}


def of_three_materials(plan: Plan, *, gives: bool) -> Plan:
    """The plan with a material for each article; an article has the same material in all runs. ``gives``: whether boxes
    also have the stiffness of their materials."""
    chosen = tuple(MATERIALS[zlib.crc32(article.encode()) % len(MATERIALS)] for article in plan.articles)
    changes: dict[str, Any] = {"materials": chosen}
    if gives:
        changes["stiffness_n_mm"] = np.array([STIFFNESS_N_MM[name] for name in chosen])
    return replace(plan, **changes)


def compared(plans: Sequence[Plan], engine: str, oracle: str, *, gives: bool, **options: Any) -> dict[str, Any]:
    """A line of results: both engines on the same plans.

    Args:
        gives: whether boxes have the stiffness of their materials, too.
        options: of ``petmjx.score``.
    """
    mixed_plans = [of_three_materials(plan, gives=gives) for plan in plans]
    worlds, seconds, timings = {}, {}, {}
    for name in (oracle, engine):
        begin = time.perf_counter()
        results = petmjx.score(mixed_plans, **{"engine": name, **SETTINGS, **options})
        seconds[name], worlds[name] = time.perf_counter() - begin, results.worlds.set_index("plan_id")
        timings[name] = float(results.info["timings"].get("compile_s", 0.0))
    oracle_worlds, here = worlds[oracle], worlds[engine]
    judged = (oracle_worlds.verdict != "invalid") & (here.verdict != "invalid")
    same = oracle_worlds.verdict == here.verdict
    differ = oracle_worlds.index[judged & ~same]
    return {
        "case": "real-boxes-soft" if gives else "real-boxes",
        "group": "real-boxes",
        "engine": engine,
        "oracle": oracle,
        "device": device_name(engine),
        "plans": len(oracle_worlds),
        "boxes": int(oracle_worlds.n_boxes.sum()),
        "judged_by_both": int(judged.sum()),
        "same": int((judged & same).sum()),
        "share": round(float((judged & same).sum() / max(judged.sum(), 1)), 6),
        "same_steps": int((oracle_worlds.n_steps == here.n_steps).sum()),
        "stand": {name: int((table.verdict == "stable").sum()) for name, table in worlds.items()},
        "without_verdict": {name: int((table.verdict == "invalid").sum()) for name, table in worlds.items()},
        "steps_per_box": {name: round(_steps_per_box(table), 1) for name, table in worlds.items()},
        "wall_s": {name: round(time_s, 2) for name, time_s in seconds.items()},
        "compile_s": {name: round(time_s, 2) for name, time_s in timings.items()},
        "differ": [
            {
                "plan_id": plan_id,
                **{name: [table.verdict[plan_id], table.reason[plan_id]] for name, table in worlds.items()},
                "margin": round(float(oracle_worlds.margin[plan_id]), 4),
            }
            for plan_id in differ
        ],
        **environment(),
    }


def _steps_per_box(worlds: pd.DataFrame) -> float:
    return float((worlds.n_steps / worlds.n_placed.clip(lower=1)).mean())
