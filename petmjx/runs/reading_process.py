"""The code of a process that reads the plans of a run (petmjx.runs.plan_input starts the process)."""

from __future__ import annotations

import warnings
from typing import NamedTuple

from petmjx.common.errors import PlanWarning
from petmjx.engines.subprocess.task_pipe import serve
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import PlanSource, usable_plans
from petmjx.results.plan_records import PlanRecord, records_of


class PlanInput(NamedTuple):
    """The plans of a run.

    Attributes:
        records: plan id → record of the plan.
    """

    plan_set: PlanSet
    records: dict[str, PlanRecord]


class Answer(NamedTuple):
    """What the process has read.

    Attributes:
        warnings: texts of the ``PlanWarning`` that reading has issued.
    """

    plan_input: PlanInput
    warnings: list[str]


def read_here(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> PlanInput:
    """Read the plans of a run in this process.

    Raises:
        InputError: as ``usable_plans``.
    """
    plan_set = usable_plans(plans, sim, options)
    return PlanInput(plan_set, records_of(plan_set.plans, plan_set.numbers))


def main() -> None:
    """Read the plans that a task from standard input names, and write the answer to standard output."""
    serve(0, lambda task: _answer_to(*task))


def _answer_to(plans: PlanSource | None, sim: Simulation, options: RunOptions) -> Answer | None:
    """The plans. None after an error, or after a warning about the user's code: the process of the run then reads the
    plans itself, so that the error or warning appears there."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            plan_input = read_here(plans, sim, options)
        except Exception:
            return None
    if not all(issubclass(warning.category, PlanWarning) for warning in caught):
        return None
    return Answer(plan_input, [str(warning.message) for warning in caught])
