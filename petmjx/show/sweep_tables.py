"""The tables of a sweep's answers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.common.text import box_label
from petmjx.common.units import FloatArray
from petmjx.results.share_intervals import ALL_PLANS, ONE_PLAN
from petmjx.runs.chain_legs import AS_IS
from petmjx.runs.chain_summary import WHOLE_WAY, arrivals, shares_by_leg
from petmjx.runs.sweep_axes import AXIS_KINDS
from petmjx.show.table_layout import FittedTable, TableColumn, number, percent

FEW_ROWS: Final = 40
"""Largest number of worlds or searches for which a table with one row for each is shown."""

MAX_VALUES: Final = 50
"""Largest number of rows in other tables. The run's table ``summary`` has all rows."""

_QUANTILES: Final = {"min": 0.0, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "max": 1.0}

_DOUBTS: Final = {
    "monotone": "* a level above the smallest that failed was survived",
    "moving": "~ boxes still moved there when the longest wait was over",
}
"""Name of each column in a search's summary that can make an answer doubtful → footnote of the table. The first letter
of a footnote is its mark."""

_STANDARD_AXES: Final = ("profile", "direction_deg", "level_g", "scale")
"""Columns of axes: those that every table of a search shows, and those whose largest survived value is the answer of
the search."""

_PROFILE: Final = TableColumn("profile", "left", least=11, middle=True)


def sweep_tables(summary: pd.DataFrame) -> Iterator[FittedTable]:
    """The tables for the ``summary`` of a run: tables of shares that stand, or of the largest levels survived.

    Args:
        summary: :attr:`petmjx.results.run_reader.RunResults.summary`.
    """
    if "axis" in summary:
        yield shares_table(summary)
        levels = summary[(summary["scope"] == ONE_PLAN) & (summary["axis"] == "level_g")]
        levels = levels.assign(level_g=pd.to_numeric(levels["value"], errors="coerce")).dropna(subset="level_g")
        if "eumos_elastic_share" in summary and levels["n_eumos"].any():
            yield levels_passed_table(levels)
        return
    if "weakest_leg" in summary:
        yield from chain_tables(summary)
        return
    yield levels_table(summary)
    if len(summary) <= FEW_ROWS:
        yield answers_table(summary)
        if "eumos_passed" in summary and summary["eumos_passed"].notna().any():
            yield laboratory_table(summary)
    if summary.get("wrap_turns", pd.Series(dtype="float64")).nunique() > 1 and "largest_level_g" in summary:
        yield turns_table(summary)


def _varied_columns(summary: pd.DataFrame) -> list[str]:
    """The columns of those axes that have several values in a search, such as turns of film, except
    ``_STANDARD_AXES``."""
    axis_columns = (kind.column for kind in AXIS_KINDS.values())
    return [
        name for name in axis_columns if name in summary and name not in _STANDARD_AXES and summary[name].nunique() > 1
    ]


def _headers(names: Sequence[str]) -> list[TableColumn]:
    return [TableColumn(name.replace("_", "\n", 1), spare=0) for name in names]


def shares_table(summary: pd.DataFrame) -> FittedTable:
    """A table of the share of worlds that stand, over all plans, for each value of each axis that has several values.

    The column before a share gives the number of worlds from which the share is computed: worlds with a verdict, or
    worlds to which EUMOS's limits were applied.
    """
    overall = summary[summary["scope"] == ALL_PLANS]
    several = overall.groupby("axis")["value"].transform("size") > 1
    shown = overall[several | (overall["axis"] == "")]
    eumos, angle = "eumos_share" in shown, "smallest_fail_angle_deg" in shown
    drawn = bool(shown["low"].notna().any())
    table = FittedTable(
        TableColumn("axis", "left", least=13, middle=True),
        TableColumn("value", least=11, middle=True),
        TableColumn("worlds\njudged"),
        TableColumn("stand", spare=1),
        TableColumn("share"),
        *([TableColumn("draws", spare=2), TableColumn("95 %")] if drawn else []),
        *([TableColumn("worlds\ntested"), TableColumn("pass\nEUMOS")] if eumos else []),
        *([TableColumn("fails\nfrom")] if angle else []),
        caption=f"{len(shown) - MAX_VALUES:,} more in summary" if len(shown) > MAX_VALUES else "",
    )
    for row in shown.head(MAX_VALUES).to_dict("records"):
        cells = [
            str(row["axis"]) or "all",
            str(row["value"]),
            f"{row['n_worlds'] - row['n_invalid']:,}",
            f"{row['n_standing']:,}",
            percent(row["share"]),
        ]
        if drawn:
            interval = f"{row['n_draws']:,}", f"{percent(row['low'])} to {percent(row['high'])}"
            cells += interval if row["n_draws"] else ("", "")
        cells += [f"{row['n_eumos']:,}", percent(row["eumos_share"])] if eumos else []
        cells += [number(row["smallest_fail_angle_deg"], ".1f", " °")] if angle else []
        table.add(*cells)
    return table


