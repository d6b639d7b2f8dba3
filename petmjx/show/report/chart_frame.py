"""The frame of a small chart in SVG: scales, axes and ticks.

Colours are defined by classes in ``static/report.css``, so charts are light or dark like the page. Charts need no
script.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from petmjx.common.text import next_round_number
from petmjx.common.units import FloatArray
from petmjx.show.pages.markup import Content, Markup, element

WIDTH: Final = 300
HEIGHT: Final = 190
"""Width and height of a chart, CSS pixels. A wide screen shows four charts side by side, a phone shows one."""

LEFT: Final = 54
RIGHT: Final = 12
TOP: Final = 12
BOTTOM: Final = 40
"""Margins around the area in which data are drawn, CSS pixels."""

MOST_TICKS: Final = 6


@dataclass(frozen=True)
class Scale:
    """The scale of an axis, which converts values to pixels.

    Attributes:
        low, high: ends of the range of values. Values outside the range are drawn at its nearest end.
        log: whether the scale is logarithmic, which requires that ``low`` is above 0.
        lowest: label at the lower end, such as "≤ 1", if smaller values are also drawn there.
        counts: whether values are counts, that is, whole numbers.
    """

    low: float
    high: float
    log: bool = False
    lowest: str = ""
    counts: bool = False

    @classmethod
    def over(cls, values: ArrayLike, *, log_from: float | None = None, lowest: str = "", zero: bool = False) -> Scale:
        """A scale that contains all finite values.

        Args:
            log_from: lower end of a logarithmic scale. If ``log_from`` is None, the scale is linear.
            lowest: as in ``Scale``.
            zero: whether a linear scale begins at 0.
        """
        numbers = np.asarray(values, dtype=np.float64)
        finite = numbers[np.isfinite(numbers)]
        if log_from is not None:
            high = max(float(finite.max(initial=log_from)), log_from * 10)
            return cls(log_from, high, log=True, lowest=lowest)
        low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
        low = min(low, 0.0) if zero else low
        if high - low <= 0:
            low, high = (low - 0.5, high + 0.5) if not zero else (low, low + 1.0)
        return cls(low, high)

    def place(self, values: ArrayLike) -> FloatArray:
        """The position of each value on the scale: 0 at ``low``, 1 at ``high``."""
        clipped = np.clip(np.asarray(values, dtype=np.float64), self.low, self.high)
        if self.log:
            return np.asarray(np.log(clipped / self.low) / math.log(self.high / self.low))
        return np.asarray((clipped - self.low) / (self.high - self.low))

    def edges(self, bins: int) -> FloatArray:
        """(bins + 1,) edges of the bins of a histogram. All bins appear equally wide.

        For counts, each bin contains the same number of whole numbers, so there may be fewer bins. A scale of counts
        begins half a unit below a whole number, so that no whole number is on an edge. The last bin may extend beyond
        the scale.
        """
        if self.counts:
            wide = math.ceil((self.high - self.low) / bins)
            return self.low + wide * np.arange(math.ceil((self.high - self.low) / wide) + 1.0)
        if self.log:
            return np.geomspace(self.low, self.high, bins + 1)
        return np.linspace(self.low, self.high, bins + 1)

    def ticks(self) -> list[tuple[float, str]]:
        """(value, label) of each tick. Ticks are at round values. There are at most about ``MOST_TICKS`` ticks."""
        if not self.log:
            step = max(next_round_number((self.high - self.low) / (MOST_TICKS - 1)), 1.0 if self.counts else 0.0)
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            return [(at * step, _label(at * step, step)) for at in range(first, last + 1)]
        decades = range(math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9) + 1)
        thin = max(1, math.ceil(len(decades) / MOST_TICKS))
        ticks = [(10.0**power, f"{10.0**power:g}") for power in decades if power % thin == 0]
        if self.lowest:
            apart = math.log10(self.high / self.low) / 12
            ticks = [(value, text) for value, text in ticks if math.log10(value / self.low) > apart]
            ticks.insert(0, (self.low, self.lowest))
        return ticks


def _label(value: float, step: float) -> str:
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    if abs(value) >= 1e5:
        return f"{value / 1e3:,.0f}k" if abs(value) < 1e8 else f"{value:.2g}"
    return f"{value:,.{decimals}f}"


@dataclass
class Frame:
    """A chart that is being built: two axes, and marks (lines, points and so on) between them.

    Attributes:
        title: title of the chart, which screen readers also read.
        x, y: scales of the axes.
        x_label, y_label: labels of the axes, with units.
        x_ticks: (value, label) of each tick of the x axis. If ``x_ticks`` is None, the ticks come from the scale.
        y_percent: whether the labels of the y axis are in per cent.
        width, height: size of the chart, CSS pixels.
        marks: the marks drawn so far.
    """

    title: str
    x: Scale
    y: Scale
    x_label: str
    y_label: str
    x_ticks: Sequence[tuple[float, str]] | None = None
    y_percent: bool = False
    width: int = WIDTH
    height: int = HEIGHT
    marks: list[Content] = field(default_factory=list)

    def at(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """The positions of values in the chart, pixels to the right and downwards."""
        return (
            LEFT + self.x.place(x) * (self.width - LEFT - RIGHT),
            self.height - BOTTOM - self.y.place(y) * (self.height - TOP - BOTTOM),
        )

    def add(self, *marks: Content) -> None:
        """Draw marks in front of the earlier marks."""
        self.marks += marks

    def line(self, x: ArrayLike, y: ArrayLike, class_: str) -> None:
        """Draw a line through points. The line is interrupted where a value is missing."""
        self.add(element("path", d=path(*self.at(x, y)), class_=class_))

    def band(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, class_: str) -> None:
        """Draw the area between two lines. Points with a missing value are left out."""
        xs, lows, highs = (np.asarray(values, dtype=np.float64) for values in (x, low, high))
        has_ends = np.isfinite(lows) & np.isfinite(highs)
        if not has_ends.any():
            return
        px, below = self.at(xs[has_ends], lows[has_ends])
        _, above = self.at(xs[has_ends], highs[has_ends])
        outline = path(np.concatenate([px, px[::-1]]), np.concatenate([below, above[::-1]])) + "Z"
        self.add(element("path", d=outline, class_=class_))

    def limit(self, value: float, text: str, *, across: bool = False) -> None:
        """Draw a dashed line at a threshold. The line is vertical if the threshold is a value of x, and horizontal if
        it is a value of y (``across``)."""
        scale = self.y if across else self.x
        if not scale.low <= value <= scale.high:
            return
        (px,), (py,) = (np.atleast_1d(coordinate) for coordinate in self.at(value, value))
        ends = (LEFT, py, self.width - RIGHT, py) if across else (px, TOP, px, self.height - BOTTOM)
        names = ("x1", "y1", "x2", "y2")
        self.add(element("line", **dict(zip(names, map(float, ends), strict=True)), class_="limit"))
        x, y, anchor = (self.width - RIGHT - 2, py - 3, "end") if across else (px + 3, TOP + 8, "start")
        if not across and px > self.width - 90:
            x, anchor = px - 3, "end"
        self.add(element("text", text, x=float(x), y=float(y), text_anchor=anchor, class_="hint"))

    def svg(self) -> Markup:
        """The chart as SVG."""
        return drawing(self.title, self.width, self.height, *self._axes(), *self.marks)

    def _axes(self) -> Iterable[Markup]:
        bottom, right = self.height - BOTTOM, self.width - RIGHT
        for value, label in self.x_ticks if self.x_ticks is not None else self.x.ticks():
            px = float(self.at(value, self.y.low)[0])
            yield element("line", x1=px, y1=bottom, x2=px, y2=bottom + 4, class_="tick")
            yield element("text", label, x=px, y=bottom + 15, text_anchor="middle")
        for value, label in self.y.ticks():
            py = float(self.at(self.x.low, value)[1])
            text = f"{value:.0%}".replace("%", " %") if self.y_percent else label
            yield element("line", x1=LEFT, y1=py, x2=right, y2=py, class_="grid")
            yield element("text", text, x=LEFT - 5, y=py + 3.5, text_anchor="end")
        yield element("line", x1=LEFT, y1=bottom, x2=right, y2=bottom, class_="axis")
        yield element(
            "text", self.x_label, x=(LEFT + right) / 2, y=self.height - 8, text_anchor="middle", class_="label"
        )
        middle = (TOP + bottom) / 2
        yield element(
            "text",
            self.y_label,
            x=0,
            y=0,
            transform=f"translate(9 {middle:g}) rotate(-90)",
            text_anchor="middle",
            class_="label",
        )


def path(x: FloatArray, y: FloatArray) -> str:
    """The attribute ``d`` of an SVG path through points, pixels. The path is interrupted where a point is not
    finite."""
    written, pen = [], "M"
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if not (math.isfinite(px) and math.isfinite(py)):
            pen = "M"
            continue
        written.append(f"{pen}{px:.1f} {py:.1f}")
        pen = "L"
    return "".join(written)


def drawing(title: str, width: float, height: float, *marks: Content) -> Markup:
    """An SVG picture with the given marks. The picture becomes smaller if the page is narrow."""
    return element(
        "svg",
        *marks,
        viewBox=f"0 0 {width:g} {height:g}",
        width=f"{width:g}",
        height=f"{height:g}",
        role="img",
        aria_label=title,
    )


def figure(title: str, picture: Markup, note: str = "") -> Markup:
    """A chart with a title above and a line of text below."""
    below = element("p", note, class_="hint") if note else None
    return element("figure", element("figcaption", title), picture, below)
