"""``score --name`` and ``compare --packers``: folders, tables, JSON, and errors of one line for runs that cannot be
compared."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest
from support.command_line import OVERHANG, TOWER, only_line, run, write
from support.plan_files import order_for

import petmjx
from petmjx.analysis.packer_kpis import KPIS
from petmjx.analysis.packer_runs import with_engine_of
from petmjx.results.run_reader import load_run

FAST = ("--engine", "mujoco", "--threads", "1")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plans of two packers for the orders ``x`` and ``y``, scored by one command. Both plans of one packer stand,
    and one plan of the other packer."""
    folder = tmp_path_factory.mktemp("packers")
    good = write(folder / "good.json", {"x": TOWER, "y": TOWER})
    bad = write(folder / "bad.json", {"x": TOWER, "y": OVERHANG})
    assert run("score", "--name", f"good={good}", f"bad,one={bad}", *FAST, "-o", folder / "out") == 0
    return folder / "out"


def words(text: str) -> list[str]:
    return [" ".join(line.split()) for line in text.splitlines()]


def test_each_packer_has_a_run_of_its_own(results: Path) -> None:
    assert sorted(path.name for path in results.iterdir()) == ["bad,one", "good"]
    assert load_run(results / "good").worlds["verdict"].tolist() == ["stable", "stable"]
    assert sorted(load_run(results / "bad,one").worlds["verdict"]) == ["stable", "unstable"]


