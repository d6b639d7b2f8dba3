"""Parts (files) of a run's tables appear completely or not at all, whatever ends the run."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from support.outcomes import make_outcome, make_plan
from support.waiting import wait_for
from test_results import part_files, write_run

from petmjx.common.errors import InputError, PetmjxError
from petmjx.results import result_files, run_writer, table_parts
from petmjx.results.plan_digests import records_of
from petmjx.results.run_json import write_run_file
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.results.world_rows import ROW_BYTES, Part


def worlds_on_disk(folder: Path) -> int:
    """Number of worlds on disk, by run.json."""
    n_worlds: int = json.loads((folder / "run.json").read_text())["counts"]["worlds"]
    return n_worlds


class Holding:
    """Delays the writing of tables until ``let_go`` is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.let_go = threading.Event()
        write = result_files.pq.write_table

        def late(*args: Any, **options: Any) -> None:
            assert self.let_go.wait(20)
            write(*args, **options)

        monkeypatch.setattr(result_files.pq, "write_table", late)


def full_once(monkeypatch: pytest.MonkeyPatch, after_s: float = 0.0) -> Iterator[int]:
    """The first table that is written fails because the disk is full. Returns a counter of written tables."""
    real, calls = result_files.pq.write_table, itertools.count()

    def write_table(*args: Any, **options: Any) -> None:
        if next(calls) == 0:
            time.sleep(after_s)
            raise OSError(28, "No space left on device")
        real(*args, **options)

    monkeypatch.setattr(result_files.pq, "write_table", write_table)
    return calls


def add_worlds(run: RunWriter, *ids: str | int) -> None:
    for plan_id in ids:
        run.add(make_plan(str(plan_id)), 0, "fixed", make_outcome())


def test_parts_stream_and_run_json_follows(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}, worlds_per_part=2, expected_worlds=5) as run:
        assert json.loads((tmp_path / "run.json").read_text())["status"] == "running"
        for number in range(5):
            add_worlds(run, number)
            written = (number + 1) // 2 * 2
            wait_for(lambda: worlds_on_disk(tmp_path) == written)  # noqa: B023 - called at once
            assert run.info["counts"]["worlds"] == written
    assert [file for file in part_files(tmp_path) if file.startswith("worlds")] == [
        f"worlds/part-0000{number}.parquet" for number in range(3)
    ]
    assert load_run(tmp_path).worlds.plan_id.tolist() == list("01234")


def test_worlds_are_gathered_while_a_part_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    holding = Holding(monkeypatch)
    with RunWriter(tmp_path, {}, worlds_per_part=2) as run:
        add_worlds(run, 0, 1, 2)
        assert worlds_on_disk(tmp_path) == 0
        holding.let_go.set()
        run.flush()
        assert worlds_on_disk(tmp_path) == 3
    assert load_run(tmp_path).worlds.plan_id.tolist() == list("012")


def test_every_part_is_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Worlds end in another order than that of the plans. The rows of each part are sorted, and ranks sort the rows of
    all parts."""
    written: list[str] = []
    write = table_parts.write_table

    def noted(table: Any, path: Path) -> str:
        written.append(str(path.relative_to(tmp_path)))
        return write(table, path)

    monkeypatch.setattr(table_parts, "write_table", noted)
    manifest = Manifest({"command": "score"}, records_of([make_plan(plan_id) for plan_id in "cabed"]))
    with RunWriter(tmp_path, {}, manifest=manifest, variants=range(1), worlds_per_part=2) as run:
        add_worlds(run, *"decab")
        run.flush()
    assert sorted(written) == [
        "boxes/part-00000.parquet", "boxes/part-00001.parquet", "boxes/part-00002.parquet", "plans/part-00000.parquet",
        "worlds/part-00000.parquet", "worlds/part-00001.parquet", "worlds/part-00002.parquet",
    ]  # fmt: skip
    read = pd.read_parquet(tmp_path / "worlds")
    assert read.plan_id.tolist() == ["e", "d", "c", "a", "b"]
    assert read["rank"].tolist() == [3, 4, 0, 1, 2]
    assert read["rank"].dtype == "int64"
    assert load_run(tmp_path).worlds.plan_id.tolist() == list("cabed")
    boxes = pd.read_parquet(tmp_path / "boxes")
    assert boxes["rank"].tolist() == [rank for rank in (3, 4, 0, 1, 2) for _ in range(3)]
    assert "rank" not in load_run(tmp_path).boxes


def test_what_waits_is_written_in_time_though_the_engine_is_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time to the next part is counted from the moment when the first world began to wait, whatever is added
    later."""
    with RunWriter(tmp_path, {}, seconds_per_part=0.5) as run:
        begin = time.monotonic()
        add_worlds(run, 0)
        while worlds_on_disk(tmp_path) == 0:
            assert time.monotonic() - begin < 20
            add_worlds(run, f"more-{time.monotonic()}")
            time.sleep(0.05)
        assert time.monotonic() - begin >= 0.5
        add_worlds(run, "last")
        run.flush()
        on_disk = worlds_on_disk(tmp_path)
        add_worlds(run, "late")
        wait_for(lambda: worlds_on_disk(tmp_path) == on_disk + 1)


