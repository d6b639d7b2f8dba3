"""Error texts for plans in BED-BPP's format, from the values of decoded JSON."""

from __future__ import annotations

from typing import Any, Final

from petmjx.common.text import printable_name
from petmjx.plans.input_conventions import USUAL_CONVENTIONS, InputConventions
from petmjx.plans.json_reader import DuplicateFieldObject
from petmjx.plans.plan_fields import (
    COM_FIELDS_JSON,
    SPARSE,
    UnreadFields,
    com_fault,
    coordinate_fault,
    first_fault,
    integer_fault,
    kind,
    kind_fault,
    missing_anywhere,
    missing_fault,
    orientation_fault,
    pallet_fault,
    positive_fault,
    sparse_fault,
    text_fault,
    too_many_boxes,
)

_SIZES: Final = ("length/mm", "width/mm", "height/mm")
_NEEDED: Final = ("article", "id", *_SIZES, "weight/kg", "sequence")
_SPARSE_OF_ITEM: Final = tuple(name for name in SPARSE if name != "approach_deg")
_RARE_FIELDS: Final = frozenset({"material", "kind", *COM_FIELDS_JSON, *_SPARSE_OF_ITEM})
"""Fields that few plans have."""
_ITEM_FIELDS: Final = frozenset({*_NEEDED, "product_group", *_RARE_FIELDS})
_OF_PLACEMENT: Final = ("item", "orientation", "flb_coordinates")
_PLACEMENT_FIELDS: Final = frozenset({*_OF_PLACEMENT, "approach_deg"})


def fault_of_plan(value: object, max_boxes: int, given: InputConventions) -> str | None:
    """The error text for the first fault of a plan, with the number of its placement; None if the plan has none."""
    if not isinstance(value, list):
        return f": must be a list of placements, got {kind(value)}"
    if not value:
        return ": has no placement"
    if len(value) > max_boxes:
        return f": {too_many_boxes(len(value), max_boxes)}"
    if (missing := _all_missing(value)) is not None:
        return f": {missing}"
    faults = ((index, find_fault(placement, given)) for index, placement in enumerate(value))
    return next((f", placement {index}: {fault}" for index, fault in faults if fault is not None), None)


def count_unread(placements: list[dict[str, Any]], unread: UnreadFields) -> None:
    """Count the fields of good placements that petmjx does not read."""
    for placement in placements:
        if not placement.keys() <= _PLACEMENT_FIELDS:
            unread.add(placement, _PLACEMENT_FIELDS)
        if not placement["item"].keys() <= _ITEM_FIELDS:
            unread.add(placement["item"], _ITEM_FIELDS, "item.")


def _value_or_default(item: dict[str, Any], field: str, otherwise: Any) -> Any:
    """The value of a field; ``otherwise`` if the field is missing or null."""
    value = item.get(field)
    return otherwise if value is None else value


def find_fault(placement: object, given: InputConventions = USUAL_CONVENTIONS) -> str | None:
    """The error text for the first bad field of a placement; None if the placement is good."""
    if not isinstance(placement, dict):
        return f"must be an object, got {kind(placement)}"
    for record, of in ((placement, ""), (placement.get("item"), "item.")):
        if isinstance(record, DuplicateFieldObject):
            return f"{of}{printable_name(record.field)} stands twice"
    missing = _missing(placement)
    if missing:
        return missing_fault(missing)
    item = placement["item"]
    if not isinstance(item, dict):
        return f"item must be an object, got {kind(item)}"
    group = item.get("product_group")
    return (
        text_fault("article", item["article"])
        or text_fault("id", item["id"])
        or (None if group is None else text_fault("product_group", group))
        or first_fault(positive_fault(field, item[field], *given.sizes) for field in _SIZES)
        or positive_fault("weight/kg", item["weight/kg"], *given.weights)
        or text_fault("material", _value_or_default(item, "material", ""))
        or first_fault(
            com_fault(field, _value_or_default(item, field, 0), item[size])
            for field, size in zip(COM_FIELDS_JSON, _SIZES, strict=True)
        )
        or integer_fault("sequence", item["sequence"])
        or orientation_fault(placement["orientation"])
        or _corner_fault(placement["flb_coordinates"], given)
        or sparse_fault("approach_deg", placement.get("approach_deg"))
        or first_fault(sparse_fault(field, item.get(field)) for field in _SPARSE_OF_ITEM)
        or kind_fault(item.get("kind"))
        or pallet_fault(item.get("kind"), [item[field] * given.length_mm for field in _SIZES])
    )


def _missing(placement: dict[str, Any]) -> list[str]:
    """The fields that a placement lacks. If its item is not an object, the item's fields are not checked."""
    item = placement.get("item")
    inner = [field for field in _NEEDED if field not in item] if isinstance(item, dict) else []
    outer = [field for field in _OF_PLACEMENT if field not in placement]
    return ["item", *outer[1:]] if outer[:1] == ["item"] else [*inner, *outer]


def _all_missing(placements: list[Any]) -> str | None:
    """The error text for missing fields if several placements lack fields; else None."""
    missing: dict[str, list[int]] = {}
    for index, placement in enumerate(placements):
        for field in _missing(placement) if isinstance(placement, dict) else ():
            missing.setdefault(field, []).append(index)
    return missing_anywhere(missing, "placement")


def _corner_fault(corner: object, given: InputConventions) -> str | None:
    if not isinstance(corner, list):
        return f"flb_coordinates must be a list of 3 numbers, got {kind(corner)}"
    if len(corner) != 3:
        return f"flb_coordinates must be 3 numbers, got {len(corner)}"
    return first_fault(
        coordinate_fault(f"flb_coordinates[{axis}]", value, *given.coordinates) for axis, value in enumerate(corner)
    )
