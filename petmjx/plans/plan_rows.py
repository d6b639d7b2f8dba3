"""Which rows of another tool's file make a plan (``PalletSearch``, ``plan_names``), and the packing order of these
rows: from a column, from the order of rows, or by height, the lowest boxes first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.cell_numbers import cell_text
from petmjx.plans.column_extraction import IGNORED
from petmjx.plans.column_names import CONTAINER_WORDS, PALLET_WORDS, may_count, names_deck, words_of
from petmjx.plans.placement_table import WIDE_STEP
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, gaps_mm
from petmjx.plans.plausibility import n_before_support
from petmjx.plans.raw_tables import rows_by_name
from petmjx.plans.reading_candidates import Candidate
from petmjx.plans.reading_choice import choose_reading
from petmjx.plans.readings import AmbiguousFile, Reading, Wishes

_MANY_OVERLAP: Final = 0.3
"""If at least this share of the boxes overlaps, two pallets have probably been read as one."""
_LEAST_OF_PALLETS: Final = 4
"""Smallest number of boxes in a file for which petmjx searches for a column that names the pallets."""
_LARGEST_NUMBER: Final = 2**53
"""Largest number of a packing order. Larger whole numbers may have been rounded, since they are stored as float64."""
_MOSTLY: Final = 0.75
"""Numbers count boxes, with some gaps or repeated numbers, if at least this share of them are distinct, and if boxes
have at least this share of the numbers from the smallest to the largest."""
_OF_STACKS: Final = frozenset(("stack", "stacks", "stack id", "stack_id", "stack no", "stack_no", "stackid"))
"""Names of columns that may name pallets, or stacks of one pallet."""


class PalletSearch:
    """Searches for the column that names the pallets of a file.

    Attributes:
        columns: the boxes of the file.
        single_reading: the reading that is chosen if all boxes are taken as one plan; None: it was not chosen yet.
    """

    def __init__(self, columns: BoxColumns, wishes: Wishes) -> None:
        self.columns, self.wishes = columns, wishes
        self.single_reading: tuple[Reading, Candidate] | None = None

    def columns_with_pallets(self) -> tuple[BoxColumns, tuple[str, ...]]:
        """The columns of the file, and notes. If boxes would overlap as one plan, or the packing order repeats numbers,
        the file has several pallets. If a column divides the boxes into pallets in which no boxes overlap and no
        numbers repeat, this column becomes the column of plans, and a note states this.

        Raises:
            InputError: it is unclear which column separates the pallets. It is clear only if exactly one of the
                possible columns has a word for pallets in its name.
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
            return columns, ()
        of_geometries = [{*geometry.columns.values()} for geometry in columns.geometries]
        has_header = columns.source.boxes.table.has_header
        used = set.union(*of_geometries) if has_header else set.intersection(*of_geometries)
        used |= {columns.columns.get(role, "") for role in ("weight", "density", "sequence")}
        used |= {columns.turns.column} if columns.turns is not None and not columns.turns.guess_cost else set()
        separating: dict[tuple[int, ...], list[str]] = {}
        for name in columns.source.boxes.table.header:
            texts = [cell_text(cell) for cell in columns.source.boxes.table.column(name)]
            groups = rows_by_name(texts)
            if name in used or "" in groups or not 2 <= len(groups) <= len(rows) / 2:
                continue
            if any(repeated_number(columns, group) is not None for group in groups.values()) or self._overlaps(
                groups, 0.0
            ):
                continue
            numbers = {text: number for number, text in enumerate(groups)}
            separating.setdefault(tuple(numbers[text] for text in texts), []).append(name)
        if not separating:
            return columns, ()
        pallet_names = [[name for name in names if PALLET_WORDS & set(words_of(name))] for names in separating.values()]
        sure = [names[0] for names in pallet_names if names]
        if len(sure) != 1 and self._is_too_large(rows):
            return columns, ()
        if len(sure) != 1:
            names = [names[0] for names in separating.values()]
            cause = "numbers of the packing order occur twice" if repeats_numbers else "boxes overlap"
            raise InputError(
                f"{cause}, but not if {' or '.join(map(printable_name, names))} separates pallets; say which with "
                f"{' or '.join(f'--columns plan={printable_name(name)}' for name in (*names, IGNORED))} (one pallet)"
            )
        texts = [cell_text(cell) for cell in columns.source.boxes.table.column(sure[0])]
        with_plans = replace(columns, plan=texts, columns={**columns.columns, "plan": sure[0]})
        return with_plans, (f"several pallets, by {printable_name(sure[0])}",)

    def check_stacks(self) -> None:
        """Refuse a column of stacks if all boxes together could be one plan.

        Raises:
            InputError: no box overlaps or floats if the stacks are one plan.
        """
        name, names = self.columns.columns.get("plan", ""), self.columns.plan or []
        if name.lower() not in _OF_STACKS or len(set(names)) < 2 or self.columns.faults:
            return
        of_one = self._overlaps({"": np.arange(self.columns.n_boxes)}, 0.0)
        if not of_one:
            shown = printable_name(name)
            raise InputError(
                f"{shown} may name pallets, or stacks of one pallet; say which with --columns plan={shown} or "
                f"--columns plan={IGNORED} (one pallet)"
            )

    def are_parts_of_one(self) -> bool:
        """Whether the parts of a file, such as sections with titles, are parts of one plan. This is so if no column
        names plans, and if no box overlaps or floats when all parts are read as one plan."""
        rows = np.arange(self.columns.n_boxes)
        return self.columns.plan is None and not self.columns.faults and not self._overlaps({"": rows}, 0.0)

    def _overlaps(self, plans: Mapping[str, NDArray[np.int64]], share: float) -> bool:
        """Whether, in the most plausible reading, more than the given share of the boxes overlaps other boxes, or any
        box floats. The result is also True if a plan has more boxes than ``Wishes.max_boxes``."""
        if any(map(self._is_too_large, plans.values())):
            return True
        try:
            choice = choose_reading(self.columns, plans, self.wishes)
            evidence = choice[0].evidence
            self.single_reading = choice if len(plans) == 1 else self.single_reading
        except AmbiguousFile as error:
            evidence = error.readings[0].evidence
        except InputError:
            return False
        return evidence.n_overlapping > share * evidence.n_boxes or (not share and evidence.n_floating > 0)

    def _is_too_large(self, rows: NDArray[np.int64]) -> bool:
        return self.wishes.max_boxes is not None and len(rows) > self.wishes.max_boxes


