"""Orders from files of any form (``foreign_orders``): tables and sheets of items with quantities, lists in JSON, test
problems of packing research, and the boxes of plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.options.run_options import RunOptions
from petmjx.plans.cell_numbers import cell_number, cell_triple
from petmjx.plans.data_frames import sources_of_frame
from petmjx.plans.file_formats import NoBoxes
from petmjx.plans.foreign_formats import sources_of_bytes
from petmjx.plans.item_columns import BOX_PROPERTIES, ItemColumns, has_sizes_of_items, item_columns
from petmjx.plans.item_joins import bytes_of, with_items_of
from petmjx.plans.item_units_and_quantities import DELI, EURO, PG, SIZES, ForeignOrders, OrderReading, orders_of_items
from petmjx.plans.known_forms import BoxSource, rows_of
from petmjx.plans.numpy_arrays import loaded_array
from petmjx.plans.order import Item, Order, target_named
from petmjx.plans.order_texts import SET_ITEMS, order_source
from petmjx.plans.plan_reader import DEFAULT_MAX_BOXES, read_plans
from petmjx.plans.raw_tables import BoxList, RawTable
from petmjx.plans.workbooks import sheets_of_xlsx

_PG: Final = {
    "length": "Length_cm", "width": "Width_cm", "height": "Height_cm", "weight": "Gross weight", "plan": "Pallet No",
    "quantity": "Pick_quantity_cs",
}  # fmt: skip
_DELI: Final = ("尺寸（L）", "尺寸（W）", "尺寸（H）")


def foreign_orders(data: bytes | bytearray, path: Path, source: str, reading: OrderReading) -> ForeignOrders:
    """Read the orders in a file's bytes.

    Args:
        source: name of the file in messages.

    Raises:
        NoBoxes: the file contains nothing that resembles boxes.
        InputError: the file cannot be read as orders, or has two possible readings. The error does not name the file.
    """
    numbers = order_source(data) or _array_of_sizes(data)
    if numbers is not None:
        return _orders_of(numbers, source, reading)
    try:
        sources = sources_of_bytes(data, path)
    except InputError:
        if (sheet := _sheet_of_deli(data)) is not None:
            return _orders_of(sheet, source, reading)
        raise
    # if the file were read as plans of another tool, columns with ``BOX_PROPERTIES`` would be lost
    has_properties = reading.for_episodes and not {*BOX_PROPERTIES}.isdisjoint(sources[0].boxes.table.header)
    if _has_three_places(sources[0]) and sources[0].boxes.has_sizes and not has_properties:
        return orders_of_plans(path, source, reading)
    return _orders_of(_best_source(sources, reading.items), source, reading)


def frame_orders(frame: Any, source: str, reading: OrderReading) -> ForeignOrders:
    """Read the orders in a data frame or an Arrow table. Arguments and errors are as in :func:`foreign_orders`."""
    return _orders_of(_best_source(sources_of_frame(frame), reading.items), source, reading)


def _has_three_places(source: BoxSource) -> bool:
    """Whether a list has coordinates x, y and z that are not all empty or zero. A column "Position" alone is not
    enough, since it may number the rows of an order."""
    table = source.boxes.table
    if not table.has_header:
        return bool(table.rows)
    axes: set[str] = set()
    has_coordinates = False
    for index, meaning in enumerate(source.boxes.meanings):
        if meaning is None or meaning.of_container:
            continue
        cells = [row[index] for row in table.rows[:200]]
        if meaning.kind == "positions":
            if sum(cell_triple(cell, table.decimal) is not None for cell in cells) * 2 > len(cells):
                return True
        elif meaning.kind in ("position", "low") and any(cell not in (None, "") for cell in cells):
            numbers = [number.value for cell in cells if (number := cell_number(cell, table.decimal)) is not None]
            axes.add(meaning.axis)
            has_coordinates |= len(numbers) < 2 or any(numbers)
    return has_coordinates and len(axes) >= 3


def _with_articles(sources: Sequence[BoxSource], items: Path | None) -> BoxSource | None:
    """Lines of orders, joined with the sizes of their articles from another table of the file, or from a file of items.
    The result is None if there are no such lines.

    Raises:
        InputError: the file of items cannot be read, or its items do not belong to the orders.
    """
    lines = [source for source in sources if not has_sizes_of_items(source) and "quantity" in source.boxes.kinds]
    if items is not None:
        name = printable(str(items))
        try:
            tables = sources_of_bytes(bytes_of(items), items)
        except InputError as error:
            line = str(error)
            raise InputError(line if line.startswith(name) else f"{name}: {line}") from None
        for source in lines or sources:
            for table in filter(has_sizes_of_items, tables):
                if (joined := with_items_of(source, table, name)) is not None:
                    return joined
        raise InputError(f"{name}: its items do not match the orders")
    for source in lines:
        for table in sources:
            if "quantity" not in table.boxes.kinds and table.boxes.has_sizes:
                name = f"the sheet {table.boxes.table.title}" if table.boxes.table.title else "the other table"
                if (joined := with_items_of(source, table, printable(name))) is not None:
                    return joined
    return None


def _best_source(sources: Sequence[BoxSource], items: Path | None = None) -> BoxSource:
    """The list of items of a file, with the sizes of their articles added."""
    if (joined := _with_articles(sources, items)) is not None:
        return joined
    sized = [source for source in sources if has_sizes_of_items(source)]
    best = max(sized or sources, key=lambda source: len(source.boxes.table.rows))
    if set(_PG.values()) <= set(best.boxes.table.header):
        return _without_gaps(replace(best, form=PG), tuple(_PG.values()))
    return best


def _without_gaps(source: BoxSource, columns: Sequence[str]) -> BoxSource:
    """A source without the rows that lack a value in one of these columns."""
    cells = [source.boxes.table.column(name) for name in columns]
    rows = enumerate(zip(*cells, strict=True))
    full = [number for number, row in rows if all(cell not in (None, "") for cell in row)]
    left = len(source.boxes.table.rows) - len(full)
    if not left:
        return source
    verb = "lacks" if left == 1 else "lack"
    note = f"{count_text(left, 'row')} that {verb} a value left out"
    return replace(source, boxes=rows_of(source.boxes, full), notes=(*source.notes, note))


def _array_of_sizes(data: bytes | bytearray) -> BoxSource | None:
    """The boxes of a NumPy array of sizes, (n, 3) or (orders, n, 3); None if the file is no such array."""
    if bytes(data[:6]) != b"\x93NUMPY":
        return None
    try:
        array = loaded_array(data)
    except InputError:
        return None  # ``sources_of_bytes``, which reads the file next, reports the error
    if array.ndim not in (2, 3) or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
        return None
    rows: list[tuple[float, ...]] = []
    places, parts = [], []
    for number, order in enumerate(array if array.ndim == 3 else array[None]):
        for index, row in enumerate(order.tolist()):
            if any(row):  # rows of zeros only fill up arrays of fixed length
                rows.append(tuple(row))
                places.append(f"row {index}" if array.ndim == 2 else f"order {number}, row {index}")
                parts.append("" if array.ndim == 2 else str(number))
    return BoxSource(BoxList(RawTable(_LENGTHS, rows, places), "", tuple(parts)), SIZES)


def _sheet_of_deli(data: bytes | bytearray) -> BoxSource | None:
    """The articles of RoboBPP's ``deli.xlsx``, whose columns have Chinese names; None for any other file."""
    if bytes(data[:2]) != b"PK":
        return None
    try:
        rows = next(iter(sheets_of_xlsx(data)[0].values()), [])
    except InputError:
        return None  # the error of ``sources_of_bytes`` is reported instead
    head = next((number for number, row in enumerate(rows[:60]) if set(_DELI) <= set(row)), None)
    if head is None:
        return None
    picked = [rows[head].index(name) for name in _DELI]
    cells = [(number, tuple(row[index] for index in picked)) for number, row in enumerate(rows) if number > head]
    good_rows = [(number, row) for number, row in cells if all(cell_number(cell) is not None for cell in row)]
    table = RawTable(_LENGTHS, [row for _, row in good_rows], [f"row {number + 1}" for number, _ in good_rows])
    parts = tuple(str(number // SET_ITEMS + 1) for number in range(len(good_rows)))
    notes = [f"the list is divided into orders of {SET_ITEMS} boxes"]
    if left := len(cells) - len(good_rows):
        notes.append(f"{count_text(left, 'row')} without three sizes left out")
    return BoxSource(BoxList(table, "", parts), DELI, tuple(notes))


_LENGTHS: Final = ("length", "width", "height")


# Plans.


def orders_of_plans(path: Path, source: str, reading: OrderReading) -> ForeignOrders:
    """Read each plan of a file as an order with the plan's boxes.

    Args:
        source: name of the file in messages.

    Raises:
        InputError: the file has no usable plan. The error does not name the file.
    """
    wishes = reading.wishes
    options = RunOptions(
        units=",".join(filter(None, (wishes.units, wishes.masses))) or None,
        columns=dict(wishes.columns) or None,
        density=wishes.density_kg_m3,
    )
    plan_set = read_plans([path], options, max_boxes=DEFAULT_MAX_BOXES, extent_mm=None)
    target = target_named(reading.target or EURO)
    orders = []
    for plan in plan_set.plans:
        names = [
            article or item_id or f"box {number}"
            for number, (article, item_id) in enumerate(zip(plan.articles, plan.item_ids, strict=True), start=1)
        ]
        groups = plan.product_groups or ("",) * plan.n_boxes
        of_boxes = np.full(plan.n_boxes, np.nan) if plan.strength_n is None else plan.strength_n
        strengths = [None if np.isnan(strength) else strength for strength in of_boxes.tolist()]
        items = [
            Item(name, item_id or name, group, length, width, height, mass, strength_n=strength)
            for name, item_id, group, (length, width, height), mass, strength in zip(
                *(names, plan.item_ids, groups, plan.item_size_mm.tolist(), plan.mass_kg.tolist(), strengths),
                strict=True,
            )
        ]
        orders.append((plan.plan_id, Order(target, tuple(items), tuple(range(1, len(items) + 1)))))
    refused = tuple((skip.plan_id or "", str(skip)) for skip in plan_set.skipped)
    if not orders and refused:
        raise InputError(refused[0][1].removeprefix(f"{source}: "))
    reading_line = next((text.line() for text in plan_set.readings.values()), "read as petmjx's plans")
    line = (
        f"{source}: holds plans: the boxes of each are an order, their places are not used; {reading_line}; "
        f"packed on {target}"
    )
    return ForeignOrders(tuple(orders), refused, line)


# Tables of items.


def _orders_of(source: BoxSource, name: str, reading: OrderReading) -> ForeignOrders:
    wishes = reading.wishes
    chosen = {**(_PG if source.form is PG else {}), **wishes.columns}
    columns = item_columns(source, chosen, wishes.units, wishes.masses, properties=reading.for_episodes)
    if columns is None or not columns.n_rows:
        raise _no_items(source, columns)
    return orders_of_items(columns, name, reading)


def _no_items(source: BoxSource, columns: ItemColumns | None) -> InputError:
    if columns is not None or not source.boxes.table.rows:
        lost = source.boxes.table.lost
        return InputError(f"{lost[0][0]}: {lost[0][1]}" if lost else "holds no item")
    header = source.boxes.table.header
    names = ", ".join(map(printable_name, header[:20]))
    if not source.boxes.table.has_header:
        return InputError("has no header: a table of items names its columns, such as length, width, height, quantity")
    kind = InputError if source.boxes.kinds else NoBoxes
    return kind(
        f"lacks the sizes of items; there are {names}; say which with --columns length=NAME,…; --items FILE names a "
        "file that has them"
    )
