"""Plans in files of other tools (``read_foreign``). A reading (a meaning for each column) is chosen for the file, and
the boxes become a checked table of placements, as in petmjx's own formats."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable, printable_name, three_digits
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns, box_columns
from petmjx.plans.box_list import BoxList
from petmjx.plans.column_extraction import IGNORED, role_of
from petmjx.plans.column_names import LENGTH_UNITS, MASS_UNITS, column_meanings, plain_text, word_set, words_of
from petmjx.plans.file_formats import NoBoxes, NoGeometry
from petmjx.plans.foreign_formats import sources_of_bytes
from petmjx.plans.header_names import are_numbers
from petmjx.plans.input_conventions import Limits
from petmjx.plans.json_reader import unpacked_bytes
from petmjx.plans.known_forms import PACKINGSOLVER, POSES, BoxSource, rows_of
from petmjx.plans.placement_table import RefusedPlan, Table, as_column
from petmjx.plans.plan_fields import (
    FARTHEST_MM,
    LARGEST_KG,
    LARGEST_MM,
    SMALLEST_KG,
    SMALLEST_MM,
    coordinate_fault,
    positive_fault,
)
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, gaps_mm
from petmjx.plans.raw_cells import GROUPED, cell_number, cell_text, thousands_faults
from petmjx.plans.raw_tables import RawTable
from petmjx.plans.reading_candidates import Candidate, layout_of
from petmjx.plans.reading_choice import TIE, choose_reading, container_of
from petmjx.plans.readings import AmbiguousFile, Reading, Wishes
from petmjx.plans.size_and_place_columns import Geometry

USUAL_KG_M3: Final = 300.0
"""Density of boxes if a file has no weights: that of cartons in BED-BPP's orders. Verdicts hardly depend on a density
that is the same for all boxes."""
_WATER_KG_M3: Final = 1000.0
_RELATIVE: Final = 1.5
"""If no density in a column of densities exceeds this value, the column is relative to the density of water. Otherwise,
it is in kg/m³."""
_LIGHTEST, _HEAVIEST = 2.0, 5000.0
"""Median densities outside these limits, kg/m³, suggest wrong weights or lengths. The lower limit is below the density
of foam, and the upper limit above the density of iron parts."""
_DECK: Final = re.compile(
    r"^\W*(?:euro?|epal|chep|gma)?[\W\d_]*(?:pallet|palette|paleta|palet|pale|bancale|europalette|europallet|epal|eur|skid)\b",
    re.IGNORECASE,
)
"""Names of pallets in lists of boxes, such as "EUR", "EPAL 1", "Euro pallet", "Palette"."""
_OF_DECKS_MM: Final = ((380.0, 580.0), (1320.0, 1500.0))
"""Limits of the sides of a pallet, mm: the smallest short and long side, and the largest short and long side."""
_HIGHEST_DECK_MM: Final = 250.0
_NUMBERS_OF_A_BOX: Final = 6
"""Smallest number of numbers in the row of a box: three sizes and three coordinates."""
_MANY_OVERLAP: Final = 0.3
"""If at least this share of the boxes overlaps, two pallets have probably been read as one."""
_LEVEL: Final = 0.01
"""Largest distance between the bottom of the lowest box and the deck at which the box counts as standing on the deck,
as a share of the boxes' median height: 2 mm for cartons of 200 mm. Centres are often rounded to millimetres."""
_LEAST_OF_PALLETS: Final = 4
"""Smallest number of boxes in a file for which petmjx searches for a column that names the pallets."""
_OF_PALLETS: Final = word_set(
    "pallet pallets palette paletten palet paleta pale palety bancale bancali pal palno palnr palletno palletid palid "
    "lu hu su sscc lpn uld stop unit nosnik ladungstrager ladetrager ladeeinheit carrier container bin"
)
"""Words that mean a pallet in names of columns. The words are used for column names that ``column_names`` does not
know."""
_OF_STACKS: Final = frozenset(("stack", "stacks", "stack id", "stack_id", "stack no", "stack_no", "stackid"))
"""Names of columns that may name pallets, or stacks of one pallet."""
_MATCHED: Final = 0.9
"""A table of items belongs to the boxes if at least this share of the boxes has an item in the table."""
PACK: Final = "pack them first: petmjx samples --orders {file} -o plans.json"


@dataclass(frozen=True, eq=False)
class ForeignPlans:
    """The plans in a file of another tool.

    Attributes:
        table: the usable plans, as a table of placements in millimetres and kilograms; None if no plan is usable.
        refused: the plans and rows that are unusable.
        reading: how the file was read: the meaning of each column, units, and the packing order.
        containers: plan id → size of its container along x, y and z, mm; NaN if unknown.
    """

    table: Table | None
    refused: tuple[RefusedPlan, ...]
    reading: Reading
    containers: Mapping[str, FloatArray]


def read_foreign(
    data: bytes | bytearray, path: Path, source: str, wishes: Wishes, items: Path | None = None
) -> ForeignPlans:
    """Read the plans in a file's bytes.

    Args:
        source: name of the file in messages.
        items: file with the sizes and weights of items, for files that contain only places. If None, such a file is
            searched for in the folder of the file of plans.

    Raises:
        AmbiguousFile: the file can be read in two ways.
        InputError: the file contains no plans. The error lines do not name the file.
    """
    return plans_of_sources(sources_of_bytes(data, path), path, source, wishes, items)


