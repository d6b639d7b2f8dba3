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
from petmjx.plans.plan_workload import statics_of
from petmjx.repairs.repair_options import RepairOptions
from petmjx.world.supports import deck_mm

TRIALS: Final = 70
"""Mean number of trials without errors for a plan that falls (benchmarks/notebook/repair.md)."""

TRIALS_WITH_ERRORS: Final = 70
"""Mean number of trials in worlds with errors for a plan that falls."""

PROPOSALS_S: Final = 1.0
"""Mean CPU time of the proposals for a plan that falls, and of the statics of these proposals, s."""


def size_of(plans: Sequence[Plan], sim: Simulation, options: RepairOptions, engine: str, threads: int) -> str:
    """One line with the number of plans, the expected number of steps, and the expected time. Plans with a loose box
    (``petmjx.plans.plan_workload``) are expected to fall; if no plan has a loose box, the largest plan is expected to
    fall. With a profile, the line has only the number of plans.

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
    searched = min(TRIALS + TRIALS_WITH_ERRORS if worlds else TRIALS, options.trials)
    with_errors = max(searched - TRIALS, 0) + worlds
    n_trials = searched + worlds
    trials = Work(sim, [n_boxes[k] for k in falls], placements=n_trials, carried=with_errors, ties=statics.ties[falls])
    costs = costs_here(trials, threads)
    parts = costs.seconds(scores, threads), replace(costs, kernel_start_s=0, gpu_start_s=0).seconds(trials, threads)
    size = f"{amount}, about {rounded_text(float(scores.steps.sum() + trials.steps.sum()))} steps"
    if engine not in parts[0]:  # the speed of a user's own engine is unknown
        return size
    seconds = sum(part[engine] for part in parts) + len(falls) * PROPOSALS_S / threads
    return f"{size}, about {duration(seconds)}"
