"""Fields of placements in all formats: their limits, and the error texts for values that are not allowed."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text, is_text, printable_name, shortened_text
from petmjx.common.units import FloatArray
from petmjx.options.carriers import Carrier
from petmjx.plans.file_formats import number_hint, other_encoding

SMALLEST_MM: Final = 1.0
LARGEST_MM: Final = 4_000.0
"""Limits of the sizes of items. A value outside these limits has the wrong unit or a damaged digit. The upper limit of
4 m also separates boxes that wait to be placed, which hang at least 8 m apart. The diagonal of a cube of 4 m is 6.9 m,
so the bounding spheres of two such cubes do not touch."""
FARTHEST_MM: Final = 20_000.0
"""Largest absolute value of a coordinate. The limit keeps all places of a plan far below the boxes that wait to be
placed, which hang at least 50 m high."""
SMALLEST_KG: Final = 0.001
LARGEST_KG: Final = 10_000.0
"""Limits of masses. For comparison: a pallet carries at most a few tonnes."""
COM_FIELDS: Final = ("com_length_mm", "com_width_mm", "com_height_mm")
"""Columns of a centre of mass in tables, along the item's length, width and height."""

COM_FIELDS_JSON: Final = tuple(name.replace("_mm", "/mm") for name in COM_FIELDS)
"""Names of the fields of a centre of mass in JSON, along the item's length, width and height."""

LARGEST_DEG: Final = 360.0
"""Largest absolute value of the direction of approach."""


def vanishing_side(size_mm: FloatArray, size_reduction_mm: float) -> tuple[int, str] | None:
    """The number of the first box that has no extent left after the size reduction, and a text about this box. The
    result is None if there is no such box. ``size_mm``: (n, 3) sizes of the boxes."""
    if size_mm.min(initial=np.inf) > size_reduction_mm:
        return None
    thin = np.flatnonzero((size_mm <= size_reduction_mm).any(axis=1))
    box, side = int(thin[0]), float(size_mm[thin[0]].min())
    return box, f"a side of {side:g} mm vanishes under the size reduction of {size_reduction_mm:g} mm"


class SparseField(NamedTuple):
    """A field with a number that placements may lack.

    Attributes:
        low, high: limits of the number.
        unit: unit of the number, spelled as in names of columns.
        units: unit of the number, spelled as in sentences.
        reaches_results: whether results depend on the field.
    """

    low: float
    high: float
    unit: str
    units: str
    reaches_results: bool = True


SPARSE: Final = {
    "approach_deg": SparseField(-LARGEST_DEG, LARGEST_DEG, "deg", "degrees"),
    "stiffness_n_mm": SparseField(0.01, 1e6, "N/mm", "N/mm"),
    "strength_n": SparseField(0.01, 1e9, "N", "N", reaches_results=False),
}
"""The fields with numbers that placements may lack. Each field is also a field of ``Plan``. The limits are wide:
corrugated boxes, for example, have a stiffness of 100 to 500 N/mm."""

SHEET: Final = "sheet"


class PalletKind(NamedTuple):
    """A kind of items that are pallets: extents, mm, and usual mass, kg, as of the carrier with the same name."""

    size_mm: tuple[float, float, float]
    mass_kg: float


PALLET_KINDS: Final[Mapping[str, PalletKind]] = {
    Carrier.EPAL_1.value: PalletKind((1200.0, 800.0, 144.0), 25.0),
    Carrier.GMA_48X40.value: PalletKind((1219.0, 1016.0, 121.0), 20.0),
}
"""Kinds of items that are pallets, and so bear other boxes."""
PALLET_SIZE_MM: Final = 1.0
"""Largest difference between the sizes of an item and the sizes of its kind of pallet, mm. Sizes in plans are usually
whole millimetres, so they may differ by one millimetre."""
KINDS: Final = ("box", SHEET, *PALLET_KINDS)
"""Kinds of items; the default is a box."""
LONGEST_NAME: Final = 1000
"""Largest number of characters of a plan id, an item id, an article or a product group."""

