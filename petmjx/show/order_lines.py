"""Lines of text that compare plans with their orders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.text import Text

from petmjx.common.text import count_text
from petmjx.show.table_layout import line


def order_lines(info: Mapping[str, Any], most: int) -> Iterator[Text]:
    """Lines about orders that were not compared; then lines about boxes that plans leave out, and about orders without
    a plan.

    Args:
        info: content of ``run.json`` of a run that was compared with orders.
        most: largest number of lines about orders that were not compared.
    """
    counts = info["counts"]["orders"]
    for error in info["orders"]["unusable"][:most]:
        yield line(f"not compared: {error}", style="yellow")
    if counts["unusable_orders"] > most:
        yield line(f"not compared: {counts['unusable_orders'] - most:,} more, in run.json", style="yellow")
    ordered = count_text(counts["ordered_boxes"], "ordered box", "ordered boxes")
    odd = []
    if counts["left_out"]:
        verb = _verb(counts["plans_leaving_out"], "leaves", "leave")
        odd.append(f"{count_text(counts['plans_leaving_out'], 'plan')} {verb} out {counts['left_out']:,} of {ordered}")
    if counts["orders_without_plan"]:
        boxes = count_text(counts["boxes_without_plan"], "box", "boxes")
        verb = _verb(counts["orders_without_plan"])
        odd.append(f"{count_text(counts['orders_without_plan'], 'order')} ({boxes}) {verb} no usable plan")
    if counts["not_ordered"]:
        verb = _verb(counts["not_ordered"], "was", "were")
        odd.append(f"{count_text(counts['not_ordered'], 'box', 'boxes')} in plans {verb} not ordered")
    if resized := counts.get("resized", 0):  # runs of petmjx 0.2 do not have this count
        differ = "has another size, mass or property" if resized == 1 else "have other sizes, masses or properties"
        odd.append(f"{count_text(resized, 'box', 'boxes')} {differ} than ordered")
    if counts["plans_without_order"]:
        odd.append(
            f"{count_text(counts['plans_without_order'], 'plan')} {_verb(counts['plans_without_order'])} no order"
        )
    if odd:
        yield line(f"{'; '.join(odd)}, in run.json", style="yellow")
    else:
        yield line(f"plans leave out none of {ordered}")
    if unnamed := counts.get("matched_by_size", 0):
        boxes = count_text(unnamed, "box", "boxes")
        yield line(f"{boxes} without id and article {_verb(unnamed, 'is', 'are')} matched by size and mass")
    if counts["orders_without_plan"] is None:
        yield line("orders without a plan are not counted with --limit: not all plans were read")


def _verb(number: int, one: str = "has", many: str = "have") -> str:
    return one if number == 1 else many
