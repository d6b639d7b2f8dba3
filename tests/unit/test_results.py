"""Results on disk: they are read back as they were written, and each file is complete or absent."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from support.outcomes import dropped_outcome, make_outcome, make_plan
from support.runs import edit_info

from petmjx.common.errors import InputError
from petmjx.engines.verdict import Attempt, Flag, Reason, Verdict
from petmjx.options.simulation import Schedule
from petmjx.plans.plan_set import Skipped
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import SCHEMA_VERSION, Param, schemas, summary_table
from petmjx.results.to_json import to_json

SPEC_WORLDS = (
    "plan_id variant rank engine solver attempt schedule n_boxes n_placed verdict reason culprit margin "
    "plan_edge_m plan_edge_box rest_edge_m rest_edge_box build_edge_m build_edge_box build_edge_step first_sign_s "
    "max_shift_m max_tilt_deg n_dropped first_drop_s max_lin_acc max_ang_acc max_top_force_n rest_top_force_n "
    "sim_time_s n_steps flags"
)
SPEC_BOXES = (
    "plan_id variant rank box item_id article sequence shift_x_m shift_y_m shift_z_m max_tilt_deg dropped drop_s "
    "max_lin_acc max_ang_acc max_top_force_n rest_top_force_n pos_x_m pos_y_m pos_z_m quat_w quat_x quat_y quat_z "
    "plan_edge_m rest_edge_m"
)


def write_run(
    folder: Path, ids: tuple[str, ...] = ("a", "b"), end: BaseException | None = None, **options: Any
) -> None:
    """Write a run with a stable world for each id. If ``end`` is given, it is raised after the last world."""
    with RunWriter(folder, {}, **options) as run:
        for plan_id in ids:
            run.add(make_plan(plan_id), 0, "fixed", make_outcome())
        if end is not None:
            raise end


def read_all(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    results = load_run(folder)
    return results.worlds, results.boxes


def part_files(folder: Path) -> list[str]:
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


def test_columns_are_the_specified_ones_and_carry_units(tmp_path: Path) -> None:
    write_run(tmp_path)
    worlds = pq.read_schema(tmp_path / "worlds/part-00000.parquet")
    boxes = pq.read_schema(tmp_path / "boxes/part-00000.parquet")
    assert " ".join(worlds.names) == SPEC_WORLDS
    assert " ".join(boxes.names) == SPEC_BOXES
    assert " ".join(schemas(dynamic=True)["boxes"].names) == f"{SPEC_BOXES} max_sway_m"
    assert worlds.metadata[b"schema_version"] == str(SCHEMA_VERSION).encode()
    for schema in (worlds, boxes):
        for column in schema:
            assert set(column.metadata) == {b"unit", b"description"}
            assert column.metadata[b"description"]
    assert worlds.field("max_lin_acc").metadata[b"unit"] == b"m/s^2"
    schedule = worlds.field("schedule").metadata[b"description"].decode()
    assert all(name in schedule for name in Schedule)
    suffixes = {"_m": b"m", "_s": b"s", "_n": b"N", "_deg": b"deg"}
    for column in (*worlds, *boxes):
        for suffix, unit in suffixes.items():
            if column.name.endswith(suffix):
                assert column.metadata[b"unit"] == unit, column.name


def test_round_trip(tmp_path: Path) -> None:
    refused = "plans.json: plan bad, placement 0: weight/kg must be > 0, got -1"
    with RunWriter(tmp_path / "run", {"sim": {"interval_s": 0.7}}, versions={"mujoco": "3"}, device="cpu") as run:
        run.add(make_plan("stands"), 0, "adaptive", make_outcome())
        run.add(make_plan("falls"), 0, "adaptive", dropped_outcome())
        run.skip(Skipped("plans.json", "bad", refused))
        run.timings["simulate_s"] = 2.0
    results = load_run(tmp_path / "run")
    stands, falls = results.worlds.to_dict("records")
    assert (stands["plan_id"], stands["verdict"], stands["reason"]) == ("stands", "stable", "")
    assert pd.isna(stands["culprit"])
    assert pd.isna(stands["first_sign_s"])
    assert pd.isna(stands["first_drop_s"])
    assert stands["max_shift_m"] == 0.006  # the largest component of the shift of box 2 is -2 · 3 mm
    assert (stands["max_tilt_deg"], stands["max_lin_acc"], stands["max_ang_acc"]) == (3.0, 30.0, 60.0)
    assert (stands["max_top_force_n"], stands["rest_top_force_n"]) == (300.0, 150.0)
    assert (stands["sim_time_s"], stands["n_steps"], stands["n_dropped"]) == (1.5, 750, 0)
    assert (falls["verdict"], falls["reason"], falls["culprit"]) == ("unstable", "drop", 1)
    assert (falls["first_sign_s"], falls["n_dropped"], falls["first_drop_s"]) == (0.4, 1, 0.8)
    assert (falls["n_placed"], falls["flags"]) == (2, int(Flag.EARLY_STOP))
    assert falls["max_tilt_deg"] == 2.0  # box 2 was never placed and does not count
    assert pd.isna(falls["rest_top_force_n"])
    boxes = results.boxes[results.boxes.plan_id == "falls"].reset_index(drop=True)
    assert boxes.box.tolist() == [0, 1, 2]
    assert boxes.item_id.tolist() == ["item-0", "item-1", "item-2"]
    assert boxes.sequence.tolist() == [1, 2, 3]
    assert boxes.dropped.tolist() == [False, True, False]
    assert boxes.loc[2, ["shift_x_m", "max_tilt_deg", "pos_x_m", "quat_w"]].isna().all()
    assert boxes.shift_y_m[1] == np.float32(-0.004)
    assert results.info["status"] == "finished"
    assert results.info["counts"] == {
        "worlds": 2,
        "stable": 1,
        "unstable": 1,
        "invalid": 0,
        "by_reason": {"unstable": {"drop": 1}, "invalid": {}},
        "moving": 0,
        "moving_by_shift": 0,
        "leans": 0,
        "retried": 0,
        "skipped_plans": 1,
        "odd_plans": 0,
    }
    assert results.info["config"] == {"sim": {"interval_s": 0.7}}
    assert results.info["versions"].keys() == {"python", "mujoco"}
    assert results.info["skipped"] == [{"plan_id": "bad", "source": "plans.json", "error": refused}]
    assert results.info["timings"]["simulate_s"] == 2.0
    assert results.summary is None
    assert results.attempts.empty


def test_the_repr_is_a_line(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run", {"command": "score"}) as run:
        run.add(make_plan("stands"), 0, "adaptive", make_outcome())
        run.add(make_plan("falls"), 0, "adaptive", dropped_outcome())
    line = f"RunResults({tmp_path}/run: 2 plans, 1 stable, 1 unstable, 0 invalid; finished)"
    assert repr(load_run(tmp_path / "run")) == line
    with RunWriter(tmp_path / "sweep", {"command": "sweep"}) as run:
        run.add(make_plan(), 0, "adaptive", make_outcome())
    assert ": 1 world, 1 stable" in repr(load_run(tmp_path / "sweep"))


def test_anything_becomes_plain_json() -> None:
    frame = pd.DataFrame({"n": pd.array([1, None], "Int64"), "x": [np.inf, 0.5]})
    value = {Verdict.STABLE: (np.float32(0.5), np.arange(2), Path("a")), 1: [np.nan, None, True, pd.NA], "f": frame}
    assert to_json(value) == {
        "stable": [0.5, [0, 1], "a"],
        "1": [None, None, True, None],
        "f": [{"n": 1, "x": None}, {"n": None, "x": 0.5}],
    }


def test_outcomes_are_copied(tmp_path: Path) -> None:
    outcome = make_outcome()
    with RunWriter(tmp_path, {}) as run:
        run.add(make_plan(), 0, "fixed", outcome)
        outcome.boxes.max_tilt_deg[:] = 99.0
    assert load_run(tmp_path).worlds.max_tilt_deg.tolist() == [3.0]


def test_other_readers(tmp_path: Path) -> None:
    write_run(tmp_path / "out", ids=tuple("abcde"), worlds_per_part=2)
    out = tmp_path / "out"
    rows = duckdb.sql(
        f"SELECT verdict, count(*) FROM '{out}/worlds/*.parquet' JOIN '{out}/boxes/*.parquet' "
        "USING (plan_id, variant) GROUP BY verdict"
    ).fetchall()
    assert rows == [("stable", 15)]
    assert len(pd.read_parquet(out / "worlds")) == 5
    assert len(pd.read_parquet(out / "boxes")) == 15


def test_attempts_are_kept_where_there_was_more_than_one(tmp_path: Path) -> None:
    first = make_outcome(verdict=Verdict.INVALID, reason=Reason.EXPLOSION, flags=Flag.EXPLOSION)
    last = make_outcome(solver="cg", attempt=2)
    attempts = [Attempt.of(first, 0.002), Attempt.of(last, 0.002)]
    with RunWriter(tmp_path, {}) as run:
        run.add(make_plan("a"), 0, "fixed", last, attempts)
        run.add(make_plan("b"), 0, "fixed", make_outcome(), [Attempt.of(make_outcome(), 0.002)])
    results = load_run(tmp_path)
    assert results.attempts[["plan_id", "attempt", "solver", "verdict", "reason"]].values.tolist() == [
        ["a", 1, "newton", "invalid", "explosion"],
        ["a", 2, "cg", "stable", ""],
    ]
    assert results.attempts.timestep_s.tolist() == [0.002, 0.002]
    assert results.worlds.attempt.tolist() == [2, 1]
    assert results.info["counts"]["retried"] == 1


def test_sweep_parameters_are_columns_with_units(tmp_path: Path) -> None:
    params = [Param("level_g", "g", "hold of the trapezoid"), Param("profile", "", "which one", str)]
    with RunWriter(tmp_path, {}, params=params, dynamic=True) as run:
        outcome = make_outcome(max_sway_m=np.array([0.1, 0.2, 0.3]))
        run.add(make_plan(), 0, "fixed", outcome)
        run.add(make_plan(), 1, "fixed", outcome, params={"profile": "tilt", "level_g": 0.5})
        with pytest.raises(ValueError, match="no parameter 'yaw'"):
            run.add(make_plan(), 2, "fixed", outcome, params={"yaw": 1})
    results = load_run(tmp_path)
    assert results.worlds.columns[-2:].tolist() == ["level_g", "profile"]
    assert results.worlds.level_g[1] == 0.5
    assert results.worlds.profile[1] == "tilt"
    assert results.worlds[["level_g", "profile"]].isna().iloc[0].all()
    assert results.units("worlds")["level_g"] == "g"
    assert results.boxes.max_sway_m.iloc[0] == np.float32(0.1)
    assert results.info["params"][0] == {"name": "level_g", "unit": "g", "description": "hold of the trapezoid"}


def test_a_parameter_cannot_take_a_columns_name() -> None:
    with pytest.raises(ValueError, match="'flags'"):
        schemas([Param("flags")])


def test_summary(tmp_path: Path) -> None:
    frame = pd.DataFrame({"plan_id": ["a"], "share_standing": [0.75], "n": [4]})
    with pytest.raises(ValueError, match="'n' needs a unit"):
        summary_table(frame, {"share_standing": "1"})
    with RunWriter(tmp_path, {}) as run:
        run.write_summary(summary_table(frame, {"share_standing": "1", "n": "1"}, {"n": "worlds"}))
    results = load_run(tmp_path)
    assert results.summary is not None
    assert results.summary.to_dict("records") == frame.to_dict("records")
    assert results.units("summary") == {"plan_id": "", "share_standing": "1", "n": "1"}


def test_a_run_without_worlds_has_its_columns(tmp_path: Path) -> None:
    write_run(tmp_path, ids=())
    assert " ".join(pd.read_parquet(tmp_path / "worlds").columns) == SPEC_WORLDS
    results = load_run(tmp_path)
    assert results.worlds.empty
    assert results.boxes.empty


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda run: (run / "run.json").unlink(), "no run of petmjx there"),
        (lambda run: (run / "run.json").write_text("{"), r"run.json: damaged: not JSON at line 1, column 2 \(Exp"),
        (lambda run: (run / "run.json").write_text("{}x"), r"damaged: not JSON at line 1, column 3 \(more text after"),
        (lambda run: (run / "run.json").write_text("9" * 5000), "run.json: damaged: not JSON$"),
        (lambda run: (run / "run.json").write_bytes(b"\xff\xfe"), "run.json: damaged: not UTF-8 text"),
        (lambda run: (run / "run.json").write_text("[]"), "not written by petmjx"),
        (lambda run: (run / "run.json").write_text('{"schema_version": 99}'), "newer petmjx"),
        (
            lambda run: (run / "run.json").write_text(
                (run / "run.json").read_text().replace('"stable": 2', '"stable": 1')
            ),
            "differs from what",
        ),
        (lambda run: _edit(run, counts=[]), "run.json: damaged: counts must be a table"),
        (lambda run: _edit(run, counts={"worlds": "2"}), "run.json: damaged: counts.worlds must be a whole number"),
        (lambda run: _edit(run, params=[1]), r"run.json: damaged: params\[0\] must be a table"),
        (lambda run: _edit(run, versions={"numpy": 2}), "run.json: damaged: versions.numpy must be text"),
        (lambda run: _edit(run, parts={"worlds": {"../a.parquet": "0" * 32}}), "run.json: damaged: parts.worlds"),
        (lambda run: _edit(run, parts={"a": {}}), "damaged: parts.a does not have the form in which petmjx writes it"),
        (lambda run: _edit(run, timings={"wall_s": "2"}), "run.json: damaged: timings.wall_s must be a finite number"),
        (lambda run: (run / "run.json").write_text("[" * 1_000_000), "run.json: damaged: not JSON"),
        (lambda run: _fifo(run / "run.json"), "run.json: cannot be read"),
        (lambda run: _fifo(run / "worlds/part-00000.parquet"), "worlds/part-00000.parquet: damaged"),
        (lambda run: (run / "worlds/part-00000.parquet").write_bytes(b"PAR1"), "worlds/part-00000.parquet: damaged"),
        (lambda run: _truncate(run / "boxes/part-00000.parquet"), "boxes/part-00000.parquet: damaged"),
        (lambda run: (run / "boxes/part-00000.parquet").unlink(), "boxes/part-00000.parquet: missing"),
    ],
)
def test_damaged_runs_get_one_clear_line(tmp_path: Path, damage: Any, message: str) -> None:
    write_run(tmp_path)
    damage(tmp_path)
    with pytest.raises(InputError, match=message) as caught:
        read_all(tmp_path)
    assert "\n" not in str(caught.value)


def _edit(run: Path, **values: Any) -> None:
    edit_info(run, lambda info: info.update(values))


def _fifo(file: Path) -> None:
    file.unlink(missing_ok=True)
    os.mkfifo(file)


def _truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-100])


def test_a_folder_may_have_any_name(tmp_path: Path) -> None:
    for name in ("a=1", "s3:bucket", "_x", os.fsdecode(b"\xff")):
        write_run(tmp_path / name)
        assert all(len(table) for table in read_all(tmp_path / name))


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        load_run(tmp_path / "nowhere")


def test_an_outcome_of_another_plan_is_refused(tmp_path: Path) -> None:
    with RunWriter(tmp_path, {}) as run, pytest.raises(ValueError, match="has 3 boxes, but its outcome has 2"):
        run.add(make_plan(n=3), 0, "fixed", make_outcome(n=2))


def test_writing_is_never_what_a_run_waits_for(tmp_path: Path) -> None:
    plan, outcome = make_plan(n=43), make_outcome(n=43)
    start = time.process_time()
    with RunWriter(tmp_path, {}) as run:
        for number in range(4_000):
            run.add(plan, number, "fixed", outcome)
    worlds_per_s = 4_000 / (time.process_time() - start)
    # An idle core writes about 10,000 worlds/s; the limit allows for a busy machine. An H100 finishes a few hundred
    # worlds/s.
    assert worlds_per_s > 2_000
