"""Plans that are built anew from the box that fails onwards (``rebuilds``), if single changes do not help.

Boxes keep their places as long as statics finds no load beyond an edge. A box that loses its supports, or whose load
would go beyond an edge, is put elsewhere, at its position in the packing order or after all others. So a plan with many
faults is mended in a few trials, with one change for each box that is put elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from petmjx.options.simulation import Simulation
from petmjx.repairs.balance import Balance, balances, balances_with_last
from petmjx.repairs.changes import Change, LeaveOut, Place
from petmjx.repairs.draft_rules import Rules
from petmjx.repairs.drafts import TOLERANCE_MM, Draft, keys_of
from petmjx.repairs.proposals import Proposal, Spot, Target, resting_corners

MOST_CAUSES: Final = 2
"""Largest number of causes of a failure for which a plan is built anew."""

SAME_TROUBLE: Final = 1e-6
"""Two values of ``Balance.trouble`` that differ by less than this count as equal."""

TRIED_AT_ONCE: Final = 8
"""Number of possible places of a box for which statics computes the balance at once."""


@dataclass(frozen=True)
class Way:
    """A way to build a plan anew.

    Attributes:
        late: whether boxes that lose their places are placed after all other boxes. If False, such boxes are placed in
            packing order.
        strict: whether a box is also put elsewhere if a load would otherwise act beyond an edge. If False, only boxes
            that cannot keep their places are put elsewhere.
    """

    late: bool
    strict: bool


WAYS: Final = tuple(Way(late, strict) for late, strict in product((False, True), repeat=2))


class PileRequest(NamedTuple):
    """Piles whose last boxes are to be judged.

    Attributes:
        piles: the piles; each is allowed without its last box.
        by_statics: whether statics also judges the piles that are allowed.
        before: the balance that all piles have without their last boxes; None if this balance is unknown.
    """

    piles: list[Draft]
    by_statics: bool
    before: Balance | None = None


class JudgedPile(NamedTuple):
    """A judged pile.

    Attributes:
        is_allowed: whether the pile is allowed.
        balance: balance of the pile; None if statics did not judge the pile, or if the pile is not allowed.
    """

    is_allowed: bool
    balance: Balance | None = None


Result = TypeVar("Result")
Judging = Generator[PileRequest, list[JudgedPile], Result]
"""A generator that does a part of the work of building a plan anew. It yields piles that must be judged, and is sent
the judged piles. It returns its result at its end."""


class Failure(NamedTuple):
    """A plan that fails.

    Attributes:
        causes: why it fails, the likeliest first.
        n_held: number of boxes that stood before the plan failed. Statics does not judge these boxes.
    """

    draft: Draft
    causes: Sequence[Target]
    n_held: int


def rebuilds(failures: Sequence[Failure], rules: Rules, sim: Simulation, *, leaves_out: bool) -> list[list[Proposal]]:
    """For each plan, ways to build it anew. In each way, one box of a cause is distrusted: the box that fails, or the
    box whose placement makes it fail. The distrusted box gets another place, or is left out.

    All ways are built side by side, since statics judges many piles at once in little more time than one.

    Args:
        leaves_out: whether the distrusted box is left out.
    """
    piles = [[*_piles(failure, rules, leaves_out)] for failure in failures]
    built = iter(_side_by_side([pile.built() for some in piles for pile in some], rules, sim))
    return [[changes for changes in islice(built, len(some)) if changes] for some in piles]


def _piles(failure: Failure, rules: Rules, leaves_out: bool) -> Iterator[_Pile]:
    draft = failure.draft
    distrusted = {frozenset(some) for cause in failure.causes[:MOST_CAUSES] for some in ({cause.box}, {cause.cause})}
    for boxes in sorted(distrusted, key=sorted):
        if min(boxes) >= rules.built and max(boxes) < draft.plan.n_boxes and boxes <= set(draft.order):
            yield from (_Pile(draft, rules, boxes, failure.n_held, way, leaves_out) for way in WAYS)


def _side_by_side(parts: Sequence[Judging[Result]], rules: Rules, sim: Simulation) -> list[Result]:
    """The results of several generators (``Judging``) whose piles are judged together. Statics examines piles only
    when all generators wait for it."""
    results: dict[int, Result] = {}
    answers: dict[int, Any] = dict.fromkeys(range(len(parts)))
    requests: dict[int, PileRequest] = {}
    while answers:
        for number, answer in answers.items():
            try:
                requests[number] = parts[number].send(answer)
            except StopIteration as end:
                results[number] = end.value
        numbers = [number for number, request in requests.items() if not request.by_statics] or [*requests]
        chosen = {number: requests.pop(number) for number in numbers}
        of_piles = [request._replace(piles=[pile]) for request in chosen.values() for pile in request.piles]
        judged = iter(_judged(of_piles, rules, sim))
        answers = {number: [*islice(judged, len(request.piles))] for number, request in chosen.items()}
    return [results[number] for number in range(len(parts))]


def _judged(requests: Sequence[PileRequest], rules: Rules, sim: Simulation) -> list[JudgedPile]:
    """The judged pile of each request; each request has one pile. Equal piles are judged only once. Statics judges the
    piles of all requests, or of none (``PileRequest.by_statics``)."""
    keys = keys_of([pile for (pile,), *_ in requests])
    different = dict(zip(keys, requests, strict=True))
    piles = {key: pile for key, ((pile,), *_) in different.items()}
    allowed = rules.allow([*piles.values()], [pile.order[-1:] for pile in piles.values()])
    judged = {key: JudgedPile(bool(is_allowed)) for key, is_allowed in zip(piles, allowed, strict=True)}
    for_statics = [key for key, request in different.items() if request.by_statics and judged[key].is_allowed]
    known = {key: before for key in for_statics if (before := different[key].before) is not None}
    unknown = [key for key in for_statics if key not in known]
    of_known = balances_with_last([piles[key] for key in known], [*known.values()], sim)
    of_unknown = balances([piles[key] for key in unknown], sim, with_loads=True)
    for key, balance in zip((*known, *unknown), (*of_known, *of_unknown), strict=True):
        judged[key] = JudgedPile(True, balance)
    return [judged[key] for key in keys]


class _Pile:
    """A plan while it is built anew: the boxes that have their new places so far are its pile."""

    def __init__(
        self, draft: Draft, rules: Rules, distrusted: Collection[int], n_held: int, way: Way, leaves_out: bool
    ) -> None:
        self._draft, self._rules = draft, rules
        self._distrusted, self._way, self._leaves_out = distrusted, way, leaves_out
        self._held = set(draft.order[:n_held])
        self._pile = draft.in_order(())
        self._balance: Balance | None = None  # balance of the pile; None: not computed yet

    def built(self) -> Judging[Proposal | None]:
        """The changes that turn the draft into the new plan; None: there is no place for a box."""
        changes: list[Change] = []
        waiting: list[int] = []
        for at, box in enumerate(self._draft.order):
            if box in self._distrusted and self._leaves_out:
                changes.append(LeaveOut(box))
            elif box not in self._distrusted and (yield from self._keeps(box)):
                continue
            elif box < self._rules.built or box >= self._draft.plan.n_boxes:
                return None
            elif self._way.late:
                waiting.append(box)
            elif (change := (yield from self._placed(box, self._draft.order[at + 1 :]))) is not None:
                changes.append(change)
            else:
                waiting.append(box)
        for box in waiting:
            last = self._pile.order[-1] if self._pile.order else None
            change = yield from self._placed(box, ())
            if change is None:
                return None
            changes.append(replace(change, neighbour=last))
        return tuple(changes)

    def _keeps(self, box: int) -> Judging[bool]:
        """Put a box at its place, if it can keep this place. The method returns whether the box can keep its place."""
        pile, after = self._pile.in_order((*self._pile.order, box)), None
        by_statics = self._way.strict and box not in self._held and bool(self._pile.order)
        if box >= self._rules.built and (by_statics or not self._is_as_in_draft(pile)):
            before = (yield from self._known()) if by_statics else None
            ((is_allowed, after),) = yield PileRequest([pile], by_statics, before)
            if not is_allowed:
                return False
            if after is not None and after.trouble > _trouble(before) + SAME_TROUBLE:
                return False
        self._pile, self._balance = pile, after
        return True

    def _is_as_in_draft(self, pile: Draft) -> bool:
        """Whether a pile has the first boxes of the draft, in their places. Such a pile is allowed, because the draft
        is allowed."""
        is_same = pile.corner_mm is self._draft.corner_mm
        return is_same and pile.order == self._draft.order[: len(pile.order)]

    def _placed(self, box: int, later: Collection[int]) -> Judging[Place | None]:
        """Put a box at the best place; None: there is no place. The best place is the one with the least trouble
        (``Balance``). Places with equal trouble are ranked by the number of later boxes that they obstruct, then by
        weakness, then by height. The places that obstruct the fewest later boxes are tried first. Of places that
        obstruct equally many boxes, the lowest is tried first. When a place adds no trouble, no further places are
        tried."""
        planned = self._draft.corner_mm[box]
        was_turned = bool(self._draft.turned[box])
        spots = [
            (turn, corner)
            for turn, corner in resting_corners(self._pile, self._rules, box)
            if turn or box not in self._distrusted or np.abs(planned - corner).max() > TOLERANCE_MM
        ]
        waiting = self._pile.in_order((*self._pile.order, box))
        in_the_way = self._in_the_way(box, spots, later)
        queue = sorted(range(len(spots)), key=lambda k: (in_the_way[k], spots[k][1][2]))
        best: tuple[float, ...] | None = None
        best_place: Place | None = None
        best_pile, best_balance = self._pile, self._balance
        before = yield from self._known()
        for begin in range(0, len(queue), TRIED_AT_ONCE):
            numbers = queue[begin : begin + TRIED_AT_ONCE]
            places = [
                Place(box, corner, was_turned != turn, differs=turn) for turn, corner in map(spots.__getitem__, numbers)
            ]
            piles = [pile for place in places if (pile := place.applied(waiting)) is not None]
            judged = yield PileRequest(piles, True, before)
            for k, place, pile, (_, balance) in zip(numbers, places, piles, judged, strict=True):
                if balance is None:
                    continue
                rank = balance.trouble, in_the_way[k], balance.weakness, place.corner_mm[2], k
                if best is None or rank < best:
                    best, best_place, best_pile, best_balance = rank, place, pile, balance
            if best is not None and best[0] <= _trouble(before) + SAME_TROUBLE:
                break  # no place can be better: a further box never lessens the trouble of the boxes below
        if best_place is not None:
            self._pile, self._balance = best_pile, best_balance
        return best_place

    def _known(self) -> Judging[Balance | None]:
        """The balance of the pile; None without boxes."""
        if self._balance is None and self._pile.order:
            ((_, self._balance),) = yield PileRequest([self._pile], True)
        return self._balance

    def _in_the_way(self, box: int, spots: Sequence[Spot], later: Collection[int]) -> list[int]:
        """For each spot of a box, how many later boxes cannot keep their places because the box would overlap or cover
        them from above."""
        rows = [number for number in later if number not in self._distrusted]
        if not (spots and rows):
            return [0] * len(spots)
        low, high = self._draft.corner_mm[rows], self._draft.high_mm[rows]
        size = self._draft.size_mm[box]
        bottom = np.array([corner for _, corner in spots])
        top = bottom + np.where([[turn] for turn, _ in spots], size[[1, 0, 2]], size)
        shared = np.minimum(high, top[:, None]) - np.maximum(low, bottom[:, None])
        is_in_the_way = (shared[..., :2] > TOLERANCE_MM).all(axis=2) & (low[:, 2] < top[:, None, 2] - TOLERANCE_MM)
        in_the_way: list[int] = is_in_the_way.sum(axis=1).tolist()
        return in_the_way


def _trouble(balance: Balance | None) -> float:
    """The trouble of a pile; 0 without boxes."""
    return 0.0 if balance is None else balance.trouble
