"""Items of an order that a packing leaves out (``LeftOutItems``), and why ``petmjx.pack`` leaves them out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from petmjx.common.text import count_text, printable_name
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.plans.order import Order

NO_PLACE: Final = "no packing has room for more boxes"
FALLS: Final = "packings with more boxes do not stand often enough"
"""The two reasons why ``petmjx.pack``, which chooses among packings by simulation, leaves items out."""


@dataclass(frozen=True)
class LeftOutItems:
    """Items of one order that a packing leaves out.

    Attributes:
        order_id: id of the order and of the plan.
        n_items: number of items of the order.
        numbers: keys of the left-out items in the order's ``item_sequence``, in ascending order. A generated order has
            no keys; its items are numbered from 1.
        why: the reason why items are left out. If the reason is that there is no place below 2 m for them, ``why`` is
            "".
    """

    order_id: str
    n_items: int
    numbers: tuple[int, ...]
    why: str = ""

    def __str__(self) -> str:
        """The left-out items as a text for messages, as in "order 00100408: 3 of 40 boxes are left out: items 3, 7,
        8"."""
        many, few = count_text(self.n_items, "box", "boxes"), len(self.numbers)
        numbers = ", ".join(map(str, self.numbers))
        verb, items = ("is", "item") if few == 1 else ("are", "items")
        why = f": {self.why}" if self.why else ""
        return f"order {printable_name(self.order_id)}: {few} of {many} {verb} left out: {items} {numbers}{why}"


def left_out_of(order_id: str, order: Order, placed: Iterable[PlacedBox], why: str = "") -> LeftOutItems | None:
    """The items of an order that a packing leaves out; None if it leaves out no item."""
    counts = Counter(box.item for box in placed)
    missing = []
    # generated orders have no numbers, so their items are numbered from 1
    for number, item in zip(order.numbers or range(1, len(order.items) + 1), order.items, strict=True):
        counts[item] -= 1
        if counts[item] < 0:
            missing.append(number)
    return LeftOutItems(order_id, len(order.items), tuple(missing), why) if missing else None
