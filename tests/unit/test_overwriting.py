"""Output files of commands: no existing file is replaced without --overwrite, and no file that the command reads is
ever replaced."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.outcomes import make_plan

from petmjx.cli import main
from petmjx.plans.plan_writer import save_plans

WRITERS = {
    "convert": ["convert", "plans.json", "--out"],
    "samples": ["samples", "-n", "1", "--workers", "1", "--out"],
    "export": ["export", "00000001", "plans.json", "--out"],
    "show": ["show", "00000001", "plans.json", "--engine", "mujoco", "--html"],
}
ENDINGS = {"convert": "csv", "samples": "json", "export": "xml", "show": "html"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    save_plans(make_plan(), "plans.json")
    return tmp_path


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_there_is_replaced_only_if_asked(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = f"out.{ENDINGS[name]}"
    Path(out).write_text("mine")
    assert main([*WRITERS[name], out]) == 2
    assert capsys.readouterr().err == f"petmjx: {out}: exists already; name another file, or pass --overwrite\n"
    assert Path(out).read_text() == "mine"
    assert main([*WRITERS[name], out, "--overwrite"]) == 0
    assert Path(out).read_text() != "mine"


@pytest.mark.parametrize("name", ["convert", "export"])
@pytest.mark.parametrize("out", ["plans.json", "link.json", "./plans.json"])
def test_what_is_read_is_never_replaced(name: str, out: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = Path("plans.json").read_bytes()
    Path("link.json").symlink_to("plans.json")
    assert main([*WRITERS[name], out, "--overwrite"]) == 2
    assert "is an input, so it cannot be written" in capsys.readouterr().err
    assert Path("plans.json").read_bytes() == before


def test_a_file_in_a_folder_that_is_read_is_not_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", ".", "--out", "plans.json", "--overwrite"]) == 2
    assert "plans.json: is an input" in capsys.readouterr().err


def test_standard_output_may_be_written(folder: Path) -> None:
    assert main(["export", "00000001", "plans.json", "--out", "/dev/stdout"]) == 0


@pytest.mark.parametrize("options", [(), ("--resume",)])
def test_tables_without_a_run_are_neither_resumed_nor_replaced(
    options: tuple[str, ...], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "run" / "worlds").mkdir(parents=True)
    part = folder / "run" / "worlds" / "part-00000.parquet"
    part.write_bytes(b"mine")
    for overwrite in ((), ("--overwrite",)):
        assert main(["score", "plans.json", "--out", "run", *(overwrite or options)]) == 2
        assert f"{part.relative_to(folder)}: was not written by petmjx" in capsys.readouterr().err
        assert part.read_bytes() == b"mine"
    part.unlink()
    assert main(["score", "plans.json", "--out", "run", "--engine", "mujoco"]) == 0
    (folder / "run" / "run.json").unlink()
    before = part.read_bytes()
    capsys.readouterr()
    assert main(["score", "plans.json", "--out", "run", *options]) == 2
    assert "run: holds tables of a run without its run.json, so that it cannot be resumed; " in capsys.readouterr().err
    assert part.read_bytes() == before
    assert main(["score", "plans.json", "--out", "run", "--engine", "mujoco", "--overwrite"]) == 0
