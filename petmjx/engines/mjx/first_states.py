"""First states of worlds on the device: fresh states, or states that earlier worlds have kept (settled or paused).

Kept states are joined on the host (in the CPU's memory).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from petmjx.engines.mjx.scene_rows import gather_rows
from petmjx.engines.mjx.world_constants import device_arrays
from petmjx.engines.mjx.world_state import State, Status, per_box
from petmjx.world.job import Job


def paused_start(job: Job) -> State | None:
    """The state of the paused placement from which a job starts; None: the job does not start from such a state."""
    return job.start if isinstance(job.start, State) and int(job.start.status) == Status.PAUSED else None


def _put_at_rest(jobs: Sequence[Job], host: State) -> None:
    """In states on the host, move the boxes of each job with ``Job.poses`` to these poses, at rest."""
    for row, job in enumerate(jobs):
        if job.poses is None:
            continue
        pos, quat = job.poses[:, :3], job.poses[:, 3:]
        frames = job.scene.frames(pos, quat)
        host.qpos[row, : len(pos)] = np.concatenate([frames, quat], axis=1)
        host.qpos_remainder[row, : len(pos)] = frames - host.qpos[row, : len(pos), :3].astype(np.float64)
        for moving in (host.qvel, host.qacc, host.qacc_warmstart):
            moving[row] = 0.0


def _put_unplaced(paused: Mapping[int, int], host: State, fresh: State) -> None:
    """In states on the host, replace the columns of boxes that are not placed yet by the columns of fresh states.

    Args:
        paused: row → number of placed boxes, for placements that had paused.
        host: the states.
        fresh: states before the first step of these worlds, from which the columns are copied.
    """
    pairs: tuple[tuple[Any, Any], ...] = ((host, fresh), (host.metrics, fresh.metrics))
    for record, new in pairs:
        kind: Any = type(record)
        for name in per_box(kind):
            for row, n_placed in paused.items():
                getattr(record, name)[row, n_placed:] = getattr(new, name)[row, n_placed:]


def started_states(jobs: Sequence[Job], fresh: State) -> State:
    """The states in which the worlds of jobs begin: the kept state ``Job.start`` if the job has one, else a fresh
    state. A placement that had paused is still paused.

    Kept states are on the host, and are copied on the host (see ``upload_worlds``). Fresh states are fetched from the
    device only if a job needs them. Rows without a job never run, so they may have any state.

    Args:
        fresh: the states of the worlds before their first step (``world_state.fresh_state``). If all jobs start from
            settled states, an argument with shapes and types but without values is enough.
    """
    # Only the boxes of a kept state can be moved to the poses in ``Job.poses``. A drive (the motion of the carrier in a
    # test) that directly follows its placement has no kept state: its state is on the device.
    assert all(job.poses is None or isinstance(job.start, State) for job in jobs)
    starts = list({id(job.start): job.start for job in jobs if isinstance(job.start, State)}.values())
    if not starts:
        return fresh
    row_of = {id(start): row for row, start in enumerate(starts)}
    spare = len(fresh.step) - len(jobs)
    source = np.array([row_of.get(id(job.start), 0) for job in jobs] + [0] * spare)
    forked = np.array([isinstance(job.start, State) for job in jobs] + [True] * spare)

    def stack(new: jax.Array | jax.ShapeDtypeStruct, *kept: Any) -> NDArray[Any]:
        stacked = np.zeros((len(kept), *new.shape[1:]), new.dtype)
        for row, values in enumerate(kept):
            if stacked.ndim > 1 and np.ndim(values):
                stacked[row][tuple(slice(0, n) for n in np.shape(values))] = values
            else:
                stacked[row] = values
        return stacked

    stacked = jax.tree.map(stack, fresh, *starts)
    # ``steps_done`` includes the steps of a paused placement, and the steps that a world took on a GPU before it left
    # the GPU. It does not include the steps of a settled placement from which a world starts.
    left = stacked.status == Status.LEFT
    stacked = stacked._replace(
        steps_done=np.where(left | (stacked.status == Status.PAUSED), stacked.steps_done, 0),
        status=np.where(left, np.int32(Status.RUNNING), stacked.status),
    )
    leaves, structure = jax.tree.flatten(stacked)
    rows = gather_rows(leaves, source)
    _put_at_rest(jobs, jax.tree.unflatten(structure, rows))
    paused = {row: int(start.placed) for row, job in enumerate(jobs) if (start := paused_start(job)) is not None}
    if paused:
        _put_unplaced(paused, jax.tree.unflatten(structure, rows), jax.tree.map(np.asarray, fresh))
    if not forked.all():
        for mine, new in zip(rows, jax.tree.leaves(fresh), strict=True):
            mine[~forked] = np.asarray(new)[~forked]
    forks: State = jax.tree.unflatten(structure, device_arrays(rows))
    return forks
