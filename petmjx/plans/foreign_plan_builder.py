"""Builds plans from the boxes of another tool's file (``PlanBuilder``): the rows of the file, interpreted by one
reading (units, vertical axis …), become a checked table of placements."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import first_names, printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.column_extraction import HALF_EXTENTS, IGNORED, LAST_CELLS
from petmjx.plans.column_names import ALL_SIZE_WORDS, known_meanings, plain_text, split_unit, word_set
from petmjx.plans.known_forms import PACKINGSOLVER
from petmjx.plans.masses_and_densities import assumed_density, masses_kg
from petmjx.plans.placed_boxes import (
    edge_faults,
    empty_rows,
    far_cells,
    fault_of_rows,
    first_bad_row,
    height_fault,
    pallet_rows,
    placed_boxes,
    range_faults,
    rows_below_deck,
)
from petmjx.plans.placement_table import RefusedPlan, Table, as_column
from petmjx.plans.plan_fields import too_many_boxes
from petmjx.plans.plan_rows import PalletSearch, packing_order, plan_names, repeated_number
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, overlap
from petmjx.plans.raw_tables import BoxList, names_with_lost_rows, row_number, rows_by_name
from petmjx.plans.reading_candidates import Candidate
from petmjx.plans.reading_choice import choose_reading
from petmjx.plans.readings import SEVERAL, AmbiguousFile, Reading, Wishes

_MOST_COMPARED: Final = 3000
"""Largest number of boxes of a plan that are compared in pairs."""


@dataclass(frozen=True, eq=False)
class ForeignPlans:
    """The plans in a file of another tool.

    Attributes:
        table: the usable plans, as a table of placements in millimetres and kilograms; None if no plan is usable.
        refused: the plans and rows that are unusable.
        reading: how the file was read: the meaning of each column, units, and the packing order.
    """

    table: Table | None
    refused: tuple[RefusedPlan, ...]
    reading: Reading


class PlanBuilder:
    """Builds the plans from one list of boxes."""

    def __init__(self, columns: BoxColumns, source: str, wishes: Wishes) -> None:
        self.columns, self.source, self.wishes = columns, source, wishes
        self.boxes: BoxList = columns.source.boxes
        self.places = self.boxes.table.places
        self.notes: list[str] = [*columns.source.notes, *self.boxes.table.notes, *self.boxes.left_out]
        self.faults: dict[int, str] = {}
        self.decks: set[int] = set()  # rows that describe a pallet, not a box

    def plans(self) -> ForeignPlans:
        names, lost, reading, candidate = self._choice()
        plans, refused = self._plans_of_size(names)
        self._find_faults(reading, candidate, plans)
        self._check_words(reading, candidate)
        self._note_columns(reading, candidate)
        size, low = placed_boxes(self.columns, reading, candidate, plans, self.wishes, self.faults, self.notes)
        self._note_plans_apart(plans, size, low)
        for row in rows_below_deck(low, plans, size):
            self.faults.setdefault(row, height_fault(reading, candidate, row))
        self.decks = pallet_rows(self.columns, plans, size, low)
        mass = masses_kg(
            *(self.columns, reading.masses, size, self.wishes, self.faults, self.notes),
            length_unit=reading.length_units[0],
        )
        sequences: dict[str, NDArray[np.int64]] = {}
        orders: dict[str, str] = {}
        counters: set[str] = set()  # names of columns of running numbers that are used as packing order
        for name, rows in plans.items():
            if name in lost:
                refusal: str | None = ": ".join(lost[name])
            else:
                refusal = fault_of_rows(rows.tolist(), self.faults, self._place_of)
                refusal = refusal or repeated_number(self.columns, rows)
            if refusal is not None:
                refused.append(RefusedPlan(name, f"{self.source}: plan {printable_name(name)}, {refusal}"))
                continue
            sequences[name], orders[name], counter = packing_order(
                self.columns, rows, low[rows], size[rows], self.notes
            )
            counters |= {counter} - {""}
        order_source = self._order_note(orders)
        guess = [self.columns.columns["rotation"]] if self.columns.turns and "rotation" not in reading.columns else []
        unread = (*guess, *self.columns.unread)
        if unread and self.boxes.table.has_header and not self.columns.source.form.anchor:
            self.notes.append(f"columns not read: {first_names(unread, 4)}")
        if set(orders.values()) == {"sequence"} and len(counters) == 1:
            reading = replace(reading, columns={**reading.columns, "sequence": counters.pop()})
        reading = replace(
            reading,
            order=order_source,
            notes=tuple(dict.fromkeys((*reading.notes, *self.notes))),
            unused=self._unused(reading) if self.boxes.table.has_header else (),
            density_kg_m3=assumed_density(self.columns, self.wishes),
        )
        good_rows = [plans[name] for name in sequences]
        table = self._table(good_rows, [*sequences.values()], names, size, low, mass) if sequences else None
        return ForeignPlans(table, tuple(refused), reading)

    def _choice(self) -> tuple[list[str], dict[str, tuple[str, str]], Reading, Candidate]:
        """Choose the most plausible reading. Returns four values: (n,) the name of each row's plan; the plans that lack
        rows (``names_with_lost_rows``); the reading; and the candidate (a reading without units) from which the reading
        was made.

        Raises:
            InputError: the file can be read in several ways, or no row is good.
        """
        faults = {**empty_rows(self.columns), **far_cells(self.columns, self.wishes), **self.columns.faults}
        self.columns = replace(self.columns, faults=faults)
        if self.wishes.exact.get("plan") == IGNORED:
            self._join_parts()
        search = PalletSearch(self.columns, self.wishes)
        unsaid = "plan" not in self.wishes.columns and not self.wishes.exact
        if unsaid and self.columns.plan is None and not any(self.boxes.parts):
            self.columns, lines = search.columns_with_pallets()
            self.notes += lines
        elif unsaid:
            search.check_stacks()
        names = plan_names(self.columns, self.source, self.notes)
        plans, too_large = self._plans_of_size(names)
        if not plans:
            raise InputError(too_large[0].message.removeprefix(f"{self.source}: "))
        try:
            lost = names_with_lost_rows(self.boxes.table, names)
            single_reading = search.single_reading if len(plans) == 1 and not lost else None
            reading, candidate = single_reading or choose_reading(self.columns, plans, self.wishes, lost)
        except InputError as error:  # either no row is good, or the good rows alone make no plausible plan
            if isinstance(error, AmbiguousFile) and len({one.far_words for one in error.readings[:2]}) > 1:
                # Two readings are about equally plausible: columns hold the ends of boxes, or the last grid cells of
                # boxes. In the second reading, a box that begins and ends at the same cell is no fault. So the user is
                # asked for the reading.
                raise
            if self.boxes.table.lost:
                place, fault = self.boxes.table.lost[0]
                raise InputError(f"{place}: {fault}") from None
            if (bad_row := first_bad_row(self.columns, self.wishes)) is not None:
                row, fault = bad_row
                plan = "" if self.columns.plan is None else f"plan {printable_name(names[row])}, "
                raise InputError(f"{plan}{self._place_of(row)}: {fault}") from None
            raise
        apart = unsaid and len(plans) > 1 and not lost
        if apart and self._float(reading, candidate, plans) and search.are_parts_of_one():
            names_text = first_names(list(plans))
            self.notes.append(f"{names_text} are read as one plan: as separate plans, some would float above the deck")
            self._join_parts()
            names = plan_names(self.columns, self.source, self.notes)
            reading, candidate = choose_reading(self.columns, self._plans_of_size(names)[0], self.wishes)
            reading = replace(reading, columns={**reading.columns, "plan": IGNORED})
        return names, lost, reading, candidate

    def _plans_of_size(self, names: Sequence[str]) -> tuple[dict[str, NDArray[np.int64]], list[RefusedPlan]]:
        """Name of each plan → its rows; and the refused plans. Plans with too many boxes are refused before any reading
        is judged, because judging them would take long.

        Args:
            names: (n,) the name of each row's plan.
        """
        plans, refused = rows_by_name(names), []
        most = self.wishes.max_boxes or len(names)
        advice = f"; {SEVERAL}" if self.columns.plan is None and len(plans) == 1 else ""
        for name in [name for name, rows in plans.items() if len(rows) > most]:
            fault = too_many_boxes(len(plans.pop(name)), most)
            refused.append(RefusedPlan(name, f"{self.source}: plan {printable_name(name)}: {fault}{advice}"))
        return plans, refused

    def _join_parts(self) -> None:
        """Make one plan of all boxes of the file, which was divided into several plans before."""
        self.boxes = replace(self.boxes, parts=())
        self.columns = replace(self.columns, source=replace(self.columns.source, boxes=self.boxes))

    def _float(self, reading: Reading, candidate: Candidate, plans: Mapping[str, NDArray[np.int64]]) -> bool:
        """Whether there is a plan in which no box stands on the deck."""
        _, low = placed_boxes(self.columns, reading, candidate, plans, self.wishes, self.columns.faults, [])
        return any(np.nanmin(low[rows, 2], initial=np.inf) > DEFAULT_TOLERANCE_MM for rows in plans.values())

    def _find_faults(self, reading: Reading, candidate: Candidate, plans: Mapping[str, NDArray[np.int64]]) -> None:
        """Find the faults of rows. A row with several faults keeps that of its cells, before that of its rotation, of
        its range and of its distance from other boxes."""
        if candidate.geometry.faults:
            self.columns = replace(self.columns, faults={**candidate.geometry.faults, **self.columns.faults})
        turns = self.columns.turns
        uses_turns = turns is not None and not turns.may_be_ignored(reading.rule)
        # ``exact`` has the columns of a reading that the user has written down; only a guessed reading needs this check
        of_places = {} if self.wishes.exact else edge_faults(self.columns, reading, candidate, plans)
        self.faults = {
            **of_places,
            **range_faults(self.columns, reading, candidate),
            **({row: f"{turns.column} {text}" for row, text in turns.faults.items()} if turns and uses_turns else {}),
            **{row: f"{column} {text}" for row, (column, text) in self.columns.faults.items()},
        }

    def _check_words(self, reading: Reading, candidate: Candidate) -> None:
        """Add a note that tells how two unknown words in a column of rotations were read.

        Raises:
            InputError: nothing shows the meaning of the words.
        """
        turns = self.columns.turns
        if turns is None or not turns.words or (turns.guess_cost and reading.rule == "none"):
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

    def _note_columns(self, reading: Reading, candidate: Candidate) -> None:
        """Add notes about half sizes, last grid cells, unknown units and quantities. The unit of a column such as
        "width [furlong]" is chosen by plausibility, unless the user names it."""
        if HALF_EXTENTS in reading.columns:
            self.notes.append(f"{printable_name(reading.columns[HALF_EXTENTS])} and columns like it hold half sizes")
        if LAST_CELLS in reading.columns:
            self.notes.append(
                f"{printable_name(reading.columns[LAST_CELLS])} and columns like it hold the last grid cell of each "
                "box (the box ends one cell further)"
            )
        weights = [self.columns.columns.get("weight", "")]
        for names, unit, is_named in (
            (candidate.geometry.columns.values(), reading.units, self.wishes.units),
            (weights, reading.masses, self.wishes.masses),
        ):
            unknown = [name for name in dict.fromkeys(names) if _has_unknown_unit(name)]
            if unknown and not is_named:
                self.notes.append(f"{first_names(unknown)}: unknown unit, read as {unit} (say which with --units)")
        self._note_quantities()

    def _note_quantities(self) -> None:
        """Add a note about quantities above 1. There is no note if each of these quantities equals the number of rows
        with the same article, because each box then has a row. A row has only one place, so it is read as one box
        whatever its quantity is."""
        table, articles = self.boxes.table, self.columns.article or [""] * self.columns.n_boxes
        if self.columns.source.form == PACKINGSOLVER:  # the reader of this form adds a note about quantities itself
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

    def _note_plans_apart(self, plans: Mapping[str, NDArray[np.int64]], size: FloatArray, low: FloatArray) -> None:
        """Add a note about plans whose rows form several groups in a table, with rows of other plans between the
        groups. There is a note only if boxes of one group overlap boxes of another group, since the groups may then be
        two plans with the same name."""
        apart = []
        for name, rows in plans.items():
            group = np.cumsum(np.diff(rows, prepend=rows[0]) > 1)
            if group[-1] > 0 and len(rows) <= _MOST_COMPARED:
                corner = low[rows].T
                pairs = np.logical_and.reduce(
                    [
                        overlap(begin, begin + side, DEFAULT_TOLERANCE_MM)
                        for begin, side in zip(corner, size[rows].T, strict=True)
                    ]
                )
                if (pairs & (group[:, None] != group)).any():
                    apart.append(name)
        if apart:
            self.notes.append(
                f"rows of {first_names(apart, 3)} are not next to each other, and their boxes overlap: do two "
                "plans have one name?"
            )

    def _place_of(self, row: int) -> str:
        """The place of a row in the file, with the name of its box."""
        ids = self.columns.item_id
        name = "" if ids is None or not ids[row] else f" ({printable_name(ids[row])})"
        return f"{self.places[row]}{name}"

    def _unused(self, reading: Reading) -> tuple[str, ...]:
        """Names of the columns that a reading does not use."""
        used = set(reading.columns.values())
        return tuple(
            name
            for name in self.boxes.table.header
            if name not in used and name.rpartition("[")[0] not in used and name not in self.columns.unit_columns
        )

    def _order_note(self, orders: Mapping[str, str]) -> str:
        """Returns the source of the packing order ("sequence", "rows" or "height"). Adds a note if no column gives the
        packing order.

        Args:
            orders: name of a plan → source of its packing order.
        """
        sorted_plans = [name for name, order in orders.items() if order == "height"]
        if sorted_plans:
            plans_text = "" if len(orders) == 1 else f" in {first_names(sorted_plans, 3)}"
            self.notes.append(f"rows are not in packing order{plans_text}: boxes are placed from the ground up")
            return "height"
        if "rows" in orders.values() or not orders:
            self.notes.append("no packing order: boxes are placed in the order of rows")
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
            self.notes.append("no articles" + (": names of boxes instead" if article is not None else ""))
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
        numbers = np.array([row_number(self.places[row], row) for row in rows.tolist()], np.int64)
        fields = {name: as_column(column) for name, column in values.items()}
        return Table(fields, (), numbers, sequence_name=columns.columns.get("sequence", "sequence"))


_LAST_WORD: Final = re.compile(r"(?:[\[(]|\s(?:in|/)\s)\s*([^\W\d_]\w*)\s*[\])]?\s*$")
"""A word in brackets, or behind "in" or "/", at the end of a name."""
_NO_UNITS: Final = word_set(
    "outer inner external internal ext int aussen innen net gross netto brutto total each item max min original nominal"
)
"""Words at such a place that state which size or weight a column has, and are no units."""


def _has_unknown_unit(name: str) -> bool:
    """Whether the name of a column ends in a word that is probably a unit, but none that petmjx knows."""
    match = None if split_unit(name)[1] else _LAST_WORD.search(name)
    word = "" if match is None else plain_text(match[1]).lower()
    return bool(word) and word not in _NO_UNITS | ALL_SIZE_WORDS and not known_meanings([word])
