"""The table of all metrics: name, unit, type, meaning, time of sampling, and how boxes' values become a world's value.

Four places use this table:

- petmjx.results.schema defines the columns of the tables ``boxes`` and ``worlds``.
- petmjx.results.world_rows fills these columns.
- petmjx.analysis.run_comparison compares the metrics of two runs.
- docs/metrics.md has the tables that ``python -m petmjx.engines.metrics`` prints.

The engines compute the values, in NumPy, JAX and Warp. For a metric that is the largest of a quantity's values at all
samples, the table has the formula of this quantity (``BoxMetric.of_sample``), which C MuJoCo and the array programs
call. The formulas in kernels share no arithmetic with it.

docs/extending.md explains step by step how to add a metric.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.options.thresholds import FAILURES

DIMENSIONLESS: Final = "1"
"""Unit of counts, indices and factors."""

TEXT: Final = ""
"""Unit of columns that hold no quantity, but texts or booleans."""

RESTLESS_M_S: Final = 0.01
RISING_M_S2: Final = 0.5
"""Limits that determine which steps count for the largest force on a box's top. Samples and the steps of a drive always
count (docs/rules.md, section 7). Another step counts if two conditions hold. First, some box is faster than
``RESTLESS_M_S`` when the step begins. Second, some box accelerates upwards by more than ``RISING_M_S2``, or the rules
check in this step whether the pallet is quiet. C MuJoCo checks speeds only every few steps, and therefore counts some
more steps (petmjx/engines/mujoco/stepper.py).

Boxes press with more than their weight only while they accelerate upwards. So if no box accelerates upwards by more
than ``RISING_M_S2``, a force exceeds the weight on the top by at most a twentieth."""

GONE_TILT: Final = 1.25
GONE_DESCENT: Final = 1.5
"""Limits of a trial simulation, which only has to find out whether the pallet stands. The trial ends as soon as a box
is *gone*: tilted by more than ``GONE_TILT`` times the tilt threshold, or lower than planned by more than
``GONE_DESCENT`` times the shift threshold. Boxes start at rest, so a box that has descended so far does not rise again
by itself. At the steps at which the engine checks whether the pallet is quiet, it also checks whether a box is gone."""


CONFIRM_S: Final = 1.0
"""Shortest time from the first sign of failure to the end of a simulation that only has to confirm a fall
(``Job.confirms``), s. The simulation ends at a sample at which the culprit (the box that failed first) is still over a
threshold. There is one more condition: two further boxes have been placed since the sign, or the last box of the plan
was placed at least ``CONFIRM_S`` seconds ago. The simulation waits for these placements because a flat box that has
tipped may become level again when the next box is placed on it. The early end saves time: with stiff contacts, a
sliding pile takes fifteen iterations of the solver per step, and would slide for thousands of further steps."""


class SampleAt(StrEnum):
    """The time in a run at which a metric is measured."""

    PLAN = "plan"
    STEPS = "steps"
    SAMPLES = "samples"
    LOOKS = "looks"
    REST = "rest window"
    END = "end"


class Reduction(StrEnum):
    """How the values of a world's boxes become one value of the world. Boxes without a value are left out."""

    LARGEST = "largest magnitude"
    SMALLEST = "smallest"
    COUNT = "number of true values"


@dataclass(frozen=True)
class Column:
    """One column of a result table.

    Attributes:
        dtype: NumPy type of the column on disk.
        meaning: the meaning of the column in one line, which is written into the Parquet file.
        compared: whether a comparison of the runs a and b shows |b - a| for this column.
        relative: whether this comparison also shows |b - a| / max(a, 10 N).
    """

    name: str
    unit: str
    dtype: type[np.generic]
    meaning: str
    compared: bool
    relative: bool = False


@dataclass(frozen=True)
class WorldReduction:
    """The column of the table ``worlds`` that is computed from the boxes' values of a metric."""

    name: str
    reduction: Reduction
    meaning: str


