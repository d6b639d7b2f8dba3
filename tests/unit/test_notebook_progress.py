"""What a notebook shows of a run: progress, tables, and pages."""

from __future__ import annotations

import html
import re
from collections.abc import Callable

import pandas as pd

import petmjx
from petmjx.results.notebook_tables import MOST_ROWS, worlds_as_html
from petmjx.runs.notebook_progress import NotebookBar, notebook_bar


def cells(text: str) -> list[list[str]]:
    """The texts of the cells of an HTML table, row by row, without the heading row."""
    return [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", text)[1:]]


def test_a_run_shows_itself_as_a_table() -> None:
    sizes, masses = [[600, 400, 250], [400, 300, 200]], [12, 5]
    plans = [
        petmjx.Plan.from_boxes(name, size_mm=sizes, corner_mm=[[0, 0, 0], [x, 50, 250]], mass_kg=masses)
        for name, x in (("careful", 100), ("daring", 420))
    ]
    run = petmjx.score(plans, engine="mujoco")
    shown = run._repr_html_()
    assert repr(run) in shown
    rows = cells(shown)
    assert [row[0] for row in rows] == list(run.worlds["plan_id"])
    assert [row[2] for row in rows] == list(run.worlds["verdict"])
    falls = run.worlds.query("verdict == 'unstable'").iloc[0]
    (row,) = (row for row in rows if row[0] == falls["plan_id"])
    assert row[4:6] == [f"{falls['margin']:.2f}", str(falls["culprit"])]
    assert row[7] == f"{1000 * falls['max_shift_m']:,.1f}"
    assert "variant" not in shown


def test_a_large_run_is_short_and_its_names_are_harmless() -> None:
    names = ["<script>alert(1)</script>", *(f"plan {number}" for number in range(9_999))]
    worlds = pd.DataFrame({"plan_id": names, "variant": 1, "verdict": "stable", "margin": -0.0, "culprit": None})
    shown = worlds_as_html("a run", worlds)
    rows = cells(shown)
    assert len(rows) == MOST_ROWS
    assert rows[0] == ["&lt;script&gt;alert(1)&lt;/script&gt;", "1", "stable", "0.00", ""]
    assert "9,980 rows more" in shown
    assert len(shown) < 5_000


def test_a_story_shows_itself_as_a_page_and_prints_one_line() -> None:
    story = petmjx.tell("hand-overhang-55", engine="mujoco")
    assert repr(story).startswith("Story(hand-overhang-55: unstable by drop; History(")
    assert len(repr(story)) < 200
    assert len(repr(story.history)) < 100
    assert len(repr(story.outcome)) < 2_000
    shown = story._repr_html_()
    assert shown is not None
    (page,) = re.findall(r'srcdoc="([^"]*)"', shown)
    assert html.unescape(page).startswith("<!doctype html>")
    assert "<script" not in shown  # a script may be in the page, but not outside the page


def test_two_runs_compared_show_their_verdicts() -> None:
    runs = [petmjx.score(limit=3, engine="mujoco", thresholds={"tilt_deg": limit}) for limit in (20, 15)]
    shown = petmjx.compare_runs(*runs)._repr_html_()
    assert "3 of 3 worlds agree" in shown
    assert ["stable", "3", "0", "0"] in cells(shown)


def test_a_run_in_a_notebook_has_a_bar() -> None:
    drawn: list[str] = []

    def display(text: str) -> Callable[[str], None]:
        drawn.append(text)
        return drawn.append

    times = iter(range(100))
    petmjx.score(limit=3, engine="mujoco", watcher=NotebookBar(display, lambda: float(next(times))))
    assert re.search(r'<progress value="0" max="3" .*</progress> 0 of 3 plans', drawn[0])
    assert "engine mujoco (as asked for)" in drawn[0]
    bar = re.search(r'<progress value="(.*)" max="3" .*</progress> 2 of 3 plans, [\d.]+ plans/s, .* left', drawn[2])
    assert bar is not None
    # the bar shows the share of the expected time, which is not that of the plans
    assert 1.0 < float(bar[1]) < 3.0
    assert float(bar[1]) != 2.0
    assert "3 of 3 plans" in drawn[-1]
    assert len(drawn) == 4


def test_elsewhere_there_is_no_bar() -> None:
    assert notebook_bar() is None
