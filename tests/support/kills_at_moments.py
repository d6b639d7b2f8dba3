"""Disturbs small runs at each moment at which they use the file system, by a full disk or by a kill.

    python tests/support/kills_at_moments.py FOLDER 0 1

kills runs at each of these moments (FOLDER 3 20: at moment 3 and every 20th after it), checks the folder, and lets the
runs continue. Runs are child processes, forked from a process that has imported all modules and started no thread.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pandas as pd
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from petmjx.common.errors import PetmjxError
from petmjx.plans.plan import Plan
from petmjx.results import result_files, run_folder
from petmjx.results.plan_digests import records_of
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import summary_table
from petmjx.results.stored_plans import placements_table
from support.outcomes import make_outcome, make_plan

KINDS: Final = ("in order", "unordered", "resumed", "other order", "merged")

WRITING: Final = ("fsync", "replace", "mkdir", "pwrite", "ftruncate")
"""Functions of ``os`` that need space on a disk. Opening a new file and writing a table also count as moments."""

TAKING_AWAY: Final = ("unlink",)

PLANS: Final = [make_plan(f"p{number}", 2) for number in range(5)]


@dataclass
class Moments:
    """Counts the moments at which a run uses the file system, and disturbs the run at one of them.

    Attributes:
        act: function that is called at the moment number ``at``, and, if ``lasts``, at all later moments. If None,
            nothing happens.
        count: number of moments so far.
    """

    act: Callable[[], None] | None = None
    at: int = -1
    lasts: bool = False
    count: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def watch(self, monkeypatch: pytest.MonkeyPatch, *, taking_away: bool = False) -> None:
        """From now on, count all calls of these functions as moments."""
        for name in (*WRITING, *(TAKING_AWAY if taking_away else ())):
            monkeypatch.setattr(os, name, self._after_passing(getattr(os, name)))
        monkeypatch.setattr(result_files.pq, "write_table", self._after_passing(result_files.pq.write_table))
        real = os.open

        def opened(path: Any, flags: int, *rest: Any, **options: Any) -> int:
            if flags & os.O_CREAT:
                self._pass()
            return real(path, flags, *rest, **options)

        monkeypatch.setattr(os, "open", opened)

    def _pass(self) -> None:
        with self._lock:
            number, self.count = self.count, self.count + 1
        if self.act is not None and (number == self.at or (self.lasts and number > self.at)):
            self.act()

    def _after_passing(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            self._pass()
            return real(*args, **options)

        return call


@dataclass
class Run:
    """A run of five worlds, in parts of two worlds.

    Attributes:
        kind: one of ``KINDS``. ``in order``: worlds end in the order of the plans; ``unordered``: in another order;
            ``resumed``: some worlds exist already; ``other order``: the same, with ranks of another order of plans;
            ``merged``: worlds are copied from two other runs.
        folder: folder of these other runs.
        ended: ids of the plans whose worlds have ended.
    """

    kind: str
    folder: Path
    ended: list[str] = field(default_factory=list)

    def prepare(self, out: Path) -> None:
        """Make the files that exist before the run begins."""
        if self.kind in ("resumed", "other order"):
            if not (self.folder / "half").exists():
                self._write(
                    self.folder / "half", order=(1, 3, 0), plans=PLANS[:: -1 if self.kind == "other order" else 1]
                )
            shutil.copytree(self.folder / "half", out)
        if self.kind == "merged" and not (self.folder / "two").exists():
            for name, order in (("one", (3, 0)), ("two", (4, 1, 2))):
                self._write(self.folder / name, order=order)
        self.ended.clear()

    def write(self, out: Path) -> None:
        """Make the run, or the missing rest of an existing run."""
        if self.kind == "merged" and not (out / run_folder.RUN_FILE).exists():
            with self._writer(out) as writer:
                for name in ("one", "two"):
                    others = load_run(self.folder / name)
                    self.ended += others.worlds["plan_id"].tolist()
                    writer.adopt(others.parts)
                self._finish(writer)
        else:
            self._write(out, order=range(5) if self.kind == "in order" else (3, 0, 4, 1, 2), complete=True)

    def _write(self, out: Path, order: Any, complete: bool = False, plans: Sequence[Plan] = PLANS) -> None:
        with self._writer(out, plans) as writer:
            for number in order:
                plan = PLANS[number]
                if (plan.plan_id, 0) in writer.recorded:
                    continue
                self.ended.append(plan.plan_id)
                writer.add(plan, 0, "fixed", make_outcome(2, sim_time_s=float(number)))
                if number == 4:
                    writer.flush()
            if complete:
                self._finish(writer)

    def _writer(self, out: Path, plans: Sequence[Plan] = PLANS) -> RunWriter:
        manifest = Manifest({"command": "score"}, records_of(plans, {}), lambda: placements_table(PLANS))
        return RunWriter(
            out,
            {},
            manifest=manifest,
            variants=range(1),
            versions={},
            resume=True,
            worlds_per_part=2,
            expected_worlds=5,
        )

    def _finish(self, writer: RunWriter) -> None:
        writer.flush()
        tables = [table.to_pandas() for table in writer.parts.table("worlds", ("plan_id",))]
        known = len(pd.concat(tables)) if tables else 0
        frame = pd.DataFrame({"plan_id": ["all"], "known": [known]})
        writer.write_summary(summary_table(frame, {"known": "1"}, {"plan_id": "whose", "known": "worlds on disk"}))


def worlds_said(out: Path) -> int:
    """Number of worlds according to the run.json of a folder. 0 if there is no run.json."""
    try:
        n_worlds: int = json.loads((out / run_folder.RUN_FILE).read_text())["counts"]["worlds"]
        return n_worlds
    except FileNotFoundError:
        return 0


def assert_sound(out: Path, at_least: int, ended: list[str] | None = None) -> None:
    """Check that a folder has each of its worlds once, with its boxes, and at least ``at_least`` worlds."""
    if not (out / run_folder.RUN_FILE).exists():
        assert at_least == 0
        return
    results = load_run(out)
    ids = results.worlds["plan_id"].tolist()
    assert results.info["counts"]["worlds"] == len(ids) == len(set(ids)) >= at_least
    assert sorted(results.boxes["plan_id"]) == sorted(2 * ids)
    assert ended is None or set(ids) <= set(ended)


def assert_complete(out: Path) -> None:
    """Check that a finished run has all worlds and tables, and no file that is not listed."""
    results = load_run(out)
    assert results.info["status"] == "finished"
    ranks = {row["plan_id"]: row["rank"] for part in results.parts.table("worlds") for row in part.to_pylist()}
    assert ranks == {plan.plan_id: rank for rank, plan in enumerate(PLANS)}
    assert results.worlds["plan_id"].tolist() == [plan.plan_id for plan in PLANS]
    assert results.worlds["sim_time_s"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert results.boxes["plan_id"].tolist() == [plan.plan_id for plan in PLANS for _ in range(2)]
    assert results.placements["plan_id"].tolist() == results.boxes["plan_id"].tolist()
    assert results.summary is not None
    listed = {f"{table}/{name}" for table, names in results.info["parts"].items() for name in names}
    assert {str(file.relative_to(out)) for file in out.rglob("*") if file.is_file()} == listed | {run_folder.RUN_FILE}


def fill(run: Run, out: Path, at: int, lasts: bool) -> bool:
    """Disturb a run by a full disk, check its folder, and let it continue. Returns False if the run has no moment
    ``at``.

    If the disk is full at one moment only, no world is lost. If it stays full (``lasts``), no world is lost that
    run.json had at that moment.
    """
    run.prepare(out)
    sizes: list[int] = []

    def full() -> None:
        sizes.append(worlds_said(out))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.MonkeyPatch.context() as monkeypatch:
        Moments(full, at, lasts).watch(monkeypatch)
        error_text = ""
        try:
            run.write(out)
        except PetmjxError as error:
            error_text = str(error)
    if error_text:
        assert "No space left on device" in error_text
    else:
        assert_complete(out)
    if not sizes:
        return False
    if out.exists():
        assert_sound(out, at_least=sizes[0], ended=None if run.kind in ("resumed", "other order") else run.ended)
        if not lasts and run.ended and run.kind != "merged":
            assert set(run.ended) <= set(load_run(out).worlds["plan_id"])
            assert not list(out.rglob("*.tmp"))
    _go_on(run, out)
    return True


def kill(run: Run, out: Path, at: int) -> bool:
    """Kill a run at a moment, check its folder, and let it continue. Both runs are processes of their own."""

    def killed() -> None:
        run.prepare(out)
        Moments(lambda: os._exit(9), at).watch(pytest.MonkeyPatch(), taking_away=True)
        run.write(out)

    def goes_on() -> None:
        if out.exists():
            assert_sound(out, 0)
        _go_on(run, out)

    ended = _in_child(killed)
    assert ended in (0, 9)
    assert _in_child(goes_on) == 0
    return ended == 9


def _go_on(run: Run, out: Path) -> None:
    run.write(out)
    assert_complete(out)


def _in_child(act: Callable[[], None]) -> int:
    """Call a function in a process of its own. Returns 0, 1 after an error, or 9 after a kill."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        act()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(0)


def main(folder: Path, first: int, every: int, most: int = 1000) -> None:
    """Kill each kind of run at some of its moments, at most ``most``."""
    for kind in KINDS:
        run = Run(kind, folder / kind)
        run.folder.mkdir(parents=True)
        assert _in_child(lambda: run.prepare(run.folder / "unused")) == 0  # noqa: B023 - called at once
        killed = 0
        while killed < most and kill(run, run.folder / f"at-{killed}", first + killed * every):
            killed += 1
        print(f"{kind}: killed at {killed} moments", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
