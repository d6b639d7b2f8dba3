"""How near loads act to the edges of what bears them: whether a verdict stands on a knife's edge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from petmjx.verdict import Flag, Outcome, Verdict
from petmjx.world.bearing import plan_edges_m, rest_edges_m
from petmjx.world.job import Job

KNIFE_EDGE_M: Final = 0.0005
"""Plans have whole millimetres, and boxes are smaller than planned by a tenth of one. All verdicts that other
simulators disputed were of boxes whose centre was nearer than this to an edge (docs/validation.md)."""


def note_edges(outcomes: Sequence[Outcome], jobs: Sequence[Job]) -> None:
    """Fill in the least distances, by the plan and at rest, and the flag of a knife's edge.

    At rest: of worlds that stand and were not shaken, whose carrier is where it was.
    """
    scenes = [job.scene for job in jobs]
    valid = [k for k, outcome in enumerate(outcomes) if outcome.verdict is not Verdict.INVALID]
    planned = list(dict.fromkeys((scenes[k], outcomes[k].n_placed) for k in valid))  # drives share a scene
    edge_m = dict(zip(planned, plan_edges_m(*zip(*planned, strict=True)), strict=True)) if planned else {}
    for k in valid:
        outcomes[k].plan_edge_m = edge_m[scenes[k], outcomes[k].n_placed]
    at_rest = [k for k in valid if outcomes[k].verdict is Verdict.STABLE and jobs[k].drive is None]
    rest_m = rest_edges_m([scenes[k] for k in at_rest], [outcomes[k].boxes.pos for k in at_rest])
    for k, least_m in zip(at_rest, rest_m, strict=True):
        outcomes[k].rest_edge_m = least_m
    for k in valid:
        if min(abs(outcomes[k].plan_edge_m), abs(outcomes[k].rest_edge_m)) <= KNIFE_EDGE_M:
            outcomes[k].flags |= Flag.KNIFE_EDGE
