"""Boxes of plans matched with ordered items: by id and article, or by size and mass if a box has neither. Each item
matches one box at most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from petmjx.plans.articles import Article, Articles, with_articles
from petmjx.plans.order import Item, Order
from petmjx.plans.order_checks import OddBoxes, counts_of, difference_in_words
from petmjx.plans.order_matching import MASS_TOLERANCE, SIZE_TOLERANCE_MM, match, on_target, with_properties
from petmjx.plans.plan import Plan

Box = tuple[str, str, Sequence[float], float]
"""Id; article; sizes along x, y and z, mm; mass, kg."""


def ordered(*boxes: Box, target: str = "euro-pallet") -> Order:
    return Order(
        target, tuple(Item(article, item_id, "", size[0], size[1], size[2], kg) for item_id, article, size, kg in boxes)
    )


def packed(*boxes: Box, corners: Sequence[Sequence[float]] | None = None, kinds: tuple[str, ...] = ()) -> Plan:
    ids, articles, sizes, masses = zip(*boxes, strict=True)
    corner = np.zeros((len(boxes), 3)) if corners is None else np.array(corners, float)
    numbers = np.arange(len(boxes))
    return Plan(
        "o", "test", np.array(sizes, float), corner, np.array(masses, float), ids, articles, numbers, kinds=kinds
    )


A: Box = ("1", "jam", (400, 300, 200), 8)
B: Box = ("2", "oil", (300, 200, 150), 5)


def said(plan: Plan, order: Order) -> tuple[int, ...]:
    """Number of ordered items that the plan leaves out, of boxes that were not ordered, and of boxes with another size
    or mass than ordered."""
    return counts_of(match(plan, order))[1:]


def test_each_item_is_one_box() -> None:
    assert said(packed(A, A, B), ordered(A, B)) == (0, 1, 0)
    assert said(packed(A), ordered(A, A, B)) == (2, 0, 0)
    assert said(packed(A, A), ordered(A, A)) == (0, 0, 0)
    matching = match(packed(A, B, A), ordered(B, A))
    assert matching.item.tolist() == [1, 0, -1]
    assert matching.as_ordered.tolist() == [True, True, False]


def test_a_box_of_another_size_or_mass_is_said_to_differ() -> None:
    for size, kg in (((20, 20, 20), 0.01), ((400, 300, 201), 8), ((400, 300, 200), 8.1), ((396, 297, 198), 8)):
        assert said(packed(("1", "jam", size, kg), B), ordered(A, B)) == (0, 0, 1)
    # of two boxes with the same names, the box with the ordered size is matched, whichever comes first; the other box
    # counts as not ordered
    small: Box = ("1", "jam", (20, 20, 20), 0.01)
    assert match(packed(small, A), ordered(A)).item.tolist() == [-1, 0]
    words = difference_in_words(packed(small), ordered(A), match(packed(small), ordered(A)))
    expected = "1 × jam (1): 20 × 20 × 20 mm, 0.01 kg for 400 × 300 × 200 mm, 8 kg"
    assert words == f"1 box has another size or mass than ordered ({expected})"


def test_a_box_is_the_same_however_it_stands_and_within_rounding() -> None:
    for size, kg in (
        ((300, 400, 200), 8),
        ((200, 300, 400), 8),
        ((400 - SIZE_TOLERANCE_MM, 300, 200 + SIZE_TOLERANCE_MM), 8 * (1 - MASS_TOLERANCE)),
        ((400 + 1e-12, 300, 200), 8.0000001),
    ):
        assert said(packed(("1", "jam", size, kg)), ordered(A)) == (0, 0, 0)
    light: Box = ("9", "paper", (100, 100, 10), 0.0021)
    assert said(packed(("9", "paper", (100, 100, 10), 0.002)), ordered(light)) == (0, 0, 0)


@pytest.mark.parametrize("names", [("1", ""), ("", "jam"), ("", "")])
def test_boxes_are_known_by_the_names_that_they_have(names: tuple[str, str]) -> None:
    matching = match(packed((*names, *A[2:]), B), ordered(B, A))
    assert matching.item.tolist() == [1, 0]
    assert matching.by_size.tolist() == [not any(names), False]
    assert said(packed((*names, (90, 90, 90), 1), B), ordered(B, A)) == ((0, 0, 1) if any(names) else (1, 1, 0))


def test_whole_plans_without_names_are_matched_by_size_and_mass() -> None:
    """Of equal boxes, as many are left out as the plan has too few, wherever they are in the plan. The order of the
    boxes does not matter."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        kinds = [(tuple(rng.integers(100, 600, 3)), float(rng.integers(1, 30))) for _ in range(4)]
        goods = [(str(k), f"a{k}", *kinds[k]) for k in rng.integers(0, 4, 12)]
        order, kept = ordered(*goods), rng.permutation(12)[: rng.integers(1, 13)]
        plan = packed(*(("", "", rng.permutation(goods[k][2]).tolist(), goods[k][3]) for k in kept))
        matching = match(plan, order)
        assert counts_of(matching)[1:] == (12 - len(kept), 0, 0)
        assert matching.by_size.all()
        assert sorted(goods[at][2:] for at in matching.item) == sorted(goods[k][2:] for k in kept)


