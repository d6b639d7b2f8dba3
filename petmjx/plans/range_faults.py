"""Faults of sizes and coordinates that are too large or too small. A fault names the column."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.column_extraction import role_of
from petmjx.plans.column_names import LENGTH_UNITS
from petmjx.plans.input_conventions import Limits
from petmjx.plans.plan_fields import (
    FARTHEST_MM,
    LARGEST_MM,
    SMALLEST_MM,
    coordinate_fault,
    positive_fault,
)
from petmjx.plans.raw_cells import thousands_faults
from petmjx.plans.reading_candidates import Candidate
from petmjx.plans.readings import Reading, Wishes
from petmjx.plans.size_and_place_columns import Geometry


def far_cells(columns: BoxColumns, wishes: Wishes) -> dict[int, tuple[str, str]]:
    """Row → (column, error text), for sizes and coordinates that are too large in every unit that a reading may
    give them."""
    geometry, form = columns.geometries[0], columns.source.form
    faults: dict[int, tuple[str, str]] = {}
    for values, largest, names, named_unit in (
        (geometry.size, LARGEST_MM, _size_names(geometry, geometry.columns), geometry.size_unit),
        (geometry.place, FARTHEST_MM, _place_names(geometry.columns), geometry.place_unit),
    ):
        low, high, unit = limits_in(-largest, largest, named_unit or wishes.units or form.units or "mm")
        with np.errstate(invalid="ignore"):
            is_far = np.abs(values) > high
        for row, axis in np.argwhere(is_far).tolist():
            text = coordinate_fault(names[axis], float(values[row, axis]), low, high, unit)
            if text is not None:
                faults.setdefault(row, (names[axis], text.removeprefix(f"{names[axis]} ")))
    return faults


def first_bad_row(columns: BoxColumns, wishes: Wishes) -> tuple[int, str] | None:
    """The first row that is bad however the file is read, and its fault: a bad cell, or a size that is not positive.
    None if all rows are good."""
    weight = columns.columns.get("weight", "") if wishes.density_kg_m3 is not None else ""
    faults = {row: f"{name} {text}" for row, (name, text) in columns.faults.items() if name != weight}
    geometries = columns.geometries
    is_bad = np.array([~(geometry.size > 0).all(axis=1) for geometry in geometries]).all(axis=0)
    for row in np.flatnonzero(is_bad).tolist():
        axis = int(np.argmin(np.nan_to_num(geometries[0].size[row], nan=math.inf)))
        name = _size_names(geometries[0], geometries[0].columns)[axis]
        faults.setdefault(row, f"{name} must be > 0, got {geometries[0].size[row, axis]:g}")
    return min(faults.items(), default=None)


def range_faults(columns: BoxColumns, reading: Reading, candidate: Candidate) -> dict[int, str]:
    """Row → fault, for sizes and coordinates that are out of range. A fault names the column."""
    faults: dict[int, str] = {}
    boxes = columns.source.boxes
    sizes, places = reading.length_units
    named_sizes = _size_names(candidate.geometry, reading.columns)
    named_places = _place_names(reading.columns)
    for role, name in candidate.geometry.columns.items():
        are_sizes = role.removesuffix(" (far)") not in {*"xyz", "position"}
        cells = boxes.table.column(name) if name in boxes.table.header else ()
        unit = sizes if are_sizes else places
        for row, text in thousands_faults(cells, boxes.table.decimal, unit, are_sizes).items():
            faults.setdefault(row, f"{name} {text}")
    size_limits = limits_in(SMALLEST_MM, LARGEST_MM, sizes)
    place_limits = limits_in(-FARTHEST_MM, FARTHEST_MM, places)
    raw_size, raw_place = candidate.geometry.size, candidate.geometry.place
    smallest, largest, _ = size_limits
    low_place, high_place, _ = place_limits
    with np.errstate(invalid="ignore"):
        bad_sizes = (raw_size < smallest) | (raw_size > largest)
        far_places = (raw_place < low_place) | (raw_place > high_place)
    for row in np.flatnonzero(bad_sizes.any(axis=1) | far_places.any(axis=1)).tolist():
        for axis in range(3):
            fault = None
            if bad_sizes[row, axis]:
                fault = positive_fault(named_sizes[axis], float(raw_size[row, axis]), *size_limits)
            elif far_places[row, axis]:
                fault = coordinate_fault(named_places[axis], float(raw_place[row, axis]), *place_limits)
            if fault is not None:
                faults.setdefault(row, fault)
    return faults


def _size_names(geometry: Geometry, columns: Mapping[str, str]) -> list[str]:
    """The names of the columns of the three sizes.

    Args:
        columns: role → name of its column.
    """
    roles = [(role_of(axis), "sizes", f"{axis} (far)") for axis in geometry.axes]
    return [next(filter(None, map(columns.get, names)), names[0]) for names in roles]


def _place_names(columns: Mapping[str, str]) -> list[str]:
    """The names of the columns of the three coordinates."""
    return [columns.get(axis, columns.get("position", axis)) for axis in "xyz"]


_UNIT_NAMES: Final = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches", "kg": "kilograms"}


def limits_in(low: float, high: float, unit: str, units: Mapping[str, float] = LENGTH_UNITS) -> Limits:
    factor = units[unit]
    return Limits(low / factor, high / factor, _UNIT_NAMES.get(unit, unit))
