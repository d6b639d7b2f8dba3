"""Finds the columns of a table that may hold the sizes and places of boxes (``Geometry``): by their names, or, if they
have no names, by their numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.column_extraction import HALF_EXTENTS, LAST_CELLS, SIZE_WORDS, XYZ, ColumnExtraction, role_of
from petmjx.plans.column_names import (
    ALL_SIZE_WORDS,
    BASE_WORDS,
    CENTRE_WORDS,
    HALF_WORDS,
    LENGTH_UNITS,
    split_unit,
    unit_in,
    word_set,
    words_of,
)
from petmjx.plans.nested_fields import CORNER_NOISE
from petmjx.plans.plausibility import density_cost, side_cost
from petmjx.plans.turn_columns import Turns

AXIS_OF_WORD: Final = {"0": "x", "1": "y", "2": "z", "length": "x", "width": "y", "height": "z", "depth": "z"}
_BY_WIDTH: Final = {"width": "x", "depth": "y", "height": "z"}
"""A column of coordinates may be named by a word for a size, such as "pos_width". Word → axis of the coordinates, for
files that have columns of coordinates for width, depth and height."""


def _on_axes(columns: Mapping[str, list[int]]) -> dict[str, list[int]]:
    """x, y and z → the columns with coordinates along this axis. ``columns`` has the same columns, but with the words
    that names of columns use for axes (``ColumnMeaning.axis``), such as "width"."""
    words = _BY_WIDTH if _BY_WIDTH.keys() <= columns.keys() else AXIS_OF_WORD
    by_axis: dict[str, list[int]] = {}
    for axis, indices in columns.items():
        by_axis.setdefault(words.get(axis, AXIS_OF_WORD.get(axis, axis)), []).extend(indices)
    return by_axis


_SIZE_SETS: Final = (
    ("length", "width", "height"), ("width", "height", "depth"), ("length", "width", "depth"),
    ("length", "height", "depth"), XYZ, ("0", "1", "2"),
)  # fmt: skip
_GOALS: Final = word_set("to bis top")
"""Words in names of columns that mark the end of a range, such as "to" in "x to". If there are also columns of near
corners ("from"), a column with one of these words has the far corners. If there are no columns of near corners, the
column may have any point of the box."""
_FAR_SIDES: Final = word_set("right back rear far rechts hinten droite arriere derecha destra")
"""Words for the sides of a box that are far from the origin. "back_right_top" is the far corner, whereas "top" alone
may be any point of the top."""
_NOT_PLACES: Final = tuple(map(word_set, ("offset offsets", "pick picked grasp source from")))
"""Words for offsets, which are relative to the box, and words for the places from which a robot takes boxes. A column
with such a word in its name does not hold the places of boxes if other columns do."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """Sizes and places of boxes in the file's units, for one choice of columns.

    Attributes:
        size: (n, 3) sizes in the order of ``axes``; NaN if a cell is bad.
        place: (n, 3) coordinates along the file's first, second and third axis; NaN if a cell is bad.
        axes: names of the axes of the sizes: words, or x, y, z, or "0", "1", "2" if they have no names.
        size_unit, place_unit: unit according to names or cells; "": none is given.
        anchor: the point of a box according to the names; "": none is given.
        placed: whether the sizes are known to be given for the box as placed.
        columns: role → name of its column.
        prior: how unlikely this choice of columns is, before any numbers are considered; 0: usual.
        turn: (n, 3, 3) rotation matrices of poses, whose numbers are −1, 0 and 1; None: no poses.
        named_up: the vertical axis according to the names of places; "": none is given.
        faults: row → (column, error text) of bad cells that matter only if this choice of columns is the right one.
    """

    size: FloatArray
    place: FloatArray
    axes: tuple[str, str, str]
    size_unit: str = ""
    place_unit: str = ""
    anchor: str = ""
    placed: bool = False
    columns: Mapping[str, str] = field(default_factory=dict)
    prior: float = 0.0
    turn: FloatArray | None = None
    named_up: str = ""
    faults: Mapping[int, tuple[str, str]] = field(default_factory=dict)

    @cached_property
    def is_positive(self) -> NDArray[np.bool_]:
        """(n,) for each box, whether it has three positive sizes and all coordinates of the place."""
        return np.asarray((self.size > 0).all(axis=1) & ~np.isnan(self.place).any(axis=1))


class Sizes(NamedTuple):
    """The sizes of boxes, and their columns. The fields mean the same as in :class:`Geometry`, where
    ``unit`` is called ``size_unit``. ``anchor`` is the point of a box that places describe according to the sizes: the
    centre if sizes are half sizes; "": none is given."""

    size: FloatArray
    axes: tuple[str, str, str]
    unit: str
    placed: bool
    columns: dict[str, str]
    anchor: str = ""
    faults: Mapping[int, tuple[str, str]] = {}


class Places(NamedTuple):
    """The places of boxes, and their columns. The fields mean the same as in :class:`Geometry`, where
    ``unit`` is called ``place_unit``."""

    place: FloatArray
    unit: str
    anchor: str
    columns: dict[str, str]
    named_up: str = ""


def sizes_in(extraction: ColumnExtraction) -> Sizes | None:
    """The sizes of the boxes; None if there are no columns with sizes. If there are several sets of columns with sizes,
    sizes of placed boxes are preferred to sizes of items."""
    header, fixed = extraction.table.header, extraction.fixed
    if "sizes" in fixed:
        values, unit = extraction.triples(fixed["sizes"])
        return Sizes(values, ("0", "1", "2"), unit, False, {"sizes": header[fixed["sizes"]]})
    return next(_all_sizes(extraction), None)


def other_sizes_in(extraction: ColumnExtraction, first: Sizes) -> list[Sizes]:
    """The further sets of sizes, such as those of a carton beside those of the product in it, or "sp_size_1" … beside
    "size_1" …, if no name shows which set has the sizes of the placed boxes. A set is left out if one of its columns is
    in an earlier set, if more than a few of its cells are bad, or if its sizes equal those of an earlier set. The bad
    cells of a set matter only if the set is chosen, so their faults are stored in ``Sizes.faults``."""
    if first.placed or any(role_of(axis) in extraction.fixed for axis in first.axes) or "sizes" in extraction.fixed:
        return []
    faults = dict(extraction.faults)
    sets = [first]
    used = {*first.columns.values()}
    for sizes in _all_sizes(extraction, used):
        further_faults = {row: fault for row, fault in extraction.faults.items() if row not in faults}
        extraction.faults = dict(faults)
        if _mostly(np.asarray((sizes.size > 0).all(axis=1))) and not any(_are_equal(sizes, other) for other in sets):
            sets.append(sizes._replace(faults=further_faults))
            used |= {*sizes.columns.values()}
    return sets[1:]


_ROUNDED: Final = 0.05
"""If a file gives each size in two units, the two values differ by at most this share, because they are rounded."""


def _are_equal(one: Sizes, other: Sizes) -> bool:
    if one.unit == other.unit or not (one.unit and other.unit):
        return np.array_equal(one.size, other.size)
    return np.allclose(
        one.size * LENGTH_UNITS[one.unit], other.size * LENGTH_UNITS[other.unit], rtol=_ROUNDED, equal_nan=True
    )


def _all_sizes(extraction: ColumnExtraction, used: Collection[str] = ()) -> Iterator[Sizes]:
    """Yield the sizes of each set of three columns, then those of each column with three sizes per cell. Sets with a
    column in ``used`` are left out. ``used`` may change between two sets."""
    header = extraction.table.header
    for columns, axes, placed in _columns_of_sizes(extraction):
        if not any(header[index] in used for index in columns):
            yield _sizes_of(extraction, columns, axes, placed)
    for index, meaning in extraction.named("sizes"):
        if header[index] not in used:
            values, unit = extraction.triples(index)
            first, second, third = meaning.order if len(meaning.order) == 3 else ("0", "1", "2")
            factor, anchor = (2.0, "centre") if meaning.half else (1.0, "")
            names = {"sizes": header[index]}
            yield Sizes(values * factor, (first, second, third), unit, meaning.placed, names, anchor)


def _sizes_of(extraction: ColumnExtraction, columns: Sequence[int], axes: tuple[str, str, str], placed: bool) -> Sizes:
    """The sizes in three columns."""
    values, unit = extraction.joined(columns)
    is_half = any((meaning := extraction.meanings[index]) is not None and meaning.half for index in columns)
    names = {role_of(axis): extraction.table.header[index] for axis, index in zip(axes, columns, strict=True)}
    return Sizes(values * (2.0 if is_half else 1.0), axes, unit, placed, names, "centre" if is_half else "")


def _columns_of_sizes(extraction: ColumnExtraction) -> Iterator[tuple[tuple[int, ...], tuple[str, str, str], bool]]:
    """Yield (columns, their axes, whether their names say that they have the sizes of placed boxes) for each set of
    three columns with sizes. Sizes of placed boxes come first."""
    header, fixed = extraction.table.header, extraction.fixed
    chosen = {axis: fixed[role_of(axis)] for axis in (*SIZE_WORDS, *XYZ) if role_of(axis) in fixed}
    by_axis = extraction.columns_of("size") | {axis: [index] for axis, index in chosen.items()}
    placed_columns = {
        index for index, meaning in enumerate(extraction.meanings) if meaning is not None and meaning.placed
    }
    for placed in (True, False):
        for axes in _SIZE_SETS:
            picked = [
                [index for index in by_axis.get(axis, ()) if axis in chosen or (index in placed_columns) == placed]
                for axis in axes
            ]
            if all(picked):
                for columns in _sets_of_columns(header, picked):
                    yield columns, axes, placed


def _sets_of_columns(header: Sequence[str], picked: Sequence[Sequence[int]]) -> list[tuple[int, ...]]:
    """Each set of three columns with sizes, from the columns of each size. Columns belong to the same set if their
    names have the same words beside the words for sizes ("product_length" and "product_width"). If no three columns
    have the same words, but all sizes have equally many columns, the first column of each size form a set, the second
    column of each size form another set, and so on."""
    in_order = list(zip(*picked, strict=True)) if len({*map(len, picked)}) == 1 else []
    return _alike(header, picked, _words_beside_size) or in_order or _same_stems(header, picked)


def _same_stems(header: Sequence[str], picked: Sequence[Sequence[int]]) -> list[tuple[int, ...]]:
    """Each set of three columns that belong to the same object, such as ``dimensions.length``, ``dimensions.width`` and
    ``dimensions.height``. If no three columns belong to the same object, the first column of each size."""
    return _alike(header, picked, _stem) or [tuple(columns[0] for columns in picked)]


def _alike(
    header: Sequence[str], picked: Sequence[Sequence[int]], common_part: Callable[[str], Hashable]
) -> list[tuple[int, ...]]:
    """Each set of three columns whose names have the same common part."""
    sets: dict[Hashable, dict[int, int]] = {}
    for number, columns in enumerate(picked):
        for index in columns:
            sets.setdefault(common_part(header[index]), {}).setdefault(number, index)
    return [tuple(columns.values()) for columns in sets.values() if len(columns) == len(picked)]


def _words_beside_size(name: str) -> tuple[str, ...]:
    """What the names of the columns of a set have in common: the part before the last dot, and the words after it,
    without units, numbers, and words for sizes and axes. "case_length [mm]" gives "" and "case"."""
    base = split_unit(name)[0]
    words = (word for word in words_of(base.rpartition(".")[2]) if word not in ALL_SIZE_WORDS and not word.isdecimal())
    return (base.rpartition(".")[0], *(word.rstrip("xyz") for word in words))


def _stem(name: str) -> str:
    """The part of a column's name that the columns of one object have in common. It is the name without a digit at its
    end ("sp_size_1" → "sp_size_"), or else the part before the last dot ("dimensions.length" → "dimensions")."""
    path, dot, last = name.rpartition(".")
    return f"{path}{dot}{last[:-1]}" if last[-1:].isdigit() else path


def places_in(extraction: ColumnExtraction) -> Places | None:
    """The places of the boxes, from the columns that most certainly have them; None if there are no such columns."""
    header, fixed = extraction.table.header, extraction.fixed
    if "position" in fixed:
        values, unit = extraction.triples(fixed["position"])
        return Places(values, unit, "", {"position": header[fixed["position"]]})
    if all(axis in fixed for axis in XYZ):
        return _places_of(extraction, [fixed[axis] for axis in XYZ], "")
    still = _still_columns(extraction)
    by_anchor: dict[str, dict[str, list[int]]] = {}
    for index, meaning in extraction.named("position", "low"):
        if index not in still:
            anchor = meaning.anchor or ("corner" if meaning.kind == "low" else "")
            by_anchor.setdefault(anchor, {}).setdefault(meaning.axis, []).append(index)
    by_anchor = {anchor: _on_axes(columns) for anchor, columns in by_anchor.items()}
    bottoms = [
        index for index in by_anchor.get("", {}).get("z", ()) if BASE_WORDS.intersection(words_of(header[index]))
    ]
    tops = _on_axes(extraction.columns_of("high")).get("z", [])
    for level, anchor, heights in (  # "center_x", "center_y" and "bottom_z"
        ("centre", "base-centre", bottoms),
        ("base-centre", "base-centre", bottoms),
        ("centre", "top-centre", tops),
        ("corner", "corner-z", tops),
    ):
        if heights and by_anchor.get(level, {}).keys() == {"x", "y"}:
            by_anchor[anchor] = {**by_anchor.pop(level), "z": heights}
    by_name: dict[str, Places] = {}
    for anchor, by_axis in sorted(by_anchor.items(), key=lambda entry: entry[0] == ""):
        by_axis |= {axis: [fixed[axis]] for axis in XYZ if axis in fixed}
        if all(axis in by_axis for axis in XYZ):
            indices = _same_stems(header, _columns_of_places(header, [by_axis[axis] for axis in XYZ]))[0]
            words = {known.axis for index in indices if (known := extraction.meanings[index]) is not None}
            by_name[anchor] = _places_of(extraction, indices, anchor)._replace(
                named_up="z" if "height" in words else ""
            )
    if {"", "centre"} <= by_name.keys() and not (by_name["centre"].place <= by_name[""].place).any():
        # columns with corners are preferred, since centres may be rounded (17.5 to 18)
        return by_name[""]._replace(anchor="corner")
    if by_name:
        return next(iter(by_name.values()))
    for index, meaning in extraction.named("positions", of_container=True):
        values, unit = extraction.triples(index)
        return Places(values, unit, meaning.anchor, {"position": header[index]})
    # the file may have the far corners and the sizes, but no near corners
    far = {axis: columns[0] for axis, columns in _on_axes(extraction.columns_of("high")).items()}
    if not all(axis in far for axis in XYZ):
        return None
    words = {word for axis in XYZ for word in words_of(header[far[axis]])}
    is_goal = bool(words & _GOALS) and not words & _FAR_SIDES
    anchor = "top-centre" if words & CENTRE_WORDS else "" if is_goal else "far-corner"
    return _places_of(extraction, [far[axis] for axis in XYZ], anchor)


def _still_columns(extraction: ColumnExtraction) -> set[int]:
    """Columns that seem to have places, but not the places of boxes: their cells are equal in nearly all rows, while
    the cells of other columns of places vary. Such columns describe something that all boxes have, such as the centre
    of a collider ("collider.center.x")."""
    header = extraction.table.header
    varying: dict[str, bool] = {}
    columns: dict[str, list[int]] = {}
    for index in extraction.indices("position", "low"):
        prefix = header[index].rpartition(".")[0]
        cells = extraction.cells(index)
        columns.setdefault(prefix, []).append(index)
        most = max(map(cells.count, cells[:_COMPARED]), default=0)
        varying[prefix] = varying.get(prefix, False) or most < _STILL * len(cells)
    if not any(varying.values()):
        return set()
    return {index for prefix, indices in columns.items() if prefix and not varying[prefix] for index in indices}


_STILL: Final = 0.9
"""If at least this share of the cells of a column of places are equal, the places count as not varying. The share is
below 1, since a cell may be damaged."""
_COMPARED: Final = 3
"""Number of cells at the beginning of a column that are compared with all cells of the column."""


def _places_of(extraction: ColumnExtraction, indices: Sequence[int], anchor: str) -> Places:
    """The places from three columns, for x, y and z."""
    values, unit = extraction.joined(indices)
    header = extraction.table.header
    return Places(values, unit, anchor, {axis: header[index] for axis, index in zip(XYZ, indices, strict=True)})


def corners_in(extraction: ColumnExtraction) -> Geometry | None:
    """Sizes and places from two corners of each box: the corner with the smallest and the corner with the largest
    coordinates. The result is None if there are no such columns."""
    header = extraction.table.header
    if (eight := _eight_corners(extraction)) is not None:
        return eight
    low, plain, high = (
        {axis: columns[0] for axis, columns in _on_axes(extraction.columns_of(kind)).items()}
        for kind in ("low", "position", "high")
    )
    high = high or _lists_beyond(extraction, low or plain)
    for begin, finish in ((low, high), (plain, high)):
        if not all(axis in begin and axis in finish for axis in XYZ):
            continue
        lows, highs = [begin[axis] for axis in XYZ], [finish[axis] for axis in XYZ]
        corner, unit = extraction.joined(lows)
        far_corner, far_unit = extraction.joined(highs)
        if unit != far_unit:
            corner, far_corner = (
                values * LENGTH_UNITS.get(name, 1.0) for values, name in ((corner, unit), (far_corner, far_unit))
            )
            unit = "mm"
        columns = {axis: header[index] for axis, index in zip(XYZ, lows, strict=True)}
        columns |= {f"{axis} (far)": header[index] for axis, index in zip(XYZ, highs, strict=True)}
        return _between(extraction, corner, far_corner, unit, highs, [header[index] for index in lows], columns)
    for index in extraction.indices("corners", of_container=True):
        both, unit = extraction.corners(index)
        near = ["its near corner"] * 3
        return _between(extraction, both[:, :3], both[:, 3:], unit, [index] * 3, near, {"corners": header[index]})
    return None


def _lists_beyond(extraction: ColumnExtraction, near: Mapping[str, int]) -> dict[str, int]:
    """x, y and z → the columns of a list of three numbers whose meaning is unknown, and which may be far corners. The
    result is empty unless there is exactly one such list, and its numbers are beyond the near corners of nearly all
    boxes.

    Args:
        near: x, y and z → the columns of the near corners.
    """
    stems: dict[str, dict[str, int]] = {}
    for index, meaning in enumerate(extraction.meanings):
        stem, _, number = extraction.table.header[index].rpartition("[")
        if meaning is None and number in ("0]", "1]", "2]"):
            stems.setdefault(stem, {})[XYZ[int(number[0])]] = index
    lists = [columns for columns in stems.values() if len(columns) == 3]
    if len(lists) != 1 or near.keys() < {*XYZ}:
        return {}
    begin, end = (
        np.array([extraction.numbers_or_median(columns[axis]) for axis in XYZ]) for columns in (near, lists[0])
    )
    # numbers that are the same for all boxes may be a colour
    is_beyond = _mostly(np.asarray((end > begin).all(axis=0))) and np.ptp(end, axis=1).any()
    return lists[0] if is_beyond else {}


_CORNER_NAME: Final = re.compile(r"([xyz])(?:[\s_.-]?([1-8])|\[([0-7])\])", re.IGNORECASE)
"""A coordinate of one of the eight corners of a box: "x1" … "z8", or "x[0]" … "z[7]"."""


def _eight_corners(extraction: ColumnExtraction) -> Geometry | None:
    """Sizes and places from the eight corners of each box, in columns "x1", "y1", "z1" … "z8" or "x[0]" … "z[7]" in any
    order; None if there are no such columns."""
    header = extraction.table.header
    names = {
        f"{match[1].lower()}{int(match[2] or 1 + int(match[3]))}": index
        for index, name in enumerate(header)
        if (match := _CORNER_NAME.fullmatch(split_unit(name)[0].strip())) is not None
    }
    if len(names) < 24:
        return None
    parts = [[extraction.numbers(names[f"{axis}{corner}"], LENGTH_UNITS)[0] for corner in range(1, 9)] for axis in XYZ]
    corners = np.sort(parts, axis=1)  # (3, 8, n)
    low, high = np.median(corners[:, :4], axis=1).T, np.median(corners[:, 4:], axis=1).T
    noise = CORNER_NOISE * (high - low).min(axis=1)
    corners = np.array(parts)
    ends = np.minimum(abs(corners - low.T[:, None]), abs(corners - high.T[:, None])) <= noise
    ends |= np.isnan(corners)
    for row in np.flatnonzero(~ends.all(axis=(0, 1))).tolist():
        axis, corner = np.argwhere(~ends[:, :, row])[0].tolist()
        index = names[f"{XYZ[axis]}{corner + 1}"]
        extraction.bad(row, index, f"must be {low[row, axis]:g} or {high[row, axis]:g}, like the other corners")
    columns = {axis: header[names[f"{axis}1"]] for axis in XYZ}
    columns |= {f"{axis} (far)": header[names[f"{axis}8"]] for axis in XYZ}
    columns |= {
        f"{axis} of corner {number}": header[names[f"{axis}{number}"]] for number in range(2, 8) for axis in XYZ
    }
    lows, highs = [columns[axis] for axis in XYZ], [names[f"{axis}8"] for axis in XYZ]
    return _between(extraction, low, high, unit_in(columns["x"]), highs, lows, columns)


def _between(
    extraction: ColumnExtraction,
    corner: FloatArray,
    far_corner: FloatArray,
    unit: str,
    highs: Sequence[int],
    lows: Sequence[str],
    columns: Mapping[str, str],
) -> Geometry:
    """Sizes and places from (n, 3) near and far corners. If all coordinates are whole numbers, a size of 0 is no error:
    the corners may be cells of a grid, and the box one cell thick (``with_last_cells``).

    Args:
        highs: indices of the columns of the far corners.
        lows: for each axis, the name of the coordinate that the far corner must exceed, for messages.
    """
    size = far_corner - corner
    is_short = size < 0 if _are_whole(corner, far_corner) else size <= 0
    for row in np.flatnonzero(is_short.any(axis=1)):
        axis = int(np.flatnonzero(is_short[row])[0])
        extraction.bad(int(row), highs[axis], f"must be beyond {lows[axis]}, got {far_corner[row, axis]:g}")
        size[row] = np.nan
    return Geometry(size, corner, XYZ, unit, unit, "corner", True, columns)


_EXTENTS: Final = word_set("extent extents")
"""Words that mean sizes in most files, but half sizes in the files of some programs (Unreal, Unity)."""


def with_half_extents(geometry: Geometry, chosen: str = "") -> Geometry | None:
    """The geometry with its sizes read as half extents. This is possible if the name of a column of sizes has the word
    "extent", which may mean half an extent, or is the name that the user has chosen. Otherwise, the result is None. It
    is also None if a name says "half" (the sizes are then known to be half extents), or if the places are corners."""
    names = [name for role, name in geometry.columns.items() if role not in (*XYZ, "position")]
    words = {word for name in names for word in words_of(name)}
    if not (words & _EXTENTS or chosen in names) or words & HALF_WORDS or geometry.anchor == "corner":
        return None
    columns = {**geometry.columns, HALF_EXTENTS: names[0]}
    return replace(geometry, size=2 * geometry.size, columns=columns, prior=geometry.prior + 0.8)


_OF_LAST_CELLS: Final = 2.0
"""Cost of a reading in which coordinates are numbers of cells of a grid, and a box is given by its first and last cells
(``with_last_cells``). The cost is added to ``Geometry.prior``."""


def with_last_cells(geometry: Geometry) -> Geometry | None:
    """The geometry, with far corners read as the last cells of boxes on a grid: a box from 1 to 40 is 40 cells long.
    The result is None if the geometry does not consist of two corners with whole numbers."""
    far = [name for role, name in geometry.columns.items() if role.endswith("(far)") or role == "corners"]
    if not far or not _are_whole(geometry.size, geometry.place):
        return None
    columns = {**geometry.columns, LAST_CELLS: far[0]}
    return replace(geometry, size=geometry.size + 1, columns=columns, prior=geometry.prior + _OF_LAST_CELLS)


def _are_whole(*numbers: FloatArray) -> bool:
    return all(np.array_equal(some, np.rint(some), equal_nan=True) for some in numbers)


def _columns_of_places(header: Sequence[str], columns_of_axes: Sequence[Sequence[int]]) -> list[list[int]]:
    """The columns for each coordinate. Columns that do not hold places (``_NOT_PLACES``) are left out if there are
    others."""
    columns = [list(some) for some in columns_of_axes]
    for words in _NOT_PLACES:
        others = [[index for index in some if not words.intersection(words_of(header[index]))] for some in columns]
        columns = others if all(others) else columns
    return columns


# Columns without names.


_DENSEST: Final = 1.5
"""A column without a name has densities only if its numbers are at most this value, relative to water. Cartons are less
dense."""
_MOST_SOUND: Final = 0.9
"""In a table without a header, at least this share of the rows must match the guessed meaning of a column. In all other
rows, the cells of this column are taken to be damaged."""


def array_choices(extraction: ColumnExtraction) -> list[Geometry]:
    """Possible sizes and places in a table without names of columns. Six columns, of which the first is the table's
    first or second column, hold sizes and then places, places and then sizes, or two corners of each box."""
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
    """Interpret the columns that follow the sizes and places in an array without column names. Returns rotations, the
    column of weights, and whether the weights are densities.

    A column of whole numbers from 0 to 5, some of them 0, holds rotations. A column of numbers up to ``_DENSEST`` holds
    densities relative to water. A column of larger numbers holds densities in kg/m³ if these are more plausible than
    weights; otherwise, it holds weights.
    """
    header = extraction.table.header
    used = {header.index(name) for name in geometries[0].columns.values()} if geometries else set()
    turns, weight, is_density = None, None, False
    for index in range(max(used, default=-1) + 1, len(header)):
        values = extraction.numbers_or_median(index)
        is_integer = bool((values == np.rint(values)).all())
        if is_integer and values.max() <= 5 and (values.min() == 0 or (values == 1).all()):
            if values.max() > 0 and turns is None:
                rules = ("swap", "py3dbp") if values.max() <= 1 else ("py3dbp",)
                turns = Turns(header[index], rules, values.astype(np.int64))
        elif weight is None and _mostly(values > 0):
            weight = index
            is_density = bool(values.max() <= _DENSEST) or _are_densities(values, geometries[0])
    return turns, weight, is_density


def _are_densities(values: FloatArray, geometry: Geometry) -> bool:
    """Whether numbers are more plausible as densities of boxes in kg/m³ than as weights in kg or g."""
    is_good = (geometry.size > 0).all(axis=1)
    values, volume = values[is_good], geometry.size[is_good].prod(axis=1)
    if not len(values):
        return False
    costs = [
        side_cost(float(np.median(volume)) ** (1 / 3) * mm)
        + density_cost(float(np.median(values / volume)) * kg / (mm / 1000) ** 3)
        for mm in (1.0, 10.0, 1000.0)
        for kg in (1.0, 0.001)
    ]
    side = min(side_cost(float(np.median(volume)) ** (1 / 3) * mm) for mm in (1.0, 10.0, 1000.0))
    return side + density_cost(float(np.median(values))) + _OF_DENSITIES < min(costs)


_OF_DENSITIES: Final = 1.5
"""Cost of reading an array's column without a name as densities in kg/m³. Such columns mostly hold weights."""


def _mostly(rows: NDArray[np.bool_]) -> bool:
    sound = int(np.count_nonzero(rows))
    return sound >= _MOST_SOUND * len(rows) or sound >= len(rows) - 1 > 1
