"""Runs that are resumed after any interruption, and runs that are divided into shards: their tables equal those of one
uninterrupted run."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest
from support.equal_runs import GRID, PLANS, SEARCH, assert_same, tables
from support.fake_engine import end_without_physics
from support.plan_files import placement
from support.plans import make_plan, stack
from support.programs import run_program
from support.runs import edit_info, leave_unfinished, relisted

import petmjx
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.world_run import WorldRun
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.results.plan_digests import records_of
from petmjx.results.result_files import write_table
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import schemas
from petmjx.runs.forked_worlds import Batching
from petmjx.world.job import Job

SAMPLE = """
mode = "sample"
sample = 2
nominal = true
[axes]
profile = ["eumos-40509", "tilt"]
placement_error_mm = 5
mass_factor = { from = 0.8, to = 1.2 }
"""
KINDS = {"grid": GRID, "search": SEARCH, "sample": SAMPLE.replace('"eumos-40509", "tilt"', '"tilt"')}


class Counting(MujocoEngine):
    """An engine that counts its jobs, and is interrupted after some of them."""

    def __init__(self, interrupt_after: int | None = None) -> None:
        super().__init__(threads=2)
        self.n_jobs = 0
        self._left = interrupt_after

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for outcome in super().run(jobs, sim, progress):
            if self._left == 0:
                raise KeyboardInterrupt
            self._left = self._left - 1 if self._left is not None else None
            self.n_jobs += 1
            yield outcome


@pytest.fixture
def without_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the simulation of a world, for tests of what happens to outcomes.
    ``test_what_is_there_is_not_simulated_again`` simulates worlds of a score and of a grid."""
    monkeypatch.setattr(WorldRun, "run", end_without_physics)


def simulate(kind: str, folder: Path, **options: Any) -> petmjx.RunResults:
    """A score of a few small plans, or a sweep of this kind."""
    options = {"engine": Counting(), "out": folder, **options}
    if kind == "score":
        return petmjx.score(options.pop("plans", PLANS[:8]), **options)
    file = folder.parent / f"{kind}.toml"
    file.write_text(KINDS[kind])
    return petmjx.sweep(file, options.pop("plans", PLANS[3:6]), batching=Batching(placements=2), **options)


