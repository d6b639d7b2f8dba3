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
from petmjx.repairs.drafts import TOLERANCE_MM, BoolArray, Draft, IntArray
from petmjx.world.edge_distances import bearing_in_order, building_loads_of, depends_on_sharing
from petmjx.world.scene import Scene, build_scenes, has_plain_scene, plain_scenes
from petmjx.world.supports import find_bearings

AT_ONCE: Final = 80
"""Number of drafts that are computed at once: their arrays stay in a core's cache."""

DEEP_MM: Final = 50.0
"""A load this far beyond an edge counts twice as much as one on the edge, and a load further beyond counts no more."""

SAFE_MM: Final = 12.0
"""A load this far inside its edges is safe. If a robot places two boxes, the error of their relative place has a
standard deviation of 3 mm (docs/confidence.md). ``SAFE_MM`` is four standard deviations."""

ROOM_MM: Final = 8.0
"""A box that is lowered between two neighbours has enough room if the gap between the neighbours is larger than the box
by at least this length. The errors of the boxes' places and sizes are 3 mm together. If the gap is too narrow, the box
lands on top of a neighbour. Of 24 generated plans that stand without errors, 8 fall in some worlds with errors. In 7 of
these 8 plans, and in none of the others, a box has at most 4 mm of room."""

PERHAPS: Final = 0.5
"""Weight of a load that is beyond an edge under one sharing of loads, but possibly inside under another."""


