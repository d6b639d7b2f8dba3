"""One plan in BED-BPP's format: from decoded JSON to checked arrays, or one line that says what is wrong."""

from __future__ import annotations

import json
import math
from itertools import chain
from typing import Any, Final

import numpy as np

from petmjx.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.text import is_text, shortened, shown

SMALLEST_MM: Final = 1.0
LARGEST_MM: Final = 4_000.0
"""Sizes of items. Boxes that wait for their turn hang 8 m apart or more: the bounding spheres of two cubes of 4 m,
whose diagonal is 6.9 m, do not meet. Beyond these limits a number has the wrong unit or a damaged digit."""
FARTHEST_MM: Final = 20_000.0
"""Coordinates. Boxes that wait hang 50 m high or more, far above what a plan places."""
SMALLEST_KG: Final = 0.001
LARGEST_KG: Final = 10_000.0
"""Masses. A pallet carries at most a few tonnes."""
LONGEST_NAME: Final = 1000
"""Characters of a plan id, an item id or an article."""

_RANGES: Final = {
    **dict.fromkeys(("length/mm", "width/mm", "height/mm"), (SMALLEST_MM, LARGEST_MM, "millimetres")),
    "weight/kg": (SMALLEST_KG, LARGEST_KG, "kilograms"),
}
_NUMBERS: Final = {int, float}
_INT64: Final = np.iinfo(np.int64)


class PlanError(InputError):
    """A plan that is refused. Its text is the whole line: file, plan, placement, field, and what was found."""


def parse_plan(plan_id: str, source: str, value: object, max_boxes: int, names: dict[str, str]) -> Plan:
    """Validate one decoded plan.

    Args:
        value: what JSON held under the plan's id.
        max_boxes: plans with more boxes are refused, never cut.
        names: item ids and articles read so far; equal ones share one string (BED-BPP repeats each about 20 times).

    Raises:
        PlanError: naming file, plan, placement (counted from 0, as boxes are everywhere) and field.
    """
    where = f"{source}: plan {shown(plan_id)}"
    if not plan_id or not is_text(plan_id):
        raise PlanError(f"{where}: the plan id must be text and not empty")
    if len(plan_id) > LONGEST_NAME:
        raise PlanError(f"{where}: the plan id must have at most {LONGEST_NAME:,} characters, got {len(plan_id):,}")
    if not isinstance(value, list):
        raise PlanError(f"{where}: must be a list of placements, got {_kind(value)}")
    if not value:
        raise PlanError(f"{where}: has no placement")
    if len(value) > max_boxes:
        raise PlanError(f"{where}: has {len(value)} boxes, more than the largest capacity of {max_boxes}")
    plan = _parse_columns(plan_id, source, value, names)
    if plan is None:
        for index, placement in enumerate(value):
            fault = find_fault(placement)
            if fault is not None:
                raise PlanError(f"{where}, placement {index}: {fault}")
        raise PlanError(f"{where}: is unusable")
    return plan


def _parse_columns(plan_id: str, source: str, value: list[Any], names: dict[str, str]) -> Plan | None:
    """Read all placements column by column; None if anything is wrong.

    10,003 plans have 3 million numbers, so a good plan is checked in C, over whole columns. For a bad plan `find_fault`
    does the same checks value by value, and says what is wrong.
    """
    try:
        items = [placement["item"] for placement in value]
        corners = [placement["flb_coordinates"] for placement in value]
        orientations = [placement["orientation"] for placement in value]
        columns = [[item[field] for item in items] for field in _RANGES]
        sequences = [item["sequence"] for item in items]
        ids = [item["id"] for item in items]
        articles = [item["article"] for item in items]
        corner_lengths = set(map(len, corners))
    except (KeyError, TypeError, IndexError):
        return None
    coordinates = list(chain.from_iterable(corners))
    well_typed = (
        corner_lengths == {3}
        and set(map(type, corners)) == {list}
        and set(map(type, chain(coordinates, *columns))) <= _NUMBERS
        and set(map(type, chain(orientations, sequences))) == {int}
        and set(orientations) <= {0, 1}
        and set(map(type, chain(ids, articles))) == {str}
        and max(map(len, chain(ids, articles))) <= LONGEST_NAME
        and is_text("".join(ids))
        and is_text("".join(articles))
    )
    if not well_typed:
        return None
    try:
        numbers = np.array(columns, dtype=np.float64)
        corner = np.array(coordinates, dtype=np.float64).reshape(-1, 3)
        sequence = np.array(sequences, dtype=np.int64)
    except OverflowError:
        return None
    size = np.ascontiguousarray(numbers[:3].T)
    mass = numbers[3].copy()
    # Comparisons with NaN are false, so each range also refuses NaN.
    in_range = (
        ((size >= SMALLEST_MM) & (size <= LARGEST_MM)).all()
        and ((mass >= SMALLEST_KG) & (mass <= LARGEST_KG)).all()
        and (np.abs(corner) <= FARTHEST_MM).all()
    )
    if not in_range:
        return None
    swapped = np.array(orientations) == 1
    size[swapped, :2] = size[swapped, 1::-1]
    return Plan(
        plan_id=plan_id,
        source=source,
        size_mm=size,
        corner_mm=corner,
        mass_kg=mass,
        item_ids=tuple([names.setdefault(name, name) for name in ids]),
        articles=tuple([names.setdefault(name, name) for name in articles]),
        sequence=sequence,
    )


