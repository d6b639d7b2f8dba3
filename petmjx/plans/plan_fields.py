"""The fields of a placement, whatever form it comes in: what is allowed, and what is said of a value that is not."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text, is_text, printable_name, shortened_text
from petmjx.common.units import FloatArray
from petmjx.plans.file_formats import number_hint, other_encoding

SMALLEST_MM: Final = 1.0
LARGEST_MM: Final = 4_000.0
"""Sizes of items. Boxes that wait for their turn hang 8 m apart or more: the bounding spheres of two cubes of 4 m,
whose diagonal is 6.9 m, do not meet. Beyond these limits a number has the wrong unit or a damaged digit."""
FARTHEST_MM: Final = 20_000.0
"""Coordinates. Boxes that wait hang 50 m high or more, far above what a plan places."""
SMALLEST_KG: Final = 0.001
LARGEST_KG: Final = 10_000.0
"""Masses. A pallet carries at most a few tonnes."""
COM_FIELDS: Final = ("com_length_mm", "com_width_mm", "com_height_mm")
"""A centre of mass in tables, along the item's sides."""

COM_FIELDS_JSON: Final = tuple(name.replace("_mm", "/mm") for name in COM_FIELDS)
"""The same in JSON."""

LARGEST_DEG: Final = 360.0
"""Approaches, both ways."""


