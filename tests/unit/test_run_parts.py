"""Parts of a run appear whole or not at all, whatever stops it."""

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
from petmjx.results import part_buffer, run_folder, run_info, run_table_files
from petmjx.results.part_buffer import Part, PartBuffer, Row
from petmjx.results.part_order import DestinationBuffer, Places
from petmjx.results.run_file import write_run_file
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import schemas


def worlds_on_disk(folder: Path) -> int:
    """As run.json has them."""
    n_worlds: int = json.loads((folder / "run.json").read_text())["counts"]["worlds"]
    return n_worlds


class Holding:
    """Holds up the writing of tables for as long as it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.let_go = threading.Event()
        write = run_folder.pq.write_table

        def late(*args: Any, **options: Any) -> None:
            assert self.let_go.wait(20)
            write(*args, **options)

        monkeypatch.setattr(run_folder.pq, "write_table", late)


def full_once(monkeypatch: pytest.MonkeyPatch, after_s: float = 0.0) -> Iterator[int]:
    """Let the first table that is written meet a full disk; counts the tables."""
    real, calls = run_folder.pq.write_table, itertools.count()

    def write_table(*args: Any, **options: Any) -> None:
        if next(calls) == 0:
            time.sleep(after_s)
            raise OSError(28, "No space left on device")
        real(*args, **options)

    monkeypatch.setattr(run_folder.pq, "write_table", write_table)
    return calls


def test_parts_stream_and_run_json_follows(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}, worlds_per_part=2, expected_worlds=5) as run:
        assert json.loads((tmp_path / "run.json").read_text())["status"] == "running"
        for number in range(5):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
            assert worlds_on_disk(tmp_path) == run.info["counts"]["worlds"] == number // 2 * 2, (
                "the last part has not landed"
            )
            if number % 2:
                beside = run._part_buffer._beside
                assert beside is not None
                beside.digests.result()
    assert [file for file in part_files(tmp_path) if file.startswith("worlds")] == [
        f"worlds/part-0000{number}.parquet" for number in range(3)
    ]
    assert load_run(tmp_path).worlds.plan_id.tolist() == list("01234")


def test_worlds_are_gathered_while_a_part_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    holding = Holding(monkeypatch)
    with RunWriter(tmp_path, {}, worlds_per_part=2) as run:
        for number in range(3):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
        assert worlds_on_disk(tmp_path) == 0
        holding.let_go.set()
        run.flush()
        assert worlds_on_disk(tmp_path) == 3
    assert load_run(tmp_path).worlds.plan_id.tolist() == list("012")


def test_a_part_lands_though_no_world_follows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_buffer, "LANDING_S", 0.05)
    with RunWriter(tmp_path, {}, worlds_per_part=2, seconds_per_part=0.2) as run:
        for number in range(2):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
        wait_for(lambda: worlds_on_disk(tmp_path) == 2)


def test_a_part_is_written_after_a_while_though_no_world_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = PartBuffer.add

    def late(*args: Any) -> None:
        time.sleep(0.3)
        add(*args)

    monkeypatch.setattr(PartBuffer, "add", late)
    with RunWriter(tmp_path, {}, seconds_per_part=0.2) as run:
        for number in range(2):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
            wait_for(lambda: worlds_on_disk(tmp_path) == number + 1)  # noqa: B023 - called at once


def test_run_json_says_finished_when_all_worlds_are_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    statuses = []

    def noted(entries: dict[str, Any], folder: Path) -> None:
        statuses.append((entries["status"], entries["counts"]["worlds"]))
        write_run_file(entries, folder)

    monkeypatch.setattr(run_info, "write_run_file", noted)
    write_run(tmp_path, ids=("0", "1", "2"), worlds_per_part=2)
    assert statuses == [("running", 0), ("running", 2), ("running", 3), ("finished", 3)]


def test_ctrl_c_keeps_whole_parts_and_says_how_many(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path, ids=("0", "1", "2"), end=KeyboardInterrupt(), worlds_per_part=2)
    results = load_run(tmp_path)
    assert results.info["status"] == "interrupted"
    assert results.info["counts"]["worlds"] == len(results.worlds) == 3
    assert len(results.boxes) == 9


def test_ctrl_c_while_a_part_is_written_neither_loses_nor_doubles_worlds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.replace
    calls = 0

    def interrupted_replace(source: Any, target: Any) -> None:
        nonlocal calls
        real(source, target)
        calls += str(target).endswith(".parquet")
        if calls == 1:  # the boxes are in place, the worlds are not
            calls += 1
            raise KeyboardInterrupt

    monkeypatch.setattr(run_folder.os, "replace", interrupted_replace)
    with pytest.raises(KeyboardInterrupt):
        write_and_flush(tmp_path)
    assert_has_whole(tmp_path, 2)


def test_ctrl_c_while_a_part_is_waited_for_neither_loses_nor_doubles_worlds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    holding = Holding(monkeypatch)
    timers = [
        threading.Timer(0.3, signal.raise_signal, [signal.SIGINT]),
        threading.Timer(0.6, holding.let_go.set),
    ]
    for timer in timers:
        timer.start()
    with pytest.raises(KeyboardInterrupt):
        write_run(tmp_path, ids=("0", "1", "2", "3"), worlds_per_part=2)  # with the last one a part waits for another
    assert_has_whole(tmp_path, 4)


def write_and_flush(folder: Path) -> None:
    with RunWriter(folder, {}) as run:
        for number in range(2):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
        run.flush()


def assert_has_whole(folder: Path, worlds: int) -> None:
    """An interrupted run has so many worlds, each once."""
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
    copy = run_table_files.copy_file

    def cut_short(file: Path, place: Path) -> str:
        if file.is_relative_to(tmp_path / "two/boxes"):
            raise KeyboardInterrupt
        return copy(file, place)

    def merge() -> None:
        with RunWriter(tmp_path / "merged", {}) as run:
            for name in ("one", "two"):
                run.adopt(load_run(tmp_path / name).parts)

    monkeypatch.setattr(run_table_files, "copy_file", cut_short)
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


def test_a_part_written_beside_lands_soon_though_others_are_gathered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its worlds do not wait as long as those of the next part may."""
    monkeypatch.setattr(part_buffer, "LANDING_S", 0.05)
    holding = Holding(monkeypatch)
    with RunWriter(tmp_path, {}, worlds_per_part=2) as run:
        for number in range(3):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
        holding.let_go.set()
        wait_for(lambda: worlds_on_disk(tmp_path) == 2)


