"""How near loads act to the edges of what bears them: whether a verdict stands on a knife's edge."""

from __future__ import annotations

from typing import Final

from petmjx.verdict import Flag, Outcome, Verdict
from petmjx.world.bearing import plan_edge_m, rest_edge_m
from petmjx.world.job import Job

KNIFE_EDGE_M: Final = 0.0005
"""Plans have whole millimetres, and boxes are smaller than planned by a tenth of one. All verdicts that other
simulators disputed were of boxes whose centre was nearer than this to an edge (docs/validation.md)."""


def note_edges(outcome: Outcome, job: Job) -> None:
    """Fill in the least distances, by the plan and at rest, and the flag of a knife's edge.

    At rest: of worlds that stand and were not shaken, whose carrier is where it was.
    """
    if outcome.verdict is Verdict.INVALID:
        return
    outcome.plan_edge_m = plan_edge_m(job.scene, outcome.n_placed)
    if outcome.verdict is Verdict.STABLE and job.drive is None:
        outcome.rest_edge_m = rest_edge_m(job.scene, outcome.boxes.pos)
    if min(abs(outcome.plan_edge_m), abs(outcome.rest_edge_m)) <= KNIFE_EDGE_M:
        outcome.flags |= Flag.KNIFE_EDGE
