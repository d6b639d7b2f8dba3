"""Metrics and verdict of one world in NumPy: the oracle's half, sharing no arithmetic with the batched JAX half.

Definitions are those of docs/metrics.md. Arrays have one row per box, in packing order.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.config import Thresholds
from petmjx.outcome import BoxMetrics, Flag, FloatArray, Reason, Verdict
from petmjx.scene import Scene

_COS_45 = float(np.sqrt(0.5))

FIRST_BOX_GEOM = 2
"""Geoms 0 and 1 are floor and carrier in every model of :mod:`petmjx.model`."""


def contact_normal_and_tangents(data: mujoco.MjData, pyramidal: bool) -> tuple[NDArray[np.intp], FloatArray]:
    """Forces of the contacts that have constraint rows.

    Pyramidal rows are forces along the four edges of the cone: the normal part is their sum, each tangent the
    difference of its pair of edges × friction. Elliptic rows are the force itself. All contacts have condim 3.

    Returns:
        (k,) indices of those contacts and (k, 3) forces in the contact frame (normal, tangents), N, as
        geom 1 exerts them on geom 2.
    """
    address = np.asarray(data.contact.efc_address)
    index = np.flatnonzero(address >= 0)
    first_row = address[index]
    if pyramidal:
        edges = data.efc_force[first_row[:, None] + np.arange(4)]
        friction = np.asarray(data.contact.friction)[index, :2]
        tangents = (edges[:, 0::2] - edges[:, 1::2]) * friction
        force = np.column_stack((edges.sum(axis=1), tangents))
    else:
        force = data.efc_force[first_row[:, None] + np.arange(3)]
    return index, force


def top_forces(data: mujoco.MjData, n_boxes: int, pyramidal: bool) -> FloatArray:
    """(n_boxes,) sum of what presses on each box from above, N.

    Counts the world-z part of every contact force whose normal lies within 45° of z, for the partner whose
    centre is lower; the floor is lower than everything, and floor and carrier are no boxes.
    """
    total = np.zeros(n_boxes)
    if data.ncon == 0:
        return total
    index, force = contact_normal_and_tangents(data, pyramidal)
    geoms = np.asarray(data.contact.geom)[index]
    frame = np.asarray(data.contact.frame)[index].reshape(-1, 3, 3)
    z_on_second = np.einsum("kr,kr->k", force, frame[:, :, 2])
    centre_z = data.geom_xpos[:, 2].copy()
    centre_z[0] = -np.inf
    first_is_lower = centre_z[geoms[:, 0]] < centre_z[geoms[:, 1]]
    lower = np.where(first_is_lower, geoms[:, 0], geoms[:, 1]) - FIRST_BOX_GEOM
    pressing = np.where(first_is_lower, z_on_second, -z_on_second)
    counted = (np.abs(frame[:, 0, 2]) >= _COS_45) & (lower >= 0) & (lower < n_boxes)
    np.add.at(total, lower[counted], pressing[counted])
    return total


def tilt_deg(quat: FloatArray) -> FloatArray:
    """(n,) angle between each box's z axis and the world's, degrees."""
    x, y = quat[:, 1], quat[:, 2]
    # The sine of the half angle is accurate near 0, where the cosine of the full angle is not.
    half_sine = np.sqrt(np.minimum((x * x + y * y) / np.einsum("ij,ij->i", quat, quat), 1.0))
    return np.asarray(np.degrees(2.0 * np.arcsin(half_sine)))


def lowest_z(pos: FloatArray, quat: FloatArray, half_size: FloatArray) -> FloatArray:
    """(n,) z of the lowest point of each turned box, m."""
    w, x, y, z = quat.T
    norm2 = w * w + x * x + y * y + z * z
    row = np.abs(np.stack((2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z))) / norm2
    return np.asarray(pos[:, 2] - row[0] * half_size[:, 0] - row[1] * half_size[:, 1] - row[2] * half_size[:, 2])


@dataclass(frozen=True, eq=False)
class Sample:
    """What is looked at after one step: the k placed boxes' poses, accelerations and top forces.

    All belong to the start of that step, where MuJoCo evaluates contacts and accelerations.
    """

    time_s: float
    pos: FloatArray
    quat: FloatArray
    lin_acc: FloatArray
    ang_acc: FloatArray
    top_force_n: FloatArray


class OracleMetrics:
    """Running maxima, first sign and resting force of one world."""

    def __init__(self, scene: Scene, thresholds: Thresholds) -> None:
        n = scene.n_boxes
        self._scene = scene
        self._thresholds = thresholds
        self.max_tilt_deg = np.zeros(n)
        self.max_lin_acc = np.zeros(n)
        self.max_ang_acc = np.zeros(n)
        self.max_top_force_n = np.zeros(n)
        self.drop_s = np.full(n, np.nan)
        self.max_sway_m = np.full(n, np.nan)
        self.culprit = -1
        self.first_sign_s = float("nan")
        self._rest_sum_n = np.zeros(n)
        self._rest_steps = 0
        self._sway_origin: FloatArray | None = None

    def fork(self) -> OracleMetrics:
        """An independent copy, for worlds that go on from a shared state."""
        twin = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(twin, name, value.copy())
        return twin

    @property
    def any_dropped(self) -> bool:
        return bool(np.any(np.isfinite(self.drop_s)))

    def add_sample(self, sample: Sample) -> bool:
        """Take in one sample.

        Returns:
            Whether some acceleration is above its threshold while no box has shown any sign of instability.
        """
        k = len(sample.pos)
        lin = np.linalg.norm(sample.lin_acc, axis=1)
        ang = np.linalg.norm(sample.ang_acc, axis=1)
        np.maximum(self.max_lin_acc[:k], lin, out=self.max_lin_acc[:k])
        np.maximum(self.max_ang_acc[:k], ang, out=self.max_ang_acc[:k])
        np.maximum(self.max_top_force_n[:k], sample.top_force_n, out=self.max_top_force_n[:k])
        if k:
            tilt = self.add_pose(sample.time_s, sample.pos, sample.quat)
            np.maximum(self.max_tilt_deg[:k], tilt, out=self.max_tilt_deg[:k])
        limits = self._thresholds
        too_fast = bool(np.any(lin > limits.lin_acc_m_s2) or np.any(ang > limits.ang_acc_rad_s2))
        return too_fast and self.culprit < 0

    def add_pose(self, time_s: float, pos: FloatArray, quat: FloatArray) -> FloatArray:
        """Look for drops and the first sign in one pose; the final state counts too. Returns the (k,) tilts."""
        k = len(pos)
        limits = self._thresholds
        tilt = tilt_deg(quat)
        hull = lowest_z(pos, quat, self._scene.half_size[:k])
        dropped = (pos[:, 2] < 0.0) | (hull < limits.drop_hull_z_m)
        newly = dropped & np.isnan(self.drop_s[:k])
        self.drop_s[:k][newly] = time_s
        if self._sway_origin is not None:
            sway = np.hypot(*(pos - self._sway_origin)[:, :2].T)
            self.max_sway_m[:k] = np.fmax(self.max_sway_m[:k], sway)
        if self.culprit < 0:
            excess, crossed = self._excess(pos, tilt, dropped)
            if crossed.any():
                self.culprit = int(np.argmax(np.where(crossed, excess, -np.inf)))
                self.first_sign_s = time_s
        return tilt

    def add_rest(self, top_force_n: FloatArray) -> None:
        """One step of the rest window."""
        self._rest_sum_n[: len(top_force_n)] += top_force_n
        self._rest_steps += 1

    def begin_drive(self, pos: FloatArray, quat: FloatArray) -> None:
        """A profile starts, with the k boxes in these poses: sway is measured from here.

        Where no box is over a threshold now, what passed during placement (a hard landing) is no sign any more:
        the first sign is then the one that the profile brings.
        """
        k = len(pos)
        self._sway_origin = pos.copy()
        self.max_sway_m[:k] = 0.0
        _, crossed = self._excess(pos, tilt_deg(quat), np.isfinite(self.drop_s[:k]))
        if not crossed.any():
            self.culprit = -1
            self.first_sign_s = float("nan")

    def finish(self, pos: FloatArray, quat: FloatArray, came_to_end: bool) -> BoxMetrics:
        """The per-box results, from the final (n, 3) centres and (n, 4) orientations."""
        shift = pos - self._scene.target
        shift[np.abs(shift) < self._thresholds.shift_floor_m] = 0.0
        n = self._scene.n_boxes
        rest = self._rest_sum_n / self._rest_steps if came_to_end and self._rest_steps else np.full(n, np.nan)
        return BoxMetrics(
            shift_m=shift,
            max_tilt_deg=self.max_tilt_deg,
            max_lin_acc=self.max_lin_acc,
            max_ang_acc=self.max_ang_acc,
            max_top_force_n=self.max_top_force_n,
            rest_top_force_n=rest,
            dropped=np.isfinite(self.drop_s),
            drop_s=self.drop_s,
            max_sway_m=self.max_sway_m,
            pos=pos,
            quat=quat,
        )

    def largest_excess(self, pos: FloatArray, quat: FloatArray) -> int:
        """The box furthest over its thresholds in this pose."""
        dropped = np.isfinite(self.drop_s[: len(pos)])
        excess, _ = self._excess(pos, tilt_deg(quat), dropped)
        return int(np.argmax(excess))

    def _excess(
        self, pos: FloatArray, tilt: FloatArray, dropped: NDArray[np.bool_]
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """(k,) how far each box is from its thresholds (1 = at them), and (k,) whether one is crossed."""
        limits = self._thresholds
        shift = np.abs(pos - self._scene.target[: len(pos)]).max(axis=1)
        excess = np.maximum(np.maximum(shift / limits.shift_m, tilt / limits.tilt_deg), dropped)
        crossed = (shift > limits.shift_m) | (tilt > limits.tilt_deg) | dropped
        return excess, crossed


def judge(flags: Flag, boxes: BoxMetrics, n_placed: int, thresholds: Thresholds) -> tuple[Verdict, Reason]:
    """The verdict over the placed boxes, in the order of spec section 5."""
    if flags & Flag.NONFINITE:
        return Verdict.INVALID, Reason.NONFINITE
    if flags & (Flag.CONTACT_OVERFLOW | Flag.CONSTRAINT_OVERFLOW | Flag.OTHER_OVERFLOW):
        return Verdict.INVALID, Reason.OVERFLOW
    if flags & Flag.EXPLOSION:
        return Verdict.INVALID, Reason.EXPLOSION
    if boxes.dropped[:n_placed].any():
        return Verdict.UNSTABLE, Reason.DROP
    if (boxes.max_tilt_deg[:n_placed] > thresholds.tilt_deg).any():
        return Verdict.UNSTABLE, Reason.TILT
    if (np.abs(boxes.shift_m[:n_placed]) > thresholds.shift_m).any():
        return Verdict.UNSTABLE, Reason.SHIFT
    return Verdict.STABLE, Reason.NONE
