"""What the command line shows of a sweep's answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import pandas as pd
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from petmjx.sweeps.shares import ALL_PLANS

FEW_ROWS: Final = 40
"""Up to so many worlds or searches a table with a row for each is shown."""

MAX_VALUES: Final = 50
"""Axis values shown, at most; all of them are in ``summary``."""

_QUANTILES: Final = {"smallest": 0.0, "lower\nquarter": 0.25, "median": 0.5, "upper\nquarter": 0.75, "largest": 1.0}


def sweep_tables(summary: pd.DataFrame) -> Iterator[Table]:
    """The tables for a run's ``summary``: of shares, or of largest levels survived.

    Args:
        summary: as :attr:`petmjx.results.reader.RunResults.summary` reads it.
    """
    if "axis" in summary:
        yield shares_table(summary)
        return
    yield levels_table(summary)
    if len(summary) <= FEW_ROWS:
        yield answers_table(summary)


def _table(*headers: str, left: int = 1) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False, collapse_padding=True)
    for number, header in enumerate(headers):
        table.add_column(header, justify="left" if number < left else "right", no_wrap=True)
    return table


def shares_table(summary: pd.DataFrame) -> Table:
    """Share standing for each value of each axis that has several, over all plans."""
    overall = summary[summary["plan_id"] == ALL_PLANS]
    several = overall.groupby("axis")["value"].transform("size") > 1
    shown = overall[several | (overall["axis"] == "")]
    eumos, angle = "eumos_share" in shown, "smallest_fail_angle_deg" in shown
    headers = ["axis", "value", "worlds", "stand", "share", "95 %"]
    headers += ["passes\nEUMOS"] if eumos else []
    headers += ["fails\nfrom"] if angle else []
    table = _table(*headers)
    for row in shown.head(MAX_VALUES).to_dict("records"):
        cells = [
            str(row["axis"]) or "all",
            str(row["value"]),
            f"{row['n_worlds']:,}",
            f"{row['n_standing']:,}",
            _percent(row["share"]),
            f"{_percent(row['low'])} to {_percent(row['high'])}",
        ]
        cells += [_percent(row["eumos_share"])] if eumos else []
        cells += [_number(row["smallest_fail_angle_deg"], ".1f", " °")] if angle else []
        table.add_row(*map(escape, cells))
    if len(shown) > MAX_VALUES:
        table.add_row("…", "", "", "", "", f"{len(shown) - MAX_VALUES} more in summary")
    return table


def levels_table(summary: pd.DataFrame) -> Table:
    """How the largest levels survived are spread over plans, for each profile and direction.

    A placement that does not stand, or survives no level, counts as 0.
    """
    column = _largest(summary)
    table = _table("profile", "direction °", "searches", "stand\nat rest", *_QUANTILES)
    for (profile, direction), part in summary.groupby(["profile", "direction_deg"], sort=True):
        levels = part[column].fillna(0.0)
        cells = [str(profile), f"{direction:g}", f"{len(part):,}", f"{int(part['stands_at_rest'].sum()):,}"]
        cells += [f"{levels.quantile(q):.3g}" for q in _QUANTILES.values()]
        table.add_row(*map(escape, cells))
    table.title = f"largest {_name(column)} survived"
    table.title_justify = "left"
    return table


def answers_table(summary: pd.DataFrame) -> Table:
    """A row a search: largest level survived, and what fails first above it."""
    column = _largest(summary)
    table = _table("plan", "profile", "direction °", f"largest\n{_name(column)}", "fails", "first box", left=2)
    table.columns[-1].justify = "left"
    for row in summary.to_dict("records"):
        box = "" if pd.isna(row["box"]) else f"{row['box']} {row['article']}"
        fails = str(row["mode"]) if row["stands_at_rest"] else f"at rest: {row['mode']}"
        table.add_row(
            escape(str(row["plan_id"])),
            escape(str(row["profile"])),
            f"{row['direction_deg']:g}",
            _number(row[column], ".3g") + ("" if row["monotone"] else " *"),
            escape(fails),
            Text(box, no_wrap=True, overflow="ellipsis"),
        )
    if not summary["monotone"].all():
        table.caption = "* a level above the smallest that failed was survived"
        table.caption_justify = "left"
    return table


def _largest(summary: pd.DataFrame) -> str:
    return next(str(name) for name in summary if str(name).startswith("largest_"))


def _name(column: str) -> str:
    return {"largest_level_g": "level, g", "largest_scale": "scale"}[column]


def _percent(share: Any) -> str:
    return _number(share, ".1f", " %", 100.0)


def _number(value: Any, form: str, unit: str = "", factor: float = 1.0) -> str:
    return "-" if pd.isna(value) else f"{factor * float(value):{form}}{unit}"
