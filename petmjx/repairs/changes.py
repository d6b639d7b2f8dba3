"""Changes of a plan: their effect on a draft, their cost, and their descriptions in plain words.

The number of a box is its position in the packing order of the unchanged plan, from 0. Left is −x, right +x, front −y
and back +y.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import ClassVar, Final

import numpy as np

from petmjx.common.units import MM_PER_M
from petmjx.repairs.drafts import TOLERANCE_MM, Draft


class Kind(StrEnum):
    """Kinds of changes. Each kind of change can be forbidden."""

    ORDER = "order"
    MOVE = "move"
    TURN = "turn"
    PLACE = "place"
    EXCHANGE = "exchange"
    SHEET = "sheet"
    FILM = "film"
    LEAVE_OUT = "leave-out"


COST: Final = {
    Kind.ORDER: 0.8,
    Kind.MOVE: 1.0,
    Kind.TURN: 1.5,
    Kind.EXCHANGE: 2.0,
    Kind.PLACE: 2.0,
    Kind.SHEET: 3.0,
    Kind.FILM: 1.0,
    Kind.LEAVE_OUT: 20.0,
}
"""Cost of a change of each kind: an assumption about the work that the change causes. A change of the order costs
least. A box that is left out costs most, because it has to be shipped on another pallet."""

COST_PER_MM: Final = 0.002
"""Cost of a millimetre of a box's move, so that shorter moves are preferred: 100 mm count as a fifth of a change."""

COST_PER_TURN: Final = 0.25
"""Cost of a turn of film."""

COST_PER_BOX: Final = 0.1
"""Cost of each further box in the same move."""


@dataclass(frozen=True)
class Change(ABC):
    """One change of a plan."""

    kind: ClassVar[Kind]

    @abstractmethod
    def applied(self, draft: Draft) -> Draft | None:
        """The draft with this change; None if impossible. Whether the result is allowed is not checked."""

    @property
    @abstractmethod
    def words(self) -> str:
        """The change in plain words, such as "place box 14 before box 12"."""

    @property
    def boxes(self) -> tuple[int, ...]:
        """Numbers of the boxes that are changed."""
        return ()

    @property
    def named(self) -> tuple[int, ...]:
        """Numbers of the boxes that the words name."""
        return self.boxes

    @property
    def cost(self) -> float:
        """The cost of the change."""
        return COST[self.kind]


@dataclass(frozen=True)
class _OfBox(Change):
    """A change of one box."""

    box: int

    @property
    def boxes(self) -> tuple[int, ...]:
        return (self.box,)


@dataclass(frozen=True)
class Order(_OfBox):
    """A box is placed directly before, or after, another one."""

    kind: ClassVar[Kind] = Kind.ORDER
    neighbour: int
    after: bool = False

    def applied(self, draft: Draft) -> Draft | None:
        return draft.with_order(self.box, self.neighbour, after=self.after)

    @property
    def words(self) -> str:
        return f"place box {self.box} {'after' if self.after else 'before'} box {self.neighbour}"

    @property
    def named(self) -> tuple[int, ...]:
        return (self.box, self.neighbour)


@dataclass(frozen=True)
class Move(_OfBox):
    """A box is moved along x and y, perhaps together with boxes that stand on it, or are in its way."""

    kind: ClassVar[Kind] = Kind.MOVE
    dx_mm: float
    dy_mm: float
    others: tuple[int, ...] = ()

    def applied(self, draft: Draft) -> Draft | None:
        boxes = [box for box in self.boxes if box in draft.order]
        if self.box not in boxes:
            return None
        return draft.with_places(boxes, draft.corner_mm[boxes] + (self.dx_mm, self.dy_mm, 0.0), anew=False)

    @property
    def words(self) -> str:
        ways = _ways(self.dx_mm, self.dy_mm)
        together = f" together with {_boxes(self.others)}" if self.others else ""
        return f"move box {self.box}{together} by {ways}"

    @property
    def boxes(self) -> tuple[int, ...]:
        return (self.box, *self.others)

    @property
    def length_mm(self) -> float:
        """Length of the move, mm."""
        return float(np.hypot(self.dx_mm, self.dy_mm))

    @property
    def cost(self) -> float:
        return COST[self.kind] + COST_PER_MM * self.length_mm + COST_PER_BOX * len(self.others)


