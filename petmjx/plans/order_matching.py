"""Boxes of a plan matched with the items of its order: which item each box is, and whether it is as it was ordered.

Boxes are known by ``id`` and ``article`` together, by the one of them that is there, or, where a box has neither, by
size and mass. Each item is one box at most, so a box that is packed twice was ordered once. ``sequence`` says nothing,
since packers renumber boxes. Sizes are compared whichever way a box stands.

Plans compared with the orders that they were packed from: what was left out, what nobody ordered, and what has
another size or mass than was ordered (petmjx.plans.order_matching says which box is which).
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.common.units import FloatArray
from petmjx.plans.order_generator import TARGET_EXTENT_MM, Item, Order
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan import Plan

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


class _MatchKey(NamedTuple):
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
    _MatchKey(lambda names: names, any, any),
    _MatchKey(lambda names: names.item_id or None, lambda box: not box.article, _any),
    _MatchKey(lambda names: names.article or None, lambda box: not box.item_id, _any),
    _MatchKey(lambda names: names.item_id or None, _any, lambda item: not item.article),
    _MatchKey(lambda names: names.article or None, _any, lambda item: not item.item_id),
    _MatchKey(lambda names: (), lambda box: not any(box), _any, named=False),
    _MatchKey(lambda names: (), _any, lambda item: not any(item), named=False),
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
                pairs = (
                    _equal_pairs(some, same_items, of_boxes, of_items) if alike else zip(some, same_items, strict=False)
                )
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


def _equal_pairs(
    boxes: list[int], items: list[int], of_boxes: FloatArray, of_items: FloatArray
) -> list[tuple[int, int]]:
    """(box, item) of the same size and mass."""
    if not items:
        return []
    same = _equal_measures(of_boxes[boxes][:, None], of_items[items][None])
    free = np.ones(len(items), bool)
    pairs = []
    for row, box in enumerate(boxes):
        if (fits := same[row] & free).any():
            column = int(fits.argmax())
            free[column] = False
            pairs.append((box, items[column]))
    return pairs


def _equal_measures(box: FloatArray, item: FloatArray) -> NDArray[np.bool_]:
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


MOST_LISTED: Final = 10_000
"""Plans, orders or errors that are named one by one; all are counted."""

MOST_ARTICLES: Final = 5
"""Articles that a line names."""


class PlanOrderCounts(NamedTuple):
    """One plan and its order, as counts of boxes.

    Attributes:
        ordered_boxes: of the order.
        left_out: ordered, but not in the plan.
        not_ordered: in the plan, but not ordered.
        resized: ordered and in the plan, but with another size or mass.
    """

    ordered_boxes: int
    left_out: int
    not_ordered: int
    resized: int = 0


@dataclass
class OrderCounts:
    """All plans of a run and all orders, as counts.

    Attributes:
        orders: usable orders of the file.
        ordered_boxes, left_out, not_ordered, resized: boxes, as in :class:`PlanOrderCounts`, of all plans that have an
        order.
        matched_by_size: boxes without id and article of these plans, which are matched by size and mass.
        plans_leaving_out: plans that leave out at least one box.
        plans_without_order: plans of which the file has no usable order.
        orders_without_plan, boxes_without_plan: orders that have no usable plan, and their boxes; None: not known,
            since not all plans were read.
        unusable_orders: orders of the file that were not compared.
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
    """What :func:`check_orders` found.

    Attributes:
        file: name of the orders file.
        digest: hexadecimal, of what was ordered.
        of_plan: plan id → counts, for each plan that has an order; also plans of other shards.
        counts: of this shard.
        lines: one for each plan of this shard that is not what was ordered. At most ``MOST_LISTED``, as those below.
        without_plan: ids of orders of this shard that have no usable plan.
        unusable: one line for each order that was not compared.
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
) -> OrderCheck:
    """Compare plans with the orders of a BED-BPP orders file; an order belongs to the plan that has its id.

    Args:
        path: the file, gzipped or not.
        plans: all plans of the run, each id once.
        takes: whether a plan or order of that id is in this shard.
        all_plans: whether these are all plans that there are. If not, it is not known which orders have none.
        strict: raise at the first unusable order, instead of leaving it out of the comparison.

    Raises:
        InputError: the file cannot be read, is damaged or holds no usable order; with ``strict`` an unusable order.
            The line names file, order and field.
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
    """A plan's boxes and its order's, as counts."""
    not_ordered, resized = (int(np.count_nonzero(mask)) for mask in (matching.not_ordered, matching.resized))
    return PlanOrderCounts(matching.n_items, matching.left_out, not_ordered, resized)


