"""Changes that may repair a plan (``proposals``). The cause of the plan's failure determines which boxes are changed,
and how.

A load beyond an edge involves several boxes: the box that has the load, the box whose placement moves the load beyond
the edge, the supports, and the boxes on top. All boxes that a load involves are moved, turned, exchanged, or placed
elsewhere or at another time. Other boxes are put under an overhanging box. A proposal only has to be possible, not
good, because statics and simulation judge it afterwards.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from operator import sub
from typing import Final, NamedTuple

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.repairs.balance import ROOM_MM, Balance
from petmjx.repairs.changes import Change, Exchange, Kind, LeaveOut, Move, Order, Place, Sheet, Turn
from petmjx.repairs.draft_rules import Places, Rules
from petmjx.repairs.drafts import TOLERANCE_MM, BoolArray, Draft, IntArray
from petmjx.repairs.repair_options import RepairOptions

Proposal = tuple[Change, ...]

Spot = tuple[bool, tuple[float, float, float]]
"""A place for a box: whether the box is turned there by 90°, and the box's front-left-bottom corner, mm."""

MOST_TARGETS: Final = 4
"""Largest number of causes of a failure for which changes are proposed."""

MOST_NEAR: Final = 8
"""Largest number of boxes that are moved, turned and exchanged because of one cause."""

SPARE_MM: Final = (2.0, 6.0, 12.0, 25.0)
"""A load that is beyond an edge is moved inside the edge, to each of these distances from the edge, mm. Each distance
gives a proposal of its own. When a robot places a box, the error of the box's place has a standard deviation of 2 mm
(docs/confidence.md)."""

STEPS_MM: Final = (10.0, 20.0, 30.0, 45.0, 60.0, 80.0, 100.0, 130.0, 160.0, 200.0)
"""Lengths, mm, of those proposed moves of a box that do not depend on how far a load is beyond an edge."""

MOST_PLACES: Final = 24
"""Largest number of other places that are proposed for one box: the lowest places, and of places of equal height those
with the largest support."""

SPOT_MM: Final = 10.0
"""Side of the squares into which the floor is divided, mm. Of the places with the same height in the same square, only
the first is proposed."""

LEAST_SUPPORT: Final = 0.5
"""Smallest supported share of a box's base at a place that is proposed for the box."""

MOST_TOGETHER: Final = 12
"""Largest number of boxes that are moved together, or lifted off together and put elsewhere."""


class Target(NamedTuple):
    """A cause of a failure.

    Attributes:
        box: number of the box that fails: its load is beyond the edge of its supports, it floats or overlaps, or it
            falls.
        cause: number of the box whose placement moves the load beyond the edge; equal to ``box`` if the own weight of
            the failing box is beyond the edge.
        depth_mm: distance of the load beyond the edge; 0 if the load is inside the edge according to statics.
        is_squeezed: whether the box needs room beside it, since it falls with errors and is lowered between two others.
    """

    box: int
    cause: int
    depth_mm: float = 0.0
    is_squeezed: bool = False


def targets(
    draft: Draft, rules: Rules, balance: Balance, culprit: int | None, fallen: Collection[int], n_placed: int
) -> list[Target]:
    """The causes of a failure, at most ``MOST_TARGETS``, the likeliest first.

    A cause is a box whose load went beyond an edge before the world ended. This box must have fallen, or bear a fallen
    box. A box that floats or overlaps in the plan is also a cause if it has fallen or bears a fallen box. If no load is
    a cause, all boxes that float or overlap are causes. Unless they are causes for these reasons, the culprit and its
    supports come last: simulations and statics may differ.

    Args:
        culprit: number of the box that first crossed a limit; None if no box crossed one.
        fallen: numbers of all boxes that crossed a limit.
        n_placed: number of boxes that were placed in the simulation.
    """
    losers = [*([] if culprit is None else [culprit]), *(box for box in fallen if box != culprit)]
    first = losers[:1]
    nearby_boxes = set(itertools.chain(first, *(draft.below(box) for box in first if box in draft.order)))
    wide = set(itertools.chain(losers, *(draft.below(box) for box in losers if box in draft.order)))
    rows = [
        (box not in nearby_boxes, box not in wide, int(step), Target(int(box), int(cause), float(depth)))
        for box, step, cause, depth in zip(balance.box, balance.step, balance.cause, balance.depth_mm, strict=True)
        if step < n_placed
    ]
    rows.sort()
    chosen = [row[3] for row in rows if not row[0]] or [row[3] for row in rows if not row[1]]
    odd = [box for box in (*rules.floating, *rules.overlapping) if draft.rank[box] < n_placed]
    chosen += [Target(box, box) for box in odd if box in wide or not chosen]
    if culprit is not None and culprit in draft.order:
        chosen.append(Target(culprit, culprit, balance.depth_of(culprit)))
        supports = np.flatnonzero(draft.on_top[:, culprit]).tolist()
        chosen += [Target(box, culprit, balance.depth_of(box)) for box in supports]
    chosen += [row[3] for row in rows if not row[1]]
    different: dict[int, Target] = {}
    for target in chosen:
        different.setdefault(target.box, target)
    return list(different.values())[:MOST_TARGETS]