def confidence_table(summary: pd.DataFrame) -> FittedTable:
    """A table with one row per plan of a score with confidence: the verdict without errors, and the share of worlds
    with errors in which the plan stands.

    If boxes could not be placed in some worlds, the table also has the number of these worlds, and the number of other
    worlds in which boxes fell.
    """
    tosses = bool(summary["coin_toss"].any())
    fails, has_exact = bool(summary[["n_not_placed", "n_fell"]].any(axis=None)), "share_exact" in summary
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        TableColumn("nominal", "left"),
        TableColumn("margin", spare=2),
        TableColumn("stand"),
        TableColumn("share", spare=1),
        TableColumn("95 %"),
        *([TableColumn("could not\nbe placed"), TableColumn("fell")] if fails else []),
        *([TableColumn("share,\nexact")] if has_exact else []),
        *([TableColumn("", "left")] if tosses else []),
        title="worlds with errors",
        caption="* differs beyond chance from boxes that are carried"
        if has_exact and summary["placing_matters"].any()
        else "",
    )
    for row in summary.to_dict("records"):
        judged = row["n_worlds"] - row["n_invalid"]
        is_judged = judged > 0
        table.add(
            str(row["plan_id"]),
            str(row["verdict"]),
            number(row["margin"], ".2f"),
            f"{row['n_standing']} of {judged}",
            percent(row["share"]),
            f"{percent(row['low'])} to {percent(row['high'])}" if is_judged else "",
            *([f"{row[name] or ''}" for name in ("n_not_placed", "n_fell")] if fails else []),
            *([percent(row["share_exact"]) + (" *" if row["placing_matters"] else "")] if has_exact else []),
            *(["coin toss" if row["coin_toss"] else ""] if tosses else []),
        )
    return table


def chain_tables(summary: pd.DataFrame) -> Iterator[FittedTable]:
    """The tables of a chain (a pallet's journey in parts, called legs): a table with one row per plan if there are few
    plans, a table with one row per leg, and a table with one row per remedy."""
    of_plans = arrivals(summary)
    if len(of_plans) <= FEW_ROWS:
        yield arrivals_table(summary, of_plans)
    overall = summary[summary["scope"] == ALL_PLANS]
    if len(of_plans) > 1:
        yield legs_table(overall[overall["remedy"] == AS_IS])
    remedies = overall[(overall["remedy"] != AS_IS) & (overall["leg"] == WHOLE_WAY)]
    if len(remedies):
        yield remedies_table(remedies)


def arrivals_table(summary: pd.DataFrame, of_plans: pd.DataFrame) -> FittedTable:
    """A table with one row per plan: the share of worlds in which the plan arrives; for each leg, the share that stands
    after this leg, of the worlds that reached it; and the leg with the most failures."""
    shares = shares_by_leg(summary)
    drawn = bool(of_plans["low"].notna().any())
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        TableColumn("arrive"),
        TableColumn("P"),
        *([TableColumn("95 %")] if drawn else []),
        *(TableColumn(leg, spare=2) for leg in shares),
        TableColumn("weakest", "left", least=8),
        TableColumn("box", spare=1),
        title="worlds that arrive; by leg: that stand after it, of those that reached it",
    )
    for row in of_plans.to_dict("records"):
        table.add(
            str(row["plan_id"]),
            f"{row['n_standing']:,} of {row['n_worlds'] - row['n_invalid']:,}",
            percent(row["share"]),
            *([_interval(row, "low", "high")] if drawn else []),
            *map(percent, shares.loc[row["plan_id"]]),
            str(row["weakest_leg"]),
            "" if pd.isna(row["box"]) else str(int(row["box"])),
        )
    return table


def _interval(row: Mapping[Any, Any], low: str, high: str) -> str:
    return "" if pd.isna(row[low]) else f"{percent(row[low])} to {percent(row[high])}"


def legs_table(legs: pd.DataFrame) -> FittedTable:
    """A table with one row per leg, over all plans."""
    table = FittedTable(
        TableColumn("leg", "left", least=10),
        TableColumn("worlds\nreach it"),
        TableColumn("stand\nafter it"),
        TableColumn("invalid", spare=2),
        TableColumn("share"),
        TableColumn("95 %", spare=1),
        title="all plans",
    )
    for row in legs.to_dict("records"):
        counts = (f"{row[name]:,}" for name in ("n_worlds", "n_standing", "n_invalid"))
        table.add(str(row["leg"]) or "whole way", *counts, percent(row["share"]), _interval(row, "low", "high"))
    return table