def test_it_goes_on_where_it_was_and_tells_who_won(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = results.parent
    plans = [f"good={folder / 'good.json'}", f"bad,one={folder / 'bad.json'}"]
    assert run("score", "--name", plans[0], "--name", plans[1], *FAST, "-o", results, "--resume") == 0
    out = capsys.readouterr()
    assert out.err.count("2 plans of an earlier run are already in the folder") == 2
    lines = words(out.out)
    assert lines.index("packer good") < lines.index("packer bad,one")
    assert "good stands, bad,one does not: y" in lines
    assert run("score", "--name", *plans, *FAST, "-o", results, "--resume", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report["runs"]) == ["good", "bad,one"]
    assert report["compared"]["pairs"][0]["only_a"] == 1


def test_one_engine_is_chosen_for_all_packers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``auto`` would choose an engine for each file of plans, and no engine has all options: ``lanes`` is ignored."""
    choices = ["mujoco", "mujoco", "no second choice"]
    monkeypatch.setattr("petmjx.engines.engine_of_run.choose", lambda *_, **__: (choices.pop(0), "the test says so"))
    packers = [f"{name}={write(tmp_path / f'{name}.json', {'x': TOWER})}" for name in ("a", "b")]
    assert run("score", "--name", *packers, "--lanes", "4", "-o", tmp_path / "out") == 0
    assert [load_run(tmp_path / "out" / name).info["config"]["engine"] for name in ("a", "b")] == ["mujoco", "mujoco"]
    board = petmjx.leaderboard(
        [packer.partition("=")[2] for packer in packers], tmp_path / "board", engine="auto", stories=0
    )
    engines = [load_run(board.parent / "runs" / name).info["config"]["engine"] for name in ("a", "b")]
    assert engines == ["mujoco", "mujoco"]
    assert choices == ["no second choice"]


def test_a_run_that_is_there_keeps_its_engine(results: Path, tmp_path: Path) -> None:
    good = load_run(results / "good")
    options = {"engine": "auto", "threads": 1, "lanes": 4}
    assert with_engine_of(good, options, tmp_path) == {"engine": "mujoco", "threads": 1}
    assert with_engine_of(good, options, results / "bad,one") == options
    replacing = {"engine": "auto", "overwrite": True}
    assert with_engine_of(good, replacing, results / "bad,one") == {"engine": "mujoco", "overwrite": True}
    assert with_engine_of(good, {"engine": "mjx-warp"}, tmp_path) == {"engine": "mjx-warp"}


def test_compare_names_runs_and_writes_files(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = f"A={results / 'good'}", f"B={results / 'bad,one'}"
    assert run("compare", "--packers", first, second, "-o", tmp_path / "found") == 0
    lines = words(capsys.readouterr().out)
    assert f"A {results / 'good'}" in lines
    assert "A stands, B does not: y" in lines
    assert lines[-1] == f"tables in {tmp_path / 'found'}"
    assert pd.read_csv(tmp_path / "found" / "decided.csv")["plan_id"].tolist() == ["y"]
    assert run("compare", "--packers", results / "good", results / "bad,one", "--json") == 0
    assert json.loads(capsys.readouterr().out)["runs"] == {
        "good": str(results / "good"),
        "bad,one": str(results / "bad,one"),
    }


def test_kpis_stand_beside_shares(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each KPI equals that of ``petmjx.kpis``. A plan without an order has no KPIs, and a note says so."""
    monkeypatch.setenv("COLUMNS", "80")
    orders = write(tmp_path / "orders.json", {"x": order_for(TOWER, more=2), "y": order_for(TOWER, more=6)})
    runs = [f"A={results / 'good'}", f"B={results / 'bad,one'}"]
    assert run("compare", "--packers", *runs, "--orders", orders, "--json") == 0
    row_by_packer = {
        row["packer"]: row for row in json.loads(capsys.readouterr().out)["packers"] if row["size"] == "all"
    }
    for name, file in (("A", "good"), ("B", "bad")):
        expected = petmjx.kpis(results.parent / f"{file}.json", orders).summary["means"]
        assert {kpi: row_by_packer[name][kpi] for kpi in KPIS} == pytest.approx({kpi: expected[kpi] for kpi in KPIS})
    assert (row_by_packer["A"]["kpi_1"], row_by_packer["B"]["kpi_4"]) == pytest.approx(
        ((2 / 4 + 6 / 8) / 2, (1 + (1 + 0.35) / 2) / 2)
    )
    write(orders, {"x": order_for(TOWER)})
    assert run("compare", "--packers", *runs, "--orders", orders) == 0
    text = capsys.readouterr().out
    assert "note: no KPIs of 1 plan of A" in text
    assert max(map(len, text.partition("compared; boxes")[2].splitlines())) <= 80
    assert "KPIs of BED-BPP, means" in text
    assert not any(kpi in petmjx.compare_packers(runs_of(results)).packers for kpi in KPIS if kpi != "kpi_2")


def runs_of(results: Path) -> dict[str, Path]:
    return {"A": results / "good", "B": results / "bad,one"}


def test_compare_of_simulators_points_to_packers(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("compare", results / "good", results / "bad,one") == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "1 of 2 plans is not the same in a and b" in text
    assert "petmjx compare --packers" in text


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("compare", "{0}"), "compare takes two runs, got 1; --packers takes more"),
        (("compare", "{0}", "{0}", "-o", "x"), "--out needs --packers"),
        (("compare", "{0}", "{0}", "--orders", "x"), "--orders needs --packers"),
        (("compare", "--packers", "{0}"), "give at least two runs to compare"),
        (
            ("compare", "--packers", "A={0}", "{0}"),
            "compare --packers: give a name to each path (NAME=PATH), or to none",
        ),
        (("compare", "--packers", "A={0}", "A={0}"), "compare --packers A: two entries have this name"),
        (("compare", "--packers", "A={0}", "B=nowhere"), "nowhere: no such folder"),
        (("score", "--name", "plans.json"), "--name: must be NAME=PLANS"),
        (("score", "--name", "../a=b.json"), "the name must be usable as the name of a folder"),
        (("score", "--name", "a=b.json", "c.json"), "--name: give a name to each path (NAME=PATH), or to none"),
        (
            ("score", "--name", "a={0}/run.json", "b=nothing.json", "-o", "never"),
            "nothing.json: no such file or folder",
        ),
    ],
)
def test_what_cannot_be_compared_is_one_line(
    arguments: tuple[str, ...],
    text: str,
    results: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*(argument.format(results / "good") for argument in arguments)) == 2
    assert text in only_line(capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []
