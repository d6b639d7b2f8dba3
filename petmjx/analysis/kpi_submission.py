"""Checks plans as a submission to the leaderboard of BED-BPP (a public benchmark for packing), and writes the
submission's file.

The file has a name of the form ``{DATE}_{SURNAME}_{ALGORITHM}_{TASK}.json``. The leaderboard's page
(floriankagerer.github.io/leaderboard) defines three tasks. In the first task (offline), all items are known. In the
second task (O3DBP), items arrive one after the other. In the third task (O3DBP-p-s), p items are known, and the packer
chooses one of the next s items.
"""

from __future__ import annotations

import datetime
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.plans.bedbpp_writer import Placement, write_plans
from petmjx.plans.order import Item, Order, target_extent_mm
from petmjx.plans.order_matching import match
from petmjx.plans.plan import Plan
from petmjx.plans.plan_writer import as_placements

_PART: Final = re.compile(r"[^\W_][^\W_.+-]*(?:[.+-][^\W_.+-]+)*")
_TASK: Final = re.compile(r"offline-?3dbp|o3dbp(?:-(\d{1,4})-(\d{1,4}))?", re.IGNORECASE)
_MOST_FAULTS: Final = 10
"""Largest number of faults that an error message names."""


@dataclass(frozen=True)
class Submission:
    """The name of a submission, split into its parts.

    Attributes:
        date: date of the submission, in ISO 8601.
        task: name of the task, as in the file's name.
        choice: how many items the packer may choose from at a time: the next items of the sequence. None if the packer
            may choose from all items.
    """

    date: str
    surname: str
    algorithm: str
    task: str
    choice: int | None

    @property
    def file_name(self) -> str:
        """The name of the submission's file, such as "2026-11-22_doe_layers_offline3dbp.json"."""
        return f"{self.date}_{self.surname}_{self.algorithm}_{self.task}.json"


def parse_name(text: str, today: Callable[[], datetime.date] = datetime.date.today) -> Submission:
    """Parse a submission's name, ``SURNAME_ALGORITHM_TASK``. The name may begin with a date and end with ``.json``.

    Raises:
        InputError: the name lacks one of these parts, or a part is invalid.
    """
    parts = text.removesuffix(".json").split("_")
    if len(parts) == 3:
        parts = [today().isoformat(), *parts]
    if len(parts) != 4:
        raise InputError(
            f"leaderboard name {printable_name(text)}: must be SURNAME_ALGORITHM_TASK or DATE_SURNAME_ALGORITHM_TASK; "
            "within a part write - instead of _"
        )
    date, surname, algorithm, task = parts
    try:
        datetime.datetime.strptime(date, "%Y-%m-%d")
    except ValueError:
        raise InputError(
            f"leaderboard name {printable_name(text)}: the date must be YYYY-MM-DD, got {printable_name(date)}"
        ) from None
    for field, part in (("surname", surname), ("algorithm", algorithm)):
        if not _PART.fullmatch(part):
            raise InputError(
                f"leaderboard name {printable_name(text)}: the {field} must consist of letters and digits, "
                "with at most one of - + . between two of them, "
                f"got {printable_name(part) or 'nothing'}"
            )
    match = _TASK.fullmatch(task)
    p, s = (int(number or 1) for number in match.groups()) if match else (0, 1)
    if match is None or not 1 <= s <= p:
        raise InputError(
            f"leaderboard name {printable_name(text)}: the task must be offline3dbp, o3dbp or o3dbp-p-s (p: number "
            "of items known in advance, s: number of items to choose from, p ≥ s ≥ 1), such as o3dbp-3-2, "
            f"got {printable_name(task) or 'nothing'}"
        )
    return Submission(date, surname, algorithm, task, None if task.lower().startswith("offline") else s)