@dataclass(frozen=True)
class Turn(_OfBox):
    """A box is turned by 90° at its place. ``x_mm``, ``y_mm``: its front-left corner afterwards."""

    kind: ClassVar[Kind] = Kind.TURN
    x_mm: float
    y_mm: float

    def applied(self, draft: Draft) -> Draft | None:
        if self.box not in draft.order:
            return None
        corner = np.array([[self.x_mm, self.y_mm, draft.corner_mm[self.box, 2]]])
        return draft.with_turn(self.box, not draft.turned[self.box]).with_places([self.box], corner)

    def way_mm(self, draft: Draft) -> tuple[float, float]:
        """The way of the box's corner along x and y, from its place in a draft to its place after the turn, mm."""
        x, y = draft.corner_mm[self.box, :2].tolist()
        return self.x_mm - x, self.y_mm - y

    def shift_mm(self, draft: Draft) -> tuple[float, float]:
        """The part of the way that is more than the turn needs, along x and y, mm: (0, 0) if the box is turned about
        its middle or about one of its corners. A turn that became one change with a move has such a part."""
        length, width = draft.size_mm[self.box, :2].tolist()
        x, y = self.way_mm(draft)
        low, high = sorted((0.0, length - width))
        return x - min(max(x, low), high), y - min(max(y, -high), -low)

    @property
    def words(self) -> str:
        return f"turn box {self.box} by 90°: its front-left corner is then at x {_mm(self.x_mm)}, y {_mm(self.y_mm)} mm"


@dataclass(frozen=True)
class Place(_OfBox):
    """A box gets another place, and perhaps another orientation, together with the boxes on it (``others``). All these
    boxes are then placed directly after, or directly before, another box in packing order."""

    kind: ClassVar[Kind] = Kind.PLACE
    corner_mm: tuple[float, float, float]
    turned: bool
    neighbour: int | None = None
    after: bool = True
    differs: bool = False
    others: tuple[int, ...] = ()

    def applied(self, draft: Draft) -> Draft | None:
        boxes = self.boxes
        moved = [box for box in draft.order if box in boxes]
        if self.box not in moved or self.neighbour in moved:
            return None
        way = np.array(self.corner_mm) - draft.corner_mm[self.box]
        draft = draft.with_turn(self.box, self.turned).with_places(moved, draft.corner_mm[moved] + way)
        if self.neighbour is None:
            return draft
        if self.neighbour not in draft.order:
            return None
        other_boxes = [box for box in draft.order if box not in moved]
        at = other_boxes.index(self.neighbour) + int(self.after)
        return draft.in_order((*other_boxes[:at], *moved, *other_boxes[at:]))

    @property
    def words(self) -> str:
        x, y, z = map(_mm, self.corner_mm)
        turn = ", turned by 90°" if self.differs else ""
        stand = "stands" if len(self.others) == 1 else "stand"
        on_it = f", with {_boxes(self.others)}, which {stand} on it," if self.others else ""
        time_text = "" if self.neighbour is None else f", {'after' if self.after else 'before'} box {self.neighbour}"
        return f"put box {self.box}{on_it} at x {x}, y {y}, z {z} mm{turn}{time_text}"

    @property
    def boxes(self) -> tuple[int, ...]:
        return (self.box, *self.others)

    @property
    def named(self) -> tuple[int, ...]:
        return self.boxes if self.neighbour is None else (*self.boxes, self.neighbour)

    @property
    def cost(self) -> float:
        return COST[self.kind] + COST_PER_BOX * len(self.others)


