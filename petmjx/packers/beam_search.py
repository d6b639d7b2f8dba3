"""Beam search for dense packings of an order. Candidates (boxes at places) are as in the packer ``balanced``.

The search keeps ``width`` packings. Every step extends each kept packing by its ``branch`` best candidates. To rate a
candidate, the packing with this candidate is filled up by best fit, as in ``balanced``. This is the pilot method (Duin,
Voß 1999, "The pilot method: a strategy for heuristic repetition with application to the Steiner problem in graphs",
Networks 34, 181–191). Of all extended packings, the best ``width`` are kept. Filling up is aborted as soon as the
packing is higher than all of the ``width`` best packings that this step has found so far. In large orders, a step of
the search places several boxes: first the candidate, then further boxes by best fit.

The search is deterministic, and does not depend on computing time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from math import ceil, inf
from typing import Final, NamedTuple

from petmjx.common.machine import why_no_warp_on_cpu
from petmjx.packers.balanced_packer import PREFERENCE_SETS
from petmjx.packers.baseline_packer import PlacedBox
from petmjx.packers.packing_state import FullPacking, NextCandidate, Packing, Preferences
from petmjx.plans.order import Item

MOST_STEPS: Final = 80
"""Largest number of steps of a search. In an order with more boxes, each step places several boxes. With this limit,
the search for an order of 162 different boxes takes 12 s; without the limit, it takes 34 s."""

_VOLUME_DECIMALS: Final = 9
"""Number of decimals to which volumes in m³ are rounded, that is, to a cubic millimetre. With this rounding, two sums
over the same boxes in different sequences are equal."""


class PackingValue(NamedTuple):
    """The value of a full packing. Values are compared first by the volume of the boxes, then by the height of the
    packing, then by the moment of the masses. The larger value is better."""

    volume_m3: float
    below_mm: float
    """Minus the height of the highest top, mm."""
    deep_kg_mm: float
    """Minus the sum of mass × height of the middle over all boxes, kg·mm. Of two equally high packings, the packing
    with the lower centre of mass stands better."""

    @classmethod
    def of(cls, filled: FullPacking) -> PackingValue:
        """The value of the packing ``filled``."""
        return cls(round(filled.volume_m3, _VOLUME_DECIMALS), -filled.top_mm, -filled.moment_kg_mm)


class RankedPacking(NamedTuple):
    """A full packing, and its value (``worth``), by which packings are compared."""

    worth: PackingValue
    placed: tuple[PlacedBox, ...]

    @property
    def height_mm(self) -> float:
        """Height of the highest top, mm."""
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
        extent_mm: length and width of the target, mm.
        clearance_mm: free space between a box and its neighbours along x and y, mm.
        width: number of packings that each step keeps.
        branch: number of candidates that each step tries for each packing.
    """
    best: RankedPacking | None = None
    for preferences in PREFERENCE_SETS:
        packing = _search(items, extent_mm, clearance_mm, preferences, width, branch)
        if best is None or packing.worth > best.worth:
            best = packing
        if len(best.placed) == len(items):
            break
    assert best is not None
    return best


Fills = Callable[[Packing, NextCandidate | None, float], FullPacking | None]
"""A function that fills up a packing, with the arguments of ``Packing.filled``."""


def fills_for(start: Packing) -> Fills:
    """Make the function that fills up packings of an order. ``start`` is the empty packing of the order.

    If Warp is installed, the function is compiled. The compiled function makes the same packings as the function in
    Python.
    """
    if why_no_warp_on_cpu() is None:
        with suppress(Exception):  # if Warp cannot be loaded, or cannot compile, Python is used
            from petmjx.packers.compiled_fill import FillKernel

            return FillKernel(start)
    return Packing.filled


class _SearchNode(NamedTuple):
    """A packing that the next step may extend, and the full packing that results from filling up this packing."""

    packing: Packing
    filled: RankedPacking


class _SearchBranch(NamedTuple):
    """A packing, a candidate for its next box, and the full packing that results if this candidate is placed first. The
    candidate is None if the packing already contains the candidate's box."""

    packing: Packing
    candidate: NextCandidate | None
    filled: RankedPacking

    def node(self) -> _SearchNode:
        """The node to which this branch leads: the packing together with the candidate's box."""
        if self.candidate is None:
            return _SearchNode(self.packing, self.filled)
        packing = self.packing.copy()
        packing.put(self.candidate)
        return _SearchNode(packing, self.filled)


def _search(
    items: Sequence[Item],
    extent_mm: tuple[float, float],
    clearance_mm: float,
    preferences: Preferences,
    width: int,
    branch: int,
) -> RankedPacking:
    start = Packing(items, extent_mm, preferences, clearance_mm)
    fills = fills_for(start)
    first = _full_packing(fills, start)
    assert first is not None
    ways, best, stride = [_SearchNode(start, first)], first, ceil(len(items) / MOST_STEPS)
    while ways := _step(ways, width, branch, stride, fills):
        best = max(best, ways[0].filled, key=lambda packing: packing.worth)
    return best


def _step(ways: Sequence[_SearchNode], width: int, branch: int, stride: int, fills: Fills) -> list[_SearchNode]:
    """The best packings with ``stride`` more boxes, best first. The list is empty if no more boxes can be placed."""
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
            # skip this packing: an earlier packing of this step has the same boxes at the same places
            if boxes in seen_packings:
                continue
            seen_packings.add(boxes)
            if number == 0:  # way.filled places the best candidate first, so it is the full packing of candidate 0
                filled: RankedPacking | None = way.filled
            else:
                filled = _full_packing(fills, packing, first, _worst(best, width, packing.n_items))
            if filled is not None:
                best.append(_SearchBranch(packing, first, filled))
                best.sort(key=lambda next_way: next_way.filled.worth, reverse=True)
                del best[width:]
    return [next_way.node() for next_way in best]


def _worst(best: Sequence[_SearchBranch], width: int, n_items: int) -> float:
    """Largest height with which a further packing can still be among the ``width`` best packings, mm. The height is
    infinite if ``best`` has fewer than ``width`` packings, or if the worst packing in ``best`` lacks boxes."""
    if len(best) < width or len(best[-1].filled.placed) < n_items:  # a packing with more boxes is better at any height
        return inf
    return best[-1].filled.height_mm


def _full_packing(
    fills: Fills, packing: Packing, first: NextCandidate | None = None, highest_mm: float = inf
) -> RankedPacking | None:
    """The full packing that results from filling up a packing; None if it becomes higher than ``highest_mm``."""
    filled = fills(packing, first, highest_mm)
    return None if filled is None else RankedPacking(PackingValue.of(filled), filled.placed)
