"""Tests of sweeps whose worlds end in any order. Each part of a table, here with ten worlds, is written only once. The
column ``rank`` gives the order of rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.fake_engine import LargestFirst
from support.plans import make_plan, stack

import petmjx
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.results import table_parts
from petmjx.results.run_writer import RunWriter
from petmjx.runs import forked_worlds
from petmjx.world.job import Job

PLANS = [make_plan(f"p{(7 * k) % 9}", stack(1 + k % 3)) for k in range(9)]
"""Nine plans that are not sorted by id. With 4 variants of each plan, there are 36 worlds, in parts of 10, 10, 10 and
6."""

SWEEP = """
replicates = 4
[axes]
placement_error_mm = 3
"""


class InTurn(LargestFirst):
    """An engine that simulates worlds in order, except that it begins with the last world."""

    name = "in-turn"

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        yield from sorted(super().run(jobs, sim, progress), key=lambda outcome: (outcome.job + 1) % len(jobs))


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    assert RunWriter.__init__.__kwdefaults__ is not None
    monkeypatch.setitem(RunWriter.__init__.__kwdefaults__, "worlds_per_part", 10)
    defaults = forked_worlds.Batching.__init__.__defaults__
    assert defaults is not None
    monkeypatch.setattr(forked_worlds.Batching.__init__, "__defaults__", (12, *defaults[1:]))


@pytest.fixture
def sweep(tmp_path: Path) -> Any:
    file = tmp_path / "errors.toml"
    file.write_text(SWEEP)

    def run(out: Path | None = None, engine: Any = None, plans: Any = PLANS, **options: Any) -> petmjx.RunResults:
        return petmjx.sweep(file, plans, engine=engine or LargestFirst(), out=out, **options)

    return run


def assert_ranked(folder: Path, plans: Sequence[petmjx.Plan] = PLANS) -> None:
    """Check that ranks sort the rows by plan and variant, and have no gaps. The tables are read without petmjx."""
    order = [(plan.plan_id, variant) for plan in plans for variant in range(1, 5)]
    for table in ("worlds", "boxes"):
        files = sorted((folder / table).iterdir())
        parts = [pq.read_table(file, partitioning=None) for file in files]
        assert all(part["rank"].to_pylist() == sorted(part["rank"].to_pylist()) for part in parts)
        rows = pa.concat_tables(parts).sort_by("rank").to_pylist()
        assert [order[row["rank"]] for row in rows] == [(row["plan_id"], row["variant"]) for row in rows]
        assert {row["rank"] for row in rows} == {*range(36)}
    assert not list(folder.rglob("*.tmp"))


@pytest.fixture
def writes(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the parts of the table ``worlds`` that are written."""
    names: list[str] = []
    write = table_parts.write_table

    def noted(table: Any, path: Path) -> str:
        names.extend([path.name] if path.parent.name == "worlds" else [])
        return write(table, path)

    monkeypatch.setattr(table_parts, "write_table", noted)
    return names


@pytest.mark.parametrize("engine", [LargestFirst, InTurn])
def test_no_part_is_written_twice(sweep: Any, tmp_path: Path, writes: list[str], engine: Any) -> None:
    results = sweep(tmp_path / "run", engine())
    assert_ranked(tmp_path / "run")
    assert writes == [f"part-{k:05d}.parquet" for k in range(4)]
    assert [len(results.parts.read(file)) for file in results.parts.files("worlds")] == [10, 10, 10, 6]
    assert results.info["counts"]["worlds"] == 36
    in_memory = sweep(None, engine())
    pd.testing.assert_frame_equal(results.worlds, in_memory.worlds)
    pd.testing.assert_frame_equal(results.boxes, in_memory.boxes)
    pd.testing.assert_frame_equal(results.summary, in_memory.summary)


def test_it_goes_on_after_any_number_of_worlds(sweep: Any, tmp_path: Path, writes: list[str]) -> None:
    expected = sweep()
    for worlds in (0, 11, 35):
        out = tmp_path / str(worlds)
        with pytest.raises(KeyboardInterrupt):
            sweep(out, LargestFirst(interrupt_after=worlds))
        cut = petmjx.load_run(out)
        assert len(cut.worlds) == cut.info["counts"]["worlds"] == worlds
        before = {file: file.read_bytes() for file in cut.parts.files("worlds") if worlds}
        results = sweep(out, resume=True)
        assert_ranked(out)
        assert all(file.read_bytes() == content for file, content in before.items()), "parts stay as they are"
        pd.testing.assert_frame_equal(results.worlds, expected.worlds)
        assert results.info["counts"] == expected.info["counts"]


def test_a_run_resumed_with_plans_in_another_order_has_that_order(sweep: Any, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        sweep(tmp_path / "run", LargestFirst(interrupt_after=25), plans=PLANS[::-1])
    results = sweep(tmp_path / "run", resume=True)
    assert_ranked(tmp_path / "run")
    assert results.worlds.plan_id.tolist() == [plan.plan_id for plan in PLANS for _ in range(4)]
    pd.testing.assert_frame_equal(results.worlds, sweep().worlds)


def test_a_part_that_was_taken_away_is_simulated_again(sweep: Any, tmp_path: Path) -> None:
    sweep(tmp_path / "run")
    (tmp_path / "run" / "worlds" / "part-00001.parquet").unlink()
    sweep(tmp_path / "run", resume=True)
    assert_ranked(tmp_path / "run")


@pytest.mark.parametrize("reversed_order", [False, True])
def test_shards_are_joined(sweep: Any, tmp_path: Path, reversed_order: bool) -> None:
    """Shards are joined by copying their files byte by byte. If a shard had its plans in another order, its rows get
    new ranks."""
    plans = PLANS[::-1] if reversed_order else PLANS
    shards = [sweep(tmp_path / f"{k}", shard=f"{k}/2", plans=given).path for k, given in ((1, PLANS), (2, plans))]
    merged = petmjx.merge_runs(shards, tmp_path / "merged")
    assert_ranked(tmp_path / "merged")
    pd.testing.assert_frame_equal(merged.worlds, sweep().worlds)
    pd.testing.assert_frame_equal(merged.boxes, sweep().boxes)
    copied = {file.read_bytes() for shard in shards for file in petmjx.load_run(shard).parts.files("worlds")}
    assert ({file.read_bytes() for file in merged.parts.files("worlds")} == copied) != reversed_order
