"""What is looked at in the outcomes of an engine, whichever it is: soft contacts, the margin, and how near loads act to
the edges of what bears them, which says whether a verdict stands on a knife's edge.

Where an engine runs in workers they do it, each with its own outcomes: of small worlds it is almost half of what the
process of the run would have to do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from petmjx.engines.sinking import note_softness
from petmjx.options.config import Simulation
from petmjx.verdict import Flag, Outcome, Verdict, margin_of
from petmjx.world.bearing import plan_edges_m, rest_edges_m
from petmjx.world.job import Job

KNIFE_EDGE_M: Final = 0.0005
"""Plans have whole millimetres, and boxes are smaller than planned by a tenth of one. All verdicts that other
simulators disputed were of boxes whose centre was nearer than this to an edge (docs/validation.md)."""

MOST_TOGETHER: Final = 64
"""At most so many outcomes are looked at together; one by one, this took longer than the simulation on a GPU."""


def looked_at(outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation) -> list[Outcome]:
    """The outcomes with what follows from them and their jobs. It may change the verdict.

    Args:
        jobs: as the engine had them, one for each outcome.
        sim: that the engine had.
    """
    found = note_softness(outcomes, jobs, sim)
    for outcome in found:
        outcome.margin = margin_of(outcome.verdict, outcome.boxes, outcome.n_placed, sim.thresholds)
    note_edges(found, jobs)
    return found


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