class SparseField(NamedTuple):
    """A number that placements may have.

    Attributes:
        low, high: its limits.
        unit: of columns of files; ``units``: in sentences.
        reaches_results: whether a simulation depends on it.
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
"""Optional numbers of placements; a plan has a field of the same name. Corrugated boxes have 100 to 500 N/mm."""

SHEET: Final = "sheet"
KINDS: Final = ("box", SHEET)
"""What an item may be; by default it is a box."""
LONGEST_NAME: Final = 1000
"""Characters of a plan id, an item id, an article or a product group."""

_LIKE: Final = {
    ("millimetres", False): (1000.0, "metres? then give units m"),
    ("kilograms", False): (1000.0, "tonnes? then give units t"),
    ("kilograms", True): (0.001, "grams? then give units g"),
}
"""The unit of a value, and whether it is too large → a factor that would make it usual, and what it may be in then."""

_NUMBERS: Final = {int, float}
_INT64: Final = np.iinfo(np.int64)
_MOST_NAMED: Final = 8
"""Fields that a note names."""


def text_fault(field: str, value: object) -> str | None:
    """What is wrong with a name; None if it is fine."""
    if not isinstance(value, str):
        return f"{field} must be a string, got {kind(value)}"
    if len(value) > LONGEST_NAME:
        return f"{field} must have at most {LONGEST_NAME:,} characters, got {len(value):,}"
    return None if is_text(value) else f"{field} is not UTF-8 text{other_encoding(value)}"


def plan_id_fault(value: str) -> str | None:
    """What is wrong with a plan id; None if it is fine."""
    if not value:
        return "the plan id must be text and not empty"
    if not is_text(value):
        return f"the plan id is not UTF-8 text{other_encoding(value)}"
    if len(value) > LONGEST_NAME:
        return f"the plan id must have at most {LONGEST_NAME:,} characters, got {len(value):,}"
    return None


def number_fault(field: str, value: object) -> str | None:
    """What is wrong with a finite number; None if it is fine."""
    if type(value) not in _NUMBERS:
        return f"{field} must be a number, got {kind(value)}{number_hint(value) if isinstance(value, str) else ''}"
    try:
        finite = math.isfinite(value)  # type: ignore[arg-type]  # a JSON number, as just checked
    except OverflowError:
        finite = False
    return None if finite else f"{field} must be finite, got {kind(value)}"


def positive_fault(field: str, value: Any, smallest: float, largest: float, unit: str) -> str | None:
    """What is wrong with a size or mass, of which the limits are in its unit; None if it is fine."""
    fault = number_fault(field, value)
    if fault is not None:
        return fault
    if value <= 0:
        return f"{field} must be > 0, got {kind(value)}"
    if not smallest <= value <= largest:
        factor, like = _LIKE.get((unit, value > largest), (0.0, ""))
        likely = smallest <= factor * value <= largest
        return _out_of_range(field, value, smallest, largest, unit) + (f"; in {like}" if likely else "")
    return None


def coordinate_fault(field: str, value: Any, smallest: float, largest: float, unit: str) -> str | None:
    """What is wrong with a coordinate; None if it is fine."""
    fault = number_fault(field, value)
    if fault is None and not smallest <= value <= largest:
        return _out_of_range(field, value, smallest, largest, unit)
    return fault


def _out_of_range(field: str, value: Any, smallest: float, largest: float, unit: str) -> str:
    return f"{field} must be from {smallest:g} to {largest:g} ({unit}), got {kind(value)}"


def com_fault(field: str, value: Any, size: float) -> str | None:
    """What is wrong with a centre of mass along a side of this length, in the same unit; None if it is fine."""
    fault = number_fault(field, value)
    if fault is None and not 2 * abs(value) < size:
        return f"{field} must be inside the box, less than half of its {size:g} from the middle, got {kind(value)}"
    return fault


def com_along_axes(item_com_mm: FloatArray, turned: NDArray[np.bool_]) -> FloatArray:
    """(n, 3) centres of mass along x, y and z, from those along items' length, width and height.

    Of an item that is turned the length lies along y and the width against x.
    """
    across = item_com_mm[:, [1, 0, 2]] * (-1.0, 1.0, 1.0)
    return np.where(turned[:, None], across, item_com_mm) + 0.0  # not -0.0


def integer_fault(field: str, value: object) -> str | None:
    """What is wrong with a running number; None if it is fine."""
    if type(value) is not int:
        return f"{field} must be an integer, got {kind(value)}"
    return None if _INT64.min <= value <= _INT64.max else f"{field} is too large, got {kind(value)}"


def orientation_fault(value: object) -> str | None:
    """What is wrong with an orientation; None if it is fine."""
    known = type(value) is int and value in (0, 1)
    return None if known else f"orientation must be 0 or 1, got {kind(value)}"


def sparse_fault(field: str, value: object) -> str | None:
    """What is wrong with one of the numbers that may be missing; None if it is fine."""
    known = SPARSE[field]
    return None if value is None else coordinate_fault(field, value, known.low, known.high, known.units)


def kind_fault(value: object) -> str | None:
    """What is wrong with what an item is said to be; None if it is fine."""
    if value is None or value == "" or (isinstance(value, str) and value in KINDS):
        return None
    return f"kind must be {' or '.join(KINDS)}, got {kind(value)}"


def missing_fault(fields: Sequence[str]) -> str:
    """ "weight/kg is missing", "id, weight/kg and sequence are missing"."""
    return f"{joined_names(fields)} {'is' if len(fields) == 1 else 'are'} missing"


def missing_anywhere(missing: Mapping[str, Sequence[int]], noun: str) -> str | None:
    """All that is missing in a plan, in one text; None: at most one of its placements misses anything.

    Args:
        missing: field → placements, as they are counted, that do not have it.
        noun: what is counted.
    """
    if len({index for indices in missing.values() for index in indices}) < 2:
        return None
    named = [
        f"{field} in {noun} {indices[0]}" + (f" and {len(indices) - 1:,} more" if len(indices) > 1 else "")
        for field, indices in missing.items()
    ]
    return f"fields are missing: {', '.join(named)}"


def too_many_boxes(n_boxes: int, most: int) -> str:
    """The message about a plan that is larger than the largest capacity."""
    return f"has {n_boxes} boxes, more than the largest capacity of {most}"


def kind(value: object) -> str:
    """A JSON value as messages show it: scalars as written, containers by name."""
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 200:
        return "an integer of more than 60 digits"
    if isinstance(value, str):
        value = value[:LONGEST_NAME]
    return shortened_text(json.dumps(value))


def joined_names(names: Sequence[str]) -> str:
    """ "x", "x and y", "x, y and z"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


class UnreadFields(Counter[str]):
    """Fields that stand in plans and that nobody reads: name → placements that have it."""

    def notes(self) -> list[str]:
        """One line that names them, if there are any."""
        if not self:
            return []
        named = [
            f"{printable_name(name)} ({count_text(number, 'placement')})"
            for name, number in self.most_common(_MOST_NAMED)
        ]
        if len(self) > _MOST_NAMED:
            named.append(f"{len(self) - _MOST_NAMED:,} more")
        return [f"fields of plans that petmjx does not read: {joined_names(named)}"]

    def add(self, names: Iterable[str], known: frozenset[str], prefix: str = "") -> None:
        """Count the names of one placement that are not known."""
        self.update(prefix + name for name in names if name not in known)
