"""What the kernels of a run must know and have room for, by what its jobs are like."""

from __future__ import annotations

from collections.abc import Sequence

from petmjx.basics.errors import InputError
from petmjx.engines.batch.upload import round_up
from petmjx.engines.warp.launch import size_for
from petmjx.engines.warp.records import MAX_BOXES
from petmjx.world.job import Job


def wants_hands(job: Job) -> bool:
    """Whether a job's boxes do not just appear at their places."""
    return not job.scene.placing.appears


def gives(job: Job) -> bool:
    """Whether a job has boxes that give."""
    return job.scene.stiffness is not None


def is_wrapped(job: Job) -> bool:
    """Whether a job's boxes are shaken with film around them."""
    return job.drive is not None and job.scene.wrap.holds


def size_of(job: Job) -> int:
    """The size of a job's world: the most boxes of one that its thread block may have."""
    return size_for(job.scene.n_boxes).most_boxes


def widths_of(jobs: Sequence[Job], granule: int) -> dict[int, int]:
    """``Run.widths`` for some jobs."""
    largest = max(job.scene.n_boxes for job in jobs)
    if largest > MAX_BOXES:
        raise InputError(
            f"engine mjx-warp has room for plans of up to {MAX_BOXES} boxes, and one has {largest}: "
            "choose the engine mujoco"
        )
    widest: dict[int, int] = {}
    for job in jobs:
        size = size_of(job)
        widest[size] = max(widest.get(size, 0), round_up(job.scene.n_boxes, granule))
    return widest
