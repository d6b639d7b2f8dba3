"""Options that are typed on the command line: which options contradict one another, and which option an error message
names."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.outcomes import make_plan

import petmjx
from petmjx.cli import main
from petmjx.plans.plan_writer import save_plans


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_plans(make_plan(), "plans.json")


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(arguments) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    return line.strip().removeprefix("petmjx: ")


def test_a_value_is_given_once(capsys: pytest.CaptureFixture[str]) -> None:
    beside = error_of(capsys, "score", "plans.json", "--set", "schedule=fixed", "--schedule", "adaptive")
    assert beside == "--set schedule: is given beside --schedule; drop one of them"
    twice = error_of(capsys, "score", "plans.json", "--set", "schedule=fixed", "--set", "schedule=adaptive")
    assert twice == "--set schedule: is given twice; drop one of them"


@pytest.mark.parametrize(
    ("line", "option", "fault"),
    [
        ('schedule = "bogus"', ("--schedule", "fixed"), "sweep.toml: simulation.schedule must be"),
        ('engine = "mujoco"', ("--engine", "mujoco"), "sweep.toml: simulation.engine: unknown field"),
    ],
)
def test_what_stands_in_a_file_is_blamed_on_the_file(
    line: str, option: tuple[str, str], fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("sweep.toml").write_text(f"[simulation]\n{line}\n")
    assert error_of(capsys, "sweep", "sweep.toml", "plans.json", *option).startswith(fault)


def test_an_option_is_blamed_for_what_it_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert error_of(capsys, "score", "plans.json", "--schedule", "bogus").startswith("--schedule must be")


@pytest.mark.parametrize("arguments", [("score", ""), ("score", "plans.json", "--out", "")])
def test_an_empty_argument_is_no_path(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    line = error_of(capsys, *arguments)
    assert line == f"argument {len(arguments)} is empty; is a shell variable not set?"


def test_plans_of_one_id_are_not_written() -> None:
    plan = make_plan("g")
    with pytest.raises(petmjx.InputError, match=r"^out\.csv: plan g occurs twice$"):
        petmjx.save_plans([plan, plan], "out.csv")
    assert not Path("out.csv").exists()
