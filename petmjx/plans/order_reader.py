"""Reads orders (``read_orders``): BED-BPP's files, which map an order id to ``item_sequence`` and ``properties``, and
files of any other form."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from petmjx.common.atomic_write import atomic_write
from petmjx.common.checked_records import reason, shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_id
from petmjx.plans.bedbpp_writer import write_orders
from petmjx.plans.convention_checks import warn
from petmjx.plans.file_formats import (
    PARQUET_MAGIC,
    NoBoxes,
    is_of_other_tools,
    looks_like_own_json,
)
from petmjx.plans.json_reader import Entry, read_text_bytes, scan_plans, unpacked_bytes
from petmjx.plans.order_generator import MOST_ITEMS, TARGET_EXTENT_MM, Item, Order, is_target
from petmjx.plans.plan_fields import (
    COM_FIELDS_JSON,
    LARGEST_KG,
    LARGEST_MM,
    SMALLEST_KG,
    SMALLEST_MM,
    com_fault,
    first_fault,
    kind,
    kind_fault,
    pallet_fault,
    positive_fault,
    sparse_fault,
    text_fault,
)

if TYPE_CHECKING:
    from petmjx.plans.item_units_and_quantities import ForeignOrders, OrderReading

_CONVERT: Final = "petmjx convert {file} --orders -o orders.json takes it, and writes orders that all commands read"
"""Advice that is appended to an error about two possible readings, for commands that have no options for reading
orders."""
OF_PLAN: Final = "is a packing plan, not an order"
_FRAME: Final = "orders"
"""Name of a data frame in messages."""
_SIZES: Final = ("length/mm", "width/mm", "height/mm")
_FORMS: Final = "orders are BED-BPP's JSON, or tables of items with sizes and quantities (docs/plan-format.md#orders)"
_MOST_DIGITS: Final = 18
"""Largest number of digits in a sequence number."""


def read_orders(
    path: Path,
    on_bad_order: Callable[[InputError], None] | None = None,
    reading: OrderReading | None = None,
) -> Iterator[tuple[str, Order]]:
    """Yield (order id, order) for each order of a file, gzipped or not. Items are sorted by sequence number.

    Orders in BED-BPP's form are read directly. A file of plans, or of another form, is read by
    ``petmjx.plans.foreign_orders``, and a ``PlanWarning`` states how.

    Args:
        on_bad_order: function that is called with the error of a bad order, which is then skipped; None: the error is
            raised.
        reading: how files of other forms are read, and the target (carrier) of their orders; None: the most plausible
            reading.

    Raises:
        InputError: the file cannot be read, or has no orders (raised before the first order); or an order is bad and
            ``on_bad_order`` is None.
    """
    name = printable(str(path))
    data, is_own = _read(path, name)
    if not is_own and (orders := _foreign(path, name, reading)) is not None:
        warn(filter(None, [orders.line]))
        yield from _good_orders(orders, on_bad_order)
        return
    _check_entries(data, name)
    order_ids: set[str] = set()
    for entry in scan_plans(data):
        where = f"{name}: order {printable_id(entry.plan_id)}"
        try:
            if entry.plan_id in order_ids:
                raise InputError(f"{where}: repeated order id")
            order = _order(entry, where)
        except InputError as error:
            if on_bad_order is None:
                raise
            on_bad_order(error)
        else:
            order_ids.add(entry.plan_id)
            yield entry.plan_id, order


def read_order_frame(
    frame: Any,
    on_bad_order: Callable[[InputError], None] | None = None,
    reading: OrderReading | None = None,
) -> Iterator[tuple[str, Order]]:
    """Yield (order id, order) for each order of a data frame, or of any object with Arrow's stream interface.

    Arguments and errors are as in :func:`read_orders`. Messages call the frame "orders".
    """
    from petmjx.plans.foreign_orders import frame_orders
    from petmjx.plans.item_units_and_quantities import OrderReading

    try:
        orders = frame_orders(frame, _FRAME, reading or OrderReading())
    except InputError as error:
        raise InputError(f"{_FRAME}: {error}") from None
    warn(filter(None, [orders.line]))
    yield from _good_orders(orders, on_bad_order)


def keep_orders(source: Path, path: Path) -> None:
    """Copy a file of orders. Orders of any other form are written in BED-BPP's form.

    Raises:
        InputError: a file cannot be read or written.
    """
    name = printable(str(source))
    data, is_own = _read(source, name)
    if not is_own:
        write_orders(path, read_orders(source, lambda error: None))
        return
    _check_entries(data, name)
    with atomic_write(path) as file:
        shutil.copyfile(source, file)


def _read(path: Path, name: str) -> tuple[bytearray, bool]:
    """The text of a file of orders, and whether it holds orders in BED-BPP's form.

    Raises:
        InputError: the file cannot be read, or is damaged.
    """
    try:
        data, fault = read_text_bytes(path)
        if fault is not None and not data:
            content, packing_fault = unpacked_bytes(path)
            if packing_fault is None and is_of_other_tools(content):
                return data, False
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be read: {reason(error)}") from error
    if fault is not None:
        raise InputError(f"{name}: {fault.partition(';')[0]}")
    like_json = data.lstrip().startswith((b"{", b"["))
    return data, not data.strip() or (like_json and looks_like_own_json(data) and not _begins_with_plan(data))


def _begins_with_plan(data: bytes | bytearray) -> bool:
    """Whether the first entry of a text in BED-BPP's form is a packing plan. A text whose first entry is damaged does
    not count."""
    try:
        return any(_is_plan(entry.value) for entry in islice(scan_plans(data), 1))
    except InputError:
        return False


def _is_plan(record: object) -> bool:
    """Whether an entry of a file in BED-BPP's form is a packing plan."""
    return isinstance(record, list) and bool(record) and isinstance(record[0], dict) and "flb_coordinates" in record[0]