def plan_names(columns: BoxColumns, source: str, notes: list[str]) -> list[str]:
    """(n,) the name of the plan of each row. If the names are numbers of containers, the file's name comes before
    them, so that plans of different files have different names. Numbers are taken for numbers of containers if they
    count without gaps from 0 or 1, or if they are in a column whose name is not "plan" or "order". Other numbers are
    ids.
    """
    parts, column = columns.source.boxes.parts, columns.plan
    if column is not None and len(set(column)) * 2 > columns.n_boxes + 2 and len(set(column)) > 1:
        column = None  # nearly every row has a different name, so the column does not name plans
    stem = Path(source).name.split(".")[0] or "plan"
    names = ["/".join(filter(None, (part, "" if column is None else column[row]))) for row, part in enumerate(parts)]
    if not any(names):
        notes.append(f"no plan_id: {printable_name(stem)}")
        return [stem] * len(names)
    words = words_of(columns.columns.get("plan", ""))
    if "plan" in words or "order" in words:  # the names are names of plans, not numbers of containers
        return [name or stem for name in names]
    if len(set(names)) == 1 and (names[0] in ("0", "1") or _is_kind_of_pallet(names[0])):
        return [stem] * len(names)  # there is only one container, which has no name of its own
    numbers = sorted(int(name) for name in set(names) if name.isdecimal())
    is_counted = bool(words) or numbers in (list(range(len(numbers))), list(range(1, len(numbers) + 1)))
    return [f"{stem}/{name}" if is_counted and name.isdecimal() else name or stem for name in names]


def _is_kind_of_pallet(name: str) -> bool:
    """Whether a name is only a word for pallets, or a kind of pallets, such as "EUR". Several files may have it."""
    is_word = CONTAINER_WORDS.issuperset(words_of(name)) or names_deck(name)
    return is_word and not any(character.isdigit() for character in name)


# The packing order.


