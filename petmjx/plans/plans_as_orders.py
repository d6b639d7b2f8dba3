"""Plans as orders (``orders_of_plans``): the boxes of each plan are an order, and their places are not used."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from petmjx.common.errors import InputError
from petmjx.options.run_options import RunOptions
from petmjx.plans.item_units_and_quantities import EURO, ForeignOrders, OrderReading
from petmjx.plans.order import Item, Order, target_named


def orders_of_plans(path: Path, source: str, reading: OrderReading) -> ForeignOrders:
    """Read each plan of a file as an order with the plan's boxes.

    Args:
        source: name of the file in messages.

    Raises:
        InputError: the file has no usable plan. The error does not name the file.
    """
    from petmjx.plans.plan_reader import DEFAULT_MAX_BOXES, read_plans

    wishes = reading.wishes
    options = RunOptions(
        units=",".join(filter(None, (wishes.units, wishes.masses))) or None,
        columns=dict(wishes.columns) or None,
        density=wishes.density_kg_m3,
    )
    plan_set = read_plans([path], options, max_boxes=DEFAULT_MAX_BOXES, extent_mm=None)
    target = target_named(reading.target or EURO)
    orders = []
    for plan in plan_set.plans:
        names = [
            article or item_id or f"box {number}"
            for number, (article, item_id) in enumerate(zip(plan.articles, plan.item_ids, strict=True), start=1)
        ]
        groups = plan.product_groups or ("",) * plan.n_boxes
        of_boxes = np.full(plan.n_boxes, np.nan) if plan.strength_n is None else plan.strength_n
        strengths = [None if np.isnan(strength) else strength for strength in of_boxes.tolist()]
        items = [
            Item(name, item_id or name, group, length, width, height, mass, strength_n=strength)
            for name, item_id, group, (length, width, height), mass, strength in zip(
                *(names, plan.item_ids, groups, plan.item_size_mm.tolist(), plan.mass_kg.tolist(), strengths),
                strict=True,
            )
        ]
        orders.append((plan.plan_id, Order(target, tuple(items), tuple(range(1, len(items) + 1)))))
    refused = tuple((skip.plan_id or "", str(skip)) for skip in plan_set.skipped)
    if not orders and refused:
        raise InputError(refused[0][1].removeprefix(f"{source}: "))
    reading_line = next((text.line() for text in plan_set.readings.values()), "read as petmjx's plans")
    line = (
        f"{source}: holds plans: the boxes of each are an order, their places are not used; {reading_line}; "
        f"packed on {target}"
    )
    return ForeignOrders(tuple(orders), refused, line)