_UNIT_HINTS: Final = {
    ("millimetres", False): (1000.0, "metres? then give units m"),
    ("kilograms", False): (1000.0, "tonnes? then give units t"),
    ("kilograms", True): (0.001, "grams? then give units g"),
}
"""(unit of a value, whether the value is too large) → (the factor that brings it into range, its probable unit)."""

_NUMBERS: Final = {int, float}
_INT64: Final = np.iinfo(np.int64)
_MOST_NAMED: Final = 8
"""Largest number of fields that a note names."""


def first_fault(faults: Iterable[str | None]) -> str | None:
    """The first error text; None if there is none."""
    return next(filter(None, faults), None)


def text_fault(field: str, value: object) -> str | None:
    """The error text for a name; None if the name is good."""
    if not isinstance(value, str):
        return f"{field} must be a string, got {kind(value)}"
    if len(value) > LONGEST_NAME:
        return f"{field} must have at most {LONGEST_NAME:,} characters, got {len(value):,}"
    return None if is_text(value) else f"{field} is not UTF-8 text{other_encoding(value)}"


def plan_id_fault(value: str) -> str | None:
    """The error text for a plan id; None if the id is good."""
    if not value:
        return "the plan id must be text and not empty"
    if not is_text(value):
        return f"the plan id is not UTF-8 text{other_encoding(value)}"
    if len(value) > LONGEST_NAME:
        return f"the plan id must have at most {LONGEST_NAME:,} characters, got {len(value):,}"
    return None


def number_fault(field: str, value: object) -> str | None:
    """The error text for a value that is not a finite number; None if the value is a finite number."""
    if type(value) not in _NUMBERS:
        return f"{field} must be a number, got {kind(value)}{number_hint(value) if isinstance(value, str) else ''}"
    try:
        finite = math.isfinite(value)  # type: ignore[arg-type]  # a JSON number, as just checked
    except OverflowError:
        finite = False
    return None if finite else f"{field} must be finite, got {kind(value)}"


def positive_fault(field: str, value: Any, smallest: float, largest: float, unit: str) -> str | None:
    """The error text for a size or a mass; None if the value is allowed. The value and the limits are in ``unit``."""
    fault = number_fault(field, value)
    if fault is not None:
        return fault
    if value <= 0:
        return f"{field} must be > 0, got {kind(value)}"
    if not smallest <= value <= largest:
        factor, like = _UNIT_HINTS.get((unit, value > largest), (0.0, ""))
        likely = smallest <= factor * value <= largest
        return _out_of_range(field, value, smallest, largest, unit) + (f"; in {like}" if likely else "")
    return None


def coordinate_fault(field: str, value: Any, smallest: float, largest: float, unit: str) -> str | None:
    """The error text for a coordinate; None if the coordinate is allowed."""
    fault = number_fault(field, value)
    if fault is None and not smallest <= value <= largest:
        return _out_of_range(field, value, smallest, largest, unit)
    return fault


def _out_of_range(field: str, value: Any, smallest: float, largest: float, unit: str) -> str:
    return f"{field} must be from {smallest:g} to {largest:g} ({unit}), got {kind(value)}"


def com_fault(field: str, value: Any, size: float) -> str | None:
    """The error text for a centre of mass along one side of a box; None if the centre of mass is allowed.

    Args:
        size: length of this side, in the unit of the value.
    """
    fault = number_fault(field, value)
    if fault is None and not 2 * abs(value) < size:
        return f"{field} must be inside the box, less than half of {size:g} from the middle, got {kind(value)}"
    return fault


def com_along_axes(item_com_mm: FloatArray, turned: NDArray[np.bool_]) -> FloatArray:
    """(n, 3) centres of mass along x, y and z, computed from the centres along the items' length, width and height (n,
    3).

    The length of a turned item lies along y, and its width along −x.
    """
    across = item_com_mm[:, [1, 0, 2]] * (-1.0, 1.0, 1.0)
    return np.where(turned[:, None], across, item_com_mm) + 0.0  # + 0.0 turns -0.0 into 0.0


def integer_fault(field: str, value: object) -> str | None:
    """The error text for a sequence number; None if the number is allowed."""
    if type(value) is not int:
        return f"{field} must be an integer, got {kind(value)}"
    return None if _INT64.min <= value <= _INT64.max else f"{field} is too large, got {kind(value)}"