def write_submission(
    name: str, folder: Path, plans: Mapping[str, Plan], orders: Mapping[str, Order], unusable: int = 0
) -> Path:
    """Check that plans are a valid submission, and write the plans to a file. In the file, each item has the id,
    product group and number that it has in the order.

    Args:
        name: name of the submission (see :func:`parse_name`).
        plans, orders: the plans and the orders, by id.
        unusable: number of plans and orders that could not be read.

    Returns:
        Path of the submission's file.

    Raises:
        InputError: the name is invalid; a plan, an order or an item is missing or superfluous; or the file cannot be
            written. If there is an error, no file is written.
    """
    submission = parse_name(name)
    faults = [f"{count_text(unusable, 'plan or order', 'plans or orders')} cannot be used"] if unusable else []
    faults += [f"order {printable_name(order_id)} has no plan" for order_id in orders if order_id not in plans]
    written: list[tuple[str, list[Placement]]] = []
    for plan_id, plan in plans.items():
        if plan_id not in orders:
            faults.append(f"plan {printable_name(plan_id)} has no order")
            continue
        placements = as_placements(plan)
        plan_faults = list(_faults(plan, placements, orders[plan_id], submission.choice))
        faults += [f"plan {printable_name(plan_id)}{fault}" for fault in plan_faults]
        written.append((plan_id, placements))
    if faults:
        more_text = f"; {len(faults) - _MOST_FAULTS:,} more" if len(faults) > _MOST_FAULTS else ""
        fault_text = "; ".join(faults[:_MOST_FAULTS])
        raise InputError(f"no submission, {count_text(len(faults), 'fault')}: {fault_text}{more_text}")
    in_order = {order_id: rank for rank, order_id in enumerate(orders)}
    written.sort(key=lambda pair: in_order[pair[0]])
    file = folder / submission.file_name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{printable(str(folder))}: cannot be made: {error.strerror or error}") from error
    write_plans(file, written)
    return file


def _faults(plan: Plan, placements: Sequence[Placement], order: Order, choice: int | None) -> Iterator[str]:
    """Yield a text for each fault of a plan that cannot be submitted. This function also writes the id, product group
    and number of the ordered item into each placement."""
    _name(plan, placements, order)
    has_ids = any(plan.item_ids)
    free: dict[tuple[str, str], list[int]] = defaultdict(list)
    for index, ordered_item in enumerate(order.items):
        free[ordered_item.item_id if has_ids else "", ordered_item.article].append(index)
    extent = target_extent_mm(order.target)
    indices = []
    for box, placement in enumerate(placements):
        item = placement["item"]
        same_items = free.get((item["id"], item["article"]))
        if not same_items:
            fault = "occurs more often than it was ordered" if same_items is not None else "was not ordered"
            name = (
                f" {printable_name(item['article'])} ({printable_name(item['id'])})"
                if item["article"] or item["id"]
                else ""
            )
            yield f", box {box}: item{name} {fault}"
            continue
        by_number = [index for index in same_items if order.numbers[index] == item["sequence"]]
        index = (by_number or same_items)[0]
        same_items.remove(index)
        indices.append(index)
        ordered = order.items[index]
        measures = (item["length/mm"], item["width/mm"], item["height/mm"], item["weight/kg"])
        if measures != (ordered.length_mm, ordered.width_mm, ordered.height_mm, ordered.weight_kg):
            yield f", box {box}: size or weight differs from those of {printable_name(ordered.article)} in the order"
        corner = placement["flb_coordinates"]
        if not all(isinstance(value, int) for value in corner):
            yield f", box {box}: coordinates must be whole millimetres, got {corner}"
        elif min(corner) < 0 or corner[0] >= extent[0] or corner[1] >= extent[1]:
            yield f", box {box}: begins outside the {order.target}, at {corner}"
        item.update(_as_ordered(ordered, order.numbers[index]))
    if choice is not None:
        yield from _sequence_faults(indices, choice, len(plan.articles))


def _name(plan: Plan, placements: Sequence[Placement], order: Order) -> None:
    """Fill in the missing names: a box that has neither id nor article gets id and article of an ordered item with the
    same size and mass."""
    unnamed = [box for box, names in enumerate(zip(plan.item_ids, plan.articles, strict=True)) if not any(names)]
    if not unnamed:
        return
    items = match(plan, order).item
    has_ids = any(plan.item_ids)
    for box in unnamed:
        if (at := int(items[box])) >= 0:
            item = order.items[at]
            placements[box]["item"].update(article=item.article, id=item.item_id if has_ids else "")


def _sequence_faults(indices: Sequence[int], choice: int, n_boxes: int) -> Iterator[str]:
    """Yield a text about the first wrong choice of an online packer. If all its choices are allowed, yield nothing. In
    each step, the packer must place one of the next ``choice`` items that are still waiting. Items that the packer
    never places do not count as waiting.
    """
    if len(indices) < n_boxes:
        return
    waiting = sorted(indices)
    for box, index in enumerate(indices):
        place = waiting.index(index)
        if place >= choice:
            allowed = "the next item" if choice == 1 else f"one of the next {choice}"
            taken = f"is number {place + 1} of the waiting items"
            yield f", box {box}: {taken}, but the task lets the packer take {allowed}"
            return
        del waiting[place]


def _as_ordered(item: Item, number: int) -> dict[str, Any]:
    return {"id": item.item_id, "product_group": item.product_group, "sequence": number}
