"""A plan while it is being changed (``Draft``).

A draft keeps the numbers that boxes have in the plan, whatever their order is now. Tie sheets that are added get the
next numbers after those of the boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import KINDS, SHEET
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, meets, shared_length

TOLERANCE_MM: Final = DEFAULT_TOLERANCE_MM
"""Largest gap or overlap, mm, of two boxes that count as touching, as in the warnings about a plan."""

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Draft:
    """A changed plan. The arrays have m rows: one for each of the n boxes of the plan, in the plan's order, then one
    for each added tie sheet.

    Attributes:
        plan: the plan before the changes.
        size_mm, corner_mm: (m, 3) extents and front-left-bottom corners, mm.
        turned: (m,) whether a box is turned by 90° from its orientation in the plan.
        order: numbers of the boxes that are placed, in packing order.
        moved: numbers of the boxes with another place or orientation than in the plan. The plan's directions of
            approach no longer hold for moved boxes.
        sheet_kg: masses of the added tie sheets, kg.
        film_turns: turns of film around the pallet.
    """

    plan: Plan
    size_mm: FloatArray
    corner_mm: FloatArray
    turned: BoolArray
    order: tuple[int, ...]
    moved: frozenset[int] = frozenset()
    sheet_kg: tuple[float, ...] = ()
    film_turns: float = 0.0

    @classmethod
    def of(cls, plan: Plan, film_turns: float = 0.0) -> Draft:
        """The plan without a change."""
        n = plan.n_boxes
        order = tuple(range(n))
        return cls(plan, plan.size_mm, plan.corner_mm, np.zeros(n, bool), order, film_turns=film_turns)

    def is_unchanged(self, film_turns: float) -> bool:
        """Whether the draft is the plan without a change. ``film_turns``: turns of film around the unchanged plan."""
        return self.key == Draft.of(self.plan, film_turns).key

    @cached_property
    def rows(self) -> IntArray:
        """(n,) ``order`` as an array."""
        return np.array(self.order, np.intp)

    @cached_property
    def key(self) -> bytes:
        """A key that is equal for equal drafts."""
        return _keys_anew([self])[0]

    @cached_property
    def high_mm(self) -> FloatArray:
        """(m, 3) back-right-top corners, mm."""
        high_mm: FloatArray = self.corner_mm + self.size_mm
        return high_mm

    @cached_property
    def rank(self) -> FloatArray:
        """(m,) position of each box in packing order; infinite if the box is left out."""
        rank = np.full(len(self.size_mm), np.inf)
        rank[list(self.order)] = np.arange(len(self.order))
        return rank

    @cached_property
    def mass_kg(self) -> FloatArray:
        """(m,) masses, kg."""
        return np.concatenate([self.plan.mass_kg, self.sheet_kg])

    @cached_property
    def shares(self) -> tuple[BoolArray, BoolArray, BoolArray]:
        """For x, y and z, (m, m) whether two boxes share a length along this axis."""
        ends = zip(self.corner_mm.T, self.high_mm.T, strict=True)
        x, y, z = (shared_length(low, high) > TOLERANCE_MM for low, high in ends)
        return x, y, z

    @cached_property
    def in_line(self) -> tuple[BoolArray, BoolArray]:
        """For x and y, (m, m) whether the row's box would meet the column's box if it moved far enough along this axis.
        Boxes that are left out are met by none."""
        x, y, z = self.shares
        present = np.isfinite(self.rank)
        return y & z & present, x & z & present

    @cached_property
    def on_top(self) -> BoolArray:
        """(m, m) whether the column's box lies directly on the row's box."""
        low, high = self.corner_mm.T, self.high_mm.T
        shared = self.shares[0] & self.shares[1]
        lies = shared & meets(low[2], high[2], TOLERANCE_MM) & np.less.outer(low[2], low[2])
        present = np.isfinite(self.rank)
        on_top: BoolArray = lies & present & present[:, None]
        return on_top

    @cached_property
    def is_bare(self) -> BoolArray:
        """(m,) whether nothing lies on a box."""
        return np.asarray(~self.on_top.any(axis=1))

    @cached_property
    def bears(self) -> BoolArray:
        """(m, m) whether the column's box lies on the row's box, directly or on boxes between them."""
        bears = self.on_top.copy()
        # from the highest box down, since a box lies only on boxes with lower bottoms
        for box in np.argsort(-self.corner_mm[:, 2], kind="stable"):
            bears[box] |= bears[bears[box]].any(axis=0)
        return bears

    @cached_property
    def _on_each(self) -> list[list[int]]:
        """For each box, the numbers of the boxes that lie directly on it."""
        return [row.nonzero()[0].tolist() for row in self.on_top]

    @cached_property
    def _under_each(self) -> list[list[int]]:
        """For each box, the numbers of the boxes on which it lies directly."""
        return [column.nonzero()[0].tolist() for column in self.on_top.T]

    def above(self, box: int) -> list[int]:
        """Numbers of the boxes that lie on a box, directly or on boxes between them."""
        return _closure(self._on_each, box)

    def below(self, box: int) -> list[int]:
        """Numbers of the boxes that bear a box, directly or through boxes between them."""
        return _closure(self._under_each, box)

    def with_places(self, boxes: Sequence[int], corner_mm: FloatArray, *, anew: bool = True) -> Draft:
        """The draft in which the given boxes have other corners. ``anew``: whether these boxes count as ``moved``,
        because the plan's directions of approach no longer hold for them."""
        corners = self.corner_mm.copy()
        corners[list(boxes)] = corner_mm
        moved = self.moved.union(boxes) if anew else self.moved
        # as ``dataclasses.replace`` does, but in a third of the time
        return Draft(self.plan, self.size_mm, corners, self.turned, self.order, moved, self.sheet_kg, self.film_turns)

    def in_order(self, order: tuple[int, ...]) -> Draft:
        """The draft with another packing order."""
        return Draft(
            self.plan, self.size_mm, self.corner_mm, self.turned, order, self.moved, self.sheet_kg, self.film_turns
        )

    def with_turn(self, box: int, turned: bool) -> Draft:
        """The draft with another turn of a box. ``turned``: whether the box is turned by 90° from its orientation in
        the plan. The box keeps its corner."""
        if bool(self.turned[box]) == turned:
            return self
        sizes, turns = self.size_mm.copy(), self.turned.copy()
        sizes[box] = sizes[box, [1, 0, 2]]
        turns[box] = turned
        moved = self.moved | {box}
        return Draft(self.plan, sizes, self.corner_mm, turns, self.order, moved, self.sheet_kg, self.film_turns)

    def with_order(self, box: int, neighbour: int, *, after: bool) -> Draft | None:
        """The draft in which a box is placed directly before or after another one; None if one of the two is left
        out."""
        if box == neighbour or box not in self.order or neighbour not in self.order:
            return None
        other_boxes = [number for number in self.order if number != box]
        other_boxes.insert(other_boxes.index(neighbour) + int(after), box)
        return self.in_order(tuple(other_boxes))

    def without(self, box: int) -> Draft | None:
        """The draft without a box; None if the draft has no such box, or no other box."""
        if box not in self.order or len(self.order) == 1:
            return None
        return self.in_order(tuple(number for number in self.order if number != box))

    def with_sheet(self, size_mm: FloatArray, corner_mm: FloatArray, mass_kg: float, before: int) -> Draft | None:
        """The draft with a further tie sheet, which is placed before the box ``before``. All boxes at or above the
        sheet's height are raised by the sheet's thickness."""
        if before not in self.order:
            return None
        corners = self.corner_mm.copy()
        corners[corners[:, 2] >= corner_mm[2] - TOLERANCE_MM, 2] += size_mm[2]
        order = list(self.order)
        order.insert(order.index(before), len(self.size_mm))
        return replace(
            self,
            size_mm=np.vstack([self.size_mm, size_mm]),
            corner_mm=np.vstack([corners, corner_mm]),
            turned=np.append(self.turned, False),
            order=tuple(order),
            sheet_kg=(*self.sheet_kg, mass_kg),
        )

    def as_plan(self, plan_id: str | None = None) -> Plan:
        """The draft as a plan. A draft without a change becomes exactly the original plan, to the last bit."""
        plan, rows = self.plan, self.rows
        n_sheets = len(self.sheet_kg)
        boxes = rows[rows < plan.n_boxes]

        def column(values: Any, sheet: Any) -> Any:
            """Values of the boxes in the new order; sheets have the value ``sheet``."""
            if values is None or not len(values):
                return values
            every = [*values, *[sheet] * n_sheets]
            return tuple(every[row] for row in self.order)

        changed: dict[str, Any] = {
            "plan_id": plan.plan_id if plan_id is None else plan_id,
            "size_mm": self.size_mm[rows],
            "corner_mm": self.corner_mm[rows],
            "mass_kg": self.mass_kg[rows],
            "item_ids": column(plan.item_ids, "tie-sheet"),
            "articles": column(plan.articles, "tie-sheet"),
            "product_groups": column(plan.product_groups, ""),
            "materials": column(plan.materials, ""),
        }
        last = int(plan.sequence[boxes].max(initial=0))
        sequence = np.concatenate([plan.sequence, last + 1 + np.arange(n_sheets)])
        changed["sequence"] = sequence[rows]
        if plan.orientation is not None or self.turned.any():
            before = np.zeros(plan.n_boxes, np.int64) if plan.orientation is None else plan.orientation
            orientation = np.concatenate([before, np.zeros(n_sheets, np.int64)])
            changed["orientation"] = np.where(self.turned, 1 - orientation, orientation)[rows]
        if plan.mass_center_mm is not None:
            changed["mass_center_mm"] = self._mass_center_mm(plan.mass_center_mm)[rows]
        for name in ("stiffness_n_mm", "strength_n", "approach_deg"):
            if (values := getattr(plan, name)) is not None:
                every = np.concatenate([values, np.full(n_sheets, np.nan)])
                if name == "approach_deg":
                    every[list(self.moved)] = np.nan
                changed[name] = every[rows]
        if plan.kinds or n_sheets:
            kinds = [*(plan.kinds or [KINDS[0]] * plan.n_boxes), *[SHEET] * n_sheets]
            changed["kinds"] = tuple(kinds[row] for row in self.order)
        return replace(plan, **changed)

    def _mass_center_mm(self, mass_center_mm: FloatArray) -> FloatArray:
        """(m, 3) centres of mass. A box is turned from orientation 0 to 1 by +90°, and from 1 to 0 by −90°
        (``Plan.item_com_mm``)."""
        centre = np.vstack([mass_center_mm, np.zeros((len(self.sheet_kg), 3))])
        lies_along_y = np.append(self.plan.turned, np.zeros(len(self.sheet_kg), bool))
        sign = np.where(lies_along_y, -1.0, 1.0)
        swapped = np.column_stack([-sign * centre[:, 1], sign * centre[:, 0], centre[:, 2]])
        return np.where(self.turned[:, None], swapped, centre) + 0.0  # + 0.0 turns -0.0 into 0.0


