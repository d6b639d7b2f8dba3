"""Tests of runs without a folder. Results are the same as those of runs with a folder. The results stay in memory
unless they exceed the size of one part of a table."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pandas as pd
import pytest
from support.command_line import write
from support.plans import make_plan, stack

import petmjx
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.results.run_folder import TABLES
from petmjx.results.run_reader import RunResults
from petmjx.results.run_writer import RunWriter
from petmjx.world.job import Job
from petmjx.world.scene import build_scene

PLANS = [make_plan("stands", stack(2, 100.0)), make_plan("falls", stack(2, 260.0)), make_plan("one", stack(1))]
STATIC = {"engine": "mujoco", "check": "static", "duration_s": 0.1}
"""Options with which a run is short."""

_DRIVES = 'profile = "eumos-40509"\ndirection = [0]\n'
SWEEPS = {
    "grid": f"nominal = true\n[axes]\nplacement_error_mm = [0, 3]\nlevel = [0.3, 0.6]\n{_DRIVES}",
    "search": f"[axes]\n{_DRIVES}[search]\nupper = 1.0\ntolerance = 0.3\n",
}
RUNS: dict[str, Callable[..., RunResults]] = {
    "score": lambda **more: petmjx.score(PLANS, **STATIC, **more),
    "histories": lambda **more: petmjx.score(PLANS, **STATIC, record="all", record_details=True, **more),
    "intervals": lambda **more: petmjx.score(PLANS, **STATIC, force_intervals=True, **more),
    "confidence": lambda **more: petmjx.score(PLANS, **STATIC, confidence=4, **more),
}
VARYING = ("started", "updated", "timings", "parts", "digest")
"""Entries of ``run.json`` that are different in each run."""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which temporary folders are made."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.fixture
def parts_of_one_world(monkeypatch: pytest.MonkeyPatch) -> None:
    assert RunWriter.__init__.__kwdefaults__ is not None
    monkeypatch.setitem(RunWriter.__init__.__kwdefaults__, "worlds_per_part", 1)


def assert_same(a: RunResults, b: RunResults) -> None:
    """Check that two runs have the same tables, to the last bit, the same units, and the same ``run.json``."""
    for table in (table for table in TABLES if table != "placements"):  # a run in memory has the plans instead
        mine, theirs = getattr(a, table), getattr(b, table)
        assert (mine is None) == (theirs is None), table
        if mine is not None:
            pd.testing.assert_frame_equal(mine, theirs, check_exact=True)
        assert a.units(table) == b.units(table)
    infos = [{name: value for name, value in run.info.items() if name not in VARYING} for run in (a, b)]
    assert infos[0] == infos[1]


@pytest.mark.parametrize("name", RUNS)
def test_results_in_memory_are_those_of_a_folder(name: str, temporary: Path, tmp_path: Path) -> None:
    results, kept = RUNS[name](), RUNS[name](out=tmp_path / "out")
    assert list(temporary.iterdir()) == []
    assert_same(results, kept)
    assert repr(results).startswith("RunResults(in memory: ")


@pytest.mark.parametrize("name", SWEEPS)
def test_sweeps_in_memory_are_those_of_a_folder(name: str, temporary: Path, tmp_path: Path) -> None:
    file = write(tmp_path / "x.toml", SWEEPS[name])
    results, kept = (petmjx.sweep(file, PLANS[:2], **STATIC, **more) for more in ({}, {"out": tmp_path / "out"}))
    assert list(temporary.iterdir()) == []
    assert_same(results, kept)


def test_their_folder_is_made_when_asked_for_and_goes_with_them(temporary: Path) -> None:
    results = RUNS["histories"]()
    folder = results.path
    assert folder.parent == temporary
    assert results.path is folder
    again = petmjx.load_run(folder)
    assert_same(results, again)
    assert results.info == again.info
    del results
    gc.collect()
    assert list(temporary.iterdir()) == []


def test_more_than_a_part_goes_to_a_temporary_folder(temporary: Path, parts_of_one_world: None) -> None:
    results = RUNS["score"]()
    assert results.path.parent == temporary
    assert len(results.parts.files("worlds")) == len(PLANS)
    assert results.worlds["plan_id"].tolist() == [plan.plan_id for plan in PLANS]
    del results
    gc.collect()
    assert list(temporary.iterdir()) == []


def test_what_was_in_memory_is_not_lost_on_the_way_to_a_folder(temporary: Path) -> None:
    sim = Simulation(check="static", duration_s=0.1)
    outcomes = list(MujocoEngine(1).run([Job(build_scene(plan, sim)) for plan in PLANS], sim))
    with RunWriter(None, {}, worlds_per_part=2) as writer:
        writer.add(PLANS[0], 0, "adaptive", outcomes[0])
        writer.flush()
        assert list(temporary.iterdir()) == []
        for plan, outcome in zip(PLANS[1:], outcomes[1:], strict=True):
            writer.add(plan, 0, "adaptive", outcome)
    results = writer.results()
    assert sorted(results.worlds["plan_id"]) == sorted(plan.plan_id for plan in PLANS)
    assert results.info["counts"]["worlds"] == 3


class _Failing(MujocoEngine):
    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        outcomes = super().run(jobs, sim, progress)
        yield next(outcomes)
        yield next(outcomes)
        raise RuntimeError("no luck")


def test_the_temporary_folder_goes_when_the_run_fails(temporary: Path, parts_of_one_world: None) -> None:
    with pytest.raises(RuntimeError, match="no luck"):
        petmjx.score(PLANS, engine=_Failing())
    gc.collect()
    assert list(temporary.iterdir()) == []
