"""Checks of the arguments of public functions. If an argument has a wrong type, an error of one line names the
argument."""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError

Kind = TypeVar("Kind")


def path_of(value: Any, name: str) -> Path:
    """The value as a path. An empty path is refused, because ``Path("")`` would be the current folder.

    Raises:
        InputError: the value is not a path, or is empty.
    """
    usable = isinstance(value, Path) or (isinstance(value, str | PathLike) and bool(str(value)))
    if not usable:
        raise InputError(f"{name} must be a path, {shown_value(value)}")
    try:
        return Path(value)
    except TypeError:  # Path() refuses a path in bytes
        raise InputError(f"{name} must be a path, {shown_value(value)}") from None


def text_of(value: Any, name: str) -> str:
    """The value, if it is text. Raises InputError if the value is not text."""
    return instance_of(value, name, str, "text")


def flag_of(value: Any, name: str) -> bool:
    """The value, if it is True or False. Raises InputError if the value is neither of the two."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} must be true or false, {shown_value(value)}")
    return bool(value)


def integer_of(value: Any, name: str, least: int | None = None, most: int | None = None) -> int:
    """The value, if it is a whole number within the limits.

    Raises:
        InputError: the value is not a whole number, or is beyond a limit.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise InputError(f"{name} must be a whole number, {shown_value(value)}")
    _check_limits(int(value), name, least, most)
    return int(value)


def number_of(value: Any, name: str, least: float | None = None, most: float | None = None) -> float:
    """The value as a float, if it is a finite number within the limits.

    Raises:
        InputError: the value is not a finite number, or is beyond a limit.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{name} must be a number, {shown_value(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{name} must be finite, {shown_value(value)}")
    _check_limits(number, name, least, most)
    return number


def instance_of(value: Any, name: str, kind: type[Kind], words: str) -> Kind:
    """The value, if it is an object of the class ``kind``.

    Args:
        words: what the error message says that the value must be, such as "a Batching".

    Raises:
        InputError: the value is of another class.
    """
    if not isinstance(value, kind):
        raise InputError(f"{name} must be {words}, {shown_value(value)}")
    return value


def list_of(values: Any, name: str, kind: type[Kind], words: str) -> list[Kind]:
    """The values of any iterable as a list, if all of them are objects of the class ``kind``.

    Args:
        words: what the error message says that the values must be, such as "Plan objects".

    Raises:
        InputError: the value is text, cannot be iterated, or has a member of another class.
    """
    try:
        members = None if isinstance(values, str | bytes) else list(values)
    except Exception:  # iterating an object of any class may raise anything
        members = None
    if members is None:
        raise InputError(f"{name} must be a list of {words}, {shown_value(values)}")
    # a fast check, since a list may have the names of all boxes of 10,000 plans
    if not set(map(type, members)) <= {kind}:
        for index, value in enumerate(members):
            instance_of(value, f"{name}[{index}]", kind, words)
    return members


def array_of(values: Any, name: str, shape: tuple[int, ...], *, may_lack: bool = False) -> NDArray[np.float64]:
    """The values as an array of finite float64 numbers.

    Args:
        shape: shape of one entry, such as (3,) if the array has the shape (n, 3), or () if it has the shape (n,).
        may_lack: whether the array may have NaN, which means that a value is not given.

    Raises:
        InputError: the value is not an array of finite numbers, or has another shape.
    """
    try:
        array = np.asarray(values)
    except Exception:  # converting an object of any class may raise anything
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} must be an array of numbers, {shown_value(values)}")
    if array.ndim != 1 + len(shape) or array.shape[1:] != shape:
        raise InputError(f"{name} must have the shape ({', '.join(['n', *map(str, shape)])}), got {array.shape}")
    if array.dtype.kind == "f" and not (np.isfinite(array) | (may_lack & np.isnan(array))).all():
        raise InputError(f"{name} must be finite")
    return array.astype(np.float64, copy=False)


def _check_limits(value: float, name: str, least: float | None, most: float | None) -> None:
    if least is not None and value < least:
        raise InputError(f"{name} must be at least {least:,}, {shown_value(value)}")
    if most is not None and value > most:
        raise InputError(f"{name} must be at most {most:,}, {shown_value(value)}")
