"""Converts the sizes and places of the boxes of another tool's file to millimetres, with the deck's corner as the
origin. The module also finds rows of pallets, and sizes and coordinates that are out of range."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.text import count_text
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.cell_numbers import cell_number, thousands_faults
from petmjx.plans.column_extraction import LAST_CELLS, role_of
from petmjx.plans.column_names import LENGTH_UNITS, limits_in, names_deck
from petmjx.plans.nested_containers import FLAT
from petmjx.plans.plan_fields import FARTHEST_MM, LARGEST_MM, SMALLEST_MM, coordinate_fault, positive_fault
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, shared_length
from petmjx.plans.reading_candidates import AXES_ALONG, Candidate, layout_of
from petmjx.plans.reading_choice import container_of
from petmjx.plans.readings import Reading, Wishes
from petmjx.plans.size_and_place_columns import Geometry

_OF_DECKS_MM: Final = ((380.0, 580.0), (1320.0, 1500.0))
"""Limits of the sides of a pallet, mm: the smallest short and long side, and the largest short and long side."""
_HIGHEST_DECK_MM: Final = 250.0
_LEAST_HEIGHT_SHARE: Final = 0.49
"""Along the vertical axis, the coordinate of a box on a pallet is larger than the pallet's coordinate by at least this
share of the pallet's height. If coordinates describe centres, the coordinate of a thin box exceeds the pallet's
coordinate by little more than half of the pallet's height."""
_LEVEL: Final = 0.01
"""The lowest box counts as standing on the deck if the distance between its bottom and the deck is at most this share
of the boxes' median height. For cartons of 200 mm, this is 2 mm. The limit is above 0, because centres are often
rounded to millimetres."""


def placed_boxes(
    columns: BoxColumns,
    reading: Reading,
    candidate: Candidate,
    plans: Mapping[str, NDArray[np.int64]],
    wishes: Wishes,
    faults: Collection[int],
    notes: list[str],
) -> tuple[FloatArray, FloatArray]:
    """(n, 3) sizes and (n, 3) corners along the plan's axes, mm. Adds to ``notes`` how the boxes of
    plans were moved so that the origin is the deck's corner.

    Args:
        faults: numbers of the rows that have faults. These rows are ignored when the beginning of a plan is determined.
    """
    factor = LENGTH_UNITS[reading.length_units[1]]
    n = columns.n_boxes
    size, low = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    containers: dict[str, FloatArray] = {}
    for name, rows in plans.items():
        layout = layout_of(columns, candidate, rows, container_of(columns.source.boxes.containers, name))
        containers[name] = layout.container * factor
        if wishes.deck_mm is not None and np.isnan(containers[name][:2]).any():
            containers[name] = np.array([*wishes.deck_mm, np.nan])
        size[rows], low[rows] = layout.size * factor, layout.low * factor
    usable = np.array([row not in faults for row in range(n)])
    good_rows = {name: rows[usable[rows]] for name, rows in plans.items() if usable[rows].any()}
    bottoms = _deck_heights(low, good_rows, size, containers)
    moved = {
        _move(low, plans[name], rows, size, containers[name], reading, bottoms[name])
        for name, rows in good_rows.items()
    }
    notes += sorted(filter(None, moved))
    return size, low


def _deck_heights(
    low: FloatArray, plans: Mapping[str, NDArray[np.int64]], size: FloatArray, containers: Mapping[str, FloatArray]
) -> dict[str, float]:
    """Height of the deck of each plan, mm. It is assumed that all plans of a file measure heights from the same level.

    The level is 0 if the lowest box of any plan is at 0; else it is the height of the lowest box of the file. So if a
    plan lacks its bottom layer, its boxes float above the deck. If heights are measured from the middle of a container,
    the deck is at the plan's own lowest box (half the container's height below 0).
    """
    small = {name: _LEVEL * float(np.nanmedian(size[rows, 2])) for name, rows in plans.items()}
    below = rows_below_deck(low, plans, size)
    lowest = {name: float(np.nanmin(low[[row for row in rows if row not in below], 2])) for name, rows in plans.items()}
    of_middle = {
        name for name, z in lowest.items() if abs(z) > small[name] and abs(z + containers[name][2] / 2) <= small[name]
    }
    others = {name: z for name, z in lowest.items() if name not in of_middle}
    begins = any(abs(z) <= small[name] for name, z in others.items())
    level = 0.0 if begins else min(others.values(), default=0.0)
    return {name: z if name in of_middle or abs(z - level) <= small[name] else level for name, z in lowest.items()}


