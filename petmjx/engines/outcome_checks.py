"""Checks of outcomes, the same for all engines: soft contacts, the margin, boxes that came to rest otherwise than
planned, and distances of loads from the edges of their supports, which show a verdict on a knife's edge.

If an engine runs in workers, each worker checks its own outcomes: for small worlds the checks are almost half of the
work of the process of the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.engines.contact_penetration import note_softness
from petmjx.engines.knife_edges import AT_REST, BY_PLAN, WHILE_BUILT, KnifeEdge, edges_when, sets_flag
from petmjx.engines.mujoco.box_motion import tilt_deg
from petmjx.engines.verdict import Flag, Outcome, Verdict, margin_of
from petmjx.options.simulation import Check, Simulation
from petmjx.world.edge_distances import Edges, LeastBuildingEdge, building_edges, edges_of
from petmjx.world.job import Job
from petmjx.world.scene import Scene
from petmjx.world.supports import bearings_of, joined_bearing

LEANS_DEG: Final = 2.0
"""A box of a stable world leans if its tilt at rest is larger. A box of half a metre is then 17 mm lower on one side.
Without a flag for it, soft contacts alone let no box lean by a tenth of this."""

LOWER_M: Final = 0.005
"""A box that lies lower than planned by more than this counts as leaning, too: soft contacts may give way by as much
(``petmjx.engines.contact_tilt.BOUND_SHARE``)."""

MOST_TOGETHER: Final = 128
"""Largest number of outcomes that are checked at once; 128 take a tenth of a second. One by one, checks took longer
than the simulation on a GPU."""

_NOT_BUILT: Final = LeastBuildingEdge(np.nan, -1, -1, np.nan, -1, -1)


def outcome_checks(outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation) -> list[Outcome]:
    """The outcomes with all values that follow from them and their jobs. The verdict may change.

    Args:
        jobs: the jobs of the engine, one for each outcome.
        sim: the options of the engine.
    """
    noted = note_softness(outcomes, jobs, sim)
    for outcome, job in zip(noted, jobs, strict=True):
        outcome.flags &= ~Flag.RERUN_AFTER_OVERFLOW
        outcome.margin = margin_of(outcome.verdict, outcome.boxes, outcome.n_placed, sim.thresholds)
        if outcome.verdict is Verdict.STABLE and job.drive is None and contact_tilt_boxes(outcome).size:
            outcome.flags |= Flag.LEANS
    if sim.check is Check.STATIC:
        note_edges(noted, jobs, in_order=False)
    else:
        note_edges(noted, jobs)
    return noted


def contact_tilt_boxes(outcome: Outcome) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """The boxes of a world at rest that lean by more than ``LEANS_DEG``, or lie more than ``LOWER_M`` lower than
    planned. If contacts gave way so far that the world has a flag for it, lower boxes do not count."""
    placed = slice(outcome.n_placed)
    leans = tilt_deg(outcome.boxes.quat[placed]) > LEANS_DEG
    if not outcome.flags & Flag.SINKING:
        leans |= outcome.boxes.shift_m[placed, 2] < -LOWER_M
    return np.flatnonzero(leans)


def note_edges(outcomes: Sequence[Outcome], jobs: Sequence[Job], *, in_order: bool = True) -> None:
    """Fill in the least distances of loads from edges: by the plan, at rest and while the plan is built. Also fill in
    the distances of boxes, and the flag of a knife's edge, which any box may set.

    Distances at rest are those of worlds that stand and were not shaken, so that the carrier is at its place. Distances
    while the plan is built are those of plans whose boxes are placed ``in_order``, without errors. Worlds that stand
    after a further leg of a chain are left out: they have the distances, and the flag, of the leg before.
    """
    scenes = [job.scene for job in jobs]
    valid = [
        k
        for k, outcome in enumerate(outcomes)
        if outcome.verdict is not Verdict.INVALID and (jobs[k].poses is None or outcome.verdict is not Verdict.STABLE)
    ]
    # drives share a scene
    planned = dict.fromkeys((scenes[k], outcomes[k].n_placed, in_order and not jobs[k].has_errors) for k in valid)
    at_rest = [k for k in valid if outcomes[k].verdict is Verdict.STABLE and jobs[k].drive is None]
    edges, built, resting = _all_edges(
        list(planned), [scenes[k] for k in at_rest], [outcomes[k].boxes.pos for k in at_rest]
    )
    by_plan = dict(zip(planned, zip(edges, built, strict=True), strict=True))
    of_rest = dict(zip(at_rest, resting, strict=True))
    for k in valid:
        outcome = outcomes[k]
        plan, least_built = by_plan[scenes[k], outcome.n_placed, in_order and not jobs[k].has_errors]
        plan_edge_m, rest_edge_m = plan.least, outcome.boxes.rest_edge_m
        outcome.plan_edge_m, outcome.plan_edge_box = _least(plan_edge_m)
        outcome.build_edge_m, outcome.build_edge_box, outcome.build_edge_step = least_built[:3]
        near = [np.array([least_built.nearest_m]), *plan]
        edge_m = np.concatenate([[outcome.build_edge_m], *plan])
        if k in of_rest:
            rest_edge_m = of_rest[k].least
            outcome.rest_edge_m, outcome.rest_edge_box = _least(rest_edge_m)
            near += of_rest[k]
        outcome.boxes = replace(outcome.boxes, plan_edge_m=plan_edge_m, rest_edge_m=rest_edge_m)
        if sets_flag(np.concatenate(near), None).any() or sets_flag(edge_m, outcome.verdict).any():
            outcome.flags |= Flag.KNIFE_EDGE


def edges_again(scene: Scene, outcome: Outcome) -> Iterator[KnifeEdge]:
    """All distances of loads from edges that ``note_edges`` looked at, also those that no table keeps: of own weights,
    and the nearest one while the plan is built."""
    in_order, at_rest = not np.isnan(outcome.build_edge_m), not np.isnan(outcome.rest_edge_m)
    edges, (built,), resting = _all_edges(
        [(scene, outcome.n_placed, in_order)], [scene] * at_rest, [outcome.boxes.pos] * at_rest
    )
    for when, of_boxes in ((BY_PLAN, edges), (AT_REST, resting)):
        for by_weight, by_load in of_boxes:
            yield from edges_when(by_load, when)
            yield from edges_when(by_weight, when, own_weight=True)
    if in_order:
        yield KnifeEdge(built.edge_m, built.box, WHILE_BUILT, built.step)
        yield KnifeEdge(built.nearest_m, built.nearest_box, WHILE_BUILT, built.nearest_step)


def _all_edges(
    planned: Sequence[tuple[Scene, int, bool]], at_rest: Sequence[Scene], pos: Sequence[FloatArray]
) -> tuple[list[Edges], list[LeastBuildingEdge], list[Edges]]:
    """The edges of planned scenes, the least edges while they are built, and the edges of scenes at rest.

    All are computed at once: the time depends on the number of calls.

    Args:
        planned: scene, number of placed boxes, and whether the least edges while it is built are wanted.
        at_rest: scenes at rest, with their boxes at the (n, 3) places ``pos``, m.
    """
    if not planned:
        return [], [], []
    scenes, placed, inputs = zip(*planned, strict=True)
    bearings = bearings_of(scenes, at_rest, pos)
    joined = joined_bearing(bearings)
    edges = edges_of(bearings, [*placed, *(scene.n_boxes for scene in at_rest)], joined)
    some = [k for k, is_asked in enumerate(inputs) if is_asked]
    counts = [scenes[k].n_boxes for k in some]
    built = building_edges([bearings[k] for k in some], counts, joined if len(some) == len(planned) else None)
    of_some = dict(zip(some, built, strict=True))
    number = len(planned)
    return edges[:number], [of_some.get(k, _NOT_BUILT) for k in range(number)], edges[number:]


def _least(edge_m: FloatArray) -> tuple[float, int]:
    """The least of the distances and the number of its box; NaN and -1 if there is none."""
    known = np.where(np.isnan(edge_m), np.inf, edge_m)
    box = int(known.argmin()) if len(known) else -1
    return (float(edge_m[box]), box) if box >= 0 and known[box] < np.inf else (np.nan, -1)