class BoxSample(NamedTuple):
    """The boxes at a sample: the inputs of formulas (``BoxMetric.of_sample``), as arrays of NumPy or JAX. All values
    hold at the beginning of the step, when MuJoCo computes contacts and accelerations.

    Attributes:
        pos: (…, n, 3) centres, m.
        quat: (…, n, 4) orientations, as quaternions (w, x, y, z).
        velocity: (…, n, 6) velocities of the centres of mass, m/s, and angular velocities in the axes of the boxes,
            rad/s.
        acceleration: (…, n, 6) the same for accelerations, m/s² and rad/s².
        top_force: (…, n) forces on the tops of boxes, N.
        target: (…, n, 3) planned centres, m.
    """

    pos: Any
    quat: Any
    velocity: Any
    acceleration: Any
    top_force: Any
    target: Any


def _lengths(vectors: Any) -> Any:
    """(…,) lengths of vectors (…, 3), as an array of NumPy or JAX."""
    return vectors.__array_namespace__().sqrt((vectors**2).sum(-1))


@dataclass(frozen=True)
class BoxMetric:
    """A quantity that each box has. The table ``boxes`` has one column for the quantity, or one column per component.

    Attributes:
        attribute: field of ``BoxMetrics`` that holds the values, as an array (n,) or (n, components).
        columns: the name of each component's column → the meaning of this column.
        definition: the formula, for docs/metrics.md.
        dtype: type of the columns. Measured values are float32, which is exact to 1 µm at 8 m and is also the precision
            of the MJX engines. Times are float64, and yes-or-no values are bool.
        of_world: the column of ``worlds`` that is computed from this metric, if any.
        of_sample: if the metric is the largest of a quantity's values at all samples, the formula of this quantity, for
            arrays of NumPy or JAX. The result has the shape (…, n). Values below 0 count as 0, since the largest value
            is 0 at first.
        driven_only: whether only runs with profiles (motions of the carrier) have this metric.
        legs_only: whether only chains of several legs (parts of a journey) have this metric.
        compared, relative: see :class:`Column`. For metrics of type bool, a comparison shows only the number of boxes
            per world for which the metric is true.
    """

    attribute: str
    unit: str
    columns: Mapping[str, str]
    when: SampleAt
    definition: str
    dtype: type[np.generic] = np.float32
    of_world: WorldReduction | None = None
    of_sample: Callable[[BoxSample], Any] | None = None
    driven_only: bool = False
    legs_only: bool = False
    compared: bool = True
    relative: bool = False

    @property
    def is_peak(self) -> bool:
        """Whether the values are the largest of a time, so that a later part of a simulation can only increase them.
        The names of such metrics begin with ``max_``. ``sustained_top_force_n``, which is also the largest of a time,
        does not count: ``petmjx.runs.chain_legs.with_sustained_force`` computes it for several legs."""
        return self.attribute.startswith("max_")

    def nothing(self, *n: int) -> NDArray[np.float64] | NDArray[np.bool_]:
        """The values of (…, n) boxes for which the metric was not measured: NaN, or False for type bool."""
        shape = (*n, len(self.columns)) if len(self.columns) > 1 else n
        return np.zeros(shape, np.bool_) if self.dtype is np.bool_ else np.full(shape, np.nan)

    def of_table(self, boxes: Any) -> NDArray[Any]:
        """(n,) or (n, components) values of the n rows of a table ``boxes``."""
        values: NDArray[Any] = boxes[[*self.columns]].to_numpy(bool if self.dtype is np.bool_ else None)
        return values if len(self.columns) > 1 else values[:, 0]

    def world_columns(self) -> list[Column]:
        """The column of ``worlds`` that is computed from this metric, if any. Measured values in this column are
        float64, since there are far fewer worlds than boxes."""
        if self.of_world is None:
            return []
        counts = self.of_world.reduction is Reduction.COUNT
        unit, dtype = (DIMENSIONLESS, np.int32) if counts else (self.unit, np.float64)
        return [Column(self.of_world.name, unit, dtype, self.of_world.meaning, self.compared, self.relative)]


