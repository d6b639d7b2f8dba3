"""Validates a plan in BED-BPP's format: decoded JSON becomes checked arrays, or an error of one line."""

from __future__ import annotations

from itertools import chain
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import is_text, printable_id, printable_name
from petmjx.plans.input_conventions import USUAL_CONVENTIONS, InputConventions
from petmjx.plans.json_reader import DuplicateFieldObject
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import (
    COM_FIELDS_JSON,
    FARTHEST_MM,
    LARGEST_KG,
    LARGEST_MM,
    LONGEST_NAME,
    SMALLEST_KG,
    SMALLEST_MM,
    SPARSE,
    UnreadFields,
    com_along_axes,
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
    plan_id_fault,
    positive_fault,
    sparse_fault,
    text_fault,
    too_many_boxes,
)

_SIZES: Final = ("length/mm", "width/mm", "height/mm")
_NUMBERS_OF_ITEM: Final = (*_SIZES, "weight/kg")
_NEEDED: Final = ("article", "id", *_NUMBERS_OF_ITEM, "sequence")
_SPARSE_OF_ITEM: Final = tuple(name for name in SPARSE if name != "approach_deg")
_RARE_FIELDS: Final = frozenset({"material", "kind", *COM_FIELDS_JSON, *_SPARSE_OF_ITEM})
"""Fields that few plans have."""
_ITEM_FIELDS: Final = frozenset({*_NEEDED, "product_group", *_RARE_FIELDS})
_OF_PLACEMENT: Final = ("item", "orientation", "flb_coordinates")
_PLACEMENT_FIELDS: Final = frozenset({*_OF_PLACEMENT, "approach_deg"})
_NUMBERS: Final = {int, float}


class PlanError(InputError):
    """Raised if a plan is refused. The text is the whole line, with file, plan, placement, field and value."""


def parse_plan(
    plan_id: str,
    source: str,
    value: object,
    max_boxes: int,
    names: dict[str, str],
    unread: UnreadFields | None = None,
    given: InputConventions = USUAL_CONVENTIONS,
) -> Plan:
    """Validate one decoded plan.

    Args:
        source: name of the file in messages.
        value: the decoded JSON value of the plan.
        max_boxes: largest number of boxes. A plan with more boxes is refused, never truncated.
        names: names read so far (item ids, articles, groups, materials), kept so that equal names share one string. In
            BED-BPP, each name occurs about 20 times.
        unread: counter to which the ignored fields of a good plan are added.
        given: the units and the anchor of the plan's numbers, as the user gave them.

    Raises:
        PlanError: the plan is refused. The message names the file, the plan, the placement (numbered from 0, like all
            boxes) and the field.
    """
    where = f"{source}: plan {printable_id(plan_id)}"
    fault = plan_id_fault(plan_id)
    if fault is not None:
        raise PlanError(f"{where}: {fault}")
    if not isinstance(value, list):
        raise PlanError(f"{where}: must be a list of placements, got {kind(value)}")
    if not value:
        raise PlanError(f"{where}: has no placement")
    if len(value) > max_boxes:
        raise PlanError(f"{where}: {too_many_boxes(len(value), max_boxes)}")
    plan = _parse_columns(plan_id, source, value, names, given)
    if plan is None:
        missing = _all_missing(value)
        if missing is not None:
            raise PlanError(f"{where}: {missing}")
        for index, placement in enumerate(value):
            fault = find_fault(placement, given)
            if fault is not None:
                raise PlanError(f"{where}, placement {index}: {fault}")
        raise PlanError(f"{where}: is unusable")
    if unread is not None:
        _count_unread(value, unread)
    return plan


def _count_unread(placements: list[dict[str, Any]], unread: UnreadFields) -> None:
    for placement in placements:
        if not placement.keys() <= _PLACEMENT_FIELDS:
            unread.add(placement, _PLACEMENT_FIELDS)
        if not placement["item"].keys() <= _ITEM_FIELDS:
            unread.add(placement["item"], _ITEM_FIELDS, "item.")


