"""Charts about the boxes that fail first: their articles, and their places in the packing order."""

from __future__ import annotations

from collections import Counter
from typing import Final

import pandas as pd

from petmjx.common.text import count_text
from petmjx.engines.verdict import Verdict
from petmjx.show.report.charts import Bar, bars, histogram
from petmjx.show.report.markup import NOTHING, Markup, element, joined_markup
from petmjx.show.report.report_runs import ReportRun
from petmjx.show.report.svg_charts import WIDTH, Frame, Scale, figure
from petmjx.show.report.verdict_shares import ORDER, link

MOST_FAILING_ARTICLES: Final = 12


def first_boxes(run: ReportRun) -> Markup:
    """Charts about the boxes that were the first in their world to cross a threshold."""
    falls = run.worlds[run.worlds["culprit"].notna()]
    if falls.empty:
        unknown = (run.worlds["verdict"] == Verdict.INVALID.value).all()
        return NOTHING if unknown else element("p", "No box crossed a threshold.", class_="hint")
    place = 100 * falls["culprit"].astype("float64") / (falls["n_boxes"] - 1).clip(lower=1)
    along = Frame(
        "Place in the packing order of the box that fails first", Scale(0, 100), Scale(0, 1), "", f"{run.what}s"
    )
    along.x_label = "place in the order: 0 first, 100 last box"
    histogram(along, place, falls["verdict"], ORDER)
    number = Frame(
        "Number of the box that fails first", Scale(0, 1), Scale(0, 1), "number in the order, from 0", f"{run.what}s"
    )
    number.x = Scale(-0.5, float(falls["culprit"].max()) + 0.5, counts=True)
    histogram(number, falls["culprit"].astype("float64"), falls["verdict"], ORDER)
    return joined_markup(
        element("p", f"In {count_text(len(falls), run.what)} a box crossed a threshold first."),
        element(
            "div",
            figure(
                "Articles that fail first",
                _articles(run, falls),
                "Of all boxes of that article: how many failed first.",
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