@dataclass(frozen=True)
class WorldMetric:
    """A quantity of a whole world: a column of the table ``worlds``, and a field of ``Outcome`` with the same name. If
    the type is int32, the value is the number of a box or a step, from 0. In an outcome, -1 stands for no value; in the
    table, -1 becomes null."""

    name: str
    unit: str
    meaning: str
    when: SampleAt
    dtype: type[np.generic] = np.float64
    compared: bool = True

    @property
    def numbers(self) -> bool:
        """Whether the metric is the number of a box or a step."""
        return self.dtype is np.int32

    def world_columns(self) -> list[Column]:
        """The metric's column of ``worlds``."""
        return [Column(self.name, self.unit, self.dtype, self.meaning, self.compared)]


def _largest(
    name: str,
    unit: str,
    when: SampleAt,
    definition: str,
    of_box: str,
    of_world: str,
    of_sample: Callable[[BoxSample], Any] | None = None,
    relative: bool = False,
) -> BoxMetric:
    """A metric of boxes with one column. A column of ``worlds`` with the same name holds the largest value of the
    world's boxes. ``of_box`` and ``of_world`` are the meanings of the two columns."""
    reduced = WorldReduction(name, Reduction.LARGEST, of_world)
    return BoxMetric(
        name, unit, {name: of_box}, when, definition, of_world=reduced, of_sample=of_sample, relative=relative
    )


def _number(name: str, meaning: str, when: SampleAt) -> WorldMetric:
    """A metric of a world that is the number of a box or a step."""
    return WorldMetric(name, DIMENSIONLESS, meaning, when, np.int32, compared=False)


