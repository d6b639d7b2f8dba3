"""Figures of comparisons, with intervals. One figure compares packers: the share of each packer's plans that stand, and
the difference of this share for each pair of packers. A second figure compares criteria with simulations: precision,
recall and correlation of each criterion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.packer_comparison import ALL_SIZES, PackerComparison
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name, shortened_text
from petmjx.results.share_statistics import DEFAULT_CONFIDENCE
from petmjx.show.figures.figure_style import POINTS, WIDTH_IN, draw_intervals, new_figure, wrapped_sentences

ROW_IN: Final = 0.26
"""Height of the row for a packer or for a pair of packers, inches."""

LINE_IN: Final = 0.155
"""Height of a line of text, inches."""

MOST_PAIRS: Final = 15
"""Largest number of pairs in a figure: the pairs of six packers."""


def draw_packers(comparison: PackerComparison) -> Any:
    """The figure, made with matplotlib: shares on the left, differences on the right, and a sentence about each pair of
    packers below.

    Raises:
        InputError: no order is compared, or there are too many packers.
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    packers = comparison.packers[comparison.packers["size"] == ALL_SIZES].to_dict("records")
    pairs = comparison.pairs[comparison.pairs["size"] == ALL_SIZES].to_dict("records")
    if not comparison.sentences:
        raise InputError("no figure of these packers: no order has a valid verdict from every packer")
    if len(pairs) > MOST_PAIRS:
        raise InputError(f"no figure of {len(packers)} packers: six fit at most")
    sentences = wrapped_sentences(comparison.sentences)
    text_in = LINE_IN * (sentences.count("\n") + 1) + 0.1
    chart_in = ROW_IN * max(len(packers), len(pairs), 2) + 0.75
    above = ConstrainedLayoutEngine(rect=(0, text_in / (chart_in + text_in), 1, chart_in / (chart_in + text_in)))
    figure = new_figure(WIDTH_IN, chart_in + text_in, above)
    left, right = figure.subplots(1, 2)
    draw_intervals(left, [printable_name(row["packer"]) for row in packers], *_percent_of(packers, "share"))
    left.set_xlabel(f"plans that stand, % of {count_text(int(packers[0]['n']), 'order')}")
    names = [f"{shortened_text(row['b'])} − {shortened_text(row['a'])}" for row in pairs]
    draw_intervals(right, names, *_percent_of(pairs, "difference"))
    right.axvline(0, color="0.6", linewidth=0.8, zorder=0)
    right.set_xlabel("difference, percentage points")
    figure.suptitle(f"dots: shares and differences; lines: {100 * comparison.confidence:g} % intervals", size=POINTS)
    figure.text(0.01, 0.05 / (chart_in + text_in), sentences, size=POINTS, va="bottom")
    return figure


def _percent_of(rows: Sequence[Mapping[Any, Any]], value: str) -> list[list[float]]:
    """Three lists with one number per row, in per cent: the values in the column ``value``, the low ends of their
    intervals, and the high ends of their intervals."""
    return [[100 * row[name] for row in rows] for name in (value, "low", "high")]


CRITERION_IN: Final = 0.19
"""Height of the row for a criterion, inches."""

PANELS: Final = (
    ("precision", "precision"),
    ("recall", "recall"),
    ("mcc", "Matthews' correlation"),
)
"""(column of ``CriteriaResults.judged``, label of the panel) for each panel."""


def draw_criteria(results: CriteriaResults) -> Any:
    """The figure, made with matplotlib, with a row for each criterion.

    Raises:
        InputError: the criteria were not compared with a run.
    """
    if results.judged is None or not len(results.judged):
        raise InputError(f"no figure of these criteria: they were not compared with a run ({option('--run')})")
    judged = results.judged
    figure = new_figure(WIDTH_IN, CRITERION_IN * len(judged) + 1.0)
    for axes, (name, label) in zip(figure.subplots(1, 3, sharey=True), PANELS, strict=True):
        draw_intervals(axes, judged["criterion"], *(judged[column] for column in (name, f"{name}_low", f"{name}_high")))
        axes.set_xlabel(label)
        axes.set_xlim(min(0.0, float(judged[f"{name}_low"].min()) - 0.02), 1.02)
    plans = count_text(int(judged["n_plans"].max()), "plan")
    figure.suptitle(f"{plans}; lines: {100 * DEFAULT_CONFIDENCE:g} % bootstrap intervals", size=POINTS)
    return figure