def rows_below_deck(low: FloatArray, plans: Mapping[str, NDArray[np.int64]], size: FloatArray) -> set[int]:
    """Numbers of the rows of boxes below the deck, whose heights are probably wrong. A plan's deck is taken to be at
    height 0 if the boxes below 0 cannot carry the boxes at 0. This is so in two cases: all boxes below 0 together have
    less than half of the base area of the boxes at 0; or there are fewer boxes below 0 than at 0, and no box below 0
    has its top at 0."""
    below: set[int] = set()
    area = size[:, 0] * size[:, 1]
    for rows in plans.values():
        small = _LEVEL * float(np.nanmedian(size[rows, 2]))
        lower, at_0 = (rows[where] for where in (low[rows, 2] < -small, np.abs(low[rows, 2]) <= small))
        carries = (np.abs(low[lower, 2] + size[lower, 2]) <= small).any()
        if np.nansum(area[lower]) < np.nansum(area[at_0]) / 2 or (len(lower) < len(at_0) and not carries):
            below |= {*lower.tolist()}
    return below


def _move(
    low: FloatArray,
    rows: NDArray[np.int64],
    used: NDArray[np.int64],
    size: FloatArray,
    container: FloatArray,
    reading: Reading,
    bottom: float,
) -> str:
    """Move the boxes of a plan so that the deck's corner is the origin. Returns a note ("" if nothing was moved).

    Args:
        used: numbers of the rows that have no faults.
        bottom: height of the deck, mm.
    """
    notes = []
    if abs(bottom) > _LEVEL * float(np.nanmedian(size[used, 2])):
        low[rows, 2] -= bottom
        notes.append(f"heights are measured from the bottom of the lowest box, which is at {bottom:g} mm in the file")
    elif bottom:
        low[rows, 2] = np.where(np.abs(low[rows, 2]) <= abs(bottom), 0.0, low[rows, 2])
    begin = np.nanmin(low[used, :2], axis=0)
    if reading.origin == "middle":
        low[rows, :2] += container[:2] / 2 if not np.isnan(container[:2]).any() else -begin
        notes.append("the origin is the middle of the carrier")
    elif (begin < -DEFAULT_TOLERANCE_MM).any():
        low[rows, :2] += np.where(begin < -DEFAULT_TOLERANCE_MM, -begin, 0.0)
        notes.append("x or y is negative: boxes are moved so that its smallest value is 0")
    return "; ".join(notes)


def pallet_rows(
    columns: BoxColumns, plans: Mapping[str, NDArray[np.int64]], size: FloatArray, low: FloatArray
) -> set[int]:
    """Numbers of the rows that describe a pallet, not a box: these rows are named as a pallet, have the size of a
    pallet, and lie below all boxes."""
    decks = set()
    for rows in plans.values():
        if len(rows) < 2 or np.isnan(low[rows]).any():
            continue
        row = int(rows[np.argmin(low[rows, 2])])
        top = low[row, 2] + size[row, 2] - DEFAULT_TOLERANCE_MM
        above = bool((low[rows[rows != row], 2] >= top).all())
        names = [cell for cell in columns.source.boxes.table.rows[row] if isinstance(cell, str)]
        level = np.sort(size[row, :2])
        narrow, wide = _OF_DECKS_MM
        as_large = narrow[0] <= level[0] <= wide[0] and narrow[1] <= level[1] <= wide[1]
        if above and as_large and size[row, 2] <= _HIGHEST_DECK_MM and any(map(names_deck, names)):
            decks.add(row)
    return decks


def named_decks(columns: BoxColumns, plans: Mapping[str, NDArray[np.int64]]) -> tuple[set[int], str]:
    """Numbers of the rows that describe pallets, one for each plan, and the vertical axis that these rows show, "y" or
    "z". If any plan lacks a row of a pallet, or if the rows of all plans do not agree on exactly one axis, the set is
    empty and the axis is "".

    The row of a pallet is named as a pallet, is flat, and has the largest base of its plan. Along the vertical axis,
    and only along this axis, all boxes of the plan have larger coordinates than the pallet.
    """
    geometry = columns.geometries[0]
    sides = np.sort(geometry.size, axis=1)
    names_plan = columns.columns.get("plan", "")
    header = columns.source.boxes.table.header
    decks: set[int] = set()
    axes = {"y", "z"}
    for rows in plans.values():
        named = [
            row
            for row in rows.tolist()
            if any(
                isinstance(cell, str) and name != names_plan and names_deck(cell)
                for name, cell in zip(header, columns.source.boxes.table.rows[row], strict=True)
            )
        ]
        if len(named) != 1 or len(rows) == 1:
            return set(), ""
        (deck,), others = named, rows[rows != named[0]]
        thickness, width, _ = sides[deck].tolist()
        if not thickness <= FLAT * width or not (sides[deck, 1:] >= sides[others, 1:].max(axis=0)).all():
            return set(), ""
        ahead = geometry.place[others] - geometry.place[deck] > _LEAST_HEIGHT_SHARE * thickness
        axes &= {axis for axis, index in (("y", 1), ("z", 2)) if ahead[:, index].all()}
        decks.add(deck)
    return (decks, axes.pop()) if len(axes) == 1 else (set(), "")


