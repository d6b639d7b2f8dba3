"""The option ``--orders``: printed tables, JSON, and the error of one line for an unusable file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.command_line import TOWER, only_line, placement, run, write
from support.fake_engine import end_without_physics

from petmjx.engines.mujoco.world_run import WorldRun

FAST = ("--engine", "mujoco", "--check", "static", "--duration", "0.05")


def order(*articles: str) -> dict[str, object]:
    items = {str(k): placement((0, 0, 0), article=article)["item"] for k, article in enumerate(articles, 1)}
    return {"item_sequence": items, "properties": {"target": "euro-pallet"}}


@pytest.fixture
def plans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write(Path("plans.json"), {"full": TOWER, "short": TOWER, "own": TOWER})


@pytest.fixture
def orders(plans: Path) -> Path:
    full, short = order("carton", "carton"), order("carton", "jam", "jam")
    return write(Path("orders.json"), {"full": full, "short": short, "lost": full, "bad": 5})


def lines_of(text: str) -> list[str]:
    return [" ".join(line.split()) for line in text.splitlines()]


def test_a_score_says_what_is_left_out(plans: Path, orders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, "--orders", orders, *FAST, "-o", "out") == 0
    lines = lines_of(capsys.readouterr().out)
    assert lines[:2] == ["left at shift tilt rest", "plan boxes out verdict reason margin first box s mm ° force N"]
    assert [line.split()[:4] for line in lines[2:5]] == [
        ["full", "2", "0", "stable"],
        ["own", "2", "-", "stable"],
        ["short", "2", "2", "stable"],
    ]
    assert "not compared: orders.json: order bad: must be an object, got 5" in lines
    assert (
        "1 plan leaves out 2 of 5 ordered boxes; 1 order (2 boxes) has no usable plan; 1 box in plans was not ordered; "
        "1 plan has no order, in run.json"
    ) in lines
    assert "stable │ 3 │ 100.0 %" in " ".join(lines)


def test_json_has_counts_and_names(plans: Path, orders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, "--orders", orders, *FAST, "-o", "out", "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["counts"]["orders"]["left_out"] == 2
    assert printed["orders"]["without_plan"] == ["lost"]
    assert printed["orders"]["plans"] == [
        "plan short: 2 of 3 ordered boxes are left out (2 × jam (1)); 1 box was not ordered (1 × carton (1))"
    ]


def test_plans_that_leave_out_nothing(plans: Path, capsys: pytest.CaptureFixture[str]) -> None:
    full = order("carton", "carton")
    orders = write(Path("orders.json"), {"full": full, "short": full, "own": full, "later": full})
    assert run("score", plans, "--orders", orders, *FAST, "-o", "out", "--limit", "3") == 0
    lines = lines_of(capsys.readouterr().out)
    assert "plans leave out none of 6 ordered boxes" in lines
    assert "orders without a plan are not counted with --limit: not all plans were read" in lines


def test_sweep_and_merge_say_it_too(plans: Path, orders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(Path("friction.toml"), "[axes]\nmass_factor = [0.8, 1.0]\n")
    for number in (1, 2):
        shard = ("--shard", f"{number}/2", "-o", f"shard-{number}")
        assert run("sweep", file, plans, "--orders", orders, *FAST, *shard) == 0
    capsys.readouterr()
    assert run("merge", "shard-1", "shard-2", "-o", "out") == 0
    printed = capsys.readouterr().out
    assert "1 plan leaves out 2 of 5 ordered boxes; 1 order (2 boxes) has no usable plan" in printed


def test_without_orders_nothing_is_said(plans: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, *FAST, "-o", "out") == 0
    assert "order" not in capsys.readouterr().out
    assert "order" not in Path("out/run.json").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("{}", "orders.json: holds no order"),
        (
            '{"a": {}}',
            "no usable order (1 unusable); the first: orders.json: order a: properties.target must be",
        ),
        ('{"a": {', "orders.json: not JSON at line 1, column 8 (the file ends too early; truncated?)"),
        ('{"item_sequence": {', "order item_sequence: not JSON at line 1, column 20 (the file ends inside this order"),
        (json.dumps({"a": []}), "the first: orders.json: order a: must be an object, got a list"),
        (json.dumps({"a": 5, "b": TOWER}), "no usable order (2 unusable); the first: orders.json: order a: must be"),
    ],
)
def test_an_unusable_file_is_one_line(plans: Path, text: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, "--orders", write(Path("orders.json"), text), *FAST, "-o", "out") == 2
    assert line in only_line(capsys.readouterr().err)
    assert not Path("out").exists()


def test_a_file_that_is_not_there_and_strict(plans: Path, orders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, "--orders", "none.json", *FAST, "-o", "out") == 2
    assert only_line(capsys.readouterr().err) == "petmjx: none.json: cannot be read: No such file or directory"
    assert run("score", plans, "--orders", orders, *FAST, "-o", "out", "--strict") == 2
    assert only_line(capsys.readouterr().err) == "petmjx: orders.json: order bad: must be an object, got 5"


def test_real_plans_and_orders(
    real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(WorldRun, "run", end_without_physics)
    files = (real_data / "packing_plan_5-bed-bpp.json", "--orders", real_data / "5_bed-bpp.json")
    assert run("score", *files, *FAST, "-o", tmp_path / "out") == 0
    assert "3 plans leave out 11 of 200 ordered boxes, in run.json" in capsys.readouterr().out
