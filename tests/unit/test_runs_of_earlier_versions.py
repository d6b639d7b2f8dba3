"""Run folders of earlier versions, whose rows have no ranks, are read, resumed and merged.

``tests/support/old_runs.zip`` was written at commit 6a85e320 by the engine of ``support.fake_engine``, in parts of two
worlds. The zip file has these runs: ``whole``, complete; ``cut``, interrupted after three worlds; the shards ``one``
and ``two``; ``recorded``, made with ``mujoco``; and ``large-cut``, a sweep that was interrupted after eleven worlds and
whose parts are numbered as in runs of more than 50,000 worlds.
"""

from __future__ import annotations

import copy
import functools
import io
import zipfile
from collections.abc import Mapping
from operator import getitem
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest
from support.fake_engine import LargestFirst
from support.plans import make_plan, stack

import petmjx
from petmjx.options.simulation import Simulation
from petmjx.results.history_tables import read_history
from petmjx.results.run_manifest import CHANGED_RESULTS, Manifest
from petmjx.results.run_reader import rows_of

PLANS = [make_plan(f"plan-{(3 * k) % 5}", stack(1 + (2 * k) % 3)) for k in range(5)]
"""The plans of these runs, sorted neither by id nor by size."""

IDS = [plan.plan_id for plan in PLANS]
ERRORS = "replicates = 4\n[axes]\nplacement_error_mm = 3\n"
ARCHIVE = Path(__file__).parents[1] / "support/old_runs.zip"

UNCHANGED_RESULTS = {
    *("attempts", "carrier", "check", "check_timestep", "duration_s", "early_stop", "friction_pairs", "interval_s"),
    *("iteration_limit", "rest_s", "rest_window_s", "sample_interval_s", "schedule", "settle_s", "size_reduction_mm"),
    *("soft", "solver", "solver_iterations", "solver_tolerance", "total_time_factor", "quiet.poll_steps"),
    *("physics.box_friction", "physics.carrier_friction", "physics.carrier_half_height_m", "physics.carrier_mass_kg"),
    *("physics.cone", "physics.floor_friction", "physics.floor_z_m", "physics.gravity_m_s2", "physics.name"),
    *("physics.kinetic_friction_share", "physics.solimp", "physics.solref", "physics.timestep_s", "placing.force_n"),
    *("placing.height_mm", "placing.name", "placing.side_mm", "placing.speed_m_s", "placing.tines_mm"),
    *("thresholds.ang_acc_rad_s2", "thresholds.drop_hull_z_m", "thresholds.lin_acc_m_s2", "thresholds.shift_floor_m"),
    *(
        "thresholds.shift_m",
        "thresholds.tilt_deg",
        "walls.friction",
        "walls.gap_mm",
        "walls.height_mm",
        "walls.mass_kg_m2",
    ),
    *("walls.material", "walls.open", "walls.sides", "walls.thickness_mm", "wrap.film_mm", "wrap.force_n"),
    *("wrap.friction", "wrap.hat_n", "wrap.turns"),
}
"""Options without which a run of an earlier version has the results of a run with their defaults."""


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("old-runs")
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(folder)
    return folder


@pytest.fixture
def old_runs(unpacked: Path, tmp_path: Path) -> Path:
    """A copy of the old runs that a test may change."""
    with zipfile.ZipFile(ARCHIVE) as archive:
        archive.extractall(tmp_path)
    return tmp_path


@functools.cache
def old_columns(table: str) -> set[str]:
    """The columns of a table in the old runs."""
    with zipfile.ZipFile(ARCHIVE) as archive:
        parts = [io.BytesIO(archive.read(name)) for name in archive.namelist() if f"/{table}/" in name]
    return {column for part in parts for column in pq.read_schema(part).names}


def assert_same_tables(results: petmjx.RunResults, expected: petmjx.RunResults) -> None:
    """Check that all tables are equal to the last bit, except for columns that the old runs did not have."""
    for table in ("worlds", "boxes", "attempts", "summary"):
        frame, expected_frame = getattr(results, table), getattr(expected, table)
        assert (frame is None) == (expected_frame is None)
        if frame is not None:
            newer = {*frame, *expected_frame} - old_columns(table) if table in ("worlds", "boxes") else ()
            both = (some.drop(columns=[*newer], errors="ignore") for some in (frame, expected_frame))
            pd.testing.assert_frame_equal(*both, check_exact=True, obj=table)
    assert results.info["counts"] == expected.info["counts"]


def assert_ranked(results: petmjx.RunResults, ranks: range) -> None:
    """Check that all rows in the files have ranks, and that the ranks sort the rows in the same order as that of the
    results."""
    for table, frame in (("worlds", results.worlds), ("boxes", results.boxes)):
        rows = pd.read_parquet(results.path / table).sort_values("rank", kind="stable")
        assert rows.plan_id.tolist() == frame.plan_id.tolist()
        assert rows["rank"].unique().tolist() == [*ranks]


def scored(**options: object) -> petmjx.RunResults:
    return petmjx.score(PLANS, engine=LargestFirst(), **options)