class Balance(NamedTuple):
    """The loads of one draft that are beyond an edge of their supports at some step of building.

    Attributes:
        box: (k,) numbers of the boxes whose loads are beyond an edge, in order of time.
        step: (k,) position in packing order of the box whose placement moves each load beyond the edge.
        cause: (k,) number of the box at that position.
        depth_mm: (k,) largest distance of each load beyond the edge.
        last_mm: (k,) distance of each load from the edge once all boxes are placed, positive inside.
        trouble: sum of the weights of the loads that are beyond an edge. Each of these loads has a weight of 1 to 2,
            times ``PERHAPS`` if the load may be inside.
        weakness: sum of the weights of what makes the plan fall only with errors. The weight of a load inside
            the edge decreases from 1 on the edge to 0 at ``SAFE_MM`` inside. A box that is lowered between two
            others adds 1 to the sum if it has no room, and less with more room: 0 with ``ROOM_MM`` of room.
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
    size_mm, corner_mm = (
        np.concatenate([getattr(draft, name)[draft.rows] for draft in drafts]) for name in ("size_mm", "corner_mm")
    )
    scenes = _scenes(drafts, sim)
    bearing = bearing_in_order(find_bearings(scenes, [scene.target for scene in scenes]))
    built = building_loads_of(bearing, [scene.n_boxes for scene in scenes])
    perhaps = depends_on_sharing(bearing, built)
    first = bearing.boxes.first
    edge_mm = MM_PER_M * built.edge_m - spare_mm
    rows = np.flatnonzero(~np.isnan(edge_mm))  # a box that floats or overlaps may bear a load although nothing bears it
    loads = _loads(built.box[rows], built.step[rows], edge_mm[rows], perhaps[rows])
    ends = np.searchsorted(loads.box, first)
    return [
        _balance(draft, loads.take(slice(*ends[k : k + 2]), int(first[k])), missing_room)
        for k, (draft, missing_room) in enumerate(zip(drafts, _missing_room(corner_mm, size_mm, first), strict=True))
    ]


def _scenes(drafts: Sequence[Draft], sim: Simulation) -> list[Scene]:
    """The scenes of drafts. To make those of plain drafts from arrays takes a fifth of the time."""
    plans = {id(draft.plan): draft.plan for draft in drafts}
    has_plain = {number: has_plain_scene(plan, sim) for number, plan in plans.items()}
    is_plain = [has_plain[id(draft.plan)] and not draft.sheet_kg for draft in drafts]
    plain = [draft for draft, plain in zip(drafts, is_plain, strict=True) if plain]
    columns = ([getattr(draft, name)[draft.rows] for draft in plain] for name in ("size_mm", "corner_mm", "mass_kg"))
    counts = [len(draft.rows) for draft in plain]
    of_plain = plain_scenes(*map(np.concatenate, columns), counts, sim) if plain else iter(())
    others = build_scenes((draft.as_plan() for draft, plain in zip(drafts, is_plain, strict=True) if not plain), sim)
    return [next(of_plain if plain else others) for plain in is_plain]


class _Loads(NamedTuple):
    """The loads of all boxes of several drafts while these are built, one row for each box. Boxes and steps count on
    over all drafts.

    Attributes:
        box: (k,) the boxes, sorted.
        step: (k,) first step at which the load is beyond an edge; some step if it is always inside.
        least_mm, last_mm: (k,) smallest and last distance from the edge, mm; negative beyond.
        is_sure: (k,) whether the load is beyond an edge however supports share the loads on them.
    """

    box: IntArray
    step: IntArray
    least_mm: FloatArray
    last_mm: FloatArray
    is_sure: BoolArray

    def take(self, rows: slice, first: int) -> _Loads:
        """Some rows, with boxes and steps that are counted from ``first``."""
        box, step = self.box[rows] - first, self.step[rows] - first
        return _Loads(box, step, self.least_mm[rows], self.last_mm[rows], self.is_sure[rows])


def _loads(box: IntArray, step: IntArray, edge_mm: FloatArray, perhaps: BoolArray) -> _Loads:
    """The loads from their distances from edges at all steps, sorted by box and step."""
    begins = np.flatnonzero(np.diff(box, prepend=-1))
    if not len(begins):
        return _Loads(box, step, edge_mm, edge_mm, perhaps)
    ends = np.append(begins[1:], len(box))
    beyond = edge_mm < 0
    first_beyond = np.minimum.reduceat(np.where(beyond, np.arange(len(box)), len(box) - 1), begins)
    return _Loads(
        box[begins],
        step[first_beyond],
        np.minimum.reduceat(edge_mm, begins),
        edge_mm[ends - 1],
        np.logical_or.reduceat(beyond & ~perhaps, begins),
    )


def _balance(draft: Draft, loads: _Loads, missing_room: FloatArray) -> Balance:
    """The balance of a draft from its loads. ``missing_room``: (n,) as from ``_missing_room``."""
    order = draft.rows
    beyond = loads.least_mm < 0
    weakness = float(missing_room.sum())
    for edge_mm in loads.least_mm[~beyond & (loads.least_mm < SAFE_MM)].tolist():
        weakness += 1 - edge_mm / SAFE_MM
    rows = np.flatnonzero(beyond)
    rows = rows[np.lexsort((order[loads.box[rows]], loads.step[rows]))]
    depth_mm, steps = -loads.least_mm[rows], loads.step[rows].astype(np.intp)
    weight = np.where(loads.is_sure[rows], 1.0, PERHAPS)
    return Balance(
        box=order[loads.box[rows]].astype(np.intp),
        step=steps,
        cause=order[steps].astype(np.intp),
        depth_mm=depth_mm,
        last_mm=loads.last_mm[rows],
        trouble=float((weight * (1 + np.minimum(depth_mm / DEEP_MM, 1.0))).sum()),
        weakness=weakness,
        squeezed=tuple(order[missing_room > 0].tolist()),
    )


def _missing_room(corner_mm: FloatArray, size_mm: FloatArray, first: IntArray) -> list[FloatArray]:
    """For each draft, (n,) weight of each box, in packing order: the sum over the axes x and y along which the box is
    lowered between two others. The weight of an axis is 1 without room to 0 with ``ROOM_MM`` of room.

    Args:
        corner_mm, size_mm: corners and extents of the boxes of all drafts, in packing order, draft after draft.
        first: (d + 1,) row of the first box of each draft.
    """
    counts, results = np.diff(first), dict[int, FloatArray]()
    for n in np.unique(counts).tolist():
        numbers = np.flatnonzero(counts == n)
        rows = first[numbers, None] + np.arange(n)
        low = corner_mm[rows]
        results |= dict(zip(numbers.tolist(), _missing(low, low + size_mm[rows]), strict=True))
    return [results[k] for k in range(len(counts))]


def _missing(low: FloatArray, high: FloatArray) -> FloatArray:
    """(c, n) weights as in ``_missing_room``, for boxes with these (c, n, 3) corners, mm."""
    n = low.shape[1]
    before = np.triu(np.ones((n, n), bool), k=1)  # the row's box is placed before the column's
    stands = before & (high[:, :, None, 2] > low[:, None, :, 2] + TOLERANCE_MM)
    stands &= low[:, :, None, 2] < high[:, None, :, 2] - TOLERANCE_MM
    pairs = np.flatnonzero(stands)
    stood, lowered = pairs // n, pairs // n**2 * n + pairs % n  # boxes are numbered over all drafts
    ends = [
        [ends.take(boxes) for boxes in (stood, lowered) for ends in (low[..., axis].ravel(), high[..., axis].ravel())]
        for axis in (0, 1)
    ]
    shared = [np.minimum(end, own_end) - np.maximum(begin, own_begin) for begin, end, own_begin, own_end in ends]
    missing = np.zeros(low.shape[:2])
    for (begin, end, own_begin, own_end), across in zip(ends, reversed(shared), strict=True):
        room = np.zeros(low.shape[:2])
        for gap in (own_begin - end, begin - own_end):
            beside = np.flatnonzero((across > TOLERANCE_MM) & (gap > -TOLERANCE_MM))
            nearest = np.full(low.shape[:2], np.inf)
            np.minimum.at(nearest.ravel(), lowered[beside], gap[beside])
            room += np.maximum(nearest, 0.0)
        missing += np.maximum(1 - room / ROOM_MM, 0.0)
    return missing
