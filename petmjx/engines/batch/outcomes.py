"""Metrics and verdicts of finished worlds: reduced on the device, judged and read out on the host."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int
from numpy.typing import NDArray

from petmjx.engines.batch.recorder import Recorder
from petmjx.engines.batch.running import Measured, measured, of_boxes
from petmjx.engines.batch.state import State, narrow, take_rows
from petmjx.engines.batch.worlds import Worlds, uploaded
from petmjx.engines.clock import Clock
from petmjx.metrics.spec import BoxMetrics
from petmjx.options.config import Simulation
from petmjx.verdict import Flag, Outcome, Verdict, judge
from petmjx.world.job import Job


@partial(jax.jit, static_argnames="sim")
def reduce_metrics(state: State, worlds: Worlds, sim: Simulation) -> Measured:
    """Metrics that need the whole run, for every world of a table, on the device."""
    placed = jnp.arange(worlds.half.shape[1])[None] < state.placed[:, None]
    return measured(state.metrics, state.qpos, worlds, placed, state.step >= state.end, sim.thresholds)


PICKED = 256
"""Rows that ``picked`` takes at a time, so that it is compiled once for a table."""


@partial(jax.jit, static_argnames="sim")
def _picked(table: State, worlds: Worlds, rows: Int[Array, " row"], sim: Simulation) -> tuple[State, Measured]:
    some = take_rows(table, rows)
    return some, reduce_metrics(some, take_rows(worlds, rows), sim)


def pick(rows: NDArray[np.int64], table: State, worlds: Worlds, sim: Simulation) -> list[tuple[State, Measured]]:
    """States and metrics of some rows of a table, still on the device, in batches of ``PICKED``."""
    batches = []
    for first in range(0, len(rows), PICKED):
        some = rows[first : first + PICKED]
        padded = np.resize(some, PICKED).astype(np.int32)
        batches.append(_picked(table, worlds, uploaded(padded), sim))
    return batches


def outcomes(
    rows: NDArray[np.int64],
    picked: Sequence[tuple[State, Measured]],
    jobs: Sequence[Job],
    first_job: int,
    sim: Simulation,
    recorder: Recorder,
) -> Iterator[Outcome]:
    """Outcomes of rows of a table that ``pick`` has picked, with their histories."""
    clock = Clock(sim.physics.timestep_s)
    for batch, first in zip(picked, range(0, len(rows), PICKED), strict=True):
        state, found = jax.device_get(batch)
        yield from _outcomes(rows[first : first + PICKED], state, found, jobs, first_job, clock, sim, recorder)


def _outcomes(
    rows: NDArray[np.int64],
    host: State,
    found: Measured,
    jobs: Sequence[Job],
    first_job: int,
    clock: Clock,
    sim: Simulation,
    recorder: Recorder,
) -> Iterator[Outcome]:
    m, seconds = host.metrics, clock.time_s
    for i, row in enumerate(rows):
        job = jobs[row]
        n = job.scene.n_boxes
        driven = job.drive is not None and bool(host.driven_from[i] <= host.step[i])
        drops, pose = m.drop_step[i, :n], np.asarray(host.qpos[i, :n], np.float64)
        boxes = BoxMetrics.measured(
            n,
            **of_boxes(m, found, i, n, driven),
            dropped=np.asarray(drops >= 0),
            drop_s=np.array([seconds(step) if step >= 0 else np.nan for step in drops.tolist()]),
            pos=job.scene.middles(pose[:, :3], pose[:, 3:]),
            quat=pose[:, 3:],
        )
        flags = Flag(int(host.flags[i]) | (int(Flag.FORKED) if job.start is not None else 0))
        verdict, reason = judge(flags, boxes, int(host.placed[i]), sim.thresholds)
        known = verdict is not Verdict.STABLE and m.culprit[i] >= 0
        yield Outcome(
            job=first_job + int(row),
            verdict=verdict,
            reason=reason,
            culprit=int(m.culprit[i]) if known else -1,
            first_sign_s=seconds(int(m.sign_step[i])) if known else float("nan"),
            n_boxes=n,
            n_placed=int(host.placed[i]),
            sim_time_s=seconds(max(int(host.step[i]), 0)),
            n_steps=int(host.steps_done[i]),
            flags=flags,
            boxes=boxes,
            n_at_sign=int(m.sign_placed[i]) if known else 0,
            solver=sim.solver.value,
            # without other worlds' columns: what starts from it may be in a narrower table
            state=jax.tree.map(lambda a, i=i: np.array(a[i]), narrow(host, n)) if job.keep_state else None,
            history=recorder.history(int(row), jax.tree.map(lambda a, i=i: a[i], host), seconds)
            if job.record
            else None,
        )


def started_states(jobs: Sequence[Job], fresh: State) -> State:
    """First states of jobs: fresh ones, and for jobs that start from a kept state that one.

    Kept states are on the host, and are forked there (see ``upload_worlds``). Fresh ones come there from the device
    only if a job needs them: rows behind the jobs', which never run, may have any state.
    """
    starts = list({id(job.start): job.start for job in jobs if isinstance(job.start, State)}.values())
    if not starts:
        return fresh
    row_of = {id(start): row for row, start in enumerate(starts)}
    spare = len(fresh.step) - len(jobs)
    source = np.array([row_of.get(id(job.start), 0) for job in jobs] + [0] * spare)
    forked = np.array([isinstance(job.start, State) for job in jobs] + [True] * spare)

    def fork(new: jax.Array, *kept: Any) -> jax.Array:
        stacked = np.zeros((len(kept), *new.shape[1:]), new.dtype)
        for row, values in enumerate(kept):
            if stacked.ndim > 1 and np.ndim(values):
                stacked[row][tuple(slice(0, n) for n in np.shape(values))] = values
            else:
                stacked[row] = values
        spread = stacked[source]
        if not forked.all():
            spread[~forked] = np.asarray(new)[~forked]
        return uploaded(spread)

    forked_states: State = jax.tree.map(fork, fresh, *starts)
    return forked_states._replace(steps_done=fresh.steps_done)
