"""Beam search for dense packings of an order, over the candidates of ``balanced``.

Every step extends each of ``width`` packings by its ``branch`` best candidates. To rate a candidate, the packing with
this candidate is filled up by best fit (the pilot method: Duin, Voß 1999, "The pilot method: a strategy for heuristic
repetition with application to the Steiner problem in graphs", Networks 34, 181–191). The best ``width`` packings are
kept. Filling up is aborted as soon as the packing is higher than all of the best ``width`` packings so far. In large
orders, a step places several boxes: the first one is the candidate, and the others follow by best fit.

The search is deterministic, and does not depend on computing time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from math import ceil, inf
from typing import Final, NamedTuple

from petmjx.common.machine import why_no_warp_on_cpu
from petmjx.packers.balanced_packer import TASTES
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.packing_state import FullPacking, NextCandidate, Packing, Taste
from petmjx.plans.order_generator import Item

MOST_STEPS: Final = 80
"""Largest number of steps of a search. With this limit, an order of 162 different boxes takes 12 s; without the limit,
34 s."""

_VOLUME_DECIMALS: Final = 9
"""Volumes in m³ are rounded to this many decimals, which is to a cubic millimetre. Sums over the same boxes in
different orders are then equal."""


class PackingValue(NamedTuple):
    """The value of a full packing. A larger value is better. The volume of the boxes counts first, then a low
    height."""

    volume_m3: float
    below_mm: float
    """Minus the height of the highest top."""
    deep_kg_mm: float
    """Minus the moment of the masses (mass × height). Of two equally high packings, the one with its masses lower
    stands better."""

    @classmethod
    def of(cls, filled: FullPacking) -> PackingValue:
        """The value of a full packing."""
        return cls(round(filled.volume_m3, _VOLUME_DECIMALS), -filled.top_mm, -filled.moment_kg_mm)


class RankedPacking(NamedTuple):
    """A full packing and its value."""

    worth: PackingValue
    placed: tuple[PlacedBox, ...]

    @property
    def height_mm(self) -> float:
        """The highest top, mm."""
        return -self.worth.below_mm


def search(
    items: Sequence[Item],
    extent_mm: tuple[float, float],
    clearance_mm: float,
    *,
    width: int,
    branch: int,
) -> RankedPacking:
    """The best packing of an order that the search finds.

    Args:
        items: items of the order.
        extent_mm: extent of the target, mm.
        clearance_mm: free space between a box and its neighbours along x and y.
        width: number of packings that each step keeps.
        branch: number of candidates tried for each packing.
    """
    best: RankedPacking | None = None
    for taste in TASTES:
        packing = _search(items, extent_mm, clearance_mm, taste, width, branch)
        if best is None or packing.worth > best.worth:
            best = packing
        if len(best.placed) == len(items):
            break
    assert best is not None
    return best


Fills = Callable[[Packing, NextCandidate | None, float], FullPacking | None]
"""A function that fills up a packing, with the arguments of ``Packing.filled``."""


def fills_for(start: Packing) -> Fills:
    """The function that fills up packings of an order. If Warp is installed, it is a compiled function, which gives the
    same packings.

    Args:
        start: the empty packing of the order.
    """
    if why_no_warp_on_cpu() is None:
        with suppress(Exception):  # Warp cannot be loaded, or cannot compile
            from petmjx.packers.compiled_fill import FillKernel

            return FillKernel(start)
    return Packing.filled


class _SearchNode(NamedTuple):
    """A packing that the next step may extend, and the full packing that filling it up gives."""

    packing: Packing
    filled: RankedPacking


class _SearchBranch(NamedTuple):
    """A packing, a candidate for its next box (None: the box is already placed), and the full packing made from
    both."""

    packing: Packing
    candidate: NextCandidate | None
    filled: RankedPacking

    def node(self) -> _SearchNode:
        """The node of this branch, with the candidate's box placed."""
        if self.candidate is None:
            return _SearchNode(self.packing, self.filled)
        packing = self.packing.copy()
        packing.put(self.candidate)
        return _SearchNode(packing, self.filled)


def _search(
    items: Sequence[Item], extent_mm: tuple[float, float], clearance_mm: float, taste: Taste, width: int, branch: int
) -> RankedPacking:
    start = Packing(items, extent_mm, taste, clearance_mm)
    fills = fills_for(start)
    first = _full_packing(fills, start)
    assert first is not None
    ways, best, stride = [_SearchNode(start, first)], first, ceil(len(items) / MOST_STEPS)
    while ways := _step(ways, width, branch, stride, fills):
        best = max(best, ways[0].filled, key=lambda packing: packing.worth)
    return best


def _step(ways: Sequence[_SearchNode], width: int, branch: int, stride: int, fills: Fills) -> list[_SearchNode]:
    """The best packings with ``stride`` further boxes, best first; empty if no further box can be placed."""
    best: list[_SearchBranch] = []
    seen_packings: set[frozenset[PlacedBox]] = set()
    for way in ways:
        before = frozenset(way.packing.placed)
        for number, candidate in enumerate(way.packing.next(branch)):
            packing = way.packing  # the packing is copied later, and only if it is among the best
            first: NextCandidate | None = candidate
            boxes = before | {packing.box(candidate)}
            if stride > 1:
                packing, first = way.packing.copy(), None
                packing.put(candidate)
                packing.fill(most=stride - 1)
                boxes = frozenset(packing.placed)
            # Skip: an earlier packing has the same boxes at the same places, placed in another order.
            if boxes in seen_packings:
                continue
            seen_packings.add(boxes)
            if number == 0:  # the known full packing began with this candidate
                filled: RankedPacking | None = way.filled
            else:
                filled = _full_packing(fills, packing, first, _worst(best, width, packing.n_items))
            if filled is not None:
                best.append(_SearchBranch(packing, first, filled))
                best.sort(key=lambda next_way: next_way.filled.worth, reverse=True)
                del best[width:]
    return [next_way.node() for next_way in best]


def _worst(best: Sequence[_SearchBranch], width: int, n_items: int) -> float:
    """The height that a further packing must not exceed to be among the best, mm."""
    if len(best) < width or len(best[-1].filled.placed) < n_items:  # packings with more boxes may have any height
        return inf
    return best[-1].filled.height_mm


def _full_packing(
    fills: Fills, packing: Packing, first: NextCandidate | None = None, highest_mm: float = inf
) -> RankedPacking | None:
    """The packing, filled up; None if it becomes higher than ``highest_mm``."""
    filled = fills(packing, first, highest_mm)
    return None if filled is None else RankedPacking(PackingValue.of(filled), filled.placed)
