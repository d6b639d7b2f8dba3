"""The outcome of a world whose simulation ended with an exception, or whose process ended."""

from __future__ import annotations

import numpy as np

from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Flag, Outcome, judge
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job


def failed_outcome(stream_number: int, job: Job, sim: Simulation, message: str) -> Outcome:
    """An invalid outcome without metrics. ``message``: one line that says what happened."""
    scene = job.scene
    boxes = BoxMetrics.measured(scene.n_boxes, pos=scene.start_pos, quat=scene.start_quat)
    flags = Flag.FAILED | (Flag.FORKED if job.forks else Flag.NONE)
    verdict, reason = judge(flags, boxes, 0, sim.thresholds)
    return Outcome(
        job=stream_number,
        verdict=verdict,
        reason=reason,
        culprit=-1,
        first_sign_s=np.nan,
        n_boxes=scene.n_boxes,
        n_placed=0,
        sim_time_s=np.nan,
        n_steps=0,
        flags=flags,
        boxes=boxes,
        solver=sim.solver.value,
        message=message,
    )
