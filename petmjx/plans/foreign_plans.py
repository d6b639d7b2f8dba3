"""Plans in files of other tools (``plans_of_sources``). A reading (an interpretation of the columns and numbers) is
chosen for the file. With this reading, the boxes become a checked table of placements, as in petmjx's own formats."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.plans.box_columns import BoxColumns, box_columns
from petmjx.plans.cell_numbers import GROUPED, cell_number
from petmjx.plans.column_extraction import XYZ
from petmjx.plans.column_names import known_meanings
from petmjx.plans.file_formats import NoBoxes, NoGeometry
from petmjx.plans.foreign_plan_builder import ForeignPlans, PlanBuilder
from petmjx.plans.header_and_total_rows import are_numbers
from petmjx.plans.item_joins import with_items
from petmjx.plans.known_forms import POSES, BoxSource, rows_of
from petmjx.plans.placed_boxes import named_decks
from petmjx.plans.plan_fields import joined_names
from petmjx.plans.plan_rows import plan_names
from petmjx.plans.raw_tables import rows_by_name
from petmjx.plans.reading_choice import TIE
from petmjx.plans.readings import NOT_READ, Wishes
from petmjx.plans.size_and_place_columns import AXIS_OF_WORD

_NUMBERS_OF_A_BOX: Final = 6
"""Smallest number of numbers in the row of a box: three sizes and three coordinates."""
PACK: Final = "pack them first: petmjx samples --orders {file} -o plans.json"


def plans_of_sources(
    sources: Sequence[BoxSource], path: Path | None, source: str, wishes: Wishes, items: Path | None
) -> ForeignPlans:
    """Read the plans in the first of several lists of boxes, the list that most likely describes plans.

    Args:
        sources: the lists, most likely first. The other lists may have the sizes and weights of items.
        path: the file of the lists; None: they come from an object.
        source: name of the file or object in messages.
        items: file with the sizes and weights of items, for files that contain only places. If ``items`` is None, a
            file of items is searched for in the folder of the file of plans.

    Raises:
        AmbiguousFile: the file can be read in two ways.
        InputError: the file contains no plans. The error lines do not name the file.
    """
    chosen = with_items(sources, path, items)
    chosen = replace(chosen, notes=(*chosen.notes, *_other_plans(sources)))
    if chosen.boxes.table.decimal:
        return _plans_of(chosen, sources, path, source, wishes)
    ways: list[ForeignPlans] = []
    for decimal in (",", GROUPED):
        with suppress(InputError):
            ways.append(_plans_of(_with_decimal(chosen, decimal), sources, path, source, wishes))
    ways.sort(key=lambda plans: plans.reading.cost)
    if not ways or (len(ways) == 2 and ways[1].reading.cost - ways[0].reading.cost < TIE):
        # this call raises the error, which says that the decimal mark is ambiguous
        return _plans_of(chosen, sources, path, source, wishes)
    return ways[0]


def _other_plans(sources: Sequence[BoxSource]) -> list[str]:
    """Lines about lists of boxes that are not read. Only the first list is read. Each other list gets a line if it has
    a header, and columns for sizes and places. A list without a header gets a line if the first list has no header
    either, and both have the same number of columns. A list gets no line if its objects contain the boxes of the first
    list, as layers do."""
    lines = []
    first = sources[0].boxes
    for other in sources[1:]:
        boxes = other.boxes
        if (boxes.path and first.path.startswith(f"{boxes.path}.")) or not boxes.table.rows:
            continue
        where = printable_name(boxes.table.title or boxes.path or "another table")
        count = count_text(len(boxes.table.rows), "box", "boxes")
        if boxes.has_places and boxes.has_sizes and boxes.table.has_header:
            is_inside = first.path and boxes.path.startswith(f"{first.path}.")
            reason = (
                "because they are inside other boxes, and their places may be relative to these"
                if is_inside
                else "because its columns differ from those of the boxes read"
            )
            lines.append(f"{NOT_READ}{count} in {where}, {reason}")
        elif not (boxes.table.has_header or first.table.has_header) and boxes.table.header == first.table.header:
            lines.append(f"{NOT_READ}{count} in {where}, because only the list with the most boxes is read")
    return lines


def _with_decimal(source: BoxSource, decimal: str) -> BoxSource:
    note = "decimal commas" if decimal == "," else "marks between thousands"
    table = replace(source.boxes.table, decimal=decimal, notes=(*source.boxes.table.notes, note))
    return replace(source, boxes=replace(source.boxes, table=table))


def _plans_of(
    chosen: BoxSource, sources: Sequence[BoxSource], path: Path | None, source: str, wishes: Wishes
) -> ForeignPlans:
    columns = box_columns(chosen, wishes.columns, wishes.units, wishes.masses)
    if not columns.geometries or not columns.n_boxes:
        raise _no_geometry(columns, sources, path, source)
    written = [one for one in columns.geometries if one.columns.items() <= wishes.exact.items()]
    # if several geometries fit the reading that the user has written, the one with the most columns is taken
    written = [max(written, key=lambda one: len(one.columns))] if written else []
    columns = replace(columns, geometries=written or columns.geometries)
    decks, up = named_decks(columns, rows_by_name(plan_names(columns, source, [])))
    if decks and wishes.up in ("", up):
        return _plans_of(_without_decks(chosen, decks), sources, path, source, replace(wishes, up=up))
    builder = PlanBuilder(columns, source, wishes)
    plans = builder.plans()
    if not builder.decks:
        return plans
    return _plans_of(_without_decks(chosen, builder.decks), sources, path, source, wishes)


def _without_decks(chosen: BoxSource, decks: Collection[int]) -> BoxSource:
    """A list of boxes without the rows that describe pallets."""
    table = chosen.boxes.table
    rows = [row for row in range(len(table.rows)) if row not in decks]
    lines = [f"{table.places[row]} is the pallet, and left out" for row in sorted(decks)]
    shown = lines if len(lines) < 3 else [f"{len(lines):,} rows are pallets, and left out"]
    return replace(chosen, boxes=rows_of(chosen.boxes, rows), notes=(*chosen.notes, *shown))


def _no_geometry(columns: BoxColumns, sources: Sequence[BoxSource], path: Path | None, source: str) -> NoGeometry:
    """The error for a file without places or sizes, with advice. If the file appears to have no boxes at all, the error
    is a ``NoBoxes``."""
    boxes = columns.source.boxes
    kinds = set().union(*(other.boxes.kinds for other in sources))
    file = source if path is None else printable(str(path))
    quantities = bool(kinds & {"quantity", "layers"})
    some_sizes = boxes.has_sizes or bool(kinds & {"size", "sizes"})
    n_sizes = max(
        sum(meaning.kind == "size" for meaning in known_meanings(other.boxes.table.header).values())
        for other in (columns.source, *sources)
    )
    sized = some_sizes and n_sizes != 1  # a column for only one of the three sizes is probably not the size of a box
    places_named = bool(boxes.kinds & {"position", "positions", "low"}) or columns.source.form == POSES
    names = f"there are {', '.join(map(printable_name, boxes.table.header[:20]))}"
    if not columns.n_boxes and boxes.table.lost:
        place, fault = boxes.table.lost[0]
        advice = (
            "; does a name in the header contain a blank?" if "fields between white space" in boxes.table.notes else ""
        )
        return NoGeometry(f"holds no box: {place} {fault}{advice}; {names}")
    if not columns.n_boxes:
        return NoGeometry("holds no box")
    items_of_packingsolver = {name.upper() for name in boxes.table.header} >= {"X", "Y", "Z", "COPIES"}
    if quantities and (items_of_packingsolver or (some_sizes and not places_named)):
        content = "quantities and layers" if "layers" in kinds else "quantities"
        return NoGeometry(f"has types of boxes with {content}, but no places; {PACK.format(file=file)}")
    if places_named and not sized:
        can_name = _has_unknown_numbers(columns, "size")
        way = "name their columns with --columns length=NAME,width=NAME,height=NAME, or " if can_name else ""
        return NoGeometry(
            f"has places of boxes, but no sizes: {way}name a file that has them with --items FILE; {names}"
        )
    if sized and not places_named:
        advice = (
            f"name their columns with --columns x=NAME,y=NAME,z=NAME, or {PACK}"
            if _has_unknown_numbers(columns)
            else PACK
        )
        return NoGeometry(f"has sizes of boxes, but no places (x, y, z): {advice.format(file=file)}; {names}")
    if sized:
        lacking = _lacking_axes(columns)
        what = f"the coordinate {joined_names(lacking)}" if lacking else "one of the sizes"
        example = f"{lacking[0] if lacking else 'length'}=NAME"
        return NoGeometry(f"lacks {what} of boxes; {names}; name the columns with --columns {example}")
    advice = "name the columns with --columns length=NAME,width=NAME,height=NAME,x=NAME,y=NAME,z=NAME"
    if some_sizes:
        return NoGeometry(f"lacks some of the sizes, and places (x, y, z) of boxes; {names}; {advice}")
    table = boxes.table
    if table.has_header and path is not None and are_numbers(table.rows, _NUMBERS_OF_A_BOX):
        return NoGeometry(f"no column is known as a size or a place of boxes; {names}; {advice}")
    return NoBoxes(f"lacks places (x, y, z) and sizes of boxes; {names}; {advice}")


def _lacking_axes(columns: BoxColumns) -> list[str]:
    """The axes x, y and z without a column of coordinates; empty if no column has coordinates along
    a single axis."""
    known = filter(None, columns.source.boxes.meanings)
    axes = {one.axis for one in known if one.kind in ("position", "low")}
    named = axes | {AXIS_OF_WORD.get(axis, "") for axis in axes}
    return [axis for axis in XYZ if axis not in named] if axes else []


def _has_unknown_numbers(columns: BoxColumns, *kinds: str) -> bool:
    """Whether at least three columns have numbers that may be places or sizes. Only columns of unknown meaning, and
    columns with a meaning of one of these ``kinds``, are examined."""
    table = columns.source.boxes.table
    meanings = zip(table.header, columns.source.boxes.meanings, strict=True)
    unknown = [table.column(name) for name, meaning in meanings if meaning is None or meaning.kind in kinds]
    numeric = [cells for cells in unknown if all(cell_number(cell, table.decimal) is not None for cell in cells[:20])]
    return len(numeric) > 2