def test_adding_waits_while_too_many_worlds_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Because the run waits for the writer, memory is bounded, however slow the disk is."""
    monkeypatch.setattr(run_writer, "MOST_WAITING_BYTES", 4 * ROW_BYTES)
    holding = Holding(monkeypatch)
    added: list[int] = []

    def add_all() -> None:
        for number in range(8):
            add_worlds(run, number)
            added.append(number)

    with RunWriter(tmp_path, {}, worlds_per_part=2) as run:
        adder = threading.Thread(target=add_all)
        adder.start()
        wait_for(lambda: len(added) >= 4)
        time.sleep(0.1)
        assert len(added) == 4
        holding.let_go.set()
        adder.join(20)
        assert len(added) == 8
    assert load_run(tmp_path).worlds.plan_id.tolist() == list("01234567")


def test_the_thread_ends_with_the_run(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run", {}) as run:
        add_worlds(run, 0)
        assert "petmjx-writer" in {thread.name for thread in threading.enumerate()}
    with pytest.raises(InputError), RunWriter(tmp_path / "run", {}):
        pass
    assert "petmjx-writer" not in {thread.name for thread in threading.enumerate()}
    write_run(tmp_path / "run", overwrite=True)  # the folder is not locked any more


def test_run_json_says_finished_when_all_worlds_are_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    statuses = []

    def noted(entries: dict[str, Any], folder: Path) -> None:
        statuses.append((entries["status"], entries["counts"]["worlds"]))
        write_run_file(entries, folder)

    monkeypatch.setattr(run_writer, "write_run_file", noted)
    write_run(tmp_path, ids=("0", "1", "2"), worlds_per_part=2)
    assert statuses == [("running", 0), ("running", 2), ("running", 3), ("finished", 3)]


def test_ctrl_c_keeps_whole_parts_and_says_how_many(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path, ids=("0", "1", "2"), end=KeyboardInterrupt(), worlds_per_part=2)
    results = load_run(tmp_path)
    assert results.info["status"] == "interrupted"
    assert results.info["counts"]["worlds"] == len(results.worlds) == 3
    assert len(results.boxes) == 9


def test_ctrl_c_while_the_rest_is_written_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first interrupt comes while the run waits for the writer, further interrupts while the run ends."""
    holding = Holding(monkeypatch)
    timers = [threading.Timer(delay_s, signal.raise_signal, [signal.SIGINT]) for delay_s in (0.3, 0.5, 0.6)]
    timers.append(threading.Timer(0.8, holding.let_go.set))
    for timer in timers:
        timer.start()
    with pytest.raises(KeyboardInterrupt):
        write_and_flush(tmp_path)
    assert_has_whole(tmp_path, 2)


def test_ctrl_c_while_adding_waits_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_writer, "MOST_WAITING_BYTES", 4 * ROW_BYTES)
    holding = Holding(monkeypatch)
    timers = [threading.Timer(0.3, signal.raise_signal, [signal.SIGINT]), threading.Timer(0.6, holding.let_go.set)]
    for timer in timers:
        timer.start()
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path, ids=tuple("01234567"), worlds_per_part=2)
    assert_has_whole(tmp_path, 4)


def test_ctrl_c_while_a_run_begins_leaves_the_folder_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, let_go = threading.Event(), threading.Event()
    check_run_folder = run_writer.check_run_folder

    def held_up(*arguments: Any) -> None:
        begun.set()
        assert let_go.wait(20)
        check_run_folder(*arguments)

    def interrupt() -> None:
        begun.wait(20)
        signal.raise_signal(signal.SIGINT)
        let_go.set()

    monkeypatch.setattr(run_writer, "check_run_folder", held_up)
    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path)
    monkeypatch.undo()
    assert load_run(tmp_path).info["status"] == "running"
    write_run(tmp_path, overwrite=True)


