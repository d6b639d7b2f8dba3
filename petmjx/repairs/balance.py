"""Checks drafts of plans by statics: finds the loads beyond the edge of their supports at each step of building, and
measures how harmful they are.

The balance takes half a millisecond per draft, a simulation a tenth of a second and more. So the balance tells which of
many changes are worth a simulation. The balance never decides: a load beyond an edge may lean on a neighbour, and
stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.simulation import Simulation
from petmjx.plans.plan_warnings import shared_length
from petmjx.repairs.drafts import TOLERANCE_MM, BoolArray, Draft, IntArray
from petmjx.world.edge_distances import bearing_in_order, building_loads_of, depends_on_sharing
from petmjx.world.scene import build_scene
from petmjx.world.supports import find_bearings

AT_ONCE: Final = 128
"""Number of drafts that are computed at once."""

DEEP_MM: Final = 50.0
"""A load this far beyond an edge counts twice as much as one on the edge, and a load further beyond counts no more."""

SAFE_MM: Final = 12.0
"""A load this far inside its edges is safe. If a robot places two boxes, the error of their relative place has a
standard deviation of 3 mm (docs/confidence.md). ``SAFE_MM`` is four standard deviations."""

ROOM_MM: Final = 8.0
"""A box has room between two others if the gap between them is larger than the box by at least this. The errors of
their places and sizes are 3 mm together. Without room, the box lands on one of the two. Of 24 generated plans that
stand without errors, 8 fall in some worlds with errors. In 7 of these 8 plans, and in none of the others, a box has at
most 4 mm of room."""

PERHAPS: Final = 0.5
"""Weight of a load that is beyond an edge under one sharing of loads, but possibly inside under another."""


class Balance(NamedTuple):
    """The loads of one draft that are beyond edges while it is built.

    Attributes:
        box: (k,) numbers of the boxes with such loads, in order of time.
        step: (k,) position in packing order of the box whose placement moves the load beyond.
        cause: (k,) number of the box at that position.
        depth_mm: (k,) largest distance of each load beyond the edge.
        last_mm: (k,) distance of each load from the edge once all boxes are placed, positive inside.
        trouble: sum of the weights of these loads. A load has a weight of 1 to 2, times ``PERHAPS`` if it may be
            inside.
        weakness: sum of the weights of what makes the plan fall only with errors. A load near its edge has a weight of
            1 on the edge to 0 at ``SAFE_MM`` inside. A box that is lowered between two others has a weight of 1 without
            room to 0 with ``ROOM_MM`` of room.
        squeezed: numbers of the boxes that are lowered between two others with less room than ``ROOM_MM``.
    """

    box: IntArray
    step: IntArray
    cause: IntArray
    depth_mm: FloatArray
    last_mm: FloatArray
    trouble: float
    weakness: float
    squeezed: tuple[int, ...]

    def depth_of(self, box: int) -> float:
        """Distance of a box's load beyond an edge, mm; 0: inside."""
        rows = np.flatnonzero(self.box == box)
        return float(self.depth_mm[rows[0]]) if len(rows) else 0.0


def balances(drafts: Sequence[Draft], sim: Simulation, *, spare_mm: float = 0.0) -> list[Balance]:
    """The balance of each draft.

    Args:
        spare_mm: loads that are inside by less than this also count as beyond an edge.
    """
    results: list[Balance] = []
    for begin in range(0, len(drafts), AT_ONCE):
        results += _balances(drafts[begin : begin + AT_ONCE], sim, spare_mm)
    return results


def _balances(drafts: Sequence[Draft], sim: Simulation, spare_mm: float) -> list[Balance]:
    scenes = [build_scene(draft.as_plan(), sim) for draft in drafts]
    bearing = bearing_in_order(find_bearings(scenes, [scene.target for scene in scenes]))
    built = building_loads_of(bearing, [scene.n_boxes for scene in scenes])
    perhaps = depends_on_sharing(bearing, built)
    first = bearing.boxes.first
    ends = np.searchsorted(built.box, first)
    results = []
    for number, draft in enumerate(drafts):
        rows, start = slice(ends[number], ends[number + 1]), int(first[number])
        edge_mm = MM_PER_M * built.edge_m[rows] - spare_mm
        results.append(_balance(draft, built.box[rows] - start, built.step[rows] - start, edge_mm, perhaps[rows]))
    return results


def _balance(draft: Draft, box: IntArray, step: IntArray, edge_mm: FloatArray, perhaps: BoolArray) -> Balance:
    """The balance of a draft from the edges of its loads, sorted by box and step."""
    order = np.array(draft.order)
    has_edge = ~np.isnan(edge_mm)  # a box that floats or overlaps may bear a load although nothing bears the box
    box, step, edge_mm, perhaps = box[has_edge], step[has_edge], edge_mm[has_edge], perhaps[has_edge]
    boxes, begins = np.unique(box, return_index=True)
    ends = np.append(begins[1:], len(box))
    rows, missing_room = [], _missing_room(draft)
    weakness = float(missing_room.sum())
    for position, begin, end in zip(boxes.tolist(), begins.tolist(), ends.tolist(), strict=True):
        edges = edge_mm[begin:end]
        beyond = np.flatnonzero(edges < 0)
        if len(beyond):
            at = begin + int(beyond[0])
            sure = bool((~perhaps[begin:end][beyond]).any())
            rows.append((int(step[at]), int(order[position]), float(-edges.min()), float(edges[-1]), sure))
        else:
            weakness += max(1 - float(edges.min()) / SAFE_MM, 0.0)
    rows.sort()
    depth = np.array([row[2] for row in rows], float)
    weight = np.where([row[4] for row in rows], 1.0, PERHAPS)
    steps = np.array([row[0] for row in rows], np.intp)
    return Balance(
        box=np.array([row[1] for row in rows], np.intp),
        step=steps,
        cause=order[steps] if len(rows) else steps,
        depth_mm=depth,
        last_mm=np.array([row[3] for row in rows], float),
        trouble=float((weight * (1 + np.minimum(depth / DEEP_MM, 1.0))).sum()),
        weakness=weakness,
        squeezed=tuple(order[missing_room > 0].tolist()),
    )


def _missing_room(draft: Draft) -> FloatArray:
    """(n,) weight of each box, in packing order: the sum over the axes x and y along which the box is lowered between
    two others. The weight of an axis is 1 without room to 0 with ``ROOM_MM`` of room."""
    order = list(draft.order)
    low, high = draft.corner_mm[order], (draft.corner_mm + draft.size_mm)[order]
    stands = np.triu(np.ones((len(order), len(order)), bool), k=1)  # the row's box is placed before the column's
    stands &= (high[:, None, 2] > low[None, :, 2] + TOLERANCE_MM) & (low[:, None, 2] < high[None, :, 2] - TOLERANCE_MM)
    missing = np.zeros(len(order))
    for axis, across in ((0, 1), (1, 0)):
        beside = stands & (shared_length(low[:, across], high[:, across]) > TOLERANCE_MM)
        room = np.zeros(len(order))
        for gap in (low[None, :, axis] - high[:, None, axis], low[:, None, axis] - high[None, :, axis]):
            room += np.maximum(np.where(beside & (gap > -TOLERANCE_MM), gap, np.inf).min(axis=0), 0.0)
        missing += np.maximum(1 - room / ROOM_MM, 0.0)
    return missing
