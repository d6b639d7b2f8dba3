"""The numbers and shares of verdicts and reasons, and links to the table of plans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final
from urllib.parse import urlencode

import pandas as pd

from petmjx.common.text import count_text, printable
from petmjx.engines.verdict import Verdict
from petmjx.results.share_statistics import wilson_interval
from petmjx.show.pages.markup import Content, Markup, element, joined_markup, table
from petmjx.show.report.charts import interval_text, percent
from petmjx.show.report.report_runs import Kind, ReportRun

ORDER: Final = [verdict.value for verdict in Verdict]

_DRAWN: Final = "95 %: Wilson’s interval of the share, if the plans are a random sample."
_NOTES: Final = {
    Kind.SCORE: _DRAWN,
    Kind.CONFIDENCE: _DRAWN + " Verdicts are from worlds without errors.",
    Kind.GRID: "Worlds of one plan depend on each other, so their shares have no interval.",
    Kind.CHAIN: "These are the worlds with errors and without remedies. Worlds of one plan depend on each other, so "
    "their shares have no interval.",
    Kind.SEARCH: "Each world is a tested level: the shares show where the search looked, not how often pallets stand.",
}


def link(run: ReportRun, **filters: str) -> str:
    """The fragment (the part of the address after #) with which the table of plans shows only some rows of a run."""
    return urlencode({"run": run.name, **{name: printable(value) for name, value in filters.items()}})


def plan_link(run: ReportRun, plan_id: str, variant: int = 0) -> str:
    """The fragment (the part of the address after #) with which the page shows a plan."""
    return urlencode({"plan": printable(plan_id), "variant": variant, "of": run.name})


def verdict_table(run: ReportRun) -> Markup:
    """A table of the numbers and shares of verdicts and reasons. For scores, the shares have Wilson's interval, which
    assumes that plans are a random sample."""
    worlds = run.worlds
    drawn = run.kind in (Kind.SCORE, Kind.CONFIDENCE)
    rows = []
    for verdict in ORDER:
        chosen = worlds[worlds["verdict"] == verdict]
        rows.append(_row(run, verdict, len(chosen), {"verdict": verdict}, drawn, class_=f"mark {verdict}"))
        for reason, count in chosen.loc[chosen["reason"] != "", "reason"].value_counts().items():
            rows.append(_row(run, str(reason), int(count), {"verdict": verdict, "reason": str(reason)}, drawn, "inner"))
    head = ["", run.what + "s", "share", *(["95 %"] if drawn else [])]
    return joined_markup(
        table(head, rows, caption=f"Verdicts of {count_text(len(worlds), run.what)}", class_="verdicts"),
        element("p", _NOTES[run.kind], class_="hint"),
    )


def _row(run: ReportRun, name: str, count: int, filters: dict[str, str], drawn: bool, class_: str) -> list[Content]:
    n = len(run.worlds)
    name_link = element("a", name, href=f"#{link(run, **filters)}", class_=class_)
    cells: list[Content] = [name_link, f"{count:,}", percent(count / n) if n else "–"]
    if drawn:
        low, high = (float(bound) for bound in wilson_interval(count, n))
        cells.append(interval_text(low, high) if n else "–")
    return cells


def headline(run: ReportRun) -> Markup:
    """The most important numbers of a run, in large type."""
    worlds, summary = run.worlds, run.results.summary
    if run.kind is Kind.SEARCH and summary is not None and len(summary):
        return element("div", *_of_search(summary), class_="cards")
    counts = worlds["verdict"].value_counts()
    cards = [_card(f"{len(worlds):,}", run.what + "s" if len(worlds) != 1 else run.what)]
    for verdict in ORDER:
        count = int(counts.get(verdict, 0))
        share = percent(count / len(worlds)) if len(worlds) else "–"
        cards.append(_card(share, f"{verdict} ({count:,})", verdict))
    middle = worlds["n_boxes"].median() if len(worlds) else float("nan")
    if not pd.isna(middle):
        cards.append(_card(f"{middle:g}", "boxes in the median plan"))
    return element("div", *cards, class_="cards")


def _of_search(summary: pd.DataFrame) -> Iterator[Markup]:
    """The most important numbers of a search: number of placements, share of placements that stand at rest, number of
    searches on placements that stand, and median of the largest level survived."""
    placements = summary.drop_duplicates(["plan_id", "placement"])
    stand = placements["stands_at_rest"].astype(bool)
    answers = summary[summary["stands_at_rest"].astype(bool)]
    yield _card(f"{len(placements):,}", "placements")
    yield _card(percent(float(stand.mean())), f"stand at rest ({int(stand.sum()):,})", Verdict.STABLE.value)
    yield _card(f"{len(answers):,}", "searches on placements that stand")
    for column, name in (("largest_level_g", "g: median largest level"), ("largest_scale", "median largest scale")):
        if column in summary and len(answers):
            yield _card(f"{answers[column].fillna(0.0).median():.3g}", name)


def _card(number: str, label: str, class_: str = "") -> Markup:
    return element("div", element("b", number), element("span", label), class_=f"card {class_}".strip())