METRICS: tuple[BoxMetric | WorldMetric, ...] = (
    WorldMetric(
        "margin", DIMENSIONLESS,
        "distance to the nearest threshold as a share of that threshold: 1 if nothing moved, 0 on the threshold, "
        "< 0 beyond it; null if the world is invalid",
        SampleAt.LOOKS,
    ),
    WorldMetric(
        "plan_edge_m", "m",
        "smallest distance of a box's load from the edge of the box's supports, with all boxes at their planned "
        "places; < 0 beyond the edge; null if the world is invalid",
        SampleAt.PLAN, compared=False,
    ),
    _number(
        "plan_edge_box", "number of the box (in packing order, from 0) whose load has the distance plan_edge_m",
        SampleAt.PLAN,
    ),
    WorldMetric(
        "rest_edge_m", "m",
        "smallest distance of a box's load from the edge of the box's supports, with all boxes where they came to "
        "rest; < 0 beyond the edge; null unless the world is stable and was not shaken",
        SampleAt.END, compared=False,
    ),
    _number(
        "rest_edge_box", "number of the box (in packing order, from 0) whose load has the distance rest_edge_m",
        SampleAt.END,
    ),
    WorldMetric(
        "build_edge_m", "m",
        "smallest distance of a box's load from the edge of the box's supports while the plan is built, computed after "
        "each placement; < 0 beyond the edge; null if all boxes are placed at once, or if the world has errors",
        SampleAt.PLAN, compared=False,
    ),
    _number(
        "build_edge_box", "number of the box (in packing order, from 0) whose load has the distance build_edge_m",
        SampleAt.PLAN,
    ),
    _number(
        "build_edge_step", "number of the box (in packing order, from 0) after whose placement the distance "
        "build_edge_m occurs",
        SampleAt.PLAN,
    ),
    WorldMetric(
        "first_sign_s", "s",
        "time at which the culprit (the first box that fails) crossed a threshold; null if no box crossed one",
        SampleAt.LOOKS,
    ),
    BoxMetric(
        "shift_m", "m",
        {"shift_x_m": "x of final centre - planned centre; 0 if |x| < shift_floor_m; null if the box was never placed",
         "shift_y_m": "y of final centre - planned centre; 0 if |y| < shift_floor_m; null if the box was never placed",
         "shift_z_m": "z of final centre - planned centre; 0 if |z| < shift_floor_m; null if the box was never placed"},
        SampleAt.END,
        "c − c_planned, where `c` is the box's centre; a component with a magnitude below `shift_floor_m` is set to 0; "
        "if boxes have a stiffness, the descent that is expected under the plan's loads does not count as shift",
        of_world=WorldReduction(
            "max_shift_m", Reduction.LARGEST, "largest |x|, |y| or |z| component of any box's shift"
        ),
    ),
    _largest(
        "max_tilt_deg", "deg", SampleAt.LOOKS,
        "max 2·asin √(x² + y²), where (w, x, y, z) is the box's unit quaternion",
        of_box="largest angle between the box's z axis and the world's z axis",
        of_world="largest angle between any box's z axis and the world's z axis",
    ),
    BoxMetric(
        "dropped", TEXT, {"dropped": "whether the box fell off the carrier, or floated when placed"}, SampleAt.LOOKS,
        "true once c_z < 0, or once the box's lowest point c_z − Σⱼ |R_zj|·hⱼ is below `drop_hull_z_m`; `c` is the "
        "box's centre, R its rotation matrix, h its half sizes. Also true for boxes that floated when they were placed",
        dtype=np.bool_, of_world=WorldReduction("n_dropped", Reduction.COUNT, "number of boxes that dropped"),
    ),
    BoxMetric(
        "drop_s", "s", {"drop_s": "time at which the box dropped; null if it did not drop"}, SampleAt.LOOKS,
        "time of the first check at which the box had dropped", dtype=np.float64,
        of_world=WorldReduction(
            "first_drop_s", Reduction.SMALLEST, "time at which the first box dropped; null if no box dropped"
        ),
    ),
    _largest(
        "max_lin_acc", "m/s^2", SampleAt.SAMPLES,
        "max ‖a‖, where `a` is the linear part of MuJoCo's `qacc` of the box's free joint",
        of_box="largest sampled linear acceleration", of_world="largest sampled linear acceleration of any box",
        of_sample=lambda sample: _lengths(sample.acceleration[..., :3]),
    ),
    _largest(
        "max_ang_acc", "rad/s^2", SampleAt.SAMPLES,
        "max ‖α‖, where `α` is the angular part of MuJoCo's `qacc` of the box's free joint",
        of_box="largest sampled angular acceleration", of_world="largest sampled angular acceleration of any box",
        of_sample=lambda sample: _lengths(sample.acceleration[..., 3:]),
    ),
    _largest(
        "max_top_force_n", "N", SampleAt.STEPS,
        "max F, where F is the force on the box's top (defined below); or `rest_top_force_n` if that is larger",
        of_box="largest force on the box's top in any step; never less than `rest_top_force_n`",
        of_world="largest force on the top of any box in any step; never less than `rest_top_force_n`", relative=True,
    ),
    _largest(
        "rest_top_force_n", "N", SampleAt.REST,
        "mean of F, the force on the box's top, over all steps of the last `rest_window_s` of a world that reached its "
        "end",
        of_box="force on the box's top at rest; null if the world never came to rest",
        of_world="largest force on the top of any box at rest; null if the world never came to rest", relative=True,
    ),
    BoxMetric(
        "pos", "m",
        {"pos_x_m": "final centre, x", "pos_y_m": "final centre, y",
         "pos_z_m": "final centre, z; 0 is the carrier's top"},
        SampleAt.END, "the box's centre c; `petmjx compare` compares two runs by the distance between the two centres "
                      "of a box", compared=False,
    ),
    BoxMetric(
        "quat", DIMENSIONLESS, {f"quat_{part}": f"final orientation, unit quaternion, {part}" for part in "wxyz"},
        SampleAt.END, "unit quaternion; `petmjx compare` compares two runs by the angle between the two orientations "
        "of a box", compared=False,
    ),
    BoxMetric(
        "plan_edge_m", "m",
        {"plan_edge_m": "distance of the box's load from the edge of the box's supports, with all boxes at their "
        "planned places; < 0 beyond the edge"},
        SampleAt.PLAN,
        "the smaller of two distances from the edge of the box's supports: the distance of the box's own weight, and "
        "the distance of its total load (own weight and all boxes on it). Exception: if only the own weight is beyond "
        "the edge, the value is the distance of the total load",
        compared=False,
    ),
    BoxMetric(
        "rest_edge_m", "m",
        {"rest_edge_m": "distance of the box's load from the edge of the box's supports, with all boxes where they "
         "came to rest; < 0 beyond the edge"},
        SampleAt.END,
        "computed like `plan_edge_m` (distance of the box's load from the edge of its supports), but with all boxes at "
        "their last places",
        compared=False,
    ),
    BoxMetric(
        "max_sway_m", "m",
        {"max_sway_m": "largest horizontal distance of the box from its place at the beginning of the profile"},
        SampleAt.LOOKS,
        "max √(Δx² + Δy²), where (Δx, Δy) is the horizontal motion of the box's centre since the profile's beginning",
        driven_only=True,
    ),
    BoxMetric(
        "sustained_top_force_n", "N",
        {"sustained_top_force_n": "largest value that the force at rest on the box's top has after the placement or "
         "after a leg; null if the world has no legs"},
        SampleAt.REST,
        "largest of the values that `rest_top_force_n` has at the end of the placement and at the end of each leg",
        driven_only=True, legs_only=True, relative=True,
    ),
    WorldMetric("sim_time_s", "s", "simulated time after the soft start", SampleAt.END),
    WorldMetric(
        "n_steps", DIMENSIONLESS, "simulated steps after the soft start", SampleAt.END, np.int64, compared=False
    ),
)  # fmt: skip
"""All metrics, in the order of their columns; but in the table ``boxes``, the metrics that only driven runs have
(``driven_only``) come after all other metrics."""