# Values out of range.


def far_cells(columns: BoxColumns, wishes: Wishes) -> dict[int, tuple[str, str]]:
    """Row → (column, error text), for sizes and coordinates that are too large in every unit that a reading may
    give them."""
    geometry, form = columns.geometries[0], columns.source.form
    faults: dict[int, tuple[str, str]] = {}
    size_names, place_names = _size_names(geometry, geometry.columns), _place_names(geometry.columns)
    sizes, places = wishes.length_units
    for values, smallest, largest, names, unit, fault_of in (
        (geometry.size, SMALLEST_MM, LARGEST_MM, size_names, geometry.size_unit or sizes, positive_fault),
        (geometry.place, -FARTHEST_MM, FARTHEST_MM, place_names, geometry.place_unit or places, coordinate_fault),
    ):
        limits = limits_in(smallest, largest, unit or form.units or "mm")
        for row, axis in np.argwhere(np.abs(values) > limits.largest).tolist():
            text = fault_of(names[axis], float(values[row, axis]), *limits)
            if text is not None:
                faults.setdefault(row, (names[axis], text.removeprefix(f"{names[axis]} ")))
    return faults


def empty_rows(columns: BoxColumns) -> dict[int, tuple[str, str]]:
    """Row → (column, error text), for boxes that have a place although the quantity in their row is 0. Columns in which
    all quantities are 0 are ignored."""
    table = columns.source.boxes.table
    faults: dict[int, tuple[str, str]] = {}
    for name, meaning in zip(table.header, columns.source.boxes.meanings, strict=True):
        if meaning is None or meaning.kind != "quantity" or meaning.of_container:
            continue
        quantities = [None if number is None else number.value for number in map(cell_number, table.column(name))]
        if any(quantities):
            rows = (row for row, quantity in enumerate(quantities) if quantity == 0)
            faults |= dict.fromkeys(rows, (name, "must be ≥ 1 in a row that has a place, got 0"))
    return faults


def first_bad_row(columns: BoxColumns, wishes: Wishes) -> tuple[int, str] | None:
    """The first row that is bad in every reading of the file, and its fault: a bad cell, or a size that is not
    positive. The result is None if all rows are good."""
    weight = columns.columns.get("weight", "") if wishes.density_kg_m3 is not None else ""
    faults = {row: f"{name} {text}" for row, (name, text) in columns.faults.items() if name != weight}
    geometries = columns.geometries
    is_bad = ~(geometries[0].size > 0).all(axis=1)
    if not any(LAST_CELLS in geometry.columns for geometry in geometries):
        is_bad = np.array([~(geometry.size > 0).all(axis=1) for geometry in geometries]).all(axis=0)
    for row in np.flatnonzero(is_bad).tolist():
        axis = int(np.argmin(np.nan_to_num(geometries[0].size[row], nan=math.inf)))
        name = _size_names(geometries[0], geometries[0].columns)[axis]
        fault = _end_fault(geometries[0], row, axis) or f"{name} must be > 0, got {geometries[0].size[row, axis]:g}"
        faults.setdefault(row, fault)
    return min(faults.items(), default=None)


def _end_fault(geometry: Geometry, row: int, axis: int) -> str:
    """The fault of a box that ends where it begins, with the names of the columns of both ends; "" for other boxes."""
    far = geometry.columns.get(f"{geometry.axes[axis]} (far)", geometry.columns.get("corners", ""))
    if not far or geometry.size[row, axis]:
        return ""
    near = "its near corner" if "corners" in geometry.columns else _place_names(geometry.columns)[axis]
    return f"{far} must be beyond {near}, got {geometry.place[row, axis]:g}"


def height_fault(reading: Reading, candidate: Candidate, row: int) -> str:
    """The error text for a box below the deck, with the name of the column of heights."""
    axis = AXES_ALONG[candidate.up][2]
    height = candidate.geometry.place[row, axis]
    return f"{_place_names(reading.columns)[axis]} is below the deck, on which other boxes stand, got {height:g}"


_FAR_MM: Final = 1000.0
"""Smallest distance, mm, of a box that is far from all others."""
_ALONG_EDGE: Final = 3
"""An edge of the load is assumed at coordinate 0 only if at least this number of boxes begin there. If the container is
known, one box less is enough."""


def _touches_next(low: FloatArray, size: FloatArray, box: int, axis: int, tolerance: float) -> bool:
    """Whether a box ends along an axis where another box beside it begins."""
    high = low + size
    touch = np.abs(low[:, axis] - high[box, axis]) <= tolerance
    for other in {0, 1, 2} - {axis}:
        touch &= shared_length(low[:, other], high[:, other])[box] > tolerance
    return bool(touch.any())