def test_a_run_file_that_could_not_be_written_is_written_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The part is on disk, and no world follows."""
    failures = [OSError(28, "No space left on device")] * 2

    def failing(entries: dict[str, Any], folder: Path) -> None:
        if failures:
            raise failures.pop()
        write_run_file(entries, folder)

    with RunWriter(tmp_path, {}, seconds_per_part=0.05) as run:
        monkeypatch.setattr(run_info, "write_run_file", failing)
        run.add(make_plan(), 0, "fixed", make_outcome())
        wait_for(lambda: worlds_on_disk(tmp_path) == 1)
    assert not failures


def test_what_waits_is_due_a_minute_after_it_came(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of parts by place those too that were begun while the alarm was set for another one."""
    now_s = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    plans = [make_plan(str(number)) for number in range(4)]
    rows = [Row.of(plan, 0, "fixed", make_outcome(), (), {}) for plan in plans]
    places = DestinationBuffer(Places([plan.plan_id for plan in plans], 1, 0, per_part=2), schemas())
    gathering = PartBuffer()
    assert places.due_s(60.0) is gathering.due_s(60.0) is None
    places.add(rows[0])
    gathering.add(rows[0])
    now_s = 140.0
    places.add(rows[2])
    gathering.add(rows[2])
    assert places.due_s(60.0) == gathering.due_s(60.0) == 20.0
    assert [places.late(60.0), places.late(40.0)] == [[], [0]]
    places._waiting[0].written_early(7)
    gathering.written()
    assert (places.due_s(60.0), gathering.due_s(60.0)) == (60.0, None)
    now_s = 300.0
    assert places.due_s(60.0) == 0.0
    gathering.close()


def test_a_part_that_cannot_be_written_does_not_keep_others_from_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = Places([str(number) for number in range(6)], 1, 0, per_part=2)
    with RunWriter(tmp_path, {}, places=places) as run:
        for number in (0, 2, 4):
            run.add(make_plan(str(number)), 0, "fixed", make_outcome())
        full_once(monkeypatch)
        with pytest.raises(PetmjxError, match="No space left"):
            run.flush()
        assert worlds_on_disk(tmp_path) == 2
    assert sorted(load_run(tmp_path).worlds.plan_id) == ["0", "2", "4"]


def test_a_run_ends_once(tmp_path: Path) -> None:
    """Another run may have its folder by then."""
    with RunWriter(tmp_path, {}) as run:
        run.add(make_plan("mine"), 0, "fixed", make_outcome())
    write_run(tmp_path, ids=("theirs",), overwrite=True)
    before = (tmp_path / "run.json").read_bytes()
    run.__exit__(None, None, None)
    run.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert (tmp_path / "run.json").read_bytes() == before
    assert load_run(tmp_path).worlds.plan_id.tolist() == ["theirs"]


def test_a_part_that_failed_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readers that know nothing of run.json read all files of a table."""

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
    # leftovers do not disturb a reader that knows nothing of petmjx, and overwriting takes them away
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
    with pytest.raises(InputError, match="cannot write results there"):
        write_run(tmp_path / "file" / "run")


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(run_folder.pq, "write_table", full)
    with pytest.raises(PetmjxError, match="cannot write results: No space left"):
        write_run(tmp_path)
    assert load_run(tmp_path).info["status"] == "failed"
    assert load_run(tmp_path).worlds.empty


@pytest.mark.parametrize("late", [False, True])
def test_worlds_that_could_not_be_written_beside_others_are_written_in_the_end(
    late: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next world meets the error, or the run ends before that."""
    added = list[str]()

    def write() -> None:
        with RunWriter(tmp_path, {}, worlds_per_part=2) as run:
            for number in range(2 if late else 4):
                added.append(str(number))
                run.add(make_plan(str(number)), 0, "fixed", make_outcome())

    full_once(monkeypatch, after_s=0.3)
    if late:
        write()
    else:
        with pytest.raises(PetmjxError, match="cannot write results: No space left"):
            write()
    results = load_run(tmp_path)
    assert results.worlds.plan_id.tolist() == added, "also the one with which the error was met"
    assert results.info["status"] == ("finished" if late else "failed")
    assert results.info["counts"]["worlds"] == len(added) == (2 if late else 4)
