"""Checks drafts of plans by statics: finds, for each step at which a box is placed, the boxes whose load acts beyond
the edge of their supports, and measures how harmful these loads are. The load of a box is its weight and all forces on
its top.

The computation of a draft's balance takes a fifth of a millisecond, and a simulation takes a tenth of a second or more.
So the balance tells which of many changes are worth a simulation. The balance never decides whether a plan stands: a
box whose load is beyond an edge may lean on a neighbour, and stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.simulation import Simulation
from petmjx.repairs.drafts import TOLERANCE_MM, BoolArray, Draft, IntArray, equal_placements
from petmjx.world.balanced_loads import ROUNDING_M
from petmjx.world.bearings import Bearing
from petmjx.world.building_edges import bearing_in_order, building_loads_of, depends_on_sharing
from petmjx.world.scene import build_scenes, has_plain_scene
from petmjx.world.supports import find_bearings, find_plain_bearings

AT_ONCE: Final = 128
"""Number of drafts whose balances are computed at once."""

LARGE: Final = 80
"""Plans with at least this number of boxes are large. A draft of a large plan begins with the same placements as the
draft from which it was made, and takes over the loads after these placements. To take loads over, instead of computing
them, takes 13 % more time for plans of 15 to 50 boxes, and 30 % less time for plans of 168 boxes."""

DEEP_MM: Final = 50.0
"""The weight of a load in ``Balance.trouble`` is 1 if the load acts on the edge of its supports, and increases to 2 at
this distance beyond the edge, mm. Further beyond the edge, the weight stays 2."""

SAFE_MM: Final = 12.0
"""A load is safe if it is inside the edges of its supports by at least this distance, mm. If a robot places two boxes,
the error of their relative place has a standard deviation of 3 mm (docs/confidence.md). ``SAFE_MM`` is four standard
deviations of the relative place of two boxes."""

ROOM_MM: Final = 8.0
"""A box that is lowered between two neighbours has enough room if the gap between the neighbours is larger than the box
by at least this length. The errors of the places and sizes of two boxes together have a standard deviation of 3 mm. If
the gap is too narrow, the box lands on top of a neighbour. Of 24 generated plans that stand without errors, 8 fall in
some worlds with errors. In 7 of these 8 plans, and in none of the 16 other plans, a box has at most 4 mm of room."""

PERHAPS: Final = 0.5
"""Factor on the weight of a load in ``Balance.trouble`` if it is uncertain whether the load is beyond an edge, because
this depends on how the supports share loads."""


class Balance(NamedTuple):
    """The loads of one draft that are beyond an edge of their supports at some step of building.

    Attributes:
        box: (k,) numbers of the boxes whose loads are beyond an edge, in order of time.
        step: (k,) position in packing order of the box whose placement moves each load beyond the edge.
        cause: (k,) number of the box whose placement moves each load beyond the edge.
        depth_mm: (k,) largest distance of each load beyond the edge.
        weight: (k,) weight of each load in ``trouble``: 1 to 2, times ``PERHAPS`` if the load may be inside the edge.
        last_mm: (k,) distance of each load from the edge once all boxes are placed, positive inside.
        trouble: sum of the weights of the loads that are beyond an edge.
        weakness: a number for the risk that the plan falls with errors, as a sum over loads and boxes. A load that is
            not beyond its edge adds a number that decreases from 1 on the edge to 0 at ``SAFE_MM`` inside the edge. A
            box that is lowered between two other boxes adds 1 to the risk if it has no room, and less with more room: 0
            with ``ROOM_MM`` of room.
        order: numbers of the boxes in packing order.
        loads: the loads of all boxes; None if ``balances`` was called without ``with_loads``. ``balances_with_last``
            computes from ``loads`` the loads of a draft with one more box.
        missing_room: (n,) part of ``weakness`` that each box contributes because it is lowered between two other boxes.
    """

    box: IntArray
    step: IntArray
    cause: IntArray
    depth_mm: FloatArray
    weight: FloatArray
    last_mm: FloatArray
    trouble: float
    weakness: float
    order: IntArray
    loads: _Loads | None
    missing_room: FloatArray

    @property
    def squeezed(self) -> tuple[int, ...]:
        """Numbers of the boxes that are lowered between two others with less room than ``ROOM_MM``."""
        squeezed: tuple[int, ...] = tuple(self.order[self.missing_room > 0].tolist())
        return squeezed

    def depth_of(self, box: int) -> float:
        """Distance of a box's load beyond an edge, mm; 0 if the load is never beyond an edge."""
        rows = np.flatnonzero(self.box == box)
        return float(self.depth_mm[rows[0]]) if len(rows) else 0.0


