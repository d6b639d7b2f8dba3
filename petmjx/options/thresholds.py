"""The reasons of verdicts (``Reason``), the thresholds of verdicts (``Thresholds``), and the ways in which a box fails
(``FAILURES``).

Defaults, units, checks, descriptions and words are defined only here. docs/extending.md explains step by step how to
add a reason.
"""

from __future__ import annotations

from enum import StrEnum
from functools import reduce
from typing import Annotated, Any, Final, NamedTuple, Self

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, CliFlag, within


class Reason(StrEnum):
    """Why a world is not stable. The reason of a stable world is empty.

    Attributes:
        words: what happened. For an invalid world: a sentence, without full stop. For an unstable world: what a box
            did, with the name of the failure's threshold in braces instead of the threshold.
    """

    words: str

    def __new__(cls, value: str, words: str = "") -> Self:
        reason = str.__new__(cls, value)
        reason._value_, reason.words = value, words
        return reason

    NONE = ""
    NONFINITE = "nonfinite", "the simulation gave numbers that are not finite"
    OVERFLOW = "overflow", "there were more contacts than the engine had room for"
    EXPLOSION = "explosion", "accelerations were impossibly large before any box had moved"
    OUT_OF_MEMORY = "out-of-memory", "the device had too little memory"
    SINKING = "sinking", "boxes sank into the boxes or the carrier below them"
    FAILED = "failed", "the simulation failed"
    TIMEOUT = "timeout", "the simulation took longer than its time limit"
    ITERATION_LIMIT = "iteration-limit", "the simulation took more solver iterations than its limit"
    DROP = "drop", "dropped"
    TILT = "tilt", "tilted by more than {tilt_deg}"
    SHIFT = "shift", "shifted by more than {shift_m}"


class Thresholds(CheckedRecord):
    """The thresholds above which a plan counts as unstable, or a simulation as invalid (PET-Physics paper, section
    IV-C)."""

    shift_m: Annotated[float, within(0, 100), CliFlag("--shift-limit-m", "M")] = Field(
        0.02,
        gt=0,
        description="a plan is unstable if the final place of a box differs from its planned place by more than this "
        "along x, y or z, m",
    )
    shift_floor_m: Annotated[float, within(0, 100)] = Field(
        0.001, ge=0, description="components of a shift that are smaller than this count as 0, m"
    )
    tilt_deg: Annotated[float, within(0, 360), CliFlag("--tilt-limit-deg", "DEG")] = Field(
        20.0,
        gt=0,
        description="a plan is unstable if the angle between a box's z axis and the world's z axis exceeds this, "
        "degrees",
    )
    drop_hull_z_m: Annotated[float, within(-100, 100)] = Field(
        -0.1, description="a box has dropped if a part of it is lower than this z, m; the carrier's top is at z = 0"
    )
    lin_acc_m_s2: Annotated[float, within(0, 1e9)] = Field(
        110.0,
        gt=0,
        description="the simulation may have exploded if the linear acceleration of a box exceeds this before any box "
        "has failed, m/s²",
    )
    ang_acc_rad_s2: Annotated[float, within(0, 1e9)] = Field(
        110.0,
        gt=0,
        description="the simulation may have exploded if the angular acceleration of a box exceeds this before any box "
        "has failed, rad/s²",
    )


BINARY_EXCESS: Final = 2.0
"""Excess of a box that has failed in a way without a threshold: it has dropped. (The excess says how far a box is
beyond its thresholds.) With this value, the margin of a world with a dropped box is at most -1. A dropped box may end
near its planned place, but its world always counts as beyond the threshold."""


class Failure(NamedTuple):
    """A way in which a box fails, which makes its world unstable.

    The methods take ``boxes``, an object that has the metric for (…, n) boxes, as an array of NumPy or JAX.

    Attributes:
        reason: the reason of the world.
        metric: the field of ``petmjx.engines.metrics.BoxMetrics`` that shows the failure.
        threshold: the field of ``Thresholds``. The box has failed if the metric, or the magnitude of a component of the
            metric, is larger than the threshold. "": the metric itself says whether the box has failed.
        mode: the failure in the column ``mode`` of searches.
        is_vector: whether the metric has components, along the last axis of its array.
    """

    reason: Reason
    metric: str
    threshold: str
    mode: str
    is_vector: bool = False

    def has_happened(self, boxes: Any, thresholds: Thresholds) -> Any:
        """(…, n) whether each box has failed in this way."""
        values = getattr(boxes, self.metric)
        if not self.threshold:
            return values
        beyond = abs(values) > getattr(thresholds, self.threshold)
        return beyond.any(axis=-1) if self.is_vector else beyond

    def excess(self, boxes: Any, thresholds: Thresholds) -> Any:
        """(…, n) the metric of each box, as a share of the threshold."""
        values = getattr(boxes, self.metric)
        if not self.threshold:
            return BINARY_EXCESS * values
        size = abs(values)
        if self.is_vector:  # for many boxes, ``max(axis=-1)`` of NumPy would take twenty times as long
            size = reduce(size.__array_namespace__().maximum, (size[..., axis] for axis in range(size.shape[-1])))
        return size / getattr(thresholds, self.threshold)


FAILURES: Final = (
    Failure(Reason.DROP, "dropped", "", "drop"),
    Failure(Reason.TILT, "max_tilt_deg", "tilt_deg", "tilt"),
    Failure(Reason.SHIFT, "shift_m", "shift_m", "slide", is_vector=True),
)
"""The ways in which a box fails, in the order in which they are checked."""

MOTION_REASONS: Final = frozenset({Reason.DROP, Reason.TILT, Reason.SHIFT})
"""The reasons of worlds whose pallet has fallen. Engines see these failures while they simulate (``excess`` of each
engine), and name the culprit and the time of the first sign. For the other ``FAILURES``,
petmjx.engines.outcome_checks names the box that is farthest beyond the threshold, and there is no time."""


def largest_excess(boxes: Any, thresholds: Thresholds) -> Any:
    """(…, n) the largest excess of each box over its thresholds, of all ``FAILURES``; above 1 if the box has failed.
    Metrics that are NaN, because they were not measured, do not count.

    Args:
        boxes: an object with the metrics of ``FAILURES`` for (…, n) boxes, as arrays of NumPy or JAX.
    """
    excesses = [failure.excess(boxes, thresholds) for failure in FAILURES]
    return reduce(excesses[0].__array_namespace__().fmax, excesses)
