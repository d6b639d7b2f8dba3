"""Matches the boxes of a plan with the items of its order (``match``).

Boxes are matched by ``id`` and ``article`` together, by whichever of the two names is present, or, if there are no
names, by size, mass and properties. An item matches at most one box: if it is packed twice, the second box was not
ordered. ``sequence`` is ignored, because packers renumber boxes. Sizes are compared in any orientation.

Properties of goods belong to the order, not to the packer: a box that differs from its item in centre of mass,
stiffness or kind counts as different, as if its size differed. The properties of an item are taken from the order, else
from the user's table of articles (:func:`with_properties`). If neither gives properties, the item's centre of mass is
in its middle, and the item is rigid.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.order import Item, Order, target_extent_mm
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import SHEET

if TYPE_CHECKING:  # importing Articles at run time would load Arrow
    from petmjx.plans.articles import Articles

SIZE_TOLERANCE_MM: Final = 0.5
"""Sizes that differ by at most this length count as equal: orders have whole millimetres, and packers may round to
them."""

MASS_TOLERANCE: Final = 0.001
"""Masses that differ by at most this share of the ordered mass count as equal."""

MASS_TOLERANCE_KG: Final = 0.0005
"""Masses that differ by at most half a gram also count as equal, even if the difference exceeds the share
``MASS_TOLERANCE``, since small masses are rounded."""

_ROUNDING: Final = 1e-9
"""Allowance for rounding in float64: a difference that equals a tolerance exactly may be computed as slightly
larger."""


@dataclass(frozen=True, eq=False)
class Matching:
    """How the n boxes of a plan match the m items of its order.

    Attributes:
        item: (n,) the item of each box; −1: the box was not ordered, or other boxes already have all items that fit it.
        resized: (n,) whether the box differs from its item in size, mass, centre of mass, stiffness or kind.
        same_size: (n,) whether a ``resized`` box has the size and mass of its item, so that the box differs only in
            other properties.
        by_size: (n,) whether the box was matched by size and mass, because the box or the item has neither id nor
            article.
        sheets: (n,) whether the box is an interlayer sheet. Orders need not contain sheets.
        n_items: the number m of items.
    """

    item: NDArray[np.int64]
    resized: NDArray[np.bool_]
    by_size: NDArray[np.bool_]
    sheets: NDArray[np.bool_]
    n_items: int
    same_size: NDArray[np.bool_]

    @property
    def as_ordered(self) -> NDArray[np.bool_]:
        """(n,) whether a box was ordered, and has the size, the mass and the properties of its item."""
        return (self.item >= 0) & ~self.resized

    @property
    def not_ordered(self) -> NDArray[np.bool_]:
        """(n,) whether a box was not ordered. Sheets never count as not ordered."""
        return (self.item < 0) & ~self.sheets

    @property
    def left_out(self) -> int:
        """The number of items that no box matches."""
        return self.n_items - int(np.count_nonzero(self.item >= 0))


class _Names(NamedTuple):
    """The names of a box or an item; "" for a missing name."""

    item_id: str
    article: str


_Key = Callable[[_Names], Hashable]
_Takes = Callable[[_Names], bool]


class _MatchKey(NamedTuple):
    """One rule of matching: boxes and items with the same key match.

    Attributes:
        key: function that returns the key of a box or an item; None: the box or item has no key, and matches nothing.
        boxes, items: functions that tell whether a box, or an item, takes part in the rule.
        named: whether the key alone identifies the item, even if the size of the box differs.
    """

    key: _Key
    boxes: _Takes
    items: _Takes
    named: bool = True


def _any(names: _Names) -> bool:
    return True


_WAYS: Final = (
    _MatchKey(lambda names: names, any, any),
    _MatchKey(lambda names: names.item_id or None, lambda box: not box.article, _any),
    _MatchKey(lambda names: names.article or None, lambda box: not box.item_id, _any),
    _MatchKey(lambda names: names.item_id or None, _any, lambda item: not item.article),
    _MatchKey(lambda names: names.article or None, _any, lambda item: not item.item_id),
    _MatchKey(lambda names: (), lambda box: not any(box), _any, named=False),
    _MatchKey(lambda names: (), _any, lambda item: not any(item), named=False),
)
"""Rules of matching, in order. Each rule is applied to the boxes and items that are still unmatched. In a first pass,
all rules match only boxes and items of equal size and mass. In a second pass, the rules that compare names (``named``)
match the rest regardless of size. A name that the box or the item lacks is not compared."""


def match(plan: Plan, order: Order) -> Matching:
    """Match the boxes of a plan with the items of its order."""
    boxes = [_Names(*names) for names in zip(plan.item_ids, plan.articles, strict=True)]
    items = [_Names(item.item_id, item.article) for item in order.items]
    of_boxes, of_items = _measures(plan.size_mm, plan.mass_kg), _measures_of(order.items)
    if _has_properties(plan) or any(map(item_has_properties, order.items)):
        of_boxes = np.column_stack([of_boxes, _properties(plan, of_boxes[:, :3])])
        of_items = np.column_stack([of_items, _properties_of(order.items, of_items[:, :3])])
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
            for key, group_boxes in _groups(left, boxes, way.boxes, way.key).items():
                same_items = items_by_key.get(key, [])
                pairs = (
                    _equal_pairs(group_boxes, same_items, of_boxes, of_items)
                    if alike
                    else zip(group_boxes, same_items, strict=False)
                )
                for box, item in pairs:
                    matched[box], resized[box], by_size[box] = item, not alike, not way.named
    same_size = resized.copy()
    if resized.any():
        same_size &= _equal_measures(of_boxes[:, :_N_PLAIN], of_items[matched][:, :_N_PLAIN])
    return Matching(matched, resized, by_size, plan.sheets, len(items), same_size)


def _match_equal(
    boxes: list[_Names], of_boxes: FloatArray, items: list[_Names], of_items: FloatArray, matched: NDArray[np.int64]
) -> None:
    """Match boxes that have exactly the names, size and mass of an item. This exact matching is fast, and matches most
    boxes."""
    free: dict[Hashable, list[int]] = defaultdict(list)
    for number in reversed(range(len(items))):
        free[items[number], *of_items[number].tolist()].append(number)
    for box, (names, measures) in enumerate(zip(boxes, of_boxes.tolist(), strict=True)):
        if any(names) and (same_items := free.get((names, *measures))):
            matched[box] = same_items.pop()


def _groups(numbers: list[int], names: list[_Names], takes: _Takes, key: _Key) -> dict[Hashable, list[int]]:
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number in numbers:
        if takes(names[number]) and (value := key(names[number])) is not None:
            groups[value].append(number)
    return groups


def _equal_pairs(
    boxes: list[int], items: list[int], of_boxes: FloatArray, of_items: FloatArray
) -> list[tuple[int, int]]:
    """Pairs (box, item) of equal size and mass. Each box and each item is in at most one pair."""
    if not items:
        return []
    is_equal = _equal_measures(of_boxes[boxes][:, None], of_items[items][None])
    free = np.ones(len(items), bool)
    pairs = []
    for row, box in enumerate(boxes):
        if (fits := is_equal[row] & free).any():
            column = int(fits.argmax())
            free[column] = False
            pairs.append((box, items[column]))
    return pairs


def _equal_measures(box: FloatArray, item: FloatArray) -> NDArray[np.bool_]:
    """Whether sizes and masses are equal within the tolerances, and also the properties (stiffness, kind and centre of
    mass), if the arrays have them."""
    apart = np.abs(box - item)
    sizes = (apart[..., :3] <= SIZE_TOLERANCE_MM + _ROUNDING).all(axis=-1)
    masses = apart[..., 3] <= np.maximum(MASS_TOLERANCE * item[..., 3], MASS_TOLERANCE_KG) + _ROUNDING
    equal = np.asarray(sizes & masses)
    if box.shape[-1] == _N_PLAIN:
        return equal
    box, item = box[..., _N_PLAIN:], item[..., _N_PLAIN:]
    stiff = np.abs(box[..., 0] - item[..., 0]) <= MASS_TOLERANCE * item[..., 0] + _ROUNDING
    equal &= stiff & (box[..., 1] == item[..., 1])
    return np.asarray(equal & _equal_centres(box[..., 2:], item[..., 2:]))


def _equal_centres(box: FloatArray, item: FloatArray) -> NDArray[np.bool_]:
    """Whether the centre of mass of each box is at the same point as in its item, in at least one orientation of the
    box.

    Args:
        box, item: (…, 6) lengths, widths and heights, and centres of mass along them, mm.
    """
    equal = np.zeros(np.broadcast_shapes(box.shape[:-1], item.shape[:-1]), bool)
    for axes, signs in _ROTATIONS:
        turned = np.concatenate([box[..., axes], box[..., 3:][..., axes] * signs], axis=-1)
        equal |= (np.abs(turned - item) <= SIZE_TOLERANCE_MM + _ROUNDING).all(axis=-1)
    return equal


def _parity(axes: tuple[int, ...]) -> int:
    return 1 if axes in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1


_ROTATIONS: Final = tuple(
    (list(axes), np.array(signs, float))
    for axes in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if _parity(axes) * signs[0] * signs[1] * signs[2] == 1
)
"""The 24 rotations of a box, as orders of its axes with their signs. Mirror images are not included."""

_N_PLAIN: Final = 4
"""Number of columns of :func:`_measures`."""


def _has_properties(plan: Plan) -> bool:
    return plan.mass_center_mm is not None or plan.stiffness_n_mm is not None or bool(plan.kinds)


def item_has_properties(item: Item) -> bool:
    """Whether an item has a centre of mass or a stiffness, or is a sheet."""
    return item.com_mm is not None or item.stiffness_n_mm is not None or item.kind == SHEET


def _properties(plan: Plan, sizes: FloatArray) -> FloatArray:
    """(n, 8) for each box: stiffness (0: rigid), whether it is a sheet, three sizes, and the centre of mass along
    length, width and height."""
    stiff = np.zeros(plan.n_boxes) if plan.stiffness_n_mm is None else np.nan_to_num(plan.stiffness_n_mm)
    return _as_rows(stiff, plan.sheets, plan.item_size_mm, plan.item_com_mm, sizes)


def _properties_of(items: tuple[Item, ...], sizes: FloatArray) -> FloatArray:
    stiff = np.array([item.stiffness_n_mm or 0.0 for item in items])
    sheets = np.array([item.kind == SHEET for item in items])
    extents = np.array([(item.length_mm, item.width_mm, item.height_mm) for item in items], float)
    return _as_rows(stiff, sheets, extents, np.array([item.com_mm or (0.0, 0.0, 0.0) for item in items]), sizes)


def _as_rows(
    stiff: FloatArray, sheets: NDArray[np.bool_], extents: FloatArray, com_mm: FloatArray, sizes: FloatArray
) -> FloatArray:
    """(n, 8) the properties of n boxes, as in ``_properties``. If the centre of mass of a box is in the middle, the
    sizes are sorted, so that equal boxes have equal rows in any orientation."""
    off = com_mm.any(axis=1, keepdims=True)
    return np.column_stack([stiff, sheets, np.where(off, extents, sizes), com_mm])


def with_properties(order: Order, articles: Articles | None) -> Order:
    """A copy of the order, in which items without properties have the properties from a table of articles."""
    if articles is None:
        return order
    return replace(order, items=tuple(_filled_up(item, articles) for item in order.items))


def _filled_up(item: Item, articles: Articles) -> Item:
    article = articles.find(item.article, item.product_group)
    com_mm = article.com_mm if item.com_mm is None else item.com_mm
    stiffness = article.stiffness_n_mm if item.stiffness_n_mm is None else item.stiffness_n_mm
    return replace(item, com_mm=com_mm, stiffness_n_mm=stiffness)


def _measures(size_mm: FloatArray, mass_kg: FloatArray) -> FloatArray:
    """(n, 4) the three sizes in ascending order, mm, and the mass, kg."""
    return np.column_stack([np.sort(size_mm, axis=1), mass_kg])


def _measures_of(items: tuple[Item, ...]) -> FloatArray:
    sizes = np.array([(item.length_mm, item.width_mm, item.height_mm) for item in items], float).reshape(-1, 3)
    return _measures(sizes, np.array([item.weight_kg for item in items], float))


def on_target(plan: Plan, order: Order) -> NDArray[np.bool_]:
    """(n,) whether each box of a plan is on the order's target (the carrier for which the order was made).

    If the plan's bounding box fits on the target, possibly turned, all boxes count as on the target, wherever the plan
    has its origin. If the bounding box does not fit, the target's corner is assumed to be at the origin, and a box is
    on the target if its middle is.
    """
    extent = np.array(target_extent_mm(order.target), float)
    low, high = plan.corner_mm[:, :2], plan.corner_mm[:, :2] + plan.size_mm[:, :2]
    across = high.max(axis=0) - low.min(axis=0)
    if any((across <= target_extent + SIZE_TOLERANCE_MM).all() for target_extent in (extent, extent[::-1])):
        return np.ones(plan.n_boxes, bool)
    middle = (low + high) / 2
    return np.asarray(((middle >= 0) & (middle <= extent)).all(axis=1))