@dataclass(eq=False)
class BoxMetrics:
    """The metrics of the n boxes of one world, in packing order. ``METRICS`` defines the meaning and unit of each
    metric.

    ``shift_m`` and ``pos`` have the shape (n, 3), ``quat`` has (n, 4) with the order (w, x, y, z), all other fields
    have (n,). NaN means that there is no value.
    """

    shift_m: FloatArray
    max_tilt_deg: FloatArray
    max_lin_acc: FloatArray
    max_ang_acc: FloatArray
    max_top_force_n: FloatArray
    rest_top_force_n: FloatArray
    dropped: NDArray[np.bool_]
    drop_s: FloatArray
    max_sway_m: FloatArray
    pos: FloatArray
    quat: FloatArray
    plan_edge_m: FloatArray
    rest_edge_m: FloatArray
    sustained_top_force_n: FloatArray

    @classmethod
    def measured(cls, *n: int, **values: NDArray[Any]) -> BoxMetrics:
        """Metrics of n boxes, or of (…, n) boxes, from the values that an engine has measured. All other metrics are
        NaN, or False for type bool.

        Raises:
            TypeError: the name of a value is not the name of a metric.
        """
        missing: dict[str, Any] = {
            metric.attribute: metric.nothing(*n) for metric in box_metrics() if metric.attribute not in values
        }
        return cls(**missing, **values)

    def with_edges(self, plan_edge_m: FloatArray, rest_edge_m: FloatArray) -> Self:
        """A copy of these metrics with other distances of loads from edges, m. ``dataclasses.replace`` would take ten
        times as long."""
        other = object.__new__(type(self))
        vars(other).update(vars(self), plan_edge_m=plan_edge_m, rest_edge_m=rest_edge_m)
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy all metrics as one float64 array. Pickling each small array on its own takes two
        and a half times as long. Attributes that are not metrics are lost.
        """
        values = [getattr(self, metric.attribute).ravel() for metric in box_metrics()]
        return _of_numbers, (type(self), np.concatenate(values, dtype=np.float64), self.max_tilt_deg.shape)


def _of_numbers(kind: type[BoxMetrics], numbers: FloatArray, shape: tuple[int, ...]) -> BoxMetrics:
    """The metrics of (…, n) boxes from their pickled array. Python calls this function to unpickle ``BoxMetrics``."""
    values: dict[str, NDArray[Any]] = {}
    size, begin = math.prod(shape), 0
    for metric in box_metrics():
        components = len(metric.columns)
        end = begin + components * size
        mine = numbers[begin:end].reshape((*shape, components) if components > 1 else shape)
        values[metric.attribute] = mine != 0 if metric.dtype is np.bool_ else mine
        begin = end
    return kind(**values)


FORCE_INTERVAL: Final = tuple(
    Column(
        name, "N", np.float32,
        f"{word} force on the box's top at rest that balance and friction allow; null if it is not known",
        compared=False,
    )
    for name, word in (("rest_top_force_low_n", "smallest"), ("rest_top_force_high_n", "largest"))
)  # fmt: skip
"""Optional columns of the table ``boxes``, after the columns of the metrics (petmjx.analysis.force_intervals)."""


@functools.cache
def box_metrics(driven: bool = True, legs: bool = True) -> tuple[BoxMetric, ...]:
    """All metrics of boxes, in the order of their columns.

    Args:
        driven: include the metrics that only runs with profiles (motions of the carrier) have.
        legs: include the metrics that only chains of several legs (parts of a journey) have.
    """
    every = (metric for metric in METRICS if isinstance(metric, BoxMetric))
    metrics = [m for m in every if (driven or not m.driven_only) and (legs or not m.legs_only)]
    return tuple(sorted(metrics, key=lambda metric: (metric.driven_only, metric.legs_only)))


@functools.cache
def sampled_metrics() -> Mapping[str, Callable[[BoxSample], Any]]:
    """Name of each metric that is the largest of a quantity's values at all samples → formula of this quantity."""
    return {metric.attribute: metric.of_sample for metric in box_metrics() if metric.of_sample is not None}


