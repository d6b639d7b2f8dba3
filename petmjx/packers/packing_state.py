"""The state of a growing packing (``Packing``): the placed boxes, the remaining items, and the candidates for the next
box.

A candidate is a shape (a kind of box in one orientation) at a corner point of the pile. A packing can be copied, so
that a search can extend the same packing in several ways.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.packers.baseline_packer import MAX_HEIGHT_MM, PlacedBox
from petmjx.packers.candidate_points import Candidates
from petmjx.packers.fill_interface import Count, Number
from petmjx.packers.pile_balance import SHARE_SLACK, TOUCH_MM, Balance, Rest
from petmjx.plans.order import Item

LEAST_SUPPORT: Final = 0.5
"""Smallest supported share of a base. The static balance of the pile mainly decides whether a box is supported well
enough; ``LEAST_SUPPORT`` also limits the box's overhang."""


@dataclass(frozen=True)
class Preferences:
    """The preferences of a packer: the values and costs with which candidates are rated. Values and costs are in mm of
    height: a cost of 1 mm has the same effect as a place that is 1 mm higher.

    Attributes:
        per_base_side: value per mm of the square root of the base area.
        per_log_weight: value per unit of the natural logarithm of the weight in kg, mm.
        per_height: value per mm of the box's height.
        per_overhang: cost of a base without any support, mm of height. A partly supported base costs ``per_overhang`` ×
            its unsupported share.
        per_distance: cost per mm of x + y of the candidate's corner. So, of equally good places, the place nearest to
            the target's corner is chosen.
    """

    per_base_side: float = 1.4
    per_log_weight: float = 40.0
    per_height: float = 0.25
    per_overhang: float = 40.0
    per_distance: float = 0.01


class NextCandidate(NamedTuple):
    """A candidate for the next box: number of the corner point, number of the shape, lowest corner of the box in mm,
    and effect of the box on the balance."""

    point: int
    shape: int
    corner_mm: tuple[float, float, float]
    rest: Rest


class FullPacking(NamedTuple):
    """A packing in which there is no place for any more boxes. The fields of ``FullPacking`` have the same meanings
    as in ``Packing``."""

    placed: tuple[PlacedBox, ...]
    top_mm: float
    volume_m3: float
    moment_kg_mm: float


