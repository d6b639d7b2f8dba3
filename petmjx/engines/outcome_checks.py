"""Checks of outcomes, which are the same for all engines. The checks find four things: verdicts that soft contacts may
have decided; boxes that floated when they were placed; boxes that came to rest tilted, or lower than planned; and loads
so near to an edge of their supports that a tiny error might change the verdict. The checks also compute the margin of
each world.

If engines run in worker processes, each worker checks its own outcomes. If the run's own process checked all outcomes,
the checks of small worlds would take almost half of the time of this process.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import compress, pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.engines.contact_penetration import note_penetration
from petmjx.engines.contact_tilt import contact_tilt_suspects, n_loading, places_with_errors
from petmjx.engines.floating_boxes import note_floating
from petmjx.engines.knife_edges import AT_REST, BY_PLAN, NEAR_M, WHILE_BUILT, KnifeEdge, edges_when, sets_flag
from petmjx.engines.margin import margins_of
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.mujoco.box_motion import tilt_deg
from petmjx.engines.verdict import Flag, Outcome, Verdict, judge
from petmjx.options.physics import Cone
from petmjx.options.simulation import Check, Simulation
from petmjx.options.thresholds import FAILURES, MOTION_REASONS, Thresholds
from petmjx.world.bearings import TOUCH_M, Bearing
from petmjx.world.building_edges import LeastBuildingEdge, building_edges, first_least
from petmjx.world.edge_distances import Edges, loads_and_edges
from petmjx.world.job import Job
from petmjx.world.scene import Scene
from petmjx.world.supports import UPRIGHT, bearings_of

LEANS_DEG: Final = 2.0
"""A box of a stable world counts as leaning if its tilt at rest is larger than this angle, degrees. At a tilt of 2°,
one side of a box of half a metre is 17 mm lower than the other side. Soft contacts alone tilt a box by less than a
tenth of this angle, unless the world has ``Flag.SINKING``."""

LOWER_M: Final = 0.005
"""A box also counts as leaning if it lies lower than planned by more than this height, m. Soft contacts alone may lower
a box by this distance before they set ``Flag.SINKING`` (``petmjx.engines.contact_tilt.BOUND_SHARE``)."""

MOST_TOGETHER: Final = 256
"""Largest number of outcomes that are checked together. Checking 256 outcomes takes 0.1 to 0.2 s. Checking outcomes one
by one took longer than their simulation on a GPU."""


def outcome_checks(
    outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation, *, verdicts_only: bool = False
) -> list[Outcome]:
    """The outcomes, with all values that can be computed from an outcome and its job: margin, distances from edges, and
    flags. The checks may change the verdict.

    Args:
        jobs: the jobs as the engine simulated them, one for each outcome.
        sim: the options with which the engine simulated.
        verdicts_only: whether only the verdicts are needed, and the flags that decide about further attempts. With
            ``verdicts_only``, worlds that stand get no distances from edges, no ``Flag.KNIFE_EDGE`` and no
            ``Flag.LEANS``. Computing these distances and flags takes most of the time of all checks.
    """
    noted = note_floating(note_penetration(outcomes, jobs, sim), jobs, sim)
    _name_culprits(noted, sim.thresholds)
    for outcome, margin in zip(noted, margins_of(noted, sim.thresholds), strict=True):
        outcome.flags &= ~Flag.RERUN_AFTER_OVERFLOW
        outcome.margin = margin
    if verdicts_only:
        fell = [k for k, outcome in enumerate(noted) if outcome.verdict is Verdict.UNSTABLE]
        note_edges([noted[k] for k in fell], [jobs[k] for k in fell], sim)
        return noted
    at_rest = [k for k, job in enumerate(jobs) if noted[k].verdict is Verdict.STABLE and job.drive is None]
    for k, leans in zip(at_rest, _leaning([noted[k] for k in at_rest]), strict=True):
        if leans.any():
            noted[k].flags |= Flag.LEANS
    note_edges(noted, jobs, sim)
    return noted


def _name_culprits(outcomes: Sequence[Outcome], thresholds: Thresholds) -> None:
    """Name the culprits of worlds whose reason is no motion, which engines do not know."""
    failure_of = {failure.reason: failure for failure in FAILURES if failure.reason not in MOTION_REASONS}
    for outcome in outcomes:
        if (failure := failure_of.get(outcome.reason)) is not None:
            excess = failure.excess(outcome.boxes, thresholds)[: outcome.n_placed]
            outcome.culprit = int(np.nan_to_num(excess, nan=-np.inf).argmax())
            outcome.first_sign_s, outcome.n_at_sign = np.nan, 0


def contact_tilt_boxes(outcome: Outcome) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """The numbers of the boxes that lean by more than ``LEANS_DEG``, or lie more than ``LOWER_M`` lower than planned,
    in a world at rest. If the world has ``Flag.SINKING``, only the boxes that lean are included."""
    return np.flatnonzero(_leaning([outcome])[0])


def _leaning(outcomes: Sequence[Outcome]) -> list[NDArray[np.bool_]]:
    """For each world, (n_placed,) whether each box leans too much or lies too far below its planned place, by the rule
    of ``contact_tilt_boxes``."""
    if not outcomes:
        return []
    placed = [outcome.n_placed for outcome in outcomes]
    quats = [outcome.boxes.quat[: outcome.n_placed] for outcome in outcomes]
    if len({quat.dtype for quat in quats}) == 1:
        quats = [np.concatenate(quats)]
    leans = np.concatenate([tilt_deg(quat) > LEANS_DEG for quat in quats])
    lower = np.concatenate([outcome.boxes.shift_m[: outcome.n_placed, 2] < -LOWER_M for outcome in outcomes])
    sinks = np.repeat([bool(outcome.flags & Flag.SINKING) for outcome in outcomes], placed)
    return np.split(leans | (lower & ~sinks), np.cumsum(placed)[:-1])


def note_edges(outcomes: Sequence[Outcome], jobs: Sequence[Job], sim: Simulation) -> None:
    """Compute the distances of the boxes' loads from the edges of their supports: in the plan, at rest and while the
    plan is built. Write the distances of all boxes, the smallest distances of each world, and two flags into the
    outcomes. ``Flag.KNIFE_EDGE`` is set if the load of any box is too near an edge. ``Flag.SINKING`` is set for worlds
    that may have tipped over because contacts are soft.

    Distances at rest are computed for worlds that stand and were not shaken, because their carriers are still at their
    places. Distances during the building of a plan are computed only if the boxes are placed in order and without
    errors. In a chain, a world that still stands after its second or a later shaken leg (part of the journey) is left
    out. Such a world keeps the distances and the flag from its previous leg.
    """
    scenes, in_order = [job.scene for job in jobs], sim.check is not Check.STATIC
    valid = [
        k
        for k, outcome in enumerate(outcomes)
        if outcome.verdict is not Verdict.INVALID and (jobs[k].poses is None or outcome.verdict is not Verdict.STABLE)
    ]
    if not valid:
        return
    # Drives (motions of the carrier) from the same placement share a scene, which is examined only once.
    keys = [(scenes[k], outcomes[k].n_placed, in_order and not jobs[k].has_errors) for k in valid]
    planned = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    at_rest = [k for k in valid if outcomes[k].verdict is Verdict.STABLE and jobs[k].drive is None]
    elliptic = sim.physics.cone is Cone.ELLIPTIC
    fallen = [k for k in valid if elliptic and outcomes[k].reason in MOTION_REASONS and scenes[k].soft is None]
    joined = _Joined(list(planned))
    number_at_rest = {k: joined.add_at_rest(scenes[k], outcomes[k].boxes) for k in at_rest}
    number_fallen = {}
    for k in fallen:
        placed, moved = n_loading(outcomes[k]), jobs[k].has_errors
        key = scenes[k], placed, in_order
        if not moved and key in planned:
            number_fallen[k] = planned[key]
        else:
            places = places_with_errors(jobs[k]) if moved else scenes[k].target
            gap_m = sim.thresholds.shift_m if moved else TOUCH_M
            number_fallen[k] = joined.add(scenes[k], places, placed, gap_m)
    bearing, load, edges, built = joined.edges()
    if fallen:
        some, rows = bearing.of_scenes(np.array([*number_fallen.values()]))
        of_some = some, load.take(rows, axis=0), edges.by_load[rows]
        leans = contact_tilt_suspects([outcomes[k] for k in fallen], [jobs[k] for k in fallen], sim, *of_some)
        for outcome in compress((outcomes[k] for k in fallen), leans):
            outcome.flags |= Flag.SINKING
            judged = judge(outcome.flags, outcome.boxes, outcome.n_placed, sim.thresholds)
            outcome.verdict, outcome.reason = judged
    first = bearing.boxes.first.tolist()
    least, boxes_of = edges.least, [slice(*ends) for ends in pairwise(first)]
    scene = np.repeat(np.arange(len(boxes_of)), np.diff(first))
    least_of = dict(zip(*(values.tolist() for values in first_least(least, scene)), strict=True))
    # Only loads close to an edge can set ``Flag.KNIFE_EDGE``. Such loads are few, and only they are examined below.
    close = np.flatnonzero(np.fmin(np.abs(edges.by_weight), np.abs(edges.by_load)) <= NEAR_M)
    by_weight, by_load = edges.by_weight[close], edges.by_load[close]
    near, contradicts_stable, contradicts_unstable = (
        np.bincount(scene[close[sets_flag(by_weight, side) | sets_flag(by_load, side)]], minlength=len(boxes_of)) > 0
        for side in (None, Verdict.STABLE, Verdict.UNSTABLE)
    )
    contradicts = {Verdict.STABLE: contradicts_stable, Verdict.UNSTABLE: contradicts_unstable}
    for verdict, of_edges in contradicts.items():
        of_edges[: len(built)] |= sets_flag(np.array([edge.edge_m for edge in built]), verdict)
        of_edges[: len(built)] |= sets_flag(np.array([edge.nearest_m for edge in built]), None)
    for k, key in zip(valid, keys, strict=True):
        outcome, number, rest = outcomes[k], planned[key], number_at_rest.get(k)
        outcome.plan_edge_m, outcome.plan_edge_box = _least_edge(least, least_of.get(number), first[number])
        outcome.build_edge_m, outcome.build_edge_box, outcome.build_edge_step = built[number][:3]
        rest_edge_m, is_knife_edge = outcome.boxes.rest_edge_m, contradicts[outcome.verdict][number]
        if rest is not None:
            rest_edge_m, is_knife_edge = least[boxes_of[rest]], is_knife_edge or near[rest]
            outcome.rest_edge_m, outcome.rest_edge_box = _least_edge(least, least_of.get(rest), first[rest])
        outcome.boxes = outcome.boxes.with_edges(least[boxes_of[number]], rest_edge_m)
        if is_knife_edge:
            outcome.flags |= Flag.KNIFE_EDGE


def edges_again(scene: Scene, outcome: Outcome) -> Iterator[KnifeEdge]:
    """Yield again all distances of loads from edges that ``note_edges`` examined. The result includes two kinds of
    distances that are in no column of the results. First: the distance of each box's own weight, without the forces on
    its top, from the nearest edge. Second: of all loads while the plan is built, the distance of the load that is
    nearest to an edge, inside or beyond the edge. (The column ``build_edge_m`` has the smallest signed distance
    instead.)"""
    in_order, at_rest = not np.isnan(outcome.build_edge_m), not np.isnan(outcome.rest_edge_m)
    joined = _Joined([(scene, outcome.n_placed, in_order)])
    if at_rest:
        joined.add_at_rest(scene, outcome.boxes)
    bearing, _, edges, (built,) = joined.edges()
    for when, (begin, end) in zip((BY_PLAN, AT_REST), pairwise(bearing.boxes.first.tolist()), strict=False):
        yield from edges_when(edges.by_load[begin:end], when)
        yield from edges_when(edges.by_weight[begin:end], when, own_weight=True)
    if in_order:
        yield KnifeEdge(built.edge_m, built.box, WHILE_BUILT, built.step)
        yield KnifeEdge(built.nearest_m, built.nearest_box, WHILE_BUILT, built.nearest_step)


@dataclass
class _Joined:
    """Scenes whose loads and edges are computed together, since the time depends mainly on the number of calls.

    Attributes:
        planned: at least one scene with boxes at their planned places. Each scene comes with two values: the number of
            placed boxes, and whether the smallest distances while the plan is built are needed.
        elsewhere: further scenes, with boxes at other places than planned. Each scene comes with four values: the
            places (n, 3) of the boxes, m; the number of placed boxes; the largest gap that ``find_bearings`` allows, m;
            and the upward directions (n, 3) of the boxes.
    """

    planned: Sequence[tuple[Scene, int, bool]]
    elsewhere: list[tuple[Scene, FloatArray, int, float, FloatArray]] = field(default_factory=list)

    def add(self, scene: Scene, pos: FloatArray, placed: int, most_gap_m: float) -> int:
        """Add a scene with its first ``placed`` boxes, upright. Returns the number of the scene among all scenes, in
        the order ``planned``, ``elsewhere``."""
        upright = np.broadcast_to(UPRIGHT, pos.shape)
        self.elsewhere.append((scene, pos, placed, most_gap_m, upright))
        return len(self.planned) + len(self.elsewhere) - 1

    def add_at_rest(self, scene: Scene, boxes: BoxMetrics) -> int:
        """Add a scene with all of its boxes in their last poses. Returns the number of the scene among all scenes, in
        the order ``planned``, ``elsewhere``.

        Poses are rounded to float32, as in tables. A difference of micrometres can change the place where a leaning box
        touches its support. With rounded poses, distances from edges are the same as if they were computed from the
        poses in a table.
        """
        pos, quat = (values.astype(np.float32).astype(float) for values in (boxes.pos, boxes.quat))
        w, x, y, z = quat.T
        up = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)], axis=-1)
        self.elsewhere.append((scene, pos, scene.n_boxes, TOUCH_M, up))
        return len(self.planned) + len(self.elsewhere) - 1

    def edges(self) -> tuple[Bearing, FloatArray, Edges, list[LeastBuildingEdge]]:
        """Four results: the supports of all boxes of all scenes; the loads of the boxes (see ``Bearing.loads``); the
        distances of these loads from edges; and the smallest distances from edges while the planned scenes are
        built."""
        scenes, placed, are_built = zip(*self.planned, strict=True)
        moved, pos, placed_moved, gaps_m, up = zip(*self.elsewhere, strict=True) if self.elsewhere else ((),) * 5
        bearing = bearings_of(scenes, moved, pos, gaps_m, up)
        load, *edges = loads_and_edges(bearing, [*placed, *placed_moved])
        n_built = [scene.n_boxes if is_built else 0 for scene, is_built in zip(scenes, are_built, strict=True)]
        return bearing, load, Edges(*edges), building_edges(bearing.of_range(0, len(scenes)), n_built)


def _least_edge(edge_m: FloatArray, place: int | None, first: int) -> tuple[float, int]:
    """The smallest distance of a load from an edge in one scene, m, and the number of its box. The result is NaN and -1
    if all distances of the scene are unknown (NaN).

    Args:
        edge_m: distances of the boxes of all scenes, scene after scene, m.
        place: index of the smallest distance of this scene; None if all its distances are unknown.
        first: index of the first box of this scene.
    """
    return (np.nan, -1) if place is None else (float(edge_m[place]), place - first)
