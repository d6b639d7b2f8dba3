"""Orders in BED-BPP's form: an order has ``properties`` and an ``item_sequence``. The module checks all fields."""

from __future__ import annotations

from itertools import islice
from typing import Any, Final

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.plans.json_reader import Entry, scan_plans
from petmjx.plans.order import MOST_ITEMS, TARGET_EXTENT_MM, Item, Order, is_target
from petmjx.plans.plan_fields import (
    COM_FIELDS_JSON,
    LARGEST_KG,
    LARGEST_MM,
    SMALLEST_KG,
    SMALLEST_MM,
    com_fault,
    first_fault,
    kind,
    kind_fault,
    pallet_fault,
    positive_fault,
    sparse_fault,
    text_fault,
)

OF_PLAN: Final = "is a packing plan, not an order"
_SIZES: Final = ("length/mm", "width/mm", "height/mm")
_MOST_DIGITS: Final = 18
"""Largest number of digits in a sequence number."""


def begins_with_plan(data: bytes | bytearray) -> bool:
    """Whether the first entry of a text in BED-BPP's form is a packing plan. The result is False if the first entry is
    damaged."""
    try:
        return any(is_plan_record(entry.value) for entry in islice(scan_plans(data), 1))
    except InputError:
        return False


def is_plan_record(record: object) -> bool:
    """Whether an entry of a file in BED-BPP's form is a packing plan."""
    return isinstance(record, list) and bool(record) and isinstance(record[0], dict) and "flb_coordinates" in record[0]


def bedbpp_order(entry: Entry, where: str) -> Order:
    """The order of one entry of a file. Raises InputError, whose message begins with ``where``, if the entry is bad."""
    record = entry.value
    if (fault := text_fault("the order id", entry.plan_id)) is not None:
        raise InputError(f"{where}: {fault}")
    if not entry.plan_id:
        raise InputError(f"{where}: the order id must not be empty")
    if is_plan_record(record):
        raise InputError(f"{where}: {OF_PLAN}: orders have item_sequence and properties")
    if not isinstance(record, dict):
        raise InputError(f"{where}: must be an object, got {kind(record)}")
    properties = record.get("properties")
    target = properties.get("target") if isinstance(properties, dict) else None
    if not isinstance(target, str) or not is_target(target):
        targets = ", ".join(TARGET_EXTENT_MM)
        raise InputError(f"{where}: properties.target must be one of {targets}, got {kind(target)}")
    sequence = record.get("item_sequence")
    if not isinstance(sequence, dict) or not sequence:
        raise InputError(f"{where}: item_sequence must be an object that holds at least one item")
    if len(sequence) > MOST_ITEMS:
        raise InputError(f"{where}: must have at most {MOST_ITEMS:,} items, got {len(sequence):,}")
    ranked = []
    for key, raw in sequence.items():
        if not (key.isdecimal() and len(key) <= _MOST_DIGITS):
            raise InputError(f"{where}: keys of item_sequence must be whole numbers, {shown_value(key)}")
        ranked.append((int(key), _item(raw, f"{where}, item {key}")))
    ranked.sort(key=lambda pair: pair[0])
    return Order(target, tuple(item for _, item in ranked), tuple(number for number, _ in ranked))


def _item(raw: object, where: str) -> Item:
    if not isinstance(raw, dict):
        raise InputError(f"{where}: must be an object, got {kind(raw)}")
    item: dict[str, Any] = {"product_group": "", **raw}
    if (fault := _item_fault(item)) is not None:
        raise InputError(f"{where}: {fault}")
    com = [item.get(field) for field in COM_FIELDS_JSON]
    stiffness = item.get("stiffness_n_mm")
    return Item(
        *(item["article"], item["id"], item["product_group"]),
        *(float(item[field]) for field in (*_SIZES, "weight/kg")),
        com_mm=None if com == [None] * 3 else (float(com[0] or 0.0), float(com[1] or 0.0), float(com[2] or 0.0)),
        stiffness_n_mm=None if stiffness is None else float(stiffness),
        kind=item.get("kind") or "",
    )


def _item_fault(item: dict[str, Any]) -> str | None:
    """The error text for the first bad field of an item; None if the item is good."""
    return (
        first_fault(text_fault(field, item.get(field)) for field in ("article", "id", "product_group"))
        or first_fault(positive_fault(field, item.get(field), SMALLEST_MM, LARGEST_MM, "mm") for field in _SIZES)
        or positive_fault("weight/kg", item.get("weight/kg"), SMALLEST_KG, LARGEST_KG, "kg")
        or first_fault(
            com_fault(field, item[field], item[size])
            for field, size in zip(COM_FIELDS_JSON, _SIZES, strict=True)
            if item.get(field) is not None
        )
        or sparse_fault("stiffness_n_mm", item.get("stiffness_n_mm"))
        or kind_fault(item.get("kind"))
        or pallet_fault(item.get("kind"), [item[field] for field in _SIZES])
    )