def test_orders_that_lack_names_are_matched_too() -> None:
    assert said(packed(A, B), ordered(("", "jam", *A[2:]), ("2", "", *B[2:]))) == (0, 0, 0)
    assert said(packed(A, B), ordered(("", "", *A[2:]), B)) == (0, 0, 0)


def test_wrong_names_are_not_ordered_whatever_their_size() -> None:
    assert said(packed(("7", "gold", *A[2:])), ordered(A)) == (1, 1, 0)
    assert said(packed(("1", "oil", *A[2:])), ordered(A, B)) == (2, 1, 0)


def test_sheets_are_no_boxes_that_nobody_ordered() -> None:
    sheet: Box = ("", "tie", (1200, 800, 2), 0.4)
    plan = packed(A, sheet, kinds=("box", "sheet"))
    assert said(plan, ordered(A)) == (0, 0, 0)
    assert said(plan, ordered(A, sheet)) == (0, 0, 1)  # only the box was ordered, not the sheet
    order = ordered(A, sheet)
    order = replace(order, items=(order.items[0], *[replace(order.items[1], kind="sheet")] * 2))
    assert said(plan, order) == (1, 0, 0)
    assert said(packed(A, kinds=("sheet",)), ordered(A)) == (0, 0, 1)


def test_of_drawn_plans_every_count_is_that_of_their_making() -> None:
    """In random plans, the counts equal those with which the plans were made. The items have unique names and sizes.
    Each item is left out, placed once, placed twice, or resized; boxes that were not ordered are added."""
    rng = np.random.default_rng(1)
    for _ in range(60):
        sizes = rng.permutation(np.arange(100, 600, 10))[:30].reshape(10, 3)
        goods: list[Box] = [(str(k), f"a{k}", tuple(size), float(1 + k)) for k, size in enumerate(sizes.tolist())]
        boxes: list[Box] = []
        left_out = not_ordered = resized = 0
        for item_id, article, size, kg in goods:
            exact, odd = rng.integers(0, 3), rng.integers(0, 2)
            shown = [(item_id, article), (item_id, ""), ("", article), ("", "")][rng.integers(0, 4)]
            boxes += [(*shown, rng.permutation(size).tolist(), kg)] * exact
            boxes += [(item_id, article, size, kg * 1.3)] * odd
            left_out += exact + odd == 0
            resized += exact == 0 and odd > 0
            not_ordered += max(exact + odd - 1, 0)
        strangers = rng.integers(0, 3)
        boxes += [("x", "y", (50, 50, 50), 1.0)] * strangers
        if boxes:
            plan = packed(*(boxes[k] for k in rng.permutation(len(boxes))))
            assert said(plan, ordered(*goods)) == (left_out, not_ordered + strangers, resized)


def test_which_boxes_are_on_the_target() -> None:
    order = ordered(A, B)
    row = [(450.0 * k, 0.0, 0.0) for k in range(5)]
    plan = packed(*[A] * 5, corners=row)
    assert on_target(plan, order).tolist() == [True, True, True, False, False]
    for corners in ([(0, 0, 0), (800, 500, 0)], [(-600, -400, 0), (200, 100, 0)], [(5000, 0, 0), (5400, 900, 0)]):
        # wherever the origin is, and also if the plan is turned
        assert on_target(packed(A, A, corners=corners), order).all()
    # both boxes reach a little beyond the edges of the target
    assert on_target(packed(A, A, corners=[(-30, 0, 0), (820, 0, 0)]), order).all()
    assert not on_target(packed(A, A, corners=[(0, 0, 0), (0, 700, 0)]), ordered(A, target="rollcontainer")).all()