def key_of(draft: Draft, n_boxes: int | None = None) -> bytes:
    """A key that is equal for equal drafts. ``n_boxes``: if given, the key of only this many first boxes in packing
    order is returned. The key of the whole draft begins with the key of its first boxes."""
    return draft.key if n_boxes is None else draft.key[: _FIRST_BYTES + n_boxes * _BYTES_PER_BOX]


def keys_of(drafts: Sequence[Draft]) -> list[bytes]:
    """The key of each draft (``key_of``). Keys that are not known yet are computed together, in half the time."""
    unknown = [draft for draft in drafts if "key" not in vars(draft)]
    if unknown:
        for draft, key in zip(unknown, _keys_anew(unknown), strict=True):
            vars(draft)["key"] = key
    return [draft.key for draft in drafts]


def equal_placements(drafts: Sequence[Draft], other: Draft) -> list[int]:
    """For each draft, the number of its first placements that are equal to those of another draft."""
    placements, counts = _placements(key_of(other)), list[int]()
    for key in keys_of(drafts):
        own = _placements(key)
        n = min(len(own), len(placements))
        differs = (own[:n] != placements[:n]).any(axis=1)
        counts.append(int(differs.argmax()) if differs.any() else n)
    return counts


def _placements(key: bytes) -> FloatArray:
    """(n, 7) the numbers in a key: one row for each box, in packing order."""
    placements: FloatArray = np.frombuffer(key, np.float64, offset=_FIRST_BYTES).reshape(-1, _BYTES_PER_BOX // 8)
    return placements


def _keys_anew(drafts: Sequence[Draft]) -> list[bytes]:
    rows = [draft.rows for draft in drafts]
    values = np.empty((sum(map(len, rows)), 7))
    np.concatenate(rows, out=values[:, 0])
    np.concatenate([draft.corner_mm.take(draft.rows, axis=0) for draft in drafts], out=values[:, 1:4])
    np.concatenate([draft.size_mm.take(draft.rows, axis=0) for draft in drafts], out=values[:, 4:])
    values[:, 1:].round(3, out=values[:, 1:])
    every, ends = values.tobytes(), np.cumsum([_BYTES_PER_BOX * len(some) for some in rows]).tolist()
    spans = zip(drafts, [0, *ends], ends, strict=False)
    return [np.float64(draft.film_turns).tobytes() + every[begin:end] for draft, begin, end in spans]


_FIRST_BYTES: Final = 8
_BYTES_PER_BOX: Final = 7 * 8
"""Bytes of a key: first the turns of film, then seven numbers for each box."""


def _closure(leads_to: Sequence[Sequence[int]], box: int) -> list[int]:
    """Numbers of the boxes that can be reached from a box, nearest first. ``leads_to``: for each box, the numbers of
    the boxes that can be reached from it in one step."""
    reached: dict[int, None] = {}
    front = [box]
    while front:
        following = {number for near in front for number in leads_to[near]}
        front = sorted(following - reached.keys() - {box})
        reached.update(dict.fromkeys(front))
    return list(reached)
