"""Checks the arguments of the methods of pallets: arrays of boxes, and numbers of pallets. An error is one line that
names the argument."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import array_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.common.units import FloatArray
from petmjx.plans.plan_fields import FARTHEST_MM, LARGEST_KG, LARGEST_MM, SMALLEST_KG, SMALLEST_MM

_LIMITS: Final = {
    "size_mm": (SMALLEST_MM, LARGEST_MM, "millimetres"),
    "corner_mm": (-FARTHEST_MM, FARTHEST_MM, "millimetres"),
    "mass_kg": (SMALLEST_KG, LARGEST_KG, "kilograms"),
}


@dataclass(frozen=True, eq=False)
class Placements:
    """m placements: boxes with their places on pallets.

    Attributes:
        size_mm, corner_mm: (m, 3) extents and front-left-bottom corners of the boxes; ``mass_kg``: (m,) masses of the
            boxes; ``pallet``: (m,) numbers of the boxes' pallets.
    """

    size_mm: FloatArray
    corner_mm: FloatArray
    mass_kg: FloatArray
    pallet: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.pallet)

    def take(self, rows: Any) -> Placements:
        """The placements in the given rows."""
        return Placements(self.size_mm[rows], self.corner_mm[rows], self.mass_kg[rows], self.pallet[rows])


def placements_of(size_mm: Any, corner_mm: Any, mass_kg: Any, pallet: Any, n: int) -> Placements:
    """Make placements from the arguments of ``Pallets.place`` and ``Pallets.try_all``. For a single box, the first axis
    may be left out.

    Args:
        n: number of pallets. If ``pallet`` is None, box i is for pallet i, or all boxes are for the only pallet.

    Raises:
        InputError: a shape or length is wrong, a number is not finite or is out of range, or a pallet does not exist.
    """
    corners = _numbers(corner_mm, "corner_mm", (3,))
    m = len(corners)
    sizes, masses = (
        _as_many(_numbers(values, name, shape), name, m)
        for values, name, shape in ((size_mm, "size_mm", (3,)), (mass_kg, "mass_kg", ()))
    )
    return Placements(sizes, corners, masses, _pallets(pallet, m, n))


def boxes_of(size_mm: Any, pallet: Any, n: int) -> Placements:
    """Make placements from the arguments of ``Pallets.places``, which has only the extents of the boxes. Corners and
    masses are placeholders.

    Raises:
        InputError: see ``placements_of``.
    """
    sizes = _numbers(size_mm, "size_mm", (3,))
    return Placements(sizes, np.zeros_like(sizes), np.ones(len(sizes)), _pallets(pallet, len(sizes), n))


def grid_of(grid_mm: Any, extent_mm: tuple[float, float]) -> FloatArray:
    """(p, 2) x and y of points on a carrier, checked, mm.

    Raises:
        InputError: the shape is wrong, or a point is outside the carrier.
    """
    corners = array_of(grid_mm, "grid_mm", (2,))
    if ((corners < 0) | (corners > extent_mm)).any():
        raise InputError(
            "grid_mm: all points must lie on the carrier, from (0, 0) to ({:g}, {:g}) mm".format(*extent_mm)
        )
    return corners


def pallets_of(pallet: Any, n: int, name: str = "pallet") -> NDArray[np.int64]:
    """The numbers of the pallets that the argument ``pallet`` selects. If ``pallet`` is None, all pallets are selected.

    Raises:
        InputError: values are not whole numbers, or a pallet does not exist.
    """
    if pallet is None:
        return np.arange(n)
    try:
        values = np.atleast_1d(np.asarray(pallet))
    except Exception:  # converting an object of an unknown class may raise anything
        values = np.empty(0, dtype=object)
    if values.ndim != 1 or (values.dtype.kind not in "iu" and values.size):
        raise InputError(f"{name} must be whole numbers (indices of pallets), {shown_value(pallet)}")
    wrong = values[(values < 0) | (values >= n)] if values.size else values
    if wrong.size:
        range_text = "there is pallet 0 alone" if n == 1 else f"there are pallets 0 to {n - 1}"
        raise InputError(f"{name}: {range_text}, got {wrong[0]}")
    return values.astype(np.int64)


def once_each(pallet: NDArray[np.int64], name: str = "pallet") -> None:
    """Raise InputError if a pallet is named twice."""
    values, counts = np.unique(pallet, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"{name}: {values[counts > 1][0]} is named twice; name each pallet once in a call")


def _pallets(pallet: Any, m: int, n: int) -> NDArray[np.int64]:
    if pallet is None and n == 1:
        return np.zeros(m, np.int64)
    if pallet is None:
        if m != n:
            raise InputError(f"pallet must name one of the {n} pallets for each box")
        return np.arange(n)
    values: NDArray[np.int64] = _as_many(pallets_of(pallet, n), "pallet", m)
    return values


def _numbers(values: Any, name: str, shape: tuple[int, ...]) -> FloatArray:
    if values is None:
        raise InputError(f"{name} is missing")
    try:
        one = np.ndim(values) == len(shape)
    except Exception:  # the lists in the argument differ in length; array_of raises the error
        one = False
    numbers = array_of([values] if one else values, name, shape)
    check_limits(numbers, name)
    return numbers


def check_limits(values: NDArray[Any], name: str) -> None:
    """Raise InputError if a number in ``size_mm``, ``corner_mm`` or ``mass_kg`` is out of range or NaN."""
    low, high, unit = _LIMITS[name]
    wrong = values[~((values >= low) & (values <= high))]
    if wrong.size:
        raise InputError(f"{name} must be from {low:g} to {high:g} {unit}, got {wrong[0]:g}")


def _as_many(values: Any, name: str, m: int) -> Any:
    """The values, one for each of m boxes. A single value is repeated for all boxes."""
    if len(values) == 1 and m != 1:
        return np.repeat(values, m, axis=0)
    if len(values) != m:
        raise InputError(f"{name} must have {count_text(m, 'row')}, one for each box, got {len(values)}")
    return values
