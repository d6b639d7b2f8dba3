"""Runs of very many worlds, of which no part is written twice: here of a few, in parts of ten."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest
from support.fake_engine import LargestFirst
from support.plans import make_plan, stack
from support.waiting import wait_for

import petmjx
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.results import part_order, run_table_files
from petmjx.results.part_order import Places
from petmjx.results.run_writer import RunWriter
from petmjx.runs import sweep_run
from petmjx.world.job import Job

PLANS = [make_plan(f"p{(7 * k) % 9}", stack(1 + k % 3)) for k in range(9)]
"""Not sorted by id. With 4 variants each there are 36 worlds: parts of 10, 10, 10 and 6."""

SWEEP = """
replicates = 4
[axes]
placement_error_mm = 3
"""


class InTurn(LargestFirst):
    """Takes worlds in turn, but for one a run, which it begins with the last one."""

    name = "in-turn"

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        yield from sorted(super().run(jobs, sim, progress), key=lambda outcome: (outcome.job + 1) % len(jobs))


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.runs.simulate.LARGE", 20)
    monkeypatch.setattr(part_order, "PIECE_WORLDS", 3)
    monkeypatch.setattr(Places.__init__, "__defaults__", (10,))
    defaults = sweep_run.Batching.__init__.__defaults__
    assert defaults is not None
    monkeypatch.setattr(sweep_run.Batching.__init__, "__defaults__", (12, *defaults[1:]))


@pytest.fixture
def sweep(tmp_path: Path) -> Any:
    file = tmp_path / "errors.toml"
    file.write_text(SWEEP)

    def run(out: Path | None = None, engine: Any = None, plans: Any = PLANS, **options: Any) -> petmjx.RunResults:
        return petmjx.sweep(file, plans, engine=engine or LargestFirst(), out=out, **options)

    return run


def written_as_given(folder: Path) -> None:
    """Parts of ten worlds, in the order given, for readers that know nothing of petmjx."""
    files = sorted((folder / "worlds").iterdir())
    assert [file.name for file in files] == [f"part-{k:05d}.parquet" for k in range(4)]
    parts = [pq.read_table(file, partitioning=None) for file in files]
    assert [len(part) for part in parts] == [10, 10, 10, 6]
    rows = [(row["plan_id"], row["variant"]) for part in parts for row in part.to_pylist()]
    assert rows == [(plan.plan_id, variant) for plan in PLANS for variant in range(1, 5)]
    boxes = [pq.read_table(folder / "boxes" / file.name, partitioning=None) for file in files]
    assert [(row["plan_id"], row["variant"]) for part in boxes for row in part.to_pylist() if row["box"] == 0] == rows
    assert not list(folder.rglob("*.tmp"))


@pytest.fixture
def writes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The parts of worlds that are written, by name."""
    names: list[str] = []
    write = run_table_files.write_table

    def noted(table: Any, path: Path) -> str:
        names.extend([path.name] if path.parent.name == "worlds" else [])
        return write(table, path)

    monkeypatch.setattr(run_table_files, "write_table", noted)
    return names


@pytest.mark.parametrize("engine", [LargestFirst, InTurn])
def test_no_part_is_written_twice(sweep: Any, tmp_path: Path, writes: list[str], engine: Any) -> None:
    results = sweep(tmp_path / "run", engine())
    written_as_given(tmp_path / "run")
    assert sorted(writes) == [f"part-{k:05d}.parquet" for k in range(4)]
    assert results.info["counts"]["worlds"] == 36
    in_memory = sweep(None, engine())
    pd.testing.assert_frame_equal(results.worlds, in_memory.worlds)
    pd.testing.assert_frame_equal(results.boxes, in_memory.boxes)
    pd.testing.assert_frame_equal(results.summary, in_memory.summary)


def test_it_goes_on_after_any_number_of_worlds(sweep: Any, tmp_path: Path) -> None:
    expected = sweep()
    for worlds in (0, 1, 11, 12, 13, 25, 35):
        out = tmp_path / str(worlds)
        with pytest.raises(KeyboardInterrupt):
            sweep(out, LargestFirst(interrupt_after=worlds))
        cut = petmjx.load_run(out)
        assert len(cut.worlds) == cut.info["counts"]["worlds"] == worlds
        results = sweep(out, resume=True)
        written_as_given(out)
        pd.testing.assert_frame_equal(results.worlds, expected.worlds)
        counts = {**results.info["counts"]}
        assert counts == expected.info["counts"]


def test_worlds_that_take_too_much_memory_are_written_early(
    sweep: Any, tmp_path: Path, writes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_order, "MOST_WAITING_BYTES", 0)
    sweep(tmp_path / "run")
    assert len(writes) == 36  # each as it comes; the last one of a part with all others
    written_as_given(tmp_path / "run")


class Slow(LargestFirst):
    """Waits after three worlds until they are on disk."""

    name = "slow"

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for number, outcome in enumerate(super().run(jobs, sim, progress)):
            yield outcome
            if number == 2:
                wait_for(lambda: [*self._folder.glob("worlds/*")])


def test_worlds_that_wait_too_long_are_written_early(
    sweep: Any, tmp_path: Path, writes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    defaults = RunWriter.__init__.__kwdefaults__
    assert defaults is not None
    monkeypatch.setitem(defaults, "seconds_per_part", 0.2)
    sweep(tmp_path / "run", Slow(tmp_path / "run"))
    assert writes[0] == "part-00004.parquet"
    written_as_given(tmp_path / "run")


def test_a_run_in_another_order_is_sorted_in_the_end(sweep: Any, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "run", LargestFirst(interrupt_after=25), plans=PLANS[::-1])
    results = sweep(tmp_path / "run", resume=True)
    assert results.worlds.plan_id.tolist() == [plan.plan_id for plan in PLANS for _ in range(4)]
    pd.testing.assert_frame_equal(results.worlds, sweep().worlds)


def test_a_part_that_was_taken_away_is_simulated_again(sweep: Any, tmp_path: Path) -> None:
    sweep(tmp_path / "run")
    (tmp_path / "run" / "worlds" / "part-00001.parquet").unlink()
    sweep(tmp_path / "run", resume=True)
    written_as_given(tmp_path / "run")


def test_shards_are_joined(sweep: Any, tmp_path: Path) -> None:
    shards = [sweep(tmp_path / f"{k}", shard=f"{k}/2").path for k in (1, 2)]
    merged = petmjx.merge_runs(shards, tmp_path / "merged")
    pd.testing.assert_frame_equal(merged.worlds, sweep().worlds)
