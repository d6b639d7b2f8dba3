"""Tests of damaged folders of runs. petmjx notices the damage: there is no traceback, and no number changes. Files that
do not belong to the run are not read."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.damaged_runs import fuzz
from support.fake_engine import LargestFirst
from support.plans import make_plan
from support.runs import edit_info

import petmjx

PLANS = [make_plan(name, n) for name, n in (("a", 1), ("b", 2), ("c", 3))]


def test_damaged_folders_give_right_numbers_or_a_line() -> None:
    faults: list[str] = []
    counts = fuzz(30, seed=0, readings=1, told=faults.append)
    assert faults == []
    assert counts["folders"] == 30


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return petmjx.score(PLANS, engine=LargestFirst(), out=tmp_path / "run").path


def test_parts_that_the_run_did_not_list_are_not_read(run: Path) -> None:
    """Parts that the run did not list are not read. Such files are left behind if a run is killed, or put there by
    somebody."""
    worlds = petmjx.load_run(run).worlds
    shutil.copy(run / "worlds/part-00000.parquet", run / "worlds/part-00001.parquet")
    assert petmjx.load_run(run).worlds.equals(worlds)
    petmjx.score(PLANS, engine=LargestFirst(), out=run, resume=True)
    assert [file.name for file in (run / "worlds").iterdir()] == ["part-00000.parquet"]


def test_worlds_that_were_taken_away_are_simulated_again(run: Path) -> None:
    worlds = petmjx.load_run(run).worlds
    (run / "worlds/part-00000.parquet").unlink()
    with pytest.raises(petmjx.InputError, match=r"worlds/part-00000.parquet: missing, though the run wrote it"):
        _ = petmjx.load_run(run).worlds
    assert petmjx.score(PLANS, engine=LargestFirst(), out=run, resume=True).worlds.equals(worlds)


def test_worlds_without_boxes_are_simulated_again(run: Path) -> None:
    """Worlds without boxes are simulated again. An interrupted merge of petmjx 0.2 left such worlds."""
    complete_run = petmjx.load_run(run)
    worlds, boxes = complete_run.worlds, complete_run.boxes
    (run / "boxes/part-00000.parquet").unlink()
    edit_info(run, lambda info: info["parts"]["boxes"].pop("part-00000.parquet"))
    again = petmjx.score(PLANS, engine=LargestFirst(), out=run, resume=True)
    assert again.boxes.equals(boxes)
    assert again.worlds.equals(worlds)
    assert [line for line in again.info["warnings"] if "had no rows in boxes" in line] == [
        f"{len(worlds)} worlds had no rows in boxes, and were simulated again"
    ]


@pytest.mark.parametrize("table", ["worlds", "boxes"])
def test_a_damaged_part_is_named_with_its_cure(table: str, run: Path) -> None:
    results = petmjx.load_run(run)
    boxes, worlds = results.boxes, run / "worlds/part-00000.parquet"
    (run / table / worlds.name).write_bytes(b"PAR1")
    with pytest.raises(petmjx.InputError) as caught:
        getattr(petmjx.load_run(run), table)
    line = str(caught.value)
    assert line.startswith(
        f"{run / table / worlds.name}: damaged part, it differs from what the run wrote; delete {worlds} and"
    )
    assert line.endswith("use resume=True to simulate its worlds again")
    worlds.unlink()
    assert petmjx.score(PLANS, engine=LargestFirst(), out=run, resume=True).boxes.equals(boxes)


def test_of_what_resume_cannot_cure_the_line_says_so(run: Path) -> None:
    (run / "plans/part-00000.parquet").write_bytes(b"PAR1")
    with pytest.raises(petmjx.InputError, match="what the run wrote; simulate the run again, with overwrite=True"):
        _ = petmjx.load_run(run).plans


def test_a_folder_that_is_gone_is_called_so(run: Path) -> None:
    results = petmjx.load_run(run)
    shutil.rmtree(run)
    with pytest.raises(petmjx.InputError, match="the run's folder is gone"):
        _ = results.boxes


def test_runs_of_before_digests_are_refused(run: Path) -> None:
    edit_info(run, lambda info: info.pop("parts"))
    with pytest.raises(
        petmjx.InputError, match=r"run.json: written by petmjx before 0.2, .*: simulate the plans again"
    ):
        petmjx.load_run(run)
