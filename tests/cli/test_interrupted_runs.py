"""How runs end after a signal, and how they are continued or joined: --resume, --shard and merge."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest
from support.command_line import OVERHANG, TOWER, only_line, run, write
from support.interrupted_commands import INTERRUPT_AFTER, run_interrupted
from support.outcomes import make_outcome, make_plan

from petmjx.results import result_files
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter


@pytest.fixture
def plans(tmp_path: Path) -> Path:
    return write(tmp_path / "plans.json", {f"p{k}": TOWER if k % 2 else OVERHANG for k in range(6)})


@pytest.mark.parametrize(
    ("signals", "code"),
    [
        ([signal.SIGTERM], 143),
        ([signal.SIGHUP], 129),
        ([signal.SIGINT] * 6, 130),
        ([signal.SIGTERM, signal.SIGINT, signal.SIGHUP] * 2, 143),
    ],
)
def test_signals_end_a_run_once_and_lose_nothing(signals: list[int], code: int, tmp_path: Path) -> None:
    path = write(tmp_path / "plans.json", {f"p{k}": TOWER for k in range(300)})
    out = tmp_path / "out"
    done = run_interrupted("score", path, "--engine", "mujoco", "--out", out, signals=signals)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert f"interrupted: {INTERRUPT_AFTER} of 300 plans are done and in {out}" in done.stderr
    results = load_run(out)
    assert (results.info["status"], len(results.worlds)) == ("interrupted", INTERRUPT_AFTER)


def test_ctrl_c_in_the_end_is_put_off_until_the_last_part_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C is also put off in runs from Python, where only the writer defers signals."""
    real = os.replace

    def replace(source: Path, target: Path) -> None:
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
        real(source, target)

    def end_under_fire() -> None:
        with RunWriter(tmp_path, {}) as writer:
            writer.add(make_plan("a"), 0, "fixed", make_outcome())
            monkeypatch.setattr(result_files.os, "replace", replace)

    with pytest.raises(KeyboardInterrupt):
        end_under_fire()
    assert (load_run(tmp_path).info["status"], len(load_run(tmp_path).worlds)) == ("finished", 1)


def test_an_interrupted_run_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "plans.json", {f"p{k}": TOWER for k in range(20)})
    out = tmp_path / "out"
    assert run_interrupted("score", path, "--engine", "mujoco", "--out", out, "--resume").returncode == 130
    assert run("score", path, "--engine", "mujoco", "--out", out, "--resume") == 0
    stderr = capsys.readouterr().err
    assert f"{INTERRUPT_AFTER} plans of an earlier run are already in the folder" in stderr
    assert "10 of 10 plans" in stderr
    assert run("score", path, "--engine", "mujoco", "--out", tmp_path / "whole") == 0
    left, right = (
        load_run(folder).worlds.sort_values("plan_id", ignore_index=True) for folder in (out, tmp_path / "whole")
    )
    assert left.equals(right)


def test_another_run_is_not_gone_on_with(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("score", plans, "--engine", "mujoco", "--out", tmp_path / "out")
    assert run(*arguments) == 0
    capsys.readouterr()
    assert run(*arguments, "--resume", "--rest", "2") == 2
    line = only_line(capsys.readouterr().err)
    assert line.endswith("cannot be resumed, because the folder has another run (simulation.rest_s is 2.0, was 1.0)")
    assert run("score", plans, "--engine", "mujoco", "--resume") == 2
    assert "--resume needs the option out" in only_line(capsys.readouterr().err)
    assert run("score", plans, "--engine", "mujoco", "--shard", "4/3") == 2
    assert "--shard must be I/N" in only_line(capsys.readouterr().err)


def test_shards_are_merged(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [tmp_path / str(number) for number in (1, 2)]
    for number, folder in enumerate(folders, 1):
        assert run("score", plans, "--engine", "mujoco", "--out", folder, "--shard", f"{number}/2") == 0
    capsys.readouterr()
    assert run("merge", folders[0], "--out", tmp_path / "all") == 2
    assert only_line(capsys.readouterr().err) == "petmjx: missing: shard 2/2"
    assert run("merge", *folders, "--out", tmp_path / "all", "--json") == 0
    assert json.loads(capsys.readouterr().out)["counts"]["worlds"] == 6
    assert run("merge", *folders, "--out", tmp_path / "all") == 2
    assert "holds a run already" in only_line(capsys.readouterr().err)
    assert run("merge", *folders, "--out", tmp_path / "all", "--overwrite") == 0
    assert "6" in capsys.readouterr().out


def test_a_run_that_does_not_begin_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("score", write(tmp_path / "bad.json", "{}"), "--engine", "mujoco") == 2
    assert not (tmp_path / "petmjx-results").exists()
