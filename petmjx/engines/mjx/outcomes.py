"""Outcomes of finished worlds, made on the host (in the CPU's memory)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import jax
import numpy as np

from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.mjx.frame_recorder import Recorder
from petmjx.engines.mjx.readback import Readback
from petmjx.engines.mjx.running_metrics import of_boxes
from petmjx.engines.mjx.world_state import State, Status, narrow
from petmjx.engines.step_clock import Clock
from petmjx.engines.verdict import Flag, Outcome, Verdict, judge
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job


def outcomes(
    picked: Sequence[Readback],
    jobs: Mapping[int, Job] | Sequence[Job],
    stream_numbers: Mapping[int, int] | Sequence[int],
    sim: Simulation,
    recorder: Recorder,
) -> Iterator[Outcome]:
    """The outcomes, with histories, of rows (worlds in the device's table). Each batch is copied to the host when its
    first outcome is requested.

    Args:
        picked: the states of the rows, still on the device.
        jobs: row → job of the world in this row.
        stream_numbers: row → number of this job for ``Outcome.job``.
    """
    seconds = Clock(sim.physics.timestep_s).time_s
    for batch in picked:
        host, measured = batch.on_host()
        m = host.metrics
        for i, row in enumerate(batch.rows.tolist()):
            job = jobs[row]
            n = job.scene.n_boxes
            driven = job.drive is not None and bool(host.driven_from[i] <= host.step[i])
            drops, pose = m.drop_step[i, :n], np.asarray(host.qpos[i, :n], np.float64)
            pose[:, :3] += host.qpos_remainder[i, :n]
            boxes = BoxMetrics.measured(
                n,
                **of_boxes(m, measured, i, n, driven),
                dropped=np.asarray(drops >= 0),
                drop_s=np.array([seconds(step) if step >= 0 else np.nan for step in drops.tolist()]),
                pos=job.scene.middles(pose[:, :3], pose[:, 3:]),
                quat=pose[:, 3:],
            )
            flags = Flag(int(host.flags[i]) | (int(Flag.FORKED) if job.forks else 0))
            verdict, reason = judge(flags, boxes, int(host.placed[i]), sim.thresholds)
            has_culprit = verdict is not Verdict.STABLE and m.culprit[i] >= 0
            history = None
            if job.record:
                history = recorder.history(row, jax.tree.map(lambda array, i=i: array[i], host), seconds)
            yield Outcome(
                job=stream_numbers[row],
                verdict=verdict,
                reason=reason,
                culprit=int(m.culprit[i]) if has_culprit else -1,
                first_sign_s=seconds(int(m.sign_step[i])) if has_culprit else float("nan"),
                n_boxes=n,
                n_placed=int(host.placed[i]),
                sim_time_s=seconds(max(int(host.step[i]), 0)),
                n_steps=int(host.steps_done[i]),
                flags=flags,
                boxes=boxes,
                n_at_sign=int(m.sign_placed[i]) if has_culprit else 0,
                solver=sim.solver.value,
                state=_kept_state(job, host, i),
                history=history,
            )


def _kept_state(job: Job, host: State, row: int) -> State | None:
    """The state that the outcome of a job must have; None if the outcome needs no state. The state has columns for the
    boxes of this world alone or, if the placement paused, for the placed boxes alone. A world that starts from this
    state may then be in a table for fewer boxes."""
    pauses = host.status[row] == Status.PAUSED
    if not (job.keep_state or pauses or host.status[row] == Status.LEFT):
        return None
    width = int(host.placed[row]) if pauses else job.scene.n_boxes
    kept: State = jax.tree.map(lambda array: np.array(array[row]), narrow(host, width))
    return kept