@pytest.mark.parametrize(("kind", "after"), [("score", 3), ("grid", 5), ("search", 7), ("sample", 5)])
def test_what_is_there_is_not_simulated_again(
    kind: str, after: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if kind in ("search", "sample"):
        request.getfixturevalue("without_physics")
    few: dict[str, Any] = {"score": {}, "grid": {"plans": PLANS[5:6]}}.get(kind, {"plans": PLANS[4:6]})
    first_engine = Counting()
    expected = tables(simulate(kind, tmp_path / "whole", engine=first_engine, **few))
    with pytest.raises(KeyboardInterrupt):
        simulate(kind, tmp_path / "run", engine=Counting(after), resume=True, **few)
    before = load_run(tmp_path / "run").info
    assert 0 < before["counts"]["worlds"] < len(expected["worlds"])
    rest = Counting()
    results = simulate(kind, tmp_path / "run", engine=rest, resume=True, **few)
    assert_same(results, expected)
    assert 0 < rest.n_jobs < first_engine.n_jobs
    nothing = Counting()
    again = simulate(kind, tmp_path / "run", engine=nothing, resume=True, **few)
    assert nothing.n_jobs == 0
    assert_same(again, expected)
    assert len(again.info["resumed"]) == 2
    assert again.info["started"] == before["started"]
    assert again.info["timings"]["wall_s"] > before["timings"]["wall_s"]


def test_runs_that_are_killed_many_times_go_on(tmp_path: Path) -> None:
    """The runs are killed in a process of their own, since killing uses fork."""
    script = Path(__file__).parents[1] / "support" / "kills_at_random.py"
    kills = {"score": 4, "grid": 2, "search": 2}
    words = [str(word) for pair in kills.items() for word in pair]
    printed = run_program(script, str(tmp_path), *words, folder=tmp_path)
    assert re.findall(r"^(\w+): (\d+) kills", printed, flags=re.MULTILINE) == [
        (kind, str(count)) for kind, count in kills.items()
    ]


def test_what_was_noted_before_stays_noted_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def some_fail(self: WorldRun) -> Outcome:
        if self._scene.n_boxes == 2:
            raise MemoryError("no room")
        return run(self)

    run = WorldRun.run
    monkeypatch.setattr(WorldRun, "run", some_fail)
    with pytest.raises(KeyboardInterrupt):
        simulate("score", tmp_path, engine=Counting(6))
    edit_info(tmp_path, lambda info: info["versions"].update(mujoco="2.0"))
    noted = [simulate("score", tmp_path, resume=True).info["warnings"] for _ in range(2)]
    assert noted[0] == noted[1]
    assert sorted(noted[0])[:2] == [f"plan plan-0{k}: failed: MemoryError: no room" for k in (1, 5)]
    assert "earlier worlds were simulated with 2.0" in sorted(noted[0])[2]
    assert len(noted[0]) == 3


def test_tests_that_failed_do_not_say_that_the_placement_fell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def weak_ones_fail(self: WorldRun) -> Outcome:
        if self._job.drive is not None and self._job.drive.scale < 0.35:
            raise MemoryError("no room")
        return run(self)

    run = WorldRun.run
    monkeypatch.setattr(WorldRun, "run", weak_ones_fail)
    (tmp_path / "search.toml").write_text(SEARCH.replace("upper = 1.0", "lower = 0.2\nupper = 0.6"))
    options = {"engine": "mujoco", "threads": 1, "out": tmp_path / "run"}
    before = petmjx.sweep(tmp_path / "search.toml", make_plan("a", 1), **options).summary
    after = petmjx.sweep(tmp_path / "search.toml", make_plan("a", 1), resume=True, **options).summary
    assert before is not None
    assert before.stands_at_rest.all()
    pd.testing.assert_frame_equal(after, before)


@pytest.mark.usefixtures("without_physics")
def test_leftovers_of_a_part_are_taken_away(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        simulate("score", tmp_path, engine=Counting(3))
    for table, schema in schemas().items():
        # these files are complete, since parts appear completely or not at all; but run.json does not list them
        if table in ("boxes", "attempts"):
            write_table(schema.empty_table(), tmp_path / table / "part-00007.parquet")
    simulate("score", tmp_path, resume=True)
    listed = load_run(tmp_path).info["parts"]["boxes"]
    assert {file.name for file in tmp_path.glob("boxes/*")} == {*listed}
    assert "part-00007.parquet" not in listed
    assert not list(tmp_path.glob("attempts/*"))


@pytest.mark.usefixtures("without_physics")
def test_boxes_that_are_missing_are_named(tmp_path: Path) -> None:
    simulate("score", tmp_path)
    (tmp_path / "boxes/part-00000.parquet").unlink()
    with pytest.raises(petmjx.InputError, match=r"boxes/part-00000.parquet: missing"):
        simulate("score", tmp_path, resume=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schedule": "fixed"}, "simulation.schedule is fixed, was adaptive"),
        ({"thresholds": {"tilt_deg": 5}}, "simulation.thresholds.tilt_deg is 5.0, was 20.0"),
        ({"plans": PLANS[:9]}, "(1 plan more)"),
        ({"plans": PLANS[1:8]}, "(1 plan fewer)"),
        ({"plans": [*PLANS[:7], make_plan("plan-07", 2)]}, "(plan plan-07 differs)"),
        ({"shard": "1/2"}, "shard is 1/2, was none"),
    ],
)
@pytest.mark.usefixtures("without_physics")
def test_another_run_is_not_gone_on_with(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    simulate("score", tmp_path / "run")
    before = {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()}
    with pytest.raises(petmjx.InputError, match="cannot be resumed, because the folder has another run") as caught:
        simulate("score", tmp_path / "run", resume=True, **changes)
    assert message in str(caught.value)
    assert {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()} == before


@pytest.mark.usefixtures("without_physics")
def test_another_sweep_is_not_gone_on_with(tmp_path: Path) -> None:
    simulate("grid", tmp_path / "run")
    file = tmp_path / "other.toml"
    file.write_text(GRID.replace("level = [0.3, 0.6]", "level = [0.3, 0.7]"))
    with pytest.raises(petmjx.InputError, match=r"sweep.axes.level is \[0.3, 0.7\], was \[0.3, 0.6\]"):
        petmjx.sweep(file, PLANS[3:6], engine=Counting(), out=tmp_path / "run", resume=True)
    with pytest.raises(petmjx.InputError, match="command is score, was sweep"):
        petmjx.score(PLANS[3:6], engine=Counting(), out=tmp_path / "run", resume=True)


@pytest.mark.usefixtures("without_physics")
def test_a_changed_profile_of_the_same_name_is_another_sweep(tmp_path: Path) -> None:
    text = '[profiles.push]\nkind = "windows"\nwindows = [[0.0, 0.1, 0.1, 0, 0]]\n'
    text += '[axes]\nprofile = ["push"]\n'
    file = tmp_path / "push.toml"
    file.write_text(text)
    petmjx.sweep(file, PLANS[:1], engine=Counting(), out=tmp_path / "run")
    file.write_text(text.replace("0.1, 0, 0", "0.2, 0, 0"))
    with pytest.raises(petmjx.InputError, match=r"sweep.profiles.push is"):
        petmjx.sweep(file, PLANS[:1], engine=Counting(), out=tmp_path / "run", resume=True)


@pytest.mark.parametrize("name", ["started", "resumed", "versions", "timings", "warnings", "skipped", "params"])
@pytest.mark.usefixtures("without_physics")
def test_what_is_missing_in_run_json_is_named(name: str, tmp_path: Path) -> None:
    simulate("score", tmp_path / "run", shard="1/1")
    edit_info(tmp_path / "run", lambda info: info.pop(name))
    message = f"run.json: damaged: {name} is missing"
    with pytest.raises(petmjx.InputError, match=message):
        simulate("score", tmp_path / "run", shard="1/1", resume=True)
    with pytest.raises(petmjx.InputError, match=message):
        petmjx.merge_runs([tmp_path / "run"], tmp_path / "merged")


@pytest.mark.parametrize("column", ["variant", "culprit"])
@pytest.mark.usefixtures("without_physics")
def test_a_column_that_is_missing_is_named(column: str, tmp_path: Path) -> None:
    file = tmp_path / "worlds/part-00000.parquet"
    simulate("score", tmp_path)
    pq.write_table(pq.read_table(file).drop([column]), file)
    relisted(tmp_path)
    with pytest.raises(petmjx.InputError, match=f"part-00000.parquet: damaged part, it has no column {column}"):
        simulate("score", tmp_path, resume=True)


def test_a_run_that_does_not_say_what_it_is_of_cannot_be_resumed(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}):
        pass
    with pytest.raises(petmjx.InputError, match="does not list its plans"):
        simulate("score", tmp_path, resume=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"resume": True}, "resume needs the option out"),
        ({"resume": True, "out": "x", "overwrite": True}, "resume contradicts overwrite"),
        ({"shard": "0/4"}, "shard must be I/N with 1 ≤ I ≤ N"),
        ({"shard": "5/4"}, "shard must be I/N"),
        ({"shard": "١/٣"}, "shard must be I/N"),
        ({"shard": "half"}, "shard must be I/N"),
    ],
)
def test_options_that_make_no_sense(options: dict[str, Any], message: str) -> None:
    with pytest.raises(petmjx.InputError, match=message):
        RunOptions(**options)