def balances(
    drafts: Sequence[Draft],
    sim: Simulation,
    *,
    spare_mm: float = 0.0,
    with_loads: bool = False,
    parent: Draft | None = None,
) -> list[Balance]:
    """The balance of each draft.

    Args:
        spare_mm: a load that is inside an edge, but nearer to the edge than this distance, mm, also counts as beyond
            the edge.
        with_loads: whether the results have the loads of all boxes (``Balance.loads``).
        parent: a draft with the same first placements as many of the drafts. The loads after these placements are
            computed only once, which takes a fraction of the time for large plans. The results may differ by rounding
            errors.
    """
    results: list[Balance] = []
    is_plain = are_plain(drafts, sim)
    if len({*is_plain}) == 2:  # not all drafts are equally plain: for example, only some have sheets
        parts = [[k for k, plain in enumerate(is_plain) if plain is one] for one in (True, False)]
        of_parts = [
            balances([drafts[k] for k in part], sim, spare_mm=spare_mm, with_loads=with_loads, parent=parent)
            for part in parts
        ]
        of_number = dict(zip(chain(*parts), chain(*of_parts), strict=True))
        return [of_number[k] for k in range(len(drafts))]
    known = None
    if parent is not None and len(parent.order) >= LARGE and all(is_plain) and all(are_plain([parent], sim)):
        known = parent, _Building.of([parent], sim, spare_mm)
    for begin in range(0, len(drafts), AT_ONCE):
        some = drafts[begin : begin + AT_ONCE]
        if known is None:
            built = _Building.of(some, sim, spare_mm)
            loads, first = built.loads(), built.first
        else:
            loads, first = _loads_after(some, *known, sim, spare_mm)
        results += _balances(some, loads, _missing_room(some), first, with_loads=with_loads)
    return results


def balances_with_last(drafts: Sequence[Draft], before: Sequence[Balance], sim: Simulation) -> list[Balance]:
    """The balance of each draft. ``before``: for each draft, the balance of the draft without its last box, with
    ``loads``. The last box changes only the loads below it, and each of these loads only once. So this function takes a
    fraction of the time of ``balances``. The results of the two functions may differ by rounding errors."""
    results: list[Balance] = []
    for begin in range(0, len(drafts), AT_ONCE):
        some, known = drafts[begin : begin + AT_ONCE], before[begin : begin + AT_ONCE]
        bearing = _bearing(some, sim)
        first = bearing.boxes.first
        known_loads = [one.loads for one in known if one.loads is not None]
        loads = _loads_with_last(bearing, _Loads.joined(known_loads, first))
        missing = [
            np.append(one.missing_room, weight)
            for one, weight in zip(known, _missing_room(some, only_last=True), strict=True)
        ]
        results += _balances(some, loads, missing, first, with_loads=True)
    return results


def _bearing(drafts: Sequence[Draft], sim: Simulation) -> Bearing:
    """The contacts between the boxes of drafts. The boxes are in packing order."""
    if not all(are_plain(drafts, sim)):
        scenes = [*build_scenes((draft.as_plan() for draft in drafts), sim)]
        return bearing_in_order(find_bearings(scenes, [scene.target for scene in scenes]))
    return bearing_in_order(find_plain_bearings(*arrays_of(drafts), sim))


def arrays_of(drafts: Sequence[Draft]) -> tuple[FloatArray, FloatArray, FloatArray, list[int]]:
    """(n, 3) extents and (n, 3) corners of the boxes of all drafts, mm, draft after draft and in packing order; (n,)
    masses of these boxes, kg; and the number of boxes of each draft."""
    size_mm, corner_mm, mass_kg = (
        np.concatenate([getattr(draft, name).take(draft.rows, axis=0) for draft in drafts])
        for name in ("size_mm", "corner_mm", "mass_kg")
    )
    return size_mm, corner_mm, mass_kg, [len(draft.rows) for draft in drafts]


