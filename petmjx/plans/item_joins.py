"""Adds the sizes and weights of items to boxes that have only places. The items are in another table of the same file,
or in another file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.plans.cell_numbers import cell_number, cell_text
from petmjx.plans.column_names import column_meanings, known_meanings, unit_in, word_set
from petmjx.plans.foreign_formats import sources_of_bytes
from petmjx.plans.json_reader import unpacked_bytes
from petmjx.plans.known_forms import PACKINGSOLVER, BoxSource
from petmjx.plans.raw_tables import RawTable

_LEAST_MATCHED_SHARE: Final = 0.9
"""A table of items belongs to the boxes if at least this share of the boxes has an item in the table."""
_MEASURES: Final = word_set(
    "size sizes position positions low high quaternion euler weight density volume quantity sequence"
)
"""Kinds of columns that cannot name the item of a box: if a box and an item have equal numbers in such columns, this is
chance."""
_OF_WEIGHT: Final = word_set("weight density")
_OF_ITEMS: Final = re.compile(r"item|article|artikel|sku|product|produkt", re.IGNORECASE)
_MOST_BESIDE: Final = 20
"""If a file of plans has only places, at most this number of files in its folder are tried as files of items."""


def with_items(sources: Sequence[BoxSource], path: Path | None, items: Path | None) -> BoxSource:
    """The first of the given lists of boxes. If its boxes lack sizes or weights, these are added from a table of items:
    the file ``items``, one of the other lists, or a file in the folder of ``path``."""
    best = sources[0]
    if items is not None:
        tables = sources_of_bytes(bytes_of(items), items)
        joined = with_items_of(best, tables[0], printable(str(items)))
        if joined is None:
            raise InputError(f"{printable(str(items))}: its items do not match the boxes")
        return joined
    if best.boxes.has_places and not best.boxes.has_sizes:
        for other in sources[1:]:
            name = other.boxes.path or "the other table"
            if other.boxes.has_sizes and (joined := with_items_of(best, other, name)) is not None:
                return joined
        return best if path is None else _with_articles_beside(best, path)
    if best.form == PACKINGSOLVER and path is not None:
        return _with_items_beside(best, path)
    if best.boxes.has_places and not best.boxes.kinds & _OF_WEIGHT:
        for other in sources[1:]:
            if (joined := _with_weights_of(best, other)) is not None:
                return joined
    return best


def _with_articles_beside(best: BoxSource, path: Path) -> BoxSource:
    """The boxes, with sizes from a file of items that is in the same folder as the file of the boxes. If the items of
    no file or of several files match the boxes, the boxes are returned unchanged."""
    try:
        beside = sorted(file for file in path.parent.iterdir() if file != path and _OF_ITEMS.search(file.name))
    except OSError:
        return best
    joined = []
    for file in beside[:_MOST_BESIDE]:
        try:
            source = sources_of_bytes(bytes_of(file), file)[0]
        except InputError:
            continue  # the file cannot be read, so it has no items
        if source.boxes.has_sizes and (completed := with_items_of(best, source, file.name)) is not None:
            joined.append(completed)
    return joined[0] if len(joined) == 1 else best


def bytes_of(path: Path) -> bytearray:
    try:
        data, fault = unpacked_bytes(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{printable(str(path))}: cannot be read ({reason(error)})") from None
    if fault is not None:
        raise InputError(f"{printable(str(path))}: {fault}")
    return data


def has_named_places(path: Path) -> bool:
    """Whether a file has columns with the sizes of boxes and with at least two of their coordinates. Three columns of
    lengths whose words are unknown ("Links (mm)") are probably coordinates, too."""
    try:
        boxes = sources_of_bytes(bytes_of(path), path)[0].boxes
    except InputError:
        return False
    axes = {
        meaning.axis
        for meaning in boxes.meanings
        if meaning is not None and meaning.kind in ("position", "low") and not meaning.of_container
    }
    named = zip(boxes.table.header, boxes.meanings, strict=True)
    n_lengths = sum(meaning is None and unit_in(name) != "" for name, meaning in named)
    return boxes.has_sizes and (len(axes) > 1 or n_lengths > 2 or "positions" in boxes.kinds)


def _with_items_beside(best: BoxSource, path: Path) -> BoxSource:
    """The boxes of packingsolver's certificate (its file of a solution), with weights added from the file of items in
    the same folder if the sizes in both files agree."""
    stem = re.sub(r"_?(solution|certificate|output|result)s?$", "", path.stem, flags=re.IGNORECASE)
    for name in dict.fromkeys((f"{path.stem}_items.csv", f"{stem}_items.csv", "items.csv")):
        beside = path.with_name(name)
        if beside == path or not beside.is_file():
            continue
        joined = with_items_of(best, sources_of_bytes(bytes_of(beside), beside)[0], name, by_number=True)
        if joined is not None:
            return joined
        return replace(best, notes=(*best.notes, f"{name} in the same folder has other items, and is not read"))
    return replace(best, notes=(*best.notes, "no weights, because the folder has no file of items (NAME_items.csv)"))


def with_items_of(best: BoxSource, items: BoxSource, name: str, by_number: bool = False) -> BoxSource | None:
    """Boxes with the columns of a table of items added; None if the items do not belong to the boxes.

    Args:
        by_number: whether items are found by number: the ID of a box is the number of its item's row in the table of
            items, from 0. In this case, the sizes of boxes and items must agree.
    """
    table, other = best.boxes.table, items.boxes.table
    rows = _rows_by_number(table, other) if by_number else _rows_by_name(table, other)
    if rows is None:
        return None
    added = [index for index, column in enumerate(other.header) if column not in table.header]
    if by_number:
        added = [index for index in added if other.header[index].upper() == "WEIGHT"]
    if not best.boxes.has_sizes:  # tables of items have the sizes before boxes are turned, which the form then states
        best = replace(best, form=replace(best.form, sizes=best.form.sizes or "item"))
    return _with_columns(best, other, rows, added, f"{'' if by_number else 'sizes and '}weights from {name}")


def _with_weights_of(best: BoxSource, items: BoxSource) -> BoxSource | None:
    """Boxes with the weights of the items in another list of the same file. The boxes have sizes. The result is None if
    the names or sizes of the boxes and the items do not agree."""
    table, other = best.boxes.table, items.boxes.table
    weights = [index for index, meaning in enumerate(items.boxes.meanings) if meaning and meaning.kind in _OF_WEIGHT]
    rows = _rows_by_name(table, other) if weights and items.boxes.has_sizes else None
    if rows is None or not _agree(rows, _sorted_sizes(table), _sorted_sizes(other)):
        return None
    return _with_columns(best, other, rows, weights, f"weights from {items.boxes.path or 'the other table'}")


def _with_columns(
    best: BoxSource, other: RawTable, rows: Sequence[int | None], added: Sequence[int], note: str
) -> BoxSource:
    """The boxes, with the columns ``added`` of a table of items. For each box, ``rows`` has the row of its item; None:
    the box has no item."""

    def cell(row: int, index: int) -> Any:
        number = cell_number(other.rows[row][index], ",") if other.decimal == "," else None
        # a text with a decimal comma becomes a number, since the table of the boxes may have decimal points
        return other.rows[row][index] if number is None or number.unit else number.value

    table = best.boxes.table
    header = (*table.header, *(other.header[index] for index in added))
    cells = [
        (*box, *(None if item is None else cell(item, index) for index in added))
        for box, item in zip(table.rows, rows, strict=True)
    ]
    joined = replace(table, header=header, rows=cells)
    return replace(best, boxes=replace(best.boxes, table=joined), notes=(*best.notes, note))


def _sorted_sizes(table: RawTable, names: Sequence[str] = ()) -> list[list[float]]:
    """For each row, the numbers in the columns with these names (in capital letters; without names, in all columns of
    sizes), in ascending order."""
    sizes = {name for name, meaning in known_meanings(table.header).items() if meaning.kind == "size"}
    indices = [k for k, name in enumerate(table.header) if (name.upper() in names if names else name in sizes)]
    numbers = [[cell_number(row[index], table.decimal) for index in indices] for row in table.rows]
    return [sorted(number.value for number in row if number is not None) for row in numbers]


def _agree(rows: Sequence[int | None], one: Sequence[Sequence[float]], two: Sequence[Sequence[float]]) -> bool:
    """Whether nearly all boxes (sizes ``one``) have the sizes of their items (``two``)."""
    pairs = [(one[row], two[item]) for row, item in enumerate(rows) if item is not None]
    alike = sum(len(a) == len(b) and bool(np.allclose(a, b)) for a, b in pairs)
    return alike >= _LEAST_MATCHED_SHARE * max(len(rows), 1)


def _rows_by_number(table: RawTable, other: RawTable) -> list[int | None] | None:
    if not {"X", "Y", "Z"} <= {name.upper() for name in other.header}:
        return None
    ids = next(index for index, name in enumerate(table.header) if name.upper() == "ID")
    numbers = [cell_number(row[ids]) for row in table.rows]
    last = len(other.rows) - 1
    rows = [int(number.value) if number is not None and 0 <= number.value <= last else None for number in numbers]
    sizes = _sorted_sizes(table, ("LX", "LY", "LZ"))
    return rows if _agree(rows, sizes, _sorted_sizes(other, ("X", "Y", "Z"))) else None


def _naming_columns(table: RawTable) -> list[int]:
    """Columns that may name items: all columns except those with sizes, places, weights or running numbers of rows."""
    running = [str(number) for number in range(1, len(table.rows) + 1)]
    return [
        index
        for index, meaning in enumerate(column_meanings(table.header))
        if (meaning is None or meaning.kind not in _MEASURES)
        and (len(running) < 2 or [*map(cell_text, table.cells(index))] != running)
    ]


def _rows_by_name(table: RawTable, other: RawTable) -> list[int | None] | None:
    """For each box, the row of its item. An item belongs to a box if both have the same value in a column of names. Of
    all pairs of a column of boxes and a column of items, the pair whose values agree most often is used."""
    best, most = None, _LEAST_MATCHED_SHARE * max(len(table.rows), 1)
    box_columns = _naming_columns(table)
    for item_column in _naming_columns(other):
        names: dict[str, int] = {}
        for number, cell in enumerate(other.cells(item_column)):
            names.setdefault(cell_text(cell), number)
        names.pop("", None)
        if len(names) < len(other.rows):
            continue
        for box_column in box_columns:
            texts = [*map(cell_text, table.cells(box_column))]
            rows = [*map(names.get, texts)]
            matched = sum(row is not None for row in rows)
            are_words = any(not text.replace(".", "").isdigit() for text in texts[:5])
            if matched + 0.5 * are_words > most:
                best, most = rows, matched + 0.5 * are_words
    return best
