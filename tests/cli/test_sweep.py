"""``petmjx sweep`` from the user's view: its output, its files and its errors."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from support.command_line import TOWER, only_line, run, write
from support.interrupted_commands import INTERRUPT_AFTER, run_interrupted

from petmjx.results.run_reader import load_run

GRID = """
[simulation]
settle_s = 0.2
rest_s = 0.2
[axes]
profile = "eumos-40509"
level = [0.2, 0.4, 0.8]
"""

SEARCH = """
[simulation]
settle_s = 0.2
rest_s = 0.2
[axes]
profile = "eumos-40509"
[search]
upper = 1.0
tolerance = 0.1
"""


@pytest.fixture
def plans(tmp_path: Path) -> Path:
    return write(tmp_path / "plans.json", {"tower": TOWER, "box": TOWER[:1]})


def test_a_grid_says_what_it_will_do_and_what_came_of_it(
    plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run("sweep", write(tmp_path / "x.toml", GRID), plans, "--engine", "mujoco", "--out", out) == 0
    printed = capsys.readouterr()
    assert "6 worlds (2 plans × 3 variants) from 2 placements, about" in printed.err
    assert "engine mujoco (as asked for)" in printed.err
    # the last two numbers are EUMOS's verdicts
    assert re.search(r"level_g\s+0.2\s+2\s+2\s+100.0 %\s+2\s+100.0 %\n", printed.out)
    assert "95 %" not in printed.out
    assert "note: eumos-40509 reaches 0.8 g from level 0.8 on: with friction 0.5 no unsecured load" in printed.out
    assert re.search(r"level_g\s+0.8\s+2\s+0\s+0.0 %", printed.out)
    assert re.search(r"worlds\s*│\s*6", printed.out)
    assert f"results in {out}" in printed.out
    results = load_run(out)
    assert results.info["status"] == "finished"
    assert results.info["config"]["sweep"]["axes"]["level"] == [0.2, 0.4, 0.8]
    assert results.info["timings"]["placements"] == 2
    assert sorted(results.worlds["variant"]) == [1, 1, 2, 2, 3, 3]
    assert "max_sway_m" in results.boxes


def test_a_search_names_the_largest_level_and_what_fails_first(
    plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    file = write(tmp_path / "x.toml", SEARCH)
    assert run("sweep", file, plans, "--engine", "mujoco", "--out", out, "--limit", "1") == 0
    printed = capsys.readouterr()
    assert "at most 5 worlds (1 plan × 5 variants) from 1 placement" in printed.err
    assert "largest level, g survived" in printed.out
    assert re.search(r"tower\s+eumos-40509\s+0\s+0.5\s+slide\s+\d carton", printed.out)
    assert re.search(r"answers\s*│\s*1 ", printed.out)
    assert re.search(r"tests simulated\s*│\s*[345] ", printed.out)
    assert "unstable" not in printed.out
    summary = load_run(out).summary
    assert summary is not None
    assert summary["plan_id"].tolist() == ["tower"]


def test_json_holds_the_summary(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "x.toml", SEARCH)
    assert run("sweep", file, plans, "--engine", "mujoco", "--out", tmp_path / "out", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert [row["plan_id"] for row in report["summary"]] == ["box", "tower"]
    assert report["counts"]["worlds"] >= 2


def test_ready_made_sweeps_go_by_name(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("sweep", "friction", plans, "--limit", "1", "--engine", "mujoco", "--out", tmp_path / "out") == 0
    assert "13 worlds (1 plan × 13 variants) from 13 placements" in capsys.readouterr().err
    assert run("sweep", "no-such", plans) == 2
    line = only_line(capsys.readouterr().err)
    names = "chain-film-road, chain-film-truck, chain-to-wrapper, confidence, en-12195-1, eumos-search, eumos,"
    assert f"ready-made sweeps are {names}" in line


BAD = {
    "unknown axis": ("[axes]\ncolour = [1]", "axes.colour: unknown field; there are profile, "),
    "empty axis": ("[axes]\nfriction_factor = []", "axes.friction_factor is empty: give at least one value"),
    "contradicting axes": (
        '[axes]\nprofile = "radial"\nscale = [1]\nlevel = [1]',
        "axes.scale contradicts axes.level",
    ),
    "negative scale": ('[axes]\nprofile = "radial"\nscale = [1, -1]', "axes.scale[1] must be > 0, got -1"),
    "too many worlds": (
        '[axes]\nprofile = "radial"\nscale = { from = 0.001, to = 2, step = 0.001 }\n'
        "direction = { from = 0, to = 359.5, step = 0.5 }",
        "axes make 2,880,000 worlds (2 plans × 1,440,000 variants), more than 1,000,000: pass --yes",
    ),
    "not TOML": ("[axes", "not valid TOML"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_sweep_file_takes_one_line(
    case: str, plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, complaint = BAD[case]
    file = write(tmp_path / "x.toml", text)
    assert run("sweep", file, plans, "--out", tmp_path / "out") == 2
    line = only_line(capsys.readouterr().err)
    assert str(file) in line
    assert complaint in line
    assert not (tmp_path / "out").exists()


def test_missing_plans_take_one_line(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "x.toml", GRID)
    assert run("sweep", file) == 2
    assert "plans is missing: name plan files in the sweep file or on the command line" in only_line(
        capsys.readouterr().err
    )
    assert run("sweep", file, tmp_path / "nowhere.json") == 2
    assert "nowhere.json" in only_line(capsys.readouterr().err)
    named = write(tmp_path / "y.toml", 'plans = "gone.json"\n' + GRID)
    assert run("sweep", named) == 2
    assert "plans: no such file or folder:" in only_line(capsys.readouterr().err)
    assert run("sweep", file, write(tmp_path / "bad.json", '{"p": 3}')) == 2
    assert "no usable plan (1 skipped)" in only_line(capsys.readouterr().err)


def test_results_are_not_written_over_unasked(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ("sweep", write(tmp_path / "x.toml", GRID), plans, "--engine", "mujoco", "--out", tmp_path / "out")
    assert run(*command) == 0
    capsys.readouterr()
    assert run(*command) == 2
    assert "holds a run already" in only_line(capsys.readouterr().err)
    assert run(*command, "--overwrite", "--limit", "1") == 0
    assert len(load_run(tmp_path / "out").worlds) == 3


def test_ctrl_c_leaves_whole_parts(tmp_path: Path) -> None:
    plans = write(tmp_path / "plans.json", {f"p{k}": TOWER for k in range(200)})
    file = write(tmp_path / "x.toml", "[axes]\nfriction_factor = [0.9, 1.0, 1.1]")
    out = tmp_path / "out"
    done = run_interrupted("sweep", file, plans, "--engine", "mujoco", "--out", out)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert f"interrupted: {INTERRUPT_AFTER} of 600 worlds are done and in {out}" in done.stderr
    parts = sorted((out / "worlds").glob("*"))
    assert {part.suffix for part in parts} == {".parquet"}
    assert sum(pq.read_metadata(part).num_rows for part in parts) == INTERRUPT_AFTER


def test_options_replace_the_values_of_the_file(plans: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    file = write(tmp_path / "x.toml", GRID)
    code = run(
        "sweep", file, plans, "--engine", "mujoco", "--limit", "1", "--carrier", "euro-pallet", "--rest", "0.3",
        "--physics", "reference", "--set", "thresholds.drop_hull_z_m=-0.2", "--tilt-limit-deg", "15", "--out", out,
    )  # fmt: skip
    assert code == 0
    sim = load_run(out).info["config"]["simulation"]
    assert (sim["settle_s"], sim["rest_s"], sim["carrier"], sim["physics"]["name"]) == (
        0.2, 0.3, "euro-pallet", "reference",
    )  # fmt: skip
    assert (sim["thresholds"]["drop_hull_z_m"], sim["thresholds"]["tilt_deg"]) == (-0.2, 15.0)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--rest", "-1"], "--rest must be ≥ 0, got -1"),
        (["--set", "quiet.steps=0"], "--set quiet.steps must be ≥ 1, got 0"),
    ],
)
def test_an_error_names_the_option_not_the_file(
    arguments: list[str], expected: str, plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("sweep", write(tmp_path / "x.toml", GRID), plans, *arguments) == 2
    assert only_line(capsys.readouterr().err).startswith(f"petmjx: {expected}")


def test_help_says_where_defaults_come_from(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("sweep", "--help") == 0
    printed = capsys.readouterr().out
    assert "Simulation (the sweep file's [simulation] may set other defaults):" in printed
    assert "--yes" in printed
    assert "--carrier" in printed
