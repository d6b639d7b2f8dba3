"""Compares plans with a file of orders (``check_orders``): finds items that were left out, boxes that were not ordered,
and boxes with another size or mass than ordered, and describes them in lines."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.plans.order import Item, Order
from petmjx.plans.order_matching import Matching, item_has_properties, match, on_target, with_properties
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import SHEET

if TYPE_CHECKING:
    from petmjx.plans.articles import Articles

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
        matched_by_size: boxes of these plans that were matched by size and mass, because the box or the item has
            neither id nor article.
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
            whose: the words "of NAME" for lines about the packer NAME; "" for lines that name no packer.
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
    if not item_has_properties(item):
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