def _check_entries(data: bytearray, name: str) -> None:
    """Check that a text is a JSON object with at least one entry.

    Raises:
        InputError: the text is damaged, or has no order.
    """
    try:
        n_orders = sum(1 for _ in scan_plans(data, "order id → order", "order"))
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    if n_orders == 0:
        raise InputError(f"{name}: holds no order")


def _foreign(path: Path, name: str, reading: OrderReading | None) -> ForeignOrders | None:
    """Read the orders of a file that is not in the form of BED-BPP's orders. The result is None if the file is a JSON
    object without boxes.

    Raises:
        InputError: the file cannot be read as orders.
    """
    from petmjx.common.arrow_files import parquet_table
    from petmjx.plans.foreign_orders import foreign_orders, frame_orders, orders_of_plans
    from petmjx.plans.item_columns import TWO_WAYS
    from petmjx.plans.item_units_and_quantities import OrderReading

    try:
        data, _ = unpacked_bytes(path)
        if data.startswith(PARQUET_MAGIC):
            return frame_orders(parquet_table(path), name, reading or OrderReading())
        if looks_like_own_json(data) and _begins_with_plan(data):
            return orders_of_plans(path, name, reading or OrderReading())
        return foreign_orders(data, path, name, reading or OrderReading())
    except NoBoxes as error:
        if data.lstrip().startswith(b"{"):
            return None
        raise InputError(f"{name}: {error}: {_FORMS}") from None
    except InputError as error:
        decided = f"; {_CONVERT.format(file=name)}" if reading is None and TWO_WAYS in str(error) else ""
        raise InputError(f"{name}: {error}{decided}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be read: {reason(error)}") from error


def _good_orders(
    orders: ForeignOrders, on_bad_order: Callable[[InputError], None] | None
) -> Iterator[tuple[str, Order]]:
    """Yield the good orders of a file. Errors are as in :func:`read_orders`."""
    for _, line in orders.refused:
        error = InputError(line)
        if on_bad_order is None:
            raise error
        on_bad_order(error)
    yield from orders.orders


def _order(entry: Entry, where: str) -> Order:
    record = entry.value
    if (fault := text_fault("the order id", entry.plan_id)) is not None:
        raise InputError(f"{where}: {fault}")
    if not entry.plan_id:
        raise InputError(f"{where}: the order id must not be empty")
    if _is_plan(record):
        raise InputError(f"{where}: {OF_PLAN}: orders have item_sequence and properties")
    if not isinstance(record, dict):
        raise InputError(f"{where}: must be an object, got {kind(record)}")
    properties = record.get("properties")
    target = properties.get("target") if isinstance(properties, dict) else None
    if not isinstance(target, str) or not is_target(target):
        targets = ", ".join(TARGET_EXTENT_MM)
        raise InputError(f"{where}: properties.target must be one of {targets}, got {kind(target)}")
    sequence = record.get("item_sequence")
    if not isinstance(sequence, dict) or not sequence:
        raise InputError(f"{where}: item_sequence must be an object that holds at least one item")
    if len(sequence) > MOST_ITEMS:
        raise InputError(f"{where}: must have at most {MOST_ITEMS:,} items, got {len(sequence):,}")
    ranked = []
    for key, raw in sequence.items():
        if not (key.isdecimal() and len(key) <= _MOST_DIGITS):
            raise InputError(f"{where}: keys of item_sequence must be whole numbers, {shown_value(key)}")
        ranked.append((int(key), _item(raw, f"{where}, item {key}")))
    ranked.sort(key=lambda pair: pair[0])
    return Order(target, tuple(item for _, item in ranked), tuple(number for number, _ in ranked))


def _item(raw: object, where: str) -> Item:
    if not isinstance(raw, dict):
        raise InputError(f"{where}: must be an object, got {kind(raw)}")
    item: dict[str, Any] = {"product_group": "", **raw}
    if (fault := _item_fault(item)) is not None:
        raise InputError(f"{where}: {fault}")
    com = [item.get(field) for field in COM_FIELDS_JSON]
    stiffness = item.get("stiffness_n_mm")
    return Item(
        *(item["article"], item["id"], item["product_group"]),
        *(float(item[field]) for field in (*_SIZES, "weight/kg")),
        com_mm=None if com == [None] * 3 else (float(com[0] or 0.0), float(com[1] or 0.0), float(com[2] or 0.0)),
        stiffness_n_mm=None if stiffness is None else float(stiffness),
        kind=item.get("kind") or "",
    )


def _item_fault(item: dict[str, Any]) -> str | None:
    """The error text for the first bad field of an item; None if the item is good."""
    return (
        first_fault(text_fault(field, item.get(field)) for field in ("article", "id", "product_group"))
        or first_fault(positive_fault(field, item.get(field), SMALLEST_MM, LARGEST_MM, "mm") for field in _SIZES)
        or positive_fault("weight/kg", item.get("weight/kg"), SMALLEST_KG, LARGEST_KG, "kg")
        or first_fault(
            com_fault(field, item[field], item[size])
            for field, size in zip(COM_FIELDS_JSON, _SIZES, strict=True)
            if item.get(field) is not None
        )
        or sparse_fault("stiffness_n_mm", item.get("stiffness_n_mm"))
        or kind_fault(item.get("kind"))
        or pallet_fault(item.get("kind"), [item[field] for field in _SIZES])
    )
