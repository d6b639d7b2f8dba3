"""Charts of shift, tilt, force and the time of the first sign (when a box first crosses a threshold): histograms, and
charts against the size of plans. The module also draws charts about the boxes that fail first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd

from petmjx.analysis.run_comparison import thresholds_of
from petmjx.common.text import count_text
from petmjx.common.units import MM_PER_M
from petmjx.engines.verdict import Verdict
from petmjx.options.thresholds import Thresholds
from petmjx.results.share_statistics import wilson_interval
from petmjx.show.pages.markup import NOTHING, Markup, element, joined_markup
from petmjx.show.report.chart_frame import WIDTH, Frame, Scale, figure
from petmjx.show.report.charts import (
    MOST_POINTS,
    Bar,
    bars,
    equal_groups,
    histogram,
    points,
    quantile_bands,
    share_curve,
)
from petmjx.show.report.report_runs import ReportRun
from petmjx.show.report.verdict_shares import ORDER, link


@dataclass(frozen=True)
class Quantity:
    """A metric of worlds, and how charts show it.

    Attributes:
        column: column of the table ``worlds``.
        title: name of the metric.
        label: name and unit of the metric, for an axis.
        factor: factor that converts values to the unit of the label.
        log_from: lower end of a logarithmic axis. If ``log_from`` is None, the axis is linear and begins at 0.
        lowest: label at the lower end of the axis, if smaller values are also drawn there.
        counts: whether values are whole numbers.
    """

    column: str
    title: str
    label: str
    factor: float = 1.0
    log_from: float | None = None
    lowest: str = ""
    counts: bool = False

    def of(self, worlds: pd.DataFrame) -> pd.Series:
        """The value of each world in the unit of the label. Missing and infinite values are NaN."""
        values = worlds[self.column].astype("float64") * self.factor
        return values.where(np.isfinite(values))

    def scale(self, values: pd.Series) -> Scale:
        """The axis for histograms of this metric. The axis extends from the metric's lower end to the largest value."""
        return Scale.over(values.to_numpy(), log_from=self.log_from, lowest=self.lowest, zero=True)

    def across(self, values: pd.Series) -> Scale:
        """An axis that extends from the smallest to the largest value."""
        return replace(Scale.over(values.to_numpy()), counts=self.counts)

    def limit(self, thresholds: Thresholds) -> float | None:
        """The threshold of this metric, in the unit of the label; None if the metric has no threshold."""
        limits = {"max_shift_m": thresholds.shift_m * MM_PER_M, "max_tilt_deg": thresholds.tilt_deg}
        return limits.get(self.column)


SHIFT: Final = Quantity("max_shift_m", "Shift", "largest shift, mm", MM_PER_M, 0.5, "< 1")
"""The largest shift. Shifts below ``shift_floor_m``, by default 1 mm, count as 0."""

METRICS: Final = (
    SHIFT,
    Quantity("max_tilt_deg", "Tilt", "largest tilt, °", 1.0, 0.01, "≤ 0.01"),
    Quantity("max_top_force_n", "Force on top", "largest force on top, N", 1.0, 1.0, "≤ 1"),
    Quantity("first_sign_s", "First sign", "first sign, s"),
)

SIZES: Final = (
    Quantity("n_boxes", "boxes", "boxes of the plan", counts=True),
    Quantity("height_m", "height", "height of the plan, m"),
    Quantity("mass_kg", "weight", "weight of the load, kg"),
)


def distributions(run: ReportRun) -> Markup:
    """Histograms of all metrics; then charts of the share of standing worlds, and of each metric, against the size of
    plans."""
    worlds = run.worlds
    if worlds.empty:
        return NOTHING
    if (worlds["verdict"] == Verdict.INVALID.value).all():
        return element("p", f"No {run.what} was simulated validly: there is nothing to draw.", class_="hint")
    limits = thresholds_of(run.info)
    sizes = [size for size in SIZES if size.of(worlds).nunique() > 1]
    alone = [
        _histogram(metric, worlds, limits, f"{run.what}s") for metric in METRICS if metric.of(worlds).notna().any()
    ]
    parts = [element("div", *alone, class_="charts")]
    if sizes:
        shares = [_share(size, worlds, one_each=not run.kind.sweeps) for size in sizes]
        metrics = [metric for metric in METRICS if metric.of(worlds).notna().sum() > 1]
        against = [_against(size, metric, worlds, limits) for metric in metrics for size in sizes]
        parts.append(element("h3", "Results against number of boxes, height and weight"))
        parts.append(element("div", *shares, class_="charts three"))
        charts_title = element("summary", f"Shift, tilt, force and first sign against size: {len(against)} charts")
        parts.append(element("details", charts_title, element("div", *against, class_="charts three")))
    if run.plan_files.note and len(sizes) < len(SIZES):
        parts.append(element("p", f"Without height and weight: {run.plan_files.note}.", class_="hint"))
    return joined_markup(*parts)


