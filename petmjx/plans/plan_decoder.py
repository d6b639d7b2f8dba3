"""Fast decoder of BED-BPP's JSON, which turns placements into records without making a Python object for each number.

The decoder reads only plans that have no faults and only the common fields. ``parse_plan`` reads all other plans: it
checks field by field and has the text of each error. For the same file, both ways of reading give the same plans.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Annotated, Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from petmjx.common.garbage_collection import no_collection
from petmjx.common.units import FloatArray
from petmjx.plans.input_conventions import InputConventions
from petmjx.plans.json_reader import LONGEST_VALUE, Entry, MalformedPlans, scan_plans
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import (
    FARTHEST_MM,
    LARGEST_KG,
    LARGEST_MM,
    LONGEST_NAME,
    SMALLEST_KG,
    SMALLEST_MM,
    UnreadFields,
    plan_id_fault,
)
from petmjx.plans.plan_transfer_arrays import plan_of_rows
from petmjx.plans.plan_validation import PlanError, parse_plan

_MOST_PLANS: Final = 2000
"""Number of plans that are decoded together. 2,000 plans have about 90,000 placements, each a record of 200 bytes."""

_Name = Annotated[str, msgspec.Meta(max_length=LONGEST_NAME)]


class _Item(
    msgspec.Struct,
    forbid_unknown_fields=True,
    gc=False,  # records form no cycles, so the garbage collector would examine each of them for nothing
    rename={"length": "length/mm", "width": "width/mm", "height": "height/mm", "weight": "weight/kg"},
):
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


# loops over these functions run in C
_SEQUENCE: Final = attrgetter("sequence")
_SIZE: Final = attrgetter("length", "width", "height")
_WEIGHT: Final = attrgetter("weight")
_ORIENTATION: Final = attrgetter("orientation")
_POINT: Final = attrgetter("flb_coordinates")

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
    """Arguments of ``parse_plan`` that are the same for all plans of a file.

    Attributes:
        names: names read so far, which are kept so that equal names share one string.
        unread: counter of the fields that petmjx does not read.
    """

    source: str
    max_boxes: int
    given: InputConventions
    names: dict[str, str]
    unread: UnreadFields


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
    items = [placement.item for placement in placements]
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
        "product_groups": ["" if item.product_group is msgspec.UNSET else item.product_group for item in items],
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
    # msgspec refuses strings that cannot be written as UTF-8, so names need no check
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


def read_entry(entry: Entry, options: DecoderOptions) -> ReadEntry:
    """Read an entry field by field, because it has other fields or a fault, or is an order."""
    plan_id, value = entry
    if isinstance(value, dict) and "item_sequence" in value:
        return ReadEntry(plan_id)
    try:
        plan = parse_plan(
            plan_id, options.source, value, options.max_boxes, options.names, options.unread, options.given
        )
    except PlanError as error:
        return ReadEntry(plan_id, fault=str(error))
    return ReadEntry(plan_id, plan)
