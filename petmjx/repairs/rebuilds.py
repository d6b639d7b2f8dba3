"""Plans that are built anew, beginning with the box that does not hold (``rebuilds``), if single changes do not help.

Boxes keep their places as long as statics has no objection. A box that loses its supports, or whose load would go
beyond an edge, is put elsewhere, in its turn or after all others. So a plan with many faults is mended in a few trials,
with one change for each box that is put elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from petmjx.options.simulation import Simulation
from petmjx.repairs.balance import balances
from petmjx.repairs.changes import Change, LeaveOut, Place
from petmjx.repairs.drafts import TOLERANCE_MM, Draft, Rules
from petmjx.repairs.proposals import Proposal, Target, resting_corners

MOST_CAUSES: Final = 2
"""Largest number of causes of a failure for which a plan is built anew."""

SAME_TROUBLE: Final = 1e-6
"""Two values of ``Balance.trouble`` that differ by less than this count as equal."""

TRIED_AT_ONCE: Final = 8
"""Places of a box that statics judges at once."""


@dataclass(frozen=True)
class Way:
    """A way to build a plan anew.

    Attributes:
        late: True: boxes that lose their places are placed after all others. False: they are placed in their turn.
        strict: True: a box is also put elsewhere if a load would go beyond an edge. False: only boxes that cannot keep
            their places are put elsewhere.
    """

    late: bool
    strict: bool


WAYS: Final = tuple(Way(late, strict) for late, strict in product((False, True), repeat=2))


def rebuilds(
    draft: Draft, rules: Rules, sim: Simulation, causes: list[Target], n_held: int, *, leaves_out: bool
) -> Iterator[Proposal]:
    """Ways to build a plan anew: the boxes of one cause get other places, or are left out.

    Args:
        causes: why the plan fails, the likeliest first.
        n_held: number of boxes that stood before the plan failed. Statics does not judge these boxes.
        leaves_out: whether the boxes of a cause are left out.
    """
    distrusted = {frozenset(some) for cause in causes[:MOST_CAUSES] for some in ({cause.box}, {cause.cause})}
    for boxes in sorted(distrusted, key=sorted):
        if min(boxes) < rules.built or max(boxes) >= draft.plan.n_boxes or not boxes <= set(draft.order):
            continue
        for way in WAYS:
            changes = _Pile(draft, rules, sim, boxes, n_held, way, leaves_out).built()
            if changes:
                yield changes


class _Pile:
    """A plan that is built anew."""

    def __init__(
        self,
        draft: Draft,
        rules: Rules,
        sim: Simulation,
        distrusted: Collection[int],
        n_held: int,
        way: Way,
        leaves_out: bool,
    ) -> None:
        self._draft, self._rules, self._sim = draft, rules, sim
        self._distrusted, self._way, self._leaves_out = distrusted, way, leaves_out
        self._held = set(draft.order[:n_held])
        self._pile = replace(draft, order=())
        self._known_trouble: float | None = 0.0

    def built(self) -> Proposal | None:
        """The changes that turn the draft into the new plan; None: there is no place for a box."""
        changes: list[Change] = []
        waiting: list[int] = []
        for at, box in enumerate(self._draft.order):
            if box in self._distrusted and self._leaves_out:
                changes.append(LeaveOut(box))
            elif box not in self._distrusted and self._keeps(box):
                continue
            elif box < self._rules.built or box >= self._draft.plan.n_boxes:
                return None
            elif self._way.late:
                waiting.append(box)
            elif (change := self._placed(box, self._draft.order[at + 1 :])) is not None:
                changes.append(change)
            else:
                waiting.append(box)
        for box in waiting:
            last = self._pile.order[-1] if self._pile.order else None
            change = self._placed(box, ())
            if change is None:
                return None
            changes.append(replace(change, neighbour=last))
        return tuple(changes)

    def _keeps(self, box: int) -> bool:
        """Put a box at its place, if it can keep this place. Returns whether it can."""
        pile, trouble = replace(self._pile, order=(*self._pile.order, box)), None
        if box >= self._rules.built:
            if not self._rules.allow([pile])[0]:
                return False
            if self._way.strict and box not in self._held and self._pile.order:
                (after,) = balances([pile], self._sim)
                trouble = after.trouble
                if trouble > self._trouble + SAME_TROUBLE:
                    return False
        self._pile, self._known_trouble = pile, trouble
        return True

    def _placed(self, box: int, later: Collection[int]) -> Place | None:
        """Put a box at the best place; None: there is no place. At the best place, statics objects least. Of such
        places, it is one that is in the way of the fewest later boxes; then the one with the safest loads; then the
        lowest one. Places in the way of few boxes, and low ones, are tried first, until statics does not object."""
        planned = self._draft.corner_mm[box]
        places = [
            Place(box, corner, bool(self._draft.turned[box]) != turn, differs=turn)
            for turn, corner in resting_corners(self._pile, self._rules, box)
            if turn or box not in self._distrusted or np.abs(planned - corner).max() > TOLERANCE_MM
        ]
        waiting = replace(self._pile, order=(*self._pile.order, box))
        tried = [(place, draft) for place in places if (draft := place.applied(waiting)) is not None]
        in_the_way = [self._in_the_way(draft, box, later) for _, draft in tried]
        queue = sorted(range(len(tried)), key=lambda k: (in_the_way[k], tried[k][0].corner_mm[2]))
        best: tuple[float, ...] | None = None
        for begin in range(0, len(queue), TRIED_AT_ONCE):
            numbers = queue[begin : begin + TRIED_AT_ONCE]
            allowed = self._rules.allow([tried[k][1] for k in numbers])
            numbers = [k for k, is_allowed in zip(numbers, allowed, strict=True) if is_allowed]
            for k, balance in zip(numbers, balances([tried[k][1] for k in numbers], self._sim), strict=True):
                rank = balance.trouble, in_the_way[k], balance.weakness, tried[k][0].corner_mm[2], k
                if best is None or rank < best:
                    best = rank
            if best is not None and best[0] <= self._trouble + SAME_TROUBLE:
                break  # no box makes the trouble of the boxes below less
        if best is None:
            return None
        chosen = int(best[-1])
        self._pile, self._known_trouble = tried[chosen][1], best[0]
        return tried[chosen][0]

    @property
    def _trouble(self) -> float:
        """``Balance.trouble`` of the pile; 0 without boxes."""
        if self._known_trouble is None:
            (balance,) = balances([self._pile], self._sim)
            self._known_trouble = balance.trouble
        return self._known_trouble

    def _in_the_way(self, pile: Draft, box: int, later: Collection[int]) -> int:
        """How many later boxes cannot keep their places because a box stands there, or above."""
        rows = [number for number in later if number not in self._distrusted]
        low, high = pile.corner_mm[rows], (pile.corner_mm + pile.size_mm)[rows]
        bottom, top = pile.corner_mm[box], pile.corner_mm[box] + pile.size_mm[box]
        shared = np.minimum(high, top) - np.maximum(low, bottom)
        return int(((shared[:, :2] > TOLERANCE_MM).all(axis=1) & (low[:, 2] < top[2] - TOLERANCE_MM)).sum())
