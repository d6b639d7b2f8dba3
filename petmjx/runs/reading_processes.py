"""Reads the plans of a run: in the process of the run, or in other processes while JAX and Warp start.

Reading 10,003 plans and starting JAX and Warp take two to three seconds each, and both need Python's global lock. So in
one process, reading and starting would take turns, and the GPU would wait for both.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import Final, NamedTuple

from petmjx.common.machine import cpu_threads, cuda_devices
from petmjx.engines.engine_warmup import bytes_of_plans, may_use_gpu
from petmjx.engines.subprocess.task_pipe import Child
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.plan_reader import OPTIONS_OF_OTHERS
from petmjx.plans.plan_segments import Segment, joined, segments_of
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import PlanSource, carrier_extent_mm, usable_of, usable_plans
from petmjx.results.plan_digests import PlanRecord, records_of
from petmjx.runs.reading_child import ReadingAnswer

WORTH_A_PROCESS: Final = 16 << 20
"""Smallest size of plan files, in bytes, for which another process reads the plans. Files of this size have about 1,500
plans. The run's own process reads smaller files in less time than another process takes to start."""

MOST_IN_A_PROCESS: Final = 4 << 30
"""Largest size of plan files, in bytes, for which another process reads the plans. For a moment, the plans are in the
memory of this process and of the other process."""

MOST_PROCESSES: Final = 6
"""Largest number of processes that read segments of a file. With six processes, starting them takes as long as reading
the segments of 10,003 plans."""

THREADS_EACH: Final = 2
"""A machine with k times this number of CPU threads gets up to k processes."""


class PlanInput(NamedTuple):
    """The plans of a run.

    Attributes:
        records: plan id → record of the plan. There may also be records of skipped plans.
        edge_risks: plan id → ``EdgeRisk`` of the plan, for plans that other processes have read and examined.
    """

    plan_set: PlanSet
    records: dict[str, PlanRecord]
    edge_risks: dict[str, int]


def read_input(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanInput:
    """Read the plans of a run.

    Raises:
        InputError: see ``usable_plans``.
    """
    if _suits_processes(plans, options) and (gathered := read_in_processes(plans, sim, options)) is not None:
        return gathered._replace(plan_set=usable_of(gathered.plan_set, sim, options))
    return read_here(plans, sim, options)


def read_here(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanInput:
    """Read the plans of a run in this process.

    Raises:
        InputError: see ``usable_plans``.
    """
    plan_set = usable_plans(plans, sim, options)
    return PlanInput(plan_set, records_of(plan_set.plans, plan_set.numbers), {})


def read_in_processes(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanInput | None:
    """All plans of a source (``gather_plans``), read in one or more processes. The result is None if this fails: the
    caller then reads the plans itself, and gets the error."""
    segments = _segments(plans, options)
    sources: Sequence[PlanSource | Segment | None] = segments or [plans]
    try:
        tasks = [pickle.dumps((source, sim, options)) for source in sources]
    except Exception:  # a user's own class of paths may raise any error here
        return None
    answers = _answers(tasks)
    if answers is None:
        return None
    if not segments:
        (answer,) = answers
        return PlanInput(answer.content.plan_set, answer.records, answer.edge_risks)
    plan_set = joined([answer.content for answer in answers], carrier_extent_mm(sim))
    if plan_set is None:
        return None
    records = {
        plan_id: record._replace(number=plan_set.numbers[plan_id])
        for answer in answers
        for plan_id, record in answer.records.items()
    }
    risks = {plan_id: risk for answer in answers for plan_id, risk in answer.edge_risks.items()}
    return PlanInput(plan_set, records, risks)


def _answers(tasks: Sequence[bytes]) -> list[ReadingAnswer] | None:
    """Start one process for each task, and return the answers of the processes. The result is None if a process cannot
    answer."""
    children: list[Child] = []
    answers: list[ReadingAnswer] = []
    try:
        for task in tasks:
            children.append(Child("petmjx.runs.reading_child"))
            children[-1].tasks.put(task)
        for child in children:
            answer: ReadingAnswer | None = child.answers.get()
            if answer is None:
                return None
            answers.append(answer)
            child.end()
    finally:
        for child in children:
            child.end()
    return answers


def _segments(plans: PlanSource | None, options: RunOptions) -> list[Segment]:
    """Segments of the plans' file that processes can read at the same time. The list is empty if one process should
    read all plans. This is so if there are few CPU threads, if the file is small, if it lacks the suffix ``.json``, if
    it is a file of another tool, or if an option concerns all plans of a file together (such as ``limit``)."""
    count = min(MOST_PROCESSES, cpu_threads() // THREADS_EACH, bytes_of_plans(plans) // WORTH_A_PROCESS)
    names = ["limit", "articles", *(name for name, _ in OPTIONS_OF_OTHERS)]
    if count < 2 or any(getattr(options, name) is not None for name in names):
        return []
    (file,) = plans if isinstance(plans, list | tuple) and len(plans) == 1 else (plans,)
    if not isinstance(file, str | PathLike):
        return []
    path = Path(file)
    if path.suffix.lower() != ".json" or path.name == "run.json":
        return []
    with suppress(OSError, ValueError):
        return segments_of(path, count)
    return []


def _suits_processes(plans: PlanSource | None, options: RunOptions) -> bool:
    """Whether other processes should read the plans. This is so if ``plans`` are large files, and if this process may
    start a GPU meanwhile."""
    sources = plans if isinstance(plans, list | tuple) else [plans]
    paths = [Path(source) for source in sources if isinstance(source, str | PathLike)]
    if len(paths) < len(sources) or not may_use_gpu(options, plans):
        return False
    # a link such as "/dev/stdin" may lead to a pipe of this process, which another process cannot read
    if any(path.is_symlink() or not (path.is_file() or path.is_dir()) for path in paths):
        return False
    return WORTH_A_PROCESS <= bytes_of_plans(plans) <= MOST_IN_A_PROCESS and cpu_threads() > 1 and bool(cuda_devices())
