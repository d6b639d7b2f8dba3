"""Sources of orders (lists of boxes to pack) for episodes: petmjx's generator of random orders, files of orders in any
form, and tables of boxes with strengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.options.run_options import RunOptions
from petmjx.plans.articles import Articles, read_articles
from petmjx.plans.item_columns import MOST_PIECES, SIZE_LETTERS
from petmjx.plans.item_units_and_quantities import OrderReading
from petmjx.plans.order import Item, Order
from petmjx.plans.order_generator import catalogue, drawn_articles
from petmjx.plans.order_reader import read_order_frame, read_orders
from petmjx.plans.plan_fields import vanishing_side

ENDLESS: Final = "endless"
"""Value of the option ``orders`` for random orders, which are generated as by ``petmjx samples``. Each episode draws a
new order."""

STRENGTH: Final = 4
"""Index of the column of ``Boxes.rows`` that has the strength of a box."""

_HEIGHT_IS_UPRIGHT: Final = (False, False, True)

_MOST_DRAWN: Final = 200_000


def order_reading(units: Any = None, columns: Any = None, density: Any = None) -> OrderReading:
    """How an environment reads files of orders that are not in BED-BPP's form. Orders may have any number of boxes.

    Args:
        units, columns, density: as the fields of ``petmjx.RunOptions``. For an option that is None, the most plausible
            value is used.

    Raises:
        InputError: a value is unusable. The message begins with the name of the environment's option, such as
            ``orders_units``.
    """
    try:
        options = RunOptions(units=units, columns=columns, density=density)
    except InputError as error:
        raise InputError(f"orders_{error}") from None
    return replace(OrderReading.of(options), most_items=MOST_PIECES, for_episodes=True)


@dataclass(frozen=True, eq=False)
class Boxes:
    """The boxes of one order, in the sequence in which they arrive.

    Attributes:
        size_mm: (k, 3) length, width and height of each box; ``mass_kg``: (k,) mass of each box.
        strength_n: (k,) largest load that each box can bear on its top, N; NaN if unknown.
        upright: (k, 3) whether the length, the width and the height of each box may be vertical. If ``upright`` is
            None, only the height may be vertical.
        article: (k,) number of the article of each box. Boxes of an article are equal, except that their strengths may
            differ. If ``article`` is None, the articles are unknown.
        name: id of the order in its source; "" if the order has no id.
    """

    size_mm: FloatArray
    mass_kg: FloatArray
    strength_n: FloatArray
    upright: NDArray[np.bool_] | None = None
    name: str = ""
    article: NDArray[np.int64] | None = None

    @cached_property
    def rows(self) -> FloatArray:
        """(k, 8) one row for each box: its three sizes, mass and strength, and then, for each size, 1 if the size may
        be vertical, else 0."""
        rows: FloatArray = np.zeros((len(self), 8))
        rows[:, :3], rows[:, 3], rows[:, STRENGTH] = self.size_mm, self.mass_kg, self.strength_n
        rows[:, 5:] = _HEIGHT_IS_UPRIGHT if self.upright is None else self.upright
        return rows

    @cached_property
    def kind(self) -> NDArray[np.int64]:
        """(k,) number of each box's kind. Boxes of a kind are equal, except that their strengths may differ."""
        if self.article is not None:
            return self.article
        numbers: dict[bytes, int] = {}
        keys = [box.tobytes() for box in np.delete(self.rows, STRENGTH, axis=1)]
        return np.array([numbers.setdefault(key, len(numbers)) for key in keys], np.int64)

    def take(self, rows: Any) -> Boxes:
        """The boxes in the given rows."""
        upright = None if self.upright is None else self.upright[rows]
        article = None if self.article is None else self.article[rows]
        return Boxes(self.size_mm[rows], self.mass_kg[rows], self.strength_n[rows], upright, self.name, article)

    def __len__(self) -> int:
        return len(self.mass_kg)


