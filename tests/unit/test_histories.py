"""Tests of histories (recorded frames of worlds): which worlds have one, their frames, their files, and the stories
made from them. Recording changes no other result."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.equal_runs import assert_same, tables
from support.histories import Forgetful, assert_equal, history_of
from support.plans import make_plan, make_scene, make_world, stack
from support.programs import run_program

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Outcome, Reason, Verdict
from petmjx.options.simulation import Check, Schedule, Simulation, Solver
from petmjx.results import history_tables, run_writer
from petmjx.results.history_tables import read_history
from petmjx.results.schema import schemas
from petmjx.world.history import Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.release_places import release_of

PLANS = (
    make_plan("stands", stack(3)),
    make_plan("falls", stack(3, 260.0)),
    make_plan("a,b <i>", stack(2, 250.0)),
    make_plan("stands too", stack(1)),
)
FALLING = {"falls", "a,b <i>"}


def simulate(scene: Any, sim: Simulation, record: Record | None, **job: Any) -> Outcome:
    (outcome,) = MujocoEngine(1).run([Job(scene, record=record, **job)], sim)
    return outcome


# ---------------------------------------------------------------------- frames


SHAKE = Drive(Excitation("shake", "force", np.tile([0.6, 0.0, 0.0], (100, 1))), yaw_rad=1.0, rest_s=0.2)
TILT = Drive(Excitation("brake", "acceleration", np.tile([6.0, 0.0, 0.0], (100, 1))), rest_s=0.2)
SHORT: dict[str, Any] = {"interval_s": 0.3, "settle_s": 0.3, "duration_s": 0.6}
CASES: dict[str, dict[str, Any]] = {
    "one by one": {},
    "fixed": {"schedule": Schedule.FIXED, "early_stop": False},
    "static": {"check": Check.STATIC},
    "static, fixed": {"check": Check.STATIC, "schedule": Schedule.FIXED},
    "reference": {"physics": "reference"},
    "pushed": {"drive": SHAKE},
    "braked": {"drive": TILT},
}


@pytest.mark.parametrize("interval_s", [0.0001, 0.05], ids="{} s".format)
@pytest.mark.parametrize("case", CASES)
def test_a_recorded_world_is_the_same_to_the_last_bit(case: str, interval_s: float) -> None:
    options = dict(CASES[case])
    drive = options.pop("drive", None)
    sim = Simulation(**SHORT, **options)
    for boxes in (stack(3), stack(3, 260.0)):
        scene = make_scene(boxes, sim)
        plain = simulate(scene, sim, None, drive=drive)
        recorded = simulate(scene, sim, Record(interval_s, details=True), drive=drive)
        for name, value in vars(plain).items():
            if name == "boxes":
                for metric, values in vars(value).items():
                    np.testing.assert_array_equal(getattr(recorded.boxes, metric), values, err_msg=metric)
            elif name != "history":
                np.testing.assert_equal(getattr(recorded, name), value, err_msg=name)
        assert plain.history is None
        check_frames(recorded, sim, interval_s, drive)


def check_frames(outcome: Outcome, sim: Simulation, interval_s: float, drive: Drive | None) -> None:
    """Check that frames are at the right times, and that the poses in the last frame are those in the outcome."""
    history, n = history_of(outcome), outcome.n_boxes
    steps = np.round(history.time_s / sim.physics.timestep_s).astype(int)
    every = max(int(interval_s / sim.physics.timestep_s), 1)
    assert (np.diff(steps) > 0).all()
    assert set(range(-(-int(steps[0]) // every) * every, int(steps[-1]) + 1, every)) <= set(steps.tolist())
    first = n if sim.check is Check.STATIC else 1
    assert (history.n_placed[0], history.n_placed[-1]) == (first, outcome.n_placed)
    assert set(history.n_placed.tolist()) == set(range(first, outcome.n_placed + 1))
    placed = slice(outcome.n_placed)
    np.testing.assert_array_equal(history.pos[-1, placed], outcome.boxes.pos[placed])
    np.testing.assert_array_equal(history.quat[-1, placed], outcome.boxes.quat[placed])
    assert history.time_s[-1] == outcome.sim_time_s
    absent = np.arange(n) >= history.n_placed[:, None]
    for values in (history.pos[..., 0], history.top_force_n, history.penetration_m):
        assert values is not None
        np.testing.assert_array_equal(np.isnan(values), absent)
    assert history.drive_kind == (drive.excitation.kind if drive is not None else "")
    assert history.drive.any() == (drive is not None)
    if drive is not None and drive.excitation.kind == "acceleration":
        np.testing.assert_allclose(np.abs(history.drive).max(axis=0), [6.0, 0.0, 0.0])
        held = history.drive.any(axis=1)
        assert (history.carrier_pos[held] == history.carrier_pos[held][0]).all()


def test_a_box_begins_where_it_is_released_and_nothing_acts_on_it_yet() -> None:
    """In the first frame of a box, the box is at the place of its release, and nothing acts on it. The place of the
    release is as deep as the box's own weight will press it, and lower by the distance by which its support has
    sunk."""
    scene = make_scene(3)
    release = release_of(scene, Simulation())
    history = history_of(simulate(scene, Simulation(), Record(1.0, details=True)))
    assert history.lin_acc is not None
    for box in range(3):
        frame = int(np.argmax(history.n_placed > box))
        below = (
            history.pos[frame, box - 1] - scene.target[box - 1]
            if box
            else history.carrier_pos[frame] - scene.carrier.pos
        )
        np.testing.assert_allclose(history.pos[frame, box], release.pos[box] + [0.0, 0.0, below[2]], rtol=0, atol=1e-12)
        assert history.top_force_n[frame, box] == 0.0
        assert not history.lin_acc[frame, box].any()
    # at rest, the force on a box is the weight of the boxes above; nothing is on the last box
    np.testing.assert_allclose(history.top_force_n[-1], [2 * 5 * 9.81, 5 * 9.81, 0.0], rtol=0.01)


def test_what_a_fork_records_goes_on_from_its_placement() -> None:
    sim = Simulation(**SHORT)
    scene, record = make_scene(2), Record(0.02, details=True)
    placed = simulate(scene, sim, record, keep_state=True)
    fork = simulate(scene, sim, record, start=placed.state, drive=SHAKE)
    full_run = simulate(scene, sim, record, drive=SHAKE)
    assert np.isnan(history_of(fork).top_force_n[0]).all()
    joined = history_of(placed).then(history_of(fork))
    assert len(joined.time_s) > len(history_of(fork).time_s)
    assert_equal(joined, history_of(full_run))


class Doubtful(MujocoEngine):
    """C MuJoCo, but the outcome of every first attempt is invalid."""

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for outcome in super().run(jobs, sim, progress):
            if sim.physics.timestep_s == Simulation().physics.timestep_s:
                yield replace(outcome, verdict=Verdict.INVALID, reason=Reason.NONFINITE)
            else:
                yield outcome


def test_a_history_is_of_the_attempt_that_counts() -> None:
    plan = make_plan("p", 1)
    world = make_world(plan)
    world = replace(world, job=replace(world.job, record=Record(0.02)))
    (result,) = score_worlds([world], Simulation(), Doubtful(1))
    assert result.outcome.attempt == 5
    history = history_of(result.outcome)
    np.testing.assert_array_equal(history.pos[-1], result.outcome.boxes.pos)
    half = Simulation(solver=Solver.NEWTON).changed(
        physics={"timestep_s": 0.001}, quiet={"steps": 30, "landing_steps": 100, "poll_steps": 10}
    )
    assert_equal(history, history_of(simulate(world.job.scene, half, world.job.record)))


# ---------------------------------------------------------------------- which worlds


@pytest.mark.parametrize(
    ("record", "kept"),
    [
        ("all", {plan.plan_id for plan in PLANS}),
        ("failed", FALLING),
        ("stands,falls", {"stands", "falls"}),
        ("a,b <i>", {"a,b <i>"}),
        (["a,b <i>", "stands too"], {"a,b <i>", "stands too"}),
        (None, set()),
    ],
    ids=["all", "failed", "two ids", "one id with a comma", "a list", "none"],
)
def test_the_worlds_that_are_asked_for_have_histories(record: Any, kept: set[str]) -> None:
    run = petmjx.score(PLANS, engine="mujoco", threads=1, record=record)
    assert set(run.histories["plan_id"]) == set(run.frames["plan_id"]) == kept
    assert run.contacts.empty
    assert run.histories["lin_acc_x"].isna().all()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"record": "stands,none,nor"}, "record: none, nor: not among the 4 plans of the run"),
        ({"record": ["all"]}, "record: all: not among"),
        ({"record_details": True}, "record_details needs the option record"),
        ({"record": "all", "record_interval_s": 0}, "record_interval_s must be from 0.0001 to 3600, got 0"),
        ({"record": "all", "record_details": True, "engine": Forgetful(1)}, "record_details needs the engine mujoco"),
    ],
)
def test_what_cannot_be_recorded_is_said_in_a_line(options: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line) as error:
        petmjx.score(PLANS, **{"engine": "mujoco", **options})
    assert "\n" not in str(error.value)


def test_an_engine_without_histories_is_named() -> None:
    run = petmjx.score(PLANS, engine=Forgetful(1), record="all")
    assert run.info["warnings"] == ["the engine forgetful records no histories"]
    assert run.histories.empty


# ---------------------------------------------------------------------- tables


def recorded(folder: Path, **options: Any) -> petmjx.RunResults:
    kept = {"record": "all", "record_details": True, "record_interval_s": 0.1}
    return petmjx.score(PLANS, **{"engine": "mujoco", "threads": 1, "out": folder, **kept, **options})


def test_tables_have_every_number_with_a_unit(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run")
    plain = petmjx.score(PLANS, engine="mujoco", threads=1)
    assert_same(run, tables(plain))
    for table in ("histories", "frames", "contacts"):
        frame, units = getattr(run, table), run.units(table)
        assert not frame.empty
        assert list(units) == list(frame.columns)
        assert all(units[name] for name in frame.columns if pd.api.types.is_numeric_dtype(frame[name]))
    key = ["plan_id", "frame"]
    placed = run.histories.groupby(key).size().rename("boxes").reset_index()
    merged = run.frames.merge(placed, on=key)
    assert (merged["boxes"] == merged["n_placed"]).all()
    ends = run.histories.groupby(["plan_id", "box"]).last().reset_index().merge(run.boxes, on=["plan_id", "box"])
    for name in ("pos_x_m", "pos_y_m", "pos_z_m", "quat_w"):
        assert (ends[f"{name}_x"].astype(np.float32) == ends[f"{name}_y"]).all()


def test_a_history_comes_back_as_it_was(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run")
    for plan in PLANS:
        scene = make_world(plan).job.scene
        expected = history_of(simulate(scene, Simulation(), Record(0.1, details=True)))
        history = read_history(run, plan.plan_id, 0, plan.n_boxes)
        assert history is not None
        assert_equal(history, expected)
    assert read_history(run, "stands", 1, 3) is None


def test_drives_come_back_as_they_were() -> None:
    sim = Simulation(**SHORT)
    for drive, column in ((SHAKE, "drive_force_x_n"), (TILT, "drive_acc_x")):
        history = history_of(simulate(make_scene(1), sim, Record(0.1), drive=drive))
        columns = history_tables.frame_columns([history_tables.RecordedWorld("p", 0, history, 0)])
        np.testing.assert_array_equal(columns[column], history.drive[:, 0])
        others = {"drive_force_x_n", "drive_acc_x"} - {column}
        assert np.isnan(columns[others.pop()]).all()


def test_histories_end_a_part_before_they_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_writer, "BYTES_PER_PART", 10_000)
    run = recorded(tmp_path / "run")
    assert len(list((run.path / "worlds").iterdir())) > 2
    assert_same(run, tables(recorded(tmp_path / "other")))


def by_world(run: petmjx.RunResults) -> dict[str, pd.DataFrame]:
    names = ("histories", "frames", "contacts")
    key = ["plan_id", "variant", "frame"]
    return {name: getattr(run, name).sort_values(key, kind="stable", ignore_index=True) for name in names}


def test_a_run_that_goes_on_has_the_same_histories(tmp_path: Path) -> None:
    expected = by_world(recorded(tmp_path / "whole"))

    class Stopping(MujocoEngine):
        def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
            for number, outcome in enumerate(super().run(jobs, sim, progress)):
                if number == 2:
                    raise KeyboardInterrupt
                yield outcome

    with pytest.raises(KeyboardInterrupt):
        recorded(tmp_path / "run", engine=Stopping(1), threads=None)
    # as after a kill: there is a history, but its world was not written
    left = tmp_path / "run" / "histories" / "part-00001.parquet"
    left.write_bytes((tmp_path / "run" / "histories" / "part-00000.parquet").read_bytes())
    run = recorded(tmp_path / "run", resume=True)
    again = by_world(run)
    assert run.info["warnings"] == []
    for name, table in expected.items():
        pd.testing.assert_frame_equal(again[name], table)


def test_worlds_of_before_are_not_simulated_again_to_be_recorded(tmp_path: Path) -> None:
    recorded(tmp_path / "run", record=None, record_details=False)
    run = recorded(tmp_path / "run", record="failed", resume=True)
    assert run.histories.empty
    (line,) = run.info["warnings"]
    assert line == (
        "2 worlds of an earlier run have no history, and will not be simulated again; to "
        "record histories, name another folder"
    )


def test_shards_are_merged_with_their_histories(tmp_path: Path) -> None:
    shards = [tmp_path / f"shard{number}" for number in (1, 2)]
    for number, folder in enumerate(shards, 1):
        recorded(folder, shard=f"{number}/2")
    merged = by_world(petmjx.merge_runs(shards, tmp_path / "whole"))
    for name, table in by_world(recorded(tmp_path / "one")).items():
        pd.testing.assert_frame_equal(merged[name], table)


def test_a_new_run_takes_the_old_histories_away(tmp_path: Path) -> None:
    recorded(tmp_path / "run")
    assert recorded(tmp_path / "run", record=None, record_details=False, overwrite=True).histories.empty


# ---------------------------------------------------------------------- docs


def test_examples_of_the_docs_run(repository: Path, tmp_path: Path) -> None:
    """All Python blocks of the page about histories run as one program."""
    text = (repository / "docs" / "histories.md").read_text(encoding="utf-8")
    program = "\n".join(re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE))
    printed = run_program(program, folder=tmp_path)
    assert "hand-overhang-55" in printed
    assert "as in the run" in printed


def test_the_docs_name_the_columns(repository: Path) -> None:
    """The page about histories names all columns. Of vectors, it names at least the first component."""
    text = (repository / "docs" / "histories.md").read_text(encoding="utf-8")
    tables = schemas()
    followed = re.compile(r"_[yz](_m|_n)?$")
    for table in ("histories", "frames", "contacts"):
        names = [name for name in tables[table].names if not followed.search(name)]
        names = [
            name for name in names if not re.fullmatch(r"carrier_quat_x", name) and name not in ("variant", "rank")
        ]
        assert [name for name in names if f"`{name}`" not in text] == []