def are_plain(drafts: Sequence[Draft], sim: Simulation) -> list[bool]:
    """For each draft, whether its scene or its contacts can be made from arrays (``has_plain_scene``)."""
    plans = {id(draft.plan): draft.plan for draft in drafts}
    has_plain = {number: has_plain_scene(plan, sim) for number, plan in plans.items()}
    return [has_plain[id(draft.plan)] and not draft.sheet_kg for draft in drafts]


def _balances(
    drafts: Sequence[Draft], loads: _Loads, missing_room: Sequence[FloatArray], first: IntArray, *, with_loads: bool
) -> list[Balance]:
    """The balances of d drafts from their loads. ``first``: (d + 1,) number of the first box of each draft, and at the
    end the number of all boxes."""
    order = np.concatenate([draft.rows for draft in drafts])
    rows = (loads.least_mm < 0).nonzero()[0]
    # steps are numbered over all drafts, so drafts stay in order
    rows = rows[np.lexsort((order[loads.box[rows]], loads.step[rows]))]
    depth_mm, steps = -loads.least_mm[rows], loads.step[rows].astype(np.intp)
    weight = np.where(loads.is_sure[rows], 1.0, PERHAPS) * (1 + np.minimum(depth_mm / DEEP_MM, 1.0))
    box, cause, last_mm = order[loads.box[rows]], order[steps], loads.last_mm[rows]
    near = ((loads.least_mm >= 0) & (loads.least_mm < SAFE_MM)).nonzero()[0]
    nearness = (1 - loads.least_mm[near] / SAFE_MM).tolist()
    ends, beyond_ends, near_ends = (
        np.searchsorted(sorted_numbers, first).tolist() for sorted_numbers in (loads.box, steps, loads.box[near])
    )
    results = []
    for k, begin in enumerate(first[:-1].tolist()):
        some = slice(beyond_ends[k], beyond_ends[k + 1])
        results.append(
            Balance(
                box=box[some],
                step=steps[some] - begin,
                cause=cause[some],
                depth_mm=depth_mm[some],
                weight=weight[some],
                last_mm=last_mm[some],
                trouble=float(weight[some].sum()),
                weakness=sum(nearness[near_ends[k] : near_ends[k + 1]], float(missing_room[k].sum())),
                order=drafts[k].rows,
                loads=loads.take(slice(ends[k], ends[k + 1]), begin) if with_loads else None,
                missing_room=missing_room[k],
            )
        )
    return results


class _Loads(NamedTuple):
    """The loads of all boxes of several drafts while the drafts are built, one row for each box. Boxes and steps are
    numbered over all drafts: the numbers of a draft follow those of the draft before it.

    Attributes:
        box: (k,) numbers of the boxes, ascending.
        step: (k,) first step at which the load is beyond an edge; without meaning if the load is never beyond an edge.
        least_mm, last_mm: (k,) smallest distance of the load from the edge over all steps, and the distance at the last
            step, mm; negative beyond the edge.
        is_sure: (k,) whether the load is beyond an edge at some step, however the supports share loads.
        perhaps: (k,) whether the load at the last step depends on how the supports share loads.
    """

    box: IntArray
    step: IntArray
    least_mm: FloatArray
    last_mm: FloatArray
    is_sure: BoolArray
    perhaps: BoolArray

    def take(self, rows: slice, first: int) -> _Loads:
        """The given rows of the loads. In the result, ``first`` is subtracted from the numbers of boxes and steps."""
        box, step, *others = (values[rows] for values in self)
        return _Loads._make((box - first, step - first, *others))

    @classmethod
    def joined(cls, some: Sequence[_Loads], first: IntArray) -> _Loads:
        """The loads of several drafts in one record. ``first[k]`` is added to the numbers of boxes and steps of draft
        k."""
        begin = np.repeat(first[:-1], [len(loads.box) for loads in some])
        joined = cls._make(map(np.concatenate, zip(*some, strict=True)))
        return joined._replace(box=joined.box + begin, step=joined.step + begin)

    def followed_by(self, later: _Loads, n_boxes: int) -> _Loads:
        """The loads after further placements. ``later``: the loads over the further placements alone, for the boxes
        whose loads these placements change. ``n_boxes``: number of the boxes of all drafts."""
        step = np.zeros(n_boxes, np.intp)
        least_mm, last_mm = np.full((2, n_boxes), np.nan)
        is_sure, perhaps = np.zeros((2, n_boxes), bool)
        for loads in (self, later):
            box = loads.box
            is_first = ~(least_mm[box] < 0)
            step[box[is_first]] = loads.step[is_first]
            least_mm[box] = np.fmin(least_mm[box], loads.least_mm)
            last_mm[box] = loads.last_mm
            is_sure[box] |= loads.is_sure
            perhaps[box] |= loads.perhaps
        box = np.flatnonzero(~np.isnan(least_mm))
        return _Loads(box, step[box], least_mm[box], last_mm[box], is_sure[box], perhaps[box])