def test_a_run_whose_end_was_interrupted_ends_with_the_process(tmp_path: Path) -> None:
    """If the writer's thread has ended, the process does not wait for its answer."""
    run = RunWriter(tmp_path, {}).__enter__()
    add_worlds(run, 0, 1)
    run._end_at_exit()
    assert_has_whole(tmp_path, 2)
    with pytest.raises(run_writer._CutShortError):
        run.flush()


def write_and_flush(folder: Path) -> None:
    with RunWriter(folder, {}) as run:
        add_worlds(run, 0, 1)
        run.flush()


def assert_has_whole(folder: Path, worlds: int) -> None:
    """Check that an interrupted run has this number of worlds, each world once."""
    results = load_run(folder)
    numbers = [str(number) for number in range(worlds)]
    assert results.worlds.plan_id.tolist() == numbers
    assert results.boxes.plan_id.tolist() == [number for number in numbers for _ in range(3)]
    assert (results.info["status"], results.info["counts"]["worlds"]) == ("interrupted", worlds)


def test_an_error_in_the_body_is_told(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError):
        write_run(tmp_path, ids=("a",), end=RuntimeError("the engine\nbroke"))
    info = load_run(tmp_path).info
    assert (info["status"], info["error"], info["counts"]["worlds"]) == ("failed", "RuntimeError: the engine broke", 1)


def test_a_merge_that_is_cut_short_counts_whole_runs_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, ids in (("one", "ab"), ("two", "cd")):
        write_run(tmp_path / name, ids=tuple(ids))
    copy = table_parts.copy_file

    def cut_short(file: Path, place: Path) -> str:
        if file.is_relative_to(tmp_path / "two/boxes"):
            raise KeyboardInterrupt
        return copy(file, place)

    def merge() -> None:
        with RunWriter(tmp_path / "merged", {}) as run:
            for name in ("one", "two"):
                run.adopt(load_run(tmp_path / name).parts, ranked=True)

    monkeypatch.setattr(table_parts, "copy_file", cut_short)
    with pytest.raises(KeyboardInterrupt):
        merge()
    merged = load_run(tmp_path / "merged")
    assert merged.info["counts"]["worlds"] == 2
    assert merged.worlds.plan_id.tolist() == merged.boxes.plan_id.unique().tolist() == ["a", "b"]


def test_an_error_of_another_kind_in_the_last_part_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_room(*_: Any) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(Part, "worlds", no_room)
    with pytest.raises(MemoryError):
        write_run(tmp_path)
    info = load_run(tmp_path).info
    assert (info["status"], info["error"], info["counts"]["worlds"]) == ("failed", "MemoryError: no room", 0)


def test_a_disk_that_was_full_for_a_while_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with RunWriter(tmp_path, {}, seconds_per_part=0.05) as run:
        calls = full_once(monkeypatch)
        run.add(make_plan(), 0, "fixed", make_outcome())
        wait_for(lambda: worlds_on_disk(tmp_path))
    assert next(calls) > 1


def test_a_run_file_that_could_not_be_written_is_written_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The part is on disk, but run.json could not be written. The file run.json is written later, although no further
    world ends."""
    failures = [OSError(28, "No space left on device")] * 2

    def failing(entries: dict[str, Any], folder: Path) -> None:
        if failures:
            raise failures.pop()
        write_run_file(entries, folder)

    with RunWriter(tmp_path, {}, seconds_per_part=0.05) as run:
        monkeypatch.setattr(run_writer, "write_run_file", failing)
        run.add(make_plan(), 0, "fixed", make_outcome())
        wait_for(lambda: worlds_on_disk(tmp_path) == 1)
    assert not failures


def test_rows_that_cannot_be_packed_keep_no_others_from_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The writer tries these rows again. If the run ends without them, run.json reports this."""
    tables = Part.tables

    def packed(part: Part, schemas: Any) -> Any:
        if any(row.plan.plan_id == "2" for row in part.rows):
            raise ValueError("odd")
        return tables(part, schemas)

    monkeypatch.setattr(Part, "tables", packed)
    with pytest.raises(ValueError, match="odd"):
        write_run(tmp_path, ids=tuple("0123456"), worlds_per_part=2)
    results = load_run(tmp_path)
    assert {*results.worlds.plan_id} >= {"0", "1", "4", "5", "6"}
    assert (results.info["status"], results.info["error"]) == ("failed", "ValueError: odd")
    assert results.info["counts"]["worlds"] == len(results.worlds)


