"""Sources of the boxes of episodes: the generator, files of orders of any form, tables of boxes with strengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.arrow_files import parquet_table
from petmjx.common.checked_records import reason
from petmjx.common.errors import InputError
from petmjx.common.text import printable, printable_name
from petmjx.common.units import FloatArray
from petmjx.options.run_options import RunOptions
from petmjx.plans.articles import Articles, read_articles
from petmjx.plans.item_columns import MOST_PIECES
from petmjx.plans.item_orders import OrderReading
from petmjx.plans.order_generator import Item, Order, draw_order
from petmjx.plans.order_reader import read_order_frame, read_orders
from petmjx.plans.plan_fields import LARGEST_KG, LARGEST_MM, SMALLEST_KG, SMALLEST_MM

ENDLESS: Final = "endless"
"""The value of ``orders`` for generated orders, as in ``petmjx samples``: each episode draws a new order."""

_MOST_DRAWN: Final = 200_000

_COLUMNS: Final = ("length_mm", "width_mm", "height_mm", "weight_kg")
_STRENGTH: Final = "strength_n"
_UPRIGHT: Final = "upright"
_SIZES: Final = "lwh"
"""Letters of the column ``upright``: length, width, height."""


def order_reading(units: Any = None, columns: Any = None, density: Any = None) -> OrderReading:
    """How an environment reads files of orders that are not in BED-BPP's form. Orders may have any number of boxes.

    Args:
        units, columns, density: as fields of ``petmjx.RunOptions``; None: the most plausible.

    Raises:
        InputError: a value is unusable; the line begins with ``orders_``.
    """
    try:
        options = RunOptions(units=units, columns=columns, density=density)
    except InputError as error:
        raise InputError(f"orders_{error}") from None
    return replace(OrderReading.of(options), most_items=MOST_PIECES)


@dataclass(frozen=True, eq=False)
class Boxes:
    """The boxes of one order, in order.

    Attributes:
        size_mm: (k, 3) length, width and height; ``mass_kg``: (k,).
        strength_n: (k,) the load that each box bears on its top, N; NaN: unknown.
        upright: (k, 3) whether the length, the width and the height may be vertical; None: the height alone.
    """

    size_mm: FloatArray
    mass_kg: FloatArray
    strength_n: FloatArray
    upright: NDArray[np.bool_] | None = None

    @property
    def rows(self) -> FloatArray:
        """(k, 8) sizes, mass, strength, and 1 for each size that may be vertical."""
        upright = np.tile([False, False, True], (len(self), 1)) if self.upright is None else self.upright
        return np.column_stack([self.size_mm, self.mass_kg, self.strength_n, upright])

    def take(self, rows: Any) -> Boxes:
        """Some of the boxes."""
        upright = None if self.upright is None else self.upright[rows]
        return Boxes(self.size_mm[rows], self.mass_kg[rows], self.strength_n[rows], upright)

    def __len__(self) -> int:
        return len(self.mass_kg)


class Orders:
    """Orders for episodes, one for each episode.

    Args:
        source: ``endless``; a file of orders of any form that ``petmjx samples --orders`` reads; a table of boxes (CSV,
            Parquet or a data frame with ``length_mm``, ``width_mm``, ``height_mm``, ``weight_kg`` and perhaps
            ``order_id``, ``strength_n``, and ``upright``: letters of the sizes that may be vertical, of l, w and h); or
            a list of ``Order``.
        seed: seed of the generator's catalogue.
        articles: a table of articles, which gives the boxes of orders their strengths.
        reading: reading of files of orders that are not in BED-BPP's form; None: the most plausible reading.

        Attributes:
            have_strengths: whether the strength of any box may be known.
            lie: whether any box may stand on another side than its base.

        Raises:
            InputError: an unknown source, or a file that cannot be used.
    """

    def __init__(
        self, source: Any = ENDLESS, seed: int = 0, articles: Any = None, reading: OrderReading | None = None
    ) -> None:
        self._seed = seed
        self._articles = None if articles is None else read_articles(path_of(articles, "articles"))
        endless = isinstance(source, str) and source == ENDLESS
        self._all: list[Boxes] | None = None if endless else _read(source, self._articles, reading or order_reading())
        orders = self._all or ()
        self.have_strengths = articles is not None or any(np.isfinite(boxes.strength_n).any() for boxes in orders)
        self.lie = any(boxes.upright is not None and boxes.upright[:, :2].any() for boxes in orders)

    def draw(self, rng: np.random.Generator) -> Boxes:
        """A random order of the source, or with ``endless`` a newly drawn order."""
        if self._all is None:
            return _of_order(draw_order(self._seed, int(rng.integers(_MOST_DRAWN))), self._articles)
        return self._all[int(rng.integers(len(self._all)))]

    def numbered(self, number: int) -> Boxes:
        """An order by its number, from 0, below ``count``."""
        if self._all is None:
            return _of_order(draw_order(self._seed, number), self._articles)
        return self._all[number]

    @property
    def count(self) -> int:
        """The number of orders."""
        return _MOST_DRAWN if self._all is None else len(self._all)

    def some(self, count: int) -> list[Boxes]:
        """All orders; with ``endless`` the first ``count``."""
        if self._all is not None:
            return self._all
        return [_of_order(draw_order(self._seed, number), self._articles) for number in range(count)]


def _read(source: Any, articles: Articles | None, reading: OrderReading) -> list[Boxes]:
    if isinstance(source, pd.DataFrame):
        if set(_COLUMNS) <= set(source.columns):
            return _of_table(source, "orders")
        return [_of_order(order, articles) for _, order in read_order_frame(source, reading=reading)]
    if isinstance(source, str | PathLike):
        return _of_file(path_of(source, "orders"), articles, reading)
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


def _of_file(path: Path, articles: Articles | None, reading: OrderReading) -> list[Boxes]:
    name, kind = printable(str(path)), path.suffix.lower()
    try:
        table = parquet_table(path).to_pandas() if kind == ".parquet" else _own_csv(path) if kind == ".csv" else None
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {reason(error)}") from error
    except (ValueError, KeyError) as error:
        raise InputError(f"{name}: cannot be read as orders: {error}") from error
    if table is not None and set(_COLUMNS) <= set(table.columns):
        return _of_table(table, name)
    return [_of_order(order, articles) for _, order in read_orders(path, reading=reading)]


def _own_csv(path: Path) -> pd.DataFrame | None:
    """A table of boxes with petmjx's own names of columns; None: the file has other names."""
    try:
        if not set(_COLUMNS) <= set(pd.read_csv(path, nrows=0).columns):
            return None
    except ValueError:  # another encoding, no table
        return None
    return pd.read_csv(path)


