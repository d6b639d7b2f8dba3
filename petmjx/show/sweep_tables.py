"""The tables of a sweep's answers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pandas as pd

from petmjx.common.text import box_label
from petmjx.common.units import FloatArray
from petmjx.results.share_statistics import ALL_PLANS, ONE_PLAN
from petmjx.runs.chain_legs import AS_IS
from petmjx.runs.chain_summary import WHOLE_WAY, arrivals, shares_by_leg
from petmjx.runs.sweep_axes import AXIS_KINDS
from petmjx.show.table_layout import (
    FEW_ROWS,
    Cell,
    FittedTable,
    Row,
    TableColumn,
    count_of,
    interval_cell,
    name_column,
    number,
    number_of,
    percent,
    percent_of,
    text_of,
)

MAX_VALUES: Final = 50
"""Largest number of rows in the tables of shares, of largest levels, of EUMOS's test at each level, and of turns of
film. The run's table ``summary`` has all rows."""

_QUANTILES: Final = {"min": 0.0, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "max": 1.0}

_DOUBTS: Final = {
    "monotone": "* a level above the smallest failed level was survived",
    "moving": "~ boxes still moved after the longest wait",
}
"""Name of a column in a search's summary that can make an answer doubtful → footnote of the table. The first character
of a footnote is the mark of doubtful answers."""

_STANDARD_AXES: Final = ("profile", "direction_deg", "level_g", "scale")
"""The axes (columns of the summary) for which the table of answers needs no additional column. The table always has
columns for profile and direction, and its answer is the largest level or scale survived."""

_PLAN: Final = name_column("plan", "plan_id", least=20)
_PROFILE: Final = name_column("profile", "profile", least=11)
_DIRECTION: Final = TableColumn("direction\n°", number_of("direction_deg", "g"))
_DEFORMATIONS: Final = (
    TableColumn("elastic\n≤ 10 %", percent_of("eumos_elastic_share")),
    TableColumn("permanent\n≤ 5 %", percent_of("eumos_permanent_share")),
    TableColumn("foot, cm\n≤ 4", number_of("eumos_foot_permanent_m", ".1f", factor=100.0)),
)
"""The elastic and the permanent deformation of a load as shares of its height, and the deformation of its foot."""


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


def _axis_columns(names: Sequence[str]) -> list[TableColumn]:
    return [TableColumn(name.replace("_", "\n", 1), _axis_value(name)) for name in names]


def _axis_value(name: str) -> Cell:
    return lambda row: f"{row[name]:g}" if isinstance(row[name], int | float) else str(row[name])


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

    def draws(row: Row) -> str:
        return f"{row['n_draws']:,}" if row["n_draws"] else ""

    def interval_of_draws(row: Row) -> str:
        return interval_cell(row) if row["n_draws"] else ""

    return FittedTable(
        shown.head(MAX_VALUES).to_dict("records"),
        TableColumn("axis", lambda row: str(row["axis"]) or "all", "left", least=13, middle=True),
        TableColumn("value", text_of("value"), least=11, middle=True),
        TableColumn("worlds\njudged", _judged),
        TableColumn("stand", count_of("n_standing"), spare=1),
        TableColumn("share", percent_of("share")),
        *([TableColumn("draws", draws, spare=2), TableColumn("95 %", interval_of_draws)] if drawn else []),
        *([TableColumn("worlds\ntested", count_of("n_eumos"))] if eumos else []),
        *([TableColumn("pass\nEUMOS", percent_of("eumos_share"))] if eumos else []),
        *([TableColumn("fails\nfrom", number_of("smallest_fail_angle_deg", ".1f", " °"))] if angle else []),
        caption=_more(len(shown)),
    )


def _judged(row: Row) -> str:
    """A cell with the number of worlds that have a valid verdict."""
    return f"{row['n_worlds'] - row['n_invalid']:,}"


def confidence_table(summary: pd.DataFrame) -> FittedTable:
    """A table with one row per plan of a score with confidence: the verdict without errors, and the share of worlds
    with errors in which the plan stands.

    If boxes could not be placed in some worlds, the table also has the number of these worlds, and the number of other
    worlds in which boxes fell.
    """
    tosses = bool(summary["coin_toss"].any())
    fails, has_exact = bool(summary[["n_not_placed", "n_fell"]].any(axis=None)), "share_exact" in summary

    def stand(row: Row) -> str:
        return f"{row['n_standing']} of {row['n_worlds'] - row['n_invalid']}"

    def share_exact(row: Row) -> str:
        return percent(row["share_exact"]) + (" *" if row["placing_matters"] else "")

    def count_if_any(name: str) -> Cell:
        return lambda row: f"{row[name] or ''}"

    return FittedTable(
        summary.to_dict("records"),
        _PLAN,
        TableColumn("nominal", text_of("verdict"), "left"),
        TableColumn("margin", number_of("margin", ".2f"), spare=2),
        TableColumn("stand", stand),
        TableColumn("share", percent_of("share"), spare=1),
        TableColumn("95 %", lambda row: interval_cell(row) if row["n_worlds"] > row["n_invalid"] else ""),
        *([TableColumn("could not\nbe placed", count_if_any("n_not_placed"))] if fails else []),
        *([TableColumn("fell", count_if_any("n_fell"))] if fails else []),
        *([TableColumn("share,\nexact", share_exact)] if has_exact else []),
        *([TableColumn("", lambda row: "coin toss" if row["coin_toss"] else "", "left")] if tosses else []),
        title="worlds with errors",
        caption="* this share differs from the share with carried boxes by more than chance"
        if has_exact and summary["placing_matters"].any()
        else "",
    )


