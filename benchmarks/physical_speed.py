"""How fast the packer ``physical`` is: its search, and orders from search to verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.record import Result, timed
from petmjx.packing.finalists import finalists
from petmjx.packing.options import PhysicalOptions
from petmjx.packing.pack import Packed, pack_each
from petmjx.plans.samples.orders import Order

Numbered = tuple[str, Order]


def search_speed(orders: Sequence[Numbered]) -> Result:
    """CPU seconds an order of the search alone, in this process. Its first order is not measured, since with it machine
    code is compiled."""
    finalists(orders[0][1], PhysicalOptions())
    each = []
    for _, order in orders:
        with timed() as clock:
            finalists(order, PhysicalOptions())
        each.append(clock.cpu_s)
    return {"orders": len(orders), "cpu_s": sum(each) / len(each), "most_cpu_s": max(each)}


def packing_speed(orders: Sequence[Numbered], workers: int, how: Mapping[str, Any]) -> Result:
    """Orders packed, with all that it takes from the call to the last plan.

    Args:
        how: options of ``petmjx.pack``.
    """
    with timed() as clock:
        each = list(pack_each(iter(orders), workers=workers, **how))
    table, worlds = Packed(tuple(each)).orders, sum(packed.n_simulated for packed in each)
    return {
        "orders": len(each),
        "workers": workers,
        "wall_s": clock.wall_s,
        "orders_per_s": len(each) / clock.wall_s,
        "worlds": worlds,
        "worlds_per_s": worlds / clock.wall_s,
        "tried": int(table["tried"].sum()),
        "utilisation": float(table["utilisation"].mean()),
        "stands": float((table["verdict"] == "stable").mean()),
        "share": float(table["share"].mean()),
    }
