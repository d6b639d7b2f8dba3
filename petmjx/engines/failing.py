"""The outcome of a world whose simulation failed: by an exception, or with the process in which it ran."""

from __future__ import annotations

import numpy as np

from petmjx.config import Simulation
from petmjx.verdict import BoxMetrics, Flag, Outcome, Reason, Verdict
from petmjx.world.job import Job


def failed_outcome(index: int, job: Job, sim: Simulation, message: str) -> Outcome:
    """An invalid outcome without metrics; ``message`` says what happened, in one line."""
    n = job.scene.n_boxes
    unknown = np.full(n, np.nan)
    boxes = BoxMetrics(
        shift_m=np.full((n, 3), np.nan),
        max_tilt_deg=unknown,
        max_lin_acc=unknown,
        max_ang_acc=unknown,
        max_top_force_n=unknown,
        rest_top_force_n=unknown,
        dropped=np.zeros(n, np.bool_),
        drop_s=unknown,
        max_sway_m=unknown,
        pos=job.scene.start_pos,
        quat=job.scene.start_quat,
    )
    return Outcome(
        job=index,
        verdict=Verdict.INVALID,
        reason=Reason.FAILED,
        culprit=-1,
        first_sign_s=np.nan,
        n_boxes=n,
        n_placed=0,
        sim_time_s=np.nan,
        n_steps=0,
        flags=Flag.FAILED | (Flag.FORKED if job.start is not None else Flag.NONE),
        boxes=boxes,
        solver=sim.solver.value,
        message=message,
    )
