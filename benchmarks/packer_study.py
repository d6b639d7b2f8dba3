"""Our packers on the same orders: how dense, how sure and how firm their plans are.

Worlds with errors are drawn from another seed than those by which ``physical`` chooses: a packing that was chosen
since it stood in 16 worlds must stand in others, too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import pandas as pd

import petmjx
from benchmarks.record import environment
from petmjx.packing.pack import pack_each
from petmjx.plans.samples import as_placements
from petmjx.plans.samples.balanced import TASTES
from petmjx.plans.samples.orders import TARGET_EXTENT_MM, Order
from petmjx.plans.samples.packer import Placed
from petmjx.plans.samples.packers import packer_named
from petmjx.plans.samples.packing import Packing
from petmjx.plans.validate import parse_plan
from petmjx.sweeps.ready import find_sweep
from petmjx.units import MM_PER_M

LEVELS_G: Final = (0.3, 0.5)
DIRECTIONS: Final = ("+x", "+y")
CLEARANCE_MM: Final = 6.0
ERROR_SEED: Final = 20261124
BOOTSTRAPS: Final = 4000

Packs = Callable[[str, Order], Sequence[Placed]]


def _named(name: str, order_id: str, order: Order) -> Sequence[Placed]:
    return packer_named(name)(order.items, TARGET_EXTENT_MM[order.target], None, np.random.default_rng(0))


def _apart(order_id: str, order: Order) -> Sequence[Placed]:
    """``balanced`` with free space: what physical has from its clearances alone."""
    best: Sequence[Placed] = ()
    for taste in TASTES:
        packing = Packing(order.items, TARGET_EXTENT_MM[order.target], taste, CLEARANCE_MM)
        packing.fill()
        best = max(best, packing.placed, key=len)
        if len(best) == len(order.items):
            break
    return best


RULES: Final[dict[str, Packs]] = {
    "baseline": partial(_named, "baseline"),
    "balanced": partial(_named, "balanced"),
    f"balanced, {CLEARANCE_MM:g} mm apart": _apart,
}


def study(orders: Sequence[tuple[str, Order]], worlds: int, engine: str, threads: int | None) -> dict[str, Any]:
    """A line of results: each packer's plans, and the differences to ``balanced`` on the same orders.

    Args:
        worlds: with errors, of each plan.
    """
    how: dict[str, Any] = {"engine": engine, "threads": threads}
    tables = {}
    for name, packs in RULES.items():
        begin = time.process_time()
        placed = {order_id: packs(order_id, order) for order_id, order in orders}
        tables[name] = _judged(orders, placed, worlds, how, time.process_time() - begin)
    begin = time.process_time()
    placed = {
        each.order_id: each.taken.finalist.placed if each.taken else () for each in pack_each(iter(orders), **how)
    }
    tables["physical"] = _judged(orders, placed, worlds, how, time.process_time() - begin)
    return {
        "case": "packer-study",
        "orders": len(orders),
        "worlds": worlds,
        "engine": engine,
        "packers": {name: _summary(table) for name, table in tables.items()},
        "against_balanced": {
            name: _differences(table, tables["balanced"]) for name, table in tables.items() if name != "balanced"
        },
        **environment(),
    }


def _judged(
    orders: Sequence[tuple[str, Order]],
    placed: Mapping[str, Sequence[Placed]],
    worlds: int,
    how: Mapping[str, Any],
    cpu_s: float,
) -> pd.DataFrame:
    """A row an order: what was placed, and what physics says of it. What has no plan does not stand."""
    plans = [
        parse_plan(order_id, "study", as_placements(boxes), len(boxes), {})
        for order_id, boxes in placed.items()
        if boxes
    ]
    with TemporaryDirectory() as folder:
        errors, shaking = Path(folder, "errors.toml"), Path(folder, "shaking.toml")
        text = find_sweep("confidence").read_text(encoding="utf-8")
        assert "\nseed = 1\n" in text
        errors.write_text(text.replace("\nseed = 1\n", f"\nseed = {ERROR_SEED}\n"), encoding="utf-8")
        shaking.write_text(
            f'name = "shaking"\n[axes]\nprofile = "eumos-40509"\ndirection = {[*DIRECTIONS]}\nlevel = {[*LEVELS_G]}\n',
            encoding="utf-8",
        )
        scored = petmjx.score(plans, confidence=worlds, errors=errors, **how)
        shaken = petmjx.sweep(shaking, plans, **how).worlds
    exact = scored.worlds[scored.worlds.variant == 0].set_index("plan_id")
    rows = pd.DataFrame(
        [{"plan_id": order_id, **_measures(order, placed[order_id])} for order_id, order in orders]
    ).set_index("plan_id")
    stands = (exact.verdict == "stable").reindex(rows.index, fill_value=False)
    assert scored.summary is not None
    share = scored.summary.set_index("plan_id").share.reindex(rows.index).fillna(0.0)
    levels = {
        f"at_{level:g}_g": (shaken[shaken.level_g == level].verdict == "stable")
        .groupby(shaken.plan_id)
        .mean()
        .reindex(rows.index)
        .fillna(0.0)
        for level in LEVELS_G
    }
    return rows.assign(
        stands=stands.astype(float),
        share=share,
        **levels,
        most_load_n=exact.rest_top_force_n.reindex(rows.index),
        pack_cpu_s=cpu_s / len(orders),
    )


def _measures(order: Order, placed: Sequence[Placed]) -> dict[str, float]:
    length, width = TARGET_EXTENT_MM[order.target]
    height_m = max((box.corner_mm[2] + box.item.height_mm for box in placed), default=0.0) / MM_PER_M
    volume_m3 = sum(box.item.volume_m3 for box in placed)
    space_m3 = length * width * height_m / MM_PER_M**2
    return {
        "placed": len(placed) / len(order.items),
        "whole": float(len(placed) == len(order.items)),
        "utilisation": volume_m3 / space_m3 if placed else 0.0,
    }


def _summary(table: pd.DataFrame) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in table.mean().items()}


def _differences(table: pd.DataFrame, other: pd.DataFrame) -> dict[str, list[float]]:
    """Column → mean difference and its 95 % interval: percentiles of orders drawn with replacement (Efron 1979)."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(table), size=(BOOTSTRAPS, len(table)))
    found = {}
    for name in ("utilisation", "stands", "share", *(f"at_{level:g}_g" for level in LEVELS_G)):
        each = (table[name] - other[name]).to_numpy()
        low, high = np.percentile(each[drawn].mean(axis=1), [2.5, 97.5])
        found[name] = [round(float(value), 4) for value in (each.mean(), low, high)]
    return found