def remedies_table(remedies: pd.DataFrame) -> FittedTable:
    """A table with one row per remedy, over all plans. The remedy with the largest gain comes first."""
    table = FittedTable(
        TableColumn("remedy", "left", least=16),
        TableColumn("P"),
        TableColumn("gain,\npoints"),
        TableColumn("95 %", spare=1),
        TableColumn("arrive only\nwith it", spare=2),
        TableColumn("only\nwithout", spare=2),
        title="what would help: the same worlds with a remedy",
    )
    for row in remedies.sort_values("gain", ascending=False, kind="stable").to_dict("records"):
        bounds = [number(row[name], "+.1f", factor=100.0) for name in ("gain", "gain_low", "gain_high")]
        span = "" if pd.isna(row["gain_low"]) else f"{bounds[1]} to {bounds[2]}"
        table.add(
            str(row["remedy"]),
            percent(row["share"]),
            bounds[0],
            span,
            *(f"{int(row[name]):,}" for name in ("only_with", "only_without")),
        )
    return table


def levels_table(summary: pd.DataFrame) -> FittedTable:
    """A table of quantiles of the largest levels survived, for each profile and direction. Only searches whose pallet
    stands before it is shaken are considered.

    "survive none" is the number of searches in which no level above 0 is survived. If no level is survived at a
    quantile, the table shows "none".
    """
    column, name = _largest(summary)
    varied = _varied_columns(summary)
    table = FittedTable(
        _PROFILE,
        TableColumn("direction\n°"),
        *_headers(varied),
        TableColumn("searches"),
        TableColumn("stand\nat rest"),
        TableColumn("survive\nnone"),
        *(TableColumn(header, spare=int(q in (0.25, 0.75))) for header, q in _QUANTILES.items()),
        title=f"largest {name} survived, where placements stand at rest",
        caption=_more(summary.groupby(["profile", "direction_deg", *varied]).ngroups),
    )
    groups = summary.groupby(["profile", "direction_deg", *varied], sort=True)
    for (profile, direction, *values), part in itertools.islice(groups, MAX_VALUES):
        levels = part.loc[part["stands_at_rest"], column].sort_values(na_position="first")
        counts = len(part), len(levels), int((~(levels > 0)).sum())
        cells = [str(profile), f"{direction:g}", *map(_cell, values), *(f"{count:,}" for count in counts)]
        table.add(*cells, *(_quantile(levels.to_numpy(float), q) for q in _QUANTILES.values()))
    return table


def _more(rows: int) -> str:
    return f"{rows - MAX_VALUES:,} more in summary" if rows > MAX_VALUES else ""


def _cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _quantile(levels: FloatArray, q: float) -> str:
    """A quantile of levels as text. The levels are rising; NaN (no level is survived) comes first."""
    if not len(levels):
        return "-"
    place = q * (len(levels) - 1)
    lower, upper = levels[math.floor(place)], levels[math.ceil(place)]
    return "none" if np.isnan(lower) else number(lower + (place % 1) * (upper - lower))


def answers_table(summary: pd.DataFrame) -> FittedTable:
    """A table with one row per search: the largest level survived, and the box that fails first at higher levels."""
    column, name = _largest(summary)
    varied = _varied_columns(summary)
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        _PROFILE,
        TableColumn("direction\n°"),
        *_headers(varied),
        TableColumn(f"largest\n{name}"),
        TableColumn("fails", "left"),
        TableColumn("first box", "left", least=8),
        caption="; ".join(text for column, text in _DOUBTS.items() if _doubts(summary, column).any()),
    )
    marks = {column: _doubts(summary, column).tolist() for column in _DOUBTS}
    for place, row in enumerate(summary.to_dict("records")):
        table.add(
            str(row["plan_id"]),
            str(row["profile"]),
            f"{row['direction_deg']:g}",
            *(_cell(row[name]) for name in varied),
            number(row[column]) + "".join(f" {text[0]}" for mark, text in _DOUBTS.items() if marks[mark][place]),
            str(row["mode"]) if row["stands_at_rest"] else f"at rest: {row['mode']}",
            "" if pd.isna(row["box"]) else box_label(int(row["box"]), row["article"]),
        )
    return table


