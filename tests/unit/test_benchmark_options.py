"""Tests of benchmarks that run in several processes: a wrong option gives a message of one line before anything runs;
and the measured memory is that of all processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support.command_line import only_line

from benchmarks import stage_times
from benchmarks.__main__ import main
from benchmarks.all_memory import memory_of_all


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--placing", "thrown"], "placing"),
        (["--engine", "abacus"], "unknown engine"),
        (["--keep", "nothing"], "keep"),
        (["--threads", "0"], "threads"),
        (["--workers", "0"], "workers"),
        (["--engine", "mjx-warp", "--threads", "2"], "threads"),
    ],
)
def test_bad_options_of_a_million_worlds(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["million", str(tmp_path / "run"), *options, "--out", str(tmp_path / "out.jsonl")]) == 2
    assert words in only_line(capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_a_million_worlds_need_a_folder(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert main(["million", str(tmp_path / "file"), "--out", str(tmp_path / "out.jsonl")]) == 2
    assert only_line(capsys.readouterr().err).endswith("file: cannot be written (File exists)")


def test_a_run_that_fails_from_shell_to_shell(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["shell", str(tmp_path / "missing.json")])
    with pytest.raises(SystemExit) as ended:
        stage_times.main()
    assert ended.value.code == 2
    assert only_line(capsys.readouterr().err).endswith("missing.json: no such file or folder")


@pytest.mark.skipif(not Path("/proc/self/smaps_rollup").exists(), reason="the system does not tell")
def test_memory_of_processes_that_were_started_counts() -> None:
    held = 40 << 20
    child = f"held = b'x' * {held}; print('held', flush=True); input()"
    parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    # in a new process, since the memory of this process may change during the measurement
    with subprocess.Popen([sys.executable, "-c", parent], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with_child = memory_of_all(process.pid)
        process.communicate(b"\n")
    assert with_child is not None
    assert held < with_child < 4 * held
