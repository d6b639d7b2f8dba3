"""Reading BED-BPP *orders* files: order id → ``item_sequence`` and ``properties``."""

from __future__ import annotations

import gzip
import json
import math
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from petmjx.checked import reason
from petmjx.errors import InputError
from petmjx.plans.samples.orders import TARGET_EXTENT_MM, Item, Order


def read_orders(path: Path, on_bad_order: Callable[[InputError], None] | None = None) -> Iterator[tuple[str, Order]]:
    """Yield (order id, order) for each order of a file, plain or ``.gz``; items by rising sequence number.

    Raises:
        InputError: the file cannot be read or is not a JSON object; or an order is bad and
            ``on_bad_order`` is not given (else that is called with the error and the order skipped).
    """
    for order_id, record in _read_object(path).items():
        try:
            order = _order(record, f"{path}: order {order_id}")
        except InputError as error:
            if on_bad_order is None:
                raise
            on_bad_order(error)
        else:
            yield order_id, order


def _read_object(path: Path) -> dict[str, Any]:
    try:
        data = path.read_bytes()
        text = gzip.decompress(data) if path.suffix == ".gz" else data
        orders = json.loads(text.decode("utf-8"))
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read: {reason(error)}") from error
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, a number of thousands of digits
        raise InputError(f"{path}: is not JSON: {error}") from error
    if not isinstance(orders, dict):
        raise InputError(f"{path}: must be a JSON object of orders, got {_kind(orders)}")
    return orders


def _order(record: object, where: str) -> Order:
    if not isinstance(record, dict):
        raise InputError(f"{where}: must be a JSON object, got {_kind(record)}")
    properties = record.get("properties")
    target = properties.get("target") if isinstance(properties, dict) else None
    if not isinstance(target, str) or target not in TARGET_EXTENT_MM:
        raise InputError(f"{where}: properties.target must be one of {', '.join(TARGET_EXTENT_MM)}, got {target!r}")
    sequence = record.get("item_sequence")
    if not isinstance(sequence, dict) or not sequence:
        raise InputError(f"{where}: item_sequence must be a JSON object that holds at least one item")
    ranked = []
    for key, raw in sequence.items():
        if not key.isdecimal():
            raise InputError(f"{where}: keys of item_sequence must be whole numbers, got {key!r}")
        ranked.append((int(key), _item(raw, f"{where}, item {key}")))
    ranked.sort(key=lambda pair: pair[0])
    return Order(target, tuple(item for _, item in ranked))


def _item(raw: object, where: str) -> Item:
    if not isinstance(raw, dict):
        raise InputError(f"{where}: must be a JSON object, got {_kind(raw)}")
    return Item(
        article=_text(raw, "article", where),
        item_id=_text(raw, "id", where),
        product_group=str(raw.get("product_group", "")),
        length_mm=_positive(raw, "length/mm", where),
        width_mm=_positive(raw, "width/mm", where),
        height_mm=_positive(raw, "height/mm", where),
        weight_kg=_positive(raw, "weight/kg", where),
    )


def _text(raw: dict[str, Any], field: str, where: str) -> str:
    value = raw.get(field)
    if not isinstance(value, str):
        raise InputError(f"{where}: {field} must be a text, got {_kind(value)}")
    return value


def _positive(raw: dict[str, Any], field: str, where: str) -> float:
    value = raw.get(field)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {field} must be a number, got {_kind(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or number <= 0:
        raise InputError(f"{where}: {field} must be finite and > 0, got {number:g}")
    return number


def _kind(value: object) -> str:
    return "nothing" if value is None else type(value).__name__