def _parse_columns(
    plan_id: str, source: str, value: list[Any], names: dict[str, str], given: InputConventions
) -> Plan | None:
    """Read all placements column by column; None if anything is wrong.

    Whole columns are checked in C, since BED-BPP's 10,003 plans have 3 million numbers. For a bad plan, `find_fault`
    makes the same checks value by value, and produces the error text.
    """
    try:
        items = [placement["item"] for placement in value]
        corners = [placement["flb_coordinates"] for placement in value]
        orientations = [placement["orientation"] for placement in value]
        columns = [[item[field] for item in items] for field in _NUMBERS_OF_ITEM]
        sequences = [item["sequence"] for item in items]
        ids = [item["id"] for item in items]
        articles = [item["article"] for item in items]
        groups = ["" if (group := item.get("product_group")) is None else group for item in items]
        approaches = [placement.get("approach_deg") for placement in value]
        corner_lengths = set(map(len, corners))
        has_extra = not all(map(_RARE_FIELDS.isdisjoint, items))
        materials = [_value_or_default(item, "material", "") for item in items] if has_extra else []
        kinds = [_value_or_default(item, "kind", "") for item in items] if has_extra else []
        offsets = (
            [[_value_or_default(item, field, 0.0) for field in COM_FIELDS_JSON] for item in items] if has_extra else []
        )
        sparse = {name: [item.get(name) for item in items] for name in _SPARSE_OF_ITEM} if has_extra else {}
        sparse["approach_deg"] = approaches
    except (AttributeError, KeyError, TypeError, IndexError):
        return None
    coordinates = list(chain.from_iterable(corners))
    well_typed = (
        corner_lengths == {3}
        and not any(isinstance(entry, DuplicateFieldObject) for entry in chain(value, items))
        and set(map(type, corners)) == {list}
        and set(map(type, chain(coordinates, *columns, *offsets))) <= _NUMBERS
        and set(map(type, chain(orientations, sequences))) == {int}
        and set(orientations) <= {0, 1}
        and set(map(type, chain(*sparse.values()))) <= {*_NUMBERS, type(None)}
        and set(map(type, chain(ids, articles, groups, materials, kinds))) == {str}
        and max(map(len, chain(ids, articles, groups, materials))) <= LONGEST_NAME
        and is_text("".join(chain(ids, articles, groups, materials)))
    )
    if not well_typed:
        return None
    try:
        numbers = np.array(columns, dtype=np.float64)
        point = np.array(coordinates, dtype=np.float64).reshape(-1, 3) * given.place_mm
        sequence = np.array(sequences, dtype=np.int64)
        com = np.array(offsets, dtype=np.float64) * given.length_mm if has_extra else None
        numbers_of = {
            name: np.array([np.nan if value is None else value for value in values], dtype=np.float64)
            for name, values in sparse.items()
            if values.count(None) < len(values)
        }
    except OverflowError:
        return None
    size = np.ascontiguousarray(numbers[:3].T) * given.length_mm
    mass = numbers[3] * given.mass_kg
    # comparisons with NaN are false, so these checks of ranges also refuse NaN
    in_range = (
        ((size >= SMALLEST_MM) & (size <= LARGEST_MM)).all()
        and ((mass >= SMALLEST_KG) & (mass <= LARGEST_KG)).all()
        and (np.abs(point) <= FARTHEST_MM).all()
        and (com is None or (2 * np.abs(com) < size).all())
        and all(sparse_fault(name, value) is None for name in numbers_of for value in sparse[name])
        and all(kind_fault(name) is None for name in kinds)
        and all(pallet_fault(name, sides) is None for name, sides in zip(kinds, size, strict=False))
    )
    if not in_range:
        return None
    orientation = np.array(orientations, dtype=np.int64)
    swapped = orientation == 1
    size[swapped, :2] = size[swapped, 1::-1]
    return Plan(
        plan_id=plan_id,
        source=source,
        size_mm=size,
        corner_mm=given.corner_mm(point, size),
        mass_kg=mass,
        item_ids=tuple([names.setdefault(name, name) for name in ids]),
        articles=tuple([names.setdefault(name, name) for name in articles]),
        sequence=sequence,
        orientation=orientation,
        product_groups=tuple([names.setdefault(name, name) for name in groups]) if any(groups) else (),
        materials=tuple([names.setdefault(name, name) for name in materials]) if any(materials) else (),
        mass_center_mm=com_along_axes(com, swapped) if com is not None and com.any() else None,
        kinds=tuple(kinds),
        **numbers_of,
    )


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
