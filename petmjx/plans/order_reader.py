"""Reads orders (``read_orders``) from files in BED-BPP's form (``bedbpp_orders``) and in any other form
(``foreign_orders``)."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from petmjx.common.atomic_write import atomic_write
from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_id
from petmjx.plans.bedbpp_orders import bedbpp_order, begins_with_plan
from petmjx.plans.bedbpp_writer import write_orders
from petmjx.plans.convention_checks import warn
from petmjx.plans.file_formats import PARQUET_MAGIC, NoBoxes, is_of_other_tools, looks_like_own_json
from petmjx.plans.json_reader import read_text_bytes, scan_plans, unpacked_bytes
from petmjx.plans.order import Order

if TYPE_CHECKING:
    from petmjx.plans.item_units_and_quantities import ForeignOrders, OrderReading

_CONVERT: Final = (
    "the command 'petmjx convert {file} --orders -o orders.json' takes this option, and writes orders that all "
    "commands read"
)
"""Advice that is appended to an error about two possible readings, for commands that have no options for reading
orders."""
_FRAME: Final = "orders"
"""Name of a data frame in messages."""
_FORMS: Final = "orders are BED-BPP's JSON, or tables of items with sizes and quantities (docs/plan-format.md#orders)"


def read_orders(
    path: Path,
    on_bad_order: Callable[[InputError], None] | None = None,
    reading: OrderReading | None = None,
) -> Iterator[tuple[str, Order]]:
    """Yield (order id, order) for each order of a file, gzipped or not. Items are sorted by sequence number.

    Orders in BED-BPP's form are read directly. A file of plans, or of another form, is read by
    ``petmjx.plans.foreign_orders``. A ``PlanWarning`` then states how the file was read.

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
            order = bedbpp_order(entry, where)
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
    """The text of a file of orders, and whether it holds orders in BED-BPP's form."""
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
    return data, not data.strip() or (like_json and looks_like_own_json(data) and not begins_with_plan(data))


def _check_entries(data: bytearray, name: str) -> None:
    """Refuse a text that is no JSON object with at least one entry."""
    try:
        n_orders = sum(1 for _ in scan_plans(data, "order id → order", "order"))
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    if n_orders == 0:
        raise InputError(f"{name}: holds no order")


def _foreign(path: Path, name: str, reading: OrderReading | None) -> ForeignOrders | None:
    """Read the orders of a file that is not in the form of BED-BPP's orders. The result is None if the file is a JSON
    object without boxes."""
    from petmjx.common.parquet_files import parquet_table
    from petmjx.plans.foreign_orders import foreign_orders, frame_orders, orders_of_plans
    from petmjx.plans.item_columns import TWO_WAYS
    from petmjx.plans.item_units_and_quantities import OrderReading

    try:
        data, _ = unpacked_bytes(path)
        if data.startswith(PARQUET_MAGIC):
            return frame_orders(parquet_table(path), name, reading or OrderReading())
        if looks_like_own_json(data) and begins_with_plan(data):
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
