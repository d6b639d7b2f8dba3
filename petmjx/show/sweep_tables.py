"""What the command line shows of a sweep's answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import pandas as pd

from petmjx.show.layout import Column, FittedTable, number, percent
from petmjx.sweeps.shares import ALL_PLANS

FEW_ROWS: Final = 40
"""Up to so many worlds or searches a table with a row for each is shown."""

MAX_VALUES: Final = 50
"""Axis values shown, at most; all of them are in ``summary``."""

_QUANTILES: Final = {"smallest": 0.0, "lower\nquarter": 0.25, "median": 0.5, "upper\nquarter": 0.75, "largest": 1.0}

_PROFILE: Final = Column("profile", "left", least=11, middle=True)


def sweep_tables(summary: pd.DataFrame) -> Iterator[FittedTable]:
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


def shares_table(summary: pd.DataFrame) -> FittedTable:
    """Share standing for each value of each axis that has several, over all plans.

    Shares are of the worlds named before them: those with a verdict, and those that were held against EUMOS's limits.
    """
    overall = summary[summary["plan_id"] == ALL_PLANS]
    several = overall.groupby("axis")["value"].transform("size") > 1
    shown = overall[several | (overall["axis"] == "")]
    eumos, angle = "eumos_share" in shown, "smallest_fail_angle_deg" in shown
    table = FittedTable(
        Column("axis", "left", least=13, middle=True),
        Column("value", least=11, middle=True),
        Column("worlds\njudged"),
        Column("stand", spare=1),
        Column("share"),
        Column("95 %"),
        *([Column("worlds\ntested"), Column("pass\nEUMOS")] if eumos else []),
        *([Column("fails\nfrom")] if angle else []),
        caption=f"{len(shown) - MAX_VALUES:,} more in summary" if len(shown) > MAX_VALUES else "",
    )
    for row in shown.head(MAX_VALUES).to_dict("records"):
        cells = [
            str(row["axis"]) or "all",
            str(row["value"]),
            f"{row['n_worlds'] - row['n_invalid']:,}",
            f"{row['n_standing']:,}",
            percent(row["share"]),
            f"{percent(row['low'])} to {percent(row['high'])}",
        ]
        cells += [f"{row['n_eumos']:,}", percent(row["eumos_share"])] if eumos else []
        cells += [number(row["smallest_fail_angle_deg"], ".1f", " °")] if angle else []
        table.add(*cells)
    return table


def levels_table(summary: pd.DataFrame) -> FittedTable:
    """How the largest levels survived are spread over plans, for each profile and direction.

    A placement that does not stand, or survives no level, counts as 0.
    """
    column, name = _largest(summary)
    table = FittedTable(
        _PROFILE,
        Column("direction\n°"),
        Column("searches"),
        Column("stand\nat rest"),
        *map(Column, _QUANTILES),
        title=f"largest {name} survived",
    )
    for (profile, direction), part in summary.groupby(["profile", "direction_deg"], sort=True):
        levels = part[column].fillna(0.0)
        cells = [str(profile), f"{direction:g}", f"{len(part):,}", f"{int(part['stands_at_rest'].sum()):,}"]
        table.add(*cells, *(number(levels.quantile(q)) for q in _QUANTILES.values()))
    return table


def answers_table(summary: pd.DataFrame) -> FittedTable:
    """A row a search: largest level survived, and what fails first above it."""
    column, name = _largest(summary)
    table = FittedTable(
        Column("plan", "left", least=20, middle=True),
        _PROFILE,
        Column("direction\n°"),
        Column(f"largest\n{name}"),
        Column("fails", "left"),
        Column("first box", "left", least=8),
        caption="" if summary["monotone"].all() else "* a level above the smallest that failed was survived",
    )
    for row in summary.to_dict("records"):
        table.add(
            str(row["plan_id"]),
            str(row["profile"]),
            f"{row['direction_deg']:g}",
            number(row[column]) + ("" if row["monotone"] else " *"),
            str(row["mode"]) if row["stands_at_rest"] else f"at rest: {row['mode']}",
            "" if pd.isna(row["box"]) else f"{row['box']} {row['article']}",
        )
    return table


def _largest(summary: pd.DataFrame) -> tuple[str, str]:
    """The column with the largest level or scale, and what that is called."""
    names = {"largest_level_g": "level, g", "largest_scale": "scale"}
    return next((column, name) for column, name in names.items() if column in summary)
