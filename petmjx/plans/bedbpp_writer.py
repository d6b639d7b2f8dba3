"""Writes JSON files of plans and orders in BED-BPP's format."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import IO, Any, TypeVar

from petmjx.common.argument_checks import path_of
from petmjx.common.atomic_write import atomic_write, gzip_stream
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.plans.order import Item, Order
from petmjx.plans.plan_fields import COM_FIELDS_JSON

Value = TypeVar("Value")
Placement = dict[str, Any]
"""One placement in BED-BPP's format: item, orientation, flb_coordinates (mm)."""


def write_plans(
    path: Path | str,
    plans: Iterable[tuple[str, list[Placement]]],
    *,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write (plan id, placements) pairs as one BED-BPP object, one line per placement.

    The file appears only when it is complete. The file's bytes depend only on the plans, since the gzip header has no
    time stamp.

    Raises:
        InputError: there is no plan, or the file cannot be written.
    """
    _write_entries(path, plans, _plan_text, "plan", progress)


def write_orders(path: Path | str, orders: Iterable[tuple[str, Order]]) -> None:
    """Write (id, order) pairs as BED-BPP's orders, one line per item. Reading the written orders gives exactly the same
    numbers.

    Raises:
        InputError: there is no order, or the file cannot be written.
    """
    _write_entries(path, orders, _order_text, "order")


def _order_text(order: Order) -> str:
    numbers = order.numbers or range(1, len(order.items) + 1)
    items = zip(numbers, order.items, strict=True)
    fields = ((number, {**item_json(item), "sequence": number}) for number, item in items)
    lines = ",\n".join(f'  "{number}": {json.dumps(item, ensure_ascii=False)}' for number, item in fields)
    target = json.dumps({"target": order.target})
    return f'{{"properties": {target}, "item_sequence": {{\n{lines}\n}}}}'


def item_json(item: Item) -> dict[str, Any]:
    """An item with BED-BPP's fields. Its centre of mass, its stiffness and its kind ("box" or "sheet") are added if the
    order gives them."""
    seldom: dict[str, Any] = {} if item.com_mm is None else dict(zip(COM_FIELDS_JSON, item.com_mm, strict=True))
    seldom |= {} if item.stiffness_n_mm is None else {"stiffness_n_mm": item.stiffness_n_mm}
    seldom |= {"kind": item.kind} if item.kind else {}
    return {
        "article": item.article,
        "id": item.item_id,
        "product_group": item.product_group,
        "length/mm": _whole(item.length_mm),
        "width/mm": _whole(item.width_mm),
        "height/mm": _whole(item.height_mm),
        "weight/kg": item.weight_kg,
        **seldom,
    }


def _whole(value_mm: float) -> int | float:
    """Whole millimetres as int, as in BED-BPP."""
    return int(value_mm) if value_mm == int(value_mm) else value_mm


def _plan_text(placements: Iterable[Placement]) -> str:
    lines = ",\n".join("  " + json.dumps(placement, ensure_ascii=False) for placement in placements)
    return f"[\n{lines}\n]"


def _write_entries(
    path: Path | str,
    entries: Iterable[tuple[str, Value]],
    text_of: Callable[[Value], str],
    what: str,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Write a JSON object of named values; ``text_of`` gives the JSON text of a value, and errors call it ``what``."""
    path = path_of(path, "path")
    coming = iter(entries)
    first = next(coming, None)
    if first is None:
        raise InputError(f"{printable(str(path))}: there is no {what} to write")
    with atomic_write(path) as temporary, ExitStack() as stack:
        if isinstance(coming, Generator):
            stack.callback(coming.close)  # closes the generator even after an error, so that its worker processes end
        out = _open_text(temporary, stack)
        out.write("{")
        for count, (name, value) in enumerate(chain([first], coming), start=1):
            separator = "," if count > 1 else ""
            out.write(f"{separator}\n{json.dumps(name)}: {text_of(value)}")
            if progress is not None:
                progress(count)
        out.write("\n}\n")


def _open_text(path: Path, stack: ExitStack) -> IO[str]:
    if path.suffix != ".gz":
        return stack.enter_context(path.open("w", encoding="utf-8", newline="\n"))
    raw = stack.enter_context(path.open("wb"))
    packed = stack.enter_context(gzip_stream(raw))
    return stack.enter_context(io.TextIOWrapper(packed, encoding="utf-8", newline="\n"))
