"""A packing whose boxes come one after the other. A packer sees the next one, or the next few, and no more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.height_map import HeightMap
from petmjx.packers.packing_state import NextCandidate, Packing, Taste
from petmjx.packers.pile_balance import Balance
from petmjx.plans.order_generator import Item

MOST_LOOK_AHEAD: Final = 200


class Places(NamedTuple):
    """c candidates for the boxes that are seen.

    Attributes:
        point, shape: (c,) row and column of the packing's table; ``kind``: (c,) of the box.
        corner_mm: (c, 3); ``size_mm``: (c, 3) with the free space along x and y.
        mass_kg: (c,).
        support: (c,) share of the base that is borne.
        own_mm2: (c,) area of the box's own base.
    """

    point: NDArray[np.intp]
    shape: NDArray[np.intp]
    kind: NDArray[np.intp]
    corner_mm: FloatArray
    size_mm: FloatArray
    mass_kg: FloatArray
    support: FloatArray
    own_mm2: FloatArray

    def __len__(self) -> int:
        return len(self.point)

    def take(self, rows: NDArray[np.intp]) -> Places:
        """Some of them."""
        some: list[Any] = [values[rows] for values in self]
        return Places(*some)


class ItemStream(Packing):
    """Boxes on a target, and those that are still to come.

    Attributes:
        clearance: (3,) free space of a box along x, y and z, mm.
        surface: heights of the pile.
        skipped: how many boxes were left out so far.

    Args:
        items: of one order, in the sequence in which they come.
        extent_mm: of the target, along x and y.
        clearance_mm: free space that each box keeps to its neighbours along x and y.
        look_ahead: how many of the boxes that come next are seen; any of them may be placed next.
    """

    def __init__(
        self,
        items: Sequence[Item],
        extent_mm: tuple[float, float],
        clearance_mm: float = 0.0,
        look_ahead: int = 1,
        taste: Taste | None = None,
    ) -> None:
        super().__init__(items, extent_mm, taste or Taste(), clearance_mm)
        self.look_ahead = look_ahead
        self.skipped = 0
        self._masses = np.zeros(len(items))
        self.surface = HeightMap(self.extent_mm)
        numbers: dict[Item, int] = {}
        for item in items:
            numbers.setdefault(item, len(numbers))
        self._coming = [numbers[item] for item in items]
        self.clearance = np.array([clearance_mm, clearance_mm, 0.0])

    def copy(self) -> Self:
        """The same stream, which goes its own way."""
        twin = super().copy()
        twin._coming, twin._masses, twin.surface = list(self._coming), self._masses.copy(), self.surface.copy()
        return twin

    @property
    def seen(self) -> list[int]:
        """The kinds of the boxes that are seen, in their sequence."""
        return self._coming[: self.look_ahead]

    @property
    def boxes(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) low and high corners of the boxes placed, with the free space along x and y, mm."""
        return self._table.placed

    @property
    def bare_boxes(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) low and high corners of the boxes placed, as they are, mm."""
        low, high = self._table.placed
        return low, high - self.clearance

    @property
    def masses(self) -> FloatArray:
        """(n,) of the boxes placed, kg."""
        return self._masses[: len(self.placed)]

    def worth(self, places: Places) -> FloatArray:
        """(c,) what the boxes of candidates are worth wherever they go, to the rule, mm."""
        worths: FloatArray = self._worth[places.shape]
        return worths

    @property
    def pile(self) -> Balance:
        """The balance of the boxes placed."""
        return self._pile

    def put(self, chosen: NextCandidate) -> None:
        """Place a candidate."""
        self._coming.remove(int(self._kind_of[chosen.shape]))
        super().put(chosen)
        low, high = self.boxes
        self.surface.put(low[-1], high[-1])
        self._masses[len(low) - 1] = self.placed[-1].item.weight_kg

    def skip(self) -> None:
        """Leave out the box that comes first."""
        kind = self._coming.pop(0)
        self.skipped += 1
        # equal boxes are the same to a packing; which of them is placed does not matter
        self._stock[kind].pop(0)
        if not self._stock[kind]:
            self._keep_shapes(self._kind_of != kind)


S = TypeVar("S", bound=ItemStream)

Chooses = Callable[[S], NextCandidate | None]
"""What a packer does in one step: one of the candidates, or None: no box that is seen has a place."""


def pack_stream(stream: S, chooses: Chooses[S]) -> list[PlacedBox]:
    """Place the boxes of a stream until none is left. When none that is seen has a place, the first one is left out."""
    while stream.seen:
        chosen = chooses(stream)
        if chosen is None:
            stream.skip()
        else:
            stream.put(chosen)
    return stream.placed


def by_taste(stream: ItemStream) -> NextCandidate | None:
    """What ``balanced`` would do if it saw no more than the stream shows."""
    candidates = stream.next(1, kinds=stream.seen)
    return candidates[0] if candidates else None
