"""``petmjx report``: the page is written, and unusable input gives an error of one line."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from support.command_line import only_line, run
from support.report_runs import scored


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return scored(tmp_path, 4)


def test_a_page_is_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("report", "run", "-o", "it.html") == 0
    assert capsys.readouterr().out == "report in it.html (0.1 MB)\n"
    assert Path("it.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert run("report", "run", "-o", "it.html", "--overwrite", "--plans", "plans.json") == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nowhere",), "nowhere: no such folder"),
        ((".",), "no run of petmjx there"),
        (("run", "run"), "run: named twice"),
        (("run", "-o", "plans.json"), "plans.json: exists already"),
        (("run", "-o", "run"), "run: cannot be written: is a folder"),
        (("run", "-o", "no/it.html"), "no/it.html: cannot be written: no is not a folder"),
        (("run", "--plans", "gone.json"), "gone.json: no such file or folder"),
    ],
)
def test_what_is_unusable_takes_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    assert run("report", *arguments) == 2
    assert words in only_line(capsys.readouterr().err)


def test_a_damaged_part_takes_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    next((folder / "boxes").iterdir()).write_bytes(b"PAR1")
    assert run("report", folder) == 2
    assert "part-00000.parquet: damaged part, it differs from what the run wrote" in only_line(capsys.readouterr().err)


def test_a_full_disk_is_one_line_as_of_kpis(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert run("report", str(folder), "-o", "page.html") == 2
    assert only_line(capsys.readouterr().err) == "petmjx: page.html: cannot be written: No space left on device"
    assert not Path("page.html").exists()