def test_a_run_ends_once(tmp_path: Path) -> None:
    """The end of a run is written only once, because another run may use the folder afterwards."""
    with RunWriter(tmp_path, {}) as run:
        run.add(make_plan("mine"), 0, "fixed", make_outcome())
    write_run(tmp_path, ids=("theirs",), overwrite=True)
    before = (tmp_path / "run.json").read_bytes()
    run.__exit__(None, None, None)
    run.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert (tmp_path / "run.json").read_bytes() == before
    assert load_run(tmp_path).worlds.plan_id.tolist() == ["theirs"]


def test_a_part_that_failed_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readers that do not know run.json read all files of a table, so no file of a failed part may remain."""

    def no_room(*_: Any) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(Part, "worlds", no_room)
    with pytest.raises(MemoryError):
        write_run(tmp_path)
    assert part_files(tmp_path) == ["run.json"]


CRASH = """
import os, sys
sys.path.insert(0, sys.argv[2])
from support.outcomes import make_outcome, make_plan
from petmjx.results.run_writer import RunWriter
real = os.replace
def replace(source, target):
    if str(target).endswith("worlds/part-00001.parquet"):
        os._exit(9)
    real(source, target)
os.replace = replace
with RunWriter(sys.argv[1], {}, worlds_per_part=2) as run:
    for number in range(4):
        run.add(make_plan(str(number)), 0, "fixed", make_outcome())
"""


def test_a_crash_between_the_renames_of_a_part_leaves_readable_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    here = Path(__file__).parents[1]
    command = [sys.executable, "-c", CRASH, str(out), str(here)]
    environment = {**os.environ, "PYTHONPATH": str(here.parent)}
    assert subprocess.run(command, check=False, timeout=60, env=environment).returncode == 9
    assert (out / "boxes/part-00001.parquet").exists()
    assert list((out / "worlds").glob(".part-00001.parquet.*.tmp"))
    results = load_run(out)
    assert results.worlds.plan_id.tolist() == ["0", "1"]
    assert sorted(set(results.boxes.plan_id)) == ["0", "1"]
    assert results.info["status"] == "running"
    assert results.info["counts"]["worlds"] == 2
    # files that are left over do not disturb a reader that does not know petmjx, and --overwrite removes them
    assert len(pd.read_parquet(out / "worlds")) == 2
    write_run(out, overwrite=True)
    assert part_files(out) == ["boxes/part-00000.parquet", "run.json", "worlds/part-00000.parquet"]


def test_a_run_is_not_overwritten_unless_asked(tmp_path: Path) -> None:
    write_run(tmp_path, ids=("a", "b"), worlds_per_part=1)
    note = tmp_path / "note.txt"
    note.write_text("mine")
    with pytest.raises(InputError, match="holds a run already"):
        write_run(tmp_path)
    assert len(load_run(tmp_path).worlds) == 2
    write_run(tmp_path, ids=("c",), overwrite=True)
    assert load_run(tmp_path).worlds.plan_id.tolist() == ["c"]
    assert note.read_text() == "mine"


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file: is a file; name a folder"):
        write_run(tmp_path / "file", overwrite=True)
    with pytest.raises(InputError, match=r"run: cannot be written: .*file is a file; name a folder"):
        write_run(tmp_path / "file" / "run")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(InputError, match="fifo: is not a folder; name a folder"):
        write_run(tmp_path / "fifo")


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(result_files.pq, "write_table", full)
    with pytest.raises(PetmjxError, match="cannot write results: No space left"):
        write_run(tmp_path)
    assert load_run(tmp_path).info["status"] == "failed"
    assert load_run(tmp_path).worlds.empty


def test_a_full_disk_ends_the_run_when_too_many_worlds_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """If there is room again at the end, the waiting worlds are written."""
    monkeypatch.setattr(run_writer, "MOST_WAITING_BYTES", 4 * ROW_BYTES)
    calls = full_once(monkeypatch)
    with pytest.raises(PetmjxError, match="cannot write results: No space left"):
        write_run(tmp_path, ids=tuple("01234567"), worlds_per_part=2)
    assert next(calls) > 1
    results = load_run(tmp_path)
    assert results.worlds.plan_id.tolist() == list("0123"), "all that were added"
    assert (results.info["status"], results.info["counts"]["worlds"]) == ("failed", 4)


def test_a_run_outlives_a_disk_that_is_full_for_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full_once(monkeypatch)
    write_run(tmp_path, ids=tuple("01234"), worlds_per_part=2)
    results = load_run(tmp_path)
    assert results.worlds.plan_id.tolist() == list("01234")
    assert results.info["status"] == "finished"
    assert results.info["warnings"] == [f"{tmp_path}: cannot write results: No space left on device; tried again"]