def proposals(
    draft: Draft, rules: Rules, causes: Sequence[Target], kinds: frozenset[Kind], options: RepairOptions
) -> Iterator[Proposal]:
    """Changes of the given kinds that may help against the given causes of a failure. Some of these changes are not
    allowed (``Rules.allow``). A change of a box that does not depend on the cause is proposed only once."""
    done: set[int] = set()
    for target in causes:
        near = _near(draft, rules, target)
        new = [box for box in near if box not in done]
        for kind, make in _makers(draft, rules, target, near, new, done, options):
            if kind in kinds:
                yield from make()
        done.update(near)


def _makers(
    draft: Draft,
    rules: Rules,
    target: Target,
    near: Sequence[int],
    new: Sequence[int],
    done: Collection[int],
    options: RepairOptions,
) -> tuple[tuple[Kind, Callable[[], Iterator[Proposal]]], ...]:
    """Pairs (kind of changes, function). The function proposes changes of this kind for the given cause.

    Args:
        near: boxes to change for the cause.
        new: the boxes of ``near`` that are not in ``done``.
        done: boxes for which changes were already proposed, for causes before this one.
    """
    most_mm = options.most_move_mm
    return (
        (Kind.ORDER, lambda: _orders(draft, target)),
        (Kind.ORDER, lambda: _earlier(draft, target)),
        (Kind.MOVE, lambda: _clearances(draft, rules, target, most_mm)),
        (Kind.MOVE, lambda: _moves(draft, rules, near, new, target, most_mm)),
        (Kind.MOVE, lambda: _pushes(draft, rules, target, most_mm)),
        (Kind.TURN, lambda: _turns(draft, rules, new)),
        (Kind.EXCHANGE, lambda: _exchanges(draft, rules, new, done)),
        (Kind.PLACE, lambda: itertools.chain(_places(draft, rules, new), _props(draft, rules, target))),
        (Kind.SHEET, lambda: iter(()) if done else _sheets(draft, options.sheet_mm, options.sheet_kg_m2)),
        (Kind.LEAVE_OUT, lambda: _omissions(draft, rules, new)),
    )


def _near(draft: Draft, rules: Rules, target: Target) -> list[int]:
    """Boxes to change for a cause: the box that fails, the box whose placement moves the load beyond the edge, the
    supports of the failing box, and the boxes on the failing box."""
    box = target.box
    supports = np.flatnonzero(draft.on_top[:, box]).tolist()
    riders = sorted(np.flatnonzero(draft.on_top[box]).tolist(), key=lambda rider: draft.rank[rider])
    boxes = dict.fromkeys((box, target.cause, *supports, *riders, *draft.below(box)))
    return [number for number in boxes if number >= rules.built and number < draft.plan.n_boxes][:MOST_NEAR]


