"""The output of ``petmjx score --confidence``."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from support.command_line import TOWER, only_line, placement, run, write


def test_confidence_says_what_stands_and_what_is_a_coin_toss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")  # with 80 columns, the table leaves out the margin
    half = [placement((0, 0, 0)), placement((200, 0, 200))]
    plans = write(tmp_path / "plans.json", {"tower": TOWER, "half": half})
    out = tmp_path / "out"
    assert run("score", plans, "--engine", "mujoco", "--confidence", "12", "--out", out) == 0
    printed = capsys.readouterr()
    assert re.search(r"tower +2 stable +1\.00 ", printed.out)
    shares = re.search(r"^tower +stable +1\.00 +12 of 12 +100\.0 % +(.*)$", printed.out, flags=re.MULTILINE)
    assert shares is not None
    assert shares[1].strip() == "75.8 % to 100.0 %"
    assert re.search(r"half .* of 12 .*coin toss$", printed.out, flags=re.MULTILINE)
    assert "\ncoin toss: half\n" in printed.out
    assert re.search(r"in between\s*│\s*1 ", printed.out)
    assert re.search(r"worlds\s*│\s*26 ", printed.out)
    assert printed.err.startswith("26 worlds (2 plans × 13 variants)")
    assert run("score", plans, "--engine", "mujoco", "--confidence", "12", "--out", out, "--resume", "--json") == 0
    (tower_row, half_row) = json.loads(capsys.readouterr().out)["summary"]
    assert (half_row["coin_toss"], tower_row["n_standing"]) == (True, 12)
    assert tower_row["margin"] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--confidence", "2"), "--confidence must be from 4 to 100000, got 2"),
        (("--errors", "confidence"), "--errors needs the option confidence (the number of worlds)"),
        (("--confidence", "8", "--errors", "tilt"), "axes.profile contradicts confidence"),
    ],
)
def test_confidence_that_is_refused(
    options: tuple[str, ...], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plans = write(tmp_path / "plans.json", {"tower": TOWER})
    assert run("score", plans, "--engine", "mujoco", *options) == 2
    assert expected in only_line(capsys.readouterr().err)


CHAIN = """
replicates = 4
[axes]
friction_tolerance_rel = 0.01
[[legs]]
name = "belt"
events = [{ profile = "eumos-40509", level = 0.05 }]
[[legs]]
name = "truck"
events = [{ profile = "eumos-40509", level = 0.6 }]
[[remedies]]
name = "gentler truck"
leg = "truck"
factor = 0.1
"""


def test_a_chain_says_how_likely_a_pallet_arrives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    file = tmp_path / "way.toml"
    file.write_text(CHAIN)
    plans = write(tmp_path / "plans.json", {"tower": TOWER})
    out = tmp_path / "out"
    assert run("score", plans, "--engine", "mujoco", "--chain", file, "--out", out) == 0
    printed = capsys.readouterr()
    assert printed.err.startswith("9 worlds (1 plan × 9 variants) from 5 placements")
    assert re.search(r"^tower +2 stable +1\.00 ", printed.out, flags=re.MULTILINE)
    assert re.search(
        r"^tower 0 of 4 0\.0 % 0\.0 % to 49\.0 % +100\.0 % 100\.0 % 0\.0 % truck +[01]$", printed.out, re.MULTILINE
    )
    assert re.search(r"^gentler truck 100\.0 % +\+100\.0 +\+30\.7 to \+100\.0 +4 +0$", printed.out, re.MULTILINE)
    assert run("score", plans, "--chain", "tilt", "--out", out, "--overwrite") == 2
    assert "has no [[legs]], which a chain needs" in only_line(capsys.readouterr().err)
