"""The metrics of one world while it is simulated on C MuJoCo, in NumPy. The JAX code computes the same metrics without
sharing arithmetic with this module, except the formulas of ``sampled_metrics``.

docs/metrics.md defines the metrics. Arrays have one row per box, in packing order.
"""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import STANDARD_GRAVITY, FloatArray
from petmjx.engines.metrics import GONE_DESCENT, GONE_TILT, BoxMetrics, BoxSample, sampled_metrics
from petmjx.engines.mujoco.box_motion import corner_acceleration, farthest, has_dropped, shift, tilt_deg
from petmjx.engines.mujoco.top_forces import TopForceInputs, largest_top_forces
from petmjx.options.thresholds import Thresholds
from petmjx.world.compliance import sinks_m
from petmjx.world.job import Drive, Job
from petmjx.world.scene import Scene

_STEPS_TOGETHER = 64
"""Number of steps whose forces are computed together. Larger numbers are not faster."""


def excess(shift_m: FloatArray, tilt: FloatArray, dropped: NDArray[np.bool_], thresholds: Thresholds) -> FloatArray:
    """(n,) excess of each box: shift divided by its threshold, or tilt divided by its threshold, whichever is larger.
    The excess of a dropped box is at least 1.

    A box has failed if its excess is above 1 or if it has dropped. The twins of this function are ``excess`` in
    petmjx/engines/mjx/rules.py and ``excess_of`` in petmjx/engines/warp/kernels/box_motion.py.
    """
    worst = np.maximum(farthest(shift_m) / thresholds.shift_m, tilt / thresholds.tilt_deg)
    return np.asarray(np.maximum(worst, dropped))