class Orders:
    """The orders of a source. Each episode packs one of the orders.

    Args:
        source: ``endless``; a file of orders in any form that ``petmjx samples --orders`` reads; a data frame; or a
            list of ``Order``. A data frame may have a column ``strength_n`` with strengths in N, and a column
            ``upright`` with the letters of the sizes that may be vertical (l for length, w for width, h for height).
        seed: seed of the generator of random orders.
        articles: a table of articles, whose strengths take precedence over ``strength_n``.
        reading: how to read files of orders that are not in BED-BPP's form. If ``reading`` is None, the most plausible
            reading is taken.

    Attributes:
        reading: how files of orders are read; for generated orders, what :func:`order_reading` returns without any
            options.
        have_strengths: whether the strength of some box may be known.
        lie: whether some box may stand on a side other than its base.

    Raises:
        InputError: the source is unknown, or a file cannot be used.
    """

    def __init__(
        self, source: Any = ENDLESS, seed: int = 0, articles: Any = None, reading: OrderReading | None = None
    ) -> None:
        self._seed = seed
        self._articles = None if articles is None else read_articles(path_of(articles, "articles"))
        endless = isinstance(source, str) and source == ENDLESS
        self.reading = order_reading() if endless or reading is None else reading
        self._all: list[Boxes] | None = None if endless else _read(source, self._articles, self.reading)
        orders = self._all or ()
        self.have_strengths = articles is not None or any(np.isfinite(boxes.strength_n).any() for boxes in orders)
        self.lie = any(boxes.upright is not None and boxes.upright[:, :2].any() for boxes in orders)

    def check_sizes(self, size_reduction_mm: float) -> None:
        """Raise InputError if a size of any box is not positive after it is reduced by ``size_reduction_mm``. The
        message names the order and the box."""
        for boxes in self._all or ():
            if (thin := vanishing_side(boxes.size_mm, size_reduction_mm)) is not None:
                raise InputError(f"orders: order {printable_name(boxes.name)}, box {thin[0] + 1}: {thin[1]}")

    def draw(self, rng: np.random.Generator) -> Boxes:
        """Draw a random order of the source. If the source is ``endless``, the order is newly generated."""
        return self.numbered(int(rng.integers(self.count)))

    def numbered(self, number: int) -> Boxes:
        """The order with the given number, from 0 to ``count`` − 1."""
        if self._all is None:
            _, articles = drawn_articles(self._seed, number)
            return self._catalogue.take(articles)
        return self._all[number]

    @cached_property
    def _catalogue(self) -> Boxes:
        """A box of each article of the generator."""
        articles = catalogue(self._seed)
        boxes = _of_order(Order("", articles), self._articles)
        return replace(boxes, article=np.arange(len(articles)))

    @property
    def count(self) -> int:
        """The number of orders of the source."""
        return _MOST_DRAWN if self._all is None else len(self._all)

    def some(self, count: int) -> list[Boxes]:
        """All orders of the source, or the first ``count`` orders if the source is ``endless``."""
        return self._all if self._all is not None else [self.numbered(number) for number in range(count)]


def _read(source: Any, articles: Articles | None, reading: OrderReading) -> list[Boxes]:
    if isinstance(source, pd.DataFrame):
        read = list(read_order_frame(source, reading=reading))
    elif isinstance(source, str | PathLike):
        read = list(read_orders(path_of(source, "orders"), reading=reading))
    else:
        read = [(str(number), order) for number, order in enumerate(list_of(source, "orders", Order, "orders"))]
    if not read:
        raise InputError("orders must hold at least one order")
    return [_of_order(order, articles, name) for name, order in read]


def _of_order(order: Order, articles: Articles | None, name: str = "") -> Boxes:
    rows = np.array([[item.length_mm, item.width_mm, item.height_mm, item.weight_kg] for item in order.items], float)
    strengths = np.array([_strength(item, articles) for item in order.items], float)
    upright = None
    if any(item.upright for item in order.items):
        upright = np.array([[letter in (item.upright or "h") for letter in SIZE_LETTERS] for item in order.items])
    return Boxes(rows[:, :3], rows[:, 3], strengths, upright, name)


def _strength(item: Item, articles: Articles | None) -> float:
    strength = None if articles is None else articles.find(item.article, item.product_group).strength
    if strength is not None:
        return strength.of_box(item.length_mm, item.width_mm)
    return np.nan if item.strength_n is None else item.strength_n
