"""Output in a terminal: tables fit its width, numbers are never cut, and control characters from files are not
printed."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.cells import cell_len
from rich.console import Console, RenderableType
from support.outcomes import dropped_outcome, make_outcome, make_plan
from support.stories import standing_story

from petmjx.analysis.run_comparison import compare_runs
from petmjx.cli.console import print_tables
from petmjx.common.progress_texts import MARK_S, ProgressTexts
from petmjx.common.text import count_text, printable, three_digits, time_left
from petmjx.engines.verdict import Outcome
from petmjx.plans.plan_set import Skipped
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.show.compare_tables import comparison_tables
from petmjx.show.progress import ProgressLines, progress
from petmjx.show.run_tables import notes, run_tables, search_table, summary_table, worlds_table
from petmjx.show.story_tables import story_tables
from petmjx.show.sweep_tables import MAX_VALUES, sweep_tables
from petmjx.show.table_layout import FEW_ROWS, SHOWN_SKIPPED, FittedTable, TableColumn, number, percent

LONG = "x" * 80 + "end"
CHINESE = "纸箱托盘计划" * 8


def lines_of(renderables: RenderableType | Sequence[RenderableType], width: int = 200) -> list[str]:
    """The lines that are printed on a terminal of this width, in columns, without spaces at their ends."""
    file = io.StringIO()
    several = [*renderables] if isinstance(renderables, list) else [renderables]
    print_tables(several, Console(file=file, width=width))
    return [line.rstrip() for line in file.getvalue().splitlines()]


def words_of(renderables: RenderableType | Sequence[RenderableType], width: int = 200) -> list[str]:
    """The printed lines, with single spaces between words, and without the lines of tables."""
    return [" ".join(line.replace("│", " ").split()) for line in lines_of(renderables, width)]


def written(folder: Path, outcomes: dict[str, Outcome], command: str = "score") -> Path:
    with RunWriter(folder, {"command": command}) as run:
        for plan_id, outcome in outcomes.items():
            run.add(make_plan(plan_id, outcome.n_boxes), 0, "fixed", outcome)
    return folder


def test_forces_that_round_to_zero_have_no_sign(tmp_path: Path) -> None:
    rest_n = np.array([-0.04, -0.06, -0.0])
    story = standing_story()
    boxes = replace(story.outcome.boxes, max_top_force_n=rest_n, rest_top_force_n=rest_n)
    lines = words_of(list(story_tables(replace(story, outcome=replace(story.outcome, boxes=boxes)))))
    rows = {line.split()[0]: line.split()[-3:-1] for line in lines if line.split()[:1] in (["0"], ["1"], ["2"])}
    assert rows == {"0": ["0.0", "0.0"], "1": ["-0.1", "-0.1"], "2": ["0.0", "0.0"]}
    assert not any("most pressed" in line for line in lines), "nothing lies on these boxes"
    assert sum("most pressed" in line for line in words_of(list(story_tables(story)))) > 0
    run = load_run(written(tmp_path / "run", {"w": make_outcome(3, rest_top_force_n=np.full(3, -0.04))}))
    (row,) = (line for line in words_of(worlds_table(run.worlds, run.boxes)) if line.startswith("w "))
    assert row.split()[-1] == "0.0"


# Texts.


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("plain [bold] ü 纸", "plain [bold] ü 纸"),
        ("ü\x1b[2J", "ü\\u001b[2J"),
        ("\x7f\x9b\r\n", "\\u007f\\u009b\\r\\n"),
        ("a\u202eb\u2028", "a\\u202eb\\u2028"),
        ("\udc80", "\\x80"),
        ("\udfff", "\\udfff"),
    ],
)
def test_printable(text: str, expected: str) -> None:
    assert printable(text) == expected
    assert printable(text).isprintable()


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0, "0"), (0.00123456, "0.00123"), (12.345, "12.3"), (99.94, "99.9"), (99.96, "100"), (1234.5, "1,234"),
        (-15379.0, "-15,379"), (999_999.4, "999,999"), (1234567.0, "1.23e+06"), (5.6e-17, "5.6e-17"),
    ],
)  # fmt: skip
def test_three_digits(value: float, expected: str) -> None:
    assert three_digits(value) == expected


def test_values_in_cells() -> None:
    assert [number(value) for value in (None, np.nan, pd.NA, 2)] == ["-", "-", "-", "2"]
    assert number(0.02, ".1f", " mm", 1000.0) == "20.0 mm"
    assert [number(value, sign=True) for value in (4.0, -4.0)] == ["+4", "-4"]
    assert percent(0.1234) == "12.3 %"
    assert [count_text(n, "world") for n in (0, 1, 1000)] == ["0 worlds", "1 world", "1,000 worlds"]
    assert [time_left(seconds) for seconds in (0.2, 59.4, 105, 7500)] == ["0 s", "59 s", "1 min 45 s", "2 h 5 min"]


# The table that fits.


def example() -> FittedTable:
    rows = [
        (LONG, "a note of some length", "111.1", "0.40", "1,234,567.8"),
        ("[red]m[/red]", "a\x1b[2Jb", "-", "-", "0.0"),
        (CHINESE, "", "-", "-", "0.0"),
    ]
    return FittedTable(
        rows,
        TableColumn("plan", itemgetter(0), "left", least=8, middle=True),
        TableColumn("note", itemgetter(1), "left", least=4),
        TableColumn("rest\nN", itemgetter(2), spare=2),
        TableColumn("at s", itemgetter(3), spare=1),
        TableColumn("shift mm", itemgetter(4)),
    )


@pytest.mark.parametrize("width", [30, 40, 60, 80, 120, 200])
def test_a_table_fits_and_cuts_no_number(width: int) -> None:
    lines = lines_of(example(), width)
    assert max(cell_len(line) for line in lines) <= width
    assert any("1,234,567.8" in line for line in lines)


def test_what_gives_way_when() -> None:
    wide = lines_of(example(), 200)
    assert LONG in wide[2]
    assert "a\\u001b[2Jb" in wide[3]
    assert "[red]m[/red]" in wide[3]
    assert CHINESE in wide[4]
    assert lines_of(example(), 60)[2] == "xxxxxxxxx…xxxxxend a note of some le… 111.1 0.40 1,234,567.8"
    assert lines_of(example(), 30)[1:] == [
        "xxxx…end a n… 0.40 1,234,567.8",
        "[red…ed] a\\u…    -         0.0",
        "纸箱…划          -         0.0",
        "left out at this width: rest N",
    ]


# Runs.


def test_summary_table(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {"command": "score"}, expected_worlds=4) as run:
        run.add(make_plan("a"), 0, "fixed", make_outcome())
        run.add(make_plan("b"), 0, "fixed", dropped_outcome())
        run.skip(Skipped("plans.json", "c", "bad"))
    info = load_run(tmp_path).info
    info["timings"]["wall_s"] = 4.0
    lines = words_of(summary_table(info))
    for line in ("plans 2", "stable 1 50.0 %", "unstable 1 50.0 %", "drop 1 50.0 %", "invalid 0 0.0 %"):
        assert line in lines
    assert "skipped plans 1" in lines
    assert "not simulated 2 finished" in lines
    assert "plans/s 0.5 4.0 s" in lines


def test_summary_table_of_an_empty_run() -> None:
    assert "plans 0" in words_of(summary_table({}))


def test_worlds_table(tmp_path: Path) -> None:
    run = load_run(written(tmp_path, {"[x]a": make_outcome(), "b": dropped_outcome()}))
    lines = words_of(worlds_table(run.worlds, run.boxes))
    assert "[x]a 3 stable 0.70 - 6.0 3.0 150.0" in lines
    assert "b 2 of 3 unstable drop -1.00 1 article-1 0.40 4.0 2.0 -" in lines


@pytest.mark.parametrize("width", [80, 120])
def test_a_long_id_ruins_no_table(width: int, tmp_path: Path) -> None:
    path = written(tmp_path / "a", {LONG: dropped_outcome(), CHINESE: make_outcome()})
    run = load_run(path)
    lines = lines_of([worlds_table(run.worlds, run.boxes)], width)
    assert max(cell_len(line) for line in lines) <= width
    [row] = [line.split() for line in lines if "xend" in line]
    assert row[1:7] == ["2", "of", "3", "unstable", "drop", "-1.00"]
    assert row[9:12] == ["0.40", "4.0", "2.0"]
    other = written(tmp_path / "b", {LONG: make_outcome(), CHINESE: dropped_outcome()})
    tables = [table for table in comparison_tables(compare_runs(path, other)) if isinstance(table, FittedTable)]
    lines = lines_of(tables, width)
    assert len(tables) >= 2
    assert max(cell_len(line) for line in lines) <= width
    assert any("unstable drop" in line for line in lines)


def test_the_report_of_a_run(tmp_path: Path) -> None:
    path = written(tmp_path / ("folder-" * 20), {"a": make_outcome()})
    lines = lines_of(list(run_tables(load_run(path))), 80)
    assert f"results in {path}" in lines  # the path is printed whole, although it is longer than a line


def test_notes_are_counted() -> None:
    skipped = [{"error": f"plans.json: plan {k}\x1b: bad"} for k in range(SHOWN_SKIPPED + 2)]
    lines = lines_of(list(notes({"skipped": skipped, "warnings": ["odd"]})))
    assert lines[0] == "skipped: plans.json: plan 0\\u001b: bad"
    assert lines[-2] == "skipped: 2 more, in run.json"
    assert lines[-1].startswith("1 plan with overlapping")
    lines = lines_of(list(notes({"skipped": [], "warnings": ["all slide", "odd"], "counts": {"odd_plans": 1}})))
    assert lines[0].startswith("1 plan with overlapping")
    assert lines[1] == "note: all slide"
    assert not lines_of(
        list(notes({"skipped": [], "warnings": ["all slide"], "counts": {"odd_plans": 0}}, printed={"all slide"}))
    )


# Comparisons and sweeps.


def test_comparison(tmp_path: Path) -> None:
    moved = make_outcome()
    moved.boxes.shift_m[2, 0] += 0.004
    moved.boxes.pos[2, 0] += 0.004
    a = written(tmp_path / "a", {"[bold]s": make_outcome(), "d": make_outcome(), "only": make_outcome()})
    b = written(tmp_path / "b", {"[bold]s": moved, "d": dropped_outcome()})
    lines = words_of(list(comparison_tables(compare_runs(a, b))), 80)
    assert "1 world only in a: only/0" in lines
    assert "verdicts: 1 of 2 worlds agree (50.00 %)" in lines
    assert "stable 1 1 0" in lines
    assert any(line.startswith("d 0 a stable - ") for line in lines)
    assert any(line.startswith("b unstable drop 1 ") for line in lines)
    assert "each of these worlds has a margin from -0.7 to 0.7 in one of the runs" in lines
    assert "differences |b - a| of boxes, both stable" in lines
    assert any(line.startswith("shift_x_m 3 - 0 0.0036 0.004 [bold]s/0/2") for line in lines)
    assert any(line.startswith("max_lin_acc m/s² ") for line in lines)
    assert any(line.startswith("max_top_force_n % ") for line in lines)


def shares(n_values: int) -> pd.DataFrame:
    row = {"scope": "all", "plan_id": None, "n_worlds": 123456, "n_standing": 61728, "share": 0.5}
    row |= {"n_draws": 32, "low": 0.4, "high": 1.0, "n_invalid": 3456}
    row |= {"n_eumos": 120000, "eumos_share": 0.25, "smallest_fail_angle_deg": np.nan}
    axes = [("", "")] + [("placement_error_direction_deg", f"a-profile-of-mine-{k}") for k in range(n_values)]
    return pd.DataFrame([{**row, "axis": axis, "value": value} for axis, value in axes])


def levels(n_plans: int) -> pd.DataFrame:
    row = {"profile": "eumos-40509", "direction_deg": 270.0, "largest_level_g": 0.53, "stands_at_rest": True}
    row |= {"monotone": False, "moving": True, "mode": "slide", "box": 4, "article": LONG}
    fallen = {**row, "plan_id": LONG, "stands_at_rest": False, "mode": "drop", "largest_level_g": np.nan, "box": np.nan}
    frame = pd.DataFrame([fallen, *({**row, "plan_id": f"plan-{k}"} for k in range(n_plans - 1))])
    return frame.astype({"box": "Int64"})


def test_a_grid_has_the_table_of_a_laboratory() -> None:
    """The table has one row per level of a laboratory's test, with the largest deformations at this level. Other
    levels, and rows without a level, are left out."""
    row = {"scope": "plan", "plan_id": "a", "axis": "level_g", "n_worlds": 4, "n_standing": 4, "n_invalid": 0}
    row |= {"share": 1.0, "n_draws": 0, "low": np.nan, "high": np.nan, "n_eumos": 4, "eumos_share": 0.5}
    row |= {"eumos_elastic_share": 0.031, "eumos_permanent_share": 0.012, "eumos_foot_permanent_m": 0.034}
    of_levels = [
        {**row, "value": "0.25", "n_eumos_passed": 4},
        {**row, "value": "0.3", "n_eumos_passed": 4},
        {**row, "value": "0.5", "n_eumos_passed": 1, "eumos_elastic_share": 0.12},
        {**row, "value": "0.6", "n_eumos_passed": 0},
        {**row, "value": "0.7", "n_eumos": 0, "n_eumos_passed": 0, "eumos_elastic_share": np.nan},
    ]
    lines = words_of(
        list(sweep_tables(pd.DataFrame([*of_levels, {**row, "axis": "", "value": "", "n_eumos_passed": 0}])))
    )
    table = lines[lines.index(next(text for text in lines if "EUMOS 40509 at each level" in text)) :]
    assert not [text for text in table if text.startswith("a 0.25")]
    assert "a 0.3 4 3.1 % 1.2 % 3.4 passed" in table
    assert "a 0.5 4 12.0 % 1.2 % 3.4 3 failed" in table
    assert "a 0.6 4 3.1 % 1.2 % 3.4 failed" in table
    drawn = pd.DataFrame([{**row, "value": "0.1 to 0.2", "n_eumos_passed": 4}])
    assert not [text for text in words_of(list(sweep_tables(drawn))) if "at each level" in text]


@pytest.mark.parametrize("width", [80, 120])
def test_tables_of_sweeps_fit(width: int) -> None:
    for summary in (shares(3), levels(3)):
        for line in lines_of(list(sweep_tables(summary)), width):
            assert cell_len(line) <= width
    lines = words_of(list(sweep_tables(shares(3))), 80)
    # a wide table has no room for the number of standing worlds; the share and the number of worlds remain
    assert "all 120,000 50.0 % 40.0 % to 100.0 % 120,000 25.0 % -" in lines
    lines = words_of(list(sweep_tables(levels(3))), 120)
    assert "largest level, g survived, where placements stand at rest" in lines
    assert "eumos-40509 270 3 2 0 0.53 0.53 0.53 0.53 0.53" in lines
    assert any(line.startswith("plan-0 eumos-40509 270 0.53 * ~ slide 4 xxx") for line in lines)
    doubts = (
        "* a level above the smallest failed level was survived",
        "~ boxes still moved after the longest wait",
    )
    assert "; ".join(doubts) in lines
    lines = words_of(list(sweep_tables(levels(3).drop(columns="moving"))), 120)  # the run is of an earlier version
    assert any(line.startswith("plan-0 eumos-40509 270 0.53 * slide 4 xxx") for line in lines)


def test_intervals_are_shown_where_there_are_any() -> None:
    frame = shares(2)
    frame.loc[1, ["n_draws", "low", "high"]] = [0, np.nan, np.nan]
    lines = words_of(list(sweep_tables(frame)), 120)
    assert "placement_error_direction_deg a-profile-of-mine-0 120,000 61,728 50.0 % 120,000 25.0 % -" in lines
    lines = words_of(list(sweep_tables(frame.assign(n_draws=0, low=np.nan, high=np.nan))), 120)
    assert not any("95 %" in line or "draws" in line for line in lines)
    assert "all 120,000 61,728 50.0 % 120,000 25.0 % -" in lines


@pytest.mark.parametrize(
    ("largest", "expected"),
    [
        ([0.0, 0.2, 0.4, 0.6, 0.8], "5 5 1 0 0.2 0.4 0.6 0.8"),
        ([np.nan, np.nan, 0.5, 0.6, 0.7], "5 5 2 none none 0.5 0.6 0.7"),
        ([None, 0.3], "2 2 1 none none none none 0.3"),
        ([None, None], "2 2 2 none none none none none"),
        ([], "1 0 0 - - - - -"),
    ],
)
def test_levels_are_those_of_placements_that_stand(largest: list[float | None], expected: str) -> None:
    frame = levels(1 + len(largest)).iloc[1:].assign(largest_level_g=np.array(largest, dtype=float))
    frame = frame if len(frame) else levels(1)  # the plan does not stand
    assert f"eumos-40509 270 {expected}" in words_of(next(sweep_tables(frame)), 80)


def test_a_search_counts_its_answers_not_its_probes() -> None:
    rows = [
        ("a", 0, True, 0.5, 0.6, "slide", 5, 1), ("a", 0, True, 1.0, np.nan, "", 4, 0),
        ("b", 0, True, np.nan, 0.1, "drop", 3, 0), ("c", 0, False, np.nan, np.nan, "drop", 0, 0),
        ("d", 0, False, np.nan, np.nan, "nonfinite", 0, 0),
    ]  # fmt: skip
    names = ["plan_id", "placement", "stands_at_rest", "largest_level_g", "first_failed_level_g", "mode", "n_tests"]
    frame = pd.DataFrame(rows, columns=[*names, "n_invalid"])
    info = {"counts": {"worlds": 14, "stable": 5, "skipped_plans": 2}, "timings": {"wall_s": 4.0}}
    lines = words_of(search_table(info, frame))
    assert lines[1:10] == [
        "placements 4", "stand 2 50.0 %", "invalid 1 25.0 %",
        "answers 3", "survive no level 1 33.3 %", "survive all levels 1 33.3 %",
        "tests simulated 12", "invalid 1 8.3 %", "skipped plans 2",
    ]  # fmt: skip
    assert "tests/s 3 4.0 s" in lines


def test_long_answers_are_left_to_the_summary() -> None:
    assert len(list(sweep_tables(levels(FEW_ROWS + 1)))) == 1
    assert lines_of(list(sweep_tables(shares(MAX_VALUES + 4))))[-1] == "5 more in summary"


# Progress.


def test_a_terminal_gets_a_bar() -> None:
    console = Console(file=io.StringIO(), width=80, force_terminal=True)
    with progress(4, "plan", console) as shown:
        shown.update(1, "compiling [8 boxes]\x1b[2J")
        shown.update(4)
    text = console.file.getvalue()  # type: ignore[attr-defined]  # file is the StringIO of the first line
    assert "4 of 4 plans" in text
    assert "plans/s" in text


def test_what_is_no_terminal_gets_lines() -> None:
    now = 0.0
    output: list[str] = []
    lines = ProgressLines(10_003, "plan", output.append, clock=lambda: now)
    for now, done, message in (  # noqa: B007  # the clock reads it
        (1.0, 0, "compiling"), (9.9, 100, ""), (10.1, 0, "compiling\x1b"), (15.0, 1240, ""), (20.2, 2020, ""),
    ):  # fmt: skip
        lines.update(done, message)
    lines.end()
    assert output == [
        "0 of 10,003 plans, compiling\\u001b\n",
        "2,020 of 10,003 plans, 100 plans/s, 1 min 20 s left\n",
    ]


def test_the_last_line_of_progress_is_written_once() -> None:
    now = 0.0
    output: list[str] = []
    lines = ProgressLines(2, "plan", output.append, clock=lambda: now)
    for now, done in ((1.0, 0), (12.0, 1), (13.0, 2)):  # noqa: B007  # the clock reads it
        lines.update(done)
    lines.end()
    lines.end()
    assert [line.split(",")[0].strip() for line in output] == ["1 of 2 plans", "2 of 2 plans"]


def test_the_last_worlds_are_expected_to_take_as_long_as_the_ones_before() -> None:
    now, left = 0.0, []
    texts = ProgressTexts(1000, "world", lambda: now)
    for now, done in (  # noqa: B007  # the clock reads it
        (1.0, 0), (10.0, 500), (20.0, 996), (23.0, 998), (24.0, 998), (40.0, 998), (40.5, 999),
    ):  # fmt: skip
        texts.update(done)
        left.append(texts.left)
    # When two worlds are left, the last two of the 998 finished worlds have taken the time since 20.0 s. At the mean
    # rate of all worlds, the estimate would be 0 s.
    assert left == ["", "10 s left", "10 s left", "3 s left", "4 s left", "20 s left", "18 s left"]
    assert texts.words == ["999 of 1,000 worlds", "24.7 worlds/s", "18 s left"]
    texts.update(1000)
    now = 60.0
    assert texts.words == ["1,000 of 1,000 worlds", "24.7 worlds/s"]
    assert not ProgressTexts(None, "world").left


def test_the_time_left_follows_from_the_work_that_is_done_where_no_world_has_ended() -> None:
    """A quarter of the work of a chain, the placement of boxes, takes 10 s. The chain's four worlds arrive one after
    the other."""
    now, left = 0.0, []
    texts = ProgressTexts(4, "world", lambda: now)
    for now, done, share in ((10.0, 0, 0.25), (20.0, 0, 0.5), (35.0, 1, 0.875), (40.0, 4, 1.0)):  # noqa: B007
        texts.update(done, share)
        left.append(texts.left)
    assert left == ["30 s left", "20 s left", "15 s left", ""]
    assert texts.words == ["4 of 4 worlds", "0.1 worlds/s"]


def test_of_a_million_worlds_few_moments_are_kept() -> None:
    now = 0.0
    texts = ProgressTexts(1_000_000, "world", lambda: now)
    for done in range(1, 10_001):
        now = done / 4000
        texts.update(done)
    assert len(texts._marks) < 2.5 / MARK_S + 5
    assert texts.left == "4 min 8 s left"


def test_lines_of_an_unknown_total() -> None:
    lines: list[str] = []
    console = Console(file=io.StringIO(), width=80)
    with progress(None, "world", console) as shown:
        shown.update(1)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert len(lines) == 1
    assert lines[0].startswith("1 world, ")


def test_lines_that_nobody_reads_stop_nothing() -> None:
    def broken(text: str) -> None:
        raise BrokenPipeError

    lines = ProgressLines(3, "plan", broken)
    lines.update(1)
    lines.end()