@dataclass(frozen=True)
class Exchange(Change):
    """Two boxes exchange their places, and their positions in the packing order.

    Attributes:
        corners_mm: the new corner of each of the two boxes.
        turned: whether each of the two is turned by 90° from its orientation in the plan, after the exchange.
        differ: whether each of the two is turned by the exchange.
    """

    kind: ClassVar[Kind] = Kind.EXCHANGE
    first: int
    second: int
    corners_mm: tuple[tuple[float, float, float], tuple[float, float, float]]
    turned: tuple[bool, bool]
    differ: tuple[bool, bool] = (False, False)

    def applied(self, draft: Draft) -> Draft | None:
        if self.first not in draft.order or self.second not in draft.order:
            return None
        for box, turned in zip(self.boxes, self.turned, strict=True):
            draft = draft.with_turn(box, turned)
        swap = {self.first: self.second, self.second: self.first}
        draft = draft.with_places(self.boxes, np.array(self.corners_mm))
        return draft.in_order(tuple(swap.get(box, box) for box in draft.order))

    @property
    def words(self) -> str:
        turned = [box for box, differs in zip(self.boxes, self.differ, strict=True) if differs]
        turns = f", with {_boxes(turned)} turned" if turned else ""
        return f"exchange boxes {self.first} and {self.second}, also in the packing order{turns}"

    @property
    def boxes(self) -> tuple[int, ...]:
        return (self.first, self.second)


@dataclass(frozen=True)
class Sheet(Change):
    """A tie sheet is laid between two layers. All boxes above the sheet are raised by its thickness."""

    kind: ClassVar[Kind] = Kind.SHEET
    corner_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    kg_m2: float
    before: int

    def applied(self, draft: Draft) -> Draft | None:
        mass_kg = self.kg_m2 * self.size_mm[0] * self.size_mm[1] / MM_PER_M**2
        return draft.with_sheet(np.array(self.size_mm), np.array(self.corner_mm), mass_kg, self.before)

    @property
    def words(self) -> str:
        x, y, thick = map(_mm, self.size_mm)
        height = _mm(self.corner_mm[2])
        return f"lay a tie sheet of {x} × {y} × {thick} mm at the height {height} mm, before box {self.before}"

    @property
    def named(self) -> tuple[int, ...]:
        return (self.before,)


@dataclass(frozen=True)
class Film(Change):
    """The pallet is wrapped with stretch film before it is moved."""

    kind: ClassVar[Kind] = Kind.FILM
    turns: float

    def applied(self, draft: Draft) -> Draft:
        return replace(draft, film_turns=self.turns)

    @property
    def words(self) -> str:
        return f"wrap the pallet with {self.turns:g} turn{'' if self.turns == 1 else 's'} of film"

    @property
    def cost(self) -> float:
        return COST[self.kind] + COST_PER_TURN * self.turns


@dataclass(frozen=True)
class LeaveOut(_OfBox):
    """A box is left out."""

    kind: ClassVar[Kind] = Kind.LEAVE_OUT

    def applied(self, draft: Draft) -> Draft | None:
        return draft.without(self.box)

    @property
    def words(self) -> str:
        return f"leave out box {self.box}"


def applied(draft: Draft, changes: Sequence[Change]) -> Draft | None:
    """The draft with all changes, in order; None if a change is impossible."""
    for change in changes:
        if (changed := change.applied(draft)) is None:
            return None
        draft = changed
    return draft


def with_turns_told(draft: Draft, changes: Sequence[Change]) -> tuple[Change, ...]:
    """The changes of a draft, in which each change says which boxes it turns. A change may turn other boxes than when
    it was proposed, because the search may have dropped an earlier change that turned the same box
    (``with_change``)."""
    told: list[Change] = []
    for change in changes:
        if isinstance(change, Place):
            change = replace(change, differs=bool(draft.turned[change.box]) != change.turned)
        elif isinstance(change, Exchange):
            first, second = (bool(draft.turned[box]) for box in change.boxes)
            change = replace(change, differ=(first != change.turned[0], second != change.turned[1]))
        told.append(change)
        draft = change.applied(draft) or draft
    return tuple(told)


