"""Figures of comparisons, with intervals. One figure compares packers: the share of each packer's plans that stand, and
the difference of this share for each pair of packers. The other figure compares criteria with simulations: precision,
recall and correlation of each criterion."""

from __future__ import annotations

from typing import Any, Final

from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.packer_comparison import ALL_SIZES, PackerComparison
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name, shortened_text
from petmjx.results.share_intervals import DEFAULT_CONFIDENCE
from petmjx.show.figures.figure_style import POINTS, WIDTH_IN, wrapped_sentences
from petmjx.show.pages.palette import OKABE_ITO

ROW_IN: Final = 0.26
"""Height of the row for a packer or for a pair of packers, inches."""

LINE_IN: Final = 0.155
"""Height of a line of text, inches."""

MOST_PAIRS: Final = 15
"""Largest number of pairs in a figure: the pairs of six packers."""

_COLOUR: Final = OKABE_ITO[4]


def draw_packers(comparison: PackerComparison) -> Any:
    """The figure, made with matplotlib: shares on the left, differences on the right, and a sentence about each pair of
    packers below.

    Raises:
        InputError: no order is compared, or there are too many packers.
    """
    from matplotlib.figure import Figure
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
    figure = Figure(figsize=(WIDTH_IN, chart_in + text_in), facecolor="white", layout=above)
    left, right = figure.subplots(1, 2)
    _intervals(left, [(printable_name(row["packer"]), row["share"], row["low"], row["high"]) for row in packers])
    left.set_xlabel(f"plans that stand, % of {count_text(int(packers[0]['n']), 'order')}")
    names = [f"{shortened_text(row['b'])} − {shortened_text(row['a'])}" for row in pairs]
    _intervals(right, [(n, r["difference"], r["low"], r["high"]) for n, r in zip(names, pairs, strict=True)])
    right.axvline(0, color="0.6", linewidth=0.8, zorder=0)
    right.set_xlabel("difference, percentage points")
    figure.suptitle(f"dots: shares and differences; lines: {100 * comparison.confidence:g} % intervals", size=POINTS)
    figure.text(0.01, 0.05 / (chart_in + text_in), sentences, size=POINTS, va="bottom")
    return figure


def _intervals(axes: Any, rows: list[tuple[str, float, float, float]]) -> None:
    """Draw a dot and an interval, in per cent, for each row (name, value, low end, high end)."""
    for place, (_, value, low, high) in enumerate(rows):
        axes.plot([100 * low, 100 * high], [place, place], color=_COLOUR, linewidth=1.4, solid_capstyle="butt")
        axes.plot(100 * value, place, "o", color=_COLOUR, markersize=4)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


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
    from matplotlib.figure import Figure

    if results.judged is None or not len(results.judged):
        raise InputError(f"no figure of these criteria: they were not compared with a run ({option('--run')})")
    judged = results.judged
    figure = Figure(figsize=(WIDTH_IN, CRITERION_IN * len(judged) + 1.0), facecolor="white", layout="constrained")
    for number, (axes, (name, label)) in enumerate(zip(figure.subplots(1, 3, sharey=True), PANELS, strict=True)):
        for place, row in enumerate(judged.to_dict("records")):
            axes.plot([row[f"{name}_low"], row[f"{name}_high"]], [place, place], color=_COLOUR, linewidth=1.4)
            axes.plot(row[name], place, "o", color=_COLOUR, markersize=3.5)
        axes.set_xlabel(label)
        axes.set_xlim(min(0.0, float(judged[f"{name}_low"].min()) - 0.02), 1.02)
        axes.grid(axis="x", color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.tick_params(axis="y", length=0)
        if not number:
            axes.set_yticks(range(len(judged)), judged["criterion"])
            axes.set_ylim(len(judged) - 0.4, -0.6)
    plans = count_text(int(judged["n_plans"].max()), "plan")
    figure.suptitle(f"{plans}; lines: {100 * DEFAULT_CONFIDENCE:g} % bootstrap intervals", size=POINTS)
    return figure