def test_the_digest_of_ten_thousand_plans_is_quick() -> None:
    plan = make_plan("a", stack(43))
    plans = [replace(plan, plan_id=f"{number:08}") for number in range(10_003)]
    start = time.process_time()
    manifest = Manifest({}, records_of(plans))
    assert manifest.identity["plans"]["count"] == 10_003
    assert time.process_time() - start < 2.0  # 0.3 s on an idle core; the limit allows for a busy machine
    assert Manifest({}, records_of(plans[::-1])).identity == manifest.identity
    heavier = replace(plans[5], mass_kg=plans[5].mass_kg + 1e-9)
    other = Manifest({}, records_of([*plans[:5], heavier, *plans[6:]]))
    assert other.difference_from(manifest) == "plan 00000005 differs"


# Shards.


def test_shares_are_fixed_and_about_equal() -> None:
    ids = [f"{number:08}" for number in range(4_000)]
    shards = [[plan_id for plan_id in ids if RunOptions(shard=f"{i}/4").takes(plan_id)] for i in range(1, 5)]
    assert sorted(plan_id for shard in shards for plan_id in shard) == ids
    assert all(900 < len(shard) < 1_100 for shard in shards)
    assert shards[0][:3] == ["00000000", "00000007", "00000014"]


@pytest.mark.parametrize("kind", ["score", "grid", "search", "sample"])
@pytest.mark.usefixtures("without_physics")
def test_merged_shards_are_the_run_without_shards(kind: str, tmp_path: Path) -> None:
    expected = tables(simulate(kind, tmp_path / "whole"))
    folders = [tmp_path / f"shard-{number}" for number in (1, 2)]
    for number, folder in enumerate(folders, 1):
        simulate(kind, folder, shard=f"{number}/2")
    merged = petmjx.merge_runs(folders[::-1], tmp_path / "merged")
    assert_same(merged, expected)
    full_run = load_run(tmp_path / "whole")
    assert merged.info["counts"] == full_run.info["counts"]
    assert merged.info["identity"] == full_run.info["identity"]
    assert [entry["shard"] for entry in merged.info["config"]["shards"]] == ["1/2", "2/2"]
    for table in expected:
        assert merged.units(table) == full_run.units(table)
    assert_same(simulate(kind, tmp_path / "merged", engine=Counting(0), resume=True), expected)


