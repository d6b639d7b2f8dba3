"""The code of a check process, which checks outcomes. The process needs neither JAX nor Warp, and ends with the run."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from typing import Final

from petmjx.common.text import one_line
from petmjx.common.units import FloatArray
from petmjx.engines.outcome_checks import outcome_checks
from petmjx.engines.subprocess.task_pipe import next_of, own_pipes
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job

NICE: Final = 5

Look = tuple[Sequence[Outcome], Sequence[Job], Simulation]
"""The arguments of ``outcome_checks``."""

Answer = tuple[Sequence[Outcome], Sequence[tuple[FloatArray, FloatArray]]]
"""Outcomes without their boxes, and two arrays for the boxes of each outcome: distances of loads from edges in the
plan, and at rest, m."""


def main() -> None:
    """Make the checks one after another, and answer each. If a check raises an error, the answer is a line of text."""
    looks, answers = own_pipes(NICE)
    while (look := next_of(looks)) is not None:
        answer: Answer | str
        try:
            outcomes = outcome_checks(*look)
            edges = [(outcome.boxes.plan_edge_m, outcome.boxes.rest_edge_m) for outcome in outcomes]
            for outcome in outcomes:
                del outcome.boxes  # the run still has these data, and unpickling them takes long
            answer = outcomes, edges
        except Exception as error:
            answer = one_line(error)
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except BrokenPipeError:
            break
    os._exit(0)
