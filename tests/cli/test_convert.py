"""``petmjx convert``, and names of files that ``petmjx samples`` refuses."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest
from support.command_line import only_line, run, write
from support.plan_files import tower

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_convert(capsys: pytest.CaptureFixture[str]) -> None:
    plans = {"A": tower(2), "B": tower(1), "bad": []}
    write(Path("plans.json"), plans)
    assert run("convert", "plans.json", "-o", "plans.csv") == 0
    out, err = capsys.readouterr()
    assert out == "2 plans (3 boxes) in plans.csv\n"
    assert err == "skipped: plans.json: plan bad: has no placement\n"
    assert run("convert", "plans.csv", "-o", "again.json.gz", "--limit", "1") == 0
    assert json.loads(gzip.decompress(Path("again.json.gz").read_bytes())) == {"A": plans["A"]}
    assert sorted(path.name for path in Path().iterdir()) == ["again.json.gz", "plans.csv", "plans.json"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "plans.txt"], "plans.txt: the name must end in one of .json, .json.gz, .csv, .csv.gz, .parquet"),
        (["-o", "no/such/plans.csv"], "no/such/plans.csv: cannot be written: No such file or directory"),
        (["-o", "p.csv", "--strict"], "plans.json: plan bad: has no placement"),
    ],
)
def test_convert_refuses(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"A": tower(1), "bad": []})
    assert run("convert", "plans.json", *arguments) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line == f"petmjx: {message}"


def test_samples_are_not_written_under_the_name_of_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("samples", "-n", "1", "-o", "plans.csv") == 2
    line = only_line(capsys.readouterr().err)
    assert line == "petmjx: plans.csv: samples are written as JSON; use petmjx convert to make a table"
    assert not Path("plans.csv").exists()


def test_convert_without_a_usable_plan(capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"bad": []})
    assert run("convert", "plans.json", "-o", "p.csv") == 2
    assert only_line(capsys.readouterr().err.split("\n", 1)[1]) == "petmjx: no usable plan (1 skipped)"
