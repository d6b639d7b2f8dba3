"""Reads the plans of a run: in the process of the run, or in a process of its own while JAX and Warp start.

Reading 10,003 plans and starting JAX and Warp take two to three seconds each, and both need Python's global lock. So in
one process, they would take turns, and the GPU would wait for both.
"""

from __future__ import annotations

import pickle
from os import PathLike
from pathlib import Path
from typing import Final

from petmjx.common.machine import cpu_threads, cuda_devices
from petmjx.engines.run_engine import bytes_of_plans, may_use_gpu
from petmjx.engines.subprocess.task_pipe import Child
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.convention_checks import warn
from petmjx.plans.plan_sources import PlanSource
from petmjx.runs.reading_process import Answer, PlanInput, read_here

WORTH_A_PROCESS: Final = 16 << 20
"""Smallest size of plan files, in bytes, for which a process reads the plans: about 1,500 plans. Smaller files are read
before such a process has started."""

MOST_IN_A_PROCESS: Final = 4 << 30
"""Largest size of plan files, in bytes, for which a process reads the plans. For a moment, the plans are in the memory
of both processes."""


def read_input(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanInput:
    """Read the plans of a run.

    Raises:
        InputError: as ``usable_plans``.
    """
    if _suits_a_process(plans, options) and (answer := read_in_process(plans, sim, options)) is not None:
        warn(answer.warnings)
        return answer.plan_input
    return read_here(plans, sim, options)


def read_in_process(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> Answer | None:
    """Read the plans in a process. None if this fails: the caller then reads the plans itself, and gets the error."""
    try:
        task = pickle.dumps((plans, sim, options))
    except Exception:  # a user's own class of paths may raise any error here
        return None
    child = Child("petmjx.runs.reading_process")
    try:
        child.tasks.put(task)
        answer: Answer | None = child.answers.get()
    finally:
        child.end()
    return answer


def _suits_a_process(plans: PlanSource | None, options: RunOptions) -> bool:
    """Whether another process should read the plans: ``plans`` are large files, and this process may start a GPU while
    they are read."""
    sources = plans if isinstance(plans, list | tuple) else [plans]
    paths = [Path(source) for source in sources if isinstance(source, str | PathLike)]
    if len(paths) < len(sources) or not may_use_gpu(options, plans):
        return False
    if any(path.is_symlink() for path in paths):  # "/dev/stdin" is a link to the input of this process
        return False
    return WORTH_A_PROCESS <= bytes_of_plans(plans) <= MOST_IN_A_PROCESS and cpu_threads() > 1 and bool(cuda_devices())
