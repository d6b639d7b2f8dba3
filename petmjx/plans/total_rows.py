"""Recognises rows of totals, sums and means in raw tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from petmjx.plans.column_names import OWN_COLUMNS, column_meanings, plain_text
from petmjx.plans.header_names import geometric_columns
from petmjx.plans.raw_cells import cell_number, is_number
from petmjx.plans.raw_tables import RawTable


def is_total(row: Sequence[Any], geometric: Sequence[int]) -> bool:
    """Whether a row is a total or a mean. Its first text must be a word for a total or a mean. If the text only begins
    with a word for a total or a mean, the row must also lack a size or a place, since a box may be called "Total
    fruit"."""
    text = next((cell for cell in row if isinstance(cell, str) and not is_number(cell)), "")
    plain = plain_text(text).strip()
    if not _TOTAL.match(plain):
        return False
    if _ONLY_TOTAL.match(plain):
        return True
    return not geometric or any(index >= len(row) or row[index] is None for index in geometric)


def computed_row(table: RawTable, rows: Sequence[int]) -> str:
    """How the last row relates to the rows above it: "the total", "the sums" or "the means"; "" if the row is a box.

    Args:
        rows: indices of the rows of one plan.

    The sizes, places and weights of the last row must all be sums, or all be means. At least two numbers of the row
    must clearly be sums or means. A single sum or mean is not enough: a box on two smaller boxes may have the sum of
    their lengths, and a box in the middle of a layer of equal boxes has their mean place. If a table has petmjx's own
    column names and no places, its last row is never taken for a row of means: it is more likely a medium-sized box. If
    all rows have articles, the last row is not taken for a row of means either.
    """
    if len(rows) > 1 and is_total(table.rows[rows[-1]], geometric_columns(table.header)):
        return "the total"
    if len(rows) < 3:
        return ""
    meanings = column_meanings(table.header)
    columns = [
        (meaning.kind, index)
        for index, meaning in enumerate(meanings)
        if meaning is not None and meaning.kind in _COMPUTED and not meaning.of_container
    ]
    last = table.rows[rows[-1]]
    has_article = any(
        meaning is not None and meaning.kind == "article" and _names_box(table.rows[row][index] for row in rows)
        for index, meaning in enumerate(meanings)
    )
    has_places = any(kind in _PLACES for kind, _ in columns)
    sums, means = True, not has_article and (has_places or not {*OWN_COLUMNS} <= {*table.header})
    n_sums = n_means = n_goods = 0
    for kind, index in columns:
        number = cell_number(last[index], table.decimal)
        if number is None:
            if last[index] is not None:
                return ""
            continue
        above = [cell_number(table.rows[row][index], table.decimal) for row in rows[:-1]]
        values = np.array([cell.value for cell in above if cell is not None])
        if len(values) < len(rows) - 1 or not np.isfinite(values).all():
            return ""
        total, mean = float(values.sum()), float(values.mean())
        # Sequence and number columns are not tested: a row of sums may have any value in them.
        if kind not in ("sequence", "number"):
            sums &= _as_written(number.value, total)
            n_sums += total != 0.0
        means &= _as_written(number.value, mean)
        varies = bool(np.ptp(values) > 0.0)
        n_means += varies
        n_goods += varies and kind not in _PLACES
        if not sums and not means:
            return ""
    return "the sums" if sums and n_sums > 1 else "the means" if means and n_means > 1 and n_goods else ""


def _names_box(articles: Iterable[Any]) -> bool:
    """Whether all these cells of a column have text, and the last text is not a symbol for a mean (ø, or o or x in its
    place)."""
    texts = [plain_text(cell).strip() if isinstance(cell, str) else "" for cell in articles]
    return all(texts) and texts[-1].lower() not in ("ø", "o", "x")


_PLACES: Final = ("position", "low", "high")
_COMPUTED: Final = ("size", "weight", "volume", "sequence", "number", *_PLACES)
"""Kinds of columns whose sums and means show that a row is not a box."""


def _as_written(value: float, exact: float) -> bool:
    """Whether the number in a cell equals an exact number that is rounded to the cell's decimals."""
    decimals = next((count for count in range(7) if round(value, count) == value), 6)
    return abs(value - exact) <= 0.5000001 * 10.0**-decimals + 1e-9 * abs(exact)


_TOTAL: Final = re.compile(
    r"^(?:grand |sub|sub[- ]|sous[- ]|zwischen|end)?(?:total|totals|sums?|summe|gesamt(?:summe|gewicht)?|somme|suma|"
    r"totale|totales|totaux|razem|lacznie|ogolem|summen|insgesamt|celkem|totaal|average|avg|mean|median|mittelwert|mittel|"
    r"durchschnitt|moyenne|media|promedio|srednia|gemiddelde|prumer)\b",
    re.IGNORECASE,
)
"""Words for totals and means, without accents."""
_ONLY_TOTAL: Final = re.compile(
    _TOTAL.pattern + r"[\s:=.]*(?:\(.*\)|\[.*\]|[\d.,]+\s*\w{0,5})?[\s:=.]*$", re.IGNORECASE
)
"""A word for a total or a mean, with no other word after it: "Summe:", "Total (26)", "Total 12 kg"."""
