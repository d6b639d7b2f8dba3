"""Online packing (``ItemStream``): boxes arrive one by one, and a packer sees only the next box or the next few."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.height_map import HeightMap
from petmjx.packers.packing_state import NextCandidate, Packing, Preferences
from petmjx.packers.pile_balance import Balance
from petmjx.plans.order import Item

MOST_LOOK_AHEAD: Final = 200


class Places(NamedTuple):
    """c candidates for the next box. Each candidate is a box that the packer sees, at a place on the pile.

    Attributes:
        point, shape: (c,) row and column of each candidate in the packing's table of candidates.
        kind: (c,) number of the kind of box.
        corner_mm: (c, 3) lowest corner of the box, mm.
        size_mm: (c, 3) size of the box along x, y and z, including the free space along x and y, mm.
        mass_kg: (c,) mass of the box, kg.
        support: (c,) supported share of the box's base.
        own_mm2: (c,) area of the box's base without free space, mm².
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
        """The candidates in the given rows."""
        row_values: list[Any] = [values[rows] for values in self]
        return Places(*row_values)


class ItemStream(Packing):
    """A packing, and the boxes that are still to arrive. Candidates are rated with the first set of weights that the
    packer ``balanced`` tries.

    Attributes:
        clearance: (3,) free space that a box needs along x, y and z, mm.
        surface: height map of the boxes placed so far.
        skipped: number of boxes left out so far.

    Args:
        items: items of one order, in order of arrival.
        extent_mm: length and width of the target, mm.
        clearance_mm: free space between a box and its neighbours along x and y, mm.
        look_ahead: number of boxes that the packer sees at a time. Any of the boxes that the packer sees may be placed
            next.
    """

    def __init__(
        self,
        items: Sequence[Item],
        extent_mm: tuple[float, float],
        clearance_mm: float = 0.0,
        look_ahead: int = 1,
    ) -> None:
        super().__init__(items, extent_mm, Preferences(), clearance_mm)
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
        """An independent copy of the stream."""
        twin = super().copy()
        twin._coming, twin._masses, twin.surface = list(self._coming), self._masses.copy(), self.surface.copy()
        return twin

    @property
    def seen(self) -> list[int]:
        """Numbers of the kinds of the boxes that the packer sees, in order of arrival."""
        return self._coming[: self.look_ahead]

    @property
    def boxes(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) lowest and (n, 3) highest corners of the placed boxes including the free space along x and y, mm."""
        return self._table.placed

    @property
    def bare_boxes(self) -> tuple[FloatArray, FloatArray]:
        """(n, 3) lowest and (n, 3) highest corners of the placed boxes without free space, mm."""
        low, high = self._table.placed
        return low, high - self.clearance

    @property
    def masses(self) -> FloatArray:
        """(n,) masses of the placed boxes, kg."""
        return self._masses[: len(self.placed)]

    def worth(self, places: Places) -> FloatArray:
        """(c,) value of each candidate's box, whatever its place, mm. The value is subtracted from the cost of the
        place, as in the packer ``balanced``."""
        worths: FloatArray = self._worth[places.shape]
        return worths

    @property
    def pile(self) -> Balance:
        """The static balance of the placed boxes."""
        return self._pile

    def put(self, chosen: NextCandidate) -> None:
        """Place the box of a candidate."""
        self._coming.remove(int(self._kind_of[chosen.shape]))
        super().put(chosen)
        low, high = self.boxes
        self.surface.put(low[-1], high[-1])
        self._masses[len(low) - 1] = self.placed[-1].item.weight_kg

    def skip(self) -> None:
        """Leave out the next box."""
        kind = self._coming.pop(0)
        self.skipped += 1
        # equal boxes have the same candidates, so it does not matter which of the equal boxes is removed
        self._stock[kind].pop(0)
        if not self._stock[kind]:
            self._keep_shapes(self._kind_of != kind)


S = TypeVar("S", bound=ItemStream)

Chooses = Callable[[S], NextCandidate | None]
"""A function that makes one step of a packer: it returns the chosen candidate, or None if there is no place for any box
that the packer sees."""


def pack_stream(stream: S, chooses: Chooses[S]) -> list[PlacedBox]:
    """Place the boxes of a stream until no box is left. If there is no place for any box that the packer sees, the
    first of these boxes is left out."""
    while stream.seen:
        chosen = chooses(stream)
        if chosen is None:
            stream.skip()
        else:
            stream.put(chosen)
    return stream.placed


def by_taste(stream: ItemStream) -> NextCandidate | None:
    """Choose the candidate that the packer ``balanced`` would choose if the order had only the boxes that the packer
    sees now."""
    candidates = stream.next(1, kinds=stream.seen)
    return candidates[0] if candidates else None