def plans_of_sources(
    sources: Sequence[BoxSource], path: Path | None, source: str, wishes: Wishes, items: Path | None = None
) -> ForeignPlans:
    """Read the plans in lists of boxes, which are sorted by likelihood. Arguments and errors are those of
    :func:`read_foreign`."""
    chosen = _with_items(sources, path, items)
    chosen = replace(chosen, notes=(*chosen.notes, *_other_plans(sources)))
    if chosen.boxes.table.decimal:
        return _plans_of(chosen, sources, path, source, wishes)
    try:
        first = _plans_of(_with_decimal(chosen, ","), sources, path, source, wishes)
    except InputError:
        first = None
    try:
        second = _plans_of(_with_decimal(chosen, GROUPED), sources, path, source, wishes)
    except InputError:
        second = None
    parts = [plans for plans in (first, second) if plans is not None]
    best = min(parts, key=lambda plans: plans.reading.cost, default=None)
    if best is None or (len(parts) == 2 and abs(parts[0].reading.cost - parts[1].reading.cost) < TIE):
        return _plans_of(chosen, sources, path, source, wishes)  # raises the error that names the ambiguous number
    return best


def _other_plans(sources: Sequence[BoxSource]) -> list[str]:
    """Lines about further lists of boxes that have sizes and places, but other columns than the first, and are not
    read."""
    lines = []
    for other in sources[1:]:
        boxes = other.boxes
        if boxes.has_places and boxes.has_sizes and boxes.table.has_header and boxes.table.rows:
            where = printable_name(boxes.table.title or boxes.path or "another table")
            lines.append(f"{count_text(len(boxes.table.rows), 'box', 'boxes')} in {where} not read: other columns")
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
    columns = replace(columns, geometries=written or columns.geometries)
    builder = _Builder(columns, source, wishes)
    plans = builder.plans()
    if not builder.decks:
        return plans
    rows = [row for row in range(columns.n_boxes) if row not in builder.decks]
    lines = [f"{chosen.boxes.table.places[row]} is the pallet, and left out" for row in sorted(builder.decks)]
    shown = lines if len(lines) < 3 else [f"{len(lines):,} rows are pallets, and left out"]
    box_source = replace(chosen, boxes=rows_of(chosen.boxes, rows), notes=(*chosen.notes, *shown))
    return _plans_of(box_source, sources, path, source, wishes)


# Items in another file than the places.


def _with_items(sources: Sequence[BoxSource], path: Path | None, items: Path | None) -> BoxSource:
    """The list of boxes that have places. Missing sizes and weights are added from a table of items."""
    best = sources[0]
    if items is not None:
        tables = sources_of_bytes(bytes_of(items), items)
        joined = with_items_of(best, tables[0], printable(str(items)))
        if joined is None:
            raise InputError(f"{printable(str(items))}: its items do not match the boxes")
        return joined
    if best.boxes.has_places and not best.boxes.has_sizes:
        for other in sources[1:]:
            if (
                other.boxes.has_sizes
                and (joined := with_items_of(best, other, other.boxes.path or "the other table")) is not None
            ):
                return joined
    if path is not None and best.boxes.has_places and not best.boxes.has_sizes:
        return _with_articles_beside(best, path)
    if best.form == PACKINGSOLVER and path is not None:
        return _with_items_beside(best, path)
    return best


_OF_ITEMS: Final = re.compile(r"item|article|artikel|sku|product|produkt", re.IGNORECASE)
_MOST_BESIDE: Final = 20
"""Largest number of files in the folder of a file with places alone that are tried as files of items."""


def _with_articles_beside(best: BoxSource, path: Path) -> BoxSource:
    """Boxes with sizes added from a file of items in the folder of the boxes' file, if the items of exactly one file
    match. Otherwise, the boxes are returned unchanged."""
    try:
        beside = sorted(file for file in path.parent.iterdir() if file != path and _OF_ITEMS.search(file.name))
    except OSError:
        return best
    joined = []
    for file in beside[:_MOST_BESIDE]:
        try:
            source = sources_of_bytes(bytes_of(file), file)[0]
        except InputError:
            continue  # this file has no items for the boxes
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
    """Whether a file has columns with the sizes of boxes and with at least two of their coordinates."""
    try:
        boxes = sources_of_bytes(bytes_of(path), path)[0].boxes
    except InputError:
        return False
    axes = {
        meaning.axis
        for meaning in boxes.meanings
        if meaning is not None and meaning.kind in ("position", "low") and not meaning.of_container
    }
    return boxes.has_sizes and (len(axes) > 1 or bool(boxes.kinds & {"positions", "matrix"}))


def _with_items_beside(best: BoxSource, path: Path) -> BoxSource:
    """packingsolver's certificate with the weights from the file of items beside it, if the sizes in both files
    agree."""
    stem = re.sub(r"_?(solution|certificate|output|result)s?$", "", path.stem, flags=re.IGNORECASE)
    for name in dict.fromkeys((f"{path.stem}_items.csv", f"{stem}_items.csv", "items.csv")):
        beside = path.with_name(name)
        if beside == path or not beside.is_file():
            continue
        joined = with_items_of(best, sources_of_bytes(bytes_of(beside), beside)[0], name, by_number=True)
        if joined is not None:
            return joined
        return replace(best, notes=(*best.notes, f"{name} beside it has other items, and is not read"))
    return replace(best, notes=(*best.notes, "no items file is beside it (NAME_items.csv), which would have weights"))