def _orders(draft: Draft, target: Target) -> Iterator[Proposal]:
    """Changes of the packing order. Either a counterweight is moved forward, before the box whose placement moves the
    load beyond the edge (the cause), or the cause is moved back, after the counterweight. If the failing box is placed
    before one of its supports, the support is moved forward or the box is moved back."""
    box, cause = target.box, target.cause
    at = draft.rank[cause]
    pile = [number for number in (*draft.above(box), *_neighbours(draft, box)) if draft.rank[number] > at]
    for number in pile:
        needed = [low for low in reversed(draft.below(number)) if at < draft.rank[low] < draft.rank[number]]
        if len(needed) <= 2:
            yield (*(Order(low, cause) for low in needed), Order(number, cause))
        yield (Order(cause, number, after=True),)
        late_supports = [high for high in draft.above(cause) if draft.rank[high] < draft.rank[number]]
        if 0 < len(late_supports) <= 2:
            after = [number, cause, *late_supports]
            yield tuple(Order(moved, last, after=True) for last, moved in itertools.pairwise(after))
    for support in np.flatnonzero(draft.on_top[:, box]).tolist():
        if draft.rank[support] > draft.rank[box]:
            yield (Order(support, box),)
            yield (Order(box, support, after=True),)


def _earlier(draft: Draft, target: Target) -> Iterator[Proposal]:
    """Changes of the packing order for a squeezed box (one that is lowered between two others): the squeezed box comes
    before one of the two others. Either the squeezed box moves forward in the order, or the other box moves back."""
    box = target.box
    for number, _, _ in _tight(draft, target):
        needed = [low for low in reversed(draft.below(box)) if draft.rank[low] > draft.rank[number]]
        if len(needed) <= 2:
            yield (*(Order(low, number) for low in needed), Order(box, number))
        riders = [high for high in draft.above(number) if draft.rank[high] < draft.rank[box]]
        if len(riders) <= 2:
            after = [box, number, *riders]
            yield tuple(Order(moved, last, after=True) for last, moved in itertools.pairwise(after))


def _clearances(draft: Draft, rules: Rules, target: Target, most_mm: float) -> Iterator[Proposal]:
    """Moves of the boxes between which a squeezed box (``Target.is_squeezed``) is lowered. Each of these boxes is moved
    away from the squeezed box, together with all boxes in its way."""
    for number, axis, gap_mm in _tight(draft, target):
        sign = np.sign(draft.corner_mm[number, axis] - draft.corner_mm[target.box, axis])
        for length in (math.ceil(ROOM_MM - gap_mm) + more for more in (0, 4, 12)):
            dx, dy = (float(sign * length), 0.0) if axis == 0 else (0.0, float(sign * length))
            together = _pushed(draft, number, dx, dy, alone=False)
            fits = len(together) <= MOST_TOGETHER and min(together) >= rules.built and target.box not in together
            if fits and length <= most_mm:
                yield (Move(number, dx, dy, tuple(sorted(together - {number}))),)


def _tight(draft: Draft, target: Target) -> list[tuple[int, int, float]]:
    """Boxes that are placed before a squeezed box, and stand beside it with a gap of less than ``ROOM_MM``. Each result
    is the number of the box, the axis of the gap (0: x, 1: y), and the gap, mm."""
    if not target.is_squeezed:
        return []
    low, high = draft.corner_mm, draft.high_mm
    gap = np.maximum(low[target.box] - high, low - high[target.box])
    before = draft.rank < draft.rank[target.box]
    tight = []
    for axis in (0, 1):
        beside = before & (gap[:, [1 - axis, 2]] < -TOLERANCE_MM).all(axis=1)
        beside &= (gap[:, axis] > -TOLERANCE_MM) & (gap[:, axis] < ROOM_MM)
        tight += [(number, axis, float(gap[number, axis])) for number in np.flatnonzero(beside).tolist()]
    return tight


def _neighbours(draft: Draft, box: int) -> list[int]:
    """Boxes that stand beside a box, on the same supports or on the carrier."""
    low, high = draft.corner_mm, draft.high_mm
    gap = np.maximum(low[box] - high, low - high[box])
    beside = (gap.max(axis=1) <= 5 * TOLERANCE_MM) & np.isfinite(draft.rank)
    beside[box] = False
    return np.flatnonzero(beside & (gap[:, 2] < -TOLERANCE_MM)).tolist()