@functools.cache
def judged_samples() -> tuple[str, ...]:
    """The names of the ``sampled_metrics`` that decide verdicts (``FAILURES``)."""
    return tuple(failure.metric for failure in FAILURES if failure.metric in sampled_metrics())


@functools.cache
def world_metrics() -> tuple[WorldMetric, ...]:
    """All metrics of whole worlds."""
    return tuple(metric for metric in METRICS if isinstance(metric, WorldMetric))


def box_columns(driven: bool = True, legs: bool = True) -> list[Column]:
    """The columns of metrics in the table ``boxes``."""
    return [
        Column(name, m.unit, m.dtype, meaning, m.compared and m.dtype is not np.bool_, m.relative)
        for m in box_metrics(driven, legs)
        for name, meaning in m.columns.items()
    ]


def world_columns() -> list[Column]:
    """The columns of metrics in the table ``worlds``."""
    return [column for metric in METRICS for column in metric.world_columns()]


def reduce_boxes(reduction: Reduction, values: FloatArray, starts: NDArray[np.int64]) -> FloatArray:
    """One value for each world from the values of its boxes. If no box has a value, the result is NaN, or 0 for counts.

    Args:
        values: (rows, components) values of the boxes of all worlds, world after world. NaN means no value.
        starts: (worlds,) number of the first row of each world. Every world has at least one box.
    """
    if not len(starts):
        return np.empty(0)
    if reduction is Reduction.COUNT:
        return np.add.reduceat((values > 0).any(axis=1).astype(np.float64), starts)
    largest = reduction is Reduction.LARGEST
    pick = np.fmax if largest else np.fmin
    of_boxes = pick.reduce(np.abs(values) if largest else values, axis=1)
    return np.asarray(pick.reduceat(of_boxes, starts))


def markdown() -> str:
    """The tables of docs/metrics.md, as text."""
    boxes = [("columns of `boxes`", "unit", "type", "taken at", "definition")]
    worlds = [("column of `worlds`", "unit", "type", "made from", "meaning")]
    for metric in METRICS:
        if isinstance(metric, BoxMetric):
            names = ", ".join(f"`{name}`" for name in metric.columns)
            note = " (runs with profiles)" if metric.driven_only else ""
            note = " (chains of several legs)" if metric.legs_only else note
            boxes.append((names + note, metric.unit, metric.dtype.__name__, str(metric.when), metric.definition))
            source = f"{metric.of_world.reduction} of {names}" if metric.of_world else ""
        else:
            source = f"the world, at: {metric.when}"
        worlds += [(f"`{c.name}`", c.unit, c.dtype.__name__, source, c.meaning) for c in metric.world_columns()]
    return "\n".join((*_table(boxes), "", *_table(worlds)))


def _table(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """The lines of a Markdown table. The first row is the header."""
    for number, row in enumerate(rows):
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
        if number == 0:
            yield "| " + " | ".join("---" for _ in row) + " |"


if __name__ == "__main__":
    print(markdown())
