"""Tests of folders of runs. Only one run at a time writes into a folder, and petmjx replaces or deletes only its own
files."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from support.outcomes import make_outcome, make_plan
from support.waiting import wait_for

from petmjx.cli.run_command import folder_of_run
from petmjx.common.errors import InputError, PetmjxError
from petmjx.results import folder_lock, result_files
from petmjx.results.folder_lock import LOCK_FILE, held_folder_lock
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter


def write_run(folder: Path, *ids: str, **options: Any) -> None:
    with RunWriter(folder, {}, **options) as run:
        for plan_id in ids or ("a", "b"):
            run.add(make_plan(plan_id), 0, "fixed", make_outcome())


def test_a_second_run_into_the_same_folder_is_refused(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}) as run:
        run.add(make_plan("a"), 0, "fixed", make_outcome())
        with pytest.raises(InputError, match=rf"{tmp_path}: another run \(process {os.getpid()}\) is writing there"):
            write_run(tmp_path, overwrite=True)
    assert load_run(tmp_path).worlds.plan_id.tolist() == ["a"]
    assert not (tmp_path / LOCK_FILE).exists()
    write_run(tmp_path, "c", overwrite=True)


def test_of_a_hundred_runs_at_once_one_writes(tmp_path: Path) -> None:
    start, over = threading.Barrier(101), threading.Event()

    def attempt(_: int) -> str:
        start.wait()
        try:
            with held_folder_lock(tmp_path):
                over.wait(30)
            return "wrote"
        except InputError:
            return "refused"

    with ThreadPoolExecutor(101) as pool:
        attempts = [pool.submit(attempt, number) for number in range(101)]
        try:
            wait_for(lambda: sum(future.done() for future in attempts) == 100)
        finally:
            over.set()
        answers = [future.result() for future in attempts]
    assert sorted(answers) == ["refused"] * 100 + ["wrote"]


def test_the_lock_is_held_by_one_at_any_time_while_it_is_taken_and_removed(tmp_path: Path) -> None:
    inside, most, lock_of_count = 0, 0, threading.Lock()

    def often(_: int) -> None:
        nonlocal inside, most
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            try:
                with held_folder_lock(tmp_path):
                    with lock_of_count:
                        inside += 1
                        most = max(most, inside)
                    with lock_of_count:
                        inside -= 1
            except InputError:
                pass

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(often, range(8)))
    assert most == 1


HOLD = """
import os, signal, sys
from pathlib import Path
from petmjx.results.folder_lock import held_folder_lock
with held_folder_lock(Path(sys.argv[1])):
    print("held", flush=True)
    signal.pause()