def _moves(
    draft: Draft, rules: Rules, near: Sequence[int], new: Collection[int], target: Target, most_mm: float
) -> Iterator[Proposal]:
    """Moves of boxes along x, along y, and along both at once. Each box is moved alone, and together with the boxes on
    it. Boxes that are not in ``new`` are moved only by lengths that depend on the cause."""
    needed = _needed_mm(target.depth_mm, SPARE_MM, most_mm) if target.depth_mm > 0 else []
    for box in near:
        riders = tuple(sorted(rider for rider in draft.above(box) if rider < draft.plan.n_boxes))
        for with_them in ((), riders) if riders else ((),):
            free = _free_ways_mm(draft, box, with_them)
            lengths = []
            for way in free:
                others = (*STEPS_MM, math.floor(way)) if 1 <= way <= most_mm else STEPS_MM
                some = (*needed, *others) if box in new else needed
                lengths.append(sorted({length for length in some if 0 < length <= most_mm}))
            left, right, front, back = lengths
            ways = [(float(dx), 0.0) for dx in (*(-length for length in left), *right)]
            ways += [(0.0, float(dy)) for dy in (*(-length for length in front), *back)]
            if box == target.box:
                diagonal = [length for length in (*needed[:2], 20.0, 45.0, 80.0) if length <= most_mm]
                signs = itertools.product(diagonal, (-1, 1), (-1, 1))
                ways += [(float(dx * length), float(dy * length)) for length, dx, dy in signs]
            for (dx, dy), is_free in zip(ways, rules.have_room(draft, [box, *with_them], ways), strict=True):
                if is_free:
                    yield (Move(box, dx, dy, with_them),)


def _needed_mm(depth_mm: float, spares_mm: Sequence[float], most_mm: float) -> list[int]:
    """Lengths of moves that bring a load inside its edge by the given distances. If a length is larger than allowed, it
    is replaced by the largest allowed length: moves of two boxes, towards each other, may be enough."""
    return [*dict.fromkeys(min(math.ceil(depth_mm + spare), math.floor(most_mm)) for spare in spares_mm)]


def _pushes(draft: Draft, rules: Rules, target: Target, most_mm: float) -> Iterator[Proposal]:
    """Moves of boxes with the boxes on them and with all boxes in their way."""
    depth = target.depth_mm
    lengths = [length for length in (*_needed_mm(depth, SPARE_MM[:3], most_mm), 45) if length <= most_mm]
    supports = np.flatnonzero(draft.on_top[:, target.box]).tolist()
    for box in dict.fromkeys((target.box, target.cause, *supports)):
        for length, (along_x, along_y) in itertools.product(lengths, ((-1, 0), (1, 0), (0, -1), (0, 1))):
            dx, dy = float(along_x * length), float(along_y * length)
            together = _pushed(draft, box, dx, dy, alone=False)
            if len(together) <= MOST_TOGETHER and min(together) >= rules.built:
                yield (Move(box, dx, dy, tuple(sorted(together - {box}))),)
            if box in supports:
                together = _pushed(draft, box, dx, dy, alone=True)
                if 1 < len(together) <= MOST_TOGETHER and min(together) >= rules.built:
                    yield (Move(box, dx, dy, tuple(sorted(together - {box}))),)


def _pushed(draft: Draft, box: int, dx_mm: float, dy_mm: float, *, alone: bool) -> set[int]:
    """Numbers of the boxes that move if a box is moved along x or along y: the box itself, and all boxes in its way.
    The boxes on these boxes move as well, unless the box is moved ``alone``."""
    axis, way_mm = (0, dx_mm) if dx_mm else (1, dy_mm)
    low, high = draft.corner_mm[:, axis], draft.high_mm[:, axis]
    in_line = draft.in_line[axis]
    moved = np.arange(len(low)) == box
    front = moved if alone else moved | draft.bears[box]
    moved = front
    while front.any() and moved.sum() <= MOST_TOGETHER:
        deep = np.minimum.outer(high[front] + way_mm, high) - np.maximum.outer(low[front] + way_mm, low)
        hit = ((deep > TOLERANCE_MM) & in_line[front]).any(axis=0) & ~moved
        front = hit if alone else (hit | draft.bears[hit].any(axis=0)) & ~moved
        moved = moved | front
    return set(np.flatnonzero(moved).tolist())


