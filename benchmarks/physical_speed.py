"""Measures how fast the packer ``physical`` is: its search alone, and whole orders, from the search to the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.result_fields import Result, timed
from petmjx.packers.finalists import finalists
from petmjx.packers.pack import pack_each
from petmjx.packers.packed_orders import Packed
from petmjx.packers.physical_packer_options import PhysicalOptions
from petmjx.plans.order import Order

Numbered = tuple[str, Order]


def search_speed(orders: Sequence[Numbered]) -> Result:
    """CPU time of the search alone per order, s, in this process. The first order of ``physical`` is not measured,
    since it compiles machine code."""
    finalists(orders[0][1], PhysicalOptions())
    times_s = []
    for _, order in orders:
        with timed() as clock:
            finalists(order, PhysicalOptions())
        times_s.append(clock.cpu_s)
    return {"orders": len(orders), "cpu_s": sum(times_s) / len(times_s), "most_cpu_s": max(times_s)}


def packing_speed(orders: Sequence[Numbered], workers: int, how: Mapping[str, Any]) -> Result:
    """Pack orders, and measure the whole time from the call to the last plan.

    Args:
        how: options of ``petmjx.pack``.
    """
    with timed() as clock:
        packings = list(pack_each(iter(orders), workers=workers, **how))
    table, worlds = Packed(tuple(packings)).orders, sum(packed.n_simulated for packed in packings)
    return {
        "orders": len(packings),
        "workers": workers,
        "wall_s": clock.wall_s,
        "orders_per_s": len(packings) / clock.wall_s,
        "worlds": worlds,
        "worlds_per_s": worlds / clock.wall_s,
        "tried": int(table["tried"].sum()),
        "utilisation": float(table["utilisation"].mean()),
        "stands": float((table["verdict"] == "stable").mean()),
        "share": float(table["share"].mean()),
    }
