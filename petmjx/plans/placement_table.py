"""Tables of placements: their columns (``InputColumn``) become the checked fields of plans (``table_plans``).

A table has one row per placement. ``sequence`` is the packing order, so rows may come in any order. For each unusable
plan or row, there is one line of text.

For speed, whole columns are converted and checked in C. Python checks single values and rows only if one of these
checks fails.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, is_text, number_in, printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.file_formats import point_fault
from petmjx.plans.input_conventions import USUAL_CONVENTIONS, InputConventions, Limits
from petmjx.plans.plan_fields import (
    COM_FIELDS,
    LONGEST_NAME,
    PALLET_KINDS,
    SPARSE,
    com_along_axes,
    com_fault,
    coordinate_fault,
    first_fault,
    integer_fault,
    kind_fault,
    missing_anywhere,
    missing_fault,
    number_fault,
    orientation_fault,
    pallet_fault,
    positive_fault,
    sparse_fault,
    text_fault,
    too_many_boxes,
)

_NUMBER: Final = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_SHORT_WHOLE: Final = r"^[+-]?(\d{1,18}|[1-8]\d{18})$"
_WHOLE: Final = re.compile(r"[+-]?[0-9]+")
_MOST_EXACT: Final = 2.0**53
"""Largest n for which float64 represents all whole numbers from 0 to n exactly."""
WIDE_STEP: Final = 10
"""Programs such as SAP number rows 10, 20, 30 …, so that rows can be inserted later."""


@dataclass(frozen=True, eq=False)
class InputColumn:
    """A column of a table before it is checked.

    Attributes:
        values: an Arrow array; or Python objects, if they have several types.
        is_text: whether numbers are stored as text, as in CSV. If ``is_text`` is True, empty text is a missing value.
        decimal: the decimal mark of numbers stored as text. If the decimal mark is a comma, numbers have no points.
    """

    values: pa.Array | Sequence[Any]
    is_text: bool = False
    decimal: str = "."

    def raw(self, row: int, number: bool = False) -> Any:
        """The value of a row as messages show it; None if it is missing.

        Args:
            number: whether the column should have numbers. A number stored as text is then shown as a number.
        """
        value = self.values[row]
        value = value.as_py() if isinstance(value, pa.Scalar) else value
        if isinstance(value, bytes):
            value = value.decode("utf-8", "surrogateescape")
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, Decimal):
            value = float(value)
        if value is None or (isinstance(value, float) and np.isnan(value) and not isinstance(self.values, pa.Array)):
            return None
        if self.is_text and number:
            return _as_number(value.strip(), self.decimal)
        # values of all other types, such as times, are shown as text
        return value if isinstance(value, str | int | float | list | dict) else str(value)

    def missing(self, number: bool = False) -> NDArray[np.bool_]:
        """(n,) whether a row has no value. ``number`` is as in :meth:`raw`."""
        if not isinstance(self.values, pa.Array):
            return np.array([self.raw(row, number) is None for row in range(len(self.values))], dtype=bool)
        array = _trimmed_text(self.values) if self.is_text and number else self.values
        return np.asarray(array.is_null())

    def numbers(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(n,) numbers, NaN if missing; and a mask of the usable numbers. Ranges are not checked."""
        array = self.values
        if not isinstance(array, pa.Array):
            return _converted_objects(array, _float, np.nan, np.float64)
        if self.is_text:
            array = _numeric_text(array, self.decimal)
        elif not _is_number(array.type):
            return np.full(len(array), np.nan), np.zeros(len(array), dtype=bool)
        numbers = pc.cast(array, pa.float64(), safe=False)
        return np.asarray(numbers.fill_null(np.nan)), np.asarray(numbers.is_valid())

    def whole(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(n,) whole numbers, 0 if missing; and a mask of the rows that have a whole number."""
        numbers, usable = self.numbers()
        usable &= (np.abs(numbers) <= _MOST_EXACT) & (numbers == np.rint(numbers))
        integers = np.where(usable, numbers, 0).astype(np.int64)
        array = self.values
        if not isinstance(array, pa.Array) or not (self.is_text or pa.types.is_integer(array.type)):
            return integers, usable
        exact = _exact(_trimmed_text(array) if self.is_text else array)
        known = np.asarray(exact.is_valid())
        return np.where(known, np.asarray(exact.fill_null(0)), integers), known | usable

    def texts(self) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
        """(n,) names, "" if missing; and a mask of the usable names. Equal names share one string."""
        array = self.values
        if not isinstance(array, pa.Array):
            return _converted_objects(array, _name, "", np.object_)
        if pa.types.is_integer(array.type):
            array = pc.cast(array, pa.string())
        elif pa.types.is_binary(array.type):
            try:
                array = pc.cast(array, pa.string())
            except pa.ArrowInvalid:
                return _converted_objects([self.raw(row) for row in range(len(array))], _name, "", np.object_)
        elif not (pa.types.is_string(array.type) or pa.types.is_large_string(array.type)):
            return np.full(len(array), "", dtype=object), np.zeros(len(array), dtype=bool)
        usable = np.array(pc.less_equal(pc.utf8_length(array), LONGEST_NAME).fill_null(False))
        coded = pc.fill_null(array, "").dictionary_encode()
        names = np.array([*coded.dictionary.to_pylist(), ""], dtype=object)
        return names[np.asarray(coded.indices)], usable


def as_column(values: Any, is_text: bool = False, decimal: str = ".") -> InputColumn:
    """A column from a pandas series, a NumPy array, a list or an Arrow array. NaN is a missing value, as in pandas."""
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    if not isinstance(values, pa.Array):
        try:
            values = pa.array(values, from_pandas=True)
        except (pa.ArrowException, UnicodeError, OverflowError, TypeError, ValueError):
            return InputColumn(list(values), is_text, decimal)
        if isinstance(values, pa.ChunkedArray):
            values = values.combine_chunks()
    if pa.types.is_dictionary(values.type):
        values = values.dictionary_decode()
    if pa.types.is_string_view(values.type):
        values = pc.cast(values, pa.large_string())
    return InputColumn(values, is_text, decimal)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _trimmed_text(array: pa.Array) -> pa.Array:
    """Text without white space around it. Empty text becomes null."""
    text = pc.ascii_trim_whitespace(array)
    return pc.if_else(pc.equal(text, ""), None, text)


def _exact(array: pa.Array) -> pa.Array:
    """Whole numbers as int64, since float64 would lose digits. Null if missing."""
    try:
        return pc.cast(array, pa.int64())
    except pa.ArrowInvalid:
        if pa.types.is_integer(array.type):
            fits = pc.less_equal(array, pa.scalar(np.iinfo(np.int64).max, array.type))
        else:
            fits = pc.match_substring_regex(array, _SHORT_WHOLE)
        return pc.cast(pc.if_else(fits, array, None), pa.int64())


def _numeric_text(array: pa.Array, decimal: str) -> pa.Array:
    """The numbers in texts, as float64. Null for other texts."""
    text = _trimmed_text(array)
    if decimal != ".":
        text = pc.if_else(pc.match_substring(text, "."), "", pc.replace_substring(text, decimal, "."))
    try:
        return pc.cast(text, pa.float64())
    except pa.ArrowInvalid:
        return pc.cast(pc.if_else(pc.match_substring_regex(text, _NUMBER), text, None), pa.float64())


def _as_number(text: str, decimal: str) -> Any:
    """The number in a text. A text that is not a number is returned unchanged. The result is None for an empty text."""
    if not text:
        return None
    if _WHOLE.fullmatch(text) and len(text) < 300:
        return int(text)
    number = None if decimal != "." and "." in text else number_in(text.replace(decimal, "."))
    return text if number is None else number


def _converted_objects(
    values: Sequence[Any], read: Callable[[Any], Any], otherwise: Any, kind: type[np.generic]
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Python objects, converted one by one by ``read``, which returns None for an unusable value; and a mask of the
    usable values."""
    readings = [read(value.item() if isinstance(value, np.generic) else value) for value in values]
    usable = np.array([value is not None for value in readings], dtype=bool)
    array = np.empty(len(readings), dtype=kind)
    array[:] = [otherwise if value is None else value for value in readings]
    return array, usable


def _float(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def _name(value: Any) -> str | None:
    if isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    return value if isinstance(value, str) and len(value) <= LONGEST_NAME and is_text(value) else None


_SIZE: Final = ("length_mm", "width_mm", "height_mm")
_CORNER: Final = ("x_mm", "y_mm", "z_mm")
NEEDED: Final = ("plan_id", "sequence", "article", *_SIZE, "weight_kg", *_CORNER)
"""Columns that every table must have."""
_RARE_COLUMNS: Final = ("material", "kind", *COM_FIELDS, *SPARSE)
OPTIONAL: Final = ("item_id", "product_group", "orientation", "order_sequence", *_RARE_COLUMNS)
"""Columns that a table may have. ``order_sequence`` is BED-BPP's ``item.sequence``, the number within the order.
Without this column, ``sequence`` is used instead."""
_TEXTS: Final = ("article", "item_id", "product_group", "material", "kind")
NAMES: Final = ("plan_id", *_TEXTS)
"""Columns that have names, that is, texts. All columns that are not listed here have numbers."""
_COLUMNS_WITH_GAPS: Final = ("item_id", "product_group", *_RARE_COLUMNS)
"""Columns in which a value may be missing."""
_ALIASES: Final = {
    name.replace("_mm", "/mm").replace("_kg", "/kg"): name for name in (*_SIZE, "weight_kg", *COM_FIELDS)
}
"""BED-BPP's names for sizes, weights and centres of mass → petmjx's names."""


PlanFields = dict[str, Any]
"""The arguments of ``Plan``."""


class TableError(InputError):
    """Raised if a whole table cannot be used.

    Attributes:
        n_known: number of columns with petmjx's names.
        is_own: whether the table is certainly one of petmjx's own.
    """

    def __init__(self, message: str, n_known: int = 0, is_own: bool = False) -> None:
        super().__init__(message)
        self.n_known, self.is_own = n_known, is_own


class RefusedPlan(NamedTuple):
    """A refused plan, or a refused row whose plan is unknown (``plan_id`` is None). ``message`` is the whole line."""

    plan_id: str | None
    message: str


class LostRow(NamedTuple):
    """A row that cannot be read. ``plan_id`` is None if the row's plan is unknown."""

    number: int
    plan_id: str | None
    fault: str


@dataclass(frozen=True, eq=False)
class Table:
    """A table that has been read, but whose values are not checked yet.

    Attributes:
        columns: name in `NEEDED` or `OPTIONAL` → column of n rows.
        unread: names of columns that are not read.
        numbers: (n,) the number of each row, for messages.
        lost: rows that could not be read, and so are missing from ``columns``.
        end_fault: the error text for the last plan, if the table ends too early, so that the plan may lack rows.
        sequence_name: name of the column ``sequence`` in the file.
    """

    columns: Mapping[str, InputColumn]
    unread: Sequence[str]
    numbers: NDArray[np.int64]
    lost: Sequence[LostRow] = ()
    end_fault: str = ""
    sequence_name: str = "sequence"


def sorted_columns(names: Sequence[str]) -> tuple[dict[str, int], list[str]]:
    """petmjx's name of each known column → its position; and the names of the columns that are not read.

    Case and surrounding white space are ignored.

    Raises:
        TableError: a column occurs twice or is missing. The error does not name the file.
    """
    positions: dict[str, int] = {}
    unread = []
    for index, name in enumerate(names):
        plain = name.strip().lower()
        plain = _ALIASES.get(plain, plain)
        if plain not in NEEDED and plain not in OPTIONAL:
            unread.append(name)
        elif plain in positions:
            raise TableError(f"column {plain} occurs twice", len(positions), is_own=len(positions) > 1)
        else:
            positions[plain] = index
    missing = [name for name in NEEDED if name not in positions]
    if missing:
        listing = ", ".join(map(printable_name, names[:30])) or "none"
        columns = "column" if len(missing) == 1 else "columns"
        raise TableError(f"{columns} {missing_fault(missing)}; there are: {listing}", len(positions))
    return positions, unread


def table_plans(
    table: Table, source: str, max_boxes: int, notes: list[str], given: InputConventions = USUAL_CONVENTIONS
) -> Generator[PlanFields | RefusedPlan, None, None]:
    """Yield the plans of a table, in order of appearance, and the refused plans and rows.

    Args:
        source: name of the file in messages.
        max_boxes: plans with more boxes are refused.
        notes: list to which a line is added about plans whose ``sequence`` has gaps.
        given: the units and the anchor of the table's numbers, as the user gave them.
    """
    return _TableReader(table, source, max_boxes, notes, given).plans()


@dataclass(eq=False)
class _TableReader:
    """Reads the plans in one table of placements. Rows with an unusable plan id belong to no plan."""

    table: Table
    source: str
    max_boxes: int
    notes: list[str]
    given: InputConventions
    gaps: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Number the plans in order of appearance: ``_codes`` (n,) has the number of each row's plan, −1 if its plan id
        is unusable; ``_plan_ids`` has the ids of the plans."""
        names, usable = self._texts["plan_id"]
        coded = pa.array(names, pa.large_string(), mask=~usable | (names == "")).dictionary_encode()
        self._codes: NDArray[np.int64] = np.asarray(coded.indices.fill_null(-1)).astype(np.int64)
        self._plan_ids: list[str] = coded.dictionary.to_pylist()

    def plans(self) -> Generator[PlanFields | RefusedPlan, None, None]:
        yield from self._rows_of_no_plan()
        try:
            if self._plan_ids:
                yield from self._rows_of_plans()
        finally:  # the note is made even if the caller stops early
            if self.gaps:
                plans = f"{count_text(len(self.gaps), 'plan')} ({first_names(self.gaps)})"
                shown = printable_name(self.table.sequence_name)
                self.notes.append(f"{self.source}: {shown} has gaps in {plans}; are rows missing?")

    def _rows_of_plans(self) -> Iterator[PlanFields | RefusedPlan]:
        refused = self._refused_before()
        bad_rows = self._bad[self._order]
        begins = np.flatnonzero(np.diff(self._codes[self._order], prepend=-2))
        known = begins[self._codes[self._order][begins] >= 0]
        ends = np.append(known[1:], len(self._order))
        has_bad_row = np.logical_or.reduceat(bad_rows, known).tolist()
        for plan_id, begin, end, is_bad in zip(self._plan_ids, known.tolist(), ends.tolist(), has_bad_row, strict=True):
            fault = refused.get(plan_id) or self._fault(begin, end, is_bad)
            if fault is None:
                yield self._plan(plan_id, begin, end)
            else:
                separator = "" if fault.startswith(",") else ": "
                yield RefusedPlan(plan_id, f"{self.source}: plan {printable_name(plan_id)}{separator}{fault}")

    # Whole columns.

    @cached_property
    def _texts(self) -> dict[str, tuple[NDArray[np.object_], NDArray[np.bool_]]]:
        return {name: self.table.columns[name].texts() for name in NAMES if name in self.table.columns}

    @cached_property
    def _numbers(self) -> dict[str, FloatArray]:
        """Sizes, weights and coordinates, in mm and kg. NaN if a value is unusable."""
        columns = {}
        given = self.given
        for name, (low, high, _) in self._limits.items():
            numbers, usable = self.table.columns[name].numbers()
            unit = given.mass_kg if name == "weight_kg" else given.place_mm if name in _CORNER else given.length_mm
            # comparisons with NaN are false, so NaN stays NaN
            columns[name] = np.where(usable & (numbers >= low) & (numbers <= high), numbers * unit, np.nan)
        return columns

    @cached_property
    def _com(self) -> dict[str, FloatArray]:
        """Centres of mass along the sides of the items, mm. A coordinate is 0 if it is missing, and NaN if it is
        unusable."""
        columns = {}
        for name, of in zip(COM_FIELDS, _SIZE, strict=True):
            if name in self.table.columns:
                numbers, usable = self.table.columns[name].numbers()
                offset = np.where(self._missing[name], 0.0, np.where(usable, numbers * self.given.length_mm, np.nan))
                columns[name] = np.where(2 * np.abs(offset) < self._numbers[of], offset, np.nan)
        return columns

    @cached_property
    def _limits(self) -> dict[str, Limits]:
        given = self.given
        return (
            dict.fromkeys(_SIZE, given.sizes) | {"weight_kg": given.weights} | dict.fromkeys(_CORNER, given.coordinates)
        )

    @cached_property
    def _whole(self) -> dict[str, tuple[NDArray[np.int64], NDArray[np.bool_]]]:
        names = ("sequence", "order_sequence", "orientation")
        columns = {name: self.table.columns[name].whole() for name in names if name in self.table.columns}
        if "orientation" in columns:
            turns, usable = columns["orientation"]
            columns["orientation"] = turns, usable & ((turns == 0) | (turns == 1))
        return columns

    @cached_property
    def _bad(self) -> NDArray[np.bool_]:
        is_bad = np.zeros(len(self.table.numbers), dtype=bool)
        for name, (_, usable) in (*self._texts.items(), *self._whole.items()):
            if name != "plan_id":
                is_bad |= ~usable & ~self._missing[name] if name in _COLUMNS_WITH_GAPS else ~usable
        for numbers in (*self._numbers.values(), *self._com.values()):
            is_bad |= np.isnan(numbers)
        for name, sparse in self._sparse.items():
            is_bad |= np.isnan(sparse) & ~self._missing[name]
        if "kind" in self._texts:
            names = self._texts["kind"][0]
            is_bad |= np.array([kind_fault(name) is not None for name in names], bool)
            for row in np.flatnonzero([name in PALLET_KINDS for name in names]):
                is_bad[row] |= pallet_fault(names[row], self._size_mm(row)) is not None
        return is_bad

    @cached_property
    def _sparse(self) -> dict[str, FloatArray]:
        """Name of a field of ``SPARSE`` (numbers that placements may lack) → (n,) values of its column; NaN if a value
        is unusable or missing."""
        columns = {}
        for name, known in SPARSE.items():
            if name in self.table.columns:
                numbers, usable = self.table.columns[name].numbers()
                columns[name] = np.where(usable & (numbers >= known.low) & (numbers <= known.high), numbers, np.nan)
        return columns

    @cached_property
    def _missing(self) -> dict[str, NDArray[np.bool_]]:
        """Name of a column → (n,) whether each row lacks a value."""
        names = [name for name in (*NEEDED, *OPTIONAL) if name in self.table.columns]
        return {name: self.table.columns[name].missing(number=name not in NAMES) for name in names}

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        """The rows, sorted by plan and packing order. Rows that belong to no plan come first."""
        order: NDArray[np.int64] = np.lexsort((self._whole["sequence"][0], self._codes))
        return order

    @cached_property
    def _sorted(self) -> dict[str, NDArray[Any]]:
        """Columns sorted by plan and packing order."""
        order, number, integers, texts = self._order, self._numbers, self._whole, self._texts
        size = np.stack([number[name][order] for name in _SIZE], axis=1)
        columns: dict[str, NDArray[Any]] = {
            "mass": number["weight_kg"][order],
            "number": integers["sequence"][0][order],
            "sequence": integers["order_sequence" if "order_sequence" in integers else "sequence"][0][order],
            **{name: texts[name][0][order] for name in _TEXTS if name in texts},
        }
        if "orientation" in integers:
            columns["orientation"] = turned = integers["orientation"][0][order]
            size[turned == 1, :2] = size[turned == 1, 1::-1]
        if self._com:
            along = np.stack([self._com.get(name, np.zeros(len(order)))[order] for name in COM_FIELDS], axis=1)
            turned = columns.get("orientation", np.zeros(len(order), np.int64)) == 1
            columns["com"] = com_along_axes(along, turned)
        columns |= {name: numbers[order] for name, numbers in self._sparse.items()}
        point = np.stack([number[name][order] for name in _CORNER], axis=1)
        return {"size": size, "corner": self.given.corner_mm(point, size), **columns}

    # One plan.

    def _plan(self, plan_id: str, begin: int, end: int) -> PlanFields:
        sorted_, rows = self._sorted, slice(begin, end)
        numbers = sorted_["number"][rows]
        step = WIDE_STEP if numbers[0] == WIDE_STEP and not (numbers % WIDE_STEP).any() else 1
        if numbers[0] not in (0, step) or numbers[-1] - numbers[0] != step * (len(numbers) - 1):
            self.gaps.append(plan_id)
        names = {name: tuple(sorted_[name][rows].tolist()) for name in _TEXTS if name in sorted_}
        groups, materials = (names.get(name, ()) for name in ("product_group", "material"))
        com = sorted_["com"][rows].copy() if "com" in sorted_ else None
        sparse = {name: sorted_[name][rows] for name in SPARSE if name in sorted_}
        return {
            "plan_id": plan_id,
            "source": self.source,
            "size_mm": sorted_["size"][rows].copy(),
            "corner_mm": sorted_["corner"][rows].copy(),
            "mass_kg": sorted_["mass"][rows].copy(),
            "item_ids": names.get("item_id", ("",) * len(numbers)),
            "articles": names["article"],
            "sequence": sorted_["sequence"][rows].copy(),
            "orientation": sorted_["orientation"][rows].copy() if "orientation" in sorted_ else None,
            "product_groups": groups if any(groups) else (),
            "materials": materials if any(materials) else (),
            "mass_center_mm": com if com is not None and com.any() else None,
            **{name: values.copy() for name, values in sparse.items() if not np.isnan(values).all()},
            "kinds": names.get("kind", ()),
        }

    def _fault(self, begin: int, end: int, bad: bool) -> str | None:
        """Why a plan is refused; None if it is good. The text begins with ", row" if the fault is in a row."""
        if end - begin > self.max_boxes:
            return too_many_boxes(end - begin, self.max_boxes)
        rows = np.sort(self._order[begin:end])
        if bad:
            return self._fault_of_rows(rows[self._bad[rows]])
        numbers = self._sorted["number"][begin:end]
        twice = np.flatnonzero(numbers[1:] == numbers[:-1])
        if not len(twice):
            return None
        first, second = self.table.numbers[self._order[begin + twice[0] : begin + twice[0] + 2]]
        return f", rows {first} and {second}: sequence {numbers[twice[0]]} occurs twice"

    def _fault_of_rows(self, rows: NDArray[np.int64]) -> str:
        """The error text for a plan with bad rows. If several rows lack values, the text names all missing values;
        otherwise it names the first fault."""
        numbers = self.table.numbers
        needed = {name: empty[rows] for name, empty in self._missing.items() if name not in _COLUMNS_WITH_GAPS}
        missing = {name: numbers[rows[empty]].tolist() for name, empty in needed.items() if empty.any()}
        everywhere = missing_anywhere(missing, "row")
        if everywhere is not None:
            return everywhere
        faults = (f", row {numbers[row]}: {fault}" for row in rows if (fault := self._fault_of(row)) is not None)
        return next(faults, "is unusable")

    def _fault_of(self, row: np.int64) -> str | None:
        """The first fault of a row, in the order of the columns; None if there is none."""
        missing = [name for name, empty in self._missing.items() if empty[row] and name not in _COLUMNS_WITH_GAPS]
        if missing:
            return missing_fault(missing)
        columns = self.table.columns
        raw = {name: self._raw(name, row) for name in (*NEEDED, *OPTIONAL) if name in columns}
        texts = {name: raw[name] for name in _TEXTS if raw.get(name) is not None and type(raw[name]) is not int}
        numbers = [name for name in raw if name not in NAMES and columns[name].decimal == ","]
        faults = (
            *(point_fault(name, raw[name]) for name in numbers),
            *(integer_fault(name, _integer_value(raw[name])) for name in ("sequence", "order_sequence") if name in raw),
            *(text_fault(name, value) for name, value in texts.items()),
            *(positive_fault(name, raw[name], *self._limits[name]) for name in (*_SIZE, "weight_kg")),
            *(
                com_fault(name, raw[name], raw[of])
                for name, of in zip(COM_FIELDS, _SIZE, strict=True)
                if raw.get(name) is not None and number_fault(of, raw[of]) is None
            ),
            orientation_fault(_integer_value(raw["orientation"])) if "orientation" in raw else None,
            *(coordinate_fault(name, raw[name], *self._limits[name]) for name in _CORNER),
            *(sparse_fault(name, raw.get(name)) for name in SPARSE),
            kind_fault(raw.get("kind")),
            pallet_fault(raw.get("kind"), self._size_mm(row)),
        )
        return first_fault(faults)

    def _size_mm(self, row: np.int64) -> list[float]:
        return [float(self._numbers[name][row]) for name in _SIZE]

    def _raw(self, name: str, row: np.int64) -> Any:
        return self.table.columns[name].raw(int(row), number=name not in NAMES)

    # Refused rows and plans.

    def _rows_of_no_plan(self) -> Iterator[RefusedPlan]:
        for row in np.flatnonzero(self._codes < 0):
            value = self.table.columns["plan_id"].raw(int(row))
            missing = value in (None, "")
            fault = "plan_id is missing" if missing else text_fault("plan_id", value) or "plan_id is unusable"
            yield RefusedPlan(None, f"{self.source}: row {self.table.numbers[row]}: {fault}")
        known = set(self._plan_ids)
        for lost in self.table.lost:
            if lost.plan_id not in known:
                plan = "" if lost.plan_id is None else f" plan {printable_name(lost.plan_id)},"
                yield RefusedPlan(lost.plan_id, f"{self.source}:{plan} row {lost.number}: {lost.fault}")

    def _refused_before(self) -> dict[str, str]:
        """Id of each plan that lacks a row → the fault of the row, or of the end of the table."""
        reasons: dict[str, str] = {}
        if self.table.end_fault and len(self._codes) and self._codes[-1] >= 0:
            reasons[self._plan_ids[self._codes[-1]]] = self.table.end_fault
        for lost in reversed(self.table.lost):
            if lost.plan_id is not None:
                reasons[lost.plan_id] = f", row {lost.number}: {lost.fault}"
        return reasons


def _integer_value(value: Any) -> Any:
    """A whole number stored as float, such as 2.0, as an integer. Other values are returned unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