class _Building(NamedTuple):
    """The loads of drafts after every placement that changes a load. Boxes and steps are numbered over all drafts.

    Attributes:
        first: (d + 1,) number of the first box of each draft, and at the end the number of all boxes.
        box, step: (p,) number of the box that has the load, and number of the box that was placed last; sorted.
        edge_mm: (p,) distance of the load from the edge, mm; negative beyond the edge.
        perhaps: (p,) whether the load depends on how the supports share loads.
    """

    first: IntArray
    box: IntArray
    step: IntArray
    edge_mm: FloatArray
    perhaps: BoolArray

    @classmethod
    def of(
        cls, drafts: Sequence[Draft], sim: Simulation, spare_mm: float, before: Sequence[int] | None = None
    ) -> _Building:
        """The loads of drafts. ``before``: number of first placements of each draft that are left out, as in
        ``building_loads_of``."""
        bearing = _bearing(drafts, sim)
        first = bearing.boxes.first
        built = building_loads_of(bearing, np.diff(first).tolist(), before)
        perhaps = depends_on_sharing(bearing, built)
        edge_mm = MM_PER_M * built.edge_m - spare_mm
        rows = np.flatnonzero(~np.isnan(edge_mm))  # NaN: the box has no supports, so it has no edge
        return cls(first, built.box[rows], built.step[rows], edge_mm[rows], perhaps[rows])

    def loads(self) -> _Loads:
        """One row for each box, from the rows for each box and step."""
        box, step, edge_mm, perhaps = self.box, self.step, self.edge_mm, self.perhaps
        begins = np.flatnonzero(np.diff(box, prepend=-1))
        if not len(begins):
            return _Loads(box, step, edge_mm, edge_mm, perhaps, perhaps)
        ends = np.append(begins[1:], len(box))
        beyond = edge_mm < 0
        last = np.repeat(ends - 1, ends - begins)
        first_beyond = np.minimum.reduceat(np.where(beyond, np.arange(len(box)), last), begins)
        return _Loads(
            box[begins],
            step[first_beyond],
            np.minimum.reduceat(edge_mm, begins),
            edge_mm[ends - 1],
            np.logical_or.reduceat(beyond & ~perhaps, begins),
            perhaps[ends - 1],
        )

    def first_placements(self, count: int) -> _Building:
        """The loads after the first ``count`` placements."""
        rows = np.flatnonzero(self.step < count)
        return self._replace(
            box=self.box[rows], step=self.step[rows], edge_mm=self.edge_mm[rows], perhaps=self.perhaps[rows]
        )


def _loads_after(
    drafts: Sequence[Draft], parent: Draft, known: _Building, sim: Simulation, spare_mm: float
) -> tuple[_Loads, IntArray]:
    """The loads of drafts, and the number of the first box of each draft. ``known``: the loads of the draft ``parent``.
    Loads after the first placements, which are as in ``parent``, are taken from ``known``."""
    counts = equal_placements(drafts, parent)
    of_count = {count: known.first_placements(count).loads() for count in {*counts}}
    built = _Building.of(drafts, sim, spare_mm, counts)
    before = _Loads.joined([of_count[count] for count in counts], built.first)
    depends = np.zeros(built.first[-1], bool)
    depends[before.box] = before.perhaps
    later = built._replace(perhaps=built.perhaps | depends[built.box])
    return before.followed_by(later.loads(), int(built.first[-1])), built.first


