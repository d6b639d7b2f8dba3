"""Decodes plans of BED-BPP's JSON: placements become records, whose columns are checked and become a plan.

The text of a plan that has no faults and only the common fields becomes records at once, without a Python object for
each number. ``parse_plan`` makes records of all other plans, or an error of one line. For the same file, both ways give
the same plans.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from operator import attrgetter
from typing import Annotated, Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.garbage_collection import no_collection
from petmjx.common.text import is_text, printable_id
from petmjx.common.units import FloatArray
from petmjx.plans.input_conventions import USUAL_CONVENTIONS, InputConventions
from petmjx.plans.json_reader import LONGEST_VALUE, DuplicateFieldObject, Entry, MalformedPlans, scan_plans
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import (
    FARTHEST_MM,
    LARGEST_KG,
    LARGEST_MM,
    LONGEST_NAME,
    SMALLEST_KG,
    SMALLEST_MM,
    SPARSE,
    UnreadFields,
    com_along_axes,
    kind_fault,
    pallet_fault,
    plan_id_fault,
    sparse_fault,
)
from petmjx.plans.plan_transfer_arrays import plan_of_rows
from petmjx.plans.plan_validation import count_unread, fault_of_plan

_MOST_PLANS: Final = 2000
"""Number of plans that are decoded together. 2,000 plans have about 90,000 placements, each a record of 200 bytes."""

_Name = Annotated[str, msgspec.Meta(max_length=LONGEST_NAME)]
_JSON_NAMES: Final = {
    **{name: f"{name}/mm" for name in ("length", "width", "height", "com_length", "com_width", "com_height")},
    "weight": "weight/kg",
}


# ``gc`` is False, since records form no cycles, so the garbage collector would examine each of them for nothing
class _Item(msgspec.Struct, forbid_unknown_fields=True, gc=False, rename=_JSON_NAMES):
    article: _Name
    id: _Name
    length: float
    width: float
    height: float
    weight: float
    sequence: int
    product_group: _Name | msgspec.UnsetType = msgspec.UNSET


class _Placement(msgspec.Struct, forbid_unknown_fields=True, gc=False):
    item: _Item
    orientation: int
    flb_coordinates: tuple[float, float, float]


class _AnyItem(_Item, forbid_unknown_fields=False, gc=False, rename=_JSON_NAMES):
    """An item that may have further fields."""

    product_group: _Name | msgspec.UnsetType | None = None  # type: ignore[assignment]  # null is allowed here
    material: _Name | None = None
    kind: str | None = None
    com_length: float | None = None
    com_width: float | None = None
    com_height: float | None = None


class _AnyPlacement(_Placement, forbid_unknown_fields=False, gc=False):
    """A placement that may have further fields."""

    item: _AnyItem


_RARE_FIELDS: Final = {*_AnyItem.__struct_encode_fields__, *SPARSE} - {*_Item.__struct_encode_fields__}
"""Fields of items and placements that few plans have, under their names in JSON."""

# loops over these functions run in C
_ITEM: Final = attrgetter("item")
_SEQUENCE: Final = attrgetter("sequence")
_SIZE: Final = attrgetter("length", "width", "height")
_WEIGHT: Final = attrgetter("weight")
_ORIENTATION: Final = attrgetter("orientation")
_POINT: Final = attrgetter("flb_coordinates")
_CENTRE_OF_MASS: Final = attrgetter("com_length", "com_width", "com_height")

_N_FIELDS: Final = 10
"""Number of fields of a placement and its item, without the product group."""

_PLANS: Final = msgspec.json.Decoder(dict[str, msgspec.Raw])
_PLACEMENTS: Final = msgspec.json.Decoder(list[_Placement])


class ReadEntry(NamedTuple):
    """One entry of a file after it was read: a plan, a faulty entry, or an order.

    Attributes:
        plan: the plan; None for a faulty entry or an order.
        fault: the error of a faulty entry; None for a plan or an order.
    """

    plan_id: str
    plan: Plan | None = None
    fault: str | None = None


@dataclass(frozen=True)
class DecoderOptions:
    """How the plans of a file are decoded.

    Attributes:
        source: name of the file in messages.
        max_boxes: largest number of boxes. A plan with more boxes is refused, never truncated.
        given: the units and the anchor of the plans' numbers, as the user gave them.
        names: names read so far (item ids, articles, groups, materials), kept so that equal names share one string. In
            BED-BPP, each name occurs about 20 times.
        unread: counter of the fields that petmjx does not read.
    """

    source: str
    max_boxes: int = sys.maxsize
    given: InputConventions = USUAL_CONVENTIONS
    names: dict[str, str] = field(default_factory=dict)
    unread: UnreadFields = field(default_factory=UnreadFields)


class PlanError(InputError):
    """Raised if a plan is refused. The text is the whole line, with file, plan, placement, field and value."""


def decode_entries(data: bytes | bytearray, options: DecoderOptions) -> list[ReadEntry] | None:
    """Decode the entries of a file, in order. The result is None if the text is not JSON, or not an object with
    distinct ids. If the result is None, the caller reads the text again, entry by entry up to the error
    (``scan_plans``); ``options.unread`` is not changed."""
    try:
        values = _PLANS.decode(data)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return None
    texts = list(values.values())  # the texts are views of the caller's memory, not copies
    colons = [bytes(text).count(b":") for text in texts]
    # Of entries with the same id, the decoder keeps only one. So an id is repeated if the text has more colons than the
    # decoded entries.
    if data.count(b":") != sum(colons) + len(texts) + sum(plan_id.count(":") for plan_id in values):
        return None
    if max((memoryview(text).nbytes for text in texts), default=0) > LONGEST_VALUE:
        return None
    entries: list[ReadEntry] = []
    plan_ids, unread = list(values), options.unread.copy()
    try:
        with no_collection():
            for first in range(0, len(texts), _MOST_PLANS):
                some = slice(first, first + _MOST_PLANS)
                entries += _decode(plan_ids[some], texts[some], colons[some], options)
    except MalformedPlans:
        options.unread.clear()
        options.unread.update(unread)
        return None
    return entries


def _decode(
    plan_ids: Sequence[str], texts: Sequence[msgspec.Raw], colons: Sequence[int], options: DecoderOptions
) -> Iterator[ReadEntry]:
    """Decode the entries of some plans, in order.

    Args:
        colons: for each text, the number of its colons, both after names of fields and inside strings.
    """
    plain = {
        number: placements
        for number, (plan_id, text, count) in enumerate(zip(plan_ids, texts, colons, strict=True))
        if plan_id_fault(plan_id) is None and (placements := _plain_placements(text, count, options.max_boxes))
    }
    plans = _plans_of([plan_ids[number] for number in plain], list(plain.values()), options)
    plan_by_number = dict(zip(plain, plans, strict=True))
    for number, (plan_id, text) in enumerate(zip(plan_ids, texts, strict=True)):
        plan = plan_by_number.get(number)
        if plan is None:
            (entry,) = scan_plans(b'{"":' + bytes(text) + b"}")
            yield read_entry(entry._replace(plan_id=plan_id), options)
        else:
            yield ReadEntry(plan_id, plan)


def _plain_placements(text: msgspec.Raw, colons: int, max_boxes: int) -> list[_Placement] | None:
    """The placements of a plan that has only the common fields, each once and of the right type; else None."""
    try:
        placements = _PLACEMENTS.decode(text)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return None
    n_without = [placement.item.product_group for placement in placements].count(msgspec.UNSET)
    once = colons == (_N_FIELDS + 1) * len(placements) - n_without
    return placements if once and len(placements) <= max_boxes else None


def _plans_of(
    plan_ids: Sequence[str], plans: Sequence[Sequence[_Placement]], options: DecoderOptions
) -> list[Plan | None]:
    """Make a plan from each list of placements; None for a plan with a value that is not allowed.

    Whole columns are checked, for all plans at once. The arrays of each plan are slices of arrays with the boxes of all
    plans.
    """
    if not plans:
        return []
    placements = list(chain.from_iterable(plans))
    items = [*map(_ITEM, placements)]
    given, names = options.given, options.names
    try:
        sequence = np.fromiter(map(_SEQUENCE, items), np.int64, len(items))
        orientation = np.fromiter(map(_ORIENTATION, placements), np.int64, len(items))
    except OverflowError:
        return [None] * len(plans)
    size = _triples(map(_SIZE, items), len(items)) * given.length_mm
    mass = np.fromiter(map(_WEIGHT, items), np.float64, len(items)) * given.mass_kg
    point = _triples(map(_POINT, placements), len(items)) * given.place_mm
    texts = {
        "item_ids": [item.id for item in items],
        "articles": [item.article for item in items],
        "product_groups": [item.product_group or "" for item in items],  # ``UNSET`` is false, too
    }
    is_good = (
        ((size >= SMALLEST_MM) & (size <= LARGEST_MM)).all(1)
        & ((mass >= SMALLEST_KG) & (mass <= LARGEST_KG))
        & (np.abs(point) <= FARTHEST_MM).all(1)
        & ((orientation == 0) | (orientation == 1))
    )
    swapped = orientation == 1
    size[swapped, :2] = size[swapped, 1::-1]
    arrays: dict[str, NDArray[Any]] = {
        "size_mm": size,
        "corner_mm": given.corner_mm(point, size),
        "mass_kg": mass,
        "sequence": sequence,
        "orientation": orientation,
    }
    shared = {name: list(map(names.setdefault, column, column)) for name, column in texts.items()}
    ends = np.cumsum([len(plan) for plan in plans])
    begins = np.concatenate([[0], ends[:-1]])
    are_good = np.logical_and.reduceat(is_good, begins)  # every plan has placements
    return [
        plan_of_rows(plan_id, options.source, slice(begin, end), arrays, shared) if all_good else None
        for plan_id, begin, end, all_good in zip(
            plan_ids, begins.tolist(), ends.tolist(), are_good.tolist(), strict=True
        )
    ]


def _triples(values: Iterable[tuple[float, float, float]], count: int) -> FloatArray:
    """(count, 3) the triples as an array. ``numpy.array`` of a list of tuples would take four times as long."""
    return np.fromiter(chain.from_iterable(values), np.float64, 3 * count).reshape(-1, 3)


def parse_plan(plan_id: str, value: object, options: DecoderOptions) -> Plan:
    """Validate one decoded plan, which may have any fields.

    Args:
        value: the decoded JSON value of the plan.

    Raises:
        PlanError: the plan is refused. The message names the file, the plan, the placement (numbered from 0, like all
            boxes) and the field.
    """
    where = f"{options.source}: plan {printable_id(plan_id)}"
    if (fault := plan_id_fault(plan_id)) is not None:
        raise PlanError(f"{where}: {fault}")
    if isinstance(value, list) and len(value) <= options.max_boxes and (placements := _any_placements(value)):
        (plan,) = _plans_of([plan_id], [placements], options)
        plan = None if plan is None else _with_rare_fields(plan, value, placements, options)
        if plan is not None:
            count_unread(value, options.unread)
            return plan
    raise PlanError(f"{where}{fault_of_plan(value, options.max_boxes, options.given) or ': is unusable'}")


def _any_placements(value: list[Any]) -> list[_AnyPlacement] | None:
    """The placements of a decoded plan; None if a field is missing, is repeated or has the wrong type."""
    try:
        placements = msgspec.convert(value, list[_AnyPlacement])
    except (msgspec.ValidationError, OverflowError, UnicodeError):
        return None
    if any(isinstance(record, DuplicateFieldObject) for placed in value for record in (placed, placed["item"])):
        return None
    names = ((one.article, one.id, one.product_group, one.material) for one in map(_ITEM, placements))
    return placements if is_text("".join(filter(None, chain.from_iterable(names)))) else None


def _with_rare_fields(
    plan: Plan, value: list[dict[str, Any]], placements: Sequence[_AnyPlacement], options: DecoderOptions
) -> Plan | None:
    """A plan with the fields that few plans have; None if one of their values is not allowed. ``value``: the decoded
    placements, which also have the fields of ``SPARSE``."""
    if all(_RARE_FIELDS.isdisjoint(placed) and _RARE_FIELDS.isdisjoint(placed["item"]) for placed in value):
        return plan
    items, size_mm = [*map(_ITEM, placements)], plan.item_size_mm
    materials = [item.material or "" for item in items]
    kinds = tuple(item.kind or "" for item in items)
    com_mm = np.array([[side or 0.0 for side in _CENTRE_OF_MASS(item)] for item in items]) * options.given.length_mm
    sparse: dict[str, list[float | None]] = {
        name: [(placed if name == "approach_deg" else placed["item"]).get(name) for placed in value] for name in SPARSE
    }
    is_good = (
        bool((2 * np.abs(com_mm) < size_mm).all())
        and all(sparse_fault(name, number) is None for name, values in sparse.items() for number in values)
        and all(kind_fault(name) is None for name in kinds)
        and all(pallet_fault(name, sides) is None for name, sides in zip(kinds, size_mm, strict=True))
    )
    if not is_good:
        return None
    numbers: dict[str, Any] = {
        name: np.array([np.nan if number is None else number for number in values], np.float64)
        for name, values in sparse.items()
        if values.count(None) < len(values)
    }
    return replace(
        plan,
        materials=tuple(map(options.names.setdefault, materials, materials)) if any(materials) else (),
        mass_center_mm=com_along_axes(com_mm, plan.turned) if com_mm.any() else None,
        kinds=kinds,
        **numbers,
    )


def read_entry(entry: Entry, options: DecoderOptions) -> ReadEntry:
    """Read an entry that may have any fields or a fault, or is an order."""
    plan_id, value = entry
    if isinstance(value, dict) and "item_sequence" in value:
        return ReadEntry(plan_id)
    try:
        return ReadEntry(plan_id, parse_plan(plan_id, value, options))
    except PlanError as error:
        return ReadEntry(plan_id, fault=str(error))
