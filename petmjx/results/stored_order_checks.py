"""How the folder of a run stores the comparison of plans with orders: as columns of ``plans`` and as blocks of
``run.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from petmjx.plans.order_checks import MOST_LISTED, OrderCheck, OrderCounts, PlanOrderCounts
from petmjx.results.table_parts import Parts


def orders_block(check: OrderCheck) -> dict[str, Any]:
    """The block ``orders`` of ``run.json``. The counts of boxes and orders are in the block ``counts``."""
    return {
        "file": check.file,
        "digest": check.digest,
        "plans": check.lines,
        "without_plan": check.without_plan,
        "unusable": check.unusable,
    }


def read_check(folder: Path, info: Mapping[str, Any]) -> OrderCheck | None:
    """Read the comparison of a run's plans with their orders; None if the run was not compared with orders.

    Raises:
        InputError: the table ``plans`` of the run is damaged.
    """
    block = info.get("orders")
    if block is None:
        return None
    parts = Parts.of(folder, info)
    columns = {name for file in parts.files("plans") for name in parts.columns(file)}
    # runs of petmjx 0.2 lack the fields that have a default
    needed = [
        name for name in PlanOrderCounts._fields if name in columns or name not in PlanOrderCounts._field_defaults
    ]
    rows = [row for part in parts.table("plans", ("plan_id", *needed)) for row in part.to_pylist()]
    of_plan = {row.pop("plan_id"): PlanOrderCounts(**row) for row in rows if row["ordered_boxes"] is not None}
    return OrderCheck(
        block["file"],
        block["digest"],
        of_plan,
        OrderCounts(**info["counts"]["orders"]),
        block["plans"],
        block["without_plan"],
        block["unusable"],
    )


def joined_check(checks: Sequence[OrderCheck]) -> OrderCheck:
    """Combine the comparisons of all shards (parts of a run on several machines) into one comparison for the whole run.
    All shards were compared with the same orders."""
    counts = {
        field.name: _sum([getattr(check.counts, field.name) for check in checks]) for field in fields(OrderCounts)
    }
    # each shard lists all unusable orders, so the list of the first shard is enough
    counts["unusable_orders"] = checks[0].counts.unusable_orders
    return replace(
        checks[0],
        counts=OrderCounts(**counts),
        lines=[line for check in checks for line in check.lines][:MOST_LISTED],
        without_plan=[order_id for check in checks for order_id in check.without_plan][:MOST_LISTED],
    )


def _sum(values: Sequence[int | None]) -> Any:
    """The sum of the values; None if one of the values is None, that is, unknown."""
    values_with_number = [value for value in values if value is not None]
    return sum(values_with_number) if len(values_with_number) == len(values) else None