def _histogram(metric: Quantity, worlds: pd.DataFrame, limits: Thresholds, y_label: str) -> Markup:
    values = metric.of(worlds)
    frame = Frame(f"{metric.title}: histogram", metric.scale(values), Scale(0, 1), metric.label, y_label)
    histogram(frame, values, worlds["verdict"], ORDER, metric.limit(limits))
    _limit(frame, metric, limits)
    missing = int(values.isna().sum())
    note = f"{missing:,} of {len(values):,} {y_label} have no value." if missing else ""
    return figure(metric.title, frame.svg(), note)


def _limit(frame: Frame, metric: Quantity, limits: Thresholds, *, across: bool = False) -> None:
    value = metric.limit(limits)
    if value is not None:
        frame.limit(value, f"threshold {value:g}", across=across)


def _against(size: Quantity, metric: Quantity, worlds: pd.DataFrame, limits: Thresholds) -> Markup:
    x, y = size.of(worlds), metric.of(worlds)
    title = f"{metric.title} against {size.title}"
    frame = Frame(title, size.across(x), metric.scale(y), size.label, metric.label)
    n_points = int((x.notna() & y.notna()).sum())
    if n_points <= MOST_POINTS:
        points(frame, x, y, worlds["verdict"])
        note = ""
    else:
        quantile_bands(frame, x, y)
        note = "Line: median; bands: 25 to 75 % and 5 to 95 % of worlds."
    _limit(frame, metric, limits, across=True)
    return figure(title, frame.svg(), note)


def _share(size: Quantity, worlds: pd.DataFrame, one_each: bool) -> Markup:
    """A chart of the share of worlds that stand, against a size of plans (such as the number of boxes). Worlds are
    divided into groups with about equal numbers of worlds. If every plan has one world (``one_each``), shares have
    Wilson's interval."""
    judged = worlds[(worlds["verdict"] != Verdict.INVALID.value) & size.of(worlds).notna()]
    x = size.of(judged).to_numpy(np.float64)
    stands = (judged["verdict"] == Verdict.STABLE.value).to_numpy()
    groups = np.array(list(_grouped_values(x, stands))).reshape(-1, 4)
    title = f"Share that stands against {size.title}"
    frame = Frame(title, size.across(size.of(worlds)), Scale(0, 1), size.label, "stand", y_percent=True)
    middle, share, low, high = groups.T
    missing = np.full(len(groups), np.nan)
    share_curve(frame, middle, share, *((low, high) if one_each else (missing, missing)))
    return figure(
        title, frame.svg(), ("Band: Wilson 95 %; " if one_each else "") + "points: groups of about equally many worlds."
    )


def _grouped_values(x: np.ndarray, stands: np.ndarray) -> Iterator[tuple[float, float, float, float]]:
    for rows in equal_groups(x):
        low, high = wilson_interval(int(stands[rows].sum()), len(rows))
        yield float(np.median(x[rows])), float(stands[rows].mean()), float(low), float(high)


MOST_FAILING_ARTICLES: Final = 12


def first_boxes(run: ReportRun) -> Markup:
    """Charts about the boxes that were the first in their world to cross a threshold."""
    falls = run.worlds[run.worlds["culprit"].notna()]
    if falls.empty:
        unknown = (run.worlds["verdict"] == Verdict.INVALID.value).all()
        return NOTHING if unknown else element("p", "No box crossed a threshold.", class_="hint")
    place = 100 * falls["culprit"].astype("float64") / (falls["n_boxes"] - 1).clip(lower=1)
    along = Frame(
        "Place in the packing order of the box that fails first",
        Scale(0, 100),
        Scale(0, 1),
        "place in the packing order: 0 first box, 100 last box",
        f"{run.what}s",
    )
    histogram(along, place, falls["verdict"], ORDER)
    numbers = Scale(-0.5, float(falls["culprit"].max()) + 0.5, counts=True)
    title = "Number of the box that fails first"
    number = Frame(title, numbers, Scale(0, 1), "number in the packing order, from 0", f"{run.what}s")
    histogram(number, falls["culprit"].astype("float64"), falls["verdict"], ORDER)
    return joined_markup(
        element("p", f"In {count_text(len(falls), run.what)}, a box crossed a threshold."),
        element(
            "div",
            figure(
                "Articles that fail first",
                _articles(run, falls),
                "For each article: how many of its boxes failed first, out of all its boxes.",
            ),
            figure(along.title, along.svg()),
            figure(number.title, number.svg()),
            class_="charts",
        ),
    )


def _articles(run: ReportRun, falls: pd.DataFrame) -> Markup:
    """A chart with two counts for each article: the number of its boxes that fail first, and the number of all its
    boxes in the run. Articles with the most failures come first."""
    first = falls.loc[falls["first_article"] != "", "first_article"].value_counts()
    of_article: Counter[str] = Counter()
    worlds = run.worlds["plan_id"].value_counts()
    for plan_id, articles in run.articles(set(worlds.index)).items():
        for article in articles:
            of_article[article] += int(worlds[plan_id])
    rows = [
        Bar(
            str(article),
            float(count),
            f"{count:,} of {of_article[str(article)]:,}",
            "unstable",
            link(run, q=str(article)),
        )
        for article, count in first.head(MOST_FAILING_ARTICLES).items()
    ]
    return bars("Articles that fail first", rows, width=WIDTH, names=140)
