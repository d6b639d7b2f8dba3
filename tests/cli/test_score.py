"""``petmjx score`` from the user's view: its output, its files and its exit codes."""

from __future__ import annotations

import io
import json
import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from support.command_line import TOWER, only_line, placement, run, run_process, run_with_closed, write
from support.interrupted_commands import INTERRUPT_AFTER, run_interrupted

from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.results.run_reader import load_run
from petmjx.world.job import Job


def test_score_says_which_plans_stand(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, "--engine", "mujoco", "--out", tmp_path / "out") == 0
    printed = capsys.readouterr()
    assert "tower" in printed.out
    assert re.search(r"plans\s*│\s*2", printed.out)
    assert "Traceback" not in printed.err
    results = load_run(tmp_path / "out")
    verdicts = results.worlds.set_index("plan_id")["verdict"].to_dict()
    assert verdicts == {"tower": "stable", "overhang": "unstable"}
    assert len(results.boxes) == 4
    assert results.info["status"] == "finished"


def test_options_reach_the_run(plans: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code = run(
        "score", plans, "--engine", "mujoco", "--check", "static", "--schedule", "fixed", "--physics", "reference",
        "--duration", "0.5", "--sample-interval", "0.1", "--size-reduction-mm", "0.2", "--carrier", "euro-pallet",
        "--no-early-stop", "--shift-limit-m", "0.03", "--tilt-limit-deg", "15", "--limit", "1",
        "--threads", "1", "--out", out,
    )  # fmt: skip
    assert code == 0
    info = load_run(out).info
    config = info["config"]
    sim = config["simulation"]
    assert (config["engine"], sim["carrier"], sim["size_reduction_mm"]) == ("mujoco", "euro-pallet", 0.2)
    assert (sim["check"], sim["schedule"], sim["physics"]["name"]) == ("static", "fixed", "reference")
    assert (sim["duration_s"], sim["sample_interval_s"], sim["early_stop"]) == (0.5, 0.1, False)
    assert (sim["thresholds"]["shift_m"], sim["thresholds"]["tilt_deg"]) == (0.03, 15.0)
    assert info["counts"]["worlds"] == 1
    assert {"petmjx", "mujoco", "python"} <= info["versions"].keys() | {"petmjx"}
    assert load_run(out).worlds["n_steps"].tolist() == [250]


def test_score_without_files_takes_the_bundled_samples(
    plans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("petmjx.plans.plan_sources.bundled_path", lambda: plans)
    monkeypatch.chdir(tmp_path)
    assert run("score") == 0
    [folder] = (tmp_path / "petmjx-results").iterdir()
    assert len(load_run(folder).worlds) == 2


def test_json_output(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", plans, "--engine", "mujoco", "--json", "--out", tmp_path / "out") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["counts"]["stable"] == printed["counts"]["unstable"] == 1


def test_a_bad_plan_does_not_stop_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = [placement((0, 0, 0)), placement((0, 0, 200), **{"weight/kg": -1})]
    path = write(tmp_path / "plans.json", {"good": TOWER, "bad": bad})
    assert run("score", path, "--engine", "mujoco", "--out", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert "plan bad, placement 1: weight/kg must be > 0, got -1" in printed
    assert [skipped["plan_id"] for skipped in load_run(tmp_path / "out").info["skipped"]] == ["bad"]

    assert run("score", path, "--strict", "--out", tmp_path / "strict") == 2
    assert "plan bad, placement 1: weight/kg" in only_line(capsys.readouterr().err)
    assert not (tmp_path / "strict").exists()


@pytest.mark.parametrize(
    "content",
    ["", "{", "[]", "null", '{"p": []}', '{"p": [1]}', '{"p": [{"item"', "\x00\x01\x02"],
    ids=["empty", "cut-off", "list", "null", "no-placement", "number", "truncated", "binary"],
)
def test_unusable_files(content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", write(tmp_path / "bad.json", content), "--out", tmp_path / "out") == 2
    assert "bad.json" in only_line(capsys.readouterr().err)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nowhere.json"], "nowhere.json: no such file"),
        (["--engine", "abacus"], "abacus"),
        (["--interval", "0"], "petmjx: --interval must be > 0, got 0"),
        (["--interval", "nan"], "petmjx: --interval must be a finite number, got nan"),
        (["--sample-interval", "0.001"], "petmjx: --sample-interval must be at least the timestep of 0.002 s"),
        (["--interval", "soon"], "--interval"),
        (["--size-reduction-mm", "-1"], "petmjx: --size-reduction-mm must be ≥ 0"),
        (["--check", "foo"], "petmjx: --check must be 'one-by-one' or 'static', got 'foo'"),
        (["--physics", "foo"], "petmjx: --physics must be pallet or reference, or a table of values, got 'foo'"),
        (["--set", "quiet.steps=0"], "petmjx: --set quiet.steps must be ≥ 1, got 0"),
        (["--set", "quiet.steep=1"], "petmjx: --set quiet.steep: unknown field"),
        (
            ["--set", "total_time_factor=4"],
            "petmjx: --set total_time_factor needs check='one-by-one' and schedule='fixed'",
        ),
        (["--set", "plans=x"], "petmjx: --set plans: unknown field; there are check, schedule,"),
        (["--set", "quiet.steps"], "petmjx: --set quiet.steps: must be FIELD=VALUE"),
        (["--set", "=3"], "petmjx: --set =3: must be FIELD=VALUE"),
        (["--size-reduction-mm", "200"], "vanishes under the size reduction"),
        (["--limit", "0"], "--limit"),
        (["--engine", "mujoco", "--lanes", "8"], "lanes are an option of the engines mjx-jax and mjx-warp"),
        (["--shift-limit-m", "-1"], "petmjx: --shift-limit-m must be > 0, got -1"),
        (["--no-such-option"], "--no-such-option"),
        (["--no-such-option"], " score --help)"),
    ],
)
def test_unusable_options(
    arguments: list[str], expected: str, plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [] if arguments[0].endswith(".json") else [plans]
    assert run("score", *files, *arguments, "--out", tmp_path / "out") == 2
    assert expected in only_line(capsys.readouterr().err)


def test_a_folder_with_results_is_not_written_over_unasked(
    plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("score", plans, "--engine", "mujoco", "--limit", "1", "--out", tmp_path / "out")
    assert run(*arguments) == 0
    capsys.readouterr()
    assert run(*arguments) == 2
    assert "--overwrite" in only_line(capsys.readouterr().err)
    assert run(*arguments, "--overwrite") == 0


class _BrokenEngine(MujocoEngine):
    """An engine that scores two worlds and then raises the given error."""

    error: BaseException = RuntimeError("the floor\ncaved in")

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        yield from super().run(jobs[:2], sim, progress)
        raise self.error


@pytest.fixture
def three_plans(tmp_path: Path) -> Path:
    return write(tmp_path / "plans.json", {"a": TOWER, "b": TOWER, "c": TOWER})


def test_a_failure_inside_takes_one_line(
    three_plans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("petmjx.engines.mujoco.engine.MujocoEngine", _BrokenEngine)
    assert run("score", three_plans, "--engine", "mujoco", "--out", tmp_path / "out") == 1
    errors = capsys.readouterr().err
    assert "petmjx: failure inside petmjx: RuntimeError: the floor caved in" in errors
    assert "Traceback" not in errors
    assert load_run(tmp_path / "out").info["status"] == "failed"
    assert run("--debug", "score", three_plans, "--engine", "mujoco", "--out", tmp_path / "debug") == 1
    assert "Traceback" in capsys.readouterr().err


def test_an_interrupted_run_says_how_far_it_came(
    three_plans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(_BrokenEngine, "error", KeyboardInterrupt())
    monkeypatch.setattr("petmjx.engines.mujoco.engine.MujocoEngine", _BrokenEngine)
    assert run("score", three_plans, "--engine", "mujoco", "--out", tmp_path / "out") == 130
    assert f"interrupted: 2 of 3 plans are done and in {tmp_path / 'out'}" in capsys.readouterr().err
    results = load_run(tmp_path / "out")
    assert results.info["status"] == "interrupted"
    assert len(results.worlds) == 2


@pytest.mark.parametrize(
    ("function", "message"),
    [
        ("petmjx.runs.simulate.read_input", "{out} still has the earlier run"),
        ("petmjx.results.run_writer.RunWriter._write_plans", "the earlier run in {out} is deleted"),
    ],
)
def test_an_interrupt_before_the_first_world_says_what_the_folder_has(
    function: str,
    message: str,
    three_plans: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert run("score", three_plans, "--engine", "mujoco", "--out", out) == 0

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(function, interrupted)
    assert run("score", three_plans, "--engine", "mujoco", "--out", out, "--overwrite") == 130
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == f"petmjx: interrupted: before the first plan was finished; {message.format(out=out)}"
    assert (out / "run.json").exists() == ("still" in message)


def test_ctrl_c_leaves_whole_parts(tmp_path: Path) -> None:
    path = write(tmp_path / "plans.json", {f"p{k}": TOWER for k in range(500)})
    out = tmp_path / "out"
    done = run_interrupted("score", path, "--engine", "mujoco", "--out", out)
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert f"interrupted: {INTERRUPT_AFTER} of 500 plans are done and in {out}" in done.stderr
    files = [file for file in out.rglob("*") if file.is_file() and file.name != "run.json"]
    assert {file.suffix for file in files} == {".parquet"}

    def rows(table: str) -> int:
        return sum(pq.read_metadata(file).num_rows for file in files if file.parent.name == table)

    assert (rows("worlds"), rows("boxes")) == (INTERRUPT_AFTER, 2 * INTERRUPT_AFTER)


@pytest.mark.parametrize("command", ["info", "--help"])
def test_a_reader_that_goes_ends_it_quietly(command: str, plans: Path) -> None:
    arguments = [command, plans] if command == "info" else [command]
    reading, writing = os.pipe()
    os.close(reading)  # nobody reads the output, as with `petmjx … | true`
    with os.fdopen(writing, "w") as gone:
        done = run_process(*arguments, stdout=gone)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_run_goes_on_when_nobody_reads_its_progress(plans: Path, tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as gone:
        done = run_process("score", plans, "--engine", "mujoco", "--out", tmp_path / "out", stderr=gone)
    assert done.returncode == 0
    assert "results in" in done.stdout
    assert load_run(tmp_path / "out").info["status"] == "finished"


@pytest.mark.parametrize("closed", [1, 2], ids=["stdout", "stderr"])
def test_closed_streams(closed: int, plans: Path, tmp_path: Path) -> None:
    command = ("score", plans, "--engine", "mujoco", "--json", "--out", tmp_path / "out")
    done = run_with_closed(closed, *command)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert load_run(tmp_path / "out").info["status"] == "finished"
    if closed == 2:
        assert json.loads(done.stdout)["counts"]["worlds"] == 2


def test_a_full_disk_is_said_in_one_line(plans: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with open("/dev/full", "w") as full:
        done = run_process("export", "tower", plans, stdout=full)
    assert done.returncode == 1
    assert "No space left on device" in only_line(done.stderr)


@pytest.mark.parametrize("encoding", ["latin-1", "ascii"])
def test_terminals_without_unicode(encoding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plans = write(tmp_path / "plans.json", {"Turm-塔" * 20: TOWER})
    out, errors = (io.TextIOWrapper(io.BytesIO(), encoding) for _ in range(2))
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", errors)
    monkeypatch.setenv("COLUMNS", "80")
    assert run("score", plans, "--engine", "mujoco", "--out", tmp_path / "out") == 0
    assert run("score", plans, "--size-reduction-mm", "-1") == 2
    for stream in (out, errors):
        stream.seek(0)
    printed = out.read()
    assert "Turm-?" in printed
    assert "~" in printed  # "~" marks a shortened id
    assert all(len(line) <= 80 for line in printed.splitlines() if not line.startswith("results in "))
    assert "petmjx: --size-reduction-mm must be >= 0" in errors.read()


def test_nothing_from_a_file_reaches_the_terminal_raw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nasty = "a\x1b[2J\x9b1m\u202eb\nc[bold]"
    falls = [placement((0, 0, 0)), placement((260, 0, 200), article=nasty)]
    path = write(tmp_path / "plans.json", {nasty: falls, f"{nasty}2": [placement((0, 0, 0), **{"weight/kg": -1})]})
    assert run("score", path, "--engine", "mujoco", "--out", tmp_path / "a") == 0
    assert run("compare", tmp_path / "a", tmp_path / "a") == 0
    assert run("export", nasty, path, "--out", tmp_path / "x.xml") == 0
    printed = capsys.readouterr()
    assert run("export", f"{nasty}3", path) == 2
    errors = only_line(capsys.readouterr().err)
    assert all(char.isprintable() or char == "\n" for char in printed.out + printed.err + errors)
    assert "a\\u001b[2J\\u009b1m\\u202eb\\nc[bold]" in printed.out


def test_any_nested_value_can_be_set(plans: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    settings = ["quiet.steps=30", "physics.timestep_s=0.001", "physics.carrier_friction=[0.4,0.005,0.0001]"]
    options = [part for setting in settings for part in ("--set", setting)]
    more = ("--physics", "reference", "--limit", "1", "--shift-limit-m", "0.03", "--set", "thresholds={tilt_deg=10}")
    assert run("score", plans, "--engine", "mujoco", *options, *more, "--out", out) == 0
    sim = load_run(out).info["config"]["simulation"]
    assert sim["quiet"]["steps"] == 30
    assert (sim["physics"]["name"], sim["physics"]["cone"], sim["physics"]["timestep_s"]) == (
        "custom", "pyramidal", 0.001,
    )  # fmt: skip
    assert sim["physics"]["carrier_friction"] == [0.4, 0.005, 0.0001]
    assert (sim["thresholds"]["shift_m"], sim["thresholds"]["tilt_deg"]) == (0.03, 10.0)
