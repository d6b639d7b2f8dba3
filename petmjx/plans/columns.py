"""One column of a table of placements: its values as arrays, and which of them cannot be used.

Whole columns are converted in C; only where that fails are values looked at one by one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from petmjx.basics.text import is_text, number_in
from petmjx.basics.units import FloatArray
from petmjx.plans.fields import LONGEST_NAME

_NUMBER: Final = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"
_SHORT_WHOLE: Final = r"^[+-]?(\d{1,18}|[1-8]\d{18})$"
_WHOLE: Final = re.compile(r"[+-]?[0-9]+")
_MOST_EXACT: Final = 2.0**53
"""Up to here float64 has every whole number."""


@dataclass(frozen=True, eq=False)
class InputColumn:
    """A column as it came.

    Attributes:
        values: Arrow's array; or Python objects, where they are of several types.
        is_text: whether numbers are written as text too, as in CSV; empty text is then a missing value.
        decimal: the decimal mark of such numbers.
    """

    values: pa.Array | Sequence[Any]
    is_text: bool = False
    decimal: str = "."

    def raw(self, row: int, number: bool = False) -> Any:
        """The value of a row as messages show it; None where there is none.

        Args:
            number: whether it should be a number: text that is one is shown as one.
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
        # times and what else a table may hold are shown as text
        return value if isinstance(value, str | int | float | list | dict) else str(value)

    def missing(self, number: bool = False) -> NDArray[np.bool_]:
        """(n,) where there is no value; as for :meth:`raw`."""
        if not isinstance(self.values, pa.Array):
            return np.array([self.raw(row, number) is None for row in range(len(self.values))], dtype=bool)
        array = _trimmed(self.values) if self.is_text and number else self.values
        return np.asarray(array.is_null())

    def numbers(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(n,) numbers, NaN where there is none; and a mask of values that are usable as numbers. Ranges are not
        checked."""
        array = self.values
        if not isinstance(array, pa.Array):
            return _each(array, _float, np.nan, np.float64)
        if self.is_text:
            array = _numeric_text(array, self.decimal)
        elif not _is_number(array.type):
            return np.full(len(array), np.nan), np.zeros(len(array), dtype=bool)
        numbers = pc.cast(array, pa.float64(), safe=False)
        return np.asarray(numbers.fill_null(np.nan)), np.asarray(numbers.is_valid())

    def whole(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """(n,) whole numbers, 0 where there is none; and a mask of where there is one."""
        numbers, usable = self.numbers()
        usable &= (np.abs(numbers) <= _MOST_EXACT) & (numbers == np.rint(numbers))
        integers = np.where(usable, numbers, 0).astype(np.int64)
        array = self.values
        if not isinstance(array, pa.Array) or not (self.is_text or pa.types.is_integer(array.type)):
            return integers, usable
        exact = _exact(_trimmed(array) if self.is_text else array)
        known = np.asarray(exact.is_valid())
        return np.where(known, np.asarray(exact.fill_null(0)), integers), known | usable

    def texts(self) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
        """(n,) names, "" where there is none; and a mask of usable ones. Equal ones share one string."""
        array = self.values
        if not isinstance(array, pa.Array):
            return _each(array, _name, "", np.object_)
        if pa.types.is_integer(array.type):
            array = pc.cast(array, pa.string())
        elif pa.types.is_binary(array.type):
            try:
                array = pc.cast(array, pa.string())
            except pa.ArrowInvalid:
                return _each([self.raw(row) for row in range(len(array))], _name, "", np.object_)
        elif not (pa.types.is_string(array.type) or pa.types.is_large_string(array.type)):
            return np.full(len(array), "", dtype=object), np.zeros(len(array), dtype=bool)
        usable = np.array(pc.less_equal(pc.utf8_length(array), LONGEST_NAME).fill_null(False))
        coded = pc.fill_null(array, "").dictionary_encode()
        names = np.array([*coded.dictionary.to_pylist(), ""], dtype=object)
        return names[np.asarray(coded.indices)], usable


def as_column(values: Any, is_text: bool = False, decimal: str = ".") -> InputColumn:
    """A column of a pandas series, a NumPy array, a list or an Arrow array.

    Numbers that are NaN are missing values in pandas, and so they are here.
    """
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


def _trimmed(array: pa.Array) -> pa.Array:
    """Text without white space around it; null where it is empty."""
    text = pc.ascii_trim_whitespace(array)
    return pc.if_else(pc.equal(text, ""), None, text)


def _exact(array: pa.Array) -> pa.Array:
    """Whole numbers as int64, of which float64 has not all; null where there is none."""
    try:
        return pc.cast(array, pa.int64())
    except pa.ArrowInvalid:
        if pa.types.is_integer(array.type):
            fits = pc.less_equal(array, pa.scalar(np.iinfo(np.int64).max, array.type))
        else:
            fits = pc.match_substring_regex(array, _SHORT_WHOLE)
        return pc.cast(pc.if_else(fits, array, None), pa.int64())


def _numeric_text(array: pa.Array, decimal: str) -> pa.Array:
    """Text as Arrow reads numbers; null where it is none."""
    text = _trimmed(array)
    if decimal != ".":
        text = pc.replace_substring(text, decimal, ".")
    try:
        return pc.cast(text, pa.float64())
    except pa.ArrowInvalid:
        return pc.cast(pc.if_else(pc.match_substring_regex(text, _NUMBER), text, None), pa.float64())


def _as_number(text: str, decimal: str) -> Any:
    """A number that is written as text; other text as it is, None where it is empty."""
    if not text:
        return None
    if _WHOLE.fullmatch(text) and len(text) < 300:
        return int(text)
    number = number_in(text.replace(decimal, "."))
    return text if number is None else number


def _each(
    values: Sequence[Any], read: Callable[[Any], Any], otherwise: Any, kind: type[np.generic]
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Python objects one by one; ``read`` gives None for what cannot be used."""
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