def test_a_run_reads_as_the_same_run_of_today(unpacked: Path, tmp_path: Path) -> None:
    old = petmjx.load_run(unpacked / "whole")
    assert old.worlds.plan_id.tolist() == IDS
    assert_same_tables(old, scored())
    assert_same_tables(old, scored(out=tmp_path / "new"))


def test_an_interrupted_run_reads_in_the_order_of_its_plans(unpacked: Path) -> None:
    old = petmjx.load_run(unpacked / "cut")
    assert old.worlds.plan_id.tolist() == [plan_id for plan_id in IDS if plan_id in {*old.worlds.plan_id}]
    assert len(old.worlds) == old.info["counts"]["worlds"] == 3
    assert [IDS[number] for number in old.worlds.index] == old.worlds.plan_id.tolist()


def test_an_interrupted_run_is_resumed(old_runs: Path) -> None:
    resumed = scored(out=old_runs / "cut", resume=True)
    assert_same_tables(resumed, scored())
    assert_ranked(resumed, range(5))


def test_a_large_interrupted_run_is_resumed(old_runs: Path) -> None:
    (old_runs / "errors.toml").write_text(ERRORS)

    def sweep(**options: object) -> petmjx.RunResults:
        return petmjx.sweep(old_runs / "errors.toml", PLANS, engine=LargestFirst(), **options)

    assert len(petmjx.load_run(old_runs / "large-cut").worlds) == 11
    resumed = sweep(out=old_runs / "large-cut", resume=True)
    assert_same_tables(resumed, sweep())
    assert_ranked(resumed, range(20))


@pytest.mark.parametrize("of_today", [False, True])
def test_shards_are_merged(of_today: bool, old_runs: Path) -> None:
    """Two old shards are merged, in any order, and so are an old shard and one of today."""
    second = scored(out=old_runs / "new", shard="2/2").path if of_today else old_runs / "two"
    merged = petmjx.merge_runs([second, old_runs / "one"], old_runs / "merged")
    assert_same_tables(merged, petmjx.load_run(old_runs / "whole"))
    assert_ranked(merged, range(5))


def paths_of(options: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The paths of all options and of all tables of options."""
    inner = ((name, *path) for name, value in options.items() if isinstance(value, dict) for path in paths_of(value))
    return [*((name,) for name in options), *inner]


def difference(options: Mapping[str, Any], earlier: Mapping[str, Any]) -> str:
    return Manifest({"simulation": options}, {}).difference_from(Manifest({"simulation": earlier}, {}))


def test_it_is_known_of_each_option_whether_its_default_changed_results() -> None:
    paths = {".".join(path) for path in paths_of(Simulation().model_dump(mode="json"))}
    tables = {path.rpartition(".")[0] for path in paths}
    assert paths >= CHANGED_RESULTS
    undecided = (paths - tables - CHANGED_RESULTS) ^ UNCHANGED_RESULTS
    assert not undecided, "if the default of a new option changed results: CHANGED_RESULTS; else UNCHANGED_RESULTS"


def test_an_option_that_an_earlier_version_did_not_have_has_its_default() -> None:
    carrier = {"boards": [{"corner_mm": (0, 0, 0), "size_mm": (1200, 800, 144)}], "mass_kg": 25.0}
    pairs = [{"between": ("wood", "steel"), "friction": 0.3}]
    options = Simulation(carrier=carrier, friction_pairs=pairs).model_dump(mode="json")
    for path in paths_of(Simulation().model_dump(mode="json")):
        *tables, name = path
        earlier = copy.deepcopy(options)
        del functools.reduce(getitem, tables, earlier)[name]
        given = name in ("carrier", "friction_pairs")
        changed = any(f"{entry}.".startswith(f"{'.'.join(path)}.") for entry in CHANGED_RESULTS)
        assert bool(difference(options, earlier)) == (given or changed), path
    earlier = copy.deepcopy(options)
    del earlier["carrier"]["walls"], earlier["friction_pairs"][0]["kinetic"], earlier["physics"]["landing_s"]
    assert difference(options, earlier) == "simulation.physics.landing_s is 0.003, was none"


def test_a_message_about_an_option_that_no_longer_exists_names_no_other_option() -> None:
    options = Simulation(friction_pairs=[{"between": ("wood", "steel"), "friction": 0.3}]).model_dump(mode="json")
    earlier = copy.deepcopy(options)
    earlier["quiet"]["min_steps"] = 50
    del earlier["walls"], earlier["wrap"]["hat_n"]
    assert difference(options, earlier) == "simulation.quiet.min_steps is none, was 50"


def test_histories_are_read(unpacked: Path) -> None:
    old = petmjx.load_run(unpacked / "recorded")
    assert old.worlds.plan_id.tolist() == old.frames.plan_id.unique().tolist() == IDS[:3]
    for plan in PLANS[:3]:
        history = read_history(old, plan.plan_id, 0, plan.n_boxes)
        assert history is not None
        assert history.pos.shape[1] == plan.n_boxes
        boxes = rows_of(old, "boxes", plan.plan_id, 0)
        assert boxes is not None
        assert boxes.num_rows == plan.n_boxes
