"""Limits that all changed plans keep (``Rules``).

A layout has a fault if boxes overlap, float when they are placed, reach beyond the carrier, or would be placed under a
box that already stands. A draft is allowed if none of its faults is worse than in the plan. So a plan with such faults
can be repaired step by step, but no fault ever becomes worse. A box that is moved aside or turned must not end inside a
wall.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.options.carriers import extent_m
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.repairs.drafts import TOLERANCE_MM, BoolArray, Draft, IntArray
from petmjx.world.carrier_boards import has_walls
from petmjx.world.scene import carrier_of

_ROUNDING_MM: Final = 1e-6
"""A fault counts as worse than in the plan only if it is larger by more than this length, mm, because sums of lengths
have rounding errors."""


class Oddities(NamedTuple):
    """Faults of r boxes in the layouts of drafts. A pair is one of the r boxes and another box of its draft that covers
    a part of the same area, seen from above.

    Attributes:
        row, other: (k,) the pairs: the position of one box among the r boxes, and the number of the other box in the
            draft.
        overlap_mm: (k,) depth by which the two overlap, along the axis of least depth; zero or negative: no overlap.
        blocks: (k,) whether the box is above the place of the other box, and is placed before the other box.
        is_blocked: (k,) whether the other box is above the place of the box, and is placed before the box.
        gap_mm: (r,) height of the box above its support when it is placed.
        outside_mm: (r,) distance by which the box reaches beyond the limits of ``Rules``. Upwards, the limit is the
            largest height. Sideways, the limits are the carrier's edges; if boxes of the plan reach beyond an edge, the
            outermost sides of these boxes are the limits instead.
        through_mm: (r,) depth by which the box reaches through a wall of the carrier.
    """

    row: IntArray
    other: IntArray
    overlap_mm: FloatArray
    blocks: BoolArray
    is_blocked: BoolArray
    gap_mm: FloatArray
    outside_mm: FloatArray
    through_mm: FloatArray


class Places(NamedTuple):
    """k alternatives for the places of b boxes of a draft.

    Attributes:
        boxes: (k, b) numbers of the boxes.
        corner_mm, size_mm: (k, b, 3) corners and extents of the boxes, mm.
        turned: (k, b) whether the boxes are turned by 90° from their orientations in the plan.
        rank: (k, b) numbers that give the boxes' positions in packing order: a box is placed before all boxes of the
            draft with larger numbers (``Draft.rank``).
    """

    boxes: IntArray
    corner_mm: FloatArray
    size_mm: FloatArray
    turned: BoolArray
    rank: FloatArray


class _Limits(NamedTuple):
    """The largest faults that m boxes may have: those of the plan, or the tolerances if these are larger.

    Attributes:
        overlap_mm: (m, m) depth by which two boxes may overlap.
        gap_mm, through_mm: (m,) as in ``Oddities``.
        blocked: (m, m) whether the row's box may be placed before the column's box, although the row's box is above the
            place of the column's box.
    """

    overlap_mm: FloatArray
    gap_mm: FloatArray
    through_mm: FloatArray
    blocked: BoolArray


class _Layouts(NamedTuple):
    """The layouts of c drafts with m boxes each.

    Attributes:
        low, high: (3, c, m) lower and upper ends of the boxes along x, y and z, mm.
        rank: (c, m) positions in packing order; infinite if the box is left out.
        turned: (c, m) whether boxes are turned from their orientation in the plan.
    """

    low: FloatArray
    high: FloatArray
    rank: FloatArray
    turned: BoolArray

    @classmethod
    def of(cls, drafts: Sequence[Draft]) -> _Layouts:
        low = np.stack([draft.corner_mm for draft in drafts])
        high = low + np.stack([draft.size_mm for draft in drafts])
        # one draft for each packing order, since the order determines the rank
        with_order = {id(draft.order): draft for draft in drafts}
        rank = np.stack([with_order[id(draft.order)].rank for draft in drafts])
        return cls.between(low, high, rank, np.stack([draft.turned for draft in drafts]))

    @classmethod
    def between(cls, low: FloatArray, high: FloatArray, rank: FloatArray, turned: BoolArray) -> _Layouts:
        """The layouts of boxes with these (c, m, 3) corners."""
        low, high = (np.ascontiguousarray(np.moveaxis(corners, 2, 0)) for corners in (low, high))
        return cls(low, high, rank, turned)

    @property
    def is_placed(self) -> BoolArray:
        """(c, m) whether each box is placed."""
        return np.isfinite(self.rank)

    def flat(self, number: IntArray, box: IntArray) -> IntArray:
        """Numbers of boxes over all drafts, for flat arrays: with one index instead of two, NumPy takes half the time.
        ``number``: number of each box's draft. ``box``: number of each box in its draft."""
        numbers: IntArray = number * self.rank.shape[1] + box
        return numbers

    def beside(self, number: IntArray, box: IntArray) -> tuple[IntArray, IntArray]:
        """The k pairs of ``Oddities`` for r boxes, as the (k,) arrays ``row`` and ``other``. ``number``: (r,) number of
        each box's draft. ``box``: (r,) number of each box in its draft."""
        pairs = self.is_placed[number]
        pairs[np.arange(len(number)), box] = False
        for low, high in zip(self.low[:2], self.high[:2], strict=True):
            ends, begins = high[number, box, None], low[number, box, None]
            of_draft = high.take(number, axis=0), low.take(number, axis=0)
            pairs &= np.minimum(of_draft[0], ends) - np.maximum(of_draft[1], begins) > TOLERANCE_MM
        row, other = np.divmod(np.flatnonzero(pairs), max(pairs.shape[1], 1))
        return row, other