def laboratory_table(summary: pd.DataFrame) -> FittedTable:
    """A table with one row per search with EUMOS's test: the values that a laboratory reports, at the largest level
    survived."""
    varied = _varied_columns(summary)
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        TableColumn("direction\n°"),
        *_headers(varied),
        TableColumn("level\ng"),
        TableColumn("elastic\n≤ 10 %"),
        TableColumn("permanent\n≤ 5 %"),
        TableColumn("foot, cm\n≤ 4"),
        TableColumn("EUMOS\n40509", "left"),
        title="EUMOS 40509 at the largest level survived: deformations as shares of the load's height",
    )
    for row in summary[summary["eumos_passed"].notna()].to_dict("records"):
        table.add(
            str(row["plan_id"]),
            f"{row['direction_deg']:g}",
            *(_cell(row[name]) for name in varied),
            number(row["largest_level_g"]),
            *_deformations(row),
            "passed" if row["eumos_passed"] else "failed",
        )
    return table


def levels_passed_table(levels: pd.DataFrame) -> FittedTable:
    """A table with one row for each plan and level of a grid with EUMOS's test: the values that a laboratory reports,
    each the worst over all worlds of the level, for example over directions.

    If the grid has levels at which laboratories test, only these levels are shown.

    Args:
        levels: rows of the summary, one for each plan and level, with the column ``level_g``.
    """
    usual = np.isclose(levels["level_g"].to_numpy()[:, None], LABORATORY_LEVELS_G).any(axis=1)
    shown = levels[usual] if usual.any() else levels
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        TableColumn("level\ng"),
        TableColumn("worlds\ntested"),
        TableColumn("elastic\n≤ 10 %"),
        TableColumn("permanent\n≤ 5 %"),
        TableColumn("foot, cm\n≤ 4"),
        TableColumn("EUMOS\n40509", "left"),
        title="EUMOS 40509 at each level: the largest deformations, as shares of the load's height",
        caption=_more(len(shown)),
    )
    for row in shown.head(MAX_VALUES).to_dict("records"):
        tested, failed = int(row["n_eumos"]), int(row["n_eumos"] - row["n_eumos_passed"])
        table.add(
            str(row["plan_id"]),
            f"{row['level_g']:g}",
            f"{tested:,}",
            *_deformations(row),
            "-" if not tested else "passed" if not failed else "failed" if failed == tested else f"{failed} failed",
        )
    return table


def _deformations(row: Mapping[Any, Any]) -> Iterator[str]:
    """Yield three cells: the elastic and the permanent deformation as shares, and the deformation of the load's foot,
    cm."""
    yield percent(row["eumos_elastic_share"])
    yield percent(row["eumos_permanent_share"])
    yield number(row["eumos_foot_permanent_m"], ".1f", factor=100.0)


LABORATORY_LEVELS_G: Final = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Levels at which laboratories test load units by EUMOS 40509."""


def turns_table(summary: pd.DataFrame) -> FittedTable:
    """A table of the number of turns of film that each plan needs to survive each level: the smallest tested number
    with which the plan survives the level in every direction. "none": the plan does not survive with any tested
    number."""
    least = summary.fillna({"largest_level_g": 0.0}).groupby(["plan_id", "wrap_turns"], sort=False)["largest_level_g"]
    survived = least.min().unstack("wrap_turns")
    tested = np.fmax(summary["largest_level_g"].max(), summary["first_failed_level_g"].max())
    levels = [level for level in LABORATORY_LEVELS_G if level <= tested]
    table = FittedTable(
        TableColumn("plan", "left", least=20, middle=True),
        *(TableColumn(f"{level:g} g") for level in levels),
        title="turns of film with which plans survive a level in every direction tried",
        caption=_more(len(survived)),
    )
    for plan_id, row in survived.head(MAX_VALUES).iterrows():
        enough = (row.index[row >= level - _SAME_LEVEL_G] for level in levels)
        table.add(str(plan_id), *(f"{turns.min():g}" if len(turns) else "none" for turns in enough))
    return table


_SAME_LEVEL_G: Final = 1e-9
"""Largest difference of two levels that count as equal, g. This tolerance is needed since 0.1 + 0.2 is not exactly
0.3."""


def _doubts(summary: pd.DataFrame, column: str) -> pd.Series[bool]:
    """(n,) whether each answer of a search is doubtful according to one column of ``_DOUBTS``. All values are False if
    the run is of an older version that does not have the column."""
    if column not in summary:
        return pd.Series(False, index=summary.index)
    return summary[column].astype(bool) != (column == "monotone")


def _largest(summary: pd.DataFrame) -> tuple[str, str]:
    """The name of the column with the largest level or scale survived, and its heading."""
    names = {"largest_level_g": "level, g", "largest_scale": "scale"}
    return next((column, name) for column, name in names.items() if column in summary)