def _of_table(table: pd.DataFrame, name: str) -> list[Boxes]:
    table = _with_numbers(table, name)
    groups = [group for _, group in table.groupby("order_id", sort=False)] if "order_id" in table else [table]
    if _STRENGTH in table and not (table[_STRENGTH].dropna() > 0).all():
        raise InputError(f"{name}: {_STRENGTH} must be above 0, or empty")
    upright = _upright(table, name)
    return _checked_boxes(
        [
            (
                rows[list(_COLUMNS[:3])],
                rows[_COLUMNS[3]],
                rows.get(_STRENGTH),
                None if upright is None else upright[table.index.get_indexer(rows.index)],
            )
            for rows in groups
        ],
        name,
    )


def _with_numbers(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """The table with numbers in the columns that have numbers.

    Raises:
        InputError: a cell has something else; the line names its row, from 1 on.
    """
    numbers = {}
    for column in (*_COLUMNS, _STRENGTH):
        if column not in table:
            continue
        numbers[column] = pd.to_numeric(table[column], errors="coerce")
        wrong = np.flatnonzero(numbers[column].isna() & table[column].notna())
        if len(wrong):
            cell = printable_name(str(table[column].iloc[wrong[0]]))
            raise InputError(f"{name}: row {wrong[0] + 1}: {column} must be a number, got {cell!r}")
    return table.assign(**numbers)


def _upright(table: pd.DataFrame, name: str) -> NDArray[np.bool_] | None:
    """(k, 3) whether each size of a box may be vertical; None: not in the table."""
    if _UPRIGHT not in table:
        return None
    marks = table[_UPRIGHT].fillna("").astype(str).str.lower().replace("", "h")
    if not (wrong := marks[~marks.str.fullmatch(f"[{_SIZES}]+")]).empty:
        raise InputError(f"{name}: {_UPRIGHT} must be letters of l, w and h, or empty, got {wrong.iloc[0]!r}")
    return np.column_stack([marks.str.contains(letter) for letter in _SIZES])


def _checked_boxes(groups: Sequence[tuple[Any, Any, Any, Any]], name: str) -> list[Boxes]:
    orders = [
        Boxes(
            np.asarray(sizes, float),
            np.asarray(masses, float),
            np.full(len(masses), np.nan) if strengths is None else np.asarray(strengths, float),
            upright,
        )
        for sizes, masses, strengths, upright in groups
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
