"""Meanings of the columns of other tools' tables (``BoxColumns``): sizes, places, rotations, weights and names of
boxes.

Units, axes and anchors (the points of the boxes that coordinates describe) are decided later
(``petmjx.plans.readings``).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import cell_number, cell_text
from petmjx.plans.column_extraction import HALF_EXTENTS, IGNORED, LAST_CELLS, ColumnExtraction
from petmjx.plans.column_names import LENGTH_UNITS, may_count, word_set, words_of
from petmjx.plans.known_forms import BoxSource
from petmjx.plans.pose_columns import pose_choices
from petmjx.plans.raw_tables import rows_by_name
from petmjx.plans.size_and_place_columns import (
    Geometry,
    Places,
    Sizes,
    array_choices,
    array_extras,
    corners_in,
    other_sizes_in,
    places_in,
    sizes_in,
    with_half_extents,
    with_last_cells,
)
from petmjx.plans.turn_columns import Turns, are_two_values, may_be_turns, turns_of

_GROSS: Final = word_set("gross brutto bruttogewicht bruttogew bruto brut lordo")
"""Words for gross weights, which are preferred to net weights."""
_SECOND_SIZES: Final = 0.5
"""A table may have several sets of columns for the sizes of boxes. A reading with the sizes of a further set costs this
much more than a reading with the sizes of the first set. A reading with a smaller cost is more plausible."""


@dataclass(frozen=True, eq=False)
class BoxColumns:
    """The boxes of a source, by column.

    Attributes:
        source: where the boxes come from.
        geometries: possible choices of columns for sizes and places.
        turns: rotations; None: no column has rotations.
        weight: (n,) weights in the file's unit; None: no column has weights.
        weight_unit: unit of the weights according to the column's name or cells; for densities one of
            ``DENSITY_UNITS``; "" if no unit is given.
        weight_is_density: whether ``weight`` has densities.
        plan, article, item_id, group: (n,) names; None: no column has them.
        sequence: (n,) packing order, NaN for plans without one; None: no column has it. A column of running numbers is
            not taken as a packing order, since boxes may be numbered in any order.
        counters: name of a column → (n,) its numbers, for columns of whole numbers that may be a packing order. The
            names of these columns may mean a packing order ("Nr", "Pick"), or are unknown. NaN stands for cells that
            are not whole numbers.
        columns: role → name of its column, for all roles except sizes and places.
        faults: row → (column, error text) of the first bad cell in the row.
        unread: names of columns that are not used.
        unit_columns: names of columns whose cells are units of the numbers in other columns.
    """

    source: BoxSource
    geometries: list[Geometry]
    turns: Turns | None
    weight: FloatArray | None
    weight_unit: str
    weight_is_density: bool
    plan: list[str] | None
    article: list[str] | None
    item_id: list[str] | None
    group: list[str] | None
    sequence: FloatArray | None
    counters: Mapping[str, FloatArray]
    columns: Mapping[str, str]
    faults: Mapping[int, tuple[str, str]]
    unread: tuple[str, ...]
    unit_columns: tuple[str, ...]

    @property
    def n_boxes(self) -> int:
        return len(self.source.boxes.table.rows)


def box_columns(source: BoxSource, chosen: Mapping[str, str], units: str, masses: str) -> BoxColumns:
    """Determine the columns of a source by their meanings.

    Args:
        chosen: role (``ROLES``) → name of the column that has it, or "-".
        units: the unit that an option sets for all lengths; "" if no such option is given.
        masses: the unit that an option sets for all masses; "" if no such option is given.

    Raises:
        InputError: a chosen column does not exist, or cannot have the role. Missing places or sizes raise no error:
            ``geometries`` is then empty.
    """
    extraction = ColumnExtraction(source, chosen, units, masses)
    turns = None
    if source.boxes.table.has_header:
        geometries = pose_choices(extraction)
        if not geometries:
            geometries, turns = _geometries_of_names(extraction), rotations_in(extraction)
        geometries = _with_other_ways(extraction, geometries, chosen)
        weight_index = weight_column(extraction)
        density_index = extraction.first("density") if weight_index is None else None
    else:
        geometries = _with_other_ways(extraction, array_choices(extraction), chosen)
        turns, extra, is_density = array_extras(extraction, geometries)
        weight_index, density_index = (None, extra) if is_density else (extra, None)
    weight, weight_unit = None, ""
    if weight_index is not None:
        weight, weight_unit = extraction.weights(weight_index)
    elif density_index is not None:
        weight, weight_unit = extraction.densities(density_index)
    sequence_index = extraction.first("sequence", "sequence")
    sequence = None
    if sequence_index is not None and extraction.is_empty(sequence_index):
        sequence_index = None
    if sequence_index is not None:
        sequence, _ = extraction.numbers(sequence_index, {"": 1.0})
        if len(sequence) > 2 and bool((sequence == sequence[0]).all()) and "sequence" not in extraction.fixed:
            sequence, sequence_index = None, None  # all values are equal, so the column is no packing order
    used = {name for geometry in geometries for name in geometry.columns.values()}
    plan, plan_name = extraction.texts("plan", role="plan")
    plan = extraction.filled_down(plan, plan_name, least_rows=2.0)
    extraction.check_numbers(plan, plan_name)
    if sequence_index is not None:
        _leave_blank(extraction, sequence_index, plan)
    article, article_name = extraction.texts("article", role="article")
    item_id, item_name = extraction.texts("item_id", "number", role="item_id")
    if item_id is None and article is None:
        item_id, item_name = distinct_names_in(extraction)
    if item_id is None and article is not None:
        item_id, item_name = article, article_name
    group, group_name = extraction.texts("group")
    header = source.boxes.table.header
    named = {
        "weight": "" if weight_index is None else header[weight_index],
        "density": "" if density_index is None else header[density_index],
        "rotation": "" if turns is None else turns.column,
        "sequence": "" if sequence_index is None else header[sequence_index],
        "plan": plan_name,
        "article": article_name,
        "item_id": item_name,
        "product_group": group_name,
    }
    known = used | set(named.values())
    return BoxColumns(
        extraction.source,
        geometries,
        turns,
        weight,
        weight_unit,
        density_index is not None,
        plan,
        article,
        item_id,
        group,
        sequence,
        {} if sequence is not None else counting_columns(extraction, used),
        {role: name for role, name in named.items() if name},
        extraction.faults,
        tuple(
            name
            for name in header
            if not {name, name.rpartition("[")[0]} & known and name not in extraction.unit_columns
        ),
        tuple(extraction.unit_columns),
    )


def _leave_blank(extraction: ColumnExtraction, index: int, plan: Sequence[str] | None) -> None:
    """Remove the faults of blank cells in a column of packing orders. The faults of a plan are removed only if all
    cells of the column are blank in the rows of this plan."""
    parts, cells = extraction.source.boxes.parts, extraction.cells(index)
    names = parts if plan is None else [f"{part}\n{name}" for part, name in zip(parts, plan, strict=True)]
    for rows in rows_by_name(names).values():
        if all(cells[row] in (None, "") for row in rows.tolist()):
            for row in rows.tolist():
                if extraction.faults.get(row, ("", ""))[0] == extraction.table.header[index]:
                    del extraction.faults[row]


def _geometries_of_names(extraction: ColumnExtraction) -> list[Geometry]:
    """The possible sizes and places in columns without poses, according to their names."""
    places, sizes = places_in(extraction), sizes_in(extraction)
    if places is None or sizes is None:
        corners = corners_in(extraction)
        return [] if corners is None else [corners]
    further = other_sizes_in(extraction, sizes)
    return [
        _geometry_of(sizes, places),
        *(replace(_geometry_of(other, places), prior=_SECOND_SIZES) for other in further),
    ]


def _with_other_ways(
    extraction: ColumnExtraction, geometries: Sequence[Geometry], chosen: Mapping[str, str]
) -> list[Geometry]:
    """The geometries, and the same columns read as half extents or as first and last cells, as far as options allow.
    If at least one geometry has a box with three positive sizes, geometries without such a box are left out."""
    ways = [*geometries]
    for other_way in (partial(with_half_extents, chosen=chosen.get(HALF_EXTENTS, "")), with_last_cells):
        ways += [other for geometry in ways if (other := other_way(geometry)) is not None]
    for role in (HALF_EXTENTS, LAST_CELLS):
        if role in chosen:
            is_wanted = chosen[role] != IGNORED
            fitting = [geometry for geometry in ways if (role in geometry.columns) == is_wanted]
            are_known = role == HALF_EXTENTS and any(meaning and meaning.half for meaning in extraction.meanings)
            if is_wanted and ways and not (fitting or are_known):
                raise InputError(f"{printable_name(chosen[role])} cannot hold {role}")
            ways = fitting or ways
    return [geometry for geometry in ways if (geometry.size > 0).all(axis=1).any()] or ways


def _geometry_of(sizes: Sizes, places: Places) -> Geometry:
    """Sizes and places, joined into one ``Geometry``. If their units differ, both are converted to millimetres."""
    size, axes, size_unit, placed, columns, by_sizes, faults = sizes
    place, place_unit, anchor, more, up = places
    if size_unit and place_unit and size_unit != place_unit:
        size, place = size * LENGTH_UNITS[size_unit], place * LENGTH_UNITS[place_unit]
        size_unit = place_unit = "mm"
    anchor = anchor or by_sizes
    return Geometry(
        *(size, place, axes, size_unit, place_unit, anchor, placed, {**columns, **more}), named_up=up, faults=faults
    )


def distinct_names_in(extraction: ColumnExtraction) -> tuple[list[str] | None, str]:
    """(n,) names of boxes, and the name of their column: the first column whose name is unknown and whose cells are all
    different texts, but no dates or times. The result is None and "" if there is no such column."""
    for index, meaning in enumerate(extraction.meanings):
        cells = extraction.cells(index)
        texts = {cell for cell in cells if isinstance(cell, str) and cell_number(cell) is None}
        texts = {text for text in texts if not _MOMENT.fullmatch(text)}
        if meaning is None and len(cells) > 1 and len(texts) == len(cells):
            return [cell_text(cell) for cell in cells], extraction.table.header[index]
    return None, ""


_DATE: Final = r"(?:(?:19|20)\d\d[-./]?[01]\d[-./]?[0-3]\d|\d\d?[./]\d\d?[./]\d\d(?:\d\d)?)"
_TIME: Final = r"\d\d?:\d\d(?::\d\d(?:[.,]\d+)?)?(?:\s*[AaPp][Mm])?(?:Z|\s*[+-]\d\d:?\d\d)?"
_MOMENT: Final = re.compile(rf"\s*(?:{_DATE}(?:[T\s]+{_TIME})?|{_TIME})\s*")
"""A date, a time, or both: "2025-03-14", "20250314", "14.03.25 8:02", "3/14/2025", "2025-03-14T08:02:11Z"."""


def weight_column(extraction: ColumnExtraction) -> int | None:
    """The column of weights. If several columns have weights, the first column of gross weights is taken; without gross
    weights, the first column of weights is taken. A column that an option names for another role is not taken."""
    if "weight" in extraction.fixed or "weight" in extraction.ignored:
        return extraction.fixed.get("weight")
    weights = [index for index in extraction.indices("weight") if index not in extraction.fixed.values()]
    gross = (index for index in weights if _GROSS.intersection(words_of(extraction.table.header[index])))
    return next(gross, next(iter(weights), None))


def counting_columns(extraction: ColumnExtraction, used: Collection[str]) -> dict[str, FloatArray]:
    """Unused columns of whole numbers whose names could mean a packing order, or are unknown."""
    columns: dict[str, FloatArray] = {}
    for index, name in enumerate(extraction.table.header):
        if name in used or not (may_count(name) or extraction.meanings[index] is None):
            continue
        numbers = extraction.cell_numbers(index)
        values = np.array([np.nan if number is None or number.unit else number.value for number in numbers])
        with np.errstate(invalid="ignore"):
            columns[name] = np.where(values == np.rint(values), values, np.nan)
    return columns


def rotations_in(extraction: ColumnExtraction) -> Turns | None:
    """The column of rotations. If no column is known to have rotations, a column of unknown meaning may have them: the
    only column whose cells are yes or no, or quarter turns in degrees. If there is no such column, or more than one, it
    is the only column with two values."""
    index = extraction.first("rotation", "rotation")
    if index is not None:
        return _rotations_of(extraction, index)
    unknown = [
        index
        for index, (name, meaning) in enumerate(zip(extraction.table.header, extraction.meanings, strict=True))
        if meaning is None and index not in extraction.fixed.values() and name not in extraction.unit_columns
    ]
    for may_have_turns, cost in ((may_be_turns, _GUESSED_TURNS), (are_two_values, _GUESSED_VALUES)):
        answers = [index for index in unknown if may_have_turns(extraction.cells(index))]
        if len(answers) == 1:
            return _rotations_of(extraction, answers[0], cost)
    return None


_GUESSED_TURNS, _GUESSED_VALUES = 2.0, 3.5
"""Costs of a reading in which a column of unknown meaning has rotations: ``_GUESSED_TURNS`` if its cells are yes and
no, or quarter turns in degrees; ``_GUESSED_VALUES`` if its cells are two other values."""


def _rotations_of(extraction: ColumnExtraction, index: int, guess_cost: float = 0.0) -> Turns | None:
    faults: dict[int, str] = {}
    name, cells, decimal = extraction.table.header[index], extraction.cells(index), extraction.table.decimal
    turns = turns_of(name, cells, decimal, faults.__setitem__, guess_cost)
    if guess_cost:
        return None if turns is None else replace(turns, faults=faults)
    for row, text in faults.items():
        extraction.bad(row, index, text)
    return turns