def _loads_with_last(bearing: Bearing, before: _Loads) -> _Loads:
    """The loads of several drafts after the last box of each draft has been placed. ``before``: the loads before the
    last boxes were placed."""
    first = bearing.boxes.first
    n, last = int(first[-1]), first[1:] - 1
    is_last = np.zeros(n, bool)
    is_last[last] = True
    below = bearing.all_below(is_last)
    now_mm = MM_PER_M * bearing.edges_m(bearing.loads(np.diff(first).tolist()))
    now_mm[(now_mm < 0) & (now_mm > -MM_PER_M * ROUNDING_M)] = 0.0
    perhaps = below & np.repeat(bearing.n_supports[last] > 1, np.diff(first))
    perhaps[before.box] |= before.perhaps
    box = np.flatnonzero((below | is_last) & ~np.isnan(now_mm))
    now_mm, perhaps = now_mm[box], perhaps[box]
    step = np.repeat(last, np.diff(first))[box]
    return before.followed_by(_Loads(box, step, now_mm, now_mm, (now_mm < 0) & ~perhaps, perhaps), n)


def _missing_room(drafts: Sequence[Draft], *, only_last: bool = False) -> list[FloatArray]:
    """For each draft, (n,) numbers that tell how little room each box has, in packing order. Each of the axes x and y
    along which the box is lowered between two others adds a number from 1 (no room) to 0 (``ROOM_MM`` of room or more).
    With ``only_last``, the number is computed only for the last box, as a (1,) array."""
    results: dict[int, FloatArray] = {}
    for n in {len(draft.order) for draft in drafts}:
        numbers = [k for k, draft in enumerate(drafts) if len(draft.order) == n]
        low = np.stack([drafts[k].corner_mm[drafts[k].rows] for k in numbers])
        high = low + np.stack([drafts[k].size_mm[drafts[k].rows] for k in numbers])
        results |= dict(zip(numbers, _missing(low, high, n - 1 if only_last else 0), strict=True))
    return [results[k] for k in range(len(drafts))]


def _missing(low: FloatArray, high: FloatArray, begin: int) -> FloatArray:
    """(c, n − begin) numbers as in ``_missing_room``, for c drafts of n boxes. ``low``, ``high``: (c, n, 3) corners of
    the boxes, mm. Boxes before the box ``begin`` get no number."""
    n = low.shape[1]
    before = np.triu(np.ones((n, n), bool), k=1)[:, begin:]  # the row's box is placed before the column's box
    stands = before & (high[:, :, None, 2] > low[:, None, begin:, 2] + TOLERANCE_MM)
    stands &= low[:, :, None, 2] < high[:, None, begin:, 2] - TOLERANCE_MM
    stood, lowered = np.divmod(np.flatnonzero(stands), n - begin)
    lowered += stood // n * n + begin  # boxes are numbered over all drafts
    ends = []
    for axis in (0, 1):
        begins_and_ends = low[..., axis].ravel(), high[..., axis].ravel()
        ends.append([values.take(boxes) for boxes in (stood, lowered) for values in begins_and_ends])
    shared = [
        np.minimum(high_end, own_high) - np.maximum(low_end, own_low) for low_end, high_end, own_low, own_high in ends
    ]
    missing = np.zeros((len(low), n - begin))
    for (low_end, high_end, own_low, own_high), across in zip(ends, reversed(shared), strict=True):
        room = np.zeros_like(missing)
        for gap in (own_low - high_end, low_end - own_high):
            beside = np.flatnonzero((across > TOLERANCE_MM) & (gap > -TOLERANCE_MM))
            nearest = np.full(low.shape[:2], np.inf)
            np.minimum.at(nearest.ravel(), lowered[beside], gap[beside])
            room += np.maximum(nearest[:, begin:], 0.0)
        missing += np.maximum(1 - room / ROOM_MM, 0.0)
    return missing