def with_items_of(best: BoxSource, items: BoxSource, name: str, by_number: bool = False) -> BoxSource | None:
    """Boxes with the columns of a table of items added; None if the items do not belong to the boxes.

    Args:
        by_number: whether the column ID of each box has the number of the row of its item, from 0. If so, the sizes in
            both tables must agree.
    """
    table, other = best.boxes.table, items.boxes.table
    rows = _rows_by_number(table, other) if by_number else _rows_by_name(table, other)
    if rows is None:
        return None
    added = [index for index, column in enumerate(other.header) if column not in table.header]
    if by_number:
        added = [index for index in added if other.header[index].upper() == "WEIGHT"]
    header = (*table.header, *(other.header[index] for index in added))
    cells = [
        (*row, *(None if item is None else other.rows[item][index] for index in added))
        for row, item in zip(table.rows, rows, strict=True)
    ]
    joined = replace(table, header=header, rows=cells)
    note = f"sizes and weights from {name}" if not by_number else f"weights from {name}"
    return replace(best, boxes=replace(best.boxes, table=joined), notes=(*best.notes, note))


def _rows_by_number(table: RawTable, other: RawTable) -> list[int | None] | None:
    upper = {name.upper(): index for index, name in enumerate(table.header)}
    item_columns = {name.upper(): index for index, name in enumerate(other.header)}
    if not {"X", "Y", "Z"} <= item_columns.keys():
        return None
    rows: list[int | None] = []
    alike = 0
    for row in table.rows:
        number = cell_number(row[upper["ID"]])
        index = None if number is None or not 0 <= number.value < len(other.rows) else int(number.value)
        rows.append(index)
        if index is not None:
            one = sorted(number.value for name in ("LX", "LY", "LZ") if (number := cell_number(row[upper[name]])))
            two = sorted(
                number.value for name in "XYZ" if (number := cell_number(other.rows[index][item_columns[name]]))
            )
            alike += len(one) == len(two) and bool(np.allclose(one, two))
    return rows if alike >= _MATCHED * max(len(table.rows), 1) else None


def _rows_by_name(table: RawTable, other: RawTable) -> list[int | None] | None:
    """For each box, the row of its item. Rows are found by the pair of columns (of boxes and items) whose values agree
    best."""
    best, most = None, _MATCHED * max(len(table.rows), 1)
    for item_column in range(len(other.header)):
        names: dict[str, int] = {}
        for number, row in enumerate(other.rows):
            names.setdefault(cell_text(row[item_column]), number)
        names.pop("", None)
        if len(names) < len(other.rows):
            continue
        for box_column in range(len(table.header)):
            rows = [names.get(cell_text(row[box_column])) for row in table.rows]
            matched = sum(row is not None for row in rows)
            text = any(not cell_text(row[box_column]).replace(".", "").isdigit() for row in table.rows[:5])
            if matched + 0.5 * text > most:
                best, most = rows, matched + 0.5 * text
    return best


def _no_geometry(columns: BoxColumns, sources: Sequence[BoxSource], path: Path | None, source: str) -> NoGeometry:
    """The error for a file without places or sizes, with advice. If the file appears to have no boxes at all, the error
    is a ``NoBoxes``."""
    boxes = columns.source.boxes
    kinds = set().union(*(other.boxes.kinds for other in sources))
    file = source if path is None else printable(str(path))
    quantities = bool(kinds & {"quantity", "layers"})
    some_sizes = boxes.has_sizes or bool(kinds & {"size", "sizes"})
    n_sizes = max(
        sum(meaning is not None and meaning.kind == "size" for meaning in column_meanings(other.boxes.table.header))
        for other in (columns.source, *sources)
    )
    sized = some_sizes and n_sizes != 1  # a column for only one of the three sizes is probably not the size of a box
    places_named = bool(boxes.kinds & {"position", "positions", "low", "matrix"}) or columns.source.form == POSES
    if not columns.n_boxes:
        return NoGeometry("holds no box")
    items_of_packingsolver = {name.upper() for name in boxes.table.header} >= {"X", "Y", "Z", "COPIES"}
    if quantities and (items_of_packingsolver or (some_sizes and not places_named)):
        content = "quantities and layers" if "layers" in kinds else "quantities"
        return NoGeometry(f"has types of boxes with {content}, and no places: {PACK.format(file=file)}")
    names = f"there are {', '.join(map(printable_name, boxes.table.header[:20]))}"
    if places_named and not sized:
        return NoGeometry(f"has places of boxes, but no sizes: name a file that has them with --items FILE; {names}")
    if sized and not places_named:
        return NoGeometry(f"has sizes of boxes, but no places (x, y, z): {PACK.format(file=file)}; {names}")
    if sized:
        return NoGeometry(f"lacks one of the sizes or coordinates; {names}; say which with --columns x=NAME,…")
    advice = "say which with --columns length=NAME,width=NAME,height=NAME,x=NAME,y=NAME,z=NAME"
    if some_sizes:
        return NoGeometry(f"lacks some of the sizes, and places (x, y, z) of boxes; {names}; {advice}")
    table = boxes.table
    if table.has_header and path is not None and are_numbers(table.rows, _NUMBERS_OF_A_BOX):
        return NoGeometry(f"no column is known as a size or a place of boxes; {names}; {advice}")
    return NoBoxes(f"lacks places (x, y, z) and sizes of boxes; {names}; {advice}")


# From rows to plans.


