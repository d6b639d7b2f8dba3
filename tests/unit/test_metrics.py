"""Tests of the table of metrics, of everything that is derived from this table, and of the verdict that follows from
the metrics."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.outcomes import make_outcome, make_plan

from petmjx.analysis.run_comparison import compare_runs
from petmjx.common.units import FloatArray
from petmjx.engines import metrics
from petmjx.engines.metrics import BoxMetric, BoxMetrics, Reduction, SampleAt, WorldReduction, markdown, reduce_boxes
from petmjx.engines.verdict import INVALID_FLAGS, Flag, Outcome, Reason, Verdict, judge
from petmjx.options.thresholds import FAILURES, Thresholds, largest_excess
from petmjx.results.run_reader import load_run
from petmjx.results.run_writer import RunWriter


@pytest.fixture(scope="module")
def documentation(repository: Path) -> str:
    return (repository / "docs/metrics.md").read_text(encoding="utf-8")


def test_the_documentation_has_the_tables_of_the_spec(documentation: str) -> None:
    assert markdown() in documentation, "docs/metrics.md: paste what python -m petmjx.engines.metrics prints"


def test_the_documentation_has_all_flags_and_reasons_in_their_order(documentation: str) -> None:
    for flag in Flag:
        assert f"| {flag.value} | {str(flag.name).lower().replace('_', '-')} |" in documentation
    order = [*(reason for _, reason in INVALID_FLAGS), *LATER]
    places = [documentation.index(f"| `{reason}` |") for reason in order]
    assert places == sorted(places)
    assert set(order) == set(Reason) - {Reason.NONE}


def test_every_metric_has_a_field_and_every_field_a_metric() -> None:
    attributes = [metric.attribute for metric in metrics.box_metrics()]
    assert sorted(attributes) == sorted(field.name for field in fields(BoxMetrics))
    assert {metric.name for metric in metrics.world_metrics()} <= {field.name for field in fields(Outcome)}
    for columns in (metrics.box_columns(), metrics.world_columns()):
        assert len({column.name for column in columns}) == len(columns)


@dataclass(eq=False)
class MoreMetrics(BoxMetrics):
    """Metrics of boxes with an additional metric, which petmjx does not have."""

    spin: FloatArray


@pytest.fixture
def add_metric(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[BoxMetric], None]]:
    """A function that adds a metric to the table and reads the table again. After the test, the metric is removed."""

    def read_anew() -> None:
        metrics.box_metrics.cache_clear()
        metrics.world_metrics.cache_clear()

    def add(metric: BoxMetric) -> None:
        monkeypatch.setattr(metrics, "METRICS", (*metrics.METRICS, metric))
        read_anew()

    yield add
    monkeypatch.undo()
    read_anew()


def test_a_new_metric_reaches_files_units_and_comparison(
    tmp_path: Path, add_metric: Callable[[BoxMetric], None]
) -> None:
    columns = {"spin_x": "turns about x", "spin_y": "turns about y"}
    most = WorldReduction("max_spin", Reduction.LARGEST, "most turns of any box")
    spin = BoxMetric("spin", "1", columns, SampleAt.SAMPLES, "turns", of_world=most, relative=True)
    made = {"a": (make_outcome(), 1.0), "b": (make_outcome(), 1.5)}
    add_metric(spin)
    for folder, (outcome, factor) in made.items():
        values = np.array([[1.0, -2.0], [0.5, 0.0], [np.nan, np.nan]]) * 100 * factor
        outcome.boxes = MoreMetrics(**vars(outcome.boxes), spin=values)
        with RunWriter(tmp_path / folder, {}) as run:
            run.add(make_plan(), 0, "fixed", outcome)
    results = load_run(tmp_path / "a")
    assert results.boxes["spin_y"].tolist()[:2] == [-200.0, 0.0]
    assert results.boxes["spin_y"].isna().tolist() == [False, False, True]
    assert results.worlds["max_spin"].tolist() == [200.0]
    assert results.units("boxes")["spin_x"] == results.units("worlds")["max_spin"] == "1"
    column = pq.read_schema(tmp_path / "a/worlds/part-00000.parquet").field("max_spin")
    assert column.metadata[b"description"] == b"most turns of any box"
    comparison = compare_runs(tmp_path / "a", tmp_path / "b")
    largest = {row["metric"]: row["largest"] for row in comparison.boxes.to_dict("records")}
    assert (largest["spin_x"], largest["spin_y"], largest["spin_y relative"]) == (50.0, 100.0, 0.5)
    assert dict(zip(comparison.worlds["metric"], comparison.worlds["largest"], strict=True))["max_spin"] == 100.0
    assert "`max_spin` | 1 | float64 | largest magnitude of `spin_x`, `spin_y`" in markdown()


@pytest.mark.parametrize(
    ("reduction", "expected"),
    [(Reduction.LARGEST, [3.0, np.nan]), (Reduction.SMALLEST, [-3.0, np.nan]), (Reduction.COUNT, [1.0, 0.0])],
)
def test_boxes_without_a_value_do_not_count(reduction: Reduction, expected: list[float]) -> None:
    values = np.array([[1.0, 2.0], [-3.0, 0.0], [np.nan, np.nan], [np.nan, np.nan]])
    np.testing.assert_array_equal(reduce_boxes(reduction, values, np.array([0, 2])), expected)
    assert reduce_boxes(reduction, values[:0], np.array([], int)).shape == (0,)


# ---------------------------------------------------------------------- verdict


def everything_wrong() -> BoxMetrics:
    return replace(
        make_outcome().boxes,
        shift_m=np.array([[0.0, 0.0, 0.0], [0.0, -0.03, 0.0], [0.0, 0.0, 0.0]]),
        max_tilt_deg=np.array([0.0, 30.0, 0.0]),
        dropped=np.array([False, True, False]),
    )


def test_reasons_are_looked_at_in_their_order() -> None:
    steps = [
        (Flag.FAILED, Reason.FAILED),
        (Flag.NONFINITE, Reason.NONFINITE),
        (Flag.CONTACT_OVERFLOW, Reason.OVERFLOW),
        (Flag.CONSTRAINT_OVERFLOW, Reason.OVERFLOW),
        (Flag.OTHER_OVERFLOW, Reason.OVERFLOW),
        (Flag.OUT_OF_MEMORY, Reason.OUT_OF_MEMORY),
        (Flag.EXPLOSION, Reason.EXPLOSION),
        (Flag.TIMEOUT, Reason.TIMEOUT),
        (Flag.ITERATION_LIMIT, Reason.ITERATION_LIMIT),
    ]
    flags = ~Flag.NONE
    boxes = everything_wrong()
    before = (Verdict.UNSTABLE, Reason.TILT)
    for flag, reason in steps:
        assert judge(flags, boxes, 3, Thresholds(), sank=True, placement=before) == (Verdict.INVALID, reason)
        flags &= ~flag
    harmless = Flag.EARLY_STOP | Flag.RERUN_AFTER_OVERFLOW | Flag.FORKED | Flag.SINKING | Flag.MOVING
    assert flags == harmless | Flag.KNIFE_EDGE | Flag.TIMESTEP | Flag.LEANS | Flag.NOT_PLACED
    assert judge(flags, boxes, 3, Thresholds(), sank=True, placement=before) == (Verdict.INVALID, Reason.SINKING)
    assert judge(flags, boxes, 3, Thresholds(), placement=before) == (Verdict.UNSTABLE, Reason.DROP)
    boxes.dropped[:] = False
    assert judge(flags, boxes, 3, Thresholds()) == (Verdict.UNSTABLE, Reason.TILT)
    boxes.max_tilt_deg[:] = 0
    assert judge(flags, boxes, 3, Thresholds()) == (Verdict.UNSTABLE, Reason.SHIFT)
    assert judge(flags, boxes, 3, Thresholds(shift_m=0.03), placement=before) == before
    assert judge(flags, boxes, 3, Thresholds(shift_m=0.03)) == (Verdict.STABLE, Reason.NONE)
    assert {reason for _, reason in steps} | {Reason.NONE, *LATER} == set(Reason)


LATER = (Reason.SINKING, *(failure.reason for failure in FAILURES))
"""Reasons of verdicts that do not follow from a single flag, in the order in which they are checked."""


def test_every_reason_has_its_words() -> None:
    assert all(reason.words for reason in Reason if reason is not Reason.NONE)
    for failure in FAILURES:
        assert failure.reason.words.format(**Thresholds().model_dump())
        assert ("{" + failure.threshold + "}" in failure.reason.words) == bool(failure.threshold)


def test_what_was_not_measured_has_no_value() -> None:
    metrics = BoxMetrics.measured(2, max_tilt_deg=np.ones(2))
    assert metrics.max_tilt_deg.tolist() == [1.0, 1.0]
    assert metrics.dropped.tolist() == [False, False]
    assert np.isnan(metrics.quat).all()
    assert metrics.quat.shape == (2, 4)
    assert np.isnan(metrics.drop_s).tolist() == [True, True]
    assert largest_excess(metrics, Thresholds(tilt_deg=4.0)).tolist() == [0.25, 0.25]
    with pytest.raises(TypeError, match="max_tilt"):
        BoxMetrics.measured(2, max_tilt=np.ones(2))


@pytest.mark.parametrize("shape", [(3,), (0,), (2, 3)])
def test_metrics_are_the_same_after_a_pickle(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    columns = {metric.attribute: metric.nothing(*shape) for metric in metrics.box_metrics()}
    some = {name: rng.random(values.shape) for name, values in columns.items() if values.dtype == np.float64}
    before = BoxMetrics(**(some | {"dropped": rng.random(shape) < 0.5, "drop_s": columns["drop_s"]}))
    after = pickle.loads(pickle.dumps(before))
    assert type(after) is BoxMetrics
    for name, nothing in columns.items():
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), strict=True, err_msg=name)
        assert getattr(after, name).dtype == nothing.dtype


def test_boxes_that_were_not_placed_are_not_judged() -> None:
    assert judge(Flag.NONE, everything_wrong(), 1, Thresholds()) == (Verdict.STABLE, Reason.NONE)


@pytest.mark.parametrize(("name", "limit"), [("max_tilt_deg", 20.0), ("shift_m", 0.02)])
def test_float32_metrics_are_judged_as_the_device_would(name: str, limit: float) -> None:
    """Metrics in float32 get the verdict that a GPU would give: no float32 is between a default threshold and the
    float32 nearest to it."""
    nearest = np.float32(limit)
    for value in (np.nextafter(nearest, np.float32(0)), nearest, np.nextafter(nearest, np.float32(99))):
        boxes = make_outcome(shift_m=np.zeros((3, 3)), max_tilt_deg=np.zeros(3)).boxes
        getattr(boxes, name).flat[0] = value
        verdict, _ = judge(Flag.NONE, boxes, 3, Thresholds())
        assert (verdict is Verdict.UNSTABLE) == bool(value > nearest)