@pytest.mark.usefixtures("without_physics")
def test_a_shard_without_plans_is_a_run_without_worlds(tmp_path: Path) -> None:
    folders = [tmp_path / f"shard-{number}" for number in range(1, 4)]
    for kind in ("score", "grid", "search"):
        for number, folder in enumerate(folders, 1):
            simulate(kind, folder, shard=f"{number}/3", plans=PLANS[3:5], overwrite=True)
        assert len(petmjx.merge_runs(folders, tmp_path / "merged", overwrite=True).worlds.plan_id.unique()) == 2


@pytest.mark.usefixtures("without_physics")
def test_merged_shards_tell_the_input_apart_as_the_run_without_shards_does(tmp_path: Path) -> None:
    file = tmp_path / "plans.json"
    floating = [placement(), placement(corner=(0, 0, 900))]
    plans = {f"plan-{number}": [placement()] for number in range(6)}
    file.write_text(json.dumps({**plans, "odd": floating, "bad": []}))
    full_info = simulate("score", tmp_path / "whole", plans=file).info
    folders = [tmp_path / f"shard-{number}" for number in (1, 2)]
    for number, folder in enumerate(folders, 1):
        simulate("score", folder, shard=f"{number}/2", plans=file)
    merged = petmjx.merge_runs(folders, tmp_path / "merged").info
    assert full_info["counts"]["odd_plans"] == 1
    of_shards = [load_run(folder).info["counts"]["odd_plans"] for folder in folders]
    assert sorted(of_shards) == [0, 1]  # each shard counts its own plans
    assert {name: merged[name] for name in ("counts", "skipped", "warnings")} == {
        name: full_info[name] for name in ("counts", "skipped", "warnings")
    }


@pytest.mark.usefixtures("without_physics")
def test_shards_of_other_versions_are_noted(tmp_path: Path) -> None:
    folders = [tmp_path / f"shard-{number}" for number in (1, 2)]
    for number, folder in enumerate(folders, 1):
        simulate("score", folder, shard=f"{number}/2")
    edit_info(folders[1], lambda info: info["versions"].update(mujoco="2.0"))
    merged = petmjx.merge_runs(folders, tmp_path / "merged").info
    assert merged["warnings"] == [
        f"shard 2/2 was simulated with mujoco 2.0, shard 1/2 with {merged['versions']['mujoco']}"
    ]


@pytest.mark.usefixtures("without_physics")
def test_a_shard_without_its_boxes_is_not_merged(tmp_path: Path) -> None:
    folders = [tmp_path / f"shard-{number}" for number in (1, 2)]
    for number, folder in enumerate(folders, 1):
        simulate("score", folder, shard=f"{number}/2")
    (folders[1] / "boxes/part-00000.parquet").unlink()
    with pytest.raises(petmjx.InputError, match=r"shard-2/boxes/part-00000.parquet: missing"):
        petmjx.merge_runs(folders, tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


@pytest.mark.usefixtures("without_physics")
def test_shards_that_cannot_be_merged(tmp_path: Path) -> None:
    one, two = tmp_path / "1", tmp_path / "2"
    for number, folder in enumerate((one, two), 1):
        simulate("score", folder, shard=f"{number}/2")
    out = tmp_path / "out"

    def refused(*folders: Path, to: Path = out) -> str:
        with pytest.raises(petmjx.InputError) as caught:
            petmjx.merge_runs(folders, to)
        return str(caught.value)

    assert refused(one) == "missing: shard 2/2"
    assert refused(one, two, one) == f"{one}: is shard 1/2, and so is {one}"
    assert "is one of the shards" in refused(one, two, to=two)
    assert "no shard to merge" in refused()
    simulate("score", tmp_path / "whole")
    assert "not a shard" in refused(one, tmp_path / "whole")
    simulate("score", tmp_path / "3", shard="2/3")
    assert "is shard 2/3, but other runs are shards of 2" in refused(one, tmp_path / "3")
    simulate("score", tmp_path / "fixed", shard="2/2", schedule="fixed")
    assert "simulation.schedule is fixed, was adaptive" in refused(one, tmp_path / "fixed")
    info = json.loads((two / "run.json").read_text())
    leave_unfinished(two)
    assert "not finished (interrupted); finish it with resume=True first" in refused(one, two)
    n_worlds = info["counts"]["worlds"] + load_run(one).info["counts"]["worlds"]
    for table in ("worlds", "boxes"):
        (two / table / "part-00001.parquet").write_bytes((one / table / "part-00000.parquet").read_bytes())
        info["parts"][table]["part-00001.parquet"] = ""
    (two / "run.json").write_text(json.dumps(info | {"counts": info["counts"] | {"worlds": n_worlds}}))
    relisted(two)
    assert "exists twice: in" in refused(one, two)
    assert not out.exists()
