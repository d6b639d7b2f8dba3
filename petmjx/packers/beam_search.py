"""Dense packings of an order: a beam search over the candidates of ``balanced``, by what comes of them in the end.

Every step goes on from ``width`` packings, each with its ``branch`` best candidates. What a candidate is worth is seen
by filling the packing up, best fit after best fit (the pilot method: Duin, Voß 1999, "The pilot method: a strategy for
heuristic repetition with application to the Steiner problem in graphs", Networks 34, 181–191). The best ``width`` are
kept. A packing that is filled up is given up as soon as it is higher than those. In large orders a step places several
boxes, of which the first is chosen so.

Nothing is drawn at random, and nothing depends on the time that it takes.
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
"""Steps of a search. With it an order of 162 boxes, all different, takes 12 s, without it 34 s."""

_VOLUME_DECIMALS: Final = 9
"""Volumes are the same where they are as near as a cubic millimetre: the same boxes in another order."""


class PackingValue(NamedTuple):
    """What a packing is worth, the larger the better: first that boxes are on it, then that it is low."""

    volume_m3: float
    below_mm: float
    """How far its highest top is below z = 0: a negative number."""
    deep_kg_mm: float
    """How deep its masses are: of packings equally high, the one with lower masses stands better."""

    @classmethod
    def of(cls, filled: FullPacking) -> PackingValue:
        """Of a packing that is filled up."""
        return cls(round(filled.volume_m3, _VOLUME_DECIMALS), -filled.top_mm, -filled.moment_kg_mm)


class RankedPacking(NamedTuple):
    """A packing that is filled up."""

    worth: PackingValue
    placed: tuple[PlacedBox, ...]

    @property
    def height_mm(self) -> float:
        """Its highest top."""
        return -self.worth.below_mm


def search(
    items: Sequence[Item],
    extent_mm: tuple[float, float],
    clearance_mm: float,
    *,
    width: int,
    branch: int,
) -> RankedPacking:
    """The best packing of an order that was found.

    Args:
        items: of the order.
        extent_mm: of the target.
        clearance_mm: free space that boxes keep to their neighbours along x and y.
        width: packings that the search goes on from.
        branch: candidates of each that are tried.
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
"""What fills packings up, as ``Packing.filled``."""


def fills_for(start: Packing) -> Fills:
    """What fills up packings of an order: in machine code where Warp is installed, which compiles it. The packings are
    the same.

    Args:
        start: the one without boxes.
    """
    if why_no_warp_on_cpu() is None:
        with suppress(Exception):  # Warp cannot be loaded, or does not compile here
            from petmjx.packers.compiled_fill import FillKernel

            return FillKernel(start)
    return Packing.filled


class _SearchNode(NamedTuple):
    """A packing that the search may go on from, and what it is when it is filled up."""

    packing: Packing
    filled: RankedPacking


class _SearchBranch(NamedTuple):
    """A packing with one box more, if there is a candidate, and what it is when it is filled up."""

    packing: Packing
    candidate: NextCandidate | None
    filled: RankedPacking

    def made(self) -> _SearchNode:
        """With that box placed."""
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
    """The best ways that lead on by ``stride`` boxes, the best first; none where nothing more can be placed."""
    best: list[_SearchBranch] = []
    known: set[frozenset[PlacedBox]] = set()
    for way in ways:
        before = frozenset(way.packing.placed)
        for number, candidate in enumerate(way.packing.next(branch)):
            packing = way.packing  # copied only for the best
            first: NextCandidate | None = candidate
            boxes = before | {packing.box(candidate)}
            if stride > 1:
                packing, first = way.packing.copy(), None
                packing.put(candidate)
                packing.fill(most=stride - 1)
                boxes = frozenset(packing.placed)
            if boxes in known:  # in another order
                continue
            known.add(boxes)
            if number == 0:  # the best candidate is the one with which its packing was filled up
                filled: RankedPacking | None = way.filled
            else:
                filled = _full_packing(fills, packing, first, _worst(best, width, packing.n_items))
            if filled is not None:
                best.append(_SearchBranch(packing, first, filled))
                best.sort(key=lambda next_way: next_way.filled.worth, reverse=True)
                del best[width:]
    return [next_way.made() for next_way in best]


def _worst(best: Sequence[_SearchBranch], width: int, n_items: int) -> float:
    """The height that another packing must not exceed to be one of the best, mm."""
    if len(best) < width or len(best[-1].filled.placed) < n_items:  # more boxes may be worth any height
        return inf
    return best[-1].filled.height_mm


def _full_packing(
    fills: Fills, packing: Packing, first: NextCandidate | None = None, highest_mm: float = inf
) -> RankedPacking | None:
    """The packing, filled up; None if it becomes higher than that."""
    filled = fills(packing, first, highest_mm)
    return None if filled is None else RankedPacking(PackingValue.of(filled), filled.placed)
