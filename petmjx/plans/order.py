"""Orders (``Order``), their items (``Item``), and their targets, such as a Euro pallet."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import number_in

TARGET_EXTENT_MM: dict[str, tuple[int, int]] = {"euro-pallet": (1200, 800), "rollcontainer": (800, 700)}
"""BED-BPP's two targets (the carriers of orders) → their extents along x and y, mm."""
_SIZED_TARGET = re.compile(r"([0-9.]{1,9})\s*[x×]\s*([0-9.]{1,9})")
TARGET_RANGE_MM = (100.0, 20_000.0)
"""Allowed range for the sides of a target."""
MOST_ITEMS = 512
"""Largest number of items of an order: twice the number of boxes in the largest known plan of other packers. The
computing time of packers grows with the third power of the number of items."""


@dataclass(frozen=True)
class Item:
    """One box of an order, with BED-BPP's fields.

    Attributes:
        com_mm: centre of mass relative to the item's middle, along length, width and height, mm; None: it is in the
            middle.
        stiffness_n_mm: as in ``Plan``; None: rigid.
        kind: "box", "sheet" or "" (a box).
        strength_n: load that the box can bear on its top, N; None: unknown. Written files of orders do not contain
            ``strength_n``.
        upright: the letters ("l", "w" and "h") of the sizes that may be vertical; "": only the height may be vertical.
            Written files of orders do not contain ``upright``.
    """

    article: str
    item_id: str
    product_group: str
    length_mm: float
    width_mm: float
    height_mm: float
    weight_kg: float
    com_mm: tuple[float, float, float] | None = field(default=None, kw_only=True)
    stiffness_n_mm: float | None = field(default=None, kw_only=True)
    kind: str = field(default="", kw_only=True)
    # packers, and the matching of plans with orders, do not use these two fields, so comparisons of items ignore them
    strength_n: float | None = field(default=None, kw_only=True, compare=False)
    upright: str = field(default="", kw_only=True, compare=False)

    @property
    def volume_m3(self) -> float:
        """Volume in m³."""
        return self.length_mm * self.width_mm * self.height_mm * 1e-9


@dataclass(frozen=True)
class Order:
    """An order: the items for one target ("euro-pallet", "rollcontainer", or sizes in millimetres, "1200x1000").

    ``numbers`` are the sequence numbers that the items have in a file. Generated orders have no sequence numbers.
    """

    target: str
    items: tuple[Item, ...]
    numbers: tuple[int, ...] = ()


def target_named(text: str) -> str:
    """The name of a target: "euro-pallet", "rollcontainer", or its sizes along x and y, mm, as in "1200x1000".

    Raises:
        InputError: the text names no target.
    """
    if text in TARGET_EXTENT_MM:
        return text
    match = _SIZED_TARGET.fullmatch(text.strip())
    sides = [] if match is None else [number_in(side) for side in match.groups()]
    low, high = TARGET_RANGE_MM
    if len(sides) != 2 or not all(side is not None and low <= side <= high for side in sides):
        raise InputError(
            f"target must be {', '.join(TARGET_EXTENT_MM)} or its sizes in mm, such as 1200x1000, {shown_value(text)}"
        )
    return "x".join(f"{side:g}" for side in sides)


def is_target(text: str) -> bool:
    """Whether a text is the name of a target."""
    try:
        return target_named(text) == text
    except InputError:
        return False


def target_extent_mm(target: str) -> tuple[float, float]:
    """Extents of a target (``Order.target``) along x and y, mm."""
    if target in TARGET_EXTENT_MM:
        return TARGET_EXTENT_MM[target]
    length, _, width = target_named(target).partition("x")
    return float(length), float(width)