def _free_ways_mm(draft: Draft, box: int, riders: Sequence[int]) -> tuple[float, float, float, float]:
    """Free ways of a box to the left, right, front and back until it meets another box; infinite: no box in the way."""
    low, high = draft.corner_mm, draft.high_mm
    is_placed = np.isfinite(draft.rank)
    is_placed[[box, *riders]] = False
    ways = []
    for axis in (0, 1):
        across = [2, 1 - axis]
        beside = is_placed & (
            (low[:, across] < high[box, across] - TOLERANCE_MM) & (high[:, across] > low[box, across] + TOLERANCE_MM)
        ).all(axis=1)
        before = (low[box, axis] - high[:, axis])[beside]
        behind = (low[:, axis] - high[box, axis])[beside]
        for gaps in (before, behind):
            ahead = gaps[gaps > -TOLERANCE_MM]
            ways.append(float(ahead.min()) if len(ahead) else math.inf)
    return ways[0], ways[1], ways[2], ways[3]


def _turns(draft: Draft, rules: Rules, near: Sequence[int]) -> Iterator[Proposal]:
    """Turns of boxes about their middles, and about one of their corners."""
    turns: list[Turn] = []
    for box in near:
        x, y = draft.corner_mm[box, :2].tolist()
        length, width = draft.size_mm[box, :2].tolist()
        if abs(length - width) <= TOLERANCE_MM:
            continue
        more_x, more_y = x + length - width, y + width - length
        middle = round((x + more_x) / 2, 1), round((y + more_y) / 2, 1)
        corners = dict.fromkeys((middle, (x, y), (more_x, y), (x, more_y), (more_x, more_y)))
        turns += [Turn(box, *corner) for corner in corners]
    boxes = np.array([turn.box for turn in turns], np.intp)
    corner = np.array([(turn.x_mm, turn.y_mm, draft.corner_mm[turn.box, 2]) for turn in turns]).reshape(-1, 3)
    places = Places(
        boxes[:, None],
        corner[:, None],
        draft.size_mm[boxes][:, None, [1, 0, 2]],
        ~draft.turned[boxes][:, None],
        draft.rank[boxes][:, None],
    )
    for turn, is_allowed in zip(turns, rules.allow_places(draft, places).tolist(), strict=True):
        if is_allowed:
            yield (turn,)


def _exchanges(draft: Draft, rules: Rules, near: Sequence[int], done: Collection[int]) -> Iterator[Proposal]:
    """Exchanges of each box of ``near`` with any other box that is not in ``done``. For a pair of boxes, each of the
    two may be turned by 90° or not. If a box is not as large as the box whose place it takes, there are two proposals:
    both boxes stand at the low x and y, or both at the high x and y, of their new places."""
    others = [other for other in draft.order if rules.built <= other < draft.plan.n_boxes and other not in done]
    pairs = [(box, other) for box in near for other in others if other != box and (other not in near or other > box)]
    places, turns = _exchanged_places(draft, np.array(pairs, np.intp).reshape(-1, 2))
    for k in np.flatnonzero(rules.allow_places(draft, places)).tolist():
        (box, other), (corner, other_corner) = places.boxes[k].tolist(), places.corner_mm[k]
        turned, other_turned = places.turned[k].tolist()
        turn, other_turn = turns[k].tolist()
        corners = _triple(corner), _triple(other_corner)
        yield (Exchange(box, other, corners, (turned, other_turned), (turn, other_turn)),)