def packing_order(
    columns: BoxColumns, rows: NDArray[np.int64], low: FloatArray, size: FloatArray, notes: list[str]
) -> tuple[NDArray[np.int64], str, str]:
    """(n,) packing order of a plan's rows, from 1; the source of this order ("sequence", "rows" or "height"); and the
    name of the column of running numbers that is used as packing order ("": none). Adds notes to ``notes``."""
    if columns.sequence is not None and not np.isnan(columns.sequence[rows]).all():
        return columns.sequence[rows].astype(np.int64), "sequence", ""
    order = np.arange(1, len(rows) + 1)
    possible = _can_be_placed(order, low, size)
    for name, values in columns.counters.items():
        counted = values[rows]
        if may_count(name) and (flaw := _flaw_of_numbers(counted)):
            shown = printable_name(name)
            notes.append(f"{shown} {flaw}, so it is not read as the packing order (--columns sequence={shown})")
        if np.isnan(counted).any() or not _counts_all(counted) or not (np.diff(counted) < 0).any():
            continue  # some boxes have no number, or the numbers only repeat the order of the rows
        if not _can_be_placed(counted, low, size):
            continue
        if not possible:
            notes.append(f"packing order by {printable_name(name)}: rows are not in packing order")
            return counted.astype(np.int64), "sequence", name
        if may_count(name):
            notes.append(
                f"{printable_name(name)} may be the packing order, too (--columns sequence={printable_name(name)})"
            )
    if not possible:
        order[np.argsort(low[:, 2], kind="stable")] = np.arange(1, len(rows) + 1)
        return order, "height", ""
    return order, "rows", ""


def repeated_number(columns: BoxColumns, rows: NDArray[np.int64]) -> str | None:
    """The fault of a plan's packing order: a number that is repeated or is not whole. The result is None if there is no
    fault."""
    sequence, places = columns.sequence, columns.source.boxes.table.places
    if sequence is None or np.isnan(sequence[rows]).all():
        return None
    name, first_rows = columns.columns["sequence"], dict[float, int]()
    for row in rows.tolist():
        value = float(sequence[row])
        if not value.is_integer():
            return f"{places[row]}: {name} must be a whole number, got {value:g}"
        if abs(value) > _LARGEST_NUMBER:
            return f"{places[row]}: {name} is too large, got {value:g}"
        if value in first_rows:
            plans = "" if columns.plan else "; several plans? then name their column: --columns plan=NAME"
            unused = f"no packing order? then --columns sequence={IGNORED}"
            return f"{places[first_rows[value]]} and {places[row]}: {name} {value:g} occurs twice{plans}; {unused}"
        first_rows[value] = row
    return None


def _counts_all(values: FloatArray) -> bool:
    """Whether the n numbers are 0, 1, … n − 1 or 1, 2, … n or 10, 20, … 10 n, each once and in any order."""
    if values.min() == WIDE_STEP:
        values = values / WIDE_STEP
    return bool((np.sort(values) - np.arange(len(values)) == min(max(float(values.min()), 0.0), 1.0)).all())


def _flaw_of_numbers(values: FloatArray) -> str:
    """Why whole numbers are no running numbers although most of them are: some are repeated, or there are gaps. The
    result is "" for running numbers, whatever the first number is, and for other numbers, such as ids."""
    distinct = np.unique(values)  # NaN stays, so values with NaN have no flaw
    steps = np.diff(distinct)
    if len(distinct) < _MOSTLY * len(values) or not np.ptp(values) + 1 <= len(values) / _MOSTLY:
        return ""
    return "repeats numbers" if len(distinct) < len(values) else "has gaps" if (steps > 1).any() else ""


def _can_be_placed(order: NDArray[Any], low: FloatArray, size: FloatArray) -> bool:
    """Whether boxes can be placed in this packing order: each box is placed after all boxes on which it rests, and no
    box that has support in the complete plan floats when it is placed."""
    by_order = np.argsort(order, kind="stable")
    low, size = low[by_order], size[by_order]
    if n_before_support(low, size, DEFAULT_TOLERANCE_MM):
        return False
    in_order = gaps_mm(low, size) > DEFAULT_TOLERANCE_MM
    at_all = gaps_mm(low, size, in_order=False) > DEFAULT_TOLERANCE_MM
    return not (in_order & ~at_all).any()
