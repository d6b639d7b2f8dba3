"""``petmjx criteria``: the printed tables, the written files, and errors of one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.command_line import only_line, run
from support.runs import leave_unfinished

pytest.importorskip("scipy")
pytest.importorskip("shapely")

from petmjx.analysis.criteria_run import criteria
from petmjx.analysis.criteria_vs_physics import CELLS

ONE = ("--processes", "1")


@pytest.fixture
def physics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    """The folder of a run with a few bundled plans."""
    monkeypatch.chdir(tmp_path)
    assert run("score", "--limit", "10", "--engine", "mujoco", "-o", "physics") == 0
    capsys.readouterr()
    return "physics"


@pytest.mark.parametrize("width", [80, 120])
def test_tables_fit_the_terminal(
    physics: str, width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    assert run("criteria", "--limit", "10", "--run", physics, "-o", "out", *ONE) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= width
    for text in ("judged by physics on 10 plans", "force_balance_leaning", "thresholds found on", "tables in out"):
        assert text in printed
    assert sorted(file.name for file in Path("out").glob("*.parquet")) == [
        *("boxes.parquet", "judged.parquet", "plans.parquet", "thresholds.parquet")
    ]


def test_the_rate_counts_from_the_first_plan_on() -> None:
    """Without the first call, a bar would begin when all plans of a short run are finished."""
    calls: list[tuple[int, int]] = []
    criteria(limit=3, only=("centre",), progress=lambda done, total: calls.append((done, total)))
    assert calls == [(0, 3), (3, 3)]


def test_a_run_that_is_not_finished_is_told(physics: str, capsys: pytest.CaptureFixture[str]) -> None:
    leave_unfinished(Path(physics))
    assert run("criteria", "--limit", "10", "--run", physics, "--only", "centre", *ONE) == 0
    assert "the run is not finished (interrupted)" in capsys.readouterr().out


def test_json_has_all_that_the_tables_have(physics: str, capsys: pytest.CaptureFixture[str]) -> None:
    only = ("--only", "centre", "--only", "support_50")
    assert run("criteria", "--limit", "10", "--run", physics, "--json", *only, *ONE) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["criteria"] == ["support_50", "centre"]
    assert [row["n_plans"] for row in report["judged"]] == [10, 10]
    assert sum(report["judged"][1][cell] for cell in CELLS) == 10
    assert report["thresholds"][0]["unit"] == "mm"


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--only", "support"), "criteria: there is no support; did you mean support_"),
        (("--run", "nowhere"), "nowhere: no such folder"),
        (("--friction", "-1"), "--friction must be from 0 to 10, got -1"),
        (("nowhere.json",), "nowhere.json"),
    ],
)
@pytest.mark.usefixtures("in_tmp_path")
def test_errors_are_one_line(arguments: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("criteria", *arguments, *ONE) == 2
    assert line in only_line(capsys.readouterr().err)
