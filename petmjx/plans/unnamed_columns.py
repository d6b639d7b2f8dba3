"""Columns without names: which of them have sizes, places, rotations and weights, by their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.plans.column_extraction import XYZ, ColumnExtraction, role_of
from petmjx.plans.column_names import LENGTH_UNITS
from petmjx.plans.size_and_place_columns import Geometry
from petmjx.plans.turn_columns import Turns

_DENSEST: Final = 1.5
"""A column without a name has densities only if they are at most this, relative to water. Cartons are less dense."""
_MOST_SOUND: Final = 0.9
"""In a table without a header, at least this share of the rows must match the guessed meaning of a column. Rows that do
not match have bad cells."""


def array_choices(extraction: ColumnExtraction) -> list[Geometry]:
    """Geometries of columns without names. The first columns may hold sizes or places, or the columns may hold two
    corners of each box."""
    header, width = extraction.table.header, len(extraction.table.header)
    starts = [start for start in (0, 1) if width >= start + 6]
    geometries = []
    for start in starts:
        names = header[start : start + 6]
        values = np.stack([extraction.numbers_or_median(start + offset) for offset in range(6)], axis=1)
        first, second = values[:, :3], values[:, 3:]
        prior = 0.8 * start
        is_size = [_mostly(np.asarray((part > 0).all(axis=1))) for part in (first, second)]
        are_ends = _mostly(np.asarray((second > first).all(axis=1)))
        listed = tuple(map(role_of, "012"))
        columns = dict(zip((*listed, *XYZ), names, strict=True))
        if is_size[0]:
            geometries.append(Geometry(first, second, ("0", "1", "2"), columns=columns, prior=prior))
        if is_size[1]:
            swapped = dict(zip((*XYZ, *listed), names, strict=True))
            geometries.append(Geometry(second, first, ("0", "1", "2"), columns=swapped, prior=prior + 0.4))
        if are_ends:
            ends = dict(zip((*XYZ, *(f"{axis} (far)" for axis in XYZ)), names, strict=True))
            corners = Geometry(second - first, first, XYZ, "", "", "corner", True, ends, prior + 0.2)
            geometries.append(corners)
    for name in geometries[0].columns.values() if geometries else ():
        extraction.numbers(header.index(name), LENGTH_UNITS)  # called only to report bad cells under the column's name
    return geometries


def array_extras(extraction: ColumnExtraction, geometries: Sequence[Geometry]) -> tuple[Turns | None, int | None, bool]:
    """Interpret the further columns without names. Returns rotations, the column of weights, and whether the
    weights are densities.

    A column of whole numbers from 0 to 5 holds rotations. A column of numbers up to ``_DENSEST`` holds densities
    relative to water. A column of larger numbers holds weights.
    """
    header = extraction.table.header
    used = {header.index(name) for name in geometries[0].columns.values()} if geometries else set()
    turns, weight, is_density = None, None, False
    for index in range(max(used, default=-1) + 1, len(header)):
        values = extraction.numbers_or_median(index)
        is_integer = bool((values == np.rint(values)).all())
        if is_integer and values.min() >= 0 and values.max() <= 5:
            if values.max() > 0 and turns is None:
                rules = ("swap", "py3dbp") if values.max() <= 1 else ("py3dbp",)
                turns = Turns(header[index], rules, values.astype(np.int64))
        elif weight is None and _mostly(values > 0):
            weight, is_density = index, bool(values.max() <= _DENSEST)
    return turns, weight, is_density


def _mostly(rows: NDArray[np.bool_]) -> bool:
    sound = int(np.count_nonzero(rows))
    return sound >= _MOST_SOUND * len(rows) or sound >= len(rows) - 1 > 1
