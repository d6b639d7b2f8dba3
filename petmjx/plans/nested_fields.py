"""The fields of a box in nested values (``flattened``), named by their path, as in ``position.x``, ``stackable.dx`` and
``WHD[0]``. The module also makes objects with fields from values that are stored by column or as lists of numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.column_names import known_meanings, word_set, words_of

_LISTED: Final = 16
"""A list with at most this number of members becomes separate fields. So the 16 numbers of a 4×4 matrix become separate
fields."""
_LEAST_COLUMNS: Final = 5


def rows_by_column(value: Mapping[str, Any]) -> list[dict[str, Any]] | None:
    """The rows of an object that stores a table. An object may have one of three forms. It may have a list for each
    column. It may have an object for each column, with one value per row. Or one field has the names of all columns,
    and another field has a list of values for each row (such as ``columns`` and ``data`` of pandas). The result is None
    if the object has another form.

    Raises:
        InputError: one of the lists for sizes and places has one value more or fewer than the others.
    """
    names = _names_in(value)
    for data in value.values() if names else ():
        rows = list(data.values()) if isinstance(data, Mapping) else data
        if isinstance(rows, list) and rows and all(isinstance(row, list) and len(row) == len(names) for row in rows):
            by_name = [dict(zip(names, row, strict=True)) for row in rows]
            has_ids = isinstance(data, Mapping)
            return [{"id": key, **row} for key, row in zip(data, by_name, strict=True)] if has_ids else by_name
    if len(value) >= _LEAST_COLUMNS and all(isinstance(inner, Mapping) and inner for inner in value.values()):
        keys = max((inner.keys() for inner in value.values()), key=len)
        alike = all(inner.keys() <= keys for inner in value.values())
        if alike and len(known_meanings(value)) >= _LEAST_COLUMNS:
            return [{name: inner.get(key) for name, inner in value.items()} for key in keys]
        return None
    lists = {name: list(inner) for name, inner in value.items() if isinstance(inner, list | tuple | np.ndarray)}
    lengths = {len(inner) for inner in lists.values()}
    if len(lists) >= LEAST_NUMBERS:
        _check_lengths(lists)
    if len(lengths) != 1 or 0 in lengths or any(isinstance(inner[0], Mapping) for inner in lists.values()):
        return None
    if len(known_meanings(lists)) < 2:
        return None
    flat = sum(3 if isinstance(inner[0], list | tuple) else 1 for inner in lists.values())
    if flat < _LEAST_COLUMNS:
        return None
    return [{name: inner[index] for name, inner in lists.items()} for index in range(lengths.pop())]


def _check_lengths(lists: Mapping[str, Sequence[Any]]) -> None:
    """Refuse lists for the sizes and places of boxes if exactly one of them has one value more or fewer than the
    others."""
    known = [name for name, meaning in known_meanings(lists).items() if meaning.kind in ("size", "position")]
    counts = Counter(len(lists[name]) for name in known)
    if len(known) < LEAST_NUMBERS or len(counts) != 2:
        return
    (usual, n_usual), (odd, n_odd) = counts.most_common()
    if n_odd == 1 < n_usual and abs(odd - usual) == 1 and min(odd, usual) > 1:
        name = next(name for name in known if len(lists[name]) == odd)
        raise InputError(f"{printable_name(name)} has {count_text(odd, 'value')}, but other lists have {usual}")


def _names_in(value: Mapping[str, Any]) -> list[str]:
    """The names of columns that an object lists; empty if it lists none."""
    for field in ("columns", "fields", "header", "headers", "names", "keys"):
        names = value.get(field)
        if isinstance(names, list) and len(names) >= _LEAST_COLUMNS and all(isinstance(name, str) for name in names):
            return names
    return []


LEAST_NUMBERS: Final = 6


def rows_of_numbers(value: Sequence[Any]) -> list[dict[str, Any]] | None:
    """One row for each box in a list of lists. Each inner list has the numbers of a box (sizes, coordinates and
    others), or is a matrix. The result is None if the list has another form."""
    if not value or not all(isinstance(row, list | tuple) for row in value):
        return None
    first = value[0]
    if len(first) in (3, 4) and all(isinstance(inner, list | tuple) and len(inner) == 4 for inner in first):
        return [{"matrix": row} for row in value]
    widths = {len(row) for row in value}
    if len(first) < LEAST_NUMBERS or len(first) > 64 or len(widths) > 2:
        return None
    numeric = sum(cell_number(cell) is not None for row in value[:50] for cell in row)
    if numeric < 0.8 * sum(len(row) for row in value[:50]):
        return None
    return [{f"column {number}": cell for number, cell in enumerate(row, start=1)} for row in value]


def flattened(value: Mapping[str, Any], prefix: str = "", depth: int = 0) -> dict[str, Any]:
    """Path → value, for all values inside an object. In a path, "." leads into an object, and "[0]" into a short list
    of numbers. Longer lists are left out."""
    flat: dict[str, Any] = {}
    for name, inner in value.items():
        path = prefix[:-1] if name in _VALUES and prefix.endswith(".") else f"{prefix}{name}"
        if isinstance(inner, np.ndarray):
            inner = inner.tolist()
        if isinstance(inner, Mapping) and (quantity := _quantity(inner)) is not None:
            flat[path] = quantity
        elif isinstance(inner, Mapping) and str(name).lower() in _UNITS and isinstance(inner.get("Code"), str):
            flat[path] = inner["Code"]
        elif isinstance(inner, Mapping):
            if depth < 4:
                flat |= flattened(inner, f"{path}.", depth + 1)
        elif isinstance(inner, list | tuple):
            if _is_matrix(inner):
                flat[path] = inner
            elif len(inner) == 1 and isinstance(inner[0], Mapping) and _SHAPES.intersection(words_of(str(name))):
                if depth < 4:
                    flat |= flattened(inner[0], f"{path}[0].", depth + 1)
            elif (ends := _two_corners(str(name), inner)) is not None:
                for end, point in zip(("min", "max"), ends, strict=True):
                    flat |= {f"{path}.{end}[{axis}]": value for axis, value in enumerate(point)}
            elif len(inner) in _PARTS_OF_POSES and str(name).lower() in ("pose", "qpos"):
                flat |= _parts_of_pose(path, inner)
            elif 0 < len(inner) <= _LISTED and not any(isinstance(cell, Mapping | list | tuple) for cell in inner):
                flat |= {f"{path}[{index}]": cell for index, cell in enumerate(inner)}
        elif isinstance(inner, str) and path.rpartition(".")[2].lower() == "pose":
            numbers = inner.split()
            flat |= _parts_of_pose(path, numbers) if len(numbers) in _PARTS_OF_POSES else {path: inner}
        else:
            flat[path] = inner
    return flat


_TWO_CORNERS: Final = word_set("bbox aabb bounds corners")
"""Words in names of lists with the two corners of a box, [[0, 0, 0], [400, 300, 200]]."""


def _two_corners(name: str, value: Sequence[Any]) -> Sequence[Sequence[Any]] | None:
    """The two corners of a box in a list of two or eight points; None for other lists."""
    if len(value) not in (2, 8) or not all(isinstance(point, list | tuple) and len(point) == 3 for point in value):
        return None
    if len(value) == 8:
        return _ends_of_vertices(value)
    return value if _TWO_CORNERS.intersection(words_of(name)) else None


_SHAPES: Final = word_set(
    "primitive primitives pose poses shape shapes geometry geometries geom geoms collision collisions transform "
    "transforms"
)
"""Words in names of lists that describe the shapes and poses of one object, and not several boxes."""


_PARTS_OF_POSES: Final = {
    4: ("x", "y", "z", "yaw"),
    6: ("x", "y", "z", "rx", "ry", "rz"),
    7: ("x", "y", "z", *(f"quaternion[{index}]" for index in range(4))),
}
"""Length of a list called "pose" → meanings of the numbers in such a list."""


def _parts_of_pose(path: str, numbers: Sequence[Any]) -> dict[str, Any]:
    parts = _PARTS_OF_POSES[len(numbers)]
    return {f"{path}.{part}": cell for part, cell in zip(parts, numbers, strict=True)}


_VALUES: Final = ("value", "amount", "magnitude")
_UNITS: Final = frozenset(
    (
        "unit",
        "units",
        "uom",
        "unitofmeasurement",
        "unitofmeasure",
        "einheit",
        "unite",
        "unité",
        "unidad",
        "unita",
        "unità",
        "jednostka",
    )
)
"""Names of the fields in objects such as {"value": 400, "unit": "mm"}. ``_VALUES`` are names of the field with the
number, ``_UNITS`` are names of the field with the unit."""


def _quantity(value: Mapping[str, Any]) -> Any:
    """The text of a number with a unit, from an object such as {"value": "400", "unit": "mm"}; None for other
    objects."""
    name = next((name for name in _VALUES if name in value), None)
    unit = next((unit for key, unit in value.items() if key.lower() in _UNITS and isinstance(unit, str)), None)
    if name is not None and unit is not None and len(value) <= 4:
        return f"{value[name]} {unit}"
    if set(value) == {"ticks"}:
        return f"{value['ticks']} ticks"
    return None


CORNER_NOISE: Final = 0.01
"""Largest error of the corners of a box, as a share of the box's smallest side. Corners have errors because a camera
has measured them, or because numbers are rounded."""


def _ends_of_vertices(value: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """The smallest and the largest coordinates of the eight corners of a box, [[x, y, z], …]. If the points are not the
    corners of a level box, one coordinate in the result is replaced by an error text."""
    ends: tuple[list[Any], list[Any]] = ([], [])
    columns = [*zip(*value, strict=True)]
    sorted_numbers = [
        sorted(number.value for cell in some if (number := cell_number(cell)) is not None) for some in columns
    ]
    sides = [median(some[4:]) - median(some[:4]) for some in sorted_numbers if len(some) == 8]
    noise = CORNER_NOISE * min(sides, default=0.0)
    for column, numbers in zip(columns, sorted_numbers, strict=True):
        odd = [cell for cell in column if cell_number(cell) is None]
        low, high = (0.0, 0.0) if odd else (median(numbers[:4]), median(numbers[4:]))
        if not odd and max(numbers[3] - numbers[0], numbers[7] - numbers[4]) > noise:
            odd = [f"{column[0]}, …, which are not the corners of a level box"]
        ends[0].append(odd[0] if odd else low)
        ends[1].append(high if not odd else max(numbers, default=None))
    return ends


def _is_matrix(value: Sequence[Any]) -> bool:
    """Whether a list is a matrix of at least 3×3 numbers, or a list of the 16 numbers of a 4×4 matrix."""
    if len(value) == 16:
        return not any(isinstance(cell, Mapping | list | tuple) for cell in value)
    return len(value) in (3, 4) and all(isinstance(row, list | tuple) and len(row) in (3, 4) for row in value)