def with_change(changes: Sequence[Change], change: Change, start: Draft) -> tuple[Change, ...]:
    """A list of changes with one more change. A move becomes part of an earlier change of the same boxes, and a turn
    becomes part of an earlier turn or place of the same box. Of two changes of a box's order, only the second one is
    kept. If a box is put elsewhere or left out, its earlier changes are dropped. Two changes that cancel out are both
    dropped. Applying the returned list may give another draft than applying all changes in turn, because a later change
    of other boxes may depend on a dropped change.

    Args:
        start: the draft to which the changes are applied.
    """
    for at in reversed(range(len(changes))):
        earlier, others = changes[at], (*changes[:at], *changes[at + 1 :])
        if isinstance(change, Order) and isinstance(earlier, Order) and earlier.box == change.box:
            return (*others, change)
        if isinstance(change, Move) and (joined := _moved(earlier, change)) is not None:
            cancels = isinstance(joined, Move) and not joined.length_mm
            return others if cancels else (*changes[:at], joined, *changes[at + 1 :])
        if isinstance(change, Turn) and earlier.boxes == change.boxes:
            if isinstance(earlier, Turn) and (before := applied(start, others)) is not None:
                move = Move(change.box, *change.way_mm(before))
                return with_change(others, move, start) if move.length_mm else others
            if isinstance(earlier, Place) and (before := applied(start, changes)) is not None:
                dx_mm, dy_mm = change.way_mm(before)
                turned = replace(_shifted(earlier, dx_mm, dy_mm), turned=not earlier.turned)
                return (*changes[:at], turned, *changes[at + 1 :])
    if isinstance(change, Film):
        return (*(old for old in changes if old.kind is not Kind.FILM), change)
    if isinstance(change, Place | LeaveOut):
        changes = [old for old in changes if old.boxes != change.boxes]
    return (*changes, change)


def _moved(change: Change, move: Move) -> Change | None:
    """A change and a later move of the same boxes, as one change; None if the two are of different boxes, or cannot be
    one change."""
    if change.boxes != move.boxes:
        return None
    if isinstance(change, Move):
        return replace(change, dx_mm=change.dx_mm + move.dx_mm, dy_mm=change.dy_mm + move.dy_mm)
    if isinstance(change, Place):
        return _shifted(change, move.dx_mm, move.dy_mm)
    if isinstance(change, Turn):
        return replace(change, x_mm=change.x_mm + move.dx_mm, y_mm=change.y_mm + move.dy_mm)
    return None


def _shifted(place: Place, dx_mm: float, dy_mm: float) -> Place:
    x, y, z = place.corner_mm
    return replace(place, corner_mm=(x + dx_mm, y + dy_mm, z))


def longest_move_mm(changes: Sequence[Change], start: Draft) -> float:
    """Largest distance along x or along y by which a box is moved by all changes together, mm. A turn counts as a move,
    too, if it does not leave the box at its place (``Turn.shift_mm``).

    Args:
        start: the draft to which the changes are applied.
    """
    ways: dict[int, tuple[float, float]] = {}
    for number, change in enumerate(changes):
        if isinstance(change, Move):
            dx, dy = change.dx_mm, change.dy_mm
        elif isinstance(change, Turn) and (before := applied(start, changes[:number])) is not None:
            dx, dy = change.shift_mm(before)
        else:
            continue
        for box in change.boxes:
            x, y = ways.get(box, (0.0, 0.0))
            ways[box] = x + dx, y + dy
    return max((max(abs(x), abs(y)) for x, y in ways.values()), default=0.0)


def cost_of(changes: Sequence[Change]) -> float:
    """The cost of several changes."""
    return sum(change.cost for change in changes)


def _ways(dx_mm: float, dy_mm: float) -> str:
    """The displacement of a box in words, such as "22 mm to the left and 5 mm to the back"."""
    ways = []
    for length, negative_side, positive_side in ((dx_mm, "left", "right"), (dy_mm, "front", "back")):
        if abs(length) > 0:
            ways.append(f"{_mm(abs(length))} mm to the {negative_side if length < 0 else positive_side}")
    return " and ".join(ways)


def _boxes(numbers: Sequence[int]) -> str:
    """ "box 3", or "boxes 3, 5 and 7"."""
    *most, last = map(str, numbers)
    return f"boxes {', '.join(most)} and {last}" if most else f"box {last}"


def _mm(length: float) -> str:
    """A length in mm as a text with at most one decimal, as in plans."""
    rounded = round(length, 1) + 0.0
    return f"{rounded:.0f}" if abs(rounded - round(rounded)) < TOLERANCE_MM / 10 else f"{rounded:.1f}"