def orientation_fault(value: object) -> str | None:
    """The error text for an orientation; None if the orientation is allowed."""
    is_valid = type(value) is int and value in (0, 1)
    return None if is_valid else f"orientation must be 0 or 1, got {kind(value)}"


def sparse_fault(field: str, value: object) -> str | None:
    """The error text for a value of a field of ``SPARSE`` (a number that placements may lack); None if the value is
    good."""
    known = SPARSE[field]
    return None if value is None else coordinate_fault(field, value, known.low, known.high, known.units)


def kind_fault(value: object) -> str | None:
    """The error text for the kind of an item; None if the kind is allowed."""
    if value is None or value == "" or (isinstance(value, str) and value in KINDS):
        return None
    return f"kind must be {joined_names(KINDS, 'or')}, got {kind(value)}"


def pallet_fault(name: str | None, size_mm: Sequence[float]) -> str | None:
    """The error text for an item that is a pallet but has other sizes than its kind; None if the sizes are right.

    Args:
        name: the item's kind.
        size_mm: length, width and height of the item, or its extents as placed, mm.
    """
    if name is None or name not in PALLET_KINDS:
        return None
    length, width, height = PALLET_KINDS[name].size_mm
    for pallet in (length, width, height), (width, length, height):
        if all(abs(side - extent) <= PALLET_SIZE_MM for side, extent in zip(size_mm, pallet, strict=True)):
            return None
    sizes = " × ".join(f"{side:g}" for side in size_mm)
    return f"kind {name} must be {length:g} × {width:g} × {height:g} mm, or turned by 90°, got {sizes}"


def missing_fault(fields: Sequence[str]) -> str:
    """The error text for missing fields, such as "weight/kg is missing" or "id, weight/kg and sequence are missing"."""
    return f"{joined_names(fields)} {'is' if len(fields) == 1 else 'are'} missing"


def missing_anywhere(missing: Mapping[str, Sequence[int]], noun: str) -> str | None:
    """The error text for all missing fields of a plan; None if at most one of its placements lacks fields.

    Args:
        missing: field → numbers of the placements that lack it.
        noun: name of what is counted, such as "row".
    """
    if len({index for indices in missing.values() for index in indices}) < 2:
        return None
    field_names = [
        f"{field} in {noun} {indices[0]}" + (f" and {len(indices) - 1:,} more" if len(indices) > 1 else "")
        for field, indices in missing.items()
    ]
    return f"fields are missing: {', '.join(field_names)}"


def too_many_boxes(n_boxes: int, most: int) -> str:
    """The error text for a plan with more boxes than allowed."""
    return f"has {n_boxes} boxes, more than the largest capacity of {most}"


def kind(value: object) -> str:
    """A JSON value as messages show it: scalars as JSON, containers by the name of their type."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 200:
        return "an integer of more than 60 digits"
    if isinstance(value, str):
        value = value[:LONGEST_NAME]
    return shortened_text(json.dumps(value))


def joined_names(names: Sequence[str], conjunction: Literal["and", "or"] = "and") -> str:
    """Names in a sentence: "x", "x and y", "x, y and z"."""
    return f" {conjunction} ".join(filter(None, (", ".join(names[:-1]), names[-1])))


class UnreadFields(Counter[str]):
    """Fields of plans that petmjx does not read: name → number of placements that have it."""

    def notes(self) -> list[str]:
        """A list with one line that names the fields that petmjx does not read; empty if there are no such fields."""
        if not self:
            return []
        field_names = [
            f"{printable_name(name)} ({count_text(number, 'placement')})"
            for name, number in self.most_common(_MOST_NAMED)
        ]
        if len(self) > _MOST_NAMED:
            field_names.append(f"{len(self) - _MOST_NAMED:,} more")
        return [f"fields of plans that petmjx does not read: {joined_names(field_names)}"]

    def add(self, names: Iterable[str], known: frozenset[str], prefix: str = "") -> None:
        """Count the unknown fields of one placement."""
        self.update(prefix + name for name in names if name not in known)
