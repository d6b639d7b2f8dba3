"""What notebooks show of a run."""

from __future__ import annotations

import re

import pandas as pd

import petmjx
from petmjx.results.notebook import MOST_ROWS, worlds_as_html


def cells(text: str) -> list[list[str]]:
    """The rows of a table, without its head."""
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
