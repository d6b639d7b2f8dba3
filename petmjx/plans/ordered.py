"""Plans compared with the orders that they were packed from: what was left out, and what nobody ordered.

Boxes are distinguished by ``id`` and ``article`` together (by ``article`` alone in plans without ids), and counted.
``sequence`` says nothing, since packers renumber boxes.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from petmjx.basics.errors import InputError
from petmjx.basics.text import counted, printable, shown
from petmjx.plans.plan import Plan
from petmjx.plans.samples.order_files import read_orders

MOST_LISTED: Final = 10_000
"""Plans, orders or errors that are named one by one; all are counted."""

MOST_ARTICLES: Final = 5
"""Articles that a line names."""

_Goods = Counter[tuple[str, str]]
"""(id, article) → number of boxes."""


class Ordered(NamedTuple):
    """One plan and its order, as counts of boxes.

    Attributes:
        ordered_boxes: of the order.
        left_out: ordered, but not in the plan.
        not_ordered: in the plan, but not ordered.
    """

    ordered_boxes: int
    left_out: int
    not_ordered: int


@dataclass
class OrderCounts:
    """All plans of a run and all orders, as counts.

    Attributes:
        orders: usable orders of the file.
        ordered_boxes, left_out, not_ordered: boxes, as in :class:`Ordered`, of all plans that have an order.
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
    of_plan: dict[str, Ordered] = field(default_factory=dict)
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
        goods: _Goods = Counter((item.item_id, item.article) for item in order.items)
        digest.update(repr((order_id, sorted(goods.items()))).encode("utf-8", "backslashreplace"))
        plan, taken = by_id.get(order_id), takes(order_id)
        counts.orders += taken
        if plan is not None:
            ordered = _compare(plan, goods, check.lines if taken else None)
            check.of_plan[order_id] = ordered
            if taken:
                n_taken_with_plan += 1
                counts.ordered_boxes += ordered.ordered_boxes
                counts.left_out += ordered.left_out
                counts.not_ordered += ordered.not_ordered
                counts.plans_leaving_out += ordered.left_out > 0
        elif taken and all_plans:
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


def _compare(plan: Plan, wanted: _Goods, lines: list[str] | None) -> Ordered:
    """The counts of one plan; a line is added where it differs from its order."""
    if not any(plan.item_ids):
        wanted = _without_ids(wanted)
    there: _Goods = Counter(zip(plan.item_ids, plan.articles, strict=True))
    missing, extra = wanted - there, there - wanted
    ordered = Ordered(wanted.total(), missing.total(), extra.total())
    parts = []
    if missing:
        verb = "is" if ordered.left_out == 1 else "are"
        boxes = counted(ordered.ordered_boxes, "ordered box", "ordered boxes")
        parts.append(f"{ordered.left_out:,} of {boxes} {verb} left out ({_goods_in_words(missing)})")
    if extra:
        verb = "was" if ordered.not_ordered == 1 else "were"
        parts.append(f"{counted(ordered.not_ordered, 'box', 'boxes')} {verb} not ordered ({_goods_in_words(extra)})")
    if parts and lines is not None:
        _list(lines, f"plan {shown(plan.plan_id)}: {'; '.join(parts)}")
    return ordered


def _without_ids(goods: _Goods) -> _Goods:
    """Goods by their articles alone, for plans of tables that have no ids."""
    found: _Goods = Counter()
    for (_, article), number in goods.items():
        found["", article] += number
    return found


def _goods_in_words(goods: _Goods) -> str:
    """ "2 × bread-00105329, 1 × carton (77)": articles, with ids that they do not hold."""
    names = [
        f"{number:,} × {shown(article)}" + ("" if item_id in article else f" ({shown(item_id)})")
        for (item_id, article), number in goods.items()
    ]
    more = [f"{counted(len(names) - MOST_ARTICLES, 'more article')}"] if len(names) > MOST_ARTICLES else []
    return ", ".join([*names[:MOST_ARTICLES], *more])


def _list(lines: list[str], line: str) -> None:
    if len(lines) < MOST_LISTED:
        lines.append(line)
