"""Sources of the boxes of episodes: BED-BPP's orders, the generator, a table, RoboBPP's sets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.arrow_files import parquet_table
from petmjx.common.checked_records import reason, shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.common.units import FloatArray
from petmjx.plans.articles import Articles, read_articles
from petmjx.plans.order_generator import Item, Order, draw_order
from petmjx.plans.order_reader import read_orders
from petmjx.plans.plan_fields import LARGEST_KG, LARGEST_MM, SMALLEST_KG, SMALLEST_MM

ENDLESS: Final = "endless"
"""The value of ``orders`` for generated orders, as in ``petmjx samples``: each episode draws a new one."""

_MOST_DRAWN: Final = 200_000

_COLUMNS: Final = ("length_mm", "width_mm", "height_mm", "weight_kg")
_STRENGTH: Final = "strength_n"

KG_PER_M3: Final = 200.0
"""Density of boxes without a given mass: an assumption, about the mean of BED-BPP's boxes."""

SET_ITEMS: Final = 50
"""Number of boxes in an order if a set is one long list."""

_PG: Final = ("Length_cm", "Width_cm", "Height_cm", "Gross weight", "Pallet No", "Pick_quantity_cs")
_DELI: Final = ("尺寸（L）", "尺寸（W）", "尺寸（H）", "3月份发货量（件）")


@dataclass(frozen=True, eq=False)
class Boxes:
    """The boxes of one order, in the order in which they come.

    Attributes:
        size_mm: (k, 3) length, width and height; ``mass_kg``: (k,).
        strength_n: (k,) the load that each box bears on its top, N; NaN if not given.
    """

    size_mm: FloatArray
    mass_kg: FloatArray
    strength_n: FloatArray

    def __len__(self) -> int:
        return len(self.mass_kg)


class Orders:
    """Orders for episodes, one for each episode.

    Args:
        source: ``endless``; a file of BED-BPP orders (JSON), a table of boxes (CSV, Parquet or a data frame with
            ``length_mm``, ``width_mm``, ``height_mm``, ``weight_kg`` and perhaps ``order_id`` and ``strength_n``), one
            of RoboBPP's sets (``pg.xlsx``, ``deli.xlsx``, ``opai.txt``); or a list of ``Order``.
        seed: seed of the generator's catalogue.
            articles: a table of articles, which gives the boxes of orders their strengths.

        Attributes:
            have_strengths: whether the strength of any box can be known.

        Raises:
            InputError: an unknown source, or a file that cannot be used.
    """

    def __init__(self, source: Any = ENDLESS, seed: int = 0, articles: Any = None) -> None:
        self._seed = seed
        self._articles = None if articles is None else read_articles(path_of(articles, "articles"))
        endless = isinstance(source, str) and source == ENDLESS
        self._all: list[Boxes] | None = None if endless else _read(source, self._articles)
        orders = self._all or ()
        self.have_strengths = articles is not None or any(np.isfinite(boxes.strength_n).any() for boxes in orders)

    def draw(self, rng: np.random.Generator) -> Boxes:
        """A random order, or with ``endless`` a new one."""
        if self._all is None:
            return _of_order(draw_order(self._seed, int(rng.integers(_MOST_DRAWN))), self._articles)
        return self._all[int(rng.integers(len(self._all)))]

    def some(self, count: int) -> list[Boxes]:
        """All orders; with ``endless`` the first ``count``."""
        if self._all is not None:
            return self._all
        return [_of_order(draw_order(self._seed, number), self._articles) for number in range(count)]


def _read(source: Any, articles: Articles | None) -> list[Boxes]:
    if isinstance(source, pd.DataFrame):
        return _of_table(source, "orders")
    if isinstance(source, str | PathLike):
        return _of_file(path_of(source, "orders"), articles)
    orders = [_of_order(order, articles) for order in list_of(source, "orders", Order, "orders")]
    if not orders:
        raise InputError("orders must hold at least one order")
    return orders


def _of_order(order: Order, articles: Articles | None) -> Boxes:
    rows = np.array([[item.length_mm, item.width_mm, item.height_mm, item.weight_kg] for item in order.items], float)
    return Boxes(rows[:, :3], rows[:, 3], np.array([_strength(item, articles) for item in order.items], float))


