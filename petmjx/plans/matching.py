"""Boxes of a plan matched with the items of its order: which item each box is, and whether it is as it was ordered.

Boxes are known by ``id`` and ``article`` together, by the one of them that is there, or, where a box has neither, by
size and mass. Each item is one box at most, so a box that is packed twice was ordered once. ``sequence`` says nothing,
since packers renumber boxes. Sizes are compared whichever way a box stands.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.plans.plan import Plan
from petmjx.plans.samples.orders import Item, Order

SIZE_TOLERANCE_MM: Final = 0.5
"""Sizes that differ by no more are the same: orders have whole millimetres, and packers may round to them."""

MASS_TOLERANCE: Final = 0.001
"""Masses that differ by no more, as a share of the order's, are the same; so are those that differ by no more than half
a gram, to which small masses are rounded."""

MASS_TOLERANCE_KG: Final = 0.0005

_ROUNDING: Final = 1e-9
"""What sums in binary may add to a difference that is a tolerance exactly."""


@dataclass(frozen=True, eq=False)
class Matching:
    """The n boxes of a plan and the m items of its order.

    Attributes:
        item: (n,) which item each box is; −1: nobody ordered it, or not so often.
        resized: (n,) whether the box has another size or mass than its item.
        by_size: (n,) whether the box has neither id nor article, and was matched by size and mass.
        sheets: (n,) interlayer sheets, which orders need not have.
        n_items: m.
    """

    item: NDArray[np.int64]
    resized: NDArray[np.bool_]
    by_size: NDArray[np.bool_]
    sheets: NDArray[np.bool_]
    n_items: int

    @property
    def as_ordered(self) -> NDArray[np.bool_]:
        """(n,) whether a box is an ordered one, with its size and mass."""
        return (self.item >= 0) & ~self.resized

    @property
    def not_ordered(self) -> NDArray[np.bool_]:
        """(n,) boxes that nobody ordered; sheets are none."""
        return (self.item < 0) & ~self.sheets

    @property
    def left_out(self) -> int:
        """Items that no box is."""
        return self.n_items - int(np.count_nonzero(self.item >= 0))


class _Names(NamedTuple):
    """What a box or an item is called; "" where it has no such name."""

    item_id: str
    article: str


_Key = Callable[[_Names], Hashable]
_Takes = Callable[[_Names], bool]


class _Way(NamedTuple):
    """A way in which boxes are known: those with the same key; None: neither side has one.

    Attributes:
        boxes, items: which of them it is for.
        named: whether the key says which item a box is, whatever its size.
    """

    key: _Key
    boxes: _Takes
    items: _Takes
    named: bool = True


def _any(names: _Names) -> bool:
    return True


_WAYS: Final = (
    _Way(lambda names: names, any, any),
    _Way(lambda names: names.item_id or None, lambda box: not box.article, _any),
    _Way(lambda names: names.article or None, lambda box: not box.item_id, _any),
    _Way(lambda names: names.item_id or None, _any, lambda item: not item.article),
    _Way(lambda names: names.article or None, _any, lambda item: not item.item_id),
    _Way(lambda names: (), lambda box: not any(box), _any, named=False),
    _Way(lambda names: (), _any, lambda item: not any(item), named=False),
)
"""One after the other, for the boxes and items that are left: first for boxes of the same size and mass, then for
others. A name that one side lacks does not tell them apart."""


def match(plan: Plan, order: Order) -> Matching:
    """Match the boxes of a plan with the items of its order."""
    boxes = [_Names(*names) for names in zip(plan.item_ids, plan.articles, strict=True)]
    items = [_Names(item.item_id, item.article) for item in order.items]
    of_boxes, of_items = _measures(plan.size_mm, plan.mass_kg), _measures_of(order.items)
    matched = np.full(plan.n_boxes, -1)
    resized, by_size = (np.zeros(plan.n_boxes, bool) for _ in range(2))
    _match_equal(boxes, of_boxes, items, of_items, matched)
    for alike in (True, False):
        for way in _WAYS:
            if not alike and not way.named:
                continue
            left = np.flatnonzero(matched < 0).tolist()
            free = sorted(set(range(len(items))) - set(matched.tolist()))
            if not left or not free:
                break
            items_by_key = _groups(free, items, way.items, way.key)
            for key, some in _groups(left, boxes, way.boxes, way.key).items():
                same_items = items_by_key.get(key, [])
                pairs = _alike(some, same_items, of_boxes, of_items) if alike else zip(some, same_items, strict=False)
                for box, item in pairs:
                    matched[box], resized[box], by_size[box] = item, not alike, not way.named
    return Matching(matched, resized, by_size, plan.sheets, len(items))


def _match_equal(
    boxes: list[_Names], of_boxes: FloatArray, items: list[_Names], of_items: FloatArray, matched: NDArray[np.int64]
) -> None:
    """Match boxes that have all of an item's names and its very size and mass: most of them, and quickly."""
    free: dict[Hashable, list[int]] = defaultdict(list)
    for number in reversed(range(len(items))):
        free[items[number], *of_items[number].tolist()].append(number)
    for box, (names, measures) in enumerate(zip(boxes, of_boxes.tolist(), strict=True)):
        if any(names) and (same := free.get((names, *measures))):
            matched[box] = same.pop()


def _groups(numbers: list[int], names: list[_Names], takes: _Takes, key: _Key) -> dict[Hashable, list[int]]:
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number in numbers:
        if takes(names[number]) and (value := key(names[number])) is not None:
            groups[value].append(number)
    return groups


def _alike(boxes: list[int], items: list[int], of_boxes: FloatArray, of_items: FloatArray) -> list[tuple[int, int]]:
    """(box, item) of the same size and mass."""
    if not items:
        return []
    same = _same(of_boxes[boxes][:, None], of_items[items][None])
    free = np.ones(len(items), bool)
    pairs = []
    for row, box in enumerate(boxes):
        if (fits := same[row] & free).any():
            column = int(fits.argmax())
            free[column] = False
            pairs.append((box, items[column]))
    return pairs


def _same(box: FloatArray, item: FloatArray) -> NDArray[np.bool_]:
    """Whether size and mass are the same, within the tolerances."""
    apart = np.abs(box - item)
    sizes = (apart[..., :3] <= SIZE_TOLERANCE_MM + _ROUNDING).all(axis=-1)
    masses = apart[..., 3] <= np.maximum(MASS_TOLERANCE * item[..., 3], MASS_TOLERANCE_KG) + _ROUNDING
    return np.asarray(sizes & masses)


def _measures(size_mm: FloatArray, mass_kg: FloatArray) -> FloatArray:
    """(n, 4) sizes, the smallest first, and mass."""
    return np.column_stack([np.sort(size_mm, axis=1), mass_kg])


def _measures_of(items: tuple[Item, ...]) -> FloatArray:
    sizes = np.array([(item.length_mm, item.width_mm, item.height_mm) for item in items], float).reshape(-1, 3)
    return _measures(sizes, np.array([item.weight_kg for item in items], float))