def test_lines_name_the_first_box_of_each_kind() -> None:
    odd = OddBoxes()
    plan = packed(
        A, A, ("2", "oil", (30, 20, 10), 5), ("", "", (90, 80, 70), 1), corners=[(2000.0 * k, 0, 0) for k in range(4)]
    )
    odd.add(
        plan, ordered(A, B, ("5", "tea", (90, 80, 70), 1)), match(plan, ordered(A, B, ("5", "tea", (90, 80, 70), 1)))
    )
    assert list(odd.lines("of x")) == [
        "1 box of x was not ordered; the first: plan o, jam (1)",
        "1 box of x has another size or mass than ordered; the first: plan o, oil (2): 30 × 20 × 10 mm, 5 kg for "
        "300 × 200 × 150 mm, 5 kg",
        "2 boxes of x are not on their orders' targets; the first: plan o, oil (2)",
        "1 box of x has neither id nor article; matched by size and mass",
    ]


# Properties of goods, such as the centre of mass, are fixed by the order.


def with_com(plan: Plan, *com_mm: Sequence[float], **fields: object) -> Plan:
    return replace(plan, mass_center_mm=np.array(com_mm, float) if com_mm else None, **fields)  # type: ignore[arg-type]


def order_with(order: Order, **fields: object) -> Order:
    return replace(order, items=tuple(replace(item, **fields) for item in order.items))  # type: ignore[arg-type]


def test_a_box_with_properties_that_nobody_ordered_differs() -> None:
    for entered in (
        with_com(packed(A), (-190, 0, 0)),
        with_com(packed(A), (0, 0, -99)),
        replace(packed(A), stiffness_n_mm=np.array([0.02])),
        packed(A, kinds=("sheet",)),
    ):
        matching = match(entered, ordered(A))
        assert counts_of(matching)[1:] == (0, 0, 1)
        assert matching.same_size.all()
        assert not matching.as_ordered.any()
        nameless = replace(entered, item_ids=("",), articles=("",))
        assert not match(nameless, ordered(A)).as_ordered.any()
    plan = with_com(packed(A), (-190, 0, 0))
    assert difference_in_words(plan, ordered(A), match(plan, ordered(A))) == (
        "1 box has another centre of mass, stiffness or kind than ordered (1 × jam (1): a box, centre of mass "
        "-190, 0, 0 mm off its middle, rigid for a box, centre of mass in its middle, rigid)"
    )
    assert said(with_com(packed(A, B), (0.3, 0, 0), (0, 0, 0)), ordered(A, B)) == (0, 0, 0)


def test_the_properties_of_an_order_are_asked_for() -> None:
    order = order_with(ordered(A), com_mm=(60.0, 20.0, -50.0), stiffness_n_mm=300.0)
    stiff = {"stiffness_n_mm": np.array([300.0])}
    assert said(packed(A), order) == (0, 0, 1)
    assert said(with_com(packed(A), (60, 20, -50)), order) == (0, 0, 1)
    assert said(with_com(packed(A), (60, 20, -50), **stiff), order) == (0, 0, 0)
    # in a box that stands on another side, the centre of mass is at another place; the mirror image of a box is another
    # box
    assert said(with_com(packed(A), (-60, -20, -50), **stiff), order) == (0, 0, 0)
    assert said(with_com(packed(A), (60, -20, -50), **stiff), order) == (0, 0, 1)
    on_end = packed(("1", "jam", (300, 200, 400), 8))
    assert said(with_com(on_end, (20, -50, 60), **stiff), order) == (0, 0, 0)
    assert said(with_com(on_end, (20, 60, -50), **stiff), order) == (0, 0, 1)
    turned = packed(("1", "jam", (300, 400, 200), 8))
    along_y = with_com(turned, (-20, 60, -50), orientation=np.array([1]), **stiff)
    assert said(along_y, order) == (0, 0, 0)


def test_articles_of_the_user_fill_up_the_order() -> None:
    articles = Articles({"jam": Article(com_mm=(0.0, 0.0, -50.0), stiffness_n_mm=300.0)}, {})
    plan = with_articles(packed(A, B), articles)
    assert said(plan, ordered(A, B)) == (0, 0, 1)
    assert said(plan, with_properties(ordered(A, B), articles)) == (0, 0, 0)
    assert said(packed(A, B), with_properties(ordered(A, B), articles)) == (0, 0, 1)