def find_fault(placement: object) -> str | None:
    """What is wrong with one placement, in the order of the fields; None if nothing is."""
    if not isinstance(placement, dict):
        return f"must be an object, got {_kind(placement)}"
    if "item" not in placement:
        return "item is missing"
    item = placement["item"]
    if not isinstance(item, dict):
        return f"item must be an object, got {_kind(item)}"
    for field in ("article", "id", *_RANGES, "sequence"):
        if field not in item:
            return f"{field} is missing"
    return (
        _text_fault("article", item["article"])
        or _text_fault("id", item["id"])
        or next(filter(None, (_positive_fault(field, item[field], *_RANGES[field]) for field in _RANGES)), None)
        or _sequence_fault(item["sequence"])
        or _orientation_fault(placement)
        or _corner_fault(placement)
    )


def _text_fault(field: str, value: object) -> str | None:
    if not isinstance(value, str):
        return f"{field} must be a string, got {_kind(value)}"
    if len(value) > LONGEST_NAME:
        return f"{field} must have at most {LONGEST_NAME:,} characters, got {len(value):,}"
    return None if is_text(value) else f"{field} is not UTF-8 text"


def _number_fault(field: str, value: object) -> str | None:
    if type(value) not in _NUMBERS:
        return f"{field} must be a number, got {_kind(value)}"
    try:
        finite = math.isfinite(value)  # type: ignore[arg-type]  # a JSON number, as just checked
    except OverflowError:
        finite = False
    return None if finite else f"{field} must be finite, got {_kind(value)}"


def _positive_fault(field: str, value: Any, smallest: float, largest: float, unit: str) -> str | None:
    fault = _number_fault(field, value)
    if fault is not None:
        return fault
    if value <= 0:
        return f"{field} must be > 0, got {_kind(value)}"
    if not smallest <= value <= largest:
        return f"{field} must be from {smallest:g} to {largest:g} ({unit}), got {_kind(value)}"
    return None


def _sequence_fault(value: object) -> str | None:
    if type(value) is not int:
        return f"sequence must be an integer, got {_kind(value)}"
    return None if _INT64.min <= value <= _INT64.max else f"sequence is too large, got {_kind(value)}"


def _orientation_fault(placement: dict[str, Any]) -> str | None:
    if "orientation" not in placement:
        return "orientation is missing"
    value = placement["orientation"]
    known = type(value) is int and value in (0, 1)
    return None if known else f"orientation must be 0 or 1, got {_kind(value)}"


def _corner_fault(placement: dict[str, Any]) -> str | None:
    if "flb_coordinates" not in placement:
        return "flb_coordinates is missing"
    corner = placement["flb_coordinates"]
    if not isinstance(corner, list):
        return f"flb_coordinates must be a list of 3 numbers, got {_kind(corner)}"
    if len(corner) != 3:
        return f"flb_coordinates must be 3 numbers, got {len(corner)}"
    for axis, value in enumerate(corner):
        field = f"flb_coordinates[{axis}]"
        fault = _number_fault(field, value)
        if fault is None and abs(value) > FARTHEST_MM:
            fault = f"{field} must be from {-FARTHEST_MM:g} to {FARTHEST_MM:g} (millimetres), got {_kind(value)}"
        if fault is not None:
            return fault
    return None


def _kind(value: object) -> str:
    """A JSON value as messages show it: scalars as written, containers by name."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 200:
        return "an integer of more than 60 digits"
    if isinstance(value, str):
        value = value[:LONGEST_NAME]
    return shortened(json.dumps(value))
