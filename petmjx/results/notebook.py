"""Tables as notebooks show them: short, and without style of their own, so that they follow the notebook's theme."""

from __future__ import annotations

import html
from typing import Any, Final

import pandas as pd

from petmjx.text import counted
from petmjx.units import MM_PER_M

MOST_ROWS: Final = 20
"""More are for ``.worlds``."""

COLUMNS: Final[tuple[tuple[str, str, float, int], ...]] = (
    ("plan_id", "plan", 1.0, 0),
    ("variant", "variant", 1.0, 0),
    ("n_boxes", "boxes", 1.0, 0),
    ("verdict", "verdict", 1.0, 0),
    ("reason", "reason", 1.0, 0),
    ("margin", "margin", 1.0, 2),
    ("culprit", "first box", 1.0, 0),
    ("first_sign_s", "at s", 1.0, 2),
    ("max_shift_m", "shift mm", MM_PER_M, 1),
    ("max_tilt_deg", "tilt °", 1.0, 1),
    ("rest_top_force_n", "rest force N", 1.0, 1),
)
"""Column of ``worlds``, its head, the factor to the head's unit, and decimals. Columns that a run lacks are left out,
and so is the variant where there is only the nominal one."""


def worlds_as_html(title: str, worlds: pd.DataFrame) -> str:
    """The first rows of the table ``worlds`` under a line of text."""
    varied = "variant" in worlds and worlds["variant"].any()
    columns = [column for column in COLUMNS if column[0] in worlds and (varied or column[0] != "variant")]
    heads = "".join(f"<th>{head}</th>" for _, head, _, _ in columns)
    shown = worlds[[name for name, _, _, _ in columns]].head(MOST_ROWS).to_dict("records")
    rows = "".join(
        f"<tr>{''.join(f'<td>{_cell(row[name], factor, decimals)}</td>' for name, _, factor, decimals in columns)}</tr>"
        for row in shown
    )
    left = len(worlds) - MOST_ROWS
    more = f"<p>… and {counted(left, 'row')} more in <code>.worlds</code></p>" if left > 0 else ""
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
    return f"<div><p><code>{html.escape(title)}</code></p>{table}{more}</div>"


def _cell(value: Any, factor: float, decimals: int) -> str:
    if pd.isna(value):
        return ""
    if isinstance(value, float):
        return f"{round(value * factor, decimals) + 0.0:,.{decimals}f}"  # + 0.0: no minus before a zero
    return html.escape(str(value))
