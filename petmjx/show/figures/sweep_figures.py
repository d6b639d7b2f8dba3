"""Figures of sweeps: the levels that plans survive, and shares of standing plans along an axis."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable, printable_name
from petmjx.results.run_reader import RunResults
from petmjx.results.share_statistics import ALL_PLANS, ONE_PLAN
from petmjx.runs.chain_summary import arrivals
from petmjx.show.figures.figure_style import COLOUR, POINTS, WIDTH_IN, draw_intervals, new_figure
from petmjx.show.pages.palette import category

PANEL_IN: Final = (3.1, 2.4)
"""Width and height of a panel, inches."""

MOST_LINES: Final = 12
"""Largest number of directions that a reader can distinguish in one panel."""

MOST_PANELS: Final = 8

MOST_PLANS: Final = 60
"""Largest number of plans in a figure with one row per plan."""

_DASHES: Final = ("-", (0, (4, 2)), (0, (1, 1.5)), (0, (4, 1.5, 1, 1.5)))

_AXES: Final = {
    "direction_deg": "direction, °",
    "level_g": "level, g",
    "scale": "scale",
    "friction_factor": "factor on friction",
    "mass_factor": "factor on masses",
    "placement_error_mm": "error of placement, mm",
    "yaw_error_deg": "error of yaw, °",
    "drop_height_mm": "height of release, mm",
}
"""Name of a column in a run's table ``summary`` → label of an axis of the figure. Other columns are labelled with their
names."""


def draw_answers(run: RunResults) -> Any:
    """The figure of a run's table ``summary``, made with matplotlib.

    For a search, there is a panel for each profile, with a line for each direction: the share of plans that survive
    each level. For another sweep, there is a panel for each axis with several values: the share of worlds that stand,
    with its interval. For a score with confidence, the figure shows the share of worlds in which each plan stands. For
    a chain, the figure shows the share of worlds in which each plan arrives.

    Raises:
        InputError: the run has no summary, or nothing in its summary can be drawn.
    """
    summary = run.summary
    if summary is None:
        raise InputError(
            f"{run.path}: this run has no figure; only sweeps, and scores with {option('--confidence')} or "
            f"{option('--chain')}, have one"
        )
    if "axis" in summary:
        return _shares(summary)
    if "profile" in summary:
        return _levels(summary)
    if "weakest_leg" in summary:
        return _plans(arrivals(summary), "arrive")
    return _plans(summary)


def survival_curve(levels: pd.Series[float]) -> tuple[Any, Any]:
    """A step curve of the share of plans that survive each level.

    Args:
        levels: the largest level that each plan survives. A missing value means that the plan survives no level, and
            counts as 0.

    Returns:
        (m,) levels, rising from 0, and (m,) share of plans whose largest level is at least as high.
    """
    survived = np.sort(levels.fillna(0.0).to_numpy(np.float64))
    at = np.unique(np.concatenate(([0.0], survived)))
    return at, 1.0 - np.searchsorted(survived, at, side="left") / len(survived)


def _levels(summary: pd.DataFrame) -> Any:
    (strength,) = (name for name in summary if str(name).startswith("largest_"))
    profiles = list(summary["profile"].unique())
    figure, panels = _panels(len(profiles))
    for axes, profile in zip(panels, profiles, strict=True):
        rows = summary[summary["profile"] == profile]
        directions = list(rows["direction_deg"].unique())
        for number, direction in enumerate(directions[:MOST_LINES]):
            at, share = survival_curve(rows.loc[rows["direction_deg"] == direction, strength])
            label = "" if pd.isna(direction) else f"{direction:g}°"
            # above the largest level that any plan survives, the curve falls to 0.
            # Lines have different dashes, so that two lines at the same place are both visible.
            look = {"color": category(number), "linestyle": _DASHES[number % len(_DASHES)]}
            axes.step([*at, at[-1]], [*(100 * share), 0.0], where="pre", label=label, **look)
        axes.set_xlabel(f"{'level, g' if strength.endswith('_g') else 'scale'}")
        axes.set_ylabel("plans that survive it, %")
        axes.set_ylim(0, 103)
        axes.set_xlim(left=0)
        shown_text = f" ({MOST_LINES} of {len(directions)})" if len(directions) > MOST_LINES else ""
        axes.set_title(f"{printable(str(profile))}, {count_text(rows['plan_id'].nunique(), 'plan')}")
        axes.legend(title=f"direction{shown_text}", frameon=False, title_fontsize=POINTS)
    return figure


def _shares(summary: pd.DataFrame) -> Any:
    overall = summary[(summary["scope"] == ALL_PLANS) & (summary["axis"] != "")]
    names = [name for name, rows in overall.groupby("axis", sort=False) if len(rows) > 1]
    if not names:
        rows = summary[(summary["scope"] == ONE_PLAN) & (summary["axis"] == "")]
        return _plans(rows)
    figure, panels = _panels(len(names))
    for axes, name in zip(panels, names, strict=True):
        rows = overall[overall["axis"] == name]
        numbers = pd.to_numeric(rows["value"], errors="coerce")
        numeric = bool(numbers.notna().all())
        places = numbers.to_numpy(np.float64) if numeric else np.arange(len(rows), dtype=np.float64)
        shares = 100 * rows[["share", "low", "high"]].to_numpy(np.float64)
        axes.vlines(places, shares[:, 1], shares[:, 2], color=COLOUR, linewidth=1.4)
        axes.plot(places, shares[:, 0], "o-" if numeric else "o", color=COLOUR, markersize=4, linewidth=0.8)
        if not numeric:
            texts = [printable(str(value)) for value in rows["value"]]
            axes.set_xticks(places, texts, rotation=30, ha="right")
        axes.set_xlabel(_AXES.get(str(name), str(name)))
        axes.set_ylabel("worlds that stand, %")
        axes.set_ylim(0, 103)
    return figure


def _plans(rows: pd.DataFrame, what: str = "stand") -> Any:
    """A figure with a row for each plan: the share of the plan's worlds that stand or arrive.

    Args:
        rows: a row per plan, with its share of worlds and the interval of the share.
        what: what the counted worlds do, as a verb in the label of the axis: "stand" or "arrive".
    """
    if not len(rows) or len(rows) > MOST_PLANS:
        raise InputError(f"no figure of {count_text(len(rows), 'plan')}: a figure has room for 1 to {MOST_PLANS}")
    figure = new_figure(WIDTH_IN, 0.2 * len(rows) + 0.7)
    axes = figure.subplots()
    shares = (100 * rows[name] for name in ("share", "low", "high"))
    draw_intervals(axes, [printable_name(name) for name in rows["plan_id"]], *shares)
    axes.set_xlim(-2, 102)
    axes.set_xlabel(f"worlds that {what}, %; lines: 95 % intervals")
    return figure


def _panels(count: int) -> tuple[Any, list[Any]]:
    """A figure and its ``count`` panels, two in each row."""
    if count > MOST_PANELS:
        raise InputError(f"no figure with {count} panels: {MOST_PANELS} fit at most")
    columns, rows = min(2, count), -(-count // 2)
    figure = new_figure(PANEL_IN[0] * columns, PANEL_IN[1] * rows)
    every = list(np.ravel(figure.subplots(rows, columns, squeeze=False)))
    for axes in every[count:]:
        axes.set_axis_off()
    return figure, every[:count]
