"""A figure that compares criteria with simulations: precision, recall and correlation of each criterion, with
intervals."""

from __future__ import annotations

from typing import Any, Final

from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.results.share_intervals import DEFAULT_CONFIDENCE
from petmjx.show.figures.figure_style import POINTS, WIDTH_IN
from petmjx.show.pages.palette import OKABE_ITO

ROW_IN: Final = 0.19

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
    figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(judged) + 1.0), facecolor="white", layout="constrained")
    for number, (axes, (name, label)) in enumerate(zip(figure.subplots(1, 3, sharey=True), PANELS, strict=True)):
        for place, row in enumerate(judged.to_dict("records")):
            colour = OKABE_ITO[4]
            axes.plot([row[f"{name}_low"], row[f"{name}_high"]], [place, place], color=colour, linewidth=1.4)
            axes.plot(row[name], place, "o", color=colour, markersize=3.5)
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
