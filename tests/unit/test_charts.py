"""Tests of the ticks, scales and bars of charts, which are SVG pictures without scripts."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from petmjx.show.pages.markup import element
from petmjx.show.report.chart_frame import Frame, Scale, path
from petmjx.show.report.charts import bars, equal_groups, histogram
from petmjx.show.report.distributions import SHIFT


@pytest.mark.parametrize(
    ("scale", "ticks"),
    [
        (Scale(0.0, 10.0), ["0", "2", "4", "6", "8", "10"]),
        (Scale(0.0, 1.0, counts=True), ["0", "1"]),
        (Scale(0.0, 0.05), ["0.00", "0.01", "0.02", "0.03", "0.04", "0.05"]),
        (Scale(0.5, 2000.0, log=True, lowest="< 1"), ["< 1", "1", "10", "100", "1000"]),
    ],
)
def test_ticks_are_round(scale: Scale, ticks: list[str]) -> None:
    assert [label for _, label in scale.ticks()] == ticks
    assert all(0 <= share <= 1 for share in scale.place([value for value, _ in scale.ticks()]))


@pytest.mark.parametrize("values", [[], [math.nan], [3.0], [0.0, 0.0], [1e-9, 1e9], [-1.0, math.inf]])
def test_scales_hold_any_values(values: list[float]) -> None:
    for scale in (Scale.over(values), Scale.over(values, zero=True), Scale.over(values, log_from=0.1)):
        assert scale.low < scale.high
        assert 1 <= len(scale.ticks()) < 12
        assert np.all(np.diff(scale.edges(5)) > 0)


def test_histograms_count_every_world_once() -> None:
    values = pd.Series([0.0, 1e-9, 0.5, 3.0, 20.0, 1e5, math.nan])
    classes = pd.Series(["stable"] * 4 + ["unstable"] * 3)
    frame = Frame("t", SHIFT.scale(values), Scale(0, 1), "x", "y")
    histogram(frame, values, classes, ["stable", "unstable", "invalid"])
    counts = re.findall(r": (\d+) (\w+)</title>", "".join(map(str, frame.marks)))
    assert sum(int(count) for count, name in counts if name == "stable") == 4
    assert sum(int(count) for count, name in counts if name == "unstable") == 2


@pytest.mark.parametrize(("highest", "spans"), [(0, ["0"]), (2, ["0", "2"]), (59, ["0 to 2", "57 to 59"])])
def test_counts_have_bars_of_their_own(highest: int, spans: list[str]) -> None:
    frame = Frame("t", Scale(-0.5, highest + 0.5, counts=True), Scale(0, 1), "x", "y")
    values = pd.Series([0.0, float(highest)])
    histogram(frame, values, pd.Series(["unstable"] * 2), ["unstable"])
    drawn = "".join(map(str, frame.marks))
    assert re.findall(r"<title>(.*?): \d+ unstable</title>", drawn) == spans
    assert sum(int(count) for count in re.findall(r": (\d+) unstable<", drawn)) == 2
    assert all(float(label) == int(label) for _, label in frame.x.ticks())


def test_groups_are_about_equal_and_tear_no_ties_apart() -> None:
    x = np.array([1.0] * 50 + [2.0] * 10 + [3.0] * 40)
    groups = equal_groups(x)
    assert sum(len(rows) for rows in groups) == 100
    assert all(len(set(x[rows])) == 1 for rows in groups)
    assert [len(rows) for rows in equal_groups(np.arange(96.0))] == [12] * 8
    assert equal_groups(np.array([])) == []


def test_marks_are_drawn_as_they_are_meant() -> None:
    assert path(np.array([1.0, math.nan, 2.0, 3.0]), np.array([1.0, 1.0, 2.0, 3.0])) == "M1.0 1.0M2.0 2.0L3.0 3.0"
    assert element("a", "<b>", None, href='"x"', class_="y", title=None) == (
        '<a href="&quot;x&quot;" class="y">&lt;b&gt;</a>'
    )
    assert ElementTree.fromstring(bars("none", [])).tag == "svg"