class Packing:
    """The placed boxes on a target, and the remaining items.

    Attributes:
        n_items: number of boxes in the order.
        extent_mm: length and width of the target, mm, each plus ``clearance_mm``. The larger extent is needed because
            the base of each box includes free space, although the last box of a row needs no free space behind it.
        placed: placed boxes in packing order. Placed boxes refer to the same objects as ``items``.
        top_mm: height of the highest top, mm.
        volume_m3: volume of the placed boxes, m³.
        moment_kg_mm: sum of mass × height of the middle over all placed boxes, kg·mm. Of two equally high packings, the
            packing with the smaller moment stands better.

    Args:
        items: items of one order.
        extent_mm: length and width of the target, mm.
        preferences: values and costs with which candidates are rated.
        clearance_mm: free space between a box and its neighbours along x and y, mm.
    """

    _Table: ClassVar[type[Candidates]] = Candidates

    def __init__(
        self, items: Sequence[Item], extent_mm: tuple[float, float], preferences: Preferences, clearance_mm: float = 0.0
    ) -> None:
        kinds: dict[Item, list[Item]] = {}
        for item in items:
            kinds.setdefault(item, []).append(item)
        self.n_items = len(items)
        self.placed: list[PlacedBox] = []
        self.top_mm = self.volume_m3 = self.moment_kg_mm = 0.0
        self._stock = [list(reversed(same)) for same in kinds.values()]
        shapes = [
            (kind, orientation)
            for kind, item in enumerate(kinds)
            for orientation in ((0, 1) if item.length_mm != item.width_mm else (0,))
        ]
        firsts = list(kinds)
        self._kind_of, self._turned = np.array(shapes, dtype=np.intp).reshape(-1, 2).T
        sizes = np.array([_size(firsts[kind], turned) for kind, turned in shapes], dtype=np.float64).reshape(-1, 3)
        self._weight = np.array([firsts[kind].weight_kg for kind in self._kind_of])
        self._worth = _worth(sizes, self._weight, preferences)
        self._preferences = preferences
        # In the table of candidates, a box's base includes its free space, and the target is larger by one free space.
        # In the balance, a base is only as large as the box, since free space supports nothing.
        self._base = sizes[:, :2]
        length, width = extent_mm
        self.extent_mm = (length + clearance_mm, width + clearance_mm)
        self._table = self._Table(self._base + clearance_mm, sizes[:, 2], self.extent_mm, len(items))
        self._pile = Balance(len(items))

    def copy(self) -> Self:
        """An independent copy of the packing."""
        twin = copy.copy(self)
        twin.placed, twin._stock = list(self.placed), [list(same) for same in self._stock]
        twin._table, twin._pile = self._table.copy(), self._pile.copy()
        return twin

    @property
    def n_shapes(self) -> int:
        """Number of shapes: kinds of remaining boxes × allowed orientations."""
        return len(self._kind_of)

    @property
    def grain_mm(self) -> float:
        """The largest power of two, at most 1 mm, that divides all sides and the free space."""
        sizes = np.concatenate([self._base.ravel(), self._table.base.ravel(), self._table.height])
        grain = 1.0
        while grain > 0 and (sizes % grain).any():
            grain /= 2
        return grain

    def next(self, count: int = 1, kinds: Sequence[int] | None = None) -> list[NextCandidate]:
        """The best candidates with which the pile stays in balance, best first.

        Args:
            count: largest number of candidates.
            kinds: numbers of the kinds of boxes that are considered. Kinds are numbered in the sequence of their first
                appearance in the items. If ``kinds`` is None, all kinds are considered.
        """
        table, weight = self._table, self._weight
        support = table.carried / table.area
        cost = table.z - self._worth + self._preferences.per_overhang * (1 - support)
        cost += self._preferences.per_distance * table.points.sum(axis=1)[:, None]
        fits = (table.z + table.height <= MAX_HEIGHT_MM + TOUCH_MM) & (support >= LEAST_SUPPORT - SHARE_SLACK)
        if kinds is not None:
            fits = fits & np.isin(self._kind_of, kinds)
        cost = np.where(table.open & fits, cost, np.inf)
        candidates: list[NextCandidate] = []
        while cost.size and len(candidates) < count:
            point, shape = divmod(int(cost.argmin()), len(weight))
            if cost[point, shape] == np.inf:
                break
            cost[point, shape] = np.inf
            corner = (*table.points[point].tolist(), float(table.z[point, shape]))
            width, depth = self._base[shape].tolist()
            rest = self._pile.rest(corner, (width, depth), float(weight[shape]))
            if rest is None:
                table.open[point, shape] = False
            else:
                candidates.append(NextCandidate(point, shape, corner, rest))
        return candidates

    def box(self, chosen: NextCandidate) -> PlacedBox:
        """The placed box that would result from a candidate of the last call of ``next``."""
        item = self._stock[int(self._kind_of[chosen.shape])][-1]
        return PlacedBox(item, int(self._turned[chosen.shape]), chosen.corner_mm)

    def put(self, chosen: NextCandidate) -> None:
        """Place the box of a candidate that the last call of ``next`` returned."""
        point, shape, corner, rest = chosen
        kind, height = int(self._kind_of[shape]), float(self._table.height[shape])
        self._pile.add(corner, (*self._base[shape].tolist(), height), rest)
        box = self.box(chosen)
        item = self._stock[kind].pop()
        self.placed.append(box)
        self.top_mm = max(self.top_mm, corner[2] + height)
        self.volume_m3 += item.volume_m3
        self.moment_kg_mm += item.weight_kg * (corner[2] + height / 2)
        self._table.place(point, shape)
        if not self._stock[kind]:
            self._keep_shapes(self._kind_of != kind)

    def fill(self, highest_mm: float = inf, most: float = inf) -> bool:
        """Place the best candidate repeatedly, until there is no candidate. Returns False if filling up was aborted.

        Args:
            highest_mm: height of a top, mm, above which filling up is aborted.
            most: largest number of boxes that are placed.
        """
        end = len(self.placed) + most
        while self.top_mm <= highest_mm:
            best = self.next() if len(self.placed) < end else []
            if not best:
                return True
            self.put(best[0])
        return False

    def filled(self, first: NextCandidate | None = None, highest_mm: float = inf) -> FullPacking | None:
        """Fill up a copy of this packing: place the best candidate repeatedly, until there is no candidate. Returns the
        full packing, or None if a top would be higher than ``highest_mm``.

        Args:
            first: candidate that is placed first, one of the candidates that the last call of ``next`` returned. If
                ``first`` is None, the best candidate is placed first.
            highest_mm: largest allowed height of a top, mm.
        """
        twin = self.copy()
        if first is not None:
            twin.put(first)
        if not twin.fill(highest_mm):
            return None
        return FullPacking(tuple(twin.placed), twin.top_mm, twin.volume_m3, twin.moment_kg_mm)

    def filled_with(self, shapes: Sequence[int], corners_mm: Sequence[Sequence[float]]) -> FullPacking:
        """The full packing that consists of this packing and boxes of the given shapes at the given corners, in this
        sequence."""
        placed, top, volume, moment = list(self.placed), self.top_mm, self.volume_m3, self.moment_kg_mm
        kinds, turned, heights = self._kind_of.tolist(), self._turned.tolist(), self._table.height.tolist()
        left = [len(same) for same in self._stock]
        for shape, (x, y, z) in zip(shapes, corners_mm, strict=True):
            kind, height = kinds[shape], heights[shape]
            left[kind] -= 1
            item = self._stock[kind][left[kind]]
            placed.append(PlacedBox(item, turned[shape], (x, y, z)))
            top = max(top, z + height)
            volume += item.volume_m3
            moment += item.weight_kg * (z + height / 2)
        return FullPacking(tuple(placed), top, volume, moment)

    def write(self, tables: Mapping[str, NDArray[Any]]) -> None:
        """Copy the packing into arrays with the layout of :mod:`petmjx.packers.fill_interface`."""
        shapes = self.n_shapes
        tables["own_base"][:shapes] = self._base
        tables["weight"][:shapes] = self._weight
        tables["worth"][:shapes] = self._worth
        tables["kind"][:shapes] = self._kind_of
        tables["stock"][: len(self._stock)] = [len(same) for same in self._stock]
        preferences = self._preferences
        numbers = tables["numbers"]
        numbers[Number.TOP], tables["counts"][Count.SHAPES] = self.top_mm, shapes
        numbers[Number.PER_OVERHANG], numbers[Number.PER_DISTANCE] = preferences.per_overhang, preferences.per_distance
        self._table.write(tables)
        self._pile.write(tables)

    def _keep_shapes(self, kept: NDArray[np.bool_]) -> None:
        self._table.keep_shapes(kept)
        self._kind_of, self._turned, self._base = self._kind_of[kept], self._turned[kept], self._base[kept]
        self._weight, self._worth = self._weight[kept], self._worth[kept]


def _size(item: Item, orientation: int) -> tuple[float, float, float]:
    base = (item.length_mm, item.width_mm)
    return (*(base if orientation == 0 else base[::-1]), item.height_mm)


def _worth(sizes: FloatArray, weight: FloatArray, preferences: Preferences) -> FloatArray:
    """(s,) for each shape, the part of a candidate's value that depends only on the shape, in mm of height
    (``Preferences``).

    Args:
        sizes: (s, 3) sizes of the shapes, mm.
        weight: (s,) weights of the shapes, kg.
        preferences: values and costs with which candidates are rated.
    """
    side = np.sqrt(sizes[:, 0] * sizes[:, 1])
    worth: FloatArray = (
        preferences.per_base_side * side
        + preferences.per_log_weight * np.log(weight)
        + preferences.per_height * sizes[:, 2]
    )
    return worth