def difference_in_words(plan: Plan, order: Order, matching: Matching) -> str:
    """What of a plan is not as it was ordered: "2 of 9 ordered boxes are left out (2 × jam)"; empty: nothing."""
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
    if ordered.resized:
        verb = "has another size or mass" if ordered.resized == 1 else "have other sizes or masses"
        names = []
        for box in np.flatnonzero(matching.resized).tolist():
            item = order.items[matching.item[box]]
            names.append(f"{_name_of_box(plan, box)}: {_measures_of_box(plan, box)} for {_measures_of_item(item)}")
        boxes = count_text(ordered.resized, "box", "boxes")
        parts.append(f"{boxes} {verb} than ordered ({_in_words(names, '; ')})")
    return "; ".join(parts)


def on_target(plan: Plan, order: Order) -> NDArray[np.bool_]:
    """(n,) which boxes of a plan are on the order's target, wherever the plan has its origin: all of a plan that has
    room on it, also turned; else those whose middles are over the target with its corner in the origin."""
    extent = np.array(TARGET_EXTENT_MM[order.target], float)
    low, high = plan.corner_mm[:, :2], plan.corner_mm[:, :2] + plan.size_mm[:, :2]
    across = high.max(axis=0) - low.min(axis=0)
    if any((across <= target_extent + SIZE_TOLERANCE_MM).all() for target_extent in (extent, extent[::-1])):
        return np.ones(plan.n_boxes, bool)
    middle = (low + high) / 2
    return np.asarray(((middle >= 0) & (middle <= extent)).all(axis=1))


@dataclass(eq=False)
class OddBoxes:
    """What of many plans is not as it was ordered: boxes of each kind, and the first of them in words."""

    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, plan: Plan, order: Order, matching: Matching) -> None:
        """Count one more plan."""
        kinds = {
            "not_ordered": matching.not_ordered,
            "resized": matching.resized,
            "by_size": matching.by_size,
            "off_target": ~on_target(plan, order) & (matching.item >= 0),
        }
        for kind, boxes in kinds.items():
            if not (some := np.flatnonzero(boxes).tolist()):
                continue
            self.counts[kind] += len(some)
            if kind not in self.first:
                words = f"plan {printable_name(plan.plan_id)}, {_name_of_box(plan, some[0])}"
                if kind == "resized":
                    item = order.items[matching.item[some[0]]]
                    words += f": {_measures_of_box(plan, some[0])} for {_measures_of_item(item)}"
                self.first[kind] = words

    def lines(self, whose: str = "") -> Iterator[str]:
        """A line on each kind of which there are some; ``whose``: "of NAME", a packer."""
        for kind, one, many in (
            ("not_ordered", "was not ordered", "were not ordered"),
            ("resized", "has another size or mass than ordered", "have other sizes or masses than ordered"),
            ("off_target", "is not on the order's target", "are not on their orders' targets"),
            ("by_size", "has neither id nor article", "have neither id nor article"),
        ):
            if number := self.counts[kind]:
                boxes = f"{count_text(number, 'box', 'boxes')} {whose}".strip()
                first = "matched by size and mass" if kind == "by_size" else f"the first: {self.first[kind]}"
                yield f"{boxes} {one if number == 1 else many}; {first}"


def _ordered_goods(item: Item) -> tuple[object, ...]:
    return (item.item_id, item.article, item.length_mm, item.width_mm, item.height_mm, item.weight_kg)


def _name_of_item(item: Item, with_id: bool) -> str:
    return _name(item.item_id if with_id else "", item.article) or _measures_of_item(item)


def _name_of_box(plan: Plan, box: int) -> str:
    return _name(plan.item_ids[box], plan.articles[box]) or _measures_of_box(plan, box)


def _name(item_id: str, article: str) -> str:
    """ "bread-00105329", "carton (77)": an article, with an id that it does not hold; "" where there is neither."""
    if not article:
        return printable_name(item_id)
    return printable_name(article) + ("" if item_id in article else f" ({printable_name(item_id)})")


def _measures_of_box(plan: Plan, box: int) -> str:
    return _measures_in_words(plan.item_size_mm[box].tolist(), float(plan.mass_kg[box]))


def _measures_of_item(item: Item) -> str:
    return _measures_in_words((item.length_mm, item.width_mm, item.height_mm), item.weight_kg)


def _measures_in_words(sizes_mm: Iterable[float], kg: float) -> str:
    return f"{' × '.join(f'{size:g}' for size in sizes_mm)} mm, {kg:g} kg"


def _in_words(names: Iterable[str], between: str = ", ") -> str:
    """ "2 × bread-00105329, 1 × carton (77)"."""
    counts = [f"{number:,} × {name}" for name, number in Counter(names).items()]
    more = [count_text(len(counts) - MOST_ARTICLES, "more article")] if len(counts) > MOST_ARTICLES else []
    return between.join([*counts[:MOST_ARTICLES], *more])


def _list(lines: list[str], line: str) -> None:
    if len(lines) < MOST_LISTED:
        lines.append(line)