class Rules:
    """Limits of a changed plan.

    Args:
        plan: the plan before the changes.
        sim: options of the simulation. Boxes may overhang the carrier's edges as far as boxes of the plan do.
        max_height_mm: highest top of a box; the plan's own height if that is greater.
        built: number of boxes that stand on the real pallet already: the first boxes of the plan. These boxes stay
            unchanged.
    """

    def __init__(self, plan: Plan, sim: Simulation, max_height_mm: float, built: int) -> None:
        low, high = plan.corner_mm.min(axis=0), (plan.corner_mm + plan.size_mm).max(axis=0)
        extent = extent_m(sim.carrier)
        if extent is not None:
            low[:2] = np.minimum(low[:2], 0.0)
            high[:2] = np.maximum(high[:2], np.array(extent) * MM_PER_M)
        self.low_mm, self.high_mm = np.minimum(low, [np.inf, np.inf, 0.0]), high
        self.high_mm[2] = max(high[2], max_height_mm)
        self.built = built
        self.plan = plan
        self._room = carrier_of(plan, sim).room if has_walls(sim) else None
        rows = np.arange(plan.n_boxes)
        self._limits_of: dict[int, _Limits] = {}
        self._last_bears: tuple[Draft, BoolArray] | None = None
        self._before = self._oddities(_Layouts.of([Draft.of(plan)]), np.zeros_like(rows), rows)

    @property
    def height_mm(self) -> float:
        """Height of the highest top of the plan, mm."""
        return float((self.plan.corner_mm + self.plan.size_mm)[:, 2].max())

    @property
    def floating(self) -> list[int]:
        """Numbers of the boxes of the plan that have no support when they are placed."""
        return np.flatnonzero(self._before.gap_mm > TOLERANCE_MM).tolist()

    @property
    def overlapping(self) -> list[int]:
        """Numbers of the boxes of the plan that overlap a box with a smaller number."""
        before = self._before
        later = before.other[(before.overlap_mm > TOLERANCE_MM) & (before.row < before.other)]
        return list(dict.fromkeys(later.tolist()))

    def allow(
        self,
        drafts: Sequence[Draft],
        changed: Sequence[Collection[int]] | None = None,
        parent: Draft | None = None,
    ) -> BoolArray:
        """(c,) which drafts are allowed.

        Most changes concern few boxes. Boxes that no change concerns need not be checked again.

        Args:
            changed: for each draft, the boxes that differ from an allowed draft in place, turn or position in the
                packing order. All other boxes must have the same places as in the allowed draft, and the same order
                relative to each other. None: every box is checked.
            parent: the allowed draft from which the drafts were made. It is needed if changed boxes may have been
                supports of other boxes in this draft. None means that no changed box was a support. If a draft has one
                sheet more than ``parent``, all its boxes are checked.
        """
        allowed = np.zeros(len(drafts), bool)
        sizes: dict[int, list[int]] = {}
        for number, draft in enumerate(drafts):
            sizes.setdefault(len(draft.size_mm), []).append(number)
        for size, numbers in sizes.items():
            is_whole = changed is None or (parent is not None and size != len(parent.size_mm))
            bears = None if is_whole or parent is None else self._may_bear(parent)
            for begin in range(0, len(numbers), AT_ONCE):
                chunk = numbers[begin : begin + AT_ONCE]
                boxes = None if is_whole or changed is None else [changed[number] for number in chunk]
                allowed[chunk] = self._allow([drafts[number] for number in chunk], boxes, bears)
        return allowed

    def have_room(self, draft: Draft, boxes: list[int], ways_mm: Sequence[tuple[float, float]]) -> BoolArray:
        """(w,) for each of several moves along x and y: whether boxes of an allowed draft can make the move together
        without overlapping other boxes, and without reaching farther beyond the carrier's edges than allowed. If the
        boxes cannot make a move, the draft with this move is not allowed."""
        ways = np.array(ways_mm).reshape(-1, 1, 2)
        is_other, moved = np.isfinite(draft.rank), np.array(boxes)
        is_other[moved] = False
        others = np.flatnonzero(is_other)
        low, high = draft.corner_mm, draft.high_mm
        shared_z = np.minimum.outer(high[moved, 2], high[others, 2])
        shared_z -= np.maximum.outer(low[moved, 2], low[others, 2])
        most_mm = self._limits(len(low)).overlap_mm[moved[:, None], others]
        at, beside = np.nonzero(shared_z > most_mm)  # only boxes that share some height can overlap too far
        begin, low_end, high_end = low[moved, :2] + ways, low[others[beside], :2], high[others[beside], :2]
        end = begin + draft.size_mm[moved, :2]
        shared = np.minimum(end[:, at], high_end) - np.maximum(begin[:, at], low_end)
        hits = (shared.min(axis=2) > most_mm[at, beside]).any(axis=1)
        outside = np.maximum(self.low_mm[:2] - begin, end - self.high_mm[:2]) > TOLERANCE_MM
        return np.asarray(~hits & ~outside.any(axis=(1, 2)))

    def allow_places(self, draft: Draft, places: Places) -> BoolArray:
        """(k,) whether drafts are allowed, if they differ from an allowed draft only in the places of some boxes. No
        ``Draft`` object is made for each of the places, so this check takes a fraction of the time that ``allow``
        takes. It is not checked whether boxes that are already built stay unchanged."""
        k = len(places.boxes)
        if not k:
            return np.zeros(0, bool)
        rows = np.arange(k)[:, None]
        low, size = np.tile(draft.corner_mm, (k, 1, 1)), np.tile(draft.size_mm, (k, 1, 1))
        turned, rank = np.tile(draft.turned, (k, 1)), np.tile(draft.rank, (k, 1))
        low[rows, places.boxes], size[rows, places.boxes] = places.corner_mm, places.size_mm
        turned[rows, places.boxes], rank[rows, places.boxes] = places.turned, places.rank
        is_changed = np.zeros(rank.shape, bool)
        is_changed[rows, places.boxes] = True
        return self._keeps_rules(_Layouts.between(low, low + size, rank, turned), is_changed, self._may_bear(draft))

    def _allow(
        self, drafts: Sequence[Draft], changed: Sequence[Collection[int]] | None, bears: BoolArray | None
    ) -> BoolArray:
        """``allow`` for drafts with the same number of rows. ``bears``: the result of ``_may_bear`` for the parent of
        the drafts."""
        layouts = _Layouts.of(drafts)
        is_changed = np.ones(layouts.rank.shape, bool)
        if changed is not None:
            is_changed[:] = False
            counts = [len(boxes) for boxes in changed]
            is_changed[np.repeat(np.arange(len(drafts)), counts), [box for boxes in changed for box in boxes]] = True
        allowed = self._keeps_rules(layouts, is_changed, bears)
        if self.built:
            allowed &= [self._keeps_built(draft) for draft in drafts]
        return allowed

    def _keeps_rules(self, layouts: _Layouts, is_changed: BoolArray, bears: BoolArray | None) -> BoolArray:
        """(c,) which layouts are allowed, without regard to built boxes.

        Args:
            is_changed: (c, m) the boxes that are checked.
            bears: the result of ``_may_bear`` for the draft from which the layouts were made; None: only the boxes
                ``is_changed`` are checked.
        """
        is_placed, limits = layouts.is_placed, self._limits(layouts.rank.shape[1])
        number, box = np.nonzero(is_changed & is_placed)
        odd = self._oddities(layouts, number, box)
        own, m = box[odd.row], len(limits.gap_mm)
        of_pair = own * m + odd.other  # with one index instead of two, NumPy takes half the time
        is_odd = odd.overlap_mm > limits.overlap_mm.take(of_pair)
        is_odd |= odd.blocks & ~limits.blocked.take(of_pair)
        is_odd |= odd.is_blocked & ~limits.blocked.take(odd.other * m + own)
        worse = (odd.gap_mm > limits.gap_mm[box]) | (odd.outside_mm > TOLERANCE_MM)
        if self._room is not None:
            worse |= odd.through_mm > limits.through_mm[box]
            worse |= self._shifted(layouts)[number, box] & (odd.through_mm > TOLERANCE_MM)
        worse[odd.row[is_odd]] = True
        allowed = np.ones(len(layouts.rank), bool)
        allowed[number[worse]] = False
        if bears is not None:  # other boxes may have lost their supports
            lost = (is_changed @ bears) & is_placed & ~is_changed & allowed[:, None]
            number, box = np.nonzero(lost)
            row, other = layouts.beside(number, box)
            gaps_mm = _gaps_mm(layouts, layouts.flat(number, box), layouts.flat(number[row], other), row)
            allowed[number[gaps_mm > limits.gap_mm[box]]] = False
        return allowed

    def _limits(self, m: int) -> _Limits:
        """The largest faults that the boxes of a draft with m rows are allowed to have."""
        if m in self._limits_of:
            return self._limits_of[m]
        n, before = self.plan.n_boxes, self._before
        overlap_mm, blocked = np.full((m, m), TOLERANCE_MM), np.zeros((m, m), bool)
        np.maximum.at(overlap_mm, (before.row, before.other), before.overlap_mm + _ROUNDING_MM)
        blocked[before.row[before.blocks], before.other[before.blocks]] = True
        gap_mm, through_mm = np.full((2, m), TOLERANCE_MM)
        np.maximum(gap_mm[:n], before.gap_mm + _ROUNDING_MM, out=gap_mm[:n])
        np.maximum(through_mm[:n], before.through_mm + _ROUNDING_MM, out=through_mm[:n])
        self._limits_of[m] = _Limits(overlap_mm, gap_mm, through_mm, blocked)
        return self._limits_of[m]

    def _may_bear(self, draft: Draft) -> BoolArray:
        """(m, m) whether the column's box may float without the row's box, because the top of the row's box is close
        below the column's box. The result for the last draft is kept for the next call."""
        if self._last_bears is None or self._last_bears[0] is not draft:
            self._last_bears = draft, self._bears_closely(draft)
        return self._last_bears[1]

    def _bears_closely(self, draft: Draft) -> BoolArray:
        """The result of ``_may_bear``, computed anew."""
        layouts, rows = _Layouts.of([draft]), draft.rows
        row, other = layouts.beside(np.zeros_like(rows), rows)
        box = rows[row]
        m = len(draft.size_mm)
        top = (draft.corner_mm + draft.size_mm)[other, 2]
        is_near = top >= draft.corner_mm[box, 2] - self._limits(m).gap_mm[box] - TOLERANCE_MM
        bears = np.zeros((m, m), bool)
        bears[other[is_near], box[is_near]] = True
        return bears

    def _shifted(self, layouts: _Layouts) -> BoolArray:
        """(c, m) whether each box of the plan is moved along x or y, or turned. Added sheets count as not moved."""
        n = self.plan.n_boxes
        shifted = layouts.turned.copy()
        for low, planned in zip(layouts.low[:2], self.plan.corner_mm.T, strict=False):
            shifted[:, :n] |= low[:, :n] != planned
        return shifted

    def _keeps_built(self, draft: Draft) -> bool:
        """Whether the first ``built`` boxes of the plan have the same places, turns and order as in the plan."""
        k = self.built
        return draft.order[:k] == tuple(range(k)) and bool(
            (draft.corner_mm[:k] == self.plan.corner_mm[:k]).all() and not draft.turned[:k].any()
        )

    def _oddities(self, layouts: _Layouts, number: IntArray, box: IntArray) -> Oddities:
        """The faults of r boxes. ``number``: (r,) number of each box's draft. ``box``: (r,) number of each box in its
        draft."""
        row, other = layouts.beside(number, box)
        at, at_other = layouts.flat(number, box), layouts.flat(number[row], other)
        low, high = layouts.low.reshape(3, -1), layouts.high.reshape(3, -1)
        own_low, own_high, own_rank = low.take(at, axis=1), high.take(at, axis=1), layouts.rank.take(at)
        other_low = low.take(at_other, axis=1)
        overlap = np.minimum(own_high.take(row, axis=1), high.take(at_other, axis=1))
        overlap -= np.maximum(own_low.take(row, axis=1), other_low)
        earlier = layouts.rank.take(at_other) < own_rank.take(row)
        z, other_z = own_low[2].take(row), other_low[2]
        own_low, own_high = own_low.T, own_high.T
        outside = np.maximum(self.low_mm - own_low, own_high - self.high_mm).max(axis=1)
        return Oddities(
            row,
            other,
            overlap.min(axis=0),
            ~earlier & (z > other_z + TOLERANCE_MM),
            earlier & (other_z > z + TOLERANCE_MM),
            _gaps_mm(layouts, at, at_other, row),
            outside,
            self._through_mm(own_low, own_high),
        )

    def _through_mm(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """(r,) depths ``through_mm`` as in ``Oddities``, for boxes with these (r, 3) corners."""
        if self._room is None:
            return np.zeros(len(low))
        middle_m, half_m = (low + high) / 2 / MM_PER_M, (high - low) / 2 / MM_PER_M
        depth_mm = MM_PER_M * self._room.depths(middle_m, half_m, TOLERANCE_MM / MM_PER_M)
        return np.asarray(depth_mm.max(axis=(1, 2)))


AT_ONCE: Final = 256
"""Number of drafts whose layouts are computed at once."""


def _gaps_mm(layouts: _Layouts, at: IntArray, at_other: IntArray, row: IntArray) -> FloatArray:
    """(r,) height of each of r boxes above its support when it is placed.

    Args:
        at: (r,) numbers of the boxes over all drafts (``_Layouts.flat``).
        at_other: (k,) numbers of the boxes beside them.
        row: (k,) for each box of ``at_other``, the position in ``at`` of the box that it is beside.
    """
    bottom, low = layouts.low[2].take(at), layouts.low[2].take(at_other)
    bears = (layouts.rank.take(at_other) < layouts.rank.take(at)[row]) & (low < bottom[row])
    support = np.zeros(len(at))
    np.maximum.at(support, row[bears], layouts.high[2].take(at_other[bears]))
    gaps_mm: FloatArray = np.maximum(bottom - support, 0.0)
    return gaps_mm