class OracleMetrics:
    """What is measured in one world: the largest values of the metrics so far, the first sign of failure, and the
    forces at rest."""

    def __init__(self, scene: Scene, thresholds: Thresholds, gravity_m_s2: float = STANDARD_GRAVITY) -> None:
        n = scene.n_boxes
        self._scene, self._gravity_m_s2 = scene, gravity_m_s2
        self._sinks_m = sinks_m(scene, gravity_m_s2)
        self._thresholds = thresholds
        self.max_tilt_deg = np.zeros(n)
        self._sampled = np.zeros((n, len(sampled_metrics())))
        self._max_top_force_n = np.zeros(n)
        self._pressed: list[TopForceInputs] = []
        self.drop_s = np.full(n, np.nan)
        self.max_sway_m = np.full(n, np.nan)
        self.culprit = -1
        self.first_sign_s = float("nan")
        self._rest_sum_n = np.zeros(n)
        self._rest_steps = 0
        self._sway_origin: FloatArray | None = None

    def fork(self) -> OracleMetrics:
        """An independent copy, for a world that starts from this state."""
        self._work_off()
        twin = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(twin, name, value.copy())
        twin._pressed = []
        return twin

    def extend(self, scene: Scene) -> None:
        """Add the additional boxes of a scene. The additional boxes have no values yet."""
        self._work_off()
        larger = OracleMetrics(scene, self._thresholds, self._gravity_m_s2)
        for name, value in vars(larger).items():
            if isinstance(value, np.ndarray) and name != "_sinks_m":
                value[: self._scene.n_boxes] = getattr(self, name)
                setattr(self, name, value)
        self._scene, self._sinks_m = scene, larger._sinks_m

    @property
    def max_top_force_n(self) -> FloatArray:
        """(n,) largest force on top of each box so far, N. The result includes steps whose forces have not been
        computed yet.
        """
        self._work_off()
        return self._max_top_force_n

    def _work_off(self) -> None:
        """Compute the forces on tops in all steps collected so far, and include them in the largest forces."""
        if self._pressed:
            steps, self._pressed = self._pressed, []
            self.add_forces(largest_top_forces(steps, len(self._max_top_force_n)))

    def add_step(self, pressed: TopForceInputs) -> None:
        """Add the forces on tops in one step. The inputs are collected, so that many steps are computed together."""
        if self._pressed and (len(self._pressed) >= _STEPS_TOGETHER or self._pressed[0].bodies is not pressed.bodies):
            self._work_off()
        self._pressed.append(pressed)

    def add_forces(self, top_force_n: FloatArray) -> None:
        """Include these forces on the tops of the first k boxes in the largest forces, N. NaN is ignored."""
        largest = self._max_top_force_n[: len(top_force_n)]
        np.fmax(largest, np.where(np.isfinite(top_force_n), top_force_n, 0.0), out=largest)

    @property
    def sampled(self) -> dict[str, FloatArray]:
        """Name of each of the ``sampled_metrics`` → (n,) values so far."""
        return dict(zip(sampled_metrics(), self._sampled.T, strict=True))

    @property
    def any_dropped(self) -> bool:
        return bool(np.any(np.isfinite(self.drop_s)))

    @property
    def has_failed(self) -> bool:
        """Whether a box has failed for good: it has dropped, or was tilted too far at a sample or at a check during a
        drive. A shift is judged only at rest, since it may decrease until then."""
        tilted = self.max_tilt_deg > self._thresholds.tilt_deg
        return self.culprit >= 0 and (self.any_dropped or bool(tilted.any()))

    def tells_all(self, job: Job, pos: FloatArray, quat: FloatArray, culprit: int) -> bool:
        """Whether the pallet falls for certain, so that the simulation of its world can end. The pallet falls for
        certain if a box has dropped. If ``Job.ends_when_lost``, the pallet also falls for certain if one of the k
        placed boxes is tilted too far in these poses. In a drive (motion of the carrier), the pallet also falls for
        certain if the culprit is tilted too far and has moved too far.

        Args:
            culprit: number of the box that crossed a threshold first, at an earlier check. The number is -1 if no box
                has crossed a threshold, or if the culprit does not end a drive.
        """
        if self.any_dropped:
            return True
        lost = tilt_deg(quat) > self._thresholds.tilt_deg
        if job.ends_when_lost and lost.any():
            return True
        if self._sway_origin is None or job.drive is None or culprit < 0:
            return False
        sway = self._sway(pos, self._sway_origin)
        return bool(lost[culprit] and sway[culprit] >= job.drive.allowed_sway_m)

    def any_gone(self, pos: FloatArray, quat: FloatArray) -> bool:
        """Whether one of the k placed boxes is *gone*: it is tilted so much, or has descended so far, that the pallet
        will certainly not stand (``petmjx.engines.metrics.GONE_TILT``)."""
        k = len(pos)
        descent = self._scene.target[:k, 2] - pos[:, 2] - (0.0 if self._sinks_m is None else self._sinks_m[:k])
        limits = self._thresholds
        return bool(
            (tilt_deg(quat) > GONE_TILT * limits.tilt_deg).any() or (descent > GONE_DESCENT * limits.shift_m).any()
        )

    def add_sample(self, time_s: float, sample: BoxSample) -> bool:
        """Add one sample (measurement) of the k placed boxes.

        Returns:
            Whether an acceleration is above its threshold although no box has crossed a threshold of failure yet.
        """
        k, acc = len(sample.pos), sample.acceleration
        for column, formula in enumerate(sampled_metrics().values()):
            np.maximum(self._sampled[:k, column], formula(sample), out=self._sampled[:k, column])
        lin = np.linalg.norm(acc[:, :3], axis=1)
        ang = np.linalg.norm(acc[:, 3:], axis=1)
        self.add_forces(sample.top_force)
        if k:
            self.add_look(time_s, sample.pos, sample.quat)
        limits = self._thresholds
        at_corners = corner_acceleration(acc[:, 3:], self._scene.half_size[:k])
        turns = (ang > limits.ang_acc_rad_s2) & (at_corners > self._gravity_m_s2)
        return bool(np.any((lin > limits.lin_acc_m_s2) | turns)) and self.culprit < 0

    def add_look(self, time_s: float, pos: FloatArray, quat: FloatArray) -> None:
        """Add the poses at a sample, or at a check during a drive: record tilts, and do the same as ``add_pose``."""
        tilt, k = self.add_pose(time_s, pos, quat), len(pos)
        np.maximum(self.max_tilt_deg[:k], tilt, out=self.max_tilt_deg[:k])

    def add_pose(self, time_s: float, pos: FloatArray, quat: FloatArray) -> FloatArray:
        """Check these poses for drops, sway and the first sign of failure. Returns the (k,) tilts, degrees."""
        k = len(pos)
        tilt = tilt_deg(quat)
        dropped = has_dropped(pos, quat, self._scene.half_size[:k], self._thresholds)
        newly = dropped & np.isnan(self.drop_s[:k])
        self.drop_s[:k][newly] = time_s
        if self._sway_origin is not None:
            self.max_sway_m[:k] = np.fmax(self.max_sway_m[:k], self._sway(pos, self._sway_origin))
        if self.culprit < 0:
            over, crossed = self._excess(pos, tilt, dropped)
            if crossed.any():
                self.culprit = int(np.argmax(np.where(crossed, over, -np.inf)))
                self.first_sign_s = time_s
        return tilt

    @staticmethod
    def _sway(pos: FloatArray, origin: FloatArray) -> FloatArray:
        """(k,) horizontal distance of boxes from their places at the start of the drive, m."""
        return np.asarray(np.hypot(*(pos - origin)[:, :2].T))

    def add_rest(self, top_force_n: FloatArray) -> None:
        """Add the forces in one step of the rest window, N. The force at rest is the mean over all steps of the
        window.
        """
        self._rest_sum_n[: len(top_force_n)] += top_force_n
        self._rest_steps += 1

    def restart_rest(self) -> None:
        """Start a new rest window, since the world has continued after the end of its previous rest window."""
        self._rest_sum_n[:] = 0.0
        self._rest_steps = 0

    def are_over(self, pos: FloatArray, quat: FloatArray) -> NDArray[np.bool_]:
        """(k,) whether each of the k placed boxes has dropped, or is beyond a threshold in these poses."""
        _, crossed = self._excess(pos, tilt_deg(quat), np.isfinite(self.drop_s[: len(pos)]))
        return crossed

    def is_lost(self, pos: FloatArray, quat: FloatArray, drive: Drive | None) -> bool:
        """Whether a box has dropped or is tilted too far in these poses. In a drive, a tilted box counts only if it has
        also moved sideways by at least ``drive.allowed_sway_m``."""
        lost = tilt_deg(quat) > self._thresholds.tilt_deg
        if drive is not None and self._sway_origin is not None:
            lost &= self._sway(pos, self._sway_origin) >= drive.allowed_sway_m
        return self.any_dropped or bool(lost.any())

    def begin_drive(self, pos: FloatArray, quat: FloatArray) -> None:
        """Start a drive (motion of the carrier) with the k boxes in these poses. Sway is measured from the poses at the
        start of the drive. Whether boxes are at rest is judged at the end of the drive.

        If no box is beyond a threshold now, signs of failure during the placement (such as a hard landing) are
        forgotten. From then on, the first sign of failure is the first sign during the drive.
        """
        k = len(pos)
        self._sway_origin = pos.copy()
        self.max_sway_m[:k] = 0.0
        self.restart_rest()
        if not self.are_over(pos, quat).any():
            self.culprit = -1
            self.first_sign_s = float("nan")

    def finish(self, pos: FloatArray, quat: FloatArray, n_placed: int, came_to_end: bool) -> BoxMetrics:
        """The metrics of all boxes. ``pos`` and ``quat``: final (n, 3) centres (m) and (n, 4) quaternions.

        The largest tilt includes the tilt in the final pose of a placed box. The largest force on top includes the mean
        force at rest.
        """
        n = self._scene.n_boxes
        placed = slice(n_placed)
        with np.errstate(invalid="ignore"):  # poses may contain NaN
            np.fmax(self.max_tilt_deg[placed], tilt_deg(quat[placed]), out=self.max_tilt_deg[placed])
        rest_force_n = self._rest_sum_n / self._rest_steps if came_to_end and self._rest_steps else np.full(n, np.nan)
        return BoxMetrics.measured(
            n,
            shift_m=shift(pos, self._scene.target, self._thresholds.shift_floor_m, self._sinks_m),
            max_tilt_deg=self.max_tilt_deg,
            **self.sampled,
            max_top_force_n=np.fmax(self.max_top_force_n, rest_force_n),
            rest_top_force_n=rest_force_n,
            dropped=np.isfinite(self.drop_s),
            drop_s=self.drop_s,
            max_sway_m=self.max_sway_m,
            pos=pos,
            quat=quat,
        )

    def worst_box(self, pos: FloatArray, quat: FloatArray) -> int:
        """The number of the box with the largest excess in these poses."""
        dropped = np.isfinite(self.drop_s[: len(pos)])
        over, _ = self._excess(pos, tilt_deg(quat), dropped)
        return int(np.argmax(over))

    def _excess(
        self, pos: FloatArray, tilt: FloatArray, dropped: NDArray[np.bool_]
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(k,) excess of each box, and (k,) whether each box is beyond a threshold or has dropped."""
        limits = self._thresholds
        k = len(pos)
        sinks = None if self._sinks_m is None else self._sinks_m[:k]
        shift_m = shift(pos, self._scene.target[:k], limits.shift_floor_m, sinks)
        over = excess(shift_m, tilt, dropped, limits)
        return over, (over > 1) | dropped
