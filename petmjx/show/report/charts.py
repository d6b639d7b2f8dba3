"""Functions that draw each kind of chart in a report: histograms, curves, bars and so on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.common.text import three_digits
from petmjx.common.units import FloatArray
from petmjx.show.pages.markup import Content, Markup, element
from petmjx.show.report.chart_frame import WIDTH, Frame, Scale, drawing

BINS: Final = 24
"""Number of bins of a histogram. With 24 bins, bars are 12 pixels wide."""

GROUPS: Final = 8
FEWEST: Final = 12
"""Along an axis, worlds are divided into at most ``GROUPS`` groups of about equal size, with at least ``FEWEST`` worlds
in each group."""

MOST_POINTS: Final = 400
"""Largest number of worlds that are drawn as points. If there are more worlds, quantiles are drawn."""

QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)

ROW_HEIGHT: Final = 24
TALL_ROW: Final = 42
"""Height of a row with the name above the drawing, pixels."""

MOST_LETTERS: Final = 28
LETTER: Final = 6
"""Width of a letter, pixels, rounded up."""


def percent(share: float) -> str:
    """A share as text: "97.3 %"."""
    return "–" if math.isnan(share) else f"{100 * share:.1f} %"


def interval_text(low: float, high: float) -> str:
    """An interval of shares as text: "25.6 to 61.1 %"."""
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def _span(low: float, high: float, counts: bool) -> str:
    """The range of a histogram's bin as text, such as "0.5 to 1", or for counts "3" or "3 to 5"."""
    if not counts:
        return f"{three_digits(low)} to {three_digits(high)}"
    first, last = math.ceil(low), math.floor(high)
    return f"{first:,}" if first == last else f"{first:,} to {last:,}"


def histogram(
    frame: Frame, values: pd.Series, classes: pd.Series, order: Sequence[str], threshold: float | None = None
) -> None:
    """Draw a histogram of values into a frame, and set the frame's y scale. In each bar, the parts for different
    classes of worlds are stacked.

    Args:
        classes: class of each world, such as its verdict. The style sheet gives each class a colour.
        order: the classes, from the lowest part of a bar upwards.
        threshold: a value that must be the edge between two bins; None if no value must be an edge.
    """
    edges = frame.x.edges(BINS)
    if threshold is not None and edges[0] < threshold < edges[-1] and len(edges) > 2:
        # move an edge between bins to the threshold, so that no bar contains values on both sides of the threshold
        edges[1 + int(np.abs(edges[1:-1] - threshold).argmin())] = threshold
    has_value = values.notna()
    clipped = np.clip(values[has_value].to_numpy(np.float64), frame.x.low, frame.x.high)
    counts = {
        name: np.histogram(clipped[(classes[has_value] == name).to_numpy()], edges)[0]
        for name in order
        if (classes[has_value] == name).any()
    }
    highest = max(float(np.sum(list(counts.values()), axis=0).max(initial=0.0)), 1.0)
    frame.y = Scale(0.0, 1.05 * highest, counts=True)
    below: FloatArray = np.zeros(len(edges) - 1)
    for name, count in counts.items():
        for at in np.flatnonzero(count):
            (left, right), (low, high) = frame.at(edges[at : at + 2], [below[at], below[at] + count[at]])
            span = _span(float(edges[at]), float(edges[at + 1]), frame.x.counts)
            frame.add(
                element(
                    "rect",
                    element("title", f"{span}: {count[at]:,} {name}"),
                    x=float(left) + 0.5,
                    y=float(high),
                    width=float(right - left) - 1,
                    height=float(low - high),
                    class_=f"fill {name}",
                )
            )
        below = below + count


def points(frame: Frame, x: pd.Series, y: pd.Series, classes: pd.Series) -> None:
    """Draw a point for each world into a frame."""
    has_values = (x.notna() & y.notna()).to_numpy()
    px, py = frame.at(x[has_values].to_numpy(np.float64), y[has_values].to_numpy(np.float64))
    for at_x, at_y, name in zip(px.tolist(), py.tolist(), classes[has_values], strict=True):
        frame.add(element("circle", cx=at_x, cy=at_y, r=2.5, class_=f"point {name}"))


def quantile_bands(frame: Frame, x: pd.Series, y: pd.Series) -> None:
    """Draw quantiles of y along x into a frame: the median as a line, a band with half of the worlds, and a band with
    nine tenths of the worlds."""
    has_values = x.notna() & y.notna()
    groups = equal_groups(x[has_values].to_numpy(np.float64))
    values = y[has_values].to_numpy(np.float64)
    middle = np.array([np.median(x[has_values].to_numpy(np.float64)[rows]) for rows in groups])
    levels = np.array([np.quantile(values[rows], QUANTILES) for rows in groups]).reshape(-1, len(QUANTILES)).T
    frame.band(middle, levels[0], levels[4], "band outer")
    frame.band(middle, levels[1], levels[3], "band inner")
    frame.line(middle, levels[2], "curve")


