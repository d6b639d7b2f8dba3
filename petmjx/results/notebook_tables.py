"""Short HTML tables for notebooks. The HTML defines no styles, so it follows the notebook's theme."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from petmjx.common.text import count_text
from petmjx.common.units import MM_PER_M

if TYPE_CHECKING:
    import pandas as pd

MOST_ROWS: Final = 20
"""Largest number of rows that are shown of a table."""


@dataclass(frozen=True)
class ShownColumn:
    """A column of a data frame, and how notebooks show it.

    Attributes:
        name: name of the column in the data frame.
        head: heading of the shown column, with the unit.
        decimals: number of decimals of fractional numbers.
        factor: factor that converts the values to the unit in the heading.
    """

    name: str
    head: str
    decimals: int = 0
    factor: float = 1.0


WORLD_COLUMNS: Final = (
    ShownColumn("plan_id", "plan"),
    ShownColumn("variant", "variant"),
    ShownColumn("n_boxes", "boxes"),
    ShownColumn("verdict", "verdict"),
    ShownColumn("reason", "reason"),
    ShownColumn("margin", "margin", 2),
    ShownColumn("culprit", "first box"),
    ShownColumn("first_sign_s", "at s", 2),
    ShownColumn("max_shift_m", "shift mm", 1, MM_PER_M),
    ShownColumn("max_tilt_deg", "tilt °", 1),
    ShownColumn("rest_top_force_n", "rest force N", 1),
)
"""The columns of ``worlds`` that are shown. The column of the variant is left out if all worlds have variant 0."""


def worlds_as_html(title: str, worlds: pd.DataFrame) -> str:
    """HTML with the first rows of the table ``worlds``, below a line of text."""
    varied = "variant" in worlds and worlds["variant"].any()
    columns = [column for column in WORLD_COLUMNS if varied or column.name != "variant"]
    return block_as_html([title], [table_as_html(worlds, columns, "worlds")])


def block_as_html(lines: Sequence[str], tables: Sequence[str]) -> str:
    """HTML with lines of text, followed by tables from :func:`table_as_html`. The first line is set as code."""
    first, *other_lines = map(html.escape, lines)
    texts = "".join(f"<p>{line}</p>" for line in other_lines)
    return f"<div><p><code>{first}</code></p>{texts}{''.join(tables)}</div>"


def table_as_html(frame: pd.DataFrame, columns: Sequence[ShownColumn], attribute: str) -> str:
    """HTML with the first rows of a data frame. Columns that the data frame lacks are left out.

    Args:
        attribute: name of the attribute that holds the whole data frame, such as ``worlds``.
    """
    columns = [column for column in columns if column.name in frame]
    heads = "".join(f"<th>{html.escape(column.head)}</th>" for column in columns)
    records = frame[[column.name for column in columns]].head(MOST_ROWS).to_dict("records")
    rows = "".join(f"<tr>{''.join(_cell(row[column.name], column) for column in columns)}</tr>" for row in records)
    left = len(frame) - MOST_ROWS
    more_text = f"<p>… and {count_text(left, 'row')} more in <code>.{attribute}</code></p>" if left > 0 else ""
    return f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>{more_text}"


def _cell(value: Any, column: ShownColumn) -> str:
    import pandas as pd  # imported here, so that importing this module does not load pandas

    if pd.isna(value):
        return "<td></td>"
    if isinstance(value, float):
        text = f"{round(value * column.factor, column.decimals) + 0.0:,.{column.decimals}f}"  # + 0.0 turns -0 into 0
        return f"<td>{text}</td>"
    return f"<td>{html.escape(str(value))}</td>"
