"""Boxes that float when they are placed.

A box that is released high above its support falls. A box placed later may be put into the fallen box, and contacts may
then throw the fallen box up, back to its planned place. So the last poses of such a world do not tell that its plan
cannot be built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.engines.verdict import Outcome, Verdict, judge
from petmjx.options.simulation import Check, Simulation
from petmjx.plans.plan_warnings import gaps_mm
from petmjx.world.job import Job
from petmjx.world.scene import Scene

LEAST_FALL_M: Final = 0.02
"""A box that falls from its planned place by at most this distance, m, does not count as floating, however small the
threshold of the shift is. Files of plans are often rounded, and boxes of a file may float by some millimetres."""


def note_floating(outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation) -> list[Outcome]:
    """The outcomes. A world that stands becomes unstable if a box floated when it was placed, that is, if the gap below
    the box was larger than the threshold of the shift, and larger than ``LEAST_FALL_M``. Such a box counts as dropped.
    The first such box is the culprit. In the static check, boxes are not placed one after the other, so none floats.
    With the physics ``reference``, verdicts are those of the reference implementation, which has no such rule.

    Args:
        jobs: the jobs as the engine simulated them, one for each outcome.
    """
    if sim.check is Check.STATIC or sim.physics.falls_into_place:
        return list(outcomes)
    noted, most_m = list(outcomes), max(sim.thresholds.shift_m, LEAST_FALL_M)
    for k, (outcome, job) in enumerate(zip(outcomes, jobs, strict=True)):
        if outcome.verdict is not Verdict.STABLE:
            continue
        floating = gaps_m(job.scene) > most_m
        if floating.any():
            boxes = replace(outcome.boxes, dropped=outcome.boxes.dropped | floating)
            verdict, reason = judge(outcome.flags, boxes, outcome.n_placed, sim.thresholds)
            noted[k] = replace(outcome, boxes=boxes, verdict=verdict, reason=reason, culprit=int(floating.argmax()))
    return noted


@lru_cache(maxsize=256)
def gaps_m(scene: Scene) -> FloatArray:
    """(n,) height of each box's planned bottom above the highest box below it that is placed earlier, m. If no box is
    below it, the height above the carrier's top. The gaps are cached, since many worlds of a sweep have the same
    scene."""
    low_mm, size_mm = (scene.target - scene.half_size) * MM_PER_M, 2 * scene.half_size * MM_PER_M
    return gaps_mm(low_mm, size_mm) / MM_PER_M