def equal_groups(x: FloatArray) -> list[NDArray[np.int64]]:
    """Indices of the values ``x``, sorted by value and divided into up to ``GROUPS`` groups of about equal size. Equal
    values are always in the same group."""
    if not len(x):
        return []
    order = np.argsort(x, kind="stable")
    n = max(1, min(GROUPS, len(x) // FEWEST))
    cuts = [np.searchsorted(x[order], x[order][len(x) * part // n], side="left") for part in range(1, n)]
    return [rows for rows in np.split(order, np.unique(cuts).astype(np.int64)) if len(rows)]


def share_curve(frame: Frame, x: FloatArray, share: FloatArray, low: FloatArray, high: FloatArray) -> None:
    """Draw shares and their intervals along an axis into a frame. Shares and intervals that are NaN are not drawn."""
    frame.band(x, low, high, "band inner")
    frame.line(x, share, "curve")
    px, py = frame.at(x, share)
    for at in np.flatnonzero(np.isfinite(share)):
        interval = "" if math.isnan(low[at]) else f", 95 %: {interval_text(low[at], high[at])}"
        title = element("title", f"{x[at]:g}: {percent(share[at])}{interval}")
        frame.add(element("circle", title, cx=float(px[at]), cy=float(py[at]), r=3, class_="dot"))


@dataclass(frozen=True)
class Bar:
    """A row of a bar chart.

    Attributes:
        name: name to the left of the bar.
        length: length of the bar, in any unit. NaN counts as 0.
        text: text to the right of the bar.
        class_: class of the style sheet that gives the bar its colour.
        link: part of the page's address after #, with which a click on the bar filters the table of plans. If ``link``
            is None, a click has no effect.
    """

    name: str
    length: float
    text: str
    class_: str = "plain"
    link: str | None = None


def bars(title: str, rows: Sequence[Bar], *, width: int = WIDTH, names: int = 130) -> Markup:
    """A bar chart with the name of each bar on its left. A long name is shortened; the whole name appears when the
    mouse is over the bar.

    Args:
        width: width of the chart, pixels.
        names: largest width of the names, pixels.
    """
    lengths = [float(np.nan_to_num(row.length)) for row in rows]
    longest = max(lengths, default=0.0) or 1.0
    letters = min(names // LETTER, max((len(row.name) for row in rows), default=0))
    names = letters * LETTER + 10
    room = width - names - LETTER * max((len(row.text) for row in rows), default=0) - 14
    marks: list[Content] = []
    for at, (row, length) in enumerate(zip(rows, lengths, strict=True)):
        y, long = at * ROW_HEIGHT, room * length / longest
        drawn = (
            element("title", f"{row.name}: {row.text}"),
            element("rect", x=0, y=y, width=width, height=ROW_HEIGHT, class_="hit"),
            element("text", _shortened(row.name, letters), x=names - 6, y=y + 16, text_anchor="end"),
            element("rect", x=names, y=y + 5, width=long, height=14, class_=f"fill {row.class_}"),
            element("text", row.text, x=names + long + 5, y=y + 16),
        )
        marks.append(element("a", *drawn, href=f"#{row.link}") if row.link else element("g", *drawn))
    return drawing(title, width, max(1, len(rows)) * ROW_HEIGHT + 4, *marks)


def intervals(title: str, rows: Sequence[tuple[str, float, float, float, str]]) -> Markup:
    """A chart of shares between 0 and 100 %, with a dot and an interval in each row.

    A row is given as (name, share, low end of the interval, high end of the interval, text). The name and the text are
    above the dot.
    """
    left, right = 12.0, WIDTH - 16.0
    height = len(rows) * TALL_ROW + 22
    marks: list[Content] = []
    for value in (0.0, 0.25, 0.5, 0.75, 1.0):
        px = left + (right - left) * value
        marks.append(element("line", x1=px, y1=4, x2=px, y2=height - 16, class_="grid"))
        marks.append(element("text", f"{100 * value:.0f} %", x=px, y=height - 4, text_anchor="middle"))
    for at, (name, share, low, high, text) in enumerate(rows):
        y = at * TALL_ROW
        marks.append(_row_name(name, y + 13))
        marks.append(element("text", text, x=WIDTH, y=y + 13, text_anchor="end", class_="halo"))
        if math.isnan(share):
            continue
        ends = [left + (right - left) * value for value in (low, share, high)]
        marks.append(element("line", x1=ends[0], y1=y + 25, x2=ends[2], y2=y + 25, class_="whisker"))
        marks.append(element("circle", element("title", text), cx=ends[1], cy=y + 25, r=4.5, class_="dot"))
    return drawing(title, WIDTH, height, *marks)


def stacked_bars(title: str, rows: Sequence[tuple[str, Sequence[tuple[str, int, str]]]]) -> Markup:
    """A chart with a bar of several parts in each row. All bars have the same length.

    A row is given as (name, parts), and a part as (class of the style sheet, count, meaning). The name is above the
    bar.
    """
    marks: list[Content] = []
    for at, (name, parts) in enumerate(rows):
        y = at * TALL_ROW
        marks.append(_row_name(name, y + 13))
        total = sum(count for _, count, _ in parts) or 1
        left = 0.0
        for class_, count, meaning in parts:
            if not count:
                continue
            wide = WIDTH * count / total
            label = f"{count:,}"
            inside = element("text", label, x=left + wide / 2, y=y + 31, text_anchor="middle", class_="on")
            rect = element("rect", x=left, y=y + 18, width=max(wide - 1, 0.5), height=18, class_=f"fill {class_}")
            fits = wide > (LETTER + 2) * len(label)
            marks.append(element("g", element("title", f"{label} {meaning}"), rect, inside if fits else None))
            left += wide
    return drawing(title, WIDTH, len(rows) * TALL_ROW + 4, *marks)


def _row_name(name: str, y: float) -> Markup:
    """The name of a row. A long name is shortened; the whole name appears when the mouse is over the name."""
    return element("text", element("title", name), _shortened(name, MOST_LETTERS), x=0, y=y, class_="halo")


def _shortened(name: str, letters: int) -> str:
    return name if len(name) <= letters else name[: letters - 1] + "…"


ROSE: Final = 300
"""Width and height of a rose (a chart of values by direction), pixels."""

ROSE_RINGS: Final = 4


def rose(title: str, directions_deg: FloatArray, quantiles: Mapping[str, FloatArray], top: float, unit: str) -> Markup:
    """A chart of values by direction: 0° is to the right and 90° up, like x and y of the carrier.

    Args:
        directions_deg: (d,) directions, rising.
        quantiles: (d,) values under each of the names ``low``, ``middle`` and ``high``. Missing values are drawn at 0.
        top: the value at the outer ring.
        unit: unit of the values.
    """
    centre, reach = ROSE / 2, ROSE / 2 - 34
    rings = [reach * ring / ROSE_RINGS for ring in range(1, ROSE_RINGS + 1)]

    def place(radius: float, angle_deg: float) -> tuple[float, float]:
        angle = math.radians(angle_deg)
        return centre + radius * math.cos(angle), centre - radius * math.sin(angle)

    def radii(values: FloatArray) -> list[float]:
        scaled: list[float] = (reach * np.clip(np.nan_to_num(values) / top, 0, 1)).tolist()
        return scaled

    def outline(values: FloatArray) -> str:
        corners = map(place, radii(values), directions_deg.tolist())
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in corners) + "Z"

    marks: list[Content] = [element("circle", cx=centre, cy=centre, r=radius, class_="ring") for radius in rings]
    for angle in directions_deg.tolist():
        x, y = place(reach, angle)
        marks.append(element("line", x1=centre, y1=centre, x2=x, y2=y, class_="grid"))
        x, y = place(reach + 17, angle)[0], place(reach + 13, angle)[1] + 4
        marks.append(element("text", f"{angle:g}°", x=x, y=y, text_anchor="middle"))
    between = outline(quantiles["high"]) + outline(quantiles["low"])
    marks.append(element("path", d=between, class_="band inner", fill_rule="evenodd"))
    marks.append(element("path", d=outline(quantiles["middle"]), class_="curve"))
    medians = np.nan_to_num(quantiles["middle"])
    for angle, value, radius in zip(directions_deg.tolist(), medians.tolist(), radii(medians), strict=True):
        tooltip = element("title", f"{angle:g}°: median {three_digits(value)} {unit}")
        x, y = place(radius, angle)
        marks.append(element("circle", tooltip, cx=x, cy=y, r=4, class_="dot"))
    for number, radius in enumerate(rings, start=1):
        label = f"{three_digits(top * number / ROSE_RINGS)} {unit if number == ROSE_RINGS else ''}".strip()
        x, y = place(radius, 22.5)
        marks.append(element("text", label, x=x, y=y, text_anchor="middle", class_="halo"))
    return drawing(title, ROSE, ROSE, *marks)
