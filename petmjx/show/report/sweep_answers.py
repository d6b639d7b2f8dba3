"""The answers of sweeps in a report: shares along axes, largest levels by direction, and which axis matters most."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.common.text import count_text, next_round_number, three_digits
from petmjx.common.units import FloatArray
from petmjx.engines.verdict import Verdict
from petmjx.results.share_statistics import ALL_PLANS, share_standing
from petmjx.runs.chain_legs import AS_IS
from petmjx.runs.chain_summary import WHOLE_WAY, arrivals, shares_by_leg
from petmjx.show.pages.markup import NOTHING, Markup, element, joined_markup, table
from petmjx.show.report.chart_frame import MOST_TICKS, Frame, Scale, figure
from petmjx.show.report.charts import (
    ROSE_RINGS,
    Bar,
    bars,
    histogram,
    interval_text,
    intervals,
    percent,
    rose,
    share_curve,
)
from petmjx.show.report.report_runs import Kind, ReportRun
from petmjx.show.report.verdict_shares import ORDER, link, plan_link
from petmjx.show.table_layout import count_of

DIRECTION: Final = "direction_deg"
STRENGTHS: Final = {"level_g": ("level", "g"), "scale": ("scale", "")}
"""Name of a column of ``worlds`` with the strength of the shaking → (name, unit) in texts."""

FEWEST_DIRECTIONS: Final = 3
"""Smallest number of directions for which a rose (a chart of values by direction) is drawn."""

MOST_VALUES: Final = 60
"""Largest number of values of an axis that are drawn, and of rows in a table."""

MOST_NAMED: Final = 12

AXES_CAPTION: Final = (
    "For each value of an axis, the share of worlds that stand includes all values of the other axes. Range: "
    "difference of the largest and the smallest of these shares. Explained: part of the variance of “stands” that lies "
    "between the values of the axis (η², the squared correlation ratio). The row “plan” shows how much plans differ."
)
DIRECTIONS_CAPTION: Final = (
    "Line: the median plan; band: the middle half of the plans. A plan that survives no level counts as 0."
)


LEGS_CAPTION: Final = (
    "Share of worlds that stand after a leg, among the worlds that reached it. Line: Wilson’s 95 % interval."
)
WEAKEST_LEG_CAPTION: Final = "Number of plans by their weakest leg: the leg with the most failures of a plan."


def sweep_answers(run: ReportRun) -> Markup:
    """The section with the answers of a sweep, or of a score with confidence. For a score without confidence, the
    section is empty."""
    summary = run.results.summary
    if summary is None or summary.empty or run.worlds.empty:
        return NOTHING
    if run.shares is not None:
        return _grid(run, run.shares)
    if run.kind is Kind.SEARCH:
        return _search(run, summary)
    if run.kind is Kind.CHAIN:
        return _chain(summary)
    return _confidence(run, summary)


# sweeps over a grid, or over random samples


def _grid(run: ReportRun, summary: pd.DataFrame) -> Markup:
    worlds = run.worlds
    numeric = [
        axis for axis in run.axes if pd.api.types.is_numeric_dtype(worlds[axis]) and _has_numeric_values(summary, axis)
    ]
    text_axes = [axis for axis in run.axes if axis not in numeric]
    over_plans = share_standing(worlds.assign(draw=pd.factorize(worlds["plan_id"])[0]), run.axes)
    charts = [_curve(axis, summary, over_plans, run) for axis in numeric]
    charts += [_named_values(axis, summary, run) for axis in text_axes]
    matters = importance(worlds, run.axes, summary)
    if len(matters) > 1:
        charts.append(_importance_chart(matters))
    charts += [_rose_figure(*arguments) for arguments in _grid_roses(run)]
    return element("div", *charts, class_="charts")


def _has_numeric_values(summary: pd.DataFrame, axis: str) -> bool:
    """Whether the values of an axis are numbers in a summary. If an axis has random values, the summary divides the
    range of the axis into parts with names, so the values in the summary are texts."""
    return bool(pd.to_numeric(_rows(summary, axis)["value"], errors="coerce").notna().all())


def _curve(axis: str, summary: pd.DataFrame, over_plans: pd.DataFrame, run: ReportRun) -> Markup:
    """A chart of the share that stands along an axis with numbers. Intervals are computed from the random draws of the
    run or, if nothing is random, from the plans."""
    draws, plans = (_rows(frame, axis).head(MOST_VALUES) for frame in (summary, over_plans))
    drawn = bool(draws["low"].notna().all())
    rows = draws if drawn else plans
    x = rows["value"].astype("float64").to_numpy()
    order = np.argsort(x)
    unit = run.results.units("worlds").get(axis, "")
    frame = Frame(
        f"Share that stands by {axis}", Scale.over(x), Scale(0, 1), _with_unit(axis, unit), "stand", y_percent=True
    )
    share, low, high = (rows[name].to_numpy(np.float64)[order] for name in ("share", "low", "high"))
    if len(x) <= MOST_TICKS:
        frame.x_ticks = [(value, f"{value:g}") for value in x[order]]
    share_curve(frame, x[order], share, low, high)
    of = count_text(int(rows["n_draws"].max()), "random draw" if drawn else "plan")
    return figure(_title(axis), frame.svg(), f"Band: Wilson’s 95 % interval, from {of} at each value.")


def _rows(summary: pd.DataFrame, axis: str) -> pd.DataFrame:
    return summary[(summary["scope"] == ALL_PLANS) & (summary["axis"] == axis)]


def _named_values(axis: str, summary: pd.DataFrame, run: ReportRun) -> Markup:
    drawn = [
        Bar(
            str(row["value"]),
            row["share"],
            f"{percent(row['share'])} of {row['n_worlds'] - row['n_invalid']:,}",
            "stable",
        )
        for row in _rows(summary, axis).head(MOST_VALUES).to_dict("records")
    ]
    note = "Share of worlds that stand, among the worlds with a valid verdict."
    return figure(_title(axis), bars(f"Share that stands by {axis}", drawn), note)


def _title(axis: str) -> str:
    return f"Share that stands by {axis.removesuffix('_g').removesuffix('_deg').removesuffix('_mm').replace('_', ' ')}"


def _with_unit(axis: str, unit: str) -> str:
    name = axis.removesuffix(f"_{unit}").replace("_", " ")
    return f"{name}, {unit.replace('deg', '°')}" if unit not in ("", "1") else name


def importance(worlds: pd.DataFrame, axes: Sequence[str], summary: pd.DataFrame) -> pd.DataFrame:
    """How much each axis, and the choice of the plan, affects whether a world stands. The most important axis comes
    first.

    Returns:
        A table with the columns ``axis``, ``spread`` and ``explained``. For each value of the axis, there is a share of
        worlds that stand; ``spread`` is the difference between the largest and the smallest of these shares.
        ``explained`` is the squared correlation ratio η² = Σ nᵥ (pᵥ − p)² / (n p (1 − p)). Of the nᵥ worlds with value
        v, the share pᵥ stands; of all n worlds, the share p stands. The ratio is NaN if all worlds stand, or if no
        world stands. Sources: Pearson 1905; Fisher's one-way analysis of variance.
    """
    judged = worlds[worlds["verdict"] != Verdict.INVALID.value]
    stands = (judged["verdict"] == Verdict.STABLE.value).astype("float64")
    rows = []
    for axis in (*axes, "plan"):
        keys = judged["plan_id"] if axis == "plan" else judged[axis]
        if keys.nunique() < 2:
            continue
        groups = stands.groupby(keys).agg(["mean", "size"])
        spread = groups["mean"].max() - groups["mean"].min()
        if axis != "plan":
            shares = _rows(summary, axis)["share"]
            spread = shares.max() - shares.min()
        rows.append({"axis": axis, "spread": spread, "explained": correlation_ratio(stands, keys)})
    table = pd.DataFrame(rows, columns=["axis", "spread", "explained"])
    return table.sort_values("explained", ascending=False, ignore_index=True)


def correlation_ratio(values: pd.Series, keys: pd.Series) -> float:
    """The squared correlation ratio η² of values in groups: variance between groups / total variance. The ratio is NaN
    if all values are equal.

    Args:
        keys: the group of each value.
    """
    total = float(((values - values.mean()) ** 2).sum())
    if total <= 0:
        return float("nan")
    groups = values.groupby(keys).agg(["mean", "size"])
    return float((groups["size"] * (groups["mean"] - values[keys.notna()].mean()) ** 2).sum()) / total


def _importance_chart(matters: pd.DataFrame) -> Markup:
    rows = [
        Bar(row["axis"], row["explained"], f"{percent(row['explained'])} · {percent(row['spread'])}")
        for row in matters.to_dict("records")
    ]
    return figure("Which axis matters most: explained · range", bars("Which axis matters most", rows), AXES_CAPTION)


def _grid_roses(run: ReportRun) -> Iterator[tuple[str, str, pd.DataFrame, float]]:
    """The arguments of ``_rose_figure`` for each profile: title, unit, table of the largest level survived for each
    plan and direction, and the highest level tested."""
    worlds = run.worlds
    for column, (name, unit) in STRENGTHS.items():
        if column not in worlds or DIRECTION not in worlds:
            continue
        tested = worlds[worlds[column].notna() & worlds[DIRECTION].notna()]
        tested = tested.assign(profile=tested.get("profile", pd.Series("", index=tested.index)).fillna(""))
        for profile, part in tested.groupby("profile"):
            if part[column].nunique() > 1 and part[DIRECTION].nunique() >= FEWEST_DIRECTIONS:
                largest = largest_survived(part, column)
                yield f"Largest {name} of {profile or 'the profile'}", unit, largest, float(part[column].max())


def largest_survived(worlds: pd.DataFrame, column: str) -> pd.DataFrame:
    """The largest level that each plan survives in each direction. If no world failed, this level is the largest tested
    level. Otherwise, it is the largest tested level below the smallest level at which a world failed, or 0 if a world
    failed at the smallest tested level.

    Args:
        worlds: the worlds of one profile.
        column: name of the column with the level.

    Returns:
        A table with the columns plan_id, direction_deg and largest.
    """
    stands = worlds["verdict"] == Verdict.STABLE.value
    at_level = stands.groupby([worlds["plan_id"], worlds[DIRECTION], worlds[column]]).all()
    rising = at_level.sort_index()
    so_far = rising.groupby(level=[0, 1]).cummin()
    levels = rising.index.get_level_values(2).to_series(index=rising.index)
    largest = levels.where(so_far, 0.0).groupby(level=[0, 1]).max()
    return largest.rename("largest").reset_index()


def _rose_figure(title: str, unit: str, largest: pd.DataFrame, top: float) -> Markup:
    by = largest.groupby(DIRECTION)["largest"]
    directions = np.array(sorted(by.groups), dtype=np.float64)

    def at(share: float) -> FloatArray:
        return np.asarray(by.quantile(share).reindex(directions), dtype=np.float64)

    quantiles = {"low": at(0.25), "middle": at(0.5), "high": at(0.75)}
    reach = ROSE_RINGS * next_round_number(float(np.nanmax(quantiles["high"], initial=top / 10)) / ROSE_RINGS)
    picture = rose(title, directions, quantiles, reach, unit)
    n = count_text(int(largest["plan_id"].nunique()), "plan")
    return figure(f"{title} by direction", picture, f"{DIRECTIONS_CAPTION} {n}; tested up to {top:g} {unit}.")


# searches for the largest level survived


def _search(run: ReportRun, summary: pd.DataFrame) -> Markup:
    column = next(name for name in summary if str(name).startswith("largest_"))
    name, unit = STRENGTHS[str(column).removeprefix("largest_")]
    answers = summary[summary["stands_at_rest"].astype(bool)]
    at_rest = int((~summary.drop_duplicates(["plan_id", "placement"])["stands_at_rest"].astype(bool)).sum())
    note = f"{count_text(len(answers), 'search', 'searches')} of placements that stand at rest"
    note += f"; {count_text(at_rest, 'placement')} did not stand, and were not searched." if at_rest else "."
    parts = [element("p", note)]
    if answers.empty:
        return joined_markup(*parts)
    levels = answers.assign(largest=answers[column].fillna(0.0).astype("float64"))
    top = max(float(levels["largest"].max()), float(_upper(run)))
    charts = [_level_histogram(levels, name, unit)]
    for profile, part in levels.groupby("profile"):
        if part[DIRECTION].nunique() >= FEWEST_DIRECTIONS:
            charts.append(_rose_figure(f"Largest {name} of {profile}", unit, part, top or 1.0))
    charts += _search_importance(levels, summary, name)
    charts.append(_first_at_failure(run, answers))
    return joined_markup(*parts, element("div", *charts, class_="charts"), _levels_table(levels, name, unit))


def _upper(run: ReportRun) -> float:
    search = (run.info.get("config", {}).get("sweep") or {}).get("search") or {}
    return float(search.get("upper") or 0.0)


def _level_histogram(levels: pd.DataFrame, name: str, unit: str) -> Markup:
    label = f"largest {name} survived" + (f", {unit}" if unit else "")
    frame = Frame(f"Largest {name} survived", Scale.over(levels["largest"], zero=True), Scale(0, 1), label, "searches")
    histogram(frame, levels["largest"], pd.Series("plain", index=levels.index), ["plain"])
    return figure(frame.title, frame.svg(), "If no level is survived, the largest level counts as 0.")


def _search_importance(levels: pd.DataFrame, summary: pd.DataFrame, name: str) -> Iterator[Markup]:
    """A chart with one bar per axis of the sweep. The bar shows how much of the variance of the largest level survived
    is explained by the axis."""
    first, last = list(summary).index("placement"), list(summary).index("stands_at_rest")
    axes = {str(axis): levels[axis] for axis in list(summary)[first + 1 : last] if levels[axis].nunique() > 1}
    axes |= {"plan": levels["plan_id"]} if levels["plan_id"].nunique() > 1 else {}
    if len(axes) < 2:
        return
    values = {axis: correlation_ratio(levels["largest"], keys) for axis, keys in axes.items()}
    rows = [
        Bar(axis, value, percent(value))
        for axis, value in sorted(values.items(), key=lambda entry: -np.nan_to_num(entry[1]))
    ]
    note = f"Part of the variance of the largest {name} that lies between the values of an axis (η²)."
    yield figure("Which axis matters most", bars("Which axis matters most", rows), note)


def _first_at_failure(run: ReportRun, answers: pd.DataFrame) -> Markup:
    """A chart of the articles of the boxes that fail first, at the smallest level at which a plan failed."""
    failed = answers[answers["article"].fillna("") != ""]
    counts = failed["article"].value_counts().head(MOST_NAMED)
    rows = [
        Bar(str(article), float(n), f"{n:,}", "unstable", link(run, q=str(article))) for article, n in counts.items()
    ]
    note = f"In {count_text(len(failed), 'search', 'searches')}, the pallet failed at a level."
    return figure("Articles that fail first", bars("Articles that fail first", rows), note)


def _levels_table(levels: pd.DataFrame, name: str, unit: str) -> Markup:
    rows = [
        [
            str(profile),
            f"{direction:g}",
            f"{len(part):,}",
            *(three_digits(part["largest"].quantile(q)) for q in (0, 0.5, 1)),
        ]
        for (profile, direction), part in levels.groupby(["profile", DIRECTION])
    ]
    head = ["profile", "direction, °", "searches", "least", "median", "most"]
    caption = f"Largest {name} survived" + (f", {unit}" if unit else "")
    return table(head, rows[:MOST_VALUES], caption=caption)


# chains (journeys of a pallet in parts, called legs)


def _chain(summary: pd.DataFrame) -> Markup:
    """Charts and tables of the share of worlds in which plans arrive (over all plans, leg by leg, and for each plan),
    and a table of how much remedies raise this share."""
    overall, of_plans = summary[summary["scope"] == ALL_PLANS], arrivals(summary)
    legs = overall[overall["remedy"] == AS_IS]
    leg_rows = [(str(row["leg"]) or "whole way", row) for row in legs.to_dict("records")]
    charts = [figure("By leg", intervals("By leg", [_share_row(name, row) for name, row in leg_rows]), LEGS_CAPTION)]
    if len(of_plans) > 1:
        plain = pd.Series("plain", index=of_plans.index)
        charts.append(
            _share_histogram("Share of worlds that arrive", "share that arrives", of_plans["share"], plain, ["plain"])
        )
        weakest = of_plans.loc[of_plans["weakest_leg"] != "", "weakest_leg"].value_counts()
        rows = [
            Bar(str(leg), float(n), count_text(int(n), "plan"), Verdict.UNSTABLE.value) for leg, n in weakest.items()
        ]
        charts += [figure("Weakest leg", bars("Weakest leg", rows), WEAKEST_LEG_CAPTION)] if rows else []
    remedies = overall[(overall["remedy"] != AS_IS) & (overall["leg"] == WHOLE_WAY)]
    return joined_markup(
        element("div", *charts, class_="charts"),
        _remedies(remedies) if len(remedies) else NOTHING,
        _plans_by_leg(summary) if len(of_plans) <= MOST_VALUES else NOTHING,
    )


def _share_histogram(
    title: str, label: str, shares: pd.Series, classes: pd.Series, order: Sequence[str], note: str = ""
) -> Markup:
    """A histogram of plans by their share of worlds that stand or arrive. ``classes`` and ``order`` are as in
    ``histogram``."""
    frame = Frame(title, Scale(0, 1), Scale(0, 1), label, "plans")
    frame.x_ticks = [(value, f"{100 * value:.0f} %") for value in (0, 0.25, 0.5, 0.75, 1)]
    histogram(frame, shares.astype("float64"), classes, order)
    return figure(title, frame.svg(), note)


def _share_row(name: str, row: Mapping[Any, Any]) -> tuple[str, float, float, float, str]:
    """A row of the chart ``intervals``. If nothing in the run is random, both ends of the interval are the share
    itself."""
    share = float(row["share"])
    low, high = (share if pd.isna(row[end]) else float(row[end]) for end in ("low", "high"))
    text = f"{percent(share)} of {row['n_worlds'] - row['n_invalid']:,}"
    return name, share, low, high, text + (f" ({interval_text(low, high)})" if low < high else "")


def _remedies(remedies: pd.DataFrame) -> Markup:
    rows = []
    for row in remedies.sort_values("gain", ascending=False, kind="stable").to_dict("records"):
        gain = "" if pd.isna(row["gain"]) else f"{100 * row['gain']:+.1f}"
        span = "" if pd.isna(row["gain_low"]) else f"{100 * row['gain_low']:+.1f} to {100 * row['gain_high']:+.1f}"
        paired = (str(count_of(name)(row)) for name in ("only_with", "only_without"))
        rows.append([str(row["remedy"]), percent(row["share"]), gain, span, *paired])
    head = ["remedy", "share that arrives", "gain, points", "95 %", "arrive only with it", "only without it"]
    return table(head, rows, caption="What would help: the same worlds, simulated with a remedy")


def _plans_by_leg(summary: pd.DataFrame) -> Markup:
    shares = shares_by_leg(summary)
    rows = []
    for row in arrivals(summary).to_dict("records"):
        by_leg = map(percent, shares.loc[row["plan_id"]])
        span = "" if pd.isna(row["low"]) else interval_text(row["low"], row["high"])
        rows.append([str(row["plan_id"]), percent(float(row["share"])), span, *by_leg, str(row["weakest_leg"])])
    return table(["plan", "arrives", "95 %", *shares, "weakest leg"], rows, caption="By plan")


# scores with confidence


def _confidence(run: ReportRun, summary: pd.DataFrame) -> Markup:
    chart = _share_histogram(
        "Share of worlds with errors that stand",
        "share that stands",
        summary["share"],
        summary["verdict"],
        ORDER,
        "Coloured by the verdict without errors.",
    )
    tosses = summary.loc[summary["coin_toss"].astype(bool), "plan_id"].tolist()
    links = [
        element("li", element("a", str(plan_id), href=f"#{plan_link(run, str(plan_id))}"))
        for plan_id in tosses[:MOST_NAMED]
    ]
    more_item = element("li", f"{len(tosses) - MOST_NAMED:,} more") if len(tosses) > MOST_NAMED else NOTHING
    line = (
        f"{count_text(len(tosses), 'plan is a coin toss', 'plans are coin tosses')}: "
        "the 95 % interval of the share contains one half."
    )
    missed, fell = (int(summary[name].sum()) if name in summary else 0 for name in ("n_not_placed", "n_fell"))
    failure_text = f"A box could not be placed in {missed:,} worlds; boxes fell in {fell:,} worlds."
    return joined_markup(
        element("p", line),
        element("p", failure_text) if missed else NOTHING,
        element("ul", *links, more_item, class_="names") if tosses else NOTHING,
        element("div", chart, class_="charts"),
    )