def chain_tables(summary: pd.DataFrame) -> Iterator[FittedTable]:
    """The tables of a chain (a pallet's journey in parts, called legs): a table of the plans if there are few plans, a
    table of the legs, and a table of the remedies."""
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
    """A table with one row per plan. A row has the share of worlds in which the plan arrives; for each leg, the share
    of worlds that stand after this leg, among the worlds that reached it; and the leg with the most failures."""
    shares = shares_by_leg(summary)
    drawn = bool(of_plans["low"].notna().any())

    def share_after(leg: str) -> Cell:
        return lambda row: percent(shares.loc[row["plan_id"], leg])

    return FittedTable(
        of_plans.to_dict("records"),
        _PLAN,
        TableColumn("arrive", lambda row: f"{row['n_standing']:,} of {_judged(row)}"),
        TableColumn("P", percent_of("share")),
        *([TableColumn("95 %", interval_cell)] if drawn else []),
        *(TableColumn(leg, share_after(leg), spare=2) for leg in shares),
        TableColumn("weakest", text_of("weakest_leg"), "left", least=8),
        TableColumn("box", lambda row: "" if pd.isna(row["box"]) else str(int(row["box"])), spare=1),
        title="P: share that arrives; legs: share that stands after the leg, of worlds that reached it",
    )


def legs_table(legs: pd.DataFrame) -> FittedTable:
    """A table with one row per leg, over all plans."""
    return FittedTable(
        legs.to_dict("records"),
        TableColumn("leg", lambda row: row["leg"] or "whole way", "left", least=10),
        TableColumn("worlds\nreach it", count_of("n_worlds")),
        TableColumn("stand\nafter it", count_of("n_standing")),
        TableColumn("invalid", count_of("n_invalid"), spare=2),
        TableColumn("share", percent_of("share")),
        TableColumn("95 %", interval_cell, spare=1),
        title="all plans",
    )


def remedies_table(remedies: pd.DataFrame) -> FittedTable:
    """A table with one row per remedy, over all plans. The remedy that raises the share of arriving worlds most comes
    first."""

    def points(name: str) -> Cell:
        return number_of(name, "+.1f", factor=100.0)

    def span(row: Row) -> str:
        return "" if pd.isna(row["gain_low"]) else f"{points('gain_low')(row)} to {points('gain_high')(row)}"

    return FittedTable(
        remedies.sort_values("gain", ascending=False, kind="stable").to_dict("records"),
        TableColumn("remedy", text_of("remedy"), "left", least=16),
        TableColumn("P", percent_of("share")),
        TableColumn("gain,\npoints", points("gain")),
        TableColumn("95 %", span, spare=1),
        TableColumn("arrive only\nwith it", count_of("only_with"), spare=2),
        TableColumn("only\nwithout", count_of("only_without"), spare=2),
        title="what would help: the same worlds, simulated with a remedy",
    )


def levels_table(summary: pd.DataFrame) -> FittedTable:
    """A table of quantiles of the largest levels survived, for each profile and direction. Only searches whose pallet
    stands before it is shaken are considered.

    The column "survive none" has the number of searches in which no level above 0 is survived. If no level is survived
    at a quantile, the table shows "none".
    """
    column, name = _largest(summary)
    varied = _varied_columns(summary)
    groups = summary.groupby(["profile", "direction_deg", *varied], sort=True)
    rows = []
    for key, part in itertools.islice(groups, MAX_VALUES):
        levels = part.loc[part["stands_at_rest"], column].sort_values(na_position="first").to_numpy(float)
        row = dict(zip(("profile", "direction_deg", *varied), key, strict=True))
        row |= {"n": len(part), "n_at_rest": len(levels), "n_none": int((~(levels > 0)).sum())}
        rows.append(row | {quantile: _quantile(levels, q) for quantile, q in _QUANTILES.items()})
    return FittedTable(
        rows,
        _PROFILE,
        _DIRECTION,
        *_axis_columns(varied),
        TableColumn("searches", count_of("n")),
        TableColumn("stand\nat rest", count_of("n_at_rest")),
        TableColumn("survive\nnone", count_of("n_none")),
        *(TableColumn(quantile, text_of(quantile), spare=int(q in (0.25, 0.75))) for quantile, q in _QUANTILES.items()),
        title=f"largest {name} survived, where placements stand at rest",
        caption=_more(groups.ngroups),
    )


def _more(rows: int) -> str:
    return f"{rows - MAX_VALUES:,} more in summary" if rows > MAX_VALUES else ""