class _Builder:
    """Builds the plans from one list of boxes."""

    def __init__(self, columns: BoxColumns, source: str, wishes: Wishes) -> None:
        self.columns, self.source, self.wishes = columns, source, wishes
        self.boxes: BoxList = columns.source.boxes
        self.places = self.boxes.table.places
        self.notes: list[str] = [*columns.source.notes, *self.boxes.table.notes, *self.boxes.left_out]
        self.faults: dict[int, str] = {}
        self.decks: set[int] = set()  # rows that describe a pallet, not a box
        self.of_one: tuple[Reading, Candidate] | None = None  # the chosen reading if all boxes are one plan
        self.counters: set[str] = set()  # columns used as packing order

    def plans(self) -> ForeignPlans:
        self.columns = replace(self.columns, faults={**self._far_cells(), **self.columns.faults})
        unsaid = "plan" not in self.wishes.columns and not self.wishes.exact
        if unsaid and self.columns.plan is None and not any(self.boxes.parts) and self.boxes.table.has_header:
            self._find_pallets()
        elif unsaid and self.columns.columns.get("plan", "").lower() in _OF_STACKS:
            self._ask_about_stacks()
        names = self._plan_names()
        plans = _rows_by(names)
        try:
            lost = self._plans_with_lost(names)
            single_name = self.of_one if len(plans) == 1 and not lost else None
            reading, candidate = single_name or choose_reading(self.columns, plans, self.wishes, lost)
        except InputError:  # no row is good, or the good rows are implausible without the bad ones
            if self.boxes.table.lost:
                place, fault = self.boxes.table.lost[0]
                raise InputError(f"{place}: {fault}") from None
            if (bad_row := self._first_bad_row()) is not None:
                row, fault = bad_row
                plan = "" if self.columns.plan is None else f"plan {printable_name(names[row])}, "
                raise InputError(f"{plan}{self._place_of(row)}: {fault}") from None
            raise
        self.faults = {row: f"{column} {text}" for row, (column, text) in self.columns.faults.items()}
        self._check_words(reading, candidate)
        self._note_quantities()
        size, low, containers = self._geometry(reading, candidate, plans)
        self.decks = self._decks(plans, size, low)
        self._check_ranges(reading, candidate, size, low)
        mass = self._masses(reading, size)
        refused: list[RefusedPlan] = []
        good_rows: dict[str, NDArray[np.int64]] = {}
        sequences: list[NDArray[np.int64]] = []
        orders: list[str] = []
        for name, rows in plans.items():
            location = f"{self.source}: plan {printable_name(name)}"
            if name in lost:
                place, fault = lost[name]
                refused.append(RefusedPlan(name, f"{location}, {place}: {fault}"))
                continue
            bad_rows = [row for row in rows.tolist() if row in self.faults]
            if bad_rows:
                more_text = f" (and {count_text(len(bad_rows) - 1, 'more row')})" if len(bad_rows) > 1 else ""
                refused.append(
                    RefusedPlan(
                        name, f"{location}, {self._place_of(bad_rows[0])}: {self.faults[bad_rows[0]]}{more_text}"
                    )
                )
                continue
            if (twice := self._repeated(rows)) is not None:
                refused.append(RefusedPlan(name, f"{location}, {twice}"))
                continue
            sequence, order = self._sequence(rows, low[rows], size[rows])
            good_rows[name] = rows
            sequences.append(sequence)
            orders.append(order)
        order = self._order_note(orders, list(good_rows))
        if self.columns.unread and self.boxes.table.has_header and not self.columns.source.form.anchor:
            self.notes.append(f"not read: {first_names(self.columns.unread, 4)}")
        if set(orders) == {"sequence"} and len(self.counters) == 1:
            reading = replace(reading, columns={**reading.columns, "sequence": next(iter(self.counters))})
        reading = replace(
            reading,
            order=order,
            notes=tuple(dict.fromkeys((*reading.notes, *self.notes))),
            unused=self._unused(reading) if self.boxes.table.has_header else (),
            odd=self._odd(size, mass),
            density_kg_m3=self._density() if self._lacks_masses() else None,
        )
        table = self._table(list(good_rows.values()), sequences, names, size, low, mass) if good_rows else None
        return ForeignPlans(table, tuple(refused), reading, containers)

    def _check_words(self, reading: Reading, candidate: Candidate) -> None:
        """Note the words of rotations.

        Raises:
            InputError: nothing shows the meaning of the words.
        """
        turns = self.columns.turns
        if turns is None or not turns.words:
            return
        if turns.rules:
            zero, one = (printable_name(word or "blank") for word in turns.words)
            self.notes.append(f"{printable_name(turns.column)}: {zero} is 0, {one} is 1")
        elif not (self.wishes.sizes or self.columns.source.form.sizes or candidate.geometry.placed):
            words = first_names(turns.words)
            raise InputError(
                f"{printable_name(turns.column)} has rotations of unknown meaning ({words}); if sizes are those of the "
                "boxes as placed, say --sizes placed"
            )

    def _note_quantities(self) -> None:
        """Add a note about quantities above 1, unless they count the rows of an article. A row has only one place."""
        table, articles = self.boxes.table, self.columns.article or [""] * self.columns.n_boxes
        if self.columns.source.form == PACKINGSOLVER:  # has its own note
            return
        rows_of_article = Counter(articles)
        for name, meaning in zip(table.header, self.boxes.meanings, strict=True):
            if meaning is None or meaning.kind != "quantity":
                continue
            numbers = [cell_number(cell, table.decimal) for cell in table.column(name)]
            if any(
                number is not None and number.value > 1 and number.value != rows_of_article[article]
                for number, article in zip(numbers, articles, strict=True)
            ):
                self.notes.append(f"{printable_name(name)} is above 1 in some rows, but each row is read as one box")

    def _far_cells(self) -> dict[int, tuple[str, str]]:
        """Row → (column, error text), for sizes and coordinates that are too large in every unit that a reading may
        give them."""
        geometry, form = self.columns.geometries[0], self.columns.source.form
        faults: dict[int, tuple[str, str]] = {}
        for values, largest, names, named_unit in (
            (geometry.size, LARGEST_MM, _size_names(geometry, geometry.columns), geometry.size_unit),
            (geometry.place, FARTHEST_MM, _place_names(geometry.columns), geometry.place_unit),
        ):
            low, high, unit = _limits(-largest, largest, named_unit or self.wishes.units or form.units or "mm")
            with np.errstate(invalid="ignore"):
                is_far = np.abs(values) > high
            for row, axis in np.argwhere(is_far).tolist():
                text = coordinate_fault(names[axis], float(values[row, axis]), low, high, unit)
                if text is not None:
                    faults.setdefault(row, (names[axis], text.removeprefix(f"{names[axis]} ")))
        return faults

    def _first_bad_row(self) -> tuple[int, str] | None:
        """The first row that no reading can use, and its fault: a bad cell, or a size that is not positive. None if all
        rows are good."""
        weight = self.columns.columns.get("weight", "") if self.wishes.density_kg_m3 is not None else ""
        faults = {row: f"{name} {text}" for row, (name, text) in self.columns.faults.items() if name != weight}
        geometries = self.columns.geometries
        is_bad = np.array([~(geometry.size > 0).all(axis=1) for geometry in geometries]).all(axis=0)
        for row in np.flatnonzero(is_bad).tolist():
            axis = int(np.argmin(np.nan_to_num(geometries[0].size[row], nan=math.inf)))
            name = _size_names(geometries[0], geometries[0].columns)[axis]
            faults.setdefault(row, f"{name} must be > 0, got {geometries[0].size[row, axis]:g}")
        return min(faults.items(), default=None)

    def _find_pallets(self) -> None:
        """Find the column that names the pallets, if boxes of different pallets would overlap without it. Exactly one
        column must separate the pallets.

        Raises:
            InputError: the column does not have a word for pallets in its name, or several columns separate the
                pallets.
        """
        columns = self.columns
        rows = np.arange(columns.n_boxes)
        faultless = not columns.faults
        repeats_numbers = columns.sequence is not None and len(set(columns.sequence.tolist())) < len(rows)
        if (
            len(rows) < _LEAST_OF_PALLETS
            or not faultless
            or not (repeats_numbers or self._overlaps({"": rows}, _MANY_OVERLAP))
        ):
            return
        used = {name for geometry in columns.geometries for name in geometry.columns.values()}
        used |= {columns.columns.get(role, "") for role in ("weight", "density", "rotation", "sequence")}
        separating: dict[tuple[int, ...], list[str]] = {}
        for name in self.boxes.table.header:
            texts = [cell_text(cell) for cell in self.boxes.table.column(name)]
            groups = _rows_by(texts)
            if name in used or "" in groups or not 2 <= len(groups) <= len(rows) / 2:
                continue
            if any(self._repeated(group) is not None for group in groups.values()) or self._overlaps(groups, 0.0):
                continue
            numbers = {text: number for number, text in enumerate(groups)}
            separating.setdefault(tuple(numbers[text] for text in texts), []).append(name)
        if not separating:
            return
        pallet_names = [[name for name in names if _OF_PALLETS & set(words_of(name))] for names in separating.values()]
        sure = [names[0] for names in pallet_names if names]
        if len(sure) != 1:
            names = [names[0] for names in separating.values()]
            cause = "numbers of the packing order occur twice" if repeats_numbers else "boxes overlap"
            raise InputError(
                f"{cause}, but not if {' or '.join(map(printable_name, names))} separates pallets; say which with "
                f"{' or '.join(f'--columns plan={printable_name(name)}' for name in (*names, IGNORED))} (one pallet)"
            )
        texts = [cell_text(cell) for cell in self.boxes.table.column(sure[0])]
        self.columns = replace(columns, plan=texts, columns={**columns.columns, "plan": sure[0]})
        self.notes.append(f"several pallets, by {printable_name(sure[0])}")

    def _ask_about_stacks(self) -> None:
        """Refuse a column of stacks if all boxes together could be one plan.

        Raises:
            InputError: no box overlaps or floats if the stacks are one plan.
        """
        name, names = self.columns.columns["plan"], self.columns.plan or []
        if len(set(names)) < 2 or self.columns.faults:
            return
        of_one = self._overlaps({"": np.arange(self.columns.n_boxes)}, 0.0)
        if not of_one:
            shown = printable_name(name)
            raise InputError(
                f"{shown} may name pallets, or stacks of one pallet; say which with --columns plan={shown} or "
                f"--columns plan={IGNORED} (one pallet)"
            )

    def _overlaps(self, plans: Mapping[str, NDArray[np.int64]], share: float) -> bool:
        """Whether, in the most plausible reading, more than the given share of the boxes overlaps other boxes, or any
        box floats."""
        try:
            choice = choose_reading(self.columns, plans, self.wishes)
            evidence = choice[0].evidence
            self.of_one = choice if len(plans) == 1 else self.of_one
        except AmbiguousFile as error:
            evidence = error.readings[0].evidence
        except InputError:
            return False
        return evidence.n_overlapping > share * evidence.n_boxes or (not share and evidence.n_floating > 0)

    def _place_of(self, row: int) -> str:
        """The place of a row in the file, with the name of its box."""
        ids = self.columns.item_id
        name = "" if ids is None or not ids[row] else f" ({printable_name(ids[row])})"
        return f"{self.places[row]}{name}"

    def _plans_with_lost(self, names: Sequence[str]) -> dict[str, tuple[str, str]]:
        """Name of each plan that lacks a row → (place, fault) of the first missing row.

        An unreadable row may belong to the plan before or after it, so both plans are refused.
        """
        numbers = [_number_of(place, row) for row, place in enumerate(self.places)]
        lost: dict[str, tuple[str, str]] = {}
        for place, fault in self.boxes.table.lost:
            number = _number_of(place, 0)
            before = max((row for row in range(len(numbers)) if numbers[row] < number), default=0)
            after = min((row for row in range(len(numbers)) if numbers[row] > number), default=len(names) - 1)
            for row in (before, after):
                lost.setdefault(names[row], (place, fault))
        return lost

    def _plan_names(self) -> list[str]:
        """(n,) the name of the plan of each row. If the names are numbers of containers, the file's name comes before
        them, so that plans of different files have different names.
        """
        parts = self.boxes.parts or ("",) * self.columns.n_boxes
        column = self.columns.plan
        if column is not None and len(set(column)) * 2 > self.columns.n_boxes + 2 and len(set(column)) > 1:
            column = None  # nearly every row has another name, so the column does not name plans
        stem = Path(self.source).name.split(".")[0] or "plan"
        names = [
            "/".join(filter(None, (part, "" if column is None else column[row]))) for row, part in enumerate(parts)
        ]
        if not any(names):
            self.notes.append(f"no plan_id: {printable_name(stem)}")
            return [stem] * len(names)
        words = words_of(self.columns.columns.get("plan", ""))
        if "plan" in words or "order" in words:  # the names are names of plans, not numbers of containers
            return [name or stem for name in names]
        if len(set(names)) == 1 and names[0].isdigit():
            return [stem] * len(names)  # there is only one container
        return [f"{stem}/{name}" if name.isdigit() else name or stem for name in names]

    def _decks(self, plans: Mapping[str, NDArray[np.int64]], size: FloatArray, low: FloatArray) -> set[int]:
        """Numbers of the rows that describe a pallet, not a box: these rows are named as a pallet, have the size of a
        pallet, and lie below all boxes."""
        decks = set()
        for rows in plans.values():
            if len(rows) < 2 or np.isnan(low[rows]).any():
                continue
            row = int(rows[np.argmin(low[rows, 2])])
            top = low[row, 2] + size[row, 2] - DEFAULT_TOLERANCE_MM
            above = bool((low[rows[rows != row], 2] >= top).all())
            names = [cell for cell in self.boxes.table.rows[row] if isinstance(cell, str)]
            level = np.sort(size[row, :2])
            narrow, wide = _OF_DECKS_MM
            as_large = narrow[0] <= level[0] <= wide[0] and narrow[1] <= level[1] <= wide[1]
            if (
                above
                and as_large
                and size[row, 2] <= _HIGHEST_DECK_MM
                and any(map(_DECK.search, map(plain_text, names)))
            ):
                decks.add(row)
        return decks

    def _geometry(
        self, reading: Reading, candidate: Candidate, plans: Mapping[str, NDArray[np.int64]]
    ) -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
        """(n, 3) sizes and (n, 3) corners along the plan's axes, and the sizes of the containers, all in mm."""
        factor = LENGTH_UNITS[reading.length_units[1]]
        n = self.columns.n_boxes
        size, low = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        containers: dict[str, FloatArray] = {}
        layout = layout_of(self.columns, candidate)
        for name, rows in plans.items():
            container = layout_of(self.columns, candidate, container_of(self.boxes.containers, name)).container * factor
            if self.wishes.deck_mm is not None and np.isnan(container[:2]).any():
                container = np.array([*self.wishes.deck_mm, np.nan])
            containers[name] = container
            size[rows], low[rows] = layout.size[rows] * factor, layout.low[rows] * factor
        usable = np.array([row not in self.columns.faults for row in range(n)])
        good_rows = {name: rows[usable[rows]] for name, rows in plans.items() if usable[rows].any()}
        bottoms = self._bottoms(low, good_rows, size, containers)
        moved = {
            self._move(low, plans[name], rows, size, containers[name], reading, bottoms[name])
            for name, rows in good_rows.items()
        }
        self.notes += sorted(filter(None, moved))
        return size, low, containers

    @staticmethod
    def _bottoms(
        low: FloatArray, plans: Mapping[str, NDArray[np.int64]], size: FloatArray, containers: Mapping[str, FloatArray]
    ) -> dict[str, float]:
        """Height of the deck of each plan, mm. All plans of a file measure heights from the same level.

        This level is 0 if the lowest box of any plan is at 0; else it is the height of the lowest box of the file. So a
        plan that lacks its bottom layer floats. If heights are measured from the middle of a container, the deck is at
        the plan's own lowest box (half the container's height below 0).
        """
        small = {name: _LEVEL * float(np.nanmedian(size[rows, 2])) for name, rows in plans.items()}
        lowest = {name: float(np.nanmin(low[rows, 2])) for name, rows in plans.items()}
        of_middle = {
            name
            for name, z in lowest.items()
            if abs(z) > small[name] and abs(z + containers[name][2] / 2) <= small[name]
        }
        others = {name: z for name, z in lowest.items() if name not in of_middle}
        begins = any(abs(z) <= small[name] for name, z in others.items())
        level = 0.0 if begins else min(others.values(), default=0.0)
        return {name: z if name in of_middle or abs(z - level) <= small[name] else level for name, z in lowest.items()}

    def _move(
        self,
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
        small = _LEVEL * float(np.nanmedian(size[used, 2]))
        if abs(bottom) > small:
            low[rows, 2] -= bottom
            notes.append(f"heights count from the lowest box, {bottom:g} mm")
        elif bottom:
            low[rows, 2] = np.where(np.abs(low[rows, 2]) <= abs(bottom), 0.0, low[rows, 2])
        if reading.origin == "middle":
            begin = np.nanmin(low[used, :2], axis=0)
            shift = container[:2] / 2 if not np.isnan(container[:2]).any() else -begin
            low[rows, :2] += shift
            notes.append("the origin is the middle of the carrier")
        else:
            begin = np.nanmin(low[used, :2], axis=0)
            shift = np.where(begin < -DEFAULT_TOLERANCE_MM, -begin, 0.0)
            if shift.any():
                low[rows, :2] += shift
                notes.append("the origin is another corner of the carrier")
        return "; ".join(notes)

    def _check_ranges(self, reading: Reading, candidate: Candidate, size: FloatArray, low: FloatArray) -> None:
        """Add faults for sizes and coordinates that are out of range. A fault names the column."""
        sizes, places = reading.length_units
        named_sizes = _size_names(candidate.geometry, reading.columns)
        named_places = _place_names(reading.columns)
        for role, name in candidate.geometry.columns.items():
            are_sizes = role.removesuffix(" (far)") not in {*"xyz", "position"}
            cells = self.boxes.table.column(name) if name in self.boxes.table.header else ()
            unit = sizes if are_sizes else places
            for row, text in thousands_faults(cells, self.boxes.table.decimal, unit, are_sizes).items():
                self.faults.setdefault(row, f"{name} {text}")
        size_limits = _limits(SMALLEST_MM, LARGEST_MM, sizes)
        place_limits = _limits(-FARTHEST_MM, FARTHEST_MM, places)
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
                    self.faults.setdefault(row, fault)

    def _lacks_masses(self) -> bool:
        weight = self.columns.weight
        return weight is None or (self.wishes.density_kg_m3 is not None and bool(np.isnan(weight).any()))

    def _density(self) -> float:
        return self.wishes.density_kg_m3 or USUAL_KG_M3

    def _masses(self, reading: Reading, size: FloatArray) -> FloatArray:
        """(n,) masses, kg. Missing masses are computed from the density."""
        columns, volume = self.columns, size.prod(axis=1) / 1e9
        density = self._density()
        if columns.weight is None:
            self.notes.append(f"no weights: {density:g} kg/m³ (--density)")
            return np.asarray(volume * density)
        if columns.weight_is_density:
            relative = np.nanmax(columns.weight) <= _RELATIVE
            self.notes.append(f"weights by density, {'relative to water' if relative else 'kg/m³'}")
            return np.asarray(volume * columns.weight * (_WATER_KG_M3 if relative else 1.0))
        name = columns.columns["weight"]
        mass = columns.weight * MASS_UNITS[reading.masses]
        empty = np.isnan(mass) | ~(mass > 0)
        if self.wishes.density_kg_m3 is not None and empty.any():
            self.notes.append(f"{count_text(int(empty.sum()), 'missing weight')}: {density:g} kg/m³")
            for row in np.flatnonzero(empty).tolist():
                if self.columns.faults.get(row, ("", ""))[0] == name:
                    self.faults.pop(row, None)
            return np.asarray(np.where(empty, volume * density, mass))
        limits = _limits(SMALLEST_KG, LARGEST_KG, reading.masses, MASS_UNITS)
        for row in np.flatnonzero((mass < SMALLEST_KG) | (mass > LARGEST_KG)).tolist():
            fault = positive_fault(name, float(columns.weight[row]), *limits)
            if fault is not None:
                self.faults.setdefault(row, fault)
        return np.asarray(mass)

    def _unused(self, reading: Reading) -> tuple[str, ...]:
        """Names of the columns that a reading does not use."""
        used = set(reading.columns.values())
        return tuple(
            name
            for name in self.boxes.table.header
            if name not in used and name.rpartition("[")[0] not in used and name not in self.columns.unit_columns
        )

    def _odd(self, size: FloatArray, mass: FloatArray) -> tuple[str, ...]:
        """Lines about densities that no load of a pallet can have."""
        with np.errstate(invalid="ignore", divide="ignore"):
            density = mass / (size.prod(axis=1) / 1e9)
        density = density[np.isfinite(density)]
        if self.columns.weight is None or not len(density) or _LIGHTEST <= np.median(density) <= _HEAVIEST:
            return ()
        line = f"boxes have {three_digits(float(np.median(density)))} kg/m³ in the median"
        return (f"{line}: weights or lengths in another unit? (--units)",)

    def _sequence(self, rows: NDArray[np.int64], low: FloatArray, size: FloatArray) -> tuple[NDArray[np.int64], str]:
        """(n,) packing order of a plan's rows, from 1, and the source of this order ("sequence", "rows" or
        "height")."""
        if self.columns.sequence is not None:
            return self.columns.sequence[rows].astype(np.int64), "sequence"
        order = np.arange(1, len(rows) + 1)
        possible = _can_be_placed(order, low, size)
        for name, values in self.columns.counters.items():
            counted = values[rows]
            if np.isnan(counted).any() or not _counts_all(counted) or not (np.diff(counted) != 1).any():
                continue  # some boxes have no number, or the numbers only repeat the order of the rows
            if not _can_be_placed(counted, low, size):
                continue
            if not possible:
                self.notes.append(f"packing order by {printable_name(name)}: rows are not in packing order")
                self.counters.add(name)
                return counted.astype(np.int64), "sequence"
            self.notes.append(
                f"{printable_name(name)} may be the packing order, too (--columns sequence={printable_name(name)})"
            )
        if not possible:
            order[np.argsort(low[:, 2], kind="stable")] = np.arange(1, len(rows) + 1)
            return order, "height"
        return order, "rows"

    def _repeated(self, rows: NDArray[np.int64]) -> str | None:
        """The fault of a plan's packing order: a number that is repeated or is not whole. None if there is no fault."""
        sequence = self.columns.sequence
        if sequence is None:
            return None
        name, first_rows = self.columns.columns["sequence"], dict[float, int]()
        for row in rows.tolist():
            value = float(sequence[row])
            if not value.is_integer():
                return f"{self.places[row]}: {name} must be a whole number, got {value:g}"
            if value in first_rows:
                plans = "" if self.columns.plan else "; several plans? then name their column: --columns plan=NAME"
                return f"{self.places[first_rows[value]]} and {self.places[row]}: {name} {value:g} occurs twice{plans}"
            first_rows[value] = row
        return None

    def _order_note(self, orders: Sequence[str], names: Sequence[str]) -> str:
        """Returns the source of the packing order ("sequence", "rows" or "height"). Adds a note if no column gives the
        packing order."""
        sorted_plans = [name for name, order in zip(names, orders, strict=False) if order == "height"]
        if sorted_plans:
            plans_text = "" if len(orders) == 1 else f" in {first_names(sorted_plans, 3)}"
            self.notes.append(f"rows are not in packing order{plans_text}: boxes are placed from the ground up")
            return "height"
        if "rows" in orders or not orders:
            self.notes.append("no sequence: the order of rows")
            return "rows"
        return "sequence"

    def _table(
        self,
        good: Sequence[NDArray[np.int64]],
        sequences: Sequence[NDArray[np.int64]],
        names: Sequence[str],
        size: FloatArray,
        low: FloatArray,
        mass: FloatArray,
    ) -> Table:
        rows = np.concatenate(good)
        columns = self.columns
        article = columns.article or columns.item_id
        if columns.article is None:
            self.notes.append("no article" + (": names of boxes" if article is not None else ""))
        if article is None:
            article = [""] * columns.n_boxes
        values: dict[str, Any] = {
            "plan_id": [names[row][:1000] for row in rows.tolist()],
            "sequence": np.concatenate(sequences),
            "article": [article[row][:1000] for row in rows.tolist()],
            **{name: size[rows, axis] for axis, name in enumerate(("length_mm", "width_mm", "height_mm"))},
            "weight_kg": mass[rows],
            **{name: low[rows, axis] + 0.0 for axis, name in enumerate(("x_mm", "y_mm", "z_mm"))},
        }
        for name, texts in (("item_id", columns.item_id), ("product_group", columns.group)):
            if texts is not None and any(texts):
                values[name] = [texts[row][:1000] for row in rows.tolist()]
        numbers = np.array([_number_of(self.places[row], row) for row in rows.tolist()], np.int64)
        return Table({name: as_column(column) for name, column in values.items()}, (), numbers)


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


def _rows_by(names: Sequence[str]) -> dict[str, NDArray[np.int64]]:
    """Name → numbers of the rows that have this name."""
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
    return {name: np.array(some, np.int64) for name, some in rows.items()}


def _counts_all(values: FloatArray) -> bool:
    """Whether the n numbers are 0, 1, … n − 1 or 1, 2, … n, each once and in any order."""
    return bool((np.sort(values) - np.arange(len(values)) == min(max(float(values.min()), 0.0), 1.0)).all())


def _can_be_placed(order: NDArray[Any], low: FloatArray, size: FloatArray) -> bool:
    """Whether, in this packing order, each box that lies on other boxes is placed after at least one of the boxes below
    it."""
    by_order = np.argsort(order, kind="stable")
    low, size = low[by_order], size[by_order]
    in_order = gaps_mm(low, size) > DEFAULT_TOLERANCE_MM
    at_all = gaps_mm(low, size, in_order=False) > DEFAULT_TOLERANCE_MM
    return not (in_order & ~at_all).any()


def _number_of(place: str, otherwise: int) -> int:
    match = re.search(r"(\d+)\D*$", place)
    return int(match[1]) if match is not None and len(match[1]) < 10 else otherwise


_UNIT_NAMES: Final = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches", "kg": "kilograms"}


def _limits(low: float, high: float, unit: str, units: Mapping[str, float] = LENGTH_UNITS) -> Limits:
    factor = units[unit]
    return Limits(low / factor, high / factor, _UNIT_NAMES.get(unit, unit))
