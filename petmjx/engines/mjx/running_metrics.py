"""Running metrics of boxes, for all worlds together: statistics of samples, and the final metrics of a run.

Twin of petmjx/engines/mujoco/running_metrics.py, and of petmjx/engines/warp/kernels/box_motion.py, which uses the same
fields. Definitions: docs/metrics.md. petmjx/engines/mjx/rules.py decides which boxes and steps the metrics include.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from petmjx.common.units import FloatArray
from petmjx.engines.metrics import BoxSample, sampled_metrics
from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.world_constants import Worlds
from petmjx.options.thresholds import Thresholds


class Sample(NamedTuple):
    """Values of boxes at a sample or a check.

    Attributes:
        boxes: the inputs of metrics, at the beginning of the step; but if the step is no sample, poses after the step.
        tilt: tilts, degrees.
        sampled: whether the box has a sample in this step.
        presses: whether the largest force on the box's top includes this step.
        tilts: whether the largest tilt of the box includes this step, at a sample or at a check during a drive.
        looked: whether the box is checked. Boxes are also checked at the end of their world.
        rested: whether the mean force on the box's top at rest includes this step.
        rests: whether the step is in the rest window of the world.
    """

    step: Int[Array, " world"]
    boxes: BoxSample
    tilt: Float[Array, "world box"]
    dropped: Bool[Array, "world box"]
    sampled: Bool[Array, "world box"]
    presses: Bool[Array, "world box"]
    tilts: Bool[Array, "world box"]
    looked: Bool[Array, "world box"]
    rested: Bool[Array, "world box"]
    rests: Bool[Array, " world"]


class Metrics(NamedTuple):
    """Running statistics of boxes over all samples since each box was placed, and the first sign of failure. Tilt and
    sway also include checks during a drive. The fields of ``sampled_metrics`` have the names of these metrics."""

    max_tilt: Float[Array, "world box"]
    max_lin_acc: Float[Array, "world box"]
    max_ang_acc: Float[Array, "world box"]
    max_top_force: Float[Array, "world box"]
    rest_force_sum: Float[Array, "world box"]
    rest_samples: Int[Array, " world"]
    drop_step: Int[Array, "world box"]
    max_sway: Float[Array, "world box"]
    sway_anchor: Float[Array, "world box 2"]
    culprit: Int[Array, " world"]
    sign_step: Int[Array, " world"]
    sign_placed: Int[Array, " world"]

    def with_sample(self, sample: Sample, worlds: Worlds, *, driven: bool) -> Metrics:
        """The metrics after one more sample. ``driven``: whether worlds are shaken. The first sign of failure is not
        changed."""

        def largest(old: Array, new: Array, where: Array) -> Array:
            return jnp.where(where, jnp.maximum(old, new), old)

        max_sway, boxes = self.max_sway, sample.boxes
        if driven:
            max_sway = largest(max_sway, self.sway(boxes.pos), sample.looked)
        sampled = {
            name: largest(getattr(self, name), formula(boxes), sample.sampled)
            for name, formula in sampled_metrics().items()
        }
        return self._replace(
            max_tilt=largest(self.max_tilt, sample.tilt, sample.tilts),
            max_top_force=largest(self.max_top_force, boxes.top_force, sample.presses),
            rest_force_sum=self.rest_force_sum + jnp.where(sample.rested, boxes.top_force, 0.0),
            rest_samples=self.rest_samples + sample.rests,
            drop_step=jnp.where(sample.dropped & (self.drop_step < 0), sample.step[:, None], self.drop_step),
            max_sway=max_sway,
            **sampled,
        )

    def sway(self, pos: Float[Array, "world box 3"]) -> Float[Array, "world box"]:
        """Horizontal distance of boxes from their positions at the start of their drive, m."""
        return jnp.sqrt(((pos[..., :2] - self.sway_anchor) ** 2).sum(-1))

    def has_failed(self, thresholds: Thresholds) -> Bool[Array, " world"]:
        """Whether a box of each world has failed for good: the box has dropped, or was tilted too far at a check. A
        large shift is not a final failure: the shift is judged at rest, and may decrease until then."""
        failed = (self.drop_step >= 0) | (self.max_tilt > thresholds.tilt_deg)
        return (self.culprit >= 0) & failed.any(-1)

    def without_rest(self, where: Bool[Array, " world"]) -> Metrics:
        """The metrics at the start of a new rest window."""
        return self._replace(
            rest_force_sum=jnp.where(where[:, None], 0.0, self.rest_force_sum),
            rest_samples=jnp.where(where, 0, self.rest_samples),
        )

    def without_sign(self, where: Bool[Array, " world"]) -> Metrics:
        """The metrics, without the first sign of failure of the worlds in ``where``."""
        return self._replace(
            culprit=jnp.where(where, -1, self.culprit),
            sign_step=jnp.where(where, -1, self.sign_step),
        )


def no_metrics(n_worlds: int, n_boxes: int) -> Metrics:
    """The metrics of worlds before their first sample."""
    zeros, ints = jnp.zeros((n_worlds, n_boxes)), jnp.zeros(n_worlds, jnp.int32)
    return Metrics(
        max_tilt=zeros,
        **dict.fromkeys(sampled_metrics(), zeros),
        max_top_force=zeros,
        rest_force_sum=zeros,
        rest_samples=ints,
        drop_step=jnp.full((n_worlds, n_boxes), -1, jnp.int32),
        max_sway=zeros,
        sway_anchor=jnp.zeros((n_worlds, n_boxes, 2)),
        culprit=jnp.full(n_worlds, -1, jnp.int32),
        sign_step=jnp.full(n_worlds, -1, jnp.int32),
        sign_placed=ints,
    )


class RunMetrics(NamedTuple):
    """Metrics that are computed once a world has ended."""

    shift: Float[Array, "world box 3"]
    max_tilt: Float[Array, "world box"]
    max_top_force: Float[Array, "world box"]
    rest_force: Float[Array, "world box"]


def run_metrics(
    metrics: Metrics,
    qpos: Float[Array, "world box 7"],
    worlds: Worlds,
    placed: Bool[Array, "world box"],
    ended: Bool[Array, " world"],
    thresholds: Thresholds,
) -> RunMetrics:
    """The metrics that are computed once a world has ended, for placed boxes: from their last poses and from
    ``metrics``. Worlds that were stopped before their end have no forces at rest."""
    m = metrics
    shift = motion.shift(motion.middles(qpos, worlds.middle), worlds.target, thresholds.shift_floor_m, worlds.sinks)
    rested = (m.rest_samples > 0) & ended
    mean = m.rest_force_sum / jnp.maximum(m.rest_samples, 1)[:, None]
    tilt = jnp.where(placed, motion.tilt_deg(qpos[..., 3:]), 0.0)
    return RunMetrics(
        shift=jnp.where(placed[..., None], shift, 0.0),
        max_tilt=jnp.fmax(m.max_tilt, tilt),
        max_top_force=jnp.where(rested[:, None], jnp.maximum(m.max_top_force, mean), m.max_top_force),
        rest_force=jnp.where(rested[:, None], mean, jnp.nan),
    )


def of_boxes(metrics: Metrics, measured: RunMetrics, row: int, n: int, driven: bool) -> dict[str, FloatArray]:
    """Fields of ``petmjx.engines.metrics.BoxMetrics`` for the n boxes of the world in this row, from records on the
    host. Poses and times are not included, since they require the scene and the clock."""

    def doubles(values: Any) -> FloatArray:
        return np.asarray(values[row, :n], np.float64)

    return {
        "shift_m": doubles(measured.shift),
        "max_tilt_deg": doubles(measured.max_tilt),
        **{name: doubles(getattr(metrics, name)) for name in sampled_metrics()},
        "max_top_force_n": doubles(measured.max_top_force),
        "rest_top_force_n": doubles(measured.rest_force),
        "max_sway_m": doubles(metrics.max_sway) if driven else np.full(n, np.nan),
    }
