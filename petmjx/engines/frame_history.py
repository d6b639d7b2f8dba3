"""Makes the history of a world (its boxes' poses and forces over time) from the frames that an engine recorded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petmjx.common.units import FloatArray
from petmjx.world.history import History
from petmjx.world.job import Job


def history_of(
    job: Job,
    step: NDArray[np.integer],
    placed: NDArray[np.integer],
    pose: ArrayLike,
    top_force_n: ArrayLike,
    carrier_pose: ArrayLike,
    time_s: Callable[[int], float],
    driven_from: int | None,
) -> History:
    """The history of f recorded frames. The values of boxes that are not placed yet become NaN.

    Args:
        step: (f,) number of the step after which each frame was recorded, counted from the end of the soft start; in
            ascending order.
        placed: (f,) number of placed boxes.
        pose: (f, n, 7) positions (m) and quaternions of the boxes.
        top_force_n: (f, n) force on top of each box, N.
        carrier_pose: (f, 7) position (m) and quaternion of the carrier.
        time_s: function that returns the time after a step, s.
        driven_from: the step after which the drive (the motion of the carrier) began; None if there was no drive.
    """
    absent = np.arange(job.scene.n_boxes) >= placed[:, None]
    poses, forces = np.array(pose, np.float64), np.array(top_force_n, np.float64)
    poses[absent], forces[absent] = np.nan, np.nan
    carrier = np.asarray(carrier_pose, np.float64)
    return History(
        time_s=np.array([time_s(number) for number in step.tolist()]),
        n_placed=placed.astype(np.int32),
        pos=poses[..., :3],
        quat=poses[..., 3:],
        top_force_n=forces,
        carrier_pos=carrier[:, :3],
        carrier_quat=carrier[:, 3:],
        drive=_drive(job, step, driven_from),
        drive_kind=job.drive.excitation.kind if job.drive is not None else "",
    )


def _drive(job: Job, step: NDArray[np.integer], driven_from: int | None) -> FloatArray:
    """(f, 3) force or acceleration of the drive at these steps: zero before the drive and after its last sample."""
    acting = np.zeros((len(step), 3))
    if job.drive is None or driven_from is None:
        return acting
    rows = job.drive.rows(job.scene.total_mass)
    row = step - driven_from - 1
    during = (row >= 0) & (row < len(rows))
    acting[during] = rows[row[during]]
    return acting
