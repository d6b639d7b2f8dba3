"""Matches plans with their orders (``match``, ``check_orders``).

``match`` finds the item of each box. Boxes are matched by ``id`` and ``article`` together, by whichever of the two
names is present, or, if there are no names, by size, mass and properties. An item matches at most one box: if it is
packed twice, the second box was not ordered. ``sequence`` is ignored, because packers renumber boxes. Sizes are
compared in any orientation.

Properties of goods belong to the order, not to the packer: a box that differs from its item in centre of mass,
stiffness or kind counts as different, as if its size differed. The properties of an item are taken from the order, else
from the user's table of articles (:func:`with_properties`). If neither gives properties, the item's centre of mass is
in its middle, and the item is rigid.

``check_orders`` compares plans with a file of orders. The comparison finds items that were left out, boxes that were
not ordered, and boxes with another size or mass than ordered.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.order import Item, Order, target_extent_mm
from petmjx.plans.order_reader import read_orders
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
        item: (n,) the item of each box; −1: the box was not ordered, or its items are already matched by other boxes.
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
all rules match only boxes and items of equal size and mass. In a second pass, the ``named`` rules match the rest
regardless of size. A name that the box or the item lacks is not compared."""


def match(plan: Plan, order: Order) -> Matching:
    """Match the boxes of a plan with the items of its order."""
    boxes = [_Names(*names) for names in zip(plan.item_ids, plan.articles, strict=True)]
    items = [_Names(item.item_id, item.article) for item in order.items]
    of_boxes, of_items = _measures(plan.size_mm, plan.mass_kg), _measures_of(order.items)
    if _has_properties(plan) or any(map(_item_has_properties, order.items)):
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
    """Whether the centre of mass of each box is at the same point as that of its item, in at least one orientation of
    the box.

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


def _item_has_properties(item: Item) -> bool:
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


MOST_LISTED: Final = 10_000
"""Largest number of plans, orders or errors that are listed one by one. Counts also cover the plans, orders and errors
that are not listed."""

MOST_ARTICLES: Final = 5
"""Largest number of articles that one line of text names; further articles are only counted."""


class PlanOrderCounts(NamedTuple):
    """Numbers of boxes that compare one plan with its order.

    Attributes:
        ordered_boxes: boxes in the order.
        left_out: ordered boxes that are not in the plan.
        not_ordered: boxes in the plan that were not ordered.
        resized: boxes in the plan that were ordered, but with another size, mass, centre of mass, stiffness or kind.
    """

    ordered_boxes: int
    left_out: int
    not_ordered: int
    resized: int = 0


@dataclass
class OrderCounts:
    """Counts that compare all plans of a run with all orders.

    Attributes:
        orders: usable orders in the file.
        ordered_boxes, left_out, not_ordered, resized: boxes (see :class:`PlanOrderCounts`) of all plans that have an
            order.
        matched_by_size: boxes of these plans without id and article, which were matched by size and mass.
        plans_leaving_out: plans that leave out at least one box.
        plans_without_order: plans for which the file has no usable order.
        orders_without_plan, boxes_without_plan: orders that have no usable plan, and their boxes; None: unknown,
            because not all plans were read.
        unusable_orders: orders in the file that could not be compared.
    """

    orders: int = 0
    ordered_boxes: int = 0
    left_out: int = 0
    not_ordered: int = 0
    plans_leaving_out: int = 0
    plans_without_order: int = 0
    orders_without_plan: int | None = 0
    boxes_without_plan: int | None = 0
    unusable_orders: int = 0
    resized: int = 0
    matched_by_size: int = 0


@dataclass
class OrderCheck:
    """The result of :func:`check_orders`. Each list in the result has at most ``MOST_LISTED`` entries.

    Attributes:
        file: name of the orders file.
        digest: digest of the ordered items, in hexadecimal.
        of_plan: plan id → counts, for each plan that has an order, including plans of other shards.
        counts: counts of this shard.
        lines: a line for each plan of this shard that differs from its order.
        without_plan: ids of the orders of this shard that have no usable plan.
        unusable: a line for each order that could not be compared.
    """

    file: str
    digest: str = ""
    of_plan: dict[str, PlanOrderCounts] = field(default_factory=dict)
    counts: OrderCounts = field(default_factory=OrderCounts)
    lines: list[str] = field(default_factory=list)
    without_plan: list[str] = field(default_factory=list)
    unusable: list[str] = field(default_factory=list)


def check_orders(
    path: Path,
    plans: Iterable[Plan],
    *,
    takes: Callable[[str], bool] = lambda plan_id: True,
    all_plans: bool = True,
    strict: bool = False,
    articles: Articles | None = None,
) -> OrderCheck:
    """Compare plans with the orders of a file, in BED-BPP's form or any other. A plan and its order have the same id.

    Args:
        path: the file, gzipped or not.
        plans: all plans of the run, with distinct ids.
        takes: function that returns whether the plan or order with an id is in this shard.
        all_plans: whether ``plans`` has all plans. If ``plans`` lacks some plans, orders without a plan are not
            counted.
        strict: whether to raise at the first unusable order, instead of leaving it out of the comparison.
        articles: the user's table of articles, for properties that the orders do not give.

    Raises:
        InputError: the file cannot be read, is damaged or has no usable order; or, with ``strict``, an order is
            unusable. The message names the file, the order and the field.
    """
    by_id = {plan.plan_id: plan for plan in plans}
    check = OrderCheck(printable(str(path)))
    counts, digest = check.counts, hashlib.blake2b(digest_size=16)

    def left_aside(error: InputError) -> None:
        counts.unusable_orders += 1
        _list(check.unusable, str(error))

    n_orders, n_taken_with_plan = 0, 0
    for order_id, order in read_orders(path, None if strict else left_aside):
        n_orders += 1
        digest.update(repr((order_id, sorted(map(_ordered_goods, order.items)))).encode("utf-8", "backslashreplace"))
        plan, in_shard = by_id.get(order_id), takes(order_id)
        counts.orders += in_shard
        if plan is not None:
            order = with_properties(order, articles)
            matching = match(plan, order)
            ordered = check.of_plan[order_id] = counts_of(matching)
            if in_shard:
                n_taken_with_plan += 1
                counts.ordered_boxes += ordered.ordered_boxes
                counts.left_out += ordered.left_out
                counts.not_ordered += ordered.not_ordered
                counts.resized += ordered.resized
                counts.matched_by_size += int(np.count_nonzero(matching.by_size))
                counts.plans_leaving_out += ordered.left_out > 0
                if ordered[1:] != (0, 0, 0):
                    _list(
                        check.lines,
                        f"plan {printable_name(plan.plan_id)}: {difference_in_words(plan, order, matching)}",
                    )
        elif in_shard and all_plans:
            counts.orders_without_plan = (counts.orders_without_plan or 0) + 1
            counts.boxes_without_plan = (counts.boxes_without_plan or 0) + len(order.items)
            _list(check.without_plan, order_id)
    if n_orders == 0:
        raise InputError(f"no usable order ({counts.unusable_orders} unusable); the first: {check.unusable[0]}")
    if not all_plans:
        counts.orders_without_plan = counts.boxes_without_plan = None
    counts.plans_without_order = sum(map(takes, by_id)) - n_taken_with_plan
    check.digest = digest.hexdigest()
    return check


def counts_of(matching: Matching) -> PlanOrderCounts:
    """The numbers of boxes that compare one plan with its order."""
    not_ordered, resized = (int(np.count_nonzero(mask)) for mask in (matching.not_ordered, matching.resized))
    return PlanOrderCounts(matching.n_items, matching.left_out, not_ordered, resized)


_RESIZED: Final = ("has another size or mass than ordered", "have other sizes or masses than ordered")
_ALTERED: Final = (
    "has another centre of mass, stiffness or kind than ordered",
    "have other centres of mass, stiffnesses or kinds than ordered",
)


def difference_in_words(plan: Plan, order: Order, matching: Matching) -> str:
    """The differences between a plan and its order: "2 of 9 ordered boxes are left out (2 × jam)"; empty if there are
    none."""
    ordered, parts = counts_of(matching), []
    if ordered.left_out:
        missing = set(range(len(order.items))) - set(matching.item.tolist())
        verb = "is" if ordered.left_out == 1 else "are"
        boxes = count_text(ordered.ordered_boxes, "ordered box", "ordered boxes")
        with_ids = any(plan.item_ids)
        names = [_name_of_item(order.items[item], with_ids) for item in sorted(missing)]
        parts.append(f"{ordered.left_out:,} of {boxes} {verb} left out ({_in_words(names)})")
    if ordered.not_ordered:
        verb = "was" if ordered.not_ordered == 1 else "were"
        names = [_name_of_box(plan, box) for box in np.flatnonzero(matching.not_ordered).tolist()]
        parts.append(f"{count_text(ordered.not_ordered, 'box', 'boxes')} {verb} not ordered ({_in_words(names)})")
    for counts, one, many in (
        (matching.resized & ~matching.same_size, *_RESIZED),
        (matching.same_size, *_ALTERED),
    ):
        if numbers := np.flatnonzero(counts).tolist():
            names = [f"{_name_of_box(plan, box)}: {_pair(plan, order, matching, box)}" for box in numbers]
            verb = one if len(numbers) == 1 else many
            parts.append(f"{count_text(len(numbers), 'box', 'boxes')} {verb} ({_in_words(names, '; ')})")
    return "; ".join(parts)


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


@dataclass(eq=False)
class OddBoxes:
    """Differences between many plans and their orders: for each kind of difference, the number of boxes that have it,
    and a description of the first of these boxes."""

    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, plan: Plan, order: Order, matching: Matching) -> None:
        """Add the differences between one plan and its order."""
        kinds = {
            "not_ordered": matching.not_ordered,
            "resized": matching.resized & ~matching.same_size,
            "altered": matching.same_size,
            "by_size": matching.by_size,
            "off_target": ~on_target(plan, order) & (matching.item >= 0),
        }
        for kind, boxes in kinds.items():
            if not (box_numbers := np.flatnonzero(boxes).tolist()):
                continue
            self.counts[kind] += len(box_numbers)
            if kind not in self.first:
                words = f"plan {printable_name(plan.plan_id)}, {_name_of_box(plan, box_numbers[0])}"
                if kind in ("resized", "altered"):
                    words += f": {_pair(plan, order, matching, box_numbers[0])}"
                self.first[kind] = words

    def lines(self, whose: str = "") -> Iterator[str]:
        """A line for each kind of difference that at least one box has.

        Args:
            whose: "of NAME", with the name of a packer; may be empty.
        """
        for kind, one, many in (
            ("not_ordered", "was not ordered", "were not ordered"),
            ("resized", *_RESIZED),
            ("altered", *_ALTERED),
            ("off_target", "is not on the order's target", "are not on their orders' targets"),
            ("by_size", "has neither id nor article", "have neither id nor article"),
        ):
            if number := self.counts[kind]:
                boxes = f"{count_text(number, 'box', 'boxes')} {whose}".strip()
                first = "matched by size and mass" if kind == "by_size" else f"the first: {self.first[kind]}"
                yield f"{boxes} {one if number == 1 else many}; {first}"


def _ordered_goods(item: Item) -> tuple[object, ...]:
    plain = (item.item_id, item.article, item.length_mm, item.width_mm, item.height_mm, item.weight_kg)
    if not _item_has_properties(item):
        return plain
    return (*plain, item.com_mm or (), item.stiffness_n_mm or 0.0, item.kind)


def _name_of_item(item: Item, with_id: bool) -> str:
    return _name(item.item_id if with_id else "", item.article) or _measures_of_item(item)


def _name_of_box(plan: Plan, box: int) -> str:
    return _name(plan.item_ids[box], plan.articles[box]) or _measures_of_box(plan, box)


def _name(item_id: str, article: str) -> str:
    """The article, and the id if the article does not contain it: "bread-00105329", "carton (77)". The id if there is
    no article; "" if there is neither.
    """
    if not article:
        return printable_name(item_id)
    return printable_name(article) + ("" if item_id in article else f" ({printable_name(item_id)})")


def _measures_of_box(plan: Plan, box: int) -> str:
    return _measures_in_words(plan.item_size_mm[box].tolist(), float(plan.mass_kg[box]))


def _measures_of_item(item: Item) -> str:
    return _measures_in_words((item.length_mm, item.width_mm, item.height_mm), item.weight_kg)


def _pair(plan: Plan, order: Order, matching: Matching, box: int) -> str:
    """A box and its item as text: "400 × 300 × 201 mm, 8 kg for 400 × 300 × 200 mm, 8 kg"."""
    item = order.items[matching.item[box]]
    measures = _measures_of_box(plan, box), _measures_of_item(item)
    if not matching.same_size[box]:
        return " for ".join(measures)
    stiffness = 0.0 if plan.stiffness_n_mm is None else float(np.nan_to_num(plan.stiffness_n_mm[box]))
    is_box = _in_words_of(plan.item_com_mm[box].tolist(), stiffness, bool(plan.sheets[box]))
    return f"{is_box} for {_in_words_of(item.com_mm or (0, 0, 0), item.stiffness_n_mm or 0.0, item.kind == SHEET)}"


def _in_words_of(com_mm: Sequence[float], stiffness_n_mm: float, sheet: bool) -> str:
    """Properties as text: "a sheet, centre of mass -190, 0, 0 mm off its middle, 300 N/mm"."""
    offset = f"{', '.join(f'{value:g}' for value in com_mm)} mm off" if any(com_mm) else "in"
    stiffness = f"{stiffness_n_mm:g} N/mm" if stiffness_n_mm else "rigid"
    return f"{'a sheet' if sheet else 'a box'}, centre of mass {offset} its middle, {stiffness}"


def _measures_in_words(sizes_mm: Iterable[float], kg: float) -> str:
    return f"{' × '.join(f'{size:g}' for size in sizes_mm)} mm, {kg:g} kg"


def _in_words(names: Iterable[str], between: str = ", ") -> str:
    """Names with their counts: "2 × bread-00105329, 1 × carton (77)"."""
    counts = [f"{number:,} × {name}" for name, number in Counter(names).items()]
    more_words = [count_text(len(counts) - MOST_ARTICLES, "more article")] if len(counts) > MOST_ARTICLES else []
    return between.join([*counts[:MOST_ARTICLES], *more_words])


def _list(lines: list[str], line: str) -> None:
    if len(lines) < MOST_LISTED:
        lines.append(line)