def _quantile(levels: FloatArray, q: float) -> str:
    """A quantile of levels as text. ``levels`` are sorted, lowest first; NaN (no level is survived) comes before all
    numbers."""
    if not len(levels):
        return "-"
    place = q * (len(levels) - 1)
    lower, upper = levels[math.floor(place)], levels[math.ceil(place)]
    return "none" if np.isnan(lower) else number(lower + (place % 1) * (upper - lower))


def answers_table(summary: pd.DataFrame) -> FittedTable:
    """A table with one row per search: the largest level survived, and the box that fails first at higher levels."""
    column, name = _largest(summary)
    varied = _varied_columns(summary)
    doubts = {text: _doubts(summary, doubt) for doubt, text in _DOUBTS.items()}
    marks = ["".join(f" {text[0]}" for text in doubts if doubts[text].iloc[at]) for at in range(len(summary))]

    def first_box(row: Row) -> str:
        return "" if pd.isna(row["box"]) else box_label(int(row["box"]), row["article"])

    return FittedTable(
        summary.assign(marks=marks).to_dict("records"),
        _PLAN,
        _PROFILE,
        _DIRECTION,
        *_axis_columns(varied),
        TableColumn(f"largest\n{name}", lambda row: number(row[column]) + row["marks"]),
        TableColumn("fails", lambda row: ("" if row["stands_at_rest"] else "at rest: ") + str(row["mode"]), "left"),
        TableColumn("first box", first_box, "left", least=8),
        caption="; ".join(text for text in doubts if doubts[text].any()),
    )


def laboratory_table(summary: pd.DataFrame) -> FittedTable:
    """A table with one row per search with EUMOS's test: the values that a laboratory reports, at the largest level
    survived."""
    varied = _varied_columns(summary)
    return FittedTable(
        summary[summary["eumos_passed"].notna()].to_dict("records"),
        _PLAN,
        _DIRECTION,
        *_axis_columns(varied),
        TableColumn("level\ng", number_of("largest_level_g")),
        *_DEFORMATIONS,
        TableColumn("EUMOS\n40509", lambda row: "passed" if row["eumos_passed"] else "failed", "left"),
        title="EUMOS 40509 at the largest level survived: deformations as shares of the load's height",
    )


def levels_passed_table(levels: pd.DataFrame) -> FittedTable:
    """A table with one row for each plan and level of a sweep: the values that a laboratory reports after EUMOS's test
    at this level. Each value is the worst among all worlds of the level, for example among all directions.

    If the sweep has levels at which laboratories test, only the laboratories' levels are shown.

    Args:
        levels: rows of the summary, one for each plan and level, with the column ``level_g``.
    """
    usual = np.isclose(levels["level_g"].to_numpy()[:, None], LABORATORY_LEVELS_G).any(axis=1)
    shown = levels[usual] if usual.any() else levels

    def passed(row: Row) -> str:
        tested, failed = int(row["n_eumos"]), int(row["n_eumos"] - row["n_eumos_passed"])
        return "-" if not tested else "passed" if not failed else "failed" if failed == tested else f"{failed} failed"

    return FittedTable(
        shown.head(MAX_VALUES).to_dict("records"),
        _PLAN,
        TableColumn("level\ng", number_of("level_g", "g")),
        TableColumn("worlds\ntested", count_of("n_eumos")),
        *_DEFORMATIONS,
        TableColumn("EUMOS\n40509", passed, "left"),
        title="EUMOS 40509 at each level: the largest deformations, as shares of the load's height",
        caption=_more(len(shown)),
    )


LABORATORY_LEVELS_G: Final = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Levels at which laboratories test load units by EUMOS 40509."""


def turns_table(summary: pd.DataFrame) -> FittedTable:
    """A table of the number of turns of film that each plan needs for each level: the smallest tested number of turns
    with which the plan survives the level in every direction. "none": the plan does not survive with any tested
    number."""
    least = summary.fillna({"largest_level_g": 0.0}).groupby(["plan_id", "wrap_turns"], sort=False)["largest_level_g"]
    survived = least.min().unstack("wrap_turns")
    tested = np.fmax(summary["largest_level_g"].max(), summary["first_failed_level_g"].max())
    levels = [level for level in LABORATORY_LEVELS_G if level <= tested]

    def enough(level: float) -> Cell:
        def cell(row: Row) -> str:
            turns = [turns for turns in survived if row[turns] >= level - _SAME_LEVEL_G]
            return f"{min(turns):g}" if turns else "none"

        return cell

    return FittedTable(
        survived.head(MAX_VALUES).reset_index().to_dict("records"),
        _PLAN,
        *(TableColumn(f"{level:g} g", enough(level)) for level in levels),
        title="turns of film with which plans survive a level in all tried directions",
        caption=_more(len(survived)),
    )


_SAME_LEVEL_G: Final = 1e-9
"""Largest difference of two levels that count as equal, g. A tolerance is needed since 0.1 + 0.2 is not exactly 0.3."""


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
