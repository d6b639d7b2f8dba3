"""Orders of RoboBPP's sets, which petmjx's environments read, for packers of petmjx."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from petmjx.loop.episode_orders import Orders
from petmjx.plans.order import Item, Order

TARGET = "euro-pallet"
BOXES = range(12, 161)
"""Numbers of boxes of the orders that are read. In ``pg.xlsx``, these are 765 pallets of a real warehouse."""


def read_set(path: Path) -> Iterator[tuple[str, Order]]:
    """Orders with 12 to 160 boxes, for a euro-pallet. Equal boxes are one article."""
    for number, boxes in enumerate(Orders(path).some(0)):
        if len(boxes) not in BOXES:
            continue
        rows = np.column_stack([boxes.size_mm, boxes.mass_kg]).tolist()
        articles: dict[tuple[float, ...], str] = {}
        items = []
        for row in rows:
            name = articles.setdefault(tuple(row), f"{len(articles):08d}")
            items.append(Item(name, name, "", *row))
        yield f"{path.stem}-{number:05d}", Order(TARGET, tuple(items))