"""


def test_the_lock_dies_with_its_process(tmp_path: Path, repository: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {holder.pid}"):
            write_run(tmp_path)
        holder.kill()
    assert (tmp_path / LOCK_FILE).exists()
    write_run(tmp_path)
    assert not (tmp_path / LOCK_FILE).exists()


def test_a_file_system_without_locks_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: Any) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(folder_lock.fcntl, "flock", none)
    write_run(tmp_path)
    assert "has no locks" in load_run(tmp_path).info["warnings"][0]


def test_new_folders_of_one_second_differ_and_go_if_they_stay_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with ExitStack() as runs:
        with ThreadPoolExecutor(8) as pool:
            folders = list(pool.map(lambda _: runs.enter_context(folder_of_run({})), range(20)))
        assert len(set(folders)) == 20
        assert all(folder.is_dir() for folder in folders)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("name", ["worlds", "boxes", "worlds/part-00000.parquet", "run.json", "summary"])
def test_links_are_refused(name: str, tmp_path: Path) -> None:
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    write_run(run)
    elsewhere.mkdir()
    (elsewhere / "part-00000.parquet").write_text("mine")
    path = run / name
    if path.exists():
        path.rename(tmp_path / "away")
    path.symlink_to(elsewhere / "part-00000.parquet" if path.suffix else elsewhere)
    with pytest.raises(InputError, match=f"{path}: is a link"):
        write_run(run, overwrite=True)
    assert (elsewhere / "part-00000.parquet").read_text() == "mine"


@pytest.mark.parametrize("kind", ["file", "hard link", "link", "folder", "fifo"])
def test_what_has_the_name_of_the_lock_is_neither_written_nor_taken_away(kind: str, tmp_path: Path) -> None:
    mine, lock = tmp_path / "mine", tmp_path / "run/.lock"
    mine.write_text("mine")
    lock.parent.mkdir()
    make = {"file": lambda: lock.write_text("mine"), "hard link": lambda: lock.hardlink_to(mine)}
    make |= {"link": lambda: lock.symlink_to(mine), "folder": lock.mkdir, "fifo": lambda: os.mkfifo(lock)}
    make[kind]()
    with pytest.raises(InputError, match=r"run/\.lock: was not made by petmjx"), RunWriter(lock.parent, {}):
        pass
    assert mine.read_text() == "mine"
    assert [file.name for file in lock.parent.iterdir()] == [".lock"]
    assert kind not in ("file", "hard link") or lock.read_text() == "mine"


def test_overwriting_takes_away_nothing_of_others(tmp_path: Path) -> None:
    write_run(tmp_path, "a", "b", worlds_per_part=1)
    others = [tmp_path / "notes.txt", tmp_path / "worlds/part-of-mine.parquet", tmp_path / "worlds/.part.tmp"]
    for file in others:
        file.write_text("mine")
    (tmp_path / f"worlds/.part-00007.parquet.{'0' * 32}.tmp").write_text("of a run that was killed")
    write_run(tmp_path, "c", overwrite=True)
    assert [file.read_text() for file in others] == ["mine"] * 3
    assert sorted(file.name for file in (tmp_path / "worlds").iterdir()) == [
        ".part.tmp", "part-00000.parquet", "part-of-mine.parquet"
    ]  # fmt: skip


def test_parts_without_run_json_are_not_mixed_with_a_new_run(tmp_path: Path) -> None:
    """Parts without ``run.json`` are left behind if overwriting is interrupted. A new run does not mix with them."""
    write_run(tmp_path, "a", "b", worlds_per_part=1)
    (tmp_path / "run.json").unlink()
    for file in tmp_path.glob("worlds/*"):
        file.unlink()
    for resume in (False, True):
        with pytest.raises(InputError, match="holds tables of a run without its run"):
            write_run(tmp_path, "c", resume=resume)
    write_run(tmp_path, "c", overwrite=True)
    assert [file.name for file in tmp_path.glob("boxes/*")] == ["part-00000.parquet"]


def test_temporary_files_cannot_be_planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    monkeypatch.setattr(result_files.secrets, "token_hex", lambda n: "0" * 2 * n)
    (tmp_path / f".x.{'0' * 32}.tmp").symlink_to(victim)
    with pytest.raises(FileExistsError):
        result_files.write_text("theirs", tmp_path / "x")
    assert victim.read_text() == "mine"


def test_a_folder_that_vanishes_ends_the_run_in_one_line(tmp_path: Path) -> None:
    folder = tmp_path / "run"

    def vanish() -> None:
        with RunWriter(folder, {}) as run:
            folder.rename(tmp_path / "away")
            run.add(make_plan(), 0, "fixed", make_outcome())

    with pytest.raises(PetmjxError, match="cannot write results: No such file"):
        vanish()
    assert not folder.exists()


def test_a_disk_that_is_full_for_run_json_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    def fill() -> None:
        with RunWriter(tmp_path, {}) as run:
            run.add(make_plan(), 0, "fixed", make_outcome())
            monkeypatch.setattr(result_files.os, "fsync", full)

    with pytest.raises(PetmjxError, match="cannot write results: No space"):
        fill()


def test_a_part_that_was_taken_away_is_named(tmp_path: Path) -> None:
    write_run(tmp_path, "a", "b", "c", worlds_per_part=1)
    (tmp_path / "worlds/part-00001.parquet").rename(tmp_path / "away")
    with pytest.raises(InputError, match=r"worlds/part-00001.parquet: missing, though the run wrote it"):
        _ = load_run(tmp_path).worlds