def _exchanged_places(draft: Draft, pairs: IntArray) -> tuple[Places, BoolArray]:
    """The places of pairs of boxes after their exchange, and (k, 2) whether each of the two boxes is turned by the
    exchange. Three kinds of exchanges are left out: exchanges of boxes of equal sizes and nearly equal masses;
    exchanges of boxes of different heights, if a box stands on one of them; and exchanges of boxes whose lengths or
    widths are too different. ``pairs``: (p, 2) numbers of the boxes."""
    size, mass = draft.size_mm[pairs], draft.mass_kg[pairs]
    differ = np.abs(size[:, 0] - size[:, 1])
    uneven = differ[:, 2] > TOLERANCE_MM
    # If boxes of different heights are exchanged, a box on top of one of them would float or overlap.
    is_possible = ~uneven | draft.is_bare[pairs].all(axis=1)
    alike = (differ <= TOLERANCE_MM).all(axis=1) & (np.abs(mass[:, 0] / mass[:, 1] - 1) < 0.01)
    pairs = pairs[is_possible & ~alike]
    # Axes of these arrays: (1) pair; (2) which of its two boxes are turned; (3) low or high end of the new places, at
    # which both boxes then stand; (4) box of the pair; (5) x, y and z.
    turns = np.array([[False, False], [False, True], [True, False], [True, True]])[:, None]
    before, size = draft.size_mm[pairs][:, None, None], draft.size_mm[pairs][:, None, None]
    size = np.where(turns[..., None], size[..., [1, 0, 2]], size)
    spare = before[..., ::-1, :] - size
    lack, longest = -spare[..., :2].min(axis=(-2, -1)), size[..., :2].max(axis=(-2, -1))
    is_chosen = (lack <= longest / 2) & ~(turns & (size[..., 0] == size[..., 1])).any(axis=-1)
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]])[:, None]
    corner = draft.corner_mm[pairs][:, None, None, ::-1] + ends * spare
    pair, way = np.nonzero(is_chosen[..., 0])
    boxes = np.repeat(pairs[pair], len(ends), axis=0)
    turn = np.repeat(turns[way, 0], len(ends), axis=0)
    places = Places(
        boxes,
        corner[pair, way].reshape(-1, 2, 3),
        np.repeat(size[pair, way, 0], len(ends), axis=0),
        draft.turned[boxes] != turn,
        draft.rank[boxes[:, ::-1]],
    )
    return places, turn


def _size(draft: Draft, box: int, turn: bool) -> FloatArray:
    """(3,) extents of a box, turned by 90° or not, mm."""
    size = draft.size_mm[box]
    extents: FloatArray = size[[1, 0, 2]] if turn else size
    return extents


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _places(draft: Draft, rules: Rules, near: Sequence[int]) -> Iterator[Proposal]:
    """Proposals of other places for boxes. A box with a free top is placed at the same time as before, or last. A
    floating box is put where it would come to lie. Any other box is put elsewhere together with all boxes that have no
    other support."""
    places: list[Place] = []
    for box in near:
        is_bare = draft.is_bare[box]
        pile = [box] if is_bare else lifted_with(draft, box)
        others = [number for number in draft.order if number not in pile]
        is_fixed = len(pile) > MOST_TOGETHER or min(pile) < rules.built or max(pile) >= draft.plan.n_boxes
        if not is_bare and (is_fixed or not others):
            continue
        below = draft if is_bare else draft.in_order(tuple(others))
        planned = draft.corner_mm[box].tolist()
        for turn, corner in resting_corners(below, rules, box, turns=(False, True) if is_bare else (False,)):
            if is_bare and not turn and max(map(abs, map(sub, planned, corner))) <= TOLERANCE_MM:
                continue  # to place the box at its own place at another time is a change of order, not of place
            turned = bool(draft.turned[box]) != turn
            for last in (None, *others[-1:]):
                places.append(Place(box, corner, turned, last, differs=turn, others=tuple(sorted(pile[1:]))))
    for place, is_allowed in zip(places, rules.allow_places(draft, _places_of(draft, places)).tolist(), strict=True):
        if is_allowed:
            yield (place,)


def _places_of(draft: Draft, places: Sequence[Place]) -> Places:
    """The places that boxes have after each of several changes. If the changes concern different numbers of boxes, some
    boxes are listed more than once, so that all rows have the same length."""
    most = max((len(place.boxes) for place in places), default=1)
    boxes = np.array([place.boxes + place.boxes[:1] * (most - len(place.boxes)) for place in places], np.intp)
    boxes = boxes.reshape(-1, most)
    corner = np.array([place.corner_mm for place in places]).reshape(-1, 3)
    way = corner - draft.corner_mm[boxes[:, 0]]
    size, turned, rank = draft.size_mm[boxes], draft.turned[boxes], draft.rank[boxes]
    is_box = boxes == boxes[:, :1]
    turns = is_box & np.array([place.differs for place in places], bool)[:, None]
    last = np.array([np.nan if place.neighbour is None else draft.rank[place.neighbour] for place in places])[:, None]
    # The boxes of a change are placed directly after ``place.neighbour``, and in the same order among themselves as
    # before.
    in_turn = 1 + rank / len(draft.order)
    return Places(
        boxes,
        draft.corner_mm[boxes] + way[:, None],
        np.where(turns[..., None], size[..., [1, 0, 2]], size),
        turned ^ turns,
        np.where(np.isnan(last), rank, last + in_turn / 2),
    )


