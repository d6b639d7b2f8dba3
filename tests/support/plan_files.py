"""Placements as in plan files, and orders as in order files."""

from __future__ import annotations

from typing import Any

from petmjx.plans.plan import Plan


def placement(
    corner: tuple[float, float, float] = (0, 0, 0),
    size: tuple[float, float, float] = (600, 400, 220),
    orientation: int = 0,
    sequence: int = 1,
    **item: Any,
) -> dict[str, Any]:
    """One box. ``item``: replaces fields of its item."""
    length, width, height = size
    fields = {
        "article": "donut-00101843",
        "id": "00101843",
        "product_group": "confectionery",
        "length/mm": length,
        "width/mm": width,
        "height/mm": height,
        "weight/kg": 6.296,
        "sequence": sequence,
    }
    return {"item": fields | item, "orientation": orientation, "flb_coordinates": list(corner)}


def tower(n: int) -> list[dict[str, Any]]:
    """Boxes on top of one another."""
    return [placement(corner=(0, 0, 220 * level), sequence=level + 1) for level in range(n)]


def order(n: int = 3, **second: Any) -> dict[str, Any]:
    """An order of n equal items. ``second``: replaces fields of item 2."""
    items = {str(k): placement(size=(400, 300, 200.5), sequence=k)["item"] for k in range(1, n + 1)}
    items["2"].update(second)
    return {"item_sequence": items, "properties": {"target": "euro-pallet"}}


def order_of(plan: Plan, *more: str, without: int = 0) -> dict[str, Any]:
    """An order of the boxes of a plan, without the last ``without`` boxes, and with one more box of each article
    ``more``."""
    kept = slice(plan.n_boxes - without)
    sizes, masses = plan.item_size_mm[kept].tolist(), plan.mass_kg[kept].tolist()
    goods = list(zip(plan.item_ids[kept], plan.articles[kept], sizes, masses, strict=True))
    goods += [(name, name, (600, 400, 220), 6.296) for name in more]
    items = {
        str(k): placement(sequence=k, size=size, id=item_id, article=article, **{"weight/kg": kg})["item"]
        for k, (item_id, article, size, kg) in enumerate(goods, 1)
    }
    return {"item_sequence": items, "properties": {"target": "euro-pallet"}}


def order_for(plan: list[dict[str, Any]], more: int = 0, target: str = "euro-pallet") -> dict[str, Any]:
    """An order of the boxes of a plan, and of ``more`` further boxes."""
    items = [entry["item"] for entry in plan] + [placement(id="more")["item"]] * more
    sequence = {str(number): {**item, "sequence": number} for number, item in enumerate(items, start=1)}
    return {"item_sequence": sequence, "properties": {"target": target}}