def edge_faults(
    columns: BoxColumns, reading: Reading, candidate: Candidate, plans: Mapping[str, NDArray[np.int64]]
) -> dict[int, str]:
    """Row → fault, for two kinds of boxes.

    The first kind is the only box of a plan with a negative x or y. It is bad if most of it is beyond the edge of the
    load, and it touches no box at this edge. (If the origin is the middle of a side, a box of a sound plan may stand
    beyond the edge and touch a box there.) The second kind is a box whose distance from all other boxes is larger than
    the extent of all other boxes together.
    """
    faults: dict[int, str] = {}
    names = _place_names(reading.columns)
    far = _FAR_MM / LENGTH_UNITS[reading.length_units[1]]
    for name, plan_rows in plans.items():
        layout = layout_of(columns, candidate, plan_rows)
        is_good = np.isfinite(layout.low + layout.size).all(axis=1)
        rows, low, size = plan_rows[is_good], layout.low[is_good], layout.size[is_good]
        small = _LEVEL * float(np.median(size[:, 2])) if len(size) else 0.0
        least = _ALONG_EDGE - bool(container_of(columns.source.boxes.containers, name))
        for axis, named in enumerate(AXES_ALONG[candidate.up]):
            odd_boxes = dict.fromkeys(_far_boxes(low[:, axis], low[:, axis] + size[:, axis], far), "far from")
            beyond = np.flatnonzero(low[:, axis] < -small).tolist()
            at_edge = np.count_nonzero(np.abs(low[:, axis]) <= small)
            has_edge = axis < 2 and at_edge >= least and reading.origin != "middle"
            is_beyond = has_edge and len(beyond) == 1 and (low + size / 2)[beyond[0], axis] < 0
            if is_beyond and not _touches_next(low, size, beyond[0], axis, small):
                odd_boxes[beyond[0]] = "beyond the edge of"
            for box, where in odd_boxes.items():
                got = f"got {candidate.geometry.place[rows[box], named]:g}"
                faults.setdefault(int(rows[box]), f"{names[named]} is {where} the other boxes, {got}")
    return faults


def _far_boxes(low: FloatArray, high: FloatArray, least: float) -> list[int]:
    """Indices of the boxes that are far from all other boxes along an axis: the distance is larger than the extent of
    all other boxes together.

    Args:
        low, high: (n,) where the boxes begin and end.
        least: smallest distance of such a box.
    """
    far_boxes = []
    for box in {int(np.argmin(high)), int(np.argmax(low))} if len(low) > _ALONG_EDGE else ():
        begin, end = np.delete(low, box).min(), np.delete(high, box).max()
        if max(begin - high[box], low[box] - end) > max(end - begin, least):
            far_boxes.append(box)
    return far_boxes


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
    bad_sizes = (raw_size < size_limits.smallest) | (raw_size > size_limits.largest)
    far_places = (raw_place < place_limits.smallest) | (raw_place > place_limits.largest)
    for row, axis in np.argwhere(bad_sizes | far_places).tolist():
        if bad_sizes[row, axis]:
            fault = _end_fault(candidate.geometry, row, axis) or positive_fault(
                named_sizes[axis], float(raw_size[row, axis]), *size_limits
            )
        else:
            fault = coordinate_fault(named_places[axis], float(raw_place[row, axis]), *place_limits)
        if fault is not None:
            faults.setdefault(row, fault)
    return faults


def _size_names(geometry: Geometry, columns: Mapping[str, str]) -> list[str]:
    """The names of the columns of the three sizes.

    Args:
        columns: role → name of its column.
    """
    roles = [(role_of(axis), "sizes", f"{axis} (far)", "corners") for axis in geometry.axes]
    return [next(filter(None, map(columns.get, names)), names[0]) for names in roles]


def _place_names(columns: Mapping[str, str]) -> list[str]:
    """The names of the columns of the three coordinates."""
    return [columns.get(axis, columns.get("position", axis)) for axis in "xyz"]


def fault_of_rows(rows: Sequence[int], faults: Mapping[int, str], place_of: Callable[[int], str]) -> str | None:
    """The error text for a plan or an order with bad rows: the first fault with its place, and the number of further
    bad rows. The result is None if all rows are good.

    Args:
        faults: row → fault.
        place_of: function that returns the place of a row in the file.
    """
    bad_rows = [row for row in rows if row in faults]
    if not bad_rows:
        return None
    more_text = f" (and {count_text(len(bad_rows) - 1, 'more row')})" if len(bad_rows) > 1 else ""
    return f"{place_of(bad_rows[0])}: {faults[bad_rows[0]]}{more_text}"
