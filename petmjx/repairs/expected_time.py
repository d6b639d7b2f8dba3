"""The expected time of repairs, which is shown before they begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from petmjx.common.text import count_text, duration, rounded_text
from petmjx.engines.expected_work import Work
from petmjx.engines.machine_speed import costs_here
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_statics import statics_of
from petmjx.repairs.repair_options import RepairOptions
from petmjx.world.supports import deck_mm

TRIALS: Final = 70
"""Number of trials without errors of a plan that falls, in the mean (benchmarks/notebook/repair.md)."""

TRIALS_WITH_ERRORS: Final = 70
"""Number of trials in worlds with errors of a plan that falls, in the mean."""

PROPOSALS_S: Final = 1.0
"""CPU time of the proposals for a plan that falls, and of their statics, s, in the mean."""


def size_of(plans: Sequence[Plan], sim: Simulation, options: RepairOptions, engine: str, threads: int) -> str:
    """One line with the number of plans, the expected number of steps, and the expected time. Plans with a loose box
    (``petmjx.plans.plan_statics``) are expected to fall, but at least the largest plan. With a profile, the line has
    only the number of plans.

    Args:
        engine: name of the engine.
        threads: number of CPU threads.
    """
    amount = count_text(len(plans), "plan")
    if options.profile is not None:
        return amount
    n_boxes, worlds = [plan.n_boxes for plan in plans], options.worlds
    statics = statics_of(plans, partial(deck_mm, sim=sim))
    falls = np.flatnonzero(statics.placed_share < 1).tolist() or [int(np.argmax(n_boxes))]
    scores = Work(sim, n_boxes, placements=1 + worlds, carried=worlds, **statics._asdict())
    with_errors = TRIALS_WITH_ERRORS + worlds if worlds else 0
    n_trials = min(TRIALS, options.trials) + with_errors
    trials = Work(sim, [n_boxes[k] for k in falls], placements=n_trials, carried=with_errors, ties=statics.ties[falls])
    costs = costs_here(trials, threads)
    parts = costs.seconds(scores, threads), replace(costs, kernel_start_s=0, gpu_start_s=0).seconds(trials, threads)
    size = f"{amount}, about {rounded_text(float(scores.steps.sum() + trials.steps.sum()))} steps"
    if engine not in parts[0]:  # an engine of the user
        return size
    seconds = sum(part[engine] for part in parts) + len(falls) * PROPOSALS_S / threads
    return f"{size}, about {duration(seconds)}"