def resting_corners(
    draft: Draft, rules: Rules, box: int, below: int | None = None, turns: Sequence[bool] = (False, True)
) -> Iterator[Spot]:
    """The places at which a box can rest on the carrier or on other boxes.

    Args:
        below: number of the box below which the place must be; None if no box may be above the place.
        turns: whether the box is turned, for each orientation to be tried.
    """
    other_boxes = np.array([number for number in draft.order if number not in (box, below)], int)
    low, high = draft.corner_mm[other_boxes], draft.high_mm[other_boxes]
    ceiling = math.inf if below is None else float(draft.corner_mm[below, 2])
    lower = low[:, 2] < ceiling - TOLERANCE_MM
    low, high = low[lower], high[lower]

    def fits(z: FloatArray) -> BoolArray:
        """Whether each height ``z`` of the box's bottom, mm, is allowed: the box's top is low enough or, if the box
        must be under the box ``below``, its top reaches exactly to the bottom of that box."""
        if below is None:
            return np.asarray(z + draft.size_mm[box, 2] <= rules.high_mm[2] + TOLERANCE_MM)
        return np.asarray(np.abs(z + draft.size_mm[box, 2] - ceiling) <= TOLERANCE_MM)

    if not fits(np.append(high[:, 2], 0.0)).any():
        return
    for turn in turns:
        size = _size(draft, box, turn)
        if turn and size[0] == size[1]:
            continue
        base, least, most = size[:2], rules.low_mm[:2], rules.high_mm[:2]
        corners = [[least, most - base, draft.corner_mm[box, :2]], high[:, :2], low[:, :2] - base, low[:, :2]]
        if below is not None:
            edge, length = draft.corner_mm[below, :2], draft.size_mm[below, :2]
            corners.append([edge, edge + length - base, edge + (length - base) / 2])
        values = np.concatenate(corners)
        inside = (values >= least - TOLERANCE_MM) & (values + base <= most + TOLERANCE_MM)
        axes = []
        for along, is_inside in zip(values.round(1).T, inside.T, strict=True):
            along = np.sort(along[is_inside])
            is_new = np.ones(len(along), bool)
            np.not_equal(along[1:], along[:-1], out=is_new[1:])
            axes.append(along[is_new])  # as ``numpy.unique`` does, in half of the time
        spots: set[tuple[float, float, float]] = set()
        for x, y, z in _rests(axes[0], axes[1], size, low, high, fits):
            is_below = below is None or _shared_mm2(x, y, size, draft.corner_mm[below], draft.size_mm[below]) > 0
            spot = (x // SPOT_MM, y // SPOT_MM, z)
            if is_below and spot not in spots:
                spots.add(spot)
                yield turn, (x, y, z)
            if len(spots) == MOST_PLACES:
                break


def _rests(
    x: FloatArray,
    y: FloatArray,
    size: FloatArray,
    low: FloatArray,
    high: FloatArray,
    fits: Callable[[FloatArray], BoolArray],
) -> Iterator[tuple[float, float, float]]:
    """Corners at which a box would rest on others or on the carrier with at least the share ``LEAST_SUPPORT`` of its
    base. The lowest corners come first, and at each height those with the largest support.

    Args:
        x, y: where the corner may be, mm.
        low, high: (n, 3) corners of the boxes that may be under the placed box.
        fits: which heights are allowed.
    """
    if not (len(x) and len(y)):
        return
    shared = [
        np.minimum(begin[:, None] + length, high[:, axis]) - np.maximum(begin[:, None], low[:, axis])
        for axis, (begin, length) in enumerate(((x, size[0]), (y, size[1])))
    ]
    # At each point, the placed box lies as high as the highest top below it: the top of a box, or of the carrier (0).
    # The points at which a box is below the placed box form a rectangle.
    under = [some > TOLERANCE_MM for some in shared]
    (begin_x, end_x), (begin_y, end_y) = (
        (begin.tolist(), (begin + some.sum(axis=0)).tolist()) for some in under for begin in [some.argmax(axis=0)]
    )
    z = np.zeros((len(x), len(y)))
    for box in np.argsort(high[:, 2], kind="stable").tolist():
        z[begin_x[box] : end_x[box], begin_y[box] : end_y[box]] = high[box, 2]
    for height in np.unique(z[fits(z)]).tolist():
        at_x, at_y = np.nonzero(z == height)
        share = np.ones(len(at_x))
        if height > 0:
            bears = np.abs(high[:, 2] - height) <= TOLERANCE_MM
            along_x, along_y = (np.where(some[:, bears] > TOLERANCE_MM, some[:, bears], 0.0) for some in shared)
            # rounded, so that the order of places with equal shares does not depend on rounding errors
            share = (along_x @ along_y.T / (size[0] * size[1]))[at_x, at_y].round(9)
        chosen = np.argsort(-share, kind="stable")
        chosen = chosen[: np.count_nonzero(share >= LEAST_SUPPORT)]
        yield from zip(x[at_x[chosen]].tolist(), y[at_y[chosen]].tolist(), itertools.repeat(height))


def _shared_mm2(x: float, y: float, size: FloatArray, corner: FloatArray, other: FloatArray) -> float:
    """Area by which a box with its corner at a point overlaps another box, seen from above, mm². ``corner`` and
    ``other`` are the corner and the size of the other box."""
    shared_x = min(x + size[0], corner[0] + other[0]) - max(x, corner[0])
    shared_y = min(y + size[1], corner[1] + other[1]) - max(y, corner[1])
    return float(max(shared_x, 0.0) * max(shared_y, 0.0))


def _props(draft: Draft, rules: Rules, target: Target) -> Iterator[Proposal]:
    """Boxes with free tops are put under the overhang of a box, before this box is placed."""
    free = draft.is_bare
    sizes, mass_kg = draft.size_mm.tolist(), draft.mass_kg.tolist()
    last_of: dict[tuple[float, ...], int | None] = {}  # of several equal boxes, only the last is moved
    for box in draft.order:
        is_free = free[box] and box != target.box and rules.built <= box < draft.plan.n_boxes
        alike = (*sizes[box], mass_kg[box])
        last_of[alike] = box if is_free else last_of.get(alike)
    for box in (last for last in last_of.values() if last is not None):
        for turn, corner in itertools.islice(resting_corners(draft, rules, box, target.box), MOST_PLACES // 2):
            turned = bool(draft.turned[box]) != turn
            yield (Place(box, corner, turned, target.box, after=False, differs=turn),)


def _sheets(draft: Draft, thick_mm: float, kg_m2: float) -> Iterator[Proposal]:
    """Proposals that add a tie sheet (a sheet between two layers), each at a height that no box crosses."""
    rows = list(draft.order)
    low, high = draft.corner_mm[rows], draft.high_mm[rows]
    for height in np.unique(np.round(high[:, 2], 1)).tolist():
        above = low[:, 2] >= height - TOLERANCE_MM
        if not above.any() or (~above & (high[:, 2] > height + TOLERANCE_MM)).any():
            continue
        under = ~above & (np.abs(high[:, 2] - height) <= TOLERANCE_MM)
        begin, end = low[under, :2].min(axis=0), high[under, :2].max(axis=0)
        size = (float(end[0] - begin[0]), float(end[1] - begin[1]), thick_mm)
        first = rows[int(np.flatnonzero(above)[0])]
        yield (Sheet((float(begin[0]), float(begin[1]), height), size, kg_m2, first),)


def lifted_with(draft: Draft, box: int) -> list[int]:
    """A box and all boxes that would lose their support without it, the supports first."""
    lifted = [box]
    order = np.array(draft.order)
    rests = (draft.corner_mm[order, 2] > TOLERANCE_MM) & draft.on_top[:, order].any(axis=0)
    remains = order != box
    while True:
        bare = remains & rests & ~draft.on_top[np.ix_(order[remains], order)].any(axis=0)
        if not bare.any():
            return lifted
        lifted += order[bare].tolist()
        remains &= ~bare


def _omissions(draft: Draft, rules: Rules, near: Sequence[int]) -> Iterator[Proposal]:
    """Omissions of boxes. Each box is left out together with all boxes that would lose their support without it."""
    for box in near:
        left = lifted_with(draft, box)
        if len(left) < len(draft.order) and min(left) >= rules.built:
            yield tuple(LeaveOut(number) for number in left)
