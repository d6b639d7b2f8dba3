"""Tables and charts of sweeps: tables of searches have the axes of placements, bars of histograms end at thresholds,
and film counts as securing of a load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from rich.console import Console

from petmjx.cli.console import print_tables
from petmjx.runs.hopeless_profiles import hopeless_profiles
from petmjx.runs.sweep_file import load_sweep
from petmjx.show.report.chart_frame import Frame, Scale
from petmjx.show.report.charts import histogram
from petmjx.show.sweep_tables import answers_table, laboratory_table, levels_table, turns_table
from petmjx.show.table_layout import FittedTable, count_of


def printed(table: FittedTable, capsys: pytest.CaptureFixture[str]) -> str:
    print_tables([table], Console(width=120))
    return capsys.readouterr().out


def summary(**axes: list[Any]) -> pd.DataFrame:
    n = len(next(iter(axes.values())))
    rows = {"plan_id": ["p"] * n, "placement": range(n), "profile": ["eumos-40509"] * n, "direction_deg": [0.0] * n}
    answers = {
        "stands_at_rest": [True] * n, "largest_level_g": [0.1 * k for k in range(n)], "mode": ["slide"] * n,
        "monotone": [True] * n, "box": [1] * n, "article": ["c"] * n,
    }  # fmt: skip
    return pd.DataFrame(rows | axes | answers)


def test_turns_of_film_are_in_the_tables(capsys: pytest.CaptureFixture[str]) -> None:
    searches = summary(wrap_turns=[1.0, 4.0, 16.0], friction_factor=[0.5, 0.5, 0.5])
    for table in (answers_table(searches), levels_table(searches)):
        lines = printed(table, capsys).splitlines()
        rows = [line.split() for line in lines if "eumos" in line]
        assert [row[row.index("0") + 1] for row in rows] == ["1", "4", "16"]
        assert any("turns" in line for line in lines)
        assert not any("friction" in line for line in lines), "it has one value"


def test_a_search_says_how_many_turns_a_plan_needs(capsys: pytest.CaptureFixture[str]) -> None:
    """Of two directions, the smaller level counts. With 16 turns the plan survives all levels, with 1 turn it survives
    less than 0.3 g."""
    levels = {"wrap_turns": [1.0, 1.0, 4.0, 4.0, 16.0, 16.0], "direction_deg": [0.0, 90.0] * 3}
    searches = summary(**levels).assign(
        largest_level_g=[0.5, 0.1 + 0.1, 0.1 + 0.2, 0.6, 0.8, 0.9],
        first_failed_level_g=[0.6, 0.3, 0.4, 0.7, None, None],
    )
    text = printed(turns_table(pd.concat([searches, searches.assign(plan_id="q", largest_level_g=None)])), capsys)
    head, rows = text.splitlines()[1], text.splitlines()[2:]
    assert head.split() == ["plan", *(word for level in range(2, 9) for word in (f"{level / 10:g}", "g"))]
    assert rows[0].split() == ["p", "1", "4", "16", "16", "16", "16", "16"]
    assert rows[1].split() == ["q", *["none"] * 7]


def test_a_search_reports_what_laboratories_do(capsys: pytest.CaptureFixture[str]) -> None:
    shares = {"eumos_elastic_share": [0.061, 0.12], "eumos_permanent_share": [0.02, 0.06]}
    searches = summary(direction_deg=[0.0, 90.0]).assign(
        **shares, eumos_foot_permanent_m=[0.012, 0.05], eumos_passed=[True, False]
    )
    lines = printed(laboratory_table(searches), capsys).splitlines()
    assert lines[-2].split() == ["p", "0", "0", "6.1", "%", "2.0", "%", "1.2", "passed"]
    assert lines[-1].split() == ["p", "90", "0.1", "12.0", "%", "6.0", "%", "5.0", "failed"]


def test_tables_of_searches_without_such_axes_are_as_before(capsys: pytest.CaptureFixture[str]) -> None:
    searches = summary(wrap_turns=[4.0, 4.0])
    assert "turns" not in printed(answers_table(searches), capsys)
    (row,) = (line for line in printed(levels_table(searches), capsys).splitlines() if "eumos" in line)
    assert row.split()[1:4] == ["0", "2", "2"]


def test_many_rows_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    searches = summary(friction_factor=[k / 10 for k in range(1, 61)])
    text = printed(levels_table(searches), capsys)
    assert "10 more in summary" in text
    assert text.count("eumos-40509") == 50


@pytest.mark.parametrize("threshold", [20.0, 7.3, 40.3])
def test_no_bar_reaches_across_a_threshold(threshold: float) -> None:
    values = pd.Series([threshold - 0.5, threshold + 0.5, 0.0, 45.0])
    frame = Frame("tilt", Scale(0, 45), Scale(0, 1), "°", "worlds")
    histogram(frame, values, pd.Series(["stable"] * 4), ["stable"], threshold)
    (limit,) = frame.at([threshold], [0.0])[0]
    bars = [_bar(mark) for mark in map(str, frame.marks) if "<rect" in mark]
    assert bars
    for left, right in bars:
        assert right <= limit + 0.06 or left >= limit - 0.06, "pixels are rounded to tenths"
    assert any(right <= limit + 0.06 and right > limit - 30 for _, right in bars)


def _bar(mark: str) -> tuple[float, float]:
    import re

    x, width = (float(re.search(rf'\b{name}="([\d.]+)"', mark)[1]) for name in ("x", "width"))  # type: ignore[index]
    return x, x + width


def test_film_secures_a_load(tmp_path: Path) -> None:
    tilts = '[axes]\nprofile = "eumos-40509"\ndirection = ["+x"]\nlevel = [1.5]\n'
    cases = {
        "none": (tilts, True),
        "film": (tilts + "[simulation.wrap]\nturns = 4\n", False),
        "turns": (tilts + "wrap_turns = [1, 4]\n", False),
        "with none": (tilts + "wrap_turns = [0, 4]\n", True),
    }
    for name, (text, is_hopeless) in cases.items():
        (tmp_path / f"{name}.toml").write_text(text)
        lines = hopeless_profiles(load_sweep(tmp_path / f"{name}.toml", plans_given=True))
        assert any("no unsecured load stays in place" in line for line in lines) == is_hopeless, name


def test_no_worlds_are_a_count_of_0() -> None:
    """If no world has a verdict, pandas has no row to count, and joins NaN."""
    assert [count_of("n")({"n": count}) for count in (float("nan"), 0, 1234.0)] == ["0", "0", "1,234"]