def _strength(item: Item, articles: Articles | None) -> float:
    strength = None if articles is None else articles.find(item.article, item.product_group).strength
    return np.nan if strength is None else strength.of_box(item.length_mm, item.width_mm)


def _of_file(path: Path, articles: Articles | None) -> list[Boxes]:
    name, kind = printable(str(path)), path.suffix.lower()
    if kind in (".json", ".gz"):
        return [_of_order(order, articles) for _, order in read_orders(path)]
    try:
        if kind == ".txt":
            return _of_lengths(np.loadtxt(path, ndmin=2), name)
        if kind == ".xlsx":
            return _of_sheet(pd.read_excel(path, sheet_name=0), name)
        if kind in (".csv", ".parquet"):
            return _of_table(pd.read_csv(path) if kind == ".csv" else parquet_table(path).to_pandas(), name)
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {reason(error)}") from error
    except (ValueError, KeyError, ImportError) as error:
        raise InputError(f"{name}: cannot be read as orders: {error}") from error
    raise InputError(f"{name}: orders are .json, .csv, .parquet, .xlsx or .txt files")


def _of_table(table: pd.DataFrame, name: str) -> list[Boxes]:
    if missing := [column for column in _COLUMNS if column not in table.columns]:
        raise InputError(f"{name}: column {missing[0]} is missing")
    groups = [group for _, group in table.groupby("order_id", sort=False)] if "order_id" in table else [table]
    if _STRENGTH in table and not (table[_STRENGTH].dropna() > 0).all():
        raise InputError(f"{name}: {_STRENGTH} must be above 0, or empty")
    return _checked_boxes([(rows[list(_COLUMNS[:3])], rows[_COLUMNS[3]], rows.get(_STRENGTH)) for rows in groups], name)


def _of_sheet(table: pd.DataFrame, name: str) -> list[Boxes]:
    """RoboBPP's ``pg.xlsx``, with a pallet for each group of rows, or ``deli.xlsx``, a list of articles. In cm."""
    if set(_PG) <= set(table.columns):
        columns = table[list(_PG)].dropna()
        many = columns[_PG[5]].astype(int)
        boxes = columns.loc[columns.index.repeat(many)]
        groups = [group for _, group in boxes.groupby(_PG[4], sort=False)]
        return _checked_boxes(
            [(group[list(_PG[:3])].astype(float) * 10, group[_PG[3]].astype(float), None) for group in groups], name
        )
    if set(_DELI) <= set(table.columns):
        sides = table[list(_DELI[:3])].apply(pd.to_numeric, errors="coerce").dropna().to_numpy()
        return _of_lengths(sides, name)
    raise InputError(f"{name}: its first sheet has neither the columns of pg.xlsx nor of deli.xlsx")


def _of_lengths(sides_cm: FloatArray, name: str) -> list[Boxes]:
    """A long list of length, width and height, cm, in pieces; masses are by volume."""
    if sides_cm.ndim != 2 or sides_cm.shape[1] < 3:
        raise InputError(f"{name}: must have three lengths in each line, got {shown_value(sides_cm.shape)}")
    sides = sides_cm[:, :3] * 10.0
    mass = sides.prod(axis=1) * 1e-9 * KG_PER_M3
    pieces = [slice(first, first + SET_ITEMS) for first in range(0, len(sides), SET_ITEMS)]
    return _checked_boxes([(sides[piece], mass[piece], None) for piece in pieces], name)


def _checked_boxes(groups: Sequence[tuple[Any, Any, Any]], name: str) -> list[Boxes]:
    orders = [
        Boxes(
            np.asarray(sizes, float),
            np.asarray(masses, float),
            np.full(len(masses), np.nan) if strengths is None else np.asarray(strengths, float),
        )
        for sizes, masses, strengths in groups
    ]
    orders = [boxes for boxes in orders if len(boxes)]
    if not orders:
        raise InputError(f"{name}: holds no box")
    for number, boxes in enumerate(orders):
        for values, low, high, unit in (
            (boxes.size_mm, SMALLEST_MM, LARGEST_MM, "mm"),
            (boxes.mass_kg, SMALLEST_KG, LARGEST_KG, "kg"),
        ):
            if not ((values >= low) & (values <= high)).all():
                raise InputError(f"{name}: order {number}: all boxes must have {low:g} to {high:g} {unit}")
    return orders
